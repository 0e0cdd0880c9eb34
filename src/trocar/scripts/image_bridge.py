"""Images of messages as arrays of numpy and back, with the names of cv_bridge.

Source of names and behaviour: the public documentation of cv_bridge (ROS 1 Noetic, ROS 2 Humble).
"""

from __future__ import annotations

from io import BytesIO
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.scripts.messages import Edition, message_class

Pixels = NDArray[Any]

#: {encoding: (red, green, blue, alpha) by channel}. Source: sensor_msgs/image_encodings.
COLOURS = {
    "rgb8": "rgb", "bgr8": "bgr", "rgba8": "rgba", "bgra8": "bgra", "mono8": "m",
    "rgb16": "rgb", "bgr16": "bgr", "rgba16": "rgba", "bgra16": "bgra", "mono16": "m",
}  # fmt: skip
#: {letters of OpenCV's types: numpy's}
DEPTHS = {
    "8U": "u1", "8S": "i1", "16U": "u2", "16S": "i2", "32S": "i4", "32F": "f4", "64F": "f8",
}  # fmt: skip
#: Quality of JPEG. Source: OpenCV's default of imencode.
QUALITY = 95
#: Shares of red, green and blue in grey. Source: ITU-R BT.601, as OpenCV's cvtColor.
GREY = np.array([0.299, 0.587, 0.114])


class CvBridgeError(TypeError):
    """An image that cannot be converted."""


def layout(encoding: str) -> tuple[np.dtype[Any], int]:
    """Return type and channels of an encoding.

    Raises:
        CvBridgeError: it is unknown
    """
    if encoding in COLOURS:
        wide = "u2" if encoding.endswith("16") else "u1"
        return np.dtype(wide), len(COLOURS[encoding])
    depth, _, channels = encoding.partition("C")
    if depth in DEPTHS and (not channels or channels.isdigit()):
        return np.dtype(DEPTHS[depth]), int(channels or 1)
    raise CvBridgeError(
        f"encoding: got {encoding!r}; allowed: {', '.join(COLOURS)}, and OpenCV's, as 32FC1"
    )


class ImageBridge:
    """Converts sensor_msgs/Image and CompressedImage; colours are bgr where none are asked for."""

    edition: ClassVar[Edition] = 1

    def imgmsg_to_cv2(self, img_msg: Any, desired_encoding: str = "passthrough") -> Pixels:
        """Return the pixels of an image, (h, w) or (h, w, channels).

        Raises:
            CvBridgeError: they cannot be had in this encoding
        """
        kind, channels = layout(img_msg.encoding)
        kind = kind.newbyteorder(">" if img_msg.is_bigendian else "<")
        rows = np.frombuffer(bytes(img_msg.data), np.uint8).reshape(img_msg.height, img_msg.step)
        used = img_msg.width * channels * kind.itemsize
        pixels = np.ascontiguousarray(rows[:, :used]).view(kind).astype(kind.newbyteorder("="))
        pixels = pixels.reshape(img_msg.height, img_msg.width, channels)
        pixels = pixels[..., 0] if channels == 1 else pixels
        return _converted(pixels, img_msg.encoding, desired_encoding)

    def cv2_to_imgmsg(self, cvim: Any, encoding: str = "passthrough", header: Any = None) -> Any:
        """Return an image of pixels, (h, w) or (h, w, channels).

        Raises:
            CvBridgeError: the pixels are not of the encoding
        """
        pixels = np.ascontiguousarray(cvim)
        count = 1 if pixels.ndim == 2 else pixels.shape[2]
        code = {np.dtype(name): word for word, name in DEPTHS.items()}.get(pixels.dtype)
        if pixels.ndim not in (2, 3) or code is None:
            raise CvBridgeError(f"got an array of {pixels.dtype} {pixels.shape}; allowed: an image")
        name = f"{code}C{count}" if encoding == "passthrough" else encoding
        if layout(name) != (pixels.dtype, count):
            raise CvBridgeError(f"got {code}C{count} for encoding {name!r}; allowed: its own type")
        made: Any = message_class("sensor_msgs/Image", self.edition)()
        if header is not None:
            made.header = header
        made.height, made.width = int(pixels.shape[0]), int(pixels.shape[1])
        made.encoding, made.step = name, pixels.nbytes // made.height
        made.data = pixels.tobytes()
        return made

    def compressed_imgmsg_to_cv2(self, cmprs_img_msg: Any, desired_encoding: str = "") -> Pixels:
        """Return the pixels of a compressed image, bgr by default, (h, w, 3) or (h, w)."""
        with Image.open(BytesIO(bytes(cmprs_img_msg.data))) as picture:
            grey = picture.mode in ("L", "I;16")
            pixels = np.array(picture if grey else picture.convert("RGB"))
        wanted = desired_encoding or "passthrough"
        if grey:
            return _converted(pixels, "mono8", wanted)
        return _converted(pixels, "rgb8", "bgr8" if wanted == "passthrough" else wanted)

    def cv2_to_compressed_imgmsg(self, cvim: Any, dst_format: str = "jpg") -> Any:
        """Return pixels, bgr or grey, as a compressed image."""
        pixels = np.asarray(cvim)
        file = BytesIO()
        kind = "jpeg" if dst_format in ("jpg", "jpeg") else dst_format
        shown = pixels if pixels.ndim == 2 else pixels[..., 2::-1]
        Image.fromarray(np.ascontiguousarray(shown)).save(file, kind, quality=QUALITY)
        made: Any = message_class("sensor_msgs/CompressedImage", self.edition)()
        made.format, made.data = dst_format, file.getvalue()
        return made


def _converted(pixels: Pixels, encoding: str, wanted: str) -> Pixels:
    """Return pixels in another encoding."""
    if wanted in ("passthrough", encoding):
        return pixels
    kind, channels = layout(wanted)
    if encoding not in COLOURS or wanted not in COLOURS:
        if (pixels.dtype, 1 if pixels.ndim == 2 else pixels.shape[2]) == (kind, channels):
            return pixels
        raise CvBridgeError(f"encoding: got {encoding!r}; allowed: one that {wanted!r} is made of")
    have, want = COLOURS[encoding], COLOURS[wanted]
    if kind != pixels.dtype:
        scale = 257.0 if kind.itemsize > pixels.itemsize else 1.0 / 257.0
        pixels = np.rint(pixels * scale).astype(kind)
    if want == "m":
        grey = sum(GREY[i] * pixels[..., have.index(c)] for i, c in enumerate("rgb"))
        return np.rint(grey).astype(kind)
    opaque = np.full(pixels.shape[:2], np.iinfo(kind).max, kind)
    planes = {c: pixels if have == "m" else pixels[..., have.index(c)] for c in "rgb"}
    planes["a"] = pixels[..., have.index("a")] if "a" in have else opaque
    return np.stack([planes[c] for c in want], axis=-1)

"""Uses of viser's private names, each in place of a public hook that viser 1.1 lacks."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import viser
import viser.infra._infra as viser_infra
import websockets
from numpy.typing import NDArray
from viser._messages import (
    FileTransferStartUpload,
    SetOrientationMessage,
    SetPositionMessage,
)
from websockets.asyncio.server import serve

from trocar.errors import TrocarError

Floats = NDArray[np.float64]

_constructing = threading.Lock()


@contextlib.contextmanager
def served_with(ours: Mapping[str, Any]) -> Generator[None]:
    """Let a `ViserServer` open its port with our keyword arguments of websockets' `serve`.

    Hook: an argument of `ViserServer`, which listens before its constructor returns.

    Raises:
        TrocarError: this version of viser opens its port in another way
    """
    opened: list[int] = []

    def serve_ours(*args: Any, **options: Any) -> serve:
        opened.append(1)
        return serve(*args, **{**options, **ours})

    theirs = SimpleNamespace(server=SimpleNamespace(serve=serve_ours))
    with _constructing:
        for_viser = SimpleNamespace(**{**vars(websockets), "asyncio": theirs})
        setattr(viser_infra, "websockets", for_viser)  # noqa: B010  viser exports no such name
        try:
            yield
        finally:
            setattr(viser_infra, "websockets", websockets)  # noqa: B010
    if not opened:
        raise TrocarError(f"viser {viser.__version__}: unsupported server; allowed: 1.1")


def grey_out(buttons: viser.GuiButtonGroupHandle, *, disabled: bool) -> None:
    """Grey a group of buttons out, or no longer.

    Hook: `GuiButtonGroupHandle.disabled`, which viser's client shows and its handle refuses to set.
    """
    buttons._queue_update("disabled", disabled)  # pyright: ignore[reportPrivateUsage]


def show_packed(image: viser.GuiImageHandle, data: bytes) -> None:
    """Show a picture that is packed already, as a file's bytes in the handle's format.

    Hook: bytes for `GuiImageHandle.image`, which packs a picture anew, in viser's thread.
    """
    image._data = data  # pyright: ignore[reportPrivateUsage]


def move(scene: viser.SceneApi, nodes: Sequence[viser.SceneNodeHandle], poses: Floats) -> None:
    """Move nodes of the scene.

    Hook: a setter of a pose. `position` and `wxyz` compare with the pose before, which takes four
    times as long as sending (measured).

    Args:
        scene: of the nodes
        nodes: n nodes
        poses: in their parents, (n, 7): position [m], quaternion wxyz
    """
    queue = scene._queue_scene_message  # pyright: ignore[reportPrivateUsage]
    for node, pose in zip(nodes, poses, strict=True):
        node.position[:], node.wxyz[:] = pose[:3], pose[3:]
        x, y, z, *turn = pose.tolist()
        queue(SetPositionMessage(node.name, (x, y, z)))
        queue(SetOrientationMessage(node.name, (turn[0], turn[1], turn[2], turn[3])))


def check_uploads(gui: viser.GuiApi, check: Callable[[str, int], object]) -> None:
    """Check the name and size [bytes] of each file as soon as a browser announces it.

    Hook: a bound of `GuiApi.add_upload_button`. viser keeps the parts of an upload that it has
    accepted, whatever their size; of one that it has not, it drops them.

    Args:
        gui: the widgets among which files are uploaded
        check: called with name and size; a TrocarError refuses the file
    """
    sockets: Any = gui._websock_interface  # pyright: ignore[reportPrivateUsage]
    begin: Any = gui._handle_file_transfer_start  # pyright: ignore[reportPrivateUsage]

    def checked(client: int, message: FileTransferStartUpload) -> None:
        with contextlib.suppress(TrocarError):
            check(message.filename, message.size_bytes)
            begin(client, message)

    sockets.unregister_handler(FileTransferStartUpload)
    sockets.register_handler(FileTransferStartUpload, checked)

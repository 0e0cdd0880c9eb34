"""What cameras saw: who draws it, who looks at it, and what goes from the one to the other."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from trocar.interfaces.packing import Packer, Picture

if TYPE_CHECKING:
    from trocar.cameras.records import Calibration
    from trocar.simulation.cameras import CameraRecord
    from trocar.simulation.records import Snapshot


class Renderer(Protocol):
    """Draws; made, used and closed in one thread."""

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        camera: str,
        *,
        beside: Collection[str] = (),
    ) -> Any:
        """Return what a camera sees: a frame with `left` and `right` (h, w, 3), `right` or None.

        Beside the colours it has "depth" and "ids", where they are asked for.
        """
        ...

    def close(self) -> None:
        """Let go of the graphics library."""
        ...


@dataclass(frozen=True, eq=False)
class Order:
    """What is to be drawn: a world at one moment.

    Attributes:
        stamp: what headers say of it, None where nobody gives stamps
        asked_s: wall time of the snapshot [s]
        snapshot, cameras: where bodies and cameras are, of one moment
        wanted: names of the cameras that somebody looks through
        beside: {camera: what is wanted of it beside colours: "depth", "ids"}
    """

    stamp: tuple[int, int] | None
    asked_s: float
    snapshot: Snapshot
    cameras: Mapping[str, CameraRecord]
    wanted: frozenset[str]
    beside: Mapping[str, Collection[str]] = field(default_factory=dict[str, Collection[str]])


class Shot:
    """What one camera saw at one moment.

    Attributes:
        camera: its name
        record: where it was and what its lenses are like, as `World.cameras` tells
        frame: the picture or two, as the renderer made them
        stamp: what headers say; None where nobody gives stamps
        asked_s: wall time of the snapshot [s]
    """

    def __init__(self, camera: str, order: Order, frame: Any, packer: Packer) -> None:
        self.camera, self.record, self.frame = camera, order.cameras[camera], frame
        self.stamp, self.asked_s, self._packer = order.stamp, order.asked_s, packer
        self._packed: dict[str, bytes] = {}

    @property
    def format(self) -> str:
        """What `packed` gives: "jpeg" or "png"."""
        return self._packer.format

    def eye(self, eye: str) -> Picture:
        """Return the picture of an eye, (h, w, 3); a camera with one has it on the left."""
        return self.frame.right if eye == "right" else self.frame.left

    @property
    def calibration(self) -> Calibration:
        """What the eyes are like that saw it; without distortion where it was not asked for."""
        return self.frame.calibration

    def packed(self, eye: str) -> bytes:
        """Return the picture of an eye as a file's bytes, packed once for all who ask."""
        found = self._packed.get(eye)
        if found is None:
            found = self._packed[eye] = self._packer.pack(self.eye(eye))
        return found


class Taker(Protocol):
    """Somebody who looks."""

    def wanted(self) -> Collection[str]:
        """Return the cameras to look through now; asked in the loop's thread: be quick."""
        ...

    def take(self, shot: Shot) -> None:
        """Take a picture, of a camera that somebody wanted; called in the drawing thread."""
        ...

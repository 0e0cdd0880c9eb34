"""What cameras see, in a recording: compressed images and camera_info, as on topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from trocar.errors import InputError
from trocar.interfaces.crtk.image_rows import RECORDED, Origin, rows_of
from trocar.interfaces.crtk.images import message
from trocar.interfaces.crtk.messages import cdr_encode, message_type
from trocar.interfaces.packing import Packer
from trocar.interfaces.pictures import SLACK_S
from trocar.interfaces.shots import Order, Renderer, Shot
from trocar.recording import Extra, recorder_of

if TYPE_CHECKING:
    from trocar.interfaces.crtk.topics import Topic
    from trocar.simulation import World

SECOND = 1_000_000_000


class RecordedImages:
    """Looks through cameras as long as the world is recorded, and lets what it sees be written.

    Args:
        world: is recorded
        cameras: which of its cameras; all when omitted
    """

    def __init__(self, world: World, cameras: Iterable[str] | None = None) -> None:
        self._world = world
        known = {camera.name: camera.kind for camera in world.rig.cameras}
        names = tuple(known) if cameras is None else tuple(cameras)
        self._rows: dict[str, list[tuple[Topic, Origin]]] = {
            name: list(rows_of(name, known[name], RECORDED)) for name in names
        }

    def wanted(self) -> Collection[str]:
        """Return the cameras, while the world is recorded."""
        return () if recorder_of(self._world) is None else self._rows.keys()

    def take(self, shot: Shot) -> None:
        """Let a picture be written; its stamp is simulation time, as in the whole recording."""
        recorder = recorder_of(self._world)
        if recorder is None:
            return
        time = float(shot.frame.time)
        stamp = divmod(round(time * SECOND), SECOND)
        for topic, origin in self._rows.get(shot.camera, ()):
            kind = message_type(topic.type)
            data = cdr_encode(kind, message(shot, origin, stamp))
            recorder.add(Extra(f"/{topic.name}", kind.ros2_name, kind.text_ros2, time, data))


@contextmanager
def images_recorded(
    world: World,
    open_renderer: Callable[[], Renderer],
    rate_hz: float,
    image_format: str = "jpeg",
) -> Iterator[None]:
    """Record what the cameras of a world see while the `with` block lasts, every picture.

    The world waits while it is drawn, so this is for runs that need not keep to the wall clock.

    Args:
        world: is recorded, now or later in the block
        open_renderer: makes what draws
        rate_hz: pictures a simulated second; each is taken when so much time has passed
        image_format: "jpeg" or "png"

    Raises:
        InputError: a rate that is not above 0
        TrocarError: nothing can be drawn
    """
    if not 0.0 < rate_hz < float("inf"):
        raise InputError(f"camera rate: got {rate_hz:g} Hz; allowed: above 0")
    images, packer, renderer = RecordedImages(world), Packer(image_format), open_renderer()
    count = -1

    def look() -> None:
        nonlocal count
        due = int((world.time + SLACK_S) * rate_hz)
        wanted = frozenset(images.wanted())
        if due == count or not wanted:
            return
        count = due
        order = Order(None, 0.0, world.snapshot(arms=False), world.cameras(), wanted)
        for camera in sorted(wanted):
            frame = renderer.render(order.snapshot, order.cameras, camera)
            images.take(Shot(camera, order, frame, packer))

    leave = world.observe(look, every=5)
    try:
        yield
    finally:
        leave()
        renderer.close()

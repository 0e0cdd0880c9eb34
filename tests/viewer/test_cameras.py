"""The window of the cameras, without a browser: what it asks for, what it shows, what it says."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.live.fake_renderer import FakeRenderer
from tests.viewer.visitor import Visitor, visiting
from trocar.live import Loop
from trocar.live.images import Order, Overlay, Packer, Pictures, Shot
from trocar.rendering.frames import depth_picture, ids_picture
from trocar.simulation import World
from trocar.viewer.cameras import (
    ANAGLYPH,
    BOTH,
    COLOUR,
    DEPTH,
    IDS,
    LEFT,
    OFF,
    RATE_HZ,
    RIGHT,
    SLOWEST_HZ,
    VISIBLE_S,
    CameraWindow,
)
from trocar.viewer.legends import NAMED, depth_legend, ids_legend
from trocar.viewer.page import Page
from trocar.viewer.server import LocalServer, run_there, serving

LIGHT, DARK = 220, 40


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


@pytest.fixture(scope="module")
def world() -> World:
    return World("full_cart")


@pytest.fixture
def pictures(world: World) -> Pictures:
    return Pictures(Loop(world), FakeRenderer)


@pytest.fixture
def window(server: LocalServer, pictures: Pictures) -> CameraWindow:
    eyes = {"endoscope": 2, "room": 1}
    return run_there(server, lambda: CameraWindow(server.gui, pictures, eyes))


class Clock:
    """A wall clock that a test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("trocar.viewer.cameras.time", clock)
    return clock


def shot(
    camera: str = "endoscope", overlay: Overlay | None = None, brightness: int = LIGHT
) -> Shot:
    """A light picture on the left, a dark one on the right."""
    left = np.full((48, 64, 3), brightness, np.uint8)
    right = np.full((48, 64, 3), DARK, np.uint8) if camera == "endoscope" else None
    frame = SimpleNamespace(left=left, right=right, calibration=None)
    nowhere: Any = {camera: None}
    nothing: Any = None
    order = Order(None, 0.0, nothing, nowhere, frozenset([camera]))
    return Shot(camera, order, frame, Packer(), overlay)


@pytest.fixture
def visitor(server: LocalServer) -> Iterator[Visitor]:
    with visiting(server) as found:
        yield found


def file_of(visitor: Visitor) -> bytes:
    """Return the file of the picture that a browser shows."""
    pictures = [w for w in visitor.read().widgets.values() if w.kind == "GuiImageMessage"]
    return pictures[-1].props["_data"]


def shown(visitor: Visitor, window: CameraWindow) -> np.ndarray:
    run_there(visitor.server, lambda: window.show(time.perf_counter()))
    return np.asarray(Image.open(io.BytesIO(file_of(visitor)))).astype(int)


@pytest.mark.parametrize(
    ("view", "size", "red", "blue"),
    [
        (LEFT, (64, 48), LIGHT, LIGHT),
        (RIGHT, (64, 48), DARK, DARK),
        (ANAGLYPH, (64, 48), LIGHT, DARK),
        (BOTH, (128, 48), (LIGHT + DARK) / 2, (LIGHT + DARK) / 2),
    ],
)
def test_a_view_shows_the_eyes_that_it_says(
    view: str,
    size: tuple[int, int],
    red: float,
    blue: float,
    server: LocalServer,
    visitor: Visitor,
    window: CameraWindow,
) -> None:
    window.choose_view(view)
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.wanted() == ("endoscope",)
    window.take(shot())
    image = shown(visitor, window)
    assert image.shape[:2] == size[::-1]
    assert image[..., 0].mean() == pytest.approx(red, abs=6)
    assert image[..., 2].mean() == pytest.approx(blue, abs=6)


def test_nothing_is_asked_for_unless_somebody_looks(
    visitor: Visitor, window: CameraWindow, clock: Clock
) -> None:
    assert window.wanted() == ()
    window.show(clock.now)
    assert window.wanted() == ("endoscope",)
    assert window.wanted() == ()  # 30 a second are enough
    window.take(shot())
    window.show(clock.now)
    first = file_of(visitor)
    window.take(shot(brightness=DARK))  # another one's: it is not packed for nobody
    window.show(clock.now)
    assert np.asarray(Image.open(io.BytesIO(first))).mean() > DARK and file_of(visitor) == first
    clock.now += 0.9 * VISIBLE_S
    assert window.wanted() == ("endoscope",)
    clock.now += 0.2 * VISIBLE_S
    assert window.wanted() == ()


def test_off_is_off(server: LocalServer, visitor: Visitor, window: CameraWindow) -> None:
    window.choose_view(OFF)
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.wanted() == ()
    before = file_of(visitor)
    window.take(shot())
    run_there(server, lambda: window.show(time.perf_counter()))
    assert file_of(visitor) == before
    run_there(server, window.show_status)
    assert ">off<" in window.line.content and "Save" not in window.line.content
    assert not window.image.visible
    window.choose_view(LEFT)
    run_there(server, window.show_status)
    assert window.image.visible and "Save" in window.line.content


def test_another_camera_can_be_looked_through(
    server: LocalServer, visitor: Visitor, window: CameraWindow
) -> None:
    window.choose_view(BOTH)
    window.choose_camera("room")
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.wanted() == ("room",)
    window.take(shot())  # it belongs to somebody else
    window.take(shot("room"))
    assert shown(visitor, window).shape == (48, 64, 3)


def test_the_line_says_how_many_come_and_what_went_wrong(
    server: LocalServer, window: CameraWindow, pictures: Pictures, clock: Clock
) -> None:
    run_there(server, window.show_status)
    assert "no image yet" in window.line.content
    for _ in range(31):
        clock.now += 1 / 25.0
        window.show(clock.now)
        assert window.wanted() == ("endoscope",)
        window.take(shot())
    pictures.dropped = 3
    run_there(server, window.show_status)
    assert "25 a second, 3 dropped" in window.line.content
    pictures.failure = "no OpenGL <b>"
    run_there(server, window.show_status)
    assert "no OpenGL &lt;b&gt;" in window.line.content


def test_the_page_has_the_window_and_shows_what_is_drawn(world: World) -> None:
    loop = Loop(world, speed="max")
    pictures = Pictures(loop, FakeRenderer)
    pictures.start()
    with serving("127.0.0.1", 0, "test") as server, visiting(server) as visitor:
        page = run_there(server, lambda: Page(server, world, loop, pictures))
        visitor.report()
        before = file_of(visitor)
        end = time.monotonic() + 20
        while file_of(visitor) == before:
            assert time.monotonic() < end
            run_there(server, page.refresh)
            loop.run(0.02)
        pictures.close()
        run_there(server, lambda: page.leave(visitor.who))
        assert not pictures.wanted


def test_without_pictures_there_is_no_window(server: LocalServer, world: World) -> None:
    page = run_there(server, lambda: Page(server, world, Loop(world)))
    desk = run_there(server, lambda: page.open(server))
    run_there(server, lambda: desk.build(1920))
    assert desk.cameras is None


def test_overlays_are_shown_until_they_are_switched_off(
    server: LocalServer, visitor: Visitor, world: World, clock: Clock
) -> None:
    pictures = Pictures(Loop(world), FakeRenderer)
    pictures.overlay = lambda frame, eye: np.full_like((frame.left, frame.right)[eye], 120)
    window = run_there(server, lambda: CameraWindow(server.gui, pictures, {"endoscope": 2}))
    for switched, brightness in ((True, 120), (False, LIGHT)):
        clock.now += 1.0
        window.show(clock.now)
        run_there(server, lambda on=switched: window.choose_overlays(on))
        assert window.wanted() == ("endoscope",)
        window.take(shot(overlay=pictures.overlay))
        assert np.abs(shown(visitor, window) - brightness).max() < 4


def test_pictures_become_rare_while_the_arms_fall_behind_and_come_back(
    window: CameraWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    for behind, period_s in ((True, 1.0 / SLOWEST_HZ), (False, 1.0 / RATE_HZ)):
        monkeypatch.setattr(Pictures, "behind", behind)
        for _ in range(100):
            window.show_status()
        assert window.period_s == pytest.approx(period_s)


# ---------------------------------------------------------------------- depth and ids

#: What both eyes see: a wedge from 50 to 200 mm, and three objects.
WEDGE = np.tile(np.linspace(0.05, 0.2, 64, dtype=np.float32), (2, 48, 1))
THINGS = np.repeat(np.array([0, 5, 9, 9], np.int32), 16)[None, None].repeat(48, 1).repeat(2, 0)


def deep_shot() -> Shot:
    """A shot with depth and ids beside its colours."""
    found = shot()
    found.frame.depth, found.frame.ids = WEDGE, THINGS
    found.frame.names = {5: "PSM1/<yaw>", 9: "table"}
    return found


@pytest.mark.parametrize("content", [DEPTH, IDS])
@pytest.mark.parametrize("view", [LEFT, RIGHT, BOTH, ANAGLYPH])
def test_depth_and_ids_are_requested_and_shown_with_their_legend(
    content: str, view: str, server: LocalServer, visitor: Visitor, window: CameraWindow
) -> None:
    window.choose_view(view)
    window.choose_content(content)
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.beside() == {}  # no picture is due
    assert window.wanted() == ("endoscope",)
    assert window.beside() == {"endoscope": (content,)}
    window.take(deep_shot())
    one = depth_picture(WEDGE[0], (0.05, 0.2)) if content == DEPTH else ids_picture(THINGS[0])
    expected = np.concatenate([one, one], axis=1) if view == BOTH else one
    image = shown(visitor, window)
    assert image.shape == expected.shape
    assert np.abs(image - expected.astype(int)).mean() < 12  # as JPEG
    run_there(server, window.show_status)
    assert ("[mm]" if content == DEPTH else "PSM1/&lt;yaw&gt;") in window.legend.content
    window.choose_content(COLOUR)
    assert window.beside() == {}
    run_there(server, window.show_status)
    assert window.legend.content == "" and not window.legend.visible


def test_a_picture_without_the_depth_that_was_chosen_since_is_left_out(
    server: LocalServer, visitor: Visitor, window: CameraWindow
) -> None:
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.wanted() == ("endoscope",)
    window.choose_content(DEPTH)
    before = file_of(visitor)
    plain = shot()
    plain.frame.depth = None
    window.take(plain)
    run_there(server, lambda: window.show(time.perf_counter()))
    assert file_of(visitor) == before


def test_pictures_draw_what_any_client_requests_beside_colours(world: World) -> None:
    renderer = FakeRenderer()
    loop = Loop(world, speed="max")
    pictures = Pictures(loop, lambda: renderer)
    client: Any = SimpleNamespace(wanted=lambda: ("endoscope",), take=lambda _: None)
    leave = pictures.add(client, lambda: {"endoscope": ("depth",)})
    other: Any = SimpleNamespace(**vars(client))
    pictures.add(other, lambda: {"endoscope": ("ids",)})
    for expected in ({"depth", "ids"}, {"ids"}):
        assert "endoscope" in pictures.shoot(world)
        end = time.monotonic() + 20
        while renderer.beside != expected:
            assert time.monotonic() < end
            time.sleep(0.01)
        leave()
    pictures.close()


def test_what_is_saved_is_the_picture_that_is_shown(server: LocalServer) -> None:
    saved: dict[str, bytes] = {}
    pictures = Pictures(Loop(World("psm")), FakeRenderer)
    eyes = {"endoscope": 2}
    window = run_there(
        server, lambda: CameraWindow(server.gui, pictures, eyes, save=saved.__setitem__)
    )
    window.press("save")
    assert not saved
    window.choose_content(DEPTH)
    run_there(server, lambda: window.show(time.perf_counter()))
    assert window.wanted()
    window.take(deep_shot())
    window.press("something")
    window.press("save")
    image = np.asarray(Image.open(io.BytesIO(saved["endoscope-depth.png"])))
    assert np.array_equal(image, depth_picture(WEDGE[0], (0.05, 0.2)))


def test_legends_have_the_ends_in_millimetres_and_the_largest_objects_first() -> None:
    found = depth_legend(WEDGE)
    assert (
        "<span>50</span>" in found and "<span>100</span>" in found and "<span>200</span>" in found
    )
    text = ids_legend(THINGS, {5: "a", 9: "b"})
    assert text.index("</span> b<") < text.index("</span> a<")
    many = np.arange(NAMED + 4, dtype=np.int32)[None, None]
    assert "and 3 more" in ids_legend(many, {})
    nothing = np.full((1, 2, 2), np.inf, np.float32)
    assert "[mm]" in depth_legend(nothing)

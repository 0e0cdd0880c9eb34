"""A renderer lives through what happens to it, and says what it cannot do."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.rendering.scenes import camera, disc, mesh, plate, seen, snapshot, stereo
from trocar.errors import InputError, MissingExtraError, TrocarError, UnknownNameError
from trocar.geometry.se3 import transform
from trocar.rendering import Channels, Look, Renderer, context, draw_list
from trocar.rendering.buffers import Scenery
from trocar.rendering.draw_list import Boxes
from trocar.rendering.frustum import Frustum
from trocar.rendering.gpu import Gpu
from trocar.simulation import World

BACK = plate(transform(np.eye(3), [0.0, 0.0, 0.12]), 0.3, 0.3)
BALL = disc(np.array([0.0, 0.0, 0.08]), 0.01)[0]
SHAPES = [mesh("back", BACK), mesh("ball", BALL, (0.8, 0.2, 0.1, 1.0), 1)]
WHERE = snapshot([np.eye(4)])


def pictured(renderer: Renderer) -> np.ndarray:
    return renderer.render(WHERE, {"eye": camera(stereo())}, "eye").side_by_side


@pytest.fixture
def renderer(opengl: str) -> Renderer:  # noqa: ARG001  skips without
    return Renderer(lambda: (1, SHAPES))


def test_any_thread_draws_the_same(renderer: Renderer) -> None:
    own, theirs = pictured(renderer), []
    threads = [threading.Thread(target=lambda: theirs.append(pictured(renderer))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert len(theirs) == 4 and all((picture == own).all() for picture in theirs)


def test_two_renderers_take_turns(renderer: Renderer) -> None:
    other = Renderer(lambda: (1, SHAPES), Channels(ids=True))
    first = pictured(renderer)
    assert (pictured(other) == first).all() and (pictured(renderer) == first).all()


def test_a_closed_renderer_opens_again(renderer: Renderer) -> None:
    before = pictured(renderer)
    renderer.close()
    renderer.close()
    assert (pictured(renderer) == before).all()
    assert renderer.contexts == 2


def test_a_lost_context_is_made_anew_and_said(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    before = pictured(renderer)
    draw, losses = Gpu.draw, [1]

    def once(self: Gpu, *args: Any) -> Any:
        if losses:
            losses.pop()
            raise context.load().Error("the device was removed")
        return draw(self, *args)

    monkeypatch.setattr(Gpu, "draw", once)
    with caplog.at_level(logging.WARNING, "trocar"):
        assert (pictured(renderer) == before).all()
    assert renderer.contexts == 2
    assert "the graphics context was lost (the device was removed); it is made anew" in caplog.text


def test_what_the_driver_complains_of_is_a_lost_context(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    before = pictured(renderer)
    draw, losses = Gpu.draw, [0xFFFF]  # no capability has this number

    def once(self: Gpu, *args: Any) -> Any:
        if losses:
            self.context.enable_direct(losses.pop())
        return draw(self, *args)

    monkeypatch.setattr(Gpu, "draw", once)
    with caplog.at_level(logging.WARNING, "trocar"):
        assert (pictured(renderer) == before).all()
    assert renderer.contexts == 2
    assert "GL_INVALID_ENUM); it is made anew" in caplog.text


def test_a_context_that_is_lost_at_once_again_is_an_error(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any) -> Any:
        raise context.load().Error("gone")

    monkeypatch.setattr(Gpu, "draw", never)
    with pytest.raises(TrocarError, match="lost twice: gone"):
        pictured(renderer)


def test_without_opengl_the_debian_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    moderngl = pytest.importorskip("moderngl")

    def fail(**_: Any) -> None:
        raise RuntimeError("libEGL.so not loaded")

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(
        TrocarError, match=r"libEGL.so not loaded .*apt install libegl1 libgl1 libgl1-mesa-dri"
    ):
        Renderer(lambda: (1, SHAPES))


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[scope\]'"):
        Renderer(lambda: (1, SHAPES))


def test_more_pixels_than_the_driver_draws_are_rejected(renderer: Renderer) -> None:
    huge = {"eye": camera(stereo((), (20000, 15000), 18000.0))}
    with pytest.raises(
        InputError, match=r"20000x15000 pixels.*more than this graphics driver draws"
    ):
        renderer.render(WHERE, huge, "eye")


def test_more_samples_than_the_driver_takes_are_rejected(opengl: str) -> None:  # noqa: ARG001
    renderer = Renderer(lambda: (1, SHAPES), look=Look(samples=64))
    with pytest.raises(
        InputError, match="samples: got 64; allowed with this graphics driver: up to"
    ):
        pictured(renderer)


def test_an_unknown_camera_is_named(renderer: Renderer) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown camera 'ear'.*eye"):
        renderer.render(WHERE, {"eye": camera(stereo())}, "ear")


def test_shapes_of_another_build_are_rejected(renderer: Renderer) -> None:
    later = WHERE._replace(build=2)
    eye = {"eye": replace(camera(stereo()), build=2)}
    with pytest.raises(InputError, match="the snapshot is of build 2"):
        renderer.render(later, eye, "eye")


def test_nothing_at_all_is_black(opengl: str) -> None:  # noqa: ARG001
    frame = seen([], stereo())
    assert not frame.left.any() and frame.depth is not None and np.isinf(frame.depth).all()
    assert frame.ids is not None and not frame.ids.any() and not frame.names


# ---------------------------------------------------------------- culling, levels of detail


@pytest.fixture(scope="module")
def cart() -> World:
    world = World("full_cart")
    world.reset(pose="work")
    return world


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("name", ["endoscope", "room"])
def test_what_is_not_drawn_would_not_be_seen(
    cart: World, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = cart.snapshot()

    def pictures() -> tuple[np.ndarray, np.ndarray]:
        renderer = Renderer(lambda: (now.build, cart.shapes()), Channels(ids=True))
        frame = renderer.render(now, cart.cameras(), name)
        renderer.close()
        assert frame.ids is not None
        return frame.ids, frame.left

    culled, _ = pictures()

    def all_of_it(frusta: Sequence[Frustum], around: Boxes) -> np.ndarray:
        return np.ones((len(frusta), len(around.middles)), dtype=bool)

    monkeypatch.setattr(draw_list, "inside", all_of_it)
    whole, _ = pictures()
    assert (culled == whole).mean() > 0.9999  # order decides which of two touching surfaces wins


@pytest.mark.usefixtures("opengl")
def test_simpler_surfaces_change_edge_pixels_only(
    cart: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, drawn = cart.snapshot(), []

    def ids() -> np.ndarray:
        renderer = Renderer(lambda: (now.build, cart.shapes()), Channels(ids=True))
        frame = renderer.render(now, cart.cameras(), "room")
        renderer.close()
        assert frame.ids is not None
        return frame.ids[0]

    levels = draw_list.chosen_levels

    def counted(things: Scenery, frustum: Frustum, who: np.ndarray, *others: Any) -> Any:
        level = levels(things, frustum, who, *others)
        drawn.append((things.count[who, level].sum() // 3, things.count[who, 0].sum() // 3))
        return level

    monkeypatch.setattr(draw_list, "chosen_levels", counted)
    simple = ids()
    monkeypatch.setattr(draw_list, "chosen_levels", lambda _t, _f, who, *_: 0 * who)
    whole = ids()
    assert drawn[0][0] < 0.6 * drawn[0][1]
    assert (simple == whole).mean() > 0.99

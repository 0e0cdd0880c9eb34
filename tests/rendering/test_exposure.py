"""Automatic exposure: every rig's scope sees well, and equal snapshots give equal pictures."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from tests.rendering.scenes import camera, mesh, plate, snapshot, stereo
from trocar.descriptions import load_rig, names
from trocar.descriptions.catalogue import load_scene
from trocar.geometry.se3 import transform
from trocar.rendering import Endoscope, Look, Renderer, Series, StereoFrame
from trocar.rendering.exposure import (
    ENDLESS,
    HIGHLIGHT,
    LEAST,
    MOST,
    TARGET,
    followed,
    luma,
    metered,
)
from trocar.rendering.look import style_of
from trocar.simulation import World
from trocar.tasks import make_task

#: Half of what is seen is brighter than this, half darker: about the middle of what screens show.
NEAR = 0.03
SMALL = "dvrk_sd_640x480"
EYES = {"eye": camera(stereo())}
VIEW = {"eye": camera(stereo(), kind="view")}


def wall(grey: float) -> Renderer:
    """Return a renderer of a wall, 0.12 m ahead."""
    flat = plate(transform(np.eye(3), [0.0, 0.0, 0.12]), 0.4, 0.4)
    return Renderer(lambda: (1, [mesh("wall", flat, (grey, grey, grey, 1.0))]))


def median(frame: StereoFrame) -> float:
    return float(np.median(luma(frame.left)))


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(
    "rig", ["ecm", "full_cart", "full_cart_mtm", "pegs", "suj_two_psm_ecm", "two_psm_ecm"]
)
def test_every_rigs_scope_sees_well(rig: str) -> None:
    world = World(rig)
    world.reset(pose="work" if "work" in world.rig.poses else "start")
    scope = Endoscope(world, preset="dvrk_sd_640x480")
    frame = scope.capture()
    highlights = np.percentile(luma(frame.left), HIGHLIGHT)
    assert TARGET - NEAR < median(frame) < (TARGET + NEAR if highlights < 0.7 else 0.5)
    assert (frame.left.max(axis=-1) > 250).mean() < 0.06  # little is white without a trace
    world.step(40)
    scope.capture()
    world.reset(pose="work" if "work" in world.rig.poses else "start")
    again = scope.capture()
    assert (again.side_by_side == frame.side_by_side).all()  # whatever was drawn in between
    assert again.exposure == frame.exposure


@pytest.mark.usefixtures("opengl")
def test_what_is_dark_is_exposed_longer_and_views_are_left_as_they_are() -> None:
    stops = [wall(grey).render(snapshot(), EYES, "eye").exposure for grey in (0.7, 0.6, 0.5)]
    assert LEAST < stops[0] < stops[1] < stops[2] < MOST
    assert wall(0.5).render(snapshot(), VIEW, "eye").exposure == 0.0
    fixed = Renderer(lambda: (1, []), look=Look(exposure=1.5))
    assert Series(fixed).render(snapshot(), EYES, "eye").exposure == 1.5


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("style", ["plain", "surgical"])
def test_a_white_board_is_white_and_nothing_but_highlights_saturates(style: str) -> None:
    task = make_task("peg-board")
    task.reset(0)
    look = Look(style=style)  # type: ignore[arg-type]
    with closing(Endoscope(task.world, preset=SMALL, ids=True, look=look)) as scope:
        alone = scope.capture()
        board = next(number for number, name in alone.names.items() if name == "board")
        for _ in range(5):
            frame = scope.capture_next()
            task.world.step(40)
            assert frame.ids is not None
            shown = 255.0 * luma(frame.left).reshape(frame.ids[0].shape)
            assert np.median(shown[frame.ids[0] == board]) >= 200.0
            assert (frame.left.max(axis=-1) > 250).mean() < 0.002
        assert (scope.capture_next().exposure - alone.exposure) == pytest.approx(0.0, abs=0.3)


def test_a_scene_with_tissue_is_surgical_and_one_without_is_plain() -> None:
    styles = {name: style_of(load_scene(name).rig) for name in names("scenes")}
    assert styles["suturing"] == styles["needle-pick"] == "surgical"
    assert styles["peg-board"] == styles["dynamic-tray"] == "plain"
    assert {style_of(load_rig(name)) for name in names("rigs")} == {"plain"}


@pytest.mark.usefixtures("opengl")
def test_in_a_series_light_fades_over_and_ends_where_a_single_picture_is() -> None:
    draws = wall(0.5)
    alone = draws.render(snapshot(), EYES, "eye")
    stops = 3.0
    seen = [stops]
    for _ in range(300):
        frame = draws.render(snapshot(), EYES, "eye", stops=stops)
        stops = followed(stops, frame.left, 1.0 / 60.0)
        seen.append(stops)
    assert (np.diff(seen) <= 0.0).all() and np.abs(np.diff(seen)).max() < 0.3
    assert seen[-1] == seen[-2]  # it has settled, and does not flicker
    assert median(draws.render(snapshot(), EYES, "eye", stops=stops)) == pytest.approx(
        TARGET, abs=NEAR
    )
    assert abs(stops - alone.exposure) < 0.5  # in bright light a stop changes little


def test_two_pictures_tell_how_bright_a_third_one_is() -> None:
    colour, light = np.random.default_rng(3).uniform([[0.3], [0.1]], [[0.7], [2.0]], (2, 4000))

    def shown(stops: float) -> np.ndarray:
        a = light * 2.0**stops
        grey = np.round(255.0 * colour * np.sqrt(a / (1.0 + a))).astype(np.uint8)
        return np.repeat(grey.reshape(40, 100)[..., None], 3, axis=-1)

    stops, aim = metered(shown(0.0), shown(ENDLESS))
    assert aim == TARGET
    assert np.median(luma(shown(stops))) == pytest.approx(TARGET, abs=0.005)


def test_a_picture_of_nothing_changes_nothing() -> None:
    black = np.zeros((48, 64, 3), np.uint8)
    assert metered(black, black) == (0.0, TARGET)
    assert followed(1.25, black, 0.1) == 1.25

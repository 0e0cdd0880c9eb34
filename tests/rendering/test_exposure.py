"""Automatic exposure: every rig's scope sees well, and equal snapshots give equal pictures."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rendering.scenes import camera, mesh, plate, snapshot, stereo
from trocar.geometry.se3 import transform
from trocar.rendering import Endoscope, Look, Renderer, Series, StereoFrame
from trocar.rendering.exposure import ENDLESS, LEAST, MOST, TARGET, followed, luma, stops_of
from trocar.simulation import World

#: Half of what is seen is brighter than this, half darker: about the middle of what screens show.
NEAR = 0.03
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
    assert median(frame) == pytest.approx(TARGET, abs=NEAR)
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
    colour, light = np.random.default_rng(3).uniform([[0.3], [0.1]], [[0.9], [2.0]], (2, 4000))

    def shown(stops: float) -> np.ndarray:
        a = light * 2.0**stops
        grey = np.round(255.0 * colour * np.sqrt(a / (1.0 + a))).astype(np.uint8)
        return np.repeat(grey.reshape(40, 100)[..., None], 3, axis=-1)

    stops = stops_of(shown(0.0), shown(ENDLESS))
    assert np.median(luma(shown(stops))) == pytest.approx(TARGET, abs=0.005)


def test_a_picture_of_nothing_changes_nothing() -> None:
    black = np.zeros((48, 64, 3), np.uint8)
    assert stops_of(black, black) == 0.0
    assert followed(1.25, black, 0.1) == 1.25

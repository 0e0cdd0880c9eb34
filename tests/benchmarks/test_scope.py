"""`python -m benchmarks scope`: both renderers draw the same moments of a motion."""

from __future__ import annotations

import pytest

from benchmarks.scope import MOST_TRIANGLES, in_motion, live, sizes, timed
from trocar.descriptions.cameras import load_stereo_camera
from trocar.errors import TrocarError
from trocar.rendering.context import open_context
from trocar.simulation import World


@pytest.fixture(autouse=True)
def opengl() -> None:
    try:
        open_context().release()
    except TrocarError as problem:
        pytest.skip(str(problem))


@pytest.mark.slow
def test_both_renderers_are_timed_on_the_cart_in_motion() -> None:
    world = World("full_cart")
    snapshots, record = in_motion(world)
    assert len({now.positions.tobytes() for now in snapshots}) == len(snapshots)
    preset = "dvrk_sd_640x480"
    eyes = record.seeing(load_stereo_camera(preset))
    found = {f.name.partition(": ")[2]: f for f in sizes(world, snapshots, eyes, preset, 0.1)}
    ours, theirs = (
        next(f for name, f in found.items() if name.startswith("pairs") and ("MuJoCo" in name) is m)
        for m in (False, True)
    )
    assert found["ours over MuJoCo's"].value == pytest.approx(ours.value / theirs.value)
    assert 0 < found["triangles in view"].value <= MOST_TRIANGLES
    assert found["time with depth and ids, over colour alone"].value > 0.0


def test_each_has_its_turns() -> None:
    turns: list[str] = []
    taken = timed({name: lambda _, n=name: turns.append(n) for name in "ab"}, 0.0)
    assert set(taken) == {"a", "b"} and turns.count("a") == turns.count("b")


@pytest.mark.slow
def test_pictures_beside_real_time_are_counted_while_a_page_is_looked_at() -> None:
    said: list[str] = []
    measured = live(0.3, said.append, onlooker="")
    assert "in place of a browser" in said[0]
    assert all("in place of a browser looks" in figure.name for figure in measured)
    found = {figure.name.rpartition(": ")[2]: figure.value for figure in measured}
    assert found["pairs"] > 0.0 and found["processor"] > 0.0 and found["real-time factor"] > 0.0
    assert found["drawing, median"] > 0.0
    assert found["capture to publish beyond drawing, median"] > 0.0

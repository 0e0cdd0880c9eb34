"""The stretch of memory that holds the physics state."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.simulation import World
from trocar.simulation.state_view import FIELDS, StateView


@pytest.mark.parametrize("rig", ["psm", "ecm", "mtm", "suj_two_psm_ecm"])
def test_the_view_holds_every_field_where_mujoco_has_it(rig: str) -> None:
    world = World(rig)
    data = world._data
    view = StateView(data)
    rng = np.random.default_rng(3)
    wanted = {name: rng.standard_normal(getattr(data, name).size) for name in FIELDS}
    for name, values in wanted.items():
        getattr(data, name)[:] = values
    copied = view.values.copy()
    for name, values in wanted.items():
        np.testing.assert_array_equal(copied[view.parts[name]], values)


def test_what_is_written_back_continues_the_same_motion() -> None:
    world = World("psm")
    world.arms["PSM1"].servo_jp(world.arms["PSM1"].measured_js().position + 0.01)
    world.step(7)
    data, view = world._data, StateView(world._data)
    kept, time = view.values.copy(), data.time
    mujoco.mj_step(world._model, data, 50)
    first = view.values.copy()
    view.values[:], data.time = kept, time
    mujoco.mj_step(world._model, data, 50)
    np.testing.assert_array_equal(view.values, first)


def test_a_recorded_time_is_the_simulations_to_the_last_bit() -> None:
    world = World("psm")
    world.step(3)
    q = world.arms["PSM1"].readings()[0]
    played = world.play({"PSM1": np.tile(q, (2000, 1))}, every=7)
    assert played.time[-1] == world.time
    assert np.all(np.diff(played.time) > 0.0)

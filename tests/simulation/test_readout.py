"""What a sample reads out is what the arms' own verbs return when it was taken."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import names
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.simulation.readout import Reader, Readout

#: Computed along two ways that share the readings; numbers are of about 1.
ROUNDING = 1e-12


def scatter(world: World, rng: np.random.Generator) -> None:
    """Put every arm somewhere, at some speed, and let its set-points be elsewhere."""
    for name, arm in world.arms.items():
        if not arm.runtime.motors.welded:
            q = rng.uniform(arm.joints.lower, arm.joints.upper)
            world.set_state(name, q, 0.1 * rng.standard_normal(len(q)))
            if arm.description.type != "SUJ":
                arm.servo_jp(
                    rng.uniform(arm.joints.lower, arm.joints.upper)[: arm.description.own_joints]
                )


def verbs_of(world: World) -> dict[str, dict[str, Any]]:
    """Return what the verbs of every arm say now."""
    found: dict[str, dict[str, Any]] = {}
    for name, arm in world.arms.items():
        each = found[name] = {
            "measured": arm.measured_cp().matrix,
            "local measured": arm.local.measured_cp().matrix,
            "setpoint": arm.setpoint_cp().matrix,
            "local setpoint": arm.local.setpoint_cp().matrix,
            "frame": arm.measured_cp().frame_id,
            "reference": world.reference_pose(name),
        }
        if arm.description.type != "SUJ":
            twist, local = arm.measured_cv(), arm.local.measured_cv()
            each["twist"] = np.concatenate([twist.linear, twist.angular])
            each["local twist"] = np.concatenate([local.linear, local.angular])
            for frame in ("body", "spatial"):
                wrench = getattr(arm, frame).measured_cf()
                each[f"{frame} wrench"] = np.concatenate([wrench.force, wrench.torque])
                each[f"{frame} jacobian"] = getattr(arm, frame).jacobian()
    return found


def read_out(seen: Readout, name: str, figure: str) -> Any:
    """Return a figure of a sample, by the name that `verbs_of` has for it."""
    arm, (first, _, last) = seen.arm(name), figure.partition(" ")
    local = first == "local"
    if figure == "frame":
        return arm.base_frame
    if figure == "reference":
        return arm.reference_in_world
    if last == "jacobian":
        return arm.jacobian("body" if first == "body" else "spatial")
    if last == "wrench":
        return arm.wrench("body" if first == "body" else "spatial")
    if figure.endswith("twist"):
        return arm.twist(local=local)
    return arm.tip(setpoint=figure.endswith("setpoint"), local=local)


def check(seen: Readout, expected: Mapping[str, Mapping[str, Any]], order: Any = list) -> None:
    """Compare every figure, read in some order."""
    figures = [(name, figure) for name, each in expected.items() for figure in each]
    for name, figure in order(figures):
        got, value = read_out(seen, name, figure), expected[name][figure]
        if figure == "frame":
            assert got == value, name
            continue
        scale = max(1.0, np.abs(value).max()) * (1e4 if figure.endswith("wrench") else 1.0)
        np.testing.assert_allclose(got, value, 0.0, ROUNDING * scale, err_msg=f"{name} {figure}")


@pytest.mark.parametrize("rig", names("rigs"))
def test_every_figure_of_a_sample_is_that_of_the_verb(rig: str, rng: np.random.Generator) -> None:
    world = World(rig, collisions=False)
    reader = Reader(world.model)
    for _ in range(3):
        scatter(world, rng)
        check(reader.read(world.sample()), verbs_of(world), rng.permutation)


@pytest.mark.parametrize("reference", ["ECM", "PSM2"])
def test_poses_follow_the_reference_arm_and_frames_that_were_set(
    reference: str, rng: np.random.Generator
) -> None:
    world = World("full_cart", collisions=False)
    reader = Reader(world.model)
    check(reader.read(world.sample()), verbs_of(world))
    scatter(world, rng)
    world.set_reference_arm(reference)
    T = transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2.0, 3.0]))
    world.arm("PSM1").local.set_base_frame(T, "table")
    check(reader.read(world.sample()), verbs_of(world))


def test_setup_joints_that_are_welded_are_read_where_they_stand(rng: np.random.Generator) -> None:
    world = World("full_cart", setup_joints="locked", collisions=False)
    scatter(world, rng)
    check(Reader(world.model).read(world.sample()), verbs_of(world))


def test_a_calibrated_arm_reads_out_by_its_own_loops(skew_overlay, rng) -> None:
    world = World("psm", calibration=skew_overlay("psm", rng))
    scatter(world, rng)
    assert not world.model.joints.arms["PSM1"].parallel
    check(Reader(world.model).read(world.sample()), verbs_of(world))


def test_a_sample_stays_what_it_was_while_the_world_moves_on(rng: np.random.Generator) -> None:
    world = World("two_psm_ecm")
    reader = Reader(world.model)
    before, expected = reader.read(world.sample()), verbs_of(world)
    scatter(world, rng)
    world.step(50)
    check(before, expected)


def test_two_samples_may_be_read_in_turns(rng: np.random.Generator) -> None:
    world = World("full_cart_mtm", collisions=False)
    reader = Reader(world.model)
    pairs = []
    for _ in range(2):
        scatter(world, rng)
        pairs.append((reader.read(world.sample()), verbs_of(world)))
    for figure in pairs[0][1]["PSM1"]:
        for seen, expected in pairs:
            check(seen, {"PSM1": {figure: expected["PSM1"][figure]}})


def test_an_effort_that_is_no_number_spoils_only_its_own_arm() -> None:
    world = World("two_psm_ecm")
    sample, expected = world.sample(), verbs_of(world)
    sample.arms["PSM1"].effort[:] = np.nan
    seen = Reader(world.model).read(sample)
    assert np.isnan(seen.arm("PSM1").wrench("body")).all()
    expected.pop("PSM1")
    check(seen, expected)

"""Rigs that nobody commands rest where they start, whatever they are simulated with."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import names
from trocar.simulation import World

#: Long enough for the slowest arm to sink: the ECM of the cart took 6 s. [s]
DURATION_S = 20.0
#: Every value of what a rig is simulated with.
CHOICES: dict[str, tuple[Any, ...]] = {
    "control": ("dvrk", "paper"),
    "friction": ("identified", "paper"),
    "dynamics": (None, "cad", "identified"),
    "setup_joints": ("braked", "locked"),
    "errors": (None, "perfect", "lab", "wide"),
}
#: An arm is at rest where it started within this part of the error that trips it. A PSM that sinks
#: by its weight over Table 8's stiffness moves by 2 %, the jaws of a PSM whose readings have the
#: errors "wide" by 7 %.
MOVED = 0.1
#: In the second half of the time it moves by at most this part of it: an integral part of 0.1 that
#: takes over a PSM's weight does so by 0.3 thousandths in 10 s.
DRIFTED = 1e-3
#: Setup joints are held by brakes. [rad or m]
BRAKED = 1e-9


def complaints(world: World) -> list[str]:
    """Step a world and return which arms tripped and which joints are elsewhere or still move."""
    ticks = round(0.5 * DURATION_S / world.timestep)
    start = world.servos.true()[0]
    world.step(ticks)
    middle = world.servos.true()[0]
    world.step(ticks)
    end = world.servos.true()[0]
    simulated = [arm for arm in world.arms.values() if not arm.runtime.motors.welded]
    trips = np.array([j.tracking_tolerance for arm in simulated for j in arm.description.joints])
    found = [
        f"{arm.name}: {arm.rejections.last}"
        for arm in world.arms.values()
        if not arm.operating_state().ready
    ]
    for what, by, part in (("moved", end - start, MOVED), ("drifts", end - middle, DRIFTED)):
        allowed = np.where(world.joints.braked, BRAKED, part * trips)
        found += [
            f"{joint} {what} by {far:.2g}, allowed {most:.2g}"
            for joint, far, most in zip(world.joints.names, np.abs(by), allowed, strict=True)
            if not far <= most
        ]
    return [*found, *world.engine_warnings()]


@pytest.mark.parametrize("friction", CHOICES["friction"])
def test_an_upright_endoscope_rests_under_the_papers_control(friction: Any) -> None:
    assert complaints(World("ecm", control="paper", friction=friction)) == []


@pytest.mark.parametrize(("friction", "errors"), [("paper", None), ("identified", "wide")])
def test_the_cart_and_its_console_rest_under_the_papers_control(
    friction: Any, errors: str | None
) -> None:
    """In the configuration of Table 9 the endoscope sank until the ECM tripped."""
    world = World("full_cart_mtm", control="paper", friction=friction, errors=errors)
    assert complaints(world) == []


@pytest.mark.slow
@pytest.mark.parametrize("rig", names("rigs"))
def test_every_rig_rests_in_every_combination(rig: str) -> None:
    """Combinations of one signature, the model's digest and the errors of readings, run once."""
    found: dict[str, list[str]] = {}
    for values in product(*CHOICES.values()):
        chosen = dict(zip(CHOICES, values, strict=True))
        world = World(rig, **chosen)
        if world.signature not in found:
            found[world.signature] = [f"{chosen}: {text}" for text in complaints(world)]
    assert len(found) >= 12  # two controls, two frictions and three kinds of readings
    assert [text for each in found.values() for text in each] == []

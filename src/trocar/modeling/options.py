"""Choices for a model, and the solver's constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelOptions:
    """Choices that change the compiled model.

    Attributes:
        timestep: physics time step [s]
        servo: one actuator a joint: "pid" has the inputs position, velocity and effort, and its
            gains are written into the compiled model; "position" has the gains of `control` and
            one input (`build.position_inputs`), which GPUs accept
        control: the preset of gains, "dvrk" or "paper"; an arm without it has its first
        gravity_compensation: whether servos feed gravity forward; None: as the preset has it
        friction: "identified" (dry and viscous, from recordings) or "paper" (damping 0.1)
        belts: "rigid", or "stretch" as their stiffnesses say; links of an Si hang on them
        collisions: whether bodies touch
        decoration: whether shapes that collide with nothing, and sites at fixed frames, are in
            the model (for renderers and comparisons; a physics step is faster without)
        standalone: whether the model is for scenes of others: geoms that are seen apart from those
            that collide, sites at fixed frames, and a lone arm that touches whatever has MuJoCo's
            default contact bits
        locked: {arm: q (n,)}: arms that are welded at these joint positions
    """

    timestep: float = 0.001
    servo: Literal["pid", "position"] = "pid"
    control: str = "dvrk"
    gravity_compensation: bool | None = None
    friction: Literal["identified", "paper"] = "identified"
    belts: Literal["rigid", "stretch"] = "rigid"
    collisions: bool = True
    decoration: bool = False
    standalone: bool = False
    locked: Mapping[str, Array] = field(default_factory=dict[str, Array])


#: From so many joints on the solver works on islands: arms that do not touch are solved apart. It
#: always starts from the last solution (1 iteration where it needs 3 to 7 without).
#: Source: measured on one thread of an EPYC in interleaved passes, median of the ratios of mj_step
#: in motion, islands beside no islands, both warm: psm (13 joints) 1.08, two_psm_ecm (34) 1.07,
#: the cart with locked setup joints (47) 1.04, suj_two_psm_ecm (50) 1.00, full_cart with its
#: brakes (69) 0.94, full_cart_mtm (91) 0.88. Warm beside cold, both on islands: full_cart 0.91,
#: full_cart_mtm 0.91, pegs with all objects asleep 0.91, with a block in the jaws 0.61; the motion
#: differs by 7e-9 rad at most after 0.6 s.
ISLAND_JOINTS = 60
#: A rig with objects is always solved on islands: what lies still then sleeps, and costs nothing
#: until something touches it. Slower than this for 10 steps is still. Source: our own choice, a
#: tenth of MuJoCo's. Measured per physics step: 20 blocks beside the cart with masters, 420 us
#: awake, 170 us asleep. [m/s]
STILL_M_S = 1e-4
#: Solver tolerance of rigs with objects, as MuJoCo scales it: forces between bodies then
#: balance to rounding. Source: measured on balls that collide and that elastic bands
#: join (`python -m benchmarks laws`): momentum is kept to 5e-8 with MuJoCo's 1e-8, to 1e-13 with
#: this. It costs nothing that can be measured: Newton converges quadratically, 3.05 iterations
#: with a block in the jaws of `pegs` in either case.
TOLERANCE = 1e-20
#: Time constant of loops, in physics steps. Source: measured on the PSM and ECM under
#: 10 N: gaps of 0.06 um with a quarter (trocar bench), of 0.15 um with a whole step.
STIFF_STEPS = 0.25
STIFF_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
#: Damping of a belt that stretches, as a time: damping = stiffness * time. Source: our own choice,
#: a quarter of critical for the links of an Si at the stiffness that its file has. [s]
BELT_LOSS_S = 0.002
#: A loop without a guard is held by so many equal constraints, each of which yields as the solver's
#: stiffest one does. Source: measured on a PSM with sides off by 0.5 mm and axes by 0.2 deg under
#: 10 N, over the whole pitch: gaps of 0.29 um with one, 0.073 um with four.
LAYERS = 4
#: Time constant of the joints' mechanical stops, in physics steps. Source: measured with a
#: gripping jaw: it hammers on its stop by 3 mrad at 1 step or less, and rests 8 urad in it at 2.
STOP_STEPS = 2.0
#: Stiffness and damping of what a jaw holds a prop by, as MuJoCo's negative solref, in squared
#: steps and steps. Source: measured on a needle that is carried about: it stays within nanometres.
HOLD = (-16.0, -8.0)
#: The same of contacts of a thread, whose links are too light for `CONTACT_STEPS`: they yield by
#: accelerations. Source: measured: jaws press 0.2 mm of thread in by 10 um with 20 N; it slips
#: through with CONTACT_STEPS.
THREAD = (-4.0, -4.0)
#: Solver tolerance of rigs with threads, in place of `TOLERANCE`: while threads slide, the solver
#: needs many iterations, of which this saves one or two. Source: measured on thread-handover: 1.1
#: to 1.3 times as fast; MuJoCo's own is 1e-8.
THREAD_TOLERANCE = 1e-10
#: Time constant of contacts in physics steps, and the cone's ratio: friction yields less than
#: pressure. Source: measured on a needle between the pads of a PSM: it creeps by 0.27 mm/s with 10,
#: 5 um/s with 1000 (`python -m benchmarks grip`); with warm starts it costs nothing.
CONTACT_STEPS = 2.0
CONTACT_IMPEDANCE = (0.9999, 0.9999, 0.0001, 0.5, 2.0)
IMPRATIO = 1000.0
CONTACT_FRICTION = (1.0, 0.002, 0.0005)

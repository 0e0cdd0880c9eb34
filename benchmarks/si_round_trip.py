"""Identification of simulated arms of a dVRK-Si: what they were made with comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.drives import held_log, returned, simulated_log
from trocar.descriptions.overlay_records import BodyDynamics, Dynamics, Overlay
from trocar.descriptions.records import ArmDescription
from trocar.robot.identification import default_filters, excite, filtered, identify
from trocar.robot.identification.drivetrains import described_trains, structure
from trocar.robot.identification.regression import moving_bodies
from trocar.robot.standing import standing_arm
from trocar.robot.verification.figures import Figure

#: How far a made robot is from the description: masses and inertias as ratios, centres of mass [m].
#: Source: our own choice.
MASS, INERTIA, CENTRE_M = (0.8, 1.25), (0.9, 1.1), 0.01
#: Friction of joints of which the description has none [N m, N m s], bias and all stop elements
#: slipping as ratios of Coulomb friction, and rotors of the slide [kg] and of motors of the
#: instrument [kg m^2]. Source: our own choice; no rotors of an Si are published.
SMALL, BIAS, SLIPPING, ROTORS = 0.003, 0.1, 0.2, (0.3, 1e-4)
SPRING = 0.0016
#: Bounds of masses [ratio], and the motion: period [s], repeats, candidates.
BOUNDS, MOTION = (0.1, 10.0), (10.0, 2, 6)


def made_robot(arm: ArmDescription, rng: np.random.Generator) -> Overlay:
    """Return the dynamics of an arm that is not quite as described."""
    bodies: dict[str, BodyDynamics] = {}
    for body in arm.bodies:
        if body.part == arm.name and body.frame in moving_bodies(arm, arm.mechanism.joint_names):
            ratio = rng.uniform(*MASS)
            com = body.com + rng.uniform(-CENTRE_M, CENTRE_M, 3)
            inertia = body.inertia * ratio * rng.uniform(*INERTIA)
            bodies[body.frame] = BodyDynamics(body.mass * ratio, com, inertia)
    described = described_trains(arm)
    trains = structure(arm)
    for name, train in trains.items():
        known = described[name].terms if name in described else {}
        coulomb, viscous = (known.get(term, (SMALL,))[0] for term in ("coulomb", "viscous"))
        stops = SLIPPING * coulomb / len(train.stop_limits)
        values = {
            "coulomb": (coulomb,),
            "viscous": (viscous,),
            "offset": (BIAS * coulomb,),
            "rotor": (ROTORS[name != "insertion"],),
            "stiffness": (SPRING,),
            "stops": tuple(stops / limit for limit in train.stop_limits),
        }
        trains[name] = replace(train, terms={term: values[term] for term in train.terms})
    return Overlay(arm.name, dynamics=Dynamics(bodies, trains, default_filters(arm)))


def si_round_trip(rigs: tuple[str, ...] = ("psm_si", "ecm_si")) -> list[Figure]:
    """Identify arms that lean as on their cart from logs of motions of `excite`.

    By computed torque, and by the arm's own controller with set-points that are held.
    """
    found: list[Figure] = []
    for rig in rigs:
        stand = standing_arm(None, rig=rig)
        robot = made_robot(stand.arm, np.random.default_rng(0))
        period_s, repeats, candidates = MOTION
        plan = excite(stand.arm, period_s, repeats, candidates=candidates, up=stand.up)
        for how, made in (("computed torque", simulated_log), ("held set-points", held_log)):
            log = made(rig, plan, robot)
            logs = [filtered(log, stand.arm, default_filters(stand.arm))]
            result = identify(logs, stand.arm, mass_ratios=BOUNDS)
            found += returned(f"si: {rig}, {how}", result, robot)
    return found

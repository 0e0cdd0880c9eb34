"""Forces of drivetrains, linear in their coefficients, and which drivetrains an arm has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay_records import TERMS, Drivetrain
from trocar.robot.identification.rigid_body import JointMotion
from trocar.robot.recordings.motor_side import MOTOR_SIDE, actuators_of_recording

Array = NDArray[np.float64]

#: Travel after which the stop elements of an arm's joints slip, of its first two joints, of slides,
#: and of an instrument's and a master's small joints [rad or m]. Source: identified on recordings
#: of a PSM (docs/dynamics.md); three elements for a coordinate suffice for the first two joints.
LARGE_STOPS = (0.005, 0.02, 0.1)
SLIDE_STOPS = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.03)
SMALL_STOPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
#: Travel after which the first stop element of an instrument's wrist slips, which is its Coulomb
#: friction. Source: our own choice; held-out errors are those with a Coulomb term, which costs the
#: simulation 2 % of a physics step for each coordinate; with 2 mrad the simulated wrist, whose
#: friction is renewed every 10 ms, swings on at 50 Hz. [rad]
FIRST_STOP = 0.005
#: Ratio of a drivetrain's dry friction below which a stop element is set to 0. Source: our own
#: choice; the solver leaves 1e-7.
IDLE = 1e-5
#: Speed below which a drivetrain rests and its Coulomb friction has no sign, which rounding would
#: choose in a filter's tail or where motions of joints cancel. Source: a step of the finest of a
#: dVRK's encoders, a PSM's insertion (descriptions/data/errors.toml), in a second. [rad/s, m/s]
RESTS = 1.30e-6
#: Terms of a cable's polynomial. Source: identified on a recording of an MTM.
CABLE_TERMS = 5


def weights(train: Drivetrain, arm: ArmDescription) -> Array:
    """Return the weights of the joints in a drivetrain's coordinate, (n,)."""
    return np.array([train.along.get(name, 0.0) for name in arm.mechanism.joint_names])


def basis(train: Drivetrain, weight: Array, motion: JointMotion) -> Array:
    """Return the force on a drivetrain's coordinate by each coefficient, (k, p).

    Args:
        train: its terms, in the order of `coefficients`
        weight: of the joints in its coordinate, (n,)
        motion: samples at even times from a start at which the stop elements are unloaded
    """
    c, cd, cdd = motion.q @ weight, motion.qd @ weight, motion.qdd @ weight
    columns: list[Array] = []
    for term in _terms(train):
        if term == "rotor":
            columns.append(cdd)
        elif term == "coulomb":
            columns.append(np.sign(cd) * (np.abs(cd) > RESTS))
        elif term == "viscous":
            columns.append(cd)
        elif term == "offset":
            columns.append(np.ones_like(c))
        elif term == "stiffness":
            columns.append(c)
        elif term == "harmonic":
            columns += [np.sin(c), np.cos(c)]
        elif term == "stops":
            travel = c if motion.unfiltered is None else motion.unfiltered @ weight
            columns += list(stop_elements(travel, train.stop_limits).T)
        else:
            lower, upper = train.cable_range
            x = np.clip(2.0 * (c - lower) / (upper - lower) - 1.0, -1.0, 1.0)
            columns += list(chebyshev.chebvander(x, len(train.terms["cable"]))[:, 1:].T)
    return np.stack(columns, axis=1) if columns else np.zeros((len(c), 0))


def stop_elements(c: Array, limits: tuple[float, ...]) -> Array:
    """Return the deflection of Maxwell-slip elements along positions c, (k, len(limits)).

    They start unloaded: z_i <- clip(z_i + dc, -limit_i, limit_i).
    """
    most = np.array(limits)
    found = np.zeros((len(c), len(most)))
    z = np.zeros(len(most))
    for k, step in enumerate(np.diff(c), 1):
        z = np.minimum(np.maximum(z + step, -most), most)
        found[k] = z
    return found


def coefficients(train: Drivetrain) -> Array:
    """Return the coefficients of a drivetrain in the order of its basis, (p,)."""
    return np.array([value for term in _terms(train) for value in train.terms[term]])


def labels(train: Drivetrain) -> list[tuple[str, int]]:
    """Return (term, number within the term) of each coefficient."""
    return [(term, k) for term in _terms(train) for k in range(len(train.terms[term]))]


def with_coefficients(train: Drivetrain, values: Array, sigma: Array) -> Drivetrain:
    """Return a drivetrain with other coefficients and their standard deviations, (p,) each.

    Stop elements without force are left out.
    """
    terms: dict[str, list[float]] = {}
    spread: dict[str, list[float]] = {}
    for (term, _), value, one in zip(labels(train), values, sigma, strict=True):
        terms.setdefault(term, []).append(float(value))
        spread.setdefault(term, []).append(float(one))
    forces = np.array(terms.get("stops", [])) * np.array(train.stop_limits)
    kept = [k for k, force in enumerate(forces) if force > IDLE * forces.sum()]
    for one in (terms, spread):
        if "stops" in one:
            one["stops"] = [one["stops"][k] for k in kept]
    return replace(
        train,
        terms={term: tuple(v) for term, v in terms.items()},
        sigma={term: tuple(v) for term, v in spread.items()},
        stop_limits=tuple(train.stop_limits[k] for k in kept),
    )


def train_efforts(
    trains: Mapping[str, Drivetrain], arm: ArmDescription, motion: JointMotion
) -> Array:
    """Return the joint efforts against all drivetrains, (k, n) [N m or N]."""
    total = np.zeros(motion.q.shape)
    for train in trains.values():
        weight = weights(train, arm)
        total += np.outer(basis(train, weight, motion) @ coefficients(train), weight)
    return total


def described_trains(arm: ArmDescription) -> dict[str, Drivetrain]:
    """Return the friction and rotors that a simulation of the description has.

    Hinges of loops are along their couplings, which are exact for parallelograms.
    """
    mechanism = arm.mechanism
    friction = arm.friction.get("identified", {})
    found: dict[str, Drivetrain] = {}
    for name, one in friction.items():
        along = {name: 1.0} if name in mechanism.joint_index else _along(arm, name)
        if along:
            terms = {"coulomb": (one.coulomb,), "viscous": (one.viscous,)}
            found[name] = Drivetrain(along, terms)
    for frame, rotor in arm.rotor.items():
        if along := _along(arm, frame):
            found[f"{frame} rotor"] = Drivetrain(along, {"rotor": (rotor,)})
    return found


def structure(arm: ArmDescription, positions: Sequence[Array] = ()) -> dict[str, Drivetrain]:
    """Return the drivetrains to identify, with coefficients of 0.

    A PSM: its first three joints, the roll, and of the instrument's wrist the motors, the pitch and
    both fingers with the jaw between them. An MTM: its joints, the crank of the elbow, the motor of
    the wrist platform, cables of the platform and the wrist's pitch, and the wrist's spring.
    Another arm: its joints. A cable's curve is constant outside of the range of the positions: logs
    say nothing of it there.
    Source: what explains the recordings (docs/dynamics.md).

    Args:
        arm: the arm
        positions: of all joints along the logs, (k, n) each [rad or m]; none: the limits
    """
    if (
        arm.type == "PSM"
        and arm.coupling is not None
        and set(MOTOR_SIDE["PSM"]) <= set(arm.coupling.joints)
    ):
        return _psm(arm)
    if arm.type == "MTM":
        ends = positions or (np.stack([arm.mechanism.lower, arm.mechanism.upper]),)
        return _mtm(
            arm,
            np.min([q.min(axis=0) for q in ends], axis=0),
            np.max([q.max(axis=0) for q in ends], axis=0),
        )
    joints = [j for j in arm.joints if j.spring is None]
    return {
        j.name: _train(
            {j.name: 1.0}, SLIDE_STOPS if j.kind == "prismatic" else LARGE_STOPS, rotor=True
        )
        for j in joints
    }


def _psm(arm: ArmDescription) -> dict[str, Drivetrain]:
    names = arm.mechanism.joint_names
    found = {
        names[0]: _train({names[0]: 1.0}, LARGE_STOPS),
        names[1]: _train({names[1]: 1.0}, LARGE_STOPS),
        names[2]: _train({names[2]: 1.0}, SLIDE_STOPS, rotor=True),
        "roll": _train({"roll": 1.0}, SMALL_STOPS, rotor=True, more=("stiffness",)),
    }
    which, coupling = actuators_of_recording(arm)
    for k, row in zip(which, np.linalg.inv(coupling.actuator_to_joint), strict=True):
        along = {names[j]: float(w) for j, w in zip(which, row, strict=True) if abs(w) > 1e-12}
        found[f"motor_{k + 1}"] = _wrist(along, motor=True)
    pairs = {
        "wrist_pitch": {"wrist_pitch": 1.0},
        "right_finger": {"wrist_yaw": 1.0, "jaw": -0.5},
        "left_finger": {"wrist_yaw": 1.0, "jaw": 0.5},
        "jaw": {"jaw": 1.0},
    }
    for name, along in pairs.items():
        found[name] = _wrist(along, motor=False)
    return found


def _mtm(arm: ArmDescription, lower: Array, upper: Array) -> dict[str, Drivetrain]:
    names = arm.mechanism.joint_names
    found = {
        name: _train({name: 1.0}, LARGE_STOPS if k < 3 else SMALL_STOPS, rotor=k >= 4)
        for k, name in enumerate(names[:7])
    }
    spring = found[names[4]].terms
    without = {term: value for term, value in spring.items() if term != "offset"}
    found[names[4]] = replace(found[names[4]], terms={**without, "harmonic": (0.0, 0.0)})
    for k in (3, 4):
        cable = {**found[names[k]].terms, "cable": (0.0,) * CABLE_TERMS}
        span = float(lower[k]), float(upper[k])
        found[names[k]] = replace(found[names[k]], terms=cable, cable_range=span)
    which, coupling = actuators_of_recording(arm)
    inverse = np.linalg.inv(coupling.actuator_to_joint)
    for k, name in ((1, "elbow_bar"), (2, "motor_4")):
        along = {
            names[j]: float(w) for j, w in zip(which, inverse[k], strict=True) if abs(w) > 1e-12
        }
        found[name] = _train(along, LARGE_STOPS if k == 1 else SMALL_STOPS, rotor=k == 2)
    return found


def _train(
    along: Mapping[str, float],
    limits: tuple[float, ...],
    *,
    rotor: bool = False,
    offset: bool = True,
    more: tuple[str, ...] = (),
) -> Drivetrain:
    terms = [*(["rotor"] if rotor else []), "coulomb", "viscous", *(["offset"] if offset else [])]
    empty = dict.fromkeys((*terms, *more), (0.0,))
    return Drivetrain(dict(along), {**empty, "stops": (0.0,) * len(limits)}, stop_limits=limits)


def _wrist(along: Mapping[str, float], *, motor: bool) -> Drivetrain:
    """Return a drivetrain whose dry friction is that of stop elements alone."""
    train = _train(along, (FIRST_STOP, *SMALL_STOPS), rotor=motor, offset=motor)
    return replace(train, terms={k: v for k, v in train.terms.items() if k != "coulomb"})


def _along(arm: ArmDescription, frame: str) -> dict[str, float]:
    """Return a frame's couplings."""
    if frame not in arm.mechanism.frame_index:
        return {}
    return dict(arm.mechanism.frame(frame).couplings)


def _terms(train: Drivetrain) -> list[str]:
    return [term for term in TERMS if term in train.terms]

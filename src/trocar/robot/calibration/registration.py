"""Relative poses of the bases of arms, and the offsets of their joints, from readings.

Of each arm by itself, with A(q) the pose of its tip in its base:

    touches   T_block_base A(q + offsets) tip = point
    boards    T_camera_base A(q + offsets) T_tip_board = T_camera_board

are solved by least squares for the pose of its base, the offsets, and the tip or the board's pose
on it. An offset of the first joint is the same as a turn of the base about its axis, and counts for
that. The others are known beforehand to a few degrees, which counts as one reading of each: what
the readings leave open stays near 0 with that standard deviation, and widens those of the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.fitting.adjust import Adjustable, Block, Values, adjust, layout
from trocar.geometry import inverse, nearest_rotation, pose_residuals, skew, transform
from trocar.geometry.rotations import rpy_from_matrix
from trocar.geometry.se3 import translation
from trocar.kinematics.forward import pose
from trocar.robot.calibration.axes import Value
from trocar.robot.calibration.touches import TouchReadings

Array = NDArray[np.float64]

#: Offsets are known beforehand to be 0 within this, one standard deviation. Source: our own choice;
#: a joint that is read wrong by more is seen by eye. [rad], [m]
OFFSET_RAD, OFFSET_M = 0.035, 0.005
#: An offset whose standard deviation is still this part of that one is called undetermined.
#: Source: our own choice.
OPEN_PART = 0.5
#: A base that is known no better is not determined. Source: our own choice. [m]
OPEN_BASE_M = 0.01
#: A reading this many times as far off as the median is worth a warning. Source: our own choice; of
#: normal noise in three coordinates one of a million is beyond 3.5 medians.
FAR = 4.0
#: Residuals beyond this are no noise of a pointer. Source: our own choice. [m]
WRONG_M = 0.01
#: Readings agree no better than a dVRK's encoders resolve: a step of a PSM's insertion, and of its
#: yaw and pitch. Without this floor, rounding of exact readings decides which offsets are
#: undetermined. Source: the steps in descriptions/data/errors.toml. [m], [rad]
RESOLVED_M, RESOLVED_RAD = 1.30e-6, 7.72e-6
#: Rounds in which readings are weighted by what is left of them.
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Base:
    """One arm's base, as its readings have it.

    Attributes:
        arm: name of its description
        frame: the frame that is called base: that of the arm's `local/measured_cp`
        pose: T_reference_base, (4, 4)
        covariance: of small shifts and turns in the base's axes, (6, 6) [m, rad]
        offsets: {joint: to be added to its reading [rad or m]}, of all but the first
        undetermined: joints of whose offsets the readings say little
        tip: in the arm's tip frame: of touches where it points, of boards where they sit, (3,) [m]
        tip_sigma: (3,) [m]; 0 where it was given
        position_rms, rotation_rms: what is left of a reading, per axis [m], [rad]; 0 rotation of
            touches
        readings: how many
        warnings: for the user
    """

    arm: str
    frame: str
    pose: Array
    covariance: Array
    offsets: Mapping[str, Value]
    undetermined: tuple[str, ...]
    tip: Array
    tip_sigma: Array
    position_rms: float
    rotation_rms: float
    readings: int
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, in SI units."""
        axes = self.pose[:3, :3]
        turned = np.kron(np.eye(2), axes)
        return {
            "description": self.arm,
            "frame": self.frame,
            **_placed(self.pose, turned @ self.covariance @ turned.T),
            "offsets": {joint: value.as_dict() for joint, value in self.offsets.items()},
            "undetermined": list(self.undetermined),
            "tip_m": {"value": self.tip.tolist(), "sigma": self.tip_sigma.tolist()},
            "residuals": {
                "position_rms_m": self.position_rms,
                "rotation_rms_rad": self.rotation_rms,
                "readings": self.readings,
            },
        }


def register(
    readings: Mapping[str, TouchReadings], watch: Callable[[str], None] = lambda _: None
) -> dict[str, Base]:
    """Find the base of each arm, and its joint offsets, {name of the arm: base}.

    Args:
        readings: {name of the arm: readings}
        watch: called with the name of each arm

    Raises:
        InputError: readings that do not determine a base, or that miss by centimetres
    """
    found: dict[str, Base] = {}
    for name, mine in readings.items():
        watch(f"base of {name}")
        found[name] = _base(name, mine)
    return found


def between(one: Base, other: Base) -> tuple[Array, Array]:
    """Return the pose of another arm's base in one's, T_one_other (4, 4), and its covariance.

    Returns:
        the pose; and the covariance of small shifts and turns in the axes of the first base,
        (6, 6) [m, rad]
    """
    T = inverse(one.pose) @ other.pose
    # shift = R v_other - v_one - w_one x p, turn = R w_other - w_one
    of_other = np.kron(np.eye(2), T[:3, :3])
    of_one = -np.eye(6)
    of_one[:3, 3:] = skew(T[:3, 3])
    return T, of_other @ other.covariance @ of_other.T + of_one @ one.covariance @ of_one.T


def registration_dict(found: Mapping[str, Base], reference: str) -> dict[str, Any]:
    """Return arms and the poses between their bases as one document, in SI units.

    Args:
        found: as of `register`
        reference: "block" or "camera"
    """
    first, *others = found
    pairs = {f"{first}_{name}": between(found[first], found[name]) for name in others}
    return {
        "reference": reference,
        "arms": {name: base.as_dict() for name, base in found.items()},
        "bases": {f"T_{name}": _placed(*pair) for name, pair in pairs.items()},
        "warnings": [f"{name}: {text}" for name, base in found.items() for text in base.warnings],
    }


def _placed(T: Array, covariance: Array) -> dict[str, Any]:
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return {
        "xyz_m": T[:3, 3].tolist(),
        "xyz_sigma_m": sigma[:3].tolist(),
        "rpy_rad": rpy_from_matrix(T[:3, :3]).tolist(),
        "turn_sigma_rad": sigma[3:].tolist(),
    }


@dataclass(frozen=True, eq=False)
class _ReadingsModel:
    """Readings of one arm, of these unknowns.

    base     T_reference_base
    tip      of touches, unless it is given: in the arm's tip frame, (3,) [m]
    board    of boards: T_tip_board
    offsets  of all joints but the first, (n_offsets,) [rad or m]
    """

    readings: TouchReadings

    @property
    def problem(self) -> Adjustable:
        """The least-squares problem.

        A millimetre, and 10 mrad over a board of 0.1 m, until the readings show their noise.
        """
        arm, noise = self.readings.arm, {"position": 1e-3}
        if self.readings.boards is not None:
            noise["rotation"] = 1e-2
        kinds = np.array([joint.kind for joint in arm.joints[1 : arm.own_joints]])
        return Adjustable(
            blocks=self.blocks,
            noise=noise,
            least={"position": RESOLVED_M, "rotation": RESOLVED_RAD},
            priors={"offsets": np.where(kinds == "prismatic", OFFSET_M, OFFSET_RAD)},
        )

    def tip(self, values: Values) -> Array:
        """Return the pose of the touching tip or the board in the arm's tip frame, (4, 4)."""
        if "board" in values:
            return values["board"]
        point = self.readings.tip if self.readings.tip is not None else values["tip"]
        return translation(point)

    def blocks(self, values: Values) -> dict[str, Block]:
        """Return measured less expected positions [m], and rotations of boards [rad]."""
        mine = self.readings
        q = mine.q.copy()
        q[:, 1 : mine.arm.own_joints] += values["offsets"]
        expected = values["base"] @ pose(mine.arm.mechanism, q) @ self.tip(values)
        if mine.boards is None:
            return {"position": Block((cast(Array, mine.points) - expected[:, :3, 3]).ravel())}
        left = pose_residuals(mine.boards, expected)
        return {
            "position": Block(left[:, :3].ravel()),
            "rotation": Block(left[:, 3:].ravel()),
        }


def _base(name: str, mine: TouchReadings) -> Base:
    arm, model = mine.arm, _ReadingsModel(mine)
    start = _start(name, mine)
    size = 3 if mine.boards is None else 6
    unknowns, readings = layout(start)["offsets"].stop, size * len(mine.q)
    if readings <= unknowns:
        raise InputError(
            f"{name}: got {len(mine.q)} readings for {unknowns} unknowns; required: at least"
            f" {unknowns // size + 1}, better three times as many"
        )
    found = adjust(model.problem, start, ROUNDS)
    values = found.values
    offsets = {
        joint.name: Value(float(value), float(own))
        for joint, value, own in zip(
            arm.joints[1 : arm.own_joints], values["offsets"], found.sigma("offsets"), strict=True
        )
    }
    sigma, names = found.sigma("base"), list(offsets)
    shape = next((n for n in ("tip", "board") if n in values), None)
    left = {block: part.reshape(-1, 3) for block, part in found.residuals.items()}
    away = np.linalg.norm(left["position"], axis=1)
    if np.median(away) > WRONG_M:
        raise InputError(
            f"{name}: half of the readings miss by more than {1e3 * np.median(away):.1f} mm;"
            f" allowed: {1e3 * WRONG_M:g} mm. Points may be named wrongly, or joint positions be in"
            " other units"
        )
    if sigma[:3].max() > OPEN_BASE_M:
        raise InputError(
            f"{name}: the readings do not determine its base ({1e3 * sigma[:3].max():.0f} mm);"
            " required: points that do not lie on a line, from postures that differ"
        )
    warnings = [
        f"line {mine.lines[i]} misses by {1e3 * away[i]:.2f} mm, the median is"
        f" {1e3 * np.median(away):.2f} mm"
        + (f": is the point {mine.names[i]}?" if mine.names else "")
        for i in np.flatnonzero(away > FAR * max(float(np.median(away)), RESOLVED_M))
    ]
    free = 1.0 - (unknowns - len(offsets)) / readings
    rms = {block: float(np.sqrt(np.mean(part**2) / free)) for block, part in left.items()}
    return Base(
        arm=arm.name,
        frame=arm.mechanism.reference,
        pose=values["base"],
        covariance=found.covariance_of("base"),
        offsets=offsets,
        undetermined=tuple(names[i] for i in found.undetermined("offsets", OPEN_PART)),
        tip=model.tip(values)[:3, 3],
        tip_sigma=np.zeros(3) if shape is None else found.sigma(shape)[:3],
        position_rms=rms["position"],
        rotation_rms=rms.get("rotation", 0.0),
        readings=len(mine.q),
        warnings=tuple(warnings),
    )


def _start(name: str, mine: TouchReadings) -> dict[str, Array]:
    """Return a first guess of base and tip, without offsets."""
    at, offsets = pose(mine.arm.mechanism, mine.q), np.zeros(mine.arm.own_joints - 1)
    if mine.boards is not None:
        base, board = hand_eye(at, mine.boards)
        return {"base": base, "board": board, "offsets": offsets}
    points = cast(Array, mine.points)
    distinct = np.unique(points, axis=0)
    spread = np.linalg.svd(distinct - distinct.mean(axis=0))[1]
    if len(distinct) < 3 or spread[1] < 1e-3:
        raise InputError(
            f"{name}: touched {len(distinct)} points that lie on a line or coincide; required: at"
            " least three that do not"
        )
    tip = np.zeros(3) if mine.tip is None else mine.tip
    base = _onto((at @ translation(tip))[:, :3, 3], points)
    return {"base": base, **({} if mine.tip is not None else {"tip": tip}), "offsets": offsets}


def _onto(points: Array, others: Array) -> Array:
    """Return the pose that brings points nearest to others, (n, 3) each; Kabsch's method."""
    a, b = points.mean(axis=0), others.mean(axis=0)
    turn = nearest_rotation((others - b).T @ (points - a))
    return transform(turn, b - turn @ a)


def hand_eye(tips: Array, boards: Array) -> tuple[Array, Array]:
    """Return T_camera_base and T_tip_board of Y A_k X = B_k, without weights.

    Source: Li, Wang, Wu, "Simultaneous robot-world and hand-eye calibration using dual-quaternions
    and Kronecker product", 2010: rotations as the null vector of R_B (x) I - I (x) R_A^T.
    """
    A, B = tips[:, :3, :3], boards[:, :3, :3]
    # R_Y R_A = R_B R_X^T: with row-major vec, (I (x) R_A^T) vec R_Y = (R_B (x) I) vec R_X^T
    eye = np.eye(3)
    blocks: list[list[Array]] = [
        [np.kron(eye, a.T), -np.kron(b, eye)] for a, b in zip(A, B, strict=True)
    ]
    null = np.linalg.svd(np.concatenate([np.hstack(row) for row in blocks]))[2][-1]
    turns = [nearest_rotation(part.reshape(3, 3)) for part in (null[:9], null[9:])]
    if np.linalg.det(null[:9].reshape(3, 3)) < 0.0:
        turns = [nearest_rotation(-part.reshape(3, 3)) for part in (null[:9], null[9:])]
    Y, X = turns[0], turns[1].T
    # R_Y (R_A t_X + t_A) + t_Y = t_B
    left = np.concatenate([Y @ A, np.broadcast_to(eye, A.shape)], axis=2).reshape(-1, 6)
    right = (boards[:, :3, 3] - tips[:, :3, 3] @ Y.T).ravel()
    shifts = np.linalg.lstsq(left, right, rcond=None)[0]
    return transform(Y, shifts[3:]), transform(X, shifts[:3])

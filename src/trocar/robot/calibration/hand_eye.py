"""An endoscope's eyes, its place on the scope, and bases of arms, from views of boards on tools.

A board on the tool of a PSM is seen by both eyes of an ECM's camera. With A(q) the pose of an arm's
tip in its base, corners b of the board lie in the left eye at

    p = T_ecm_left^-1 A_ecm(q_ecm)^-1 T_base_psm A_psm(q_psm) T_tip_board b,

and in the right one at T_left_right^-1 p. One bundle adjustment finds lenses, T_left_right,
T_ecm_left, and T_base_psm and T_tip_board of each PSM. The joint positions of each view are
unknowns as well, measured with noise, so that this noise is part of the covariance. Constant
offsets of joint readings may be unknowns too; those that equal a shift of one of the poses count
for that pose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2  # pyright: ignore[reportMissingTypeStubs] - scipy has no types

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.cameras.lens import distort, distortion_jacobian
from trocar.descriptions.overlay_records import CameraPatch, FramePatch, Overlay
from trocar.errors import InputError
from trocar.fitting.adjust import (
    Adjustable,
    Adjustment,
    Block,
    Values,
    adjust,
    inverted,
    layout,
    slopes,
)
from trocar.geometry import inverse, nearest_rotation, skew, transform
from trocar.geometry.rotations import rotation_x, rotation_z, rpy_from_matrix
from trocar.geometry.se3 import exp_twist, log_transform
from trocar.kinematics import jacobian_body, pose
from trocar.robot.calibration.axes import Value
from trocar.robot.calibration.camera_views import BoardViews
from trocar.robot.calibration.registration import OFFSET_M, OFFSET_RAD, OPEN_PART, hand_eye

Array = NDArray[np.float64]

#: Fewest views. Source: our own choice; each pose needs three that differ, lenses some more.
FEWEST_VIEWS = 6
#: Noise of joints that slide, beside that of joints that turn. Source: our own choice: 35 um beside
#: 0.02 deg, as of the goals of the figures. [m/rad]
SLIDE_PER_TURN = 0.1
#: Unknowns of an eye: fx, fy, cx, cy, k1, k2, p1, p2.
EYE = 8
#: Beforehand, distortion coefficients are 0 within this: what the corners leave open stays small.
#: Source: our own choice; calibrations of endoscopes have |k1| and |k2| below 1.
DISTORTION_SIGMA = np.array([1.0, 1.0, 0.1, 0.1])
#: A pose that is known no better is not determined. Source: our own choice. [m], [rad]
OPEN_M, OPEN_RAD = 0.005, 0.05
#: Corners this far off, half of them, are wrongly named or of another board. Source: our own choice
#: [px].
WRONG_PX = 5.0
#: Views this many times as far off as the median are worth a warning. Source: as of registrations.
FAR = 4.0
#: Readings off by this many times their noise are not noise. Source: our own choice; of 200
#: independent readings the ratio stays below 1.2 in 99 of 100 cases.
DISAGREE = 1.4
#: Offsets are named where noise alone would look like them in one of so many calibrations, and each
#: that is so many standard deviations from 0. Source: our own choice.
FALSE_ALARM, NAMED_SIGMAS = 1e-3, 3.0
#: Corners are not found better than this. Source: our own choice; detectors reach 0.06 px.
BEST_PX = 0.01
#: Rounds in which the corners' noise is taken from what is left of them.
ROUNDS = 3
#: A column of which less is left beside the others is one of their combinations. Source: rounding.
DEPENDENT = 1e-6


@dataclass(frozen=True, eq=False)
class Placed:
    """A pose with its covariance.

    Attributes:
        pose: T_ab, (4, 4)
        covariance: of small shifts and turns in b's axes, (6, 6) [m, rad]
    """

    pose: Array
    covariance: Array

    @property
    def sigma(self) -> tuple[Array, Array]:
        """Standard deviations: of the position in a's axes, of turns about b's, (3,) [m], [rad]."""
        R = self.pose[:3, :3]
        shift = np.diag(R @ self.covariance[:3, :3] @ R.T)
        return np.sqrt(shift), np.sqrt(np.diag(self.covariance)[3:])

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, in SI units."""
        shift, turn = self.sigma
        return {
            "xyz_m": self.pose[:3, 3].tolist(),
            "xyz_sigma_m": shift.tolist(),
            "rpy_rad": rpy_from_matrix(self.pose[:3, :3]).tolist(),
            "rpy_sigma_rad": turn.tolist(),
            "covariance": self.covariance.tolist(),
        }

    def patch(self) -> FramePatch:
        """Return the patch of an overlay."""
        return FramePatch(self.pose[:3, 3], rpy_from_matrix(self.pose[:3, :3]), *self.sigma)


@dataclass(frozen=True, eq=False)
class HandEye:
    """Calibration of cameras and arms from views of boards.

    Attributes:
        ecm: name of the arm with the camera
        description: its description's name
        calibration: both eyes
        eye_sigma: standard deviations of fx, fy, cx, cy [px], k1, k2, p1, p2, (2, 8)
        stereo: T_left_right
        left: T_ecm_left, the left eye in the ECM's tip frame
        camera: T_ecm_camera, the middle of both eyes, which looks midway between them
        bases: {PSM: T_ecm-base_psm-base}, in the frames of the arms' `local/measured_cp`
        boards: {PSM: T_tip_board}
        offsets: {arm: {joint: to be added to its reading [rad or m]}}, where requested
        absorbed: {arm: joints whose offset equals a shift of one of the poses, and counts for it}
        corner_rms: residual of a corner per axis [px]
        joint_ratio: deviations of readings by what their noise allows, RMS; about 1
        corners, views: how many; views of both eyes
        view_rms: of each view [px]
        warnings: for the user
    """

    ecm: str
    description: str
    calibration: StereoCalibration
    eye_sigma: Array
    stereo: Placed
    left: Placed
    camera: Placed
    bases: Mapping[str, Placed]
    boards: Mapping[str, Placed]
    offsets: Mapping[str, Mapping[str, Value]]
    absorbed: Mapping[str, tuple[str, ...]]
    corner_rms: float
    joint_ratio: float
    corners: int
    view_rms: Mapping[str, float]
    warnings: tuple[str, ...]

    @property
    def overlay(self) -> Overlay:
        """The overlay of the ECM: its camera, and where the bases of PSMs stand."""
        return Overlay(
            arm=self.description,
            camera=CameraPatch(self.camera.patch(), self.calibration),
            bases={name: one.patch() for name, one in self.bases.items()},
            source={"measured": self.calibration.source},
            warnings=self.warnings,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, in SI units."""
        eyes = {
            side: {
                "size_px": list(eye.size),
                "focal_px": [eye.K[0, 0], eye.K[1, 1]],
                "focal_sigma_px": sigma[:2],
                "principal_px": eye.K[:2, 2],
                "principal_sigma_px": sigma[2:4],
                "distortion": eye.distortion[:4],
                "distortion_sigma": sigma[4:],
            }
            for side, eye, sigma in zip(
                ("left", "right"), self.calibration.eyes, self.eye_sigma, strict=True
            )
        }
        return {
            "ecm": self.ecm,
            "eyes": eyes,
            "T_left_right": self.stereo.as_dict(),
            f"T_{self.ecm}_left": self.left.as_dict(),
            f"T_{self.ecm}_camera": self.camera.as_dict(),
            "bases": {f"T_{self.ecm}_{name}": one.as_dict() for name, one in self.bases.items()},
            "boards": {f"T_{name}_board": one.as_dict() for name, one in self.boards.items()},
            "offsets": {
                arm: {joint: value.as_dict() for joint, value in row.items()}
                for arm, row in self.offsets.items()
            },
            "offsets_in_poses": {arm: list(names) for arm, names in self.absorbed.items()},
            "residuals": {
                "corner_rms_px": self.corner_rms,
                "joint_ratio": self.joint_ratio,
                "corners": self.corners,
                "view_rms_px": dict(self.view_rms),
            },
            "warnings": list(self.warnings),
        }


def calibrate_camera(
    views: BoardViews,
    joint_noise: float,
    offsets: bool = False,
    watch: Callable[[str], None] = lambda _: None,
) -> HandEye:
    """Find eyes, their place on the scope, and the bases of the arms that hold boards.

    Args:
        views: corners and joint readings
        joint_noise: standard deviation of readings of joints that turn [rad]; of joints that slide,
            SLIDE_PER_TURN of it
        offsets: find constant offsets of joint readings as well
        watch: called with the name of each round of the adjustment

    Raises:
        InputError: too few views, views that do not determine the poses, eyes exchanged, corners of
            another board
    """
    if not 0.0 < joint_noise < 0.1:
        raise InputError(
            f"joint noise: got {np.degrees(joint_noise):g} deg; allowed: above 0 to below 5.7 deg"
        )
    shown = np.asarray(np.isfinite(views.pixels).any(axis=(1, 2, 3)), dtype=np.bool_)
    blank = [name for name, some in zip(views.names, shown, strict=True) if not some]
    views = views.chosen(np.flatnonzero(shown).tolist())
    if len(views.names) < FEWEST_VIEWS:
        raise InputError(
            f"{views.file}: got {len(views.names)} views of a board; allowed: at least"
            f" {FEWEST_VIEWS}, better 20"
        )
    watch("start values")
    fit = _adjusted(*_start(views, joint_noise), 1.0, watch)
    warnings = [f"no corners were found in the views {', '.join(blank)}"] if blank else []
    if offsets:
        problem, model, values = fit.with_offsets()
        fit = _adjusted(model, values, problem.noise["corners"], watch)
    else:
        watch("constant offsets of joint readings")
    named = [] if offsets else _named_offsets(fit)
    if named:
        warnings.append(
            f"constant offsets of joint readings would explain what is left: {', '.join(named)};"
            " without them the standard deviations are too small (see --offsets)"
        )
    elif fit.joint_ratio > DISAGREE:
        warnings.append(
            f"joint readings are off by {fit.joint_ratio:.1f} times their noise of"
            f" {np.degrees(joint_noise):g} deg, so the standard deviations are too small; is the"
            " noise larger (--joint-noise-deg), or an arm not calibrated?"
        )
    return _result(fit, tuple(warnings))


@dataclass(frozen=True, eq=False)
class _BoardModel:
    """Corners in both eyes, of these unknowns.

        left, stereo     T_ecm_left, T_left_right
        eyes             fx, fy, cx, cy, k1, k2, p1, p2 of both, (16,)
        base P, board P  of each PSM
        offsets          of joint readings (n_offsets,)
        shifts           of each view's readings: those of the ECM's joints, then of its PSM's

    Attributes:
        views: corners and readings
        noise: of the readings, (n_views, k) [rad or m]
        offsets: unknown offsets, (arm, joint index)
    """

    views: BoardViews
    noise: Array
    offsets: tuple[tuple[str, int], ...] = ()

    def problem(self, pixel: float) -> Adjustable:
        """Return the least-squares problem, the corners' noise to begin with (per axis) [px]."""
        kinds = [self.views.arms[arm].joints[joint].kind for arm, joint in self.offsets]
        return Adjustable(
            blocks=self.blocks,
            noise={"corners": pixel},
            least={"corners": BEST_PX},
            priors={
                "shifts": self.noise.ravel(),
                "offsets": np.where(np.array(kinds) == "prismatic", OFFSET_M, OFFSET_RAD),
                "eyes": np.tile(np.append(np.full(4, np.inf), DISTORTION_SIGMA), 2),
            },
        )

    def blocks(self, values: Values) -> dict[str, Block]:
        """Return the corners' residuals [px], of view after view."""
        views, at = self.views, layout(values)
        left, slopes = self.corners(values)
        seen = np.isfinite(views.pixels)
        J = np.zeros((int(seen.sum()), at["shifts"].stop))
        begins = np.concatenate([[0], np.cumsum(seen.reshape(len(seen), -1).sum(axis=1))])
        own, k = views.arms[views.ecm].own_joints, self.noise.shape[1]
        for i, psm in enumerate(views.holders):
            name, rows = views.psms[psm], slice(begins[i], begins[i + 1])
            D = slopes[i][seen[i]]  # (rows, 12 + 16 + 12 + k)
            eyes, by_joint = at["eyes"].stop, D[:, -k:]
            J[rows, :eyes] = D[:, :eyes]
            J[rows, at[f"base {name}"]] = D[:, eyes : eyes + 6]
            J[rows, at[f"board {name}"]] = D[:, eyes + 6 : eyes + 12]
            first = at["shifts"].start + k * i
            J[rows, first : first + k] = by_joint
            for column, (arm, joint) in enumerate(self.offsets, at["offsets"].start):
                if arm == views.ecm:
                    J[rows, column] = by_joint[:, joint]
                elif arm == name:
                    J[rows, column] = by_joint[:, own + joint]
        return {"corners": Block(left[seen], J)}

    def positions(self, values: Values) -> tuple[Array, list[Array]]:
        """Return joint positions of the ECM (n_views, n) and of each view's PSM."""
        views = self.views
        known = {name: np.zeros(len(arm.joints)) for name, arm in views.arms.items()}
        for (name, joint), value in zip(self.offsets, values["offsets"], strict=True):
            known[name][joint] = value
        shifts = values["shifts"].reshape(self.noise.shape)
        own = views.arms[views.ecm].own_joints
        ecm = views.q[views.ecm] + known[views.ecm]
        ecm[:, :own] += shifts[:, :own]
        tools: list[Array] = []
        for i, psm in enumerate(views.holders):
            name = views.psms[psm]
            q = views.q[name][i] + known[name]
            q[: views.arms[name].own_joints] += shifts[i, own:][: views.arms[name].own_joints]
            tools.append(q)
        return ecm, tools

    def corners(self, values: Values) -> tuple[Array, Array]:
        """Return expected less seen pixels (n, 2, corners, 2) [px], and their derivatives.

        Returns:
            those by T_ecm_left, T_left_right, both eyes, base, board and joints, (n, 2, corners, 2,
            12 + 16 + 12 + k)
        """
        views = self.views
        n, corners = len(views.names), len(views.points)
        ecm_q, tool_q = self.positions(values)
        ecm = views.arms[views.ecm]
        A_e = pose(ecm.mechanism, ecm_q)
        J_e = jacobian_body(ecm.mechanism, ecm_q)[:, :, : ecm.own_joints]
        A_p, J_p = np.zeros((n, 4, 4)), np.zeros((n, 6, self.noise.shape[1] - ecm.own_joints))
        for psm, name in enumerate(views.psms):
            mine = [i for i, holder in enumerate(views.holders) if holder == psm]
            arm = views.arms[name]
            q = np.array([tool_q[i] for i in mine])
            A_p[mine] = pose(arm.mechanism, q)
            J_p[mine, :, : arm.own_joints] = jacobian_body(arm.mechanism, q)[:, :, : arm.own_joints]
        base, board = (
            np.array([values[f"{what} {views.psms[psm]}"] for psm in views.holders])
            for what in ("base", "board")
        )
        left, stereo, eyes = values["left"], values["stereo"], values["eyes"].reshape(2, EYE)
        in_tip = _apply(board, views.points)
        in_base = _apply(A_p, in_tip)
        in_ecm = _apply(inverse(A_e) @ base, in_base)
        in_left = _apply(np.broadcast_to(inverse(left), A_e.shape), in_ecm)
        R_left_ecm = np.broadcast_to(left[:3, :3].T, (n, 3, 3))
        R_left_base = R_left_ecm @ np.swapaxes(A_e[:, :3, :3], 1, 2) @ base[:, :3, :3]
        R_left_tip = R_left_base @ A_p[:, :3, :3]
        by = np.concatenate(
            [
                -_lever(np.eye(3), in_left),
                _lever(R_left_base, in_base),
                _lever(R_left_tip @ board[:, :3, :3], np.broadcast_to(views.points, in_tip.shape)),
                -_lever(R_left_ecm, in_ecm) @ J_e[:, None],
                _lever(R_left_tip, in_tip) @ J_p[:, None],
            ],
            axis=-1,
        )  # (n, corners, 3, 6 + 6 + 6 + k)
        in_right = _apply(np.broadcast_to(inverse(stereo), A_e.shape), in_left)
        expected, slopes = (
            np.zeros((n, 2, corners, 2)),
            np.zeros((n, 2, corners, 2, 12 + 2 * EYE + 12 + self.noise.shape[1])),
        )
        for eye, points in enumerate((in_left, in_right)):
            pixels, by_point, by_eye = _seen(points, eyes[eye])
            expected[:, eye] = pixels
            moves = by if eye == 0 else stereo[:3, :3].T @ by
            along = by_point @ moves
            slopes[:, eye, ..., :6] = along[..., :6]
            if eye:
                slopes[:, eye, ..., 6:12] = by_point @ -_lever(np.eye(3), points)
            slopes[:, eye, ..., 12 + EYE * eye : 12 + EYE * (eye + 1)] = by_eye
            slopes[:, eye, ..., 12 + 2 * EYE :] = along[..., 6:]
        return expected - views.pixels, slopes


def _apply(T: Array, points: Array) -> Array:
    """Return points (corners, 3) or (n, corners, 3) moved by poses (n, 4, 4)."""
    return points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]


def _lever(R: Array, points: Array) -> Array:
    """Return d / d twist of points of a body that moves, R [1, -[p]], (n, corners, 3, 6)."""
    lever = np.concatenate([np.broadcast_to(np.eye(3), (*points.shape, 3)), -skew(points)], axis=-1)
    return (R if R.ndim == 2 else R[:, None]) @ lever


def _seen(points: Array, eye: Array) -> tuple[Array, Array, Array]:
    """Return pixels (..., 2), and derivatives by the points (..., 2, 3) and by the eye (..., 2, 8).

    Points behind the eye are mirrored before it: a step may pass there.
    """
    z = np.where(np.abs(points[..., 2]) < 1e-6, 1e-6, np.abs(points[..., 2]))
    x, y = points[..., 0] / z, points[..., 1] / z
    flat = np.stack([x, y], axis=-1)
    bent = distort(flat, eye[4:])
    focal = eye[:2]
    by_flat = focal[:, None] * distortion_jacobian(flat, eye[4:])
    zero, one = np.zeros_like(x), np.ones_like(x)
    flatten = (
        np.stack([np.stack([one, zero, -x], axis=-1), np.stack([zero, one, -y], axis=-1)], axis=-2)
        / z[..., None, None]
    )
    r2 = x * x + y * y
    f, g = focal
    by_eye = np.stack(
        [
            np.stack([bent[..., 0], zero, one, zero, f * x * r2, f * x * r2**2,
                      2.0 * f * x * y, f * (r2 + 2.0 * x * x)], axis=-1),
            np.stack([zero, bent[..., 1], zero, one, g * y * r2, g * y * r2**2,
                      g * (r2 + 2.0 * y * y), 2.0 * g * x * y], axis=-1),
        ],
        axis=-2,
    )  # fmt: skip
    return bent * focal + eye[2:4], by_flat @ flatten, by_eye


@dataclass(frozen=True, eq=False)
class _Fit:
    model: _BoardModel
    found: Adjustment

    @property
    def values(self) -> Values:
        """The unknowns."""
        return self.found.values

    @property
    def joint_ratio(self) -> float:
        """Deviations of readings by what their noise allows, RMS."""
        return self.found.ratio("shifts")

    @property
    def offset_values(self) -> dict[str, dict[str, Value]]:
        """Offsets with their standard deviations."""
        found: dict[str, dict[str, Value]] = {}
        sigmas = self.found.sigma("offsets")
        for (arm, joint), value, sigma in zip(
            self.model.offsets, self.values["offsets"], sigmas, strict=True
        ):
            name = self.model.views.arms[arm].joints[joint].name
            found.setdefault(arm, {})[name] = Value(float(value), float(sigma))
        return found

    def with_offsets(self) -> tuple[Adjustable, _BoardModel, Values]:
        """Return the problem, the model and the unknowns with the offsets that may be found."""
        free = _free_offsets(self.model, self.values)
        model = replace(self.model, offsets=free)
        problem = model.problem(self.found.problem.noise["corners"])
        return problem, model, {**self.values, "offsets": np.zeros(len(free))}


def _adjusted(
    model: _BoardModel, values: Values, pixel: float, watch: Callable[[str], None]
) -> _Fit:
    """Adjust all unknowns, and the corners' noise by what is left."""

    def round_(number: int) -> None:
        watch(f"round {number} of {ROUNDS}")

    return _Fit(model, adjust(model.problem(pixel), values, ROUNDS, round_))


def _candidates(views: BoardViews) -> list[tuple[str, int]]:
    names = (views.ecm, *views.psms)
    return [(name, joint) for name in names for joint in range(views.arms[name].own_joints)]


def _free_offsets(model: _BoardModel, values: Values) -> tuple[tuple[str, int], ...]:
    """Return the offsets that no shift of a pose equals."""
    every = _candidates(model.views)
    values = {**values, "offsets": np.zeros(len(every))}
    J = replace(model, offsets=tuple(every)).blocks(values)["corners"].derivative
    if J is None:
        raise ValueError("corners: got no derivative; needed: an analytic one")
    end = layout(values)["offsets"].start
    basis, _ = np.linalg.qr(J[:, :end] / np.linalg.norm(J[:, :end], axis=0))
    free: list[tuple[str, int]] = []
    for i, one in enumerate(every):
        column = J[:, end + i] / np.linalg.norm(J[:, end + i])
        beside = column - basis @ (basis.T @ column)
        beside -= basis @ (basis.T @ beside)
        size = float(np.linalg.norm(beside))
        if size > DEPENDENT:
            free.append(one)
            basis = np.concatenate([basis, beside[:, None] / size], axis=1)
    return tuple(free)


def _named_offsets(fit: _Fit) -> list[str]:
    """Return the offsets that a step from here would find, if together they are no accident."""
    noise = max(fit.joint_ratio, 1.0)
    problem, model, values = fit.with_offsets()
    left, J = problem.linear(values)
    slope, covariance = J.T @ left, inverted(J.T @ J)
    step = -covariance @ slope
    usual = chi2.isf(FALSE_ALARM, len(model.offsets))  # pyright: ignore[reportUnknownMemberType]
    if -slope @ step < noise**2 * usual:
        return []
    named: list[str] = []
    for i, (arm, joint) in enumerate(model.offsets, layout(values)["offsets"].start):
        value, sigma = float(step[i]), float(np.sqrt(covariance[i, i]))
        if abs(value) > NAMED_SIGMAS * noise * sigma:
            one = model.views.arms[arm].joints[joint]
            unit = "mm" if one.kind == "prismatic" else "mrad"
            named.append(f"{arm} {one.name} {1e3 * value:+.2f} +- {1e3 * sigma:.2f} {unit}")
    return named or ["of several joints"]


def _result(fit: _Fit, warnings: tuple[str, ...]) -> HandEye:
    values, views, found = fit.values, fit.model.views, fit.found

    def placed(name: str) -> Placed:
        return Placed(values[name], found.covariance_of(name))

    left, stereo = placed("left"), placed("stereo")
    bases = {name: placed(f"base {name}") for name in views.psms}
    boards = {name: placed(f"board {name}") for name in views.psms}
    residuals = fit.model.corners(values)[0]
    sizes = np.sqrt(np.nanmean(residuals**2, axis=(1, 2, 3)))
    if np.nanmedian(np.abs(residuals)) > WRONG_PX:
        raise InputError(
            f"{views.file}: half of the corners miss by more than"
            f" {np.nanmedian(np.abs(residuals)):.0f} px; allowed: {WRONG_PX:g}. Are they of another"
            " board, or joint positions in other units?"
        )
    for what, one in ((f"T_{views.ecm}_left", left), *((f"T_{views.ecm}_{n}", b) for n, b in
                                                       bases.items())):  # fmt: skip
        shift, turn = one.sigma
        if shift.max() > OPEN_M or turn.max() > OPEN_RAD:
            raise InputError(
                f"{views.file}: the views do not determine {what}"
                f" ({1e3 * shift.max():.0f} mm, {np.degrees(turn.max()):.0f} deg); required: both"
                f" {views.ecm} and the tool turn by 20 deg or more about two axes between views"
            )
    eyes = [_intrinsics(views, eye) for eye in values["eyes"].reshape(2, EYE)]
    calibration = StereoCalibration(
        eyes[0], eyes[1], stereo.pose, source=f"trocar calibrate-camera {views.file}"
    )
    T_left_camera = inverse(calibration.mounts[0])

    def moved(x: Array) -> Array:
        shifted = replace(calibration, T_left_right=stereo.pose @ exp_twist(x[6:]))
        return exp_twist(x[:6]) @ inverse(shifted.mounts[0])

    by_pose = slopes(lambda x: log_transform(inverse(T_left_camera) @ moved(x)), np.zeros(12))
    both = found.covariance_of("left", "stereo")
    median = float(np.median(sizes))
    far = [
        f"view {name}: corners miss by {size:.2f} px, the median is {median:.2f} px"
        for name, size in zip(views.names, sizes, strict=True)
        if size > FAR * max(median, BEST_PX)
    ]
    opened = [
        f"{arm} {views.arms[arm].joints[joint].name}: the views say little of its offset"
        for arm, joint in (fit.model.offsets[i] for i in found.undetermined("offsets", OPEN_PART))
    ]
    chosen = set(fit.model.offsets)
    return HandEye(
        ecm=views.ecm,
        description=views.arms[views.ecm].name,
        calibration=calibration,
        eye_sigma=found.sigma("eyes").reshape(2, EYE),
        stereo=stereo,
        left=left,
        camera=Placed(left.pose @ T_left_camera, by_pose @ both @ by_pose.T),
        bases=bases,
        boards=boards,
        offsets=fit.offset_values,
        absorbed={
            arm: tuple(
                views.arms[arm].joints[joint].name
                for name, joint in _candidates(views)
                if name == arm and (name, joint) not in chosen
            )
            for arm in (views.ecm, *views.psms)
        }
        if chosen
        else {},
        corner_rms=float(np.sqrt(np.mean(found.residuals["corners"] ** 2))),
        joint_ratio=fit.joint_ratio,
        corners=int(np.isfinite(views.pixels).all(axis=-1).sum()),
        view_rms=dict(zip(views.names, sizes.tolist(), strict=True)),
        warnings=(*warnings, *far, *opened),
    )


def _intrinsics(views: BoardViews, eye: Array) -> Intrinsics:
    K = np.array([[eye[0], 0.0, eye[2]], [0.0, eye[1], eye[3]], [0.0, 0.0, 1.0]])
    return Intrinsics(*views.size, K, eye[4:])


def _start(views: BoardViews, joint_noise: float) -> tuple[_BoardModel, dict[str, Array]]:
    """Return a first guess: lenses and board poses by homographies, then the arms' poses."""
    eyes: list[Array] = []
    seen: list[dict[int, Array]] = []
    for eye in range(2):
        planes = _planes(views, eye)
        K = views.start[eye].K if views.start else _focal_lengths(views, planes)
        seen.append({i: _board_pose(H, K) for i, H in planes.items()})
        distortion = views.start[eye].distortion[:4] if views.start else np.zeros(4)
        eyes.append(np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], distortion]))
    both = sorted(set(seen[0]) & set(seen[1]))
    if len(both) < FEWEST_VIEWS:
        raise InputError(
            f"{views.file}: {len(both)} views show four corners or more to both eyes; allowed: at"
            f" least {FEWEST_VIEWS}"
        )
    stereo = _mean_pose([seen[0][i] @ inverse(seen[1][i]) for i in both])
    if stereo[0, 3] <= 0.0:
        shown = views.pixels[:, 0, :, 0] - views.pixels[:, 1, :, 0]
        raise InputError(
            f"{views.file}: the right eye is {-1e3 * stereo[0, 3]:.1f} mm left of the left one"
            f" (disparity {np.nanmedian(shown):.0f} px); allowed: to its right. Are the eyes"
            " exchanged?"
        )
    ecm = views.arms[views.ecm]
    A_e = pose(ecm.mechanism, views.q[views.ecm])
    best: tuple[float, Array, list[tuple[Array, Array]]] | None = None
    for turned in range(4):  # the camera head may sit on the scope any way round
        for bent in (0.0, np.pi / 6.0, -np.pi / 6.0):
            R = rotation_z(np.pi + 0.5 * np.pi * turned) @ rotation_x(bent)
            left, pairs, miss = _arms_start(views, A_e, transform(R, np.zeros(3)), seen[0])
            if best is None or miss < best[0]:
                best = miss, left, pairs
    if best is None:  # the loop ran
        raise InputError(f"{views.file}: no view shows a board")
    own = [views.arms[name] for name in (views.ecm, *views.psms)]
    most = max(arm.own_joints for arm in own[1:])
    noise = np.full((len(views.names), ecm.own_joints + most), joint_noise)
    for i, psm in enumerate(views.holders):
        joints = (*ecm.joints[: ecm.own_joints], *own[1 + psm].joints[: own[1 + psm].own_joints])
        slides = [j for j, joint in enumerate(joints) if joint.kind == "prismatic"]
        noise[i, slides] *= SLIDE_PER_TURN
    _, left, pairs = best
    values = {"left": left, "stereo": stereo, "eyes": np.concatenate(eyes)}
    for name, (base, board) in zip(views.psms, pairs, strict=True):
        values |= {f"base {name}": base, f"board {name}": board}
    values |= {"offsets": np.zeros(0), "shifts": np.zeros(noise.size)}
    return _BoardModel(views, noise), values


def _arms_start(
    views: BoardViews, A_e: Array, left: Array, seen: Mapping[int, Array]
) -> tuple[Array, list[tuple[Array, Array]], float]:
    """Return T_ecm_left, (T_base_psm, T_tip_board) of each PSM, and what is left [m]."""
    pairs: list[tuple[Array, Array]] = []
    chains: list[Array] = []
    boards: list[Array] = []
    for _ in range(4):
        pairs, chains, boards = [], [], []
        for psm, name in enumerate(views.psms):
            mine = [i for i, holder in enumerate(views.holders) if holder == psm and i in seen]
            arm = views.arms[name]
            if len(mine) < 3:
                raise InputError(
                    f"{views.file}: {len(mine)} views show the board of {name}; allowed: at least 3"
                )
            tips = pose(arm.mechanism, views.q[name][mine])
            in_base = np.array([A_e[i] @ left @ seen[i] for i in mine])
            base, board = hand_eye(tips, in_base)
            pairs.append((base, board))
            chains += [inverse(A_e[i]) @ base @ T @ board for i, T in zip(mine, tips, strict=True)]
            boards += [seen[i] for i in mine]
        # T_ecm_left T_left_board = T_ecm_board
        left = _mean_pose([T @ inverse(B) for T, B in zip(chains, boards, strict=True)])
    corners = views.points[[0, -1]]
    miss = [
        np.linalg.norm(_apply((left @ B)[None], corners) - _apply(T[None], corners))
        for T, B in zip(chains, boards, strict=True)
    ]
    return left, pairs, float(np.median(miss))


def _mean_pose(poses: Sequence[Array]) -> Array:
    """Return the mean: of positions by coordinates, of rotations the nearest to their mean."""
    mean = np.median(np.array(poses), axis=0)
    return transform(nearest_rotation(mean[:3, :3]), mean[:3, 3])


def _planes(views: BoardViews, eye: int) -> dict[int, Array]:
    """Return homographies, board to pixels, of the views that show four corners, {view: (3, 3)}."""
    found: dict[int, Array] = {}
    for i, pixels in enumerate(views.pixels[:, eye]):
        seen = np.isfinite(pixels).all(axis=-1)
        flat = views.points[seen, :2]
        if seen.sum() < 4 or np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-6) < 2:
            continue
        scale = np.diag([*(2.0 / np.array(views.size)), 1.0])
        scale[:2, 2] = -1.0
        size = float(np.abs(views.points).max())
        u = pixels[seen] @ scale[:2, :2] + scale[:2, 2]
        b = np.concatenate([flat / size, np.ones((len(flat), 1))], axis=1)
        zero = np.zeros_like(b)
        rows = np.concatenate(
            [
                np.concatenate([b, zero, -u[:, :1] * b], axis=1),
                np.concatenate([zero, b, -u[:, 1:] * b], axis=1),
            ]
        )
        H = np.linalg.svd(rows)[2][-1].reshape(3, 3)
        found[i] = np.linalg.inv(scale) @ H @ np.diag([1.0 / size, 1.0 / size, 1.0])
    return found


def _focal_lengths(views: BoardViews, planes: Mapping[int, Array]) -> Array:
    """Return K with the principal point in the middle and focal lengths from homographies.

    Source: Zhang, "A flexible new technique for camera calibration", 2000: h1' w h2 = 0 and
    h1' w h1 = h2' w h2 with w = diag(1/fx^2, 1/fy^2, 1), the pixels counted from the middle.
    """
    middle = 0.5 * (np.array(views.size) - 1.0)
    centred = np.eye(3)
    centred[:2, 2] = -middle
    rows: list[Array] = []
    right: list[float] = []
    for H in planes.values():
        G = centred @ H
        columns = G / np.linalg.norm(G[:, 0])
        a, b = columns[:, 0], columns[:, 1]
        rows += [a[:2] * b[:2], a[:2] ** 2 - b[:2] ** 2]
        right += [-a[2] * b[2], b[2] ** 2 - a[2] ** 2]
    inverted = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    f = 1.0 / np.sqrt(np.where(inverted > 0.0, inverted, np.nan))
    width = float(views.size[0])
    # Views that hardly tilt do not show it; the adjustment finds it from here.
    f = np.where((f > 0.2 * width) & (f < 20.0 * width), f, width)
    return np.array([[f[0], 0.0, middle[0]], [0.0, f[1], middle[1]], [0.0, 0.0, 1.0]])


def _board_pose(H: Array, K: Array) -> Array:
    """Return T_eye_board of a homography, (4, 4)."""
    columns = np.linalg.solve(K, H)
    columns = columns * (2.0 / (np.linalg.norm(columns[:, 0]) + np.linalg.norm(columns[:, 1])))
    G = columns * np.sign(columns[2, 2])
    R = np.stack([G[:, 0], G[:, 1], np.cross(G[:, 0], G[:, 1])], axis=1)
    return transform(nearest_rotation(R), G[:, 2])

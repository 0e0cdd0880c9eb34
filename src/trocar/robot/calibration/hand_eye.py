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
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.cameras.lens import distort, distortion_jacobian
from trocar.descriptions.overlay_records import CameraPatch, FramePatch, Overlay
from trocar.errors import InputError
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
#: Steps of the adjustment, and the part of the cost that a step must gain to go on.
STEPS, GAIN = 60, 1e-9
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
        """Return what an overlay has of it."""
        return FramePatch(self.pose[:3, 3], rpy_from_matrix(self.pose[:3, :3]), *self.sigma)


@dataclass(frozen=True, eq=False)
class HandEye:
    """What views of boards show.

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
    fit = _adjust(_start(views, joint_noise), watch)
    warnings = [f"no corners were found in the views {', '.join(blank)}"] if blank else []
    if offsets:
        fit = _adjust(replace(fit.state, offsets=_free_offsets(fit.state)), watch)
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
class _State:
    """Values of all unknowns.

    Attributes:
        left, stereo: T_ecm_left, T_left_right
        eyes: fx, fy, cx, cy, k1, k2, p1, p2, (2, 8)
        bases, boards: of each PSM
        offsets: unknown offsets, (arm, joint index), and their values below
        offset: (n_offsets,)
        shifts: of each view's readings: those of the ECM's joints, then of its PSM's, (n_views, k)
        noise: of the readings, (n_views, k) [rad or m]
        pixel: noise of a corner per axis [px]
    """

    views: BoardViews
    left: Array
    stereo: Array
    eyes: Array
    bases: tuple[Array, ...]
    boards: tuple[Array, ...]
    shifts: Array
    noise: Array
    pixel: float = 1.0
    offsets: tuple[tuple[str, int], ...] = ()
    offset: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def poses_end(self) -> int:
        """Where the unknowns of poses and eyes end."""
        return 12 + 2 * EYE + 12 * len(self.bases)

    @property
    def offset_sigma(self) -> Array:
        """Standard deviations that offsets have beforehand, (n_offsets,) [rad or m]."""
        slides = [
            self.views.arms[arm].joints[joint].kind == "prismatic" for arm, joint in self.offsets
        ]
        return np.where(slides, OFFSET_M, OFFSET_RAD)

    def moved(self, x: Array) -> _State:
        """Return the state a step further; poses turn in their own axes."""
        pairs = x[12 + 2 * EYE : self.poses_end].reshape(-1, 2, 6)
        end = self.poses_end + len(self.offsets)
        return replace(
            self,
            left=self.left @ exp_twist(x[:6]),
            stereo=self.stereo @ exp_twist(x[6:12]),
            eyes=self.eyes + x[12 : 12 + 2 * EYE].reshape(2, EYE),
            bases=tuple(T @ exp_twist(d[0]) for T, d in zip(self.bases, pairs, strict=True)),
            boards=tuple(T @ exp_twist(d[1]) for T, d in zip(self.boards, pairs, strict=True)),
            offset=self.offset + x[self.poses_end : end],
            shifts=self.shifts + x[end:].reshape(self.shifts.shape),
        )

    def rows(self) -> tuple[Array, Array]:
        """Return weighted residuals (m,) and their derivative (m, n) by `moved`'s argument.

        Rows are corners, of view after view, then what is known beforehand: readings, offsets,
        distortion.
        """
        views, end = self.views, self.poses_end
        first = end + len(self.offsets)
        width = first + self.shifts.size
        left, slopes = self._corners()
        seen = np.isfinite(views.pixels)
        count = int(seen.sum())
        J = np.zeros((count, width))
        per_view = seen.reshape(len(seen), -1).sum(axis=1)
        begins = np.concatenate([[0], np.cumsum(per_view)])
        own = len(views.arms[views.ecm].joints[: views.arms[views.ecm].own_joints])
        for i, psm in enumerate(views.holders):
            rows = slice(begins[i], begins[i + 1])
            D = slopes[i][seen[i]]  # (rows, 12 + 16 + 12 + k)
            fixed = 12 + 2 * EYE
            J[rows, :fixed] = D[:, :fixed]
            J[rows, fixed + 12 * psm : fixed + 12 * psm + 12] = D[:, fixed : fixed + 12]
            by_joint = D[:, fixed + 12 :]
            k = self.shifts.shape[1]
            J[rows, first + k * i : first + k * (i + 1)] = by_joint
            for column, (arm, joint) in enumerate(self.offsets):
                if arm == views.ecm:
                    J[rows, end + column] = by_joint[:, joint]
                elif arm == views.psms[psm]:
                    J[rows, end + column] = by_joint[:, own + joint]
        prior = np.zeros((self.shifts.size + len(self.offsets) + 2 * 4, width))
        known = np.zeros(len(prior))
        n, o = self.shifts.size, len(self.offsets)
        prior[np.arange(n), first + np.arange(n)] = 1.0 / self.noise.ravel()
        known[:n] = (self.shifts / self.noise).ravel()
        prior[n + np.arange(o), end + np.arange(o)] = 1.0 / self.offset_sigma
        known[n : n + o] = self.offset / self.offset_sigma
        lens = 12 + np.array([e * EYE + 4 + c for e in range(2) for c in range(4)])
        prior[n + o + np.arange(8), lens] = 1.0 / np.tile(DISTORTION_SIGMA, 2)
        known[n + o :] = (self.eyes[:, 4:] / DISTORTION_SIGMA).ravel()
        return (
            np.concatenate([left[seen] / self.pixel, known]),
            np.concatenate([J / self.pixel, prior]),
        )

    def positions(self) -> tuple[Array, list[Array]]:
        """Return joint positions of the ECM (n_views, n) and of each view's PSM."""
        views = self.views
        known = {name: np.zeros(len(arm.joints)) for name, arm in views.arms.items()}
        for (name, joint), value in zip(self.offsets, self.offset, strict=True):
            known[name][joint] = value
        own = views.arms[views.ecm].own_joints
        ecm = views.q[views.ecm] + known[views.ecm]
        ecm[:, :own] += self.shifts[:, :own]
        tools: list[Array] = []
        for i, psm in enumerate(views.holders):
            name = views.psms[psm]
            q = views.q[name][i] + known[name]
            q[: views.arms[name].own_joints] += self.shifts[i, own:][: views.arms[name].own_joints]
            tools.append(q)
        return ecm, tools

    def _corners(self) -> tuple[Array, Array]:
        """Return expected less seen pixels (n, 2, corners, 2) [px], and their derivatives.

        Returns:
            those by T_ecm_left, T_left_right, both eyes, base, board and joints, (n, 2, corners, 2,
            12 + 16 + 12 + k)
        """
        views = self.views
        n, corners = len(views.names), len(views.points)
        ecm_q, tool_q = self.positions()
        ecm = views.arms[views.ecm]
        A_e = pose(ecm.mechanism, ecm_q)
        J_e = jacobian_body(ecm.mechanism, ecm_q)[:, :, : ecm.own_joints]
        A_p, J_p = np.zeros((n, 4, 4)), np.zeros((n, 6, self.shifts.shape[1] - ecm.own_joints))
        for psm, name in enumerate(views.psms):
            mine = [i for i, holder in enumerate(views.holders) if holder == psm]
            arm = views.arms[name]
            q = np.array([tool_q[i] for i in mine])
            A_p[mine] = pose(arm.mechanism, q)
            J_p[mine, :, : arm.own_joints] = jacobian_body(arm.mechanism, q)[:, :, : arm.own_joints]
        base = np.array(self.bases)[list(views.holders)]
        board = np.array(self.boards)[list(views.holders)]
        in_tip = _apply(board, views.points)
        in_base = _apply(A_p, in_tip)
        in_ecm = _apply(inverse(A_e) @ base, in_base)
        in_left = _apply(np.broadcast_to(inverse(self.left), A_e.shape), in_ecm)
        R_left_ecm = np.broadcast_to(self.left[:3, :3].T, (n, 3, 3))
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
        in_right = _apply(np.broadcast_to(inverse(self.stereo), A_e.shape), in_left)
        expected, slopes = (
            np.zeros((n, 2, corners, 2)),
            np.zeros((n, 2, corners, 2, 12 + 2 * EYE + 12 + self.shifts.shape[1])),
        )
        for eye, points in enumerate((in_left, in_right)):
            pixels, by_point, by_eye = _seen(points, self.eyes[eye])
            expected[:, eye] = pixels
            moves = by if eye == 0 else self.stereo[:3, :3].T @ by
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
    state: _State
    covariance: Array
    joint_ratio: float
    corner_rms: float

    @property
    def offset_values(self) -> dict[str, dict[str, Value]]:
        """Offsets with their standard deviations."""
        found: dict[str, dict[str, Value]] = {}
        begin = self.state.poses_end
        for i, ((arm, joint), value) in enumerate(
            zip(self.state.offsets, self.state.offset, strict=True)
        ):
            name = self.state.views.arms[arm].joints[joint].name
            sigma = float(np.sqrt(self.covariance[begin + i, begin + i]))
            found.setdefault(arm, {})[name] = Value(float(value), sigma)
        return found


def _adjust(state: _State, watch: Callable[[str], None] = lambda _: None) -> _Fit:
    """Adjust all unknowns by damped Gauss-Newton steps, the corners' noise by what is left."""
    if len(state.offset) != len(state.offsets):
        state = replace(state, offset=np.zeros(len(state.offsets)))
    count = int(np.isfinite(state.views.pixels).sum())
    covariance = np.zeros((0, 0))
    free = 0.0
    for number in range(ROUNDS):
        watch(f"round {number + 1} of {ROUNDS}")
        state = _minimised(state)
        _, J = state.rows()
        covariance = _inverted(J.T @ J)
        # Unknowns that the corners determine, beside what is known beforehand.
        prior = J[count:]
        free = J.shape[1] - float(np.einsum("ij,jk,ik->", prior, covariance, prior))
        left = state.rows()[0][:count] * state.pixel
        pixel = float(np.sqrt(left @ left / max(count - free, 1.0)))
        state = replace(state, pixel=max(pixel, BEST_PX))
    left, J = state.rows()
    covariance = _inverted(J.T @ J)
    n, first = state.shifts.size, state.poses_end + len(state.offsets)
    used = n - float(np.sum(np.diag(covariance)[first:] / state.noise.ravel() ** 2))
    shifts = (state.shifts / state.noise).ravel()
    return _Fit(
        state,
        covariance,
        float(np.sqrt(shifts @ shifts / max(used, 1.0))),
        float(np.sqrt(np.mean((left[:count] * state.pixel) ** 2))),
    )


def _minimised(state: _State) -> _State:
    left, J = state.rows()
    damping, cost = 1e-4, float(left @ left)
    for _ in range(STEPS):
        square, slope = J.T @ J, J.T @ left
        scale = np.sqrt(np.maximum(np.diag(square), 1e-30))
        before = cost
        while damping < 1e8:
            damped = square / np.outer(scale, scale) + damping * np.eye(len(scale))
            step = -np.linalg.solve(damped, slope / scale) / scale
            tried = state.moved(step)
            tried_left, tried_J = tried.rows()
            if np.isfinite(tried_left).all() and tried_left @ tried_left < cost:
                state, left, J, cost = tried, tried_left, tried_J, float(tried_left @ tried_left)
                damping = max(0.1 * damping, 1e-12)
                break
            damping *= 10.0
        if before - cost <= GAIN * before:
            break
    return state


def _inverted(square: Array) -> Array:
    """Return the inverse of normal equations; directions that are open get a large variance."""
    scale = np.sqrt(np.maximum(np.diag(square), 1e-30))
    values, vectors = np.linalg.eigh(square / np.outer(scale, scale))
    inverted = (vectors / np.maximum(values, 1e-13)) @ vectors.T
    return np.asarray(inverted / np.outer(scale, scale))


def _candidates(views: BoardViews) -> list[tuple[str, int]]:
    names = (views.ecm, *views.psms)
    return [(name, joint) for name in names for joint in range(views.arms[name].own_joints)]


def _free_offsets(state: _State) -> tuple[tuple[str, int], ...]:
    """Return the offsets that no shift of a pose equals."""
    every = _candidates(state.views)
    trial = replace(state, offsets=tuple(every), offset=np.zeros(len(every)))
    _, J = trial.rows()
    J = J[: int(np.isfinite(state.views.pixels).sum())]
    end = trial.poses_end
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
    state, noise = fit.state, max(fit.joint_ratio, 1.0)
    free = _free_offsets(state)
    trial = replace(state, offsets=free, offset=np.zeros(len(free)))
    left, J = trial.rows()
    slope, covariance = J.T @ left, _inverted(J.T @ J)
    step = -covariance @ slope
    if -slope @ step < noise**2 * chi2.isf(FALSE_ALARM, len(free)):
        return []
    named: list[str] = []
    for i, (arm, joint) in enumerate(free, trial.poses_end):
        value, sigma = float(step[i]), float(np.sqrt(covariance[i, i]))
        if abs(value) > NAMED_SIGMAS * noise * sigma:
            one = state.views.arms[arm].joints[joint]
            unit = "mm" if one.kind == "prismatic" else "mrad"
            named.append(f"{arm} {one.name} {1e3 * value:+.2f} +- {1e3 * sigma:.2f} {unit}")
    return named or ["of several joints"]


def _slides(views: BoardViews, arm: str, joint: str) -> bool:
    return next(j.kind == "prismatic" for j in views.arms[arm].joints if j.name == joint)


def _result(fit: _Fit, warnings: tuple[str, ...]) -> HandEye:
    state, views = fit.state, fit.state.views
    C, begin = fit.covariance, 12 + 2 * EYE

    def placed(T: Array, at: int) -> Placed:
        return Placed(T, C[at : at + 6, at : at + 6])

    left, stereo = placed(state.left, 0), placed(state.stereo, 6)
    bases = {n: placed(state.bases[i], begin + 12 * i) for i, n in enumerate(views.psms)}
    boards = {n: placed(state.boards[i], begin + 12 * i + 6) for i, n in enumerate(views.psms)}
    residuals = state._corners()[0]
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
    eyes = [_intrinsics(views, state.eyes[e]) for e in range(2)]
    calibration = StereoCalibration(
        eyes[0], eyes[1], state.stereo, source=f"trocar calibrate-camera {views.file}"
    )
    T_left_camera = inverse(calibration.mounts[0])

    def moved(x: Array) -> Array:
        stereo = replace(calibration, T_left_right=state.stereo @ exp_twist(x[6:]))
        return exp_twist(x[:6]) @ inverse(stereo.mounts[0])

    step = 1e-6
    slopes = np.stack(
        [
            (
                log_transform(inverse(T_left_camera) @ moved(d))
                - log_transform(inverse(T_left_camera) @ moved(-d))
            )
            / (2.0 * step)
            for d in step * np.eye(12)
        ],
        axis=-1,
    )
    median = float(np.median(sizes))
    far = [
        f"view {name}: corners miss by {size:.2f} px, the median is {median:.2f} px"
        for name, size in zip(views.names, sizes, strict=True)
        if size > FAR * max(median, BEST_PX)
    ]
    opened = [
        f"{arm} {joint}: the views say little of its offset"
        for arm, row in fit.offset_values.items()
        for joint, value in row.items()
        if value.sigma > OPEN_PART * (OFFSET_M if _slides(views, arm, joint) else OFFSET_RAD)
    ]
    chosen = set(state.offsets)
    return HandEye(
        ecm=views.ecm,
        description=views.arms[views.ecm].name,
        calibration=calibration,
        eye_sigma=np.sqrt(np.diag(C)[12:begin]).reshape(2, EYE),
        stereo=stereo,
        left=left,
        camera=Placed(state.left @ T_left_camera, slopes @ C[:12, :12] @ slopes.T),
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
        corner_rms=fit.corner_rms,
        joint_ratio=fit.joint_ratio,
        corners=int(np.isfinite(views.pixels).all(axis=-1).sum()),
        view_rms=dict(zip(views.names, sizes.tolist(), strict=True)),
        warnings=(*warnings, *far, *opened),
    )


def _intrinsics(views: BoardViews, eye: Array) -> Intrinsics:
    K = np.array([[eye[0], 0.0, eye[2]], [0.0, eye[1], eye[3]], [0.0, 0.0, 1.0]])
    return Intrinsics(*views.size, K, eye[4:])


def _start(views: BoardViews, joint_noise: float) -> _State:
    """Return a first guess: lenses and board poses by homographies, then the arms' poses."""
    eyes, seen = [], []
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
    return _State(
        views=views,
        left=left,
        stereo=stereo,
        eyes=np.array(eyes),
        bases=tuple(pair[0] for pair in pairs),
        boards=tuple(pair[1] for pair in pairs),
        shifts=np.zeros_like(noise),
        noise=noise,
    )


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
    rows, right = [], []
    for H in planes.values():
        G = centred @ H
        G = G / np.linalg.norm(G[:, 0])
        a, b = G[:, 0], G[:, 1]
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
    G = np.linalg.solve(K, H)
    G = G * (2.0 / (np.linalg.norm(G[:, 0]) + np.linalg.norm(G[:, 1])))
    G = G * np.sign(G[2, 2])
    R = np.stack([G[:, 0], G[:, 1], np.cross(G[:, 0], G[:, 1])], axis=1)
    return transform(nearest_rotation(R), G[:, 2])

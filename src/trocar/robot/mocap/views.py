"""Simulated views of a board on a tool, as `trocar calibrate-camera` reads them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.cameras.lens import project
from trocar.descriptions import RigDescription
from trocar.descriptions.records import RigArm
from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError
from trocar.geometry import inverse, transform
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_x
from trocar.geometry.se3 import exp_twist, translation
from trocar.kinematics import jacobian_body, jacobian_spatial, pose
from trocar.robot.boards import Board
from trocar.robot.mocap.touches import reach

Array = NDArray[np.float64]

#: The board's middle is this far from the camera. Source: our own choice: a board of 40 mm fills a
#: half to most of the picture. [m]
NEAR_M, FAR_M = 0.06, 0.10
#: Spread of a view's joint positions about the rig's pose: of the ECM to either side [rad; m], of
#: the tool's wrist. Source: our own choice: the board stays before the camera.
ECM_SPREAD = np.array([0.4, 0.35, 0.03, 1.0])
WRIST_SPREAD = 0.5
#: The tip holds the board by its edge, so far from its corners. Source: our own choice. [m]
HOLDER_M = 0.008
#: And so far behind it, with the handle behind the board. Source: our own choice. [m]
BEHIND_M = 0.01
#: Errors of a robot's scope and bases against its description, 1 sigma. Source: our own choice.
OFF_M, OFF_RAD = 0.003, 0.03
#: Parts of the corners that both eyes show, at least, of a board with markers (of a chessboard all,
#: without which detectors find none); the steepest view of the board.
SEEN, STEEPEST = 0.6, np.deg2rad(55.0)
#: Attempts at a view before the simulation gives up.
ATTEMPTS = 4000
#: Distortion of the eyes where the camera has none. Source: the prototypes of the figures; a real
#: endoscope's is of this size.
DISTORTION = np.array([-0.2, 0.06, 0.001, -0.001, 0.0])


@dataclass(frozen=True)
class ViewSettings:
    """Settings of simulated views.

    Attributes:
        psm: the arm that holds the board
        board: what it holds
        count: views
        corner_noise_px: of a corner per axis, 1 sigma; 0 of pictures
        joint_noise: of readings of joints that turn [rad]; of joints that slide, a tenth [m]
        offset: joints of either arm read wrong by up to this [rad], a tenth [m]
        seed: of everything random
    """

    psm: str
    board: Board = field(default_factory=Board)
    count: int = 20
    corner_noise_px: float = 0.2
    joint_noise: float = 3.5e-4
    offset: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SimulatedViews:
    """Views, and what they are made of.

    Attributes:
        calibration: both eyes, as they are
        left: T_ecm_left
        base: T_ecm-base_psm-base
        board: T_tip_board
        q: {arm: true joint positions (n, n_joints)}
        read: {arm: readings (n, n_joints)}
        offsets: {arm: to be added to readings (n_joints,)}
        left_read, base_read: T_ecm_left and T_ecm-base_psm-base for the joint readings: with the
            offsets that equal a shift of these poses, of the ECM's insertion and roll and of both
            arms' first joints
        seen: T_left_board of each view, (n, 4, 4)
        pixels: noisy corners, NaN outside the picture, (n, 2, corners, 2) [px]
    """

    calibration: StereoCalibration
    left: Array
    base: Array
    board: Array
    q: dict[str, Array]
    read: dict[str, Array]
    offsets: dict[str, Array]
    left_read: Array
    base_read: Array
    seen: Array
    pixels: Array


def simulate_views(rig: RigDescription, settings: ViewSettings) -> SimulatedViews:
    """Simulate views by the first endoscope of a rig, from its pose "work" or "start".

    Scope and bases of the simulated robot are a few millimetres and degrees off the rig's.

    Raises:
        InputError: settings that cannot be used, a rig without endoscope, a tool that cannot come
            before the camera
        UnknownNameError: no such arm
    """
    _check(settings)
    camera = next((c for c in rig.cameras if c.kind == "endoscope"), None)
    psm = rig.arm(settings.psm)
    if camera is None or psm.arm.type != "PSM":
        got = "no endoscope" if camera is None else f"{psm.name}, of type {psm.arm.type}"
        raise InputError(f"rig {rig.name}: got {got}; allowed: a PSM, and a rig with an endoscope")
    ecm, rng = rig.arm(camera.arm), np.random.default_rng(settings.seed)
    nominal = camera.calibration
    if not isinstance(nominal, StereoCalibration):
        raise InputError(f"rig {rig.name}: its endoscope has one eye; allowed: two")
    calibration = _worn(rng, nominal)
    middle = rig.poses["work" if "work" in rig.poses else "start"]
    places = Places(rig, lambda name: middle[name])
    base = inverse(places.reference_pose(ecm.name)) @ places.reference_pose(psm.name)
    base = base @ _off(rng)
    turned = ecm.arm.mechanism.joints[-1].drive[0][0]
    zero = np.zeros(len(ecm.arm.joints))
    at_tip = pose(ecm.arm.mechanism, zero, ecm.arm.mechanism.tip, turned)
    bent = camera.pose @ transform(rotation_x(-camera.angle), np.zeros(3))
    left = inverse(at_tip) @ bent @ calibration.mounts[0] @ _off(rng)
    sees = pose(ecm.arm.mechanism, middle[ecm.name]) @ left
    tip = base @ pose(psm.arm.mechanism, middle[psm.name])
    # In the middle posture the board faces the camera, and lies beyond the tip, off the shaft.
    facing = tip[:3, :3].T @ sees[:3, :3]
    corners = settings.board.corners
    beyond = facing[2, :2] / np.linalg.norm(facing[2, :2])
    centre = 0.5 * (corners[0] + corners[-1])
    held = beyond * (np.abs(centre[:2]) @ np.abs(beyond) + HOLDER_M) - centre[:2]
    board = transform(facing, np.zeros(3)) @ translation([*held, -BEHIND_M]) @ _off(rng)
    found: list[tuple[Array, Array, Array, Array]] = []
    for _ in range(ATTEMPTS):
        view = _view(rng, ecm, psm, middle, left, base, board, calibration, settings.board)
        if view is not None:
            found.append(view)
        if len(found) == settings.count:
            break
    else:
        raise InputError(
            f"rig {rig.name}: {psm.name} brought the board before the camera {len(found)} times in"
            f" {ATTEMPTS} attempts; required: {settings.count}, from a pose with the tool in view"
        )
    q = {ecm.name: np.array([v[0] for v in found]), psm.name: np.array([v[1] for v in found])}
    offsets = {arm.name: _offsets(rng, arm, settings.offset) for arm in (ecm, psm)}
    read: dict[str, Array] = {}
    for arm in (ecm, psm):
        noise = rng.normal(size=q[arm.name].shape) * settings.joint_noise * _per_turn(arm)
        read[arm.name] = q[arm.name] + noise - offsets[arm.name]
        read[arm.name][:, arm.arm.own_joints :] = 0.0
    pixels = np.array([v[3] for v in found])
    pixels = pixels + rng.normal(scale=settings.corner_noise_px, size=pixels.shape)
    pixels[~_inside(pixels, calibration).all(axis=-1)] = np.nan
    scope, tool = offsets[ecm.name], offsets[psm.name]
    last = jacobian_body(ecm.arm.mechanism, zero)[:, 2:] @ scope[2:]
    first = [
        jacobian_spatial(arm.arm.mechanism, np.zeros(len(o)))[:, 0] * o[0]
        for arm, o in ((ecm, scope), (psm, tool))
    ]
    return SimulatedViews(
        calibration=calibration,
        left=left,
        base=base,
        board=board,
        q=q,
        read=read,
        offsets=offsets,
        left_read=exp_twist(last) @ left,
        base_read=exp_twist(-first[0]) @ base @ exp_twist(first[1]),
        seen=np.array([v[2] for v in found]),
        pixels=pixels,
    )


def _check(settings: ViewSettings) -> None:
    if not 1 <= settings.count <= 1000:
        raise InputError(f"count: got {settings.count}; allowed: 1 to 1000 views")
    if not 0.0 <= settings.corner_noise_px <= 10.0:
        raise InputError(f"corner noise: got {settings.corner_noise_px:g}; allowed: 0 to 10 px")
    for what, value in (("joint noise", settings.joint_noise), ("offset", settings.offset)):
        if not 0.0 <= value <= 0.1:
            raise InputError(f"{what}: got {np.degrees(value):g} deg; allowed: 0 to 5.7 deg")
    if settings.seed < 0:
        raise InputError(f"seed: got {settings.seed}; allowed: an integer of 0 or more")


def _off(rng: np.random.Generator) -> Array:
    turn = matrix_from_rotation_vector(rng.normal(scale=OFF_RAD, size=3))
    return transform(turn, rng.normal(scale=OFF_M, size=3))


def _worn(rng: np.random.Generator, nominal: StereoCalibration) -> StereoCalibration:
    """Return eyes whose lenses and distance are off the preset's by a few parts in a hundred."""
    eyes: list[Intrinsics] = []
    for eye in nominal.eyes:
        K = eye.K.copy()
        K[[0, 1], [0, 1]] *= 1.0 + rng.normal(scale=0.02)
        K[:2, 2] += rng.normal(scale=0.01 * eye.width, size=2)
        lens = eye.distortion if eye.distortion.any() else DISTORTION
        eyes.append(type(eye)(eye.width, eye.height, K, lens))
    T = nominal.T_left_right.copy()
    T[:3, 3] += rng.normal(scale=1e-4, size=3)
    T[:3, :3] = T[:3, :3] @ matrix_from_rotation_vector(rng.normal(scale=0.005, size=3))
    return StereoCalibration(eyes[0], eyes[1], T, "simulated", "trocar views")


def _per_turn(arm: RigArm) -> Array:
    return np.array([0.1 if j.kind == "prismatic" else 1.0 for j in arm.arm.joints])


def _offsets(rng: np.random.Generator, arm: RigArm, most: float) -> Array:
    values = rng.uniform(-most, most, size=len(arm.arm.joints)) * _per_turn(arm)
    values[arm.arm.own_joints :] = 0.0
    return values


def _view(
    rng: np.random.Generator,
    ecm: RigArm,
    psm: RigArm,
    middle: Any,
    left: Array,
    base: Array,
    board: Array,
    calibration: StereoCalibration,
    drawn: Board,
) -> tuple[Array, Array, Array, Array] | None:
    """Return joint positions of both arms, T_left_board and pixels, None if the board is unseen."""
    ecm_q = middle[ecm.name].copy()
    ecm_q[: len(ECM_SPREAD)] += rng.uniform(-1.0, 1.0, size=len(ECM_SPREAD)) * ECM_SPREAD
    lower, upper = ecm.arm.mechanism.lower, ecm.arm.mechanism.upper
    ecm_q = np.clip(ecm_q, lower, upper)
    sees = pose(ecm.arm.mechanism, ecm_q) @ left
    # The board's middle goes anywhere in the picture.
    eye = calibration.left
    depth = rng.uniform(NEAR_M, FAR_M)
    across = rng.uniform(-0.25, 0.25, size=2) * np.array(eye.size) / np.diag(eye.K)[:2] * depth
    q = middle[psm.name].copy()
    own = psm.arm.own_joints
    q[3:own] += rng.uniform(-WRIST_SPREAD, WRIST_SPREAD, size=own - 3)
    q[own:] = 0.0
    wanted = (inverse(base) @ sees @ np.append([*across, depth], 1.0))[:3]
    corners = drawn.corners
    centre = (board @ np.append(0.5 * (corners[0] + corners[-1]), 1.0))[:3]
    q = reach(psm.arm, q, wanted, centre, 3)
    if q is None:
        return None
    at = inverse(sees) @ base @ pose(psm.arm.mechanism, q) @ board
    if at[2, 2] < np.cos(STEEPEST):
        return None
    pixels: list[Array] = []
    for T, one in zip((np.eye(4), calibration.T_left_right), calibration.eyes, strict=True):
        here = inverse(T) @ at
        points = corners @ here[:3, :3].T + here[:3, 3]
        if points[:, 2].min() < 0.02:
            return None
        pixels.append(project(points, one.K, one.distortion))
    shown = np.array(pixels)
    needed = SEEN if drawn.kind == "charuco" else 1.0
    if _inside(shown, calibration).all(axis=-1).mean(axis=-1).min() < needed:
        return None
    return ecm_q, q, at, shown


def _inside(pixels: Array, calibration: StereoCalibration) -> NDArray[np.bool_]:
    return (pixels > 2.0) & (pixels < np.array(calibration.left.size) - 3.0)

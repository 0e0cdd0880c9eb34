"""A needle on tissue before the endoscope, with jaws and a thread: images whose truth is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.descriptions import load_rig
from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.needles import Needle
from trocar.descriptions.records import Movable, Prop
from trocar.descriptions.shapes import needle_shapes
from trocar.geometry import (
    inverse,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
    transform,
    transform_points,
)
from trocar.geometry.se3 import exp_twist
from trocar.rendering import Channels, Look, Renderer
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import ShapeRecord

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
#: Blotchy tissue, tissue in the surgical style, a light plate.
Style = Literal["plain", "surgical", "light"]

#: Lens of the images. Source: a wide endoscope's, our own choice.
DISTORTION = np.array([-0.2, 0.06, 0.001, -0.001])
#: Tissue: its side, height of its bumps, and colours from pale to veined. Source: our own choice.
SIDE_M, BUMP_M, CELLS = 0.16, 0.0012, 120
TINTS = ((0.80, 0.47, 0.42), (0.76, 0.40, 0.36), (0.70, 0.33, 0.30), (0.58, 0.22, 0.21))
PLATE = (0.85, 0.84, 0.80)
THREAD = (0.25, 0.12, 0.45)
#: Distance of a held needle beyond the tip. Source: `trocar.tasks.suturing.planning.REACH_M`. [m]
HELD_M = 0.0085
#: Opening of jaws about a wire of 0.8 mm. Source: a wedge of 8.5 mm. [rad]
JAW_RAD = 0.05


@dataclass(frozen=True, eq=False)
class Shot:
    """One pair of images and its truth.

    Attributes:
        time: [s]
        eyes: left and right, (h, w, 3)
        T_left_needle: truth, (4, 4)
        T_left_tip: the tool's tip as the kinematics has it, (4, 4)
        visible: share of the centre line that is seen, of the eye that sees less
    """

    time: float
    eyes: tuple[Picture, Picture]
    T_left_needle: Array
    T_left_tip: Array
    visible: float


class Stage:
    """Renders a needle wherever it is put.

    Args:
        preset: a built-in stereo camera
        needle: its dimensions
        seed: of tissue and noise
        noise: standard deviation of the images' noise, as a share of white
        common_px: standard deviation of each eye's offset, which its calibration lacks [px]
        style: of the ground
    """

    def __init__(
        self,
        preset: str,
        needle: Needle,
        seed: int,
        noise: float = 0.03,
        common_px: float = 0.3,
        style: Style = "plain",
    ) -> None:
        self.needle, self.rng, self.noise = needle, np.random.default_rng(seed), noise
        known = load_stereo_camera(preset)
        self.calibration = _bent(known, np.zeros((2, 2)))
        self._true = _bent(known, common_px * self.rng.standard_normal((2, 2)))
        self.world = _world(needle)
        shapes = [s for s in self.world.shapes() if s.arm is not None or s.name[:6] == "needle"]
        self._needle = next(s.body for s in shapes if s.arm is None)
        self._bodies = len(self.world.snapshot(arms=False).positions)
        shapes += _ground(self._bodies, self.rng, style)
        shapes += _thread(self._bodies + 1, needle)
        build = self.world.snapshot(arms=False).build
        look = Look("surgical" if style == "surgical" else "plain", distortion=True, wet=0.5)
        self.renderer = Renderer(lambda: (build, shapes), Channels(ids=True), look)

    def reset(self) -> None:
        """Put the tools where the rig has them."""
        self.world.reset(0)
        self._q = self.world.arms["PSM1"].joints.positions()

    def set_tip(self, T: Array) -> None:
        """Put the tip of PSM1 to a pose in the world, (4, 4)."""
        arm = self.world.arms["PSM1"]
        local = inverse(self.world.reference_pose("PSM1")) @ T
        self._q[:-1] = arm.local.inverse_kinematics(local, self._q[:-1])
        self._q[-1] = JAW_RAD
        self.world.set_state("PSM1", self._q)

    def tip(self, arm: str = "PSM1") -> Array:
        """Return the pose of a tool's tip in the world, (4, 4)."""
        return self.world.arms[arm].measured_cp("world").matrix

    def shot(
        self,
        time: float,
        T_needle: Array,
        T_left: Array,
        T_tissue: Array,
        hand_eye: Array | None = None,
        veil: float = 0.0,
    ) -> Shot:
        """Return the images of a moment.

        Args:
            time: [s]
            T_needle, T_left, T_tissue: needle, left eye and tissue in the world, (4, 4)
            hand_eye: error of the tool's pose before the left eye, (4, 4)
            veil: share of the needle, from the swage, behind something dark; 1 hides all
        """
        now = self.world.snapshot(arms=False)
        positions, quaternions = now.positions.copy(), now.quaternions.copy()
        positions[self._needle] = T_needle[:3, 3]
        quaternions[self._needle] = quaternion_from_matrix(T_needle[:3, :3])
        extra = (T_tissue, T_needle)
        positions = np.concatenate([positions, [T[:3, 3] for T in extra]])
        turns = [quaternion_from_matrix(T[:3, :3]) for T in extra]
        snapshot = now._replace(
            time=time, positions=positions, quaternions=np.concatenate([quaternions, turns])
        )
        mount = T_left @ inverse(self._true.mounts[0])
        camera = CameraRecord(
            "eye", "endoscope", self._true, "", "", 0, mount, 0.0, np.eye(4), time, now.build
        )
        frame = self.renderer.render(snapshot, {"eye": camera}, "eye")
        assert frame.ids is not None  # noqa: S101
        number = {name: key for key, name in frame.names.items()}["needle"]
        line = self.needle.points(np.linspace(0.0, self.needle.arc, 121))
        eyes, seen = [], []
        for k in range(2):
            image = frame.eyes[k].astype(np.float32)
            T = inverse(frame.T_world_camera[k]) @ T_needle
            pixels = _pixels(line @ T[:3, :3].T + T[:3, 3], self._true.eyes[k])
            height, width = image.shape[:2]
            u, v = np.round(pixels).astype(int).T
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            there = np.zeros(len(line), bool)
            there[inside] = frame.ids[k][v[inside], u[inside]] == number
            if veil > 0.0:
                covered = pixels[: max(2, round(veil * len(line)))]
                centre = covered.mean(axis=0)
                reach = np.linalg.norm(covered - centre, axis=1).max() + 12.0
                yy, xx = np.mgrid[:height, :width]
                mask = np.hypot(xx - centre[0], yy - centre[1]) < reach
                mask &= _half_plane(xx, yy, pixels, veil)
                image[mask] = (95.0, 90.0, 92.0) + 25.0 * np.sin(0.05 * xx[mask])[:, None]
                there[inside] &= ~mask[v[inside], u[inside]]
            image += 255.0 * self.noise * self.rng.standard_normal(image.shape, dtype=np.float32)
            eyes.append(np.clip(np.round(image), 0, 255).astype(np.uint8))
            seen.append(float(there.mean()))
        T_tip = inverse(T_left) @ self.tip()
        if hand_eye is not None:
            T_tip = hand_eye @ T_tip
        truth = inverse(T_left) @ T_needle
        return Shot(time, (eyes[0], eyes[1]), truth, T_tip, min(seen))


@cache
def _world(needle: Needle) -> World:
    """Return the training rig with a needle."""
    prop = Prop(
        "needle",
        transform(np.eye(3), [0.0, 0.0, 0.5]),
        needle_shapes(needle, "steel"),
        Movable(1e-4, np.zeros(3), 1e-9 * np.eye(3), "source"),
        needle=needle,
    )
    rig = load_rig("training")
    return World(replace(rig, props=(*rig.props, prop)), dynamics="cad")


def held_pose(needle: Needle, rng: np.random.Generator) -> Array:
    """Return T_tip_needle of a random grasp: the wire runs along the tip's x axis, (4, 4)."""
    where = needle.arc * rng.uniform(0.25, 0.45)
    about = rng.uniform(-0.7, 0.7) + (np.pi if rng.random() < 0.5 else 0.0)
    along = rng.choice([-1.0, 1.0])
    tangent = np.array([along, 0.0, 0.0])
    radial = np.array([0.0, np.sin(about), np.cos(about)])
    grip = np.stack([radial, tangent, np.cross(radial, tangent)], axis=1)
    return transform(grip, [0.0, 0.0, HELD_M]) @ inverse(needle.pose(where))


def looking(at: Array, direction: Array, distance: float, roll: float) -> Array:
    """Return the pose of an eye that has a point on its axis, (4, 4)."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(z, [0.13, 0.97, 0.21])
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    return transform(turn @ matrix_from_rotation_vector([0.0, 0.0, roll]), at - distance * z)


def small_error(rng: np.random.Generator, about: Array, shift_m: float, turn_deg: float) -> Array:
    """Return a random pose near the identity: a turn about a point, and a shift, (4, 4)."""
    turn = np.radians(turn_deg) * rng.standard_normal(3) / np.sqrt(3.0)
    shift = shift_m * rng.standard_normal(3) / np.sqrt(3.0)
    there = transform(np.eye(3), about)
    return transform(np.eye(3), shift) @ there @ exp_twist([0, 0, 0, *turn]) @ inverse(there)


def _bent(known: StereoCalibration, shift: Array) -> StereoCalibration:
    eyes = []
    for eye, off in zip(known.eyes, shift, strict=True):
        K = eye.K.copy()
        K[:2, 2] += off
        eyes.append(Intrinsics(eye.width, eye.height, K, DISTORTION))
    return StereoCalibration(eyes[0], eyes[1], known.T_left_right)


def _pixels(points: Array, eye: Intrinsics) -> Array:
    from trocar.cameras.lens import project

    return np.nan_to_num(project(points, eye.K, eye.distortion), nan=-1e6)


def _half_plane(xx: Array, yy: Array, pixels: Array, veil: float) -> NDArray[np.bool_]:
    """Return the part on the swage's side of the end of a veil."""
    if veil >= 1.0:
        return np.ones(xx.shape, bool)
    k = round(veil * (len(pixels) - 1))
    way = pixels[min(k + 3, len(pixels) - 1)] - pixels[max(k - 3, 0)]
    return (xx - pixels[k, 0]) * way[0] + (yy - pixels[k, 1]) * way[1] < 0.0


def _waves(n: int, rng: np.random.Generator, octaves: tuple[int, ...], fall: float) -> Array:
    """Return smooth noise of unit deviation on a grid, (n, n)."""
    x = np.linspace(0.0, 2.0 * np.pi, n)
    found = np.zeros((n, n))
    for octave in octaves:
        for _ in range(12):
            kx, ky = rng.uniform(-octave, octave, 2)
            phase = rng.uniform(0.0, 2.0 * np.pi)
            found += octave**-fall * np.sin(kx * x[:, None] + ky * x[None, :] + phase)
    return found / found.std()


def _ground(body: int, rng: np.random.Generator, style: Style) -> list[ShapeRecord]:
    """Return bumpy ground, its highest points in z = 0, in patches of several reds if plain."""
    n = CELLS
    x = np.linspace(-0.5 * SIDE_M, 0.5 * SIDE_M, n)
    height = BUMP_M * _waves(n, rng, (8, 16, 32), 1.0)
    height -= height.max()
    slope = np.gradient(height, x[1] - x[0])
    normals = np.stack([-slope[1], -slope[0], np.ones_like(height)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    xx, yy = np.meshgrid(x, x)
    points = np.stack([xx, yy, height], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    corner = (i * n + j).ravel()
    halves = [(corner, corner + 1, corner + n + 1), (corner, corner + n + 1, corner + n)]
    faces = np.concatenate([np.stack(half, axis=1) for half in halves])
    blotch = _waves(n, rng, (20, 40), 0.5).ravel()
    veins = np.abs(_waves(n, rng, (16, 24), 0.5)).ravel() < 0.12
    kind = np.where(veins, 3, np.digitize(blotch, [-0.6, 0.6]))[faces[:, 0]]
    tints, material = TINTS, ""
    if style != "plain":
        kind, tints = np.zeros_like(kind), (TINTS[1] if style == "surgical" else PLATE,)
        material = "tissue" if style == "surgical" else ""
    return [
        ShapeRecord(body, f"tissue/{k}", "mesh", np.array([0.08, 0.08, 0.01]), np.eye(4),
                    (*tint, 1.0), 0.45, 0.0, 0.0, None, "", False,
                    (points, faces[kind == k]), normals, material)
        for k, tint in enumerate(tints)
    ]  # fmt: skip


def _thread(body: int, needle: Needle) -> list[ShapeRecord]:
    """Return a thread from the swage that bends away, in the needle's frame."""
    t = np.linspace(0.0, 1.0, 40)
    line = np.stack(
        [needle.radius + 0.004 * np.sin(5 * t), -0.035 * t, 0.006 * np.sin(4 * t) * t], axis=1
    )
    found = []
    for k, (a, b) in enumerate(pairwise(line)):
        z = (b - a) / np.linalg.norm(b - a)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        pose = transform(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (a + b))
        size = np.array([1.2e-4, 0.5 * np.linalg.norm(b - a), 0.0])
        found.append(ShapeRecord(body, f"thread/{k}", "capsule", size, pose, (*THREAD, 1.0), 0.3,
                                 0.0, 0.0, None, "", False))  # fmt: skip
    return found


#: A run: images a second, its length, and when the needle is hidden [Hz, s].
RATE_HZ, LENGTH_S, HIDDEN_S = 30.0, 2.4, (1.0, 2.0)
#: From then on a part is covered [s]. Source: our own choice, nine images.
VEILED_S = 0.3
#: The tool's path: speed, size, and how much it turns. Source: the goals' 20 mm/s. [m/s, m, rad]
SPEED_M_S, PATH_M, TURN_RAD = 0.02, 0.008, 0.25


def run(
    stage: Stage, seed: int, distance: float, veil: float = 0.0, length: float = LENGTH_S
) -> Iterator[Shot]:
    """Yield the images of a needle that a tool carries about, hidden for a second.

    Args:
        stage: where
        seed: of the grasp, the view, the path and the hand-eye error (1 mm, 1 deg)
        distance: from the left eye to the needle [m]
        veil: share of the needle that is covered after the first 0.3 s
        length: [s]
    """
    rng = np.random.default_rng([seed, 1])
    stage.reset()
    T_start = stage.tip()
    grasp = held_pose(stage.needle, rng)
    T_needle = T_start @ grasp
    middle = transform_points(T_needle, stage.needle.points(0.5 * stage.needle.arc))
    while True:
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        across, flat = -direction @ T_start[:3, 2], abs(direction @ T_needle[:3, 2])
        if 0.15 < across < 0.8 and flat > np.cos(np.radians(65.0)):
            break
    T_left = looking(middle, direction, distance, rng.uniform(-np.pi, np.pi))
    off = [rng.uniform(-0.1, 0.1) * distance, rng.uniform(-0.06, 0.06) * distance, 0.0]
    T_left = T_left @ transform(np.eye(3), off)
    ground = looking(middle - rng.uniform(0.024, 0.03) * direction, -direction, 0.0, 0.0)
    tilt = matrix_from_rotation_vector(rng.uniform(-0.25, 0.25, 3))
    T_tissue = ground @ transform(tilt, np.zeros(3))
    error = small_error(rng, (inverse(T_left) @ T_start)[:3, 3], 0.001, 1.0)
    ways = rng.standard_normal((3, 3))
    ways, _ = np.linalg.qr(ways)
    rate = SPEED_M_S / PATH_M / np.sqrt(1.5)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    for k in range(round(length * RATE_HZ)):
        time = k / RATE_HZ
        swing = np.sin(rate * np.array([1.0, 0.8, 1.3, 0.7]) * time + phases) - np.sin(phases)
        shift = PATH_M * ways @ (swing[:3] * [1.0, 1.0, 0.4])
        turn = matrix_from_rotation_vector(TURN_RAD * swing[3] * ways[:, 0])
        stage.set_tip(transform(turn @ T_start[:3, :3], T_start[:3, 3] + shift))
        hidden = HIDDEN_S[0] <= time < HIDDEN_S[1]
        veiled = veil if time >= VEILED_S else 0.0
        yield stage.shot(
            time, stage.tip() @ grasp, T_left, T_tissue, error, 1.0 if hidden else veiled
        )


def lying(stage: Stage, seed: int, distance: float) -> Iterator[Shot]:
    """Yield images of a needle that lies on tissue, beside the tools, without end.

    Args:
        stage: where
        seed: of its place and the view
        distance: from the left eye to the needle [m]
    """
    rng = np.random.default_rng([seed, 3])
    stage.reset()
    flat = transform(np.eye(3), [0.3, 0.0, 0.0])
    turn = matrix_from_rotation_vector([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    T_needle = transform(turn, [0.3, 0.0, 0.5 * stage.needle.wire + 2e-4])
    middle = transform_points(T_needle, stage.needle.points(0.5 * stage.needle.arc))
    around, tilt = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, np.radians(50.0))
    direction = np.array(
        [np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)]
    )
    T_left = looking(middle, direction, distance, rng.uniform(-np.pi, np.pi))
    off = [rng.uniform(-0.1, 0.1) * distance, rng.uniform(-0.06, 0.06) * distance, 0.0]
    T_left = T_left @ transform(np.eye(3), off)
    k = 0
    while True:
        yield stage.shot(k / RATE_HZ, T_needle, T_left, flat)
        k += 1

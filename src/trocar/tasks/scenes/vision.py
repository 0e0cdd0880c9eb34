"""Scenes of the endoscope's images: needle tracking, augmented reality, visual servoing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.lens import plane_from_pixels, undistort
from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.scenes import Goal, Scene
from trocar.errors import InputError
from trocar.geometry import inverse, transform, transform_points
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
)
from trocar.rendering import Endoscope, Look, StereoFrame
from trocar.rendering.look import bleeding_place, vignette_of
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.motions import UP, Hand, Motion, together
from trocar.tasks.task import Task
from trocar.tasks.vision.images import opencv
from trocar.tasks.vision.needle_fit import change
from trocar.tasks.vision.needle_tracking import JAWS, Holder, NeedleEstimate, NeedleTracker
from trocar.tasks.vision.overlay import (
    BLUE,
    GREEN,
    ORANGE,
    WHITE,
    Area,
    Banner,
    Curve,
    Item,
    View,
    axes,
    distance,
    ghost,
    overlaid,
    stitch,
)
from trocar.tasks.vision.servoing import ServoSettings, VisualServo

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Commands of 20 ms between images. Source: our own choice, 25 images a second as in videos.
COMMANDS = 2
#: Look of the images unless the scene has another: style, and noise as a ratio of white. Source:
#: our own choice; the goals of tracking.
LOOK: Mapping[str, Any] = {"style": "surgical", "noise": 0.03}
#: Directions in which a box's outline is touched, and rounds of weights. Source: our own choice.
DIRECTIONS, ROUNDS = 36, 12
#: Size of the images. Source: a Classic's scope, digitised.
PRESET = "dvrk_sd_640x480"


class EndoscopeTask(Task):
    """A task that looks at the endoscope's images 25 times a second.

    Attributes:
        shown: the newest image of the left eye with what is drawn into it
    """

    sees = True

    def __init__(self, scene: Scene) -> None:
        self._scope: Endoscope | None = None
        self._eyes = load_stereo_camera(PRESET)
        self.overlay = self._overlaid
        super().__init__(scene)

    def begin(self) -> None:
        """Begin to count, with no image seen."""
        self._looks, self.shown = -1, None  # the first look, of a reset, opens no renderer
        self._items: list[Item] = []
        self._worked = False
        T_world_left = self.world.camera("endoscope").T_world_camera @ self._eyes.mounts[0]
        self._T_tip_left = inverse(self._measured("ECM")) @ T_world_left
        super().begin()

    def look(self) -> None:
        """Judge as other tasks, then take in images when they are due."""
        super().look()
        if self._looks % COMMANDS == 0 and not self.done:
            frame = self.scope().capture_next()
            self._items = self.see(frame)
            self.shown = self._overlaid(frame)
        self._looks += 1

    def _overlaid(self, frame: StereoFrame, eye: int = 0) -> Picture:
        """Return an eye's image of any frame with the newest overlays, projected anew."""
        return overlaid(frame.eyes[eye], View.of(frame, eye), self._items)

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether a goal is met, at the end of the work."""
        return self._worked and super().met(goal, at)

    def scope(self) -> Endoscope:
        """Return the endoscope, opened at the first call."""
        if self._scope is None:
            movable = [prop.name for prop in self.world.rig.objects]
            rig = self.world.rig
            of_rig = {"vignette": vignette_of(rig), "bleeding_at": bleeding_place(rig)}
            own: dict[str, Any] = {**LOOK, **of_rig}
            look = Look(**{**own, **self.scene.look})
            self._scope = Endoscope(self.world, preset=PRESET, visible=movable, look=look)
        return self._scope

    def see(self, frame: StereoFrame) -> list[Item]:
        """Take in a frame and return the items to draw into it."""
        raise NotImplementedError

    def measured_left(self) -> Array:
        """Return the left eye in the world as the ECM's joints have it, (4, 4)."""
        return self._measured("ECM") @ self._T_tip_left

    def _measured(self, arm: str) -> Array:
        """Return an arm's tip in the world as its joints have it, (4, 4)."""
        return self.world.reference_pose(arm) @ self.world.arms[arm].local.measured_cp().matrix

    def picture(self, capture: Callable[[], Picture]) -> Picture:  # noqa: ARG002  it has its own
        """Return the newest image with what is drawn into it."""
        if self.shown is None:  # not looked at yet
            return self._overlaid(self.scope().capture())
        return self.shown

    def close(self) -> None:
        """Release the graphics library."""
        if self._scope is not None:
            self._scope.close()
            self._scope = None


class NeedleTracking(EndoscopeTask):
    """An arm picks up a needle and carries it about; a tracker follows it in the images."""

    task = "needle-tracking"

    #: Duration and size of the path in the air, and rotation of the needle on it. Source: our own
    #: choice; the tip moves at up to 25 mm/s. [s, m, rad]
    CARRY_S, PATH_M, TURN_RAD = 5.0, np.array([0.012, 0.007, 0.003]), 0.35
    #: Beginning of that path: before the scope, in its axis, in the world [m].
    MIDDLE = np.array([0.0, -0.012, 0.018])
    #: Height of the grasp above the wire, and of the way. Source: as in needle-pick. [m]
    RAISED_M, WAY_M = 0.0012, 0.02
    topics: Mapping[str, str] = {
        "needle/estimate": "pose in the left eye's frame, standard deviations and state, as JSON",
        "needle/truth": "true pose, centre line in both eyes' pixels and visible share, as JSON",
    }

    def begin(self) -> None:
        """Begin to count, with a new tracker."""
        (prop,) = [one for one in self.world.rig.objects if one.needle is not None]
        assert prop.needle is not None  # noqa: S101
        self.name, self.needle = prop.name, prop.needle
        self.tracker = NeedleTracker(self._eyes, self.needle)
        self._rows: list[tuple[float, ...]] = []
        self._messages: dict[str, Any] = {}
        super().begin()
        self._reach = Hand(self, self.arms[0]).reach

    def see(self, frame: StereoFrame) -> list[Item]:
        """Track the needle and compare with the truth; draw the estimate."""
        T_left_world = inverse(self.measured_left())
        (arm,) = (one for one in self.arms if self.world.arms[one].description.type == "PSM")
        if self.referee.held.get(arm) == self.name:
            holder = Holder(arm, T_left_world @ self._measured(arm), self._reach, JAWS)
        else:
            holder = Holder("world", T_left_world)
        right = frame.right
        assert right is not None  # noqa: S101  of a stereo camera
        found = self.tracker.update(frame.time, frame.left, right, holder)
        self._note(frame, found)
        items: list[Item] = [Banner(f"needle: {found.status}", _colour(found))]
        if found.T_left_needle is not None:
            items += ghost(
                self.needle, frame.T_world_camera[0] @ found.T_left_needle, _colour(found)
            )
        return items

    def _note(self, frame: StereoFrame, found: NeedleEstimate) -> None:
        truth = inverse(frame.T_world_camera[0]) @ self.object_pose(self.name)
        seen = np.nan_to_num(frame.visible[self.name])
        row = [frame.time, float(min(seen)), float(found.status == "tracking")]
        if found.T_left_needle is not None:
            row += [*pose_errors(found.T_left_needle, truth)]
            x = change(found.T_left_needle, truth)
            row.append(float(x @ np.linalg.solve(found.covariance, x)))
        else:
            row += [np.nan] * 4
        self._rows.append(tuple(row))
        line = transform_points(
            self.object_pose(self.name), self.needle.points(np.linspace(0, self.needle.arc, 41))
        )
        self._messages = {
            "needle/estimate": {
                "stamp": frame.time,
                "status": found.status,
                "pose": None if found.T_left_needle is None else _pose(found.T_left_needle),
                "sigma": None
                if found.T_left_needle is None
                else [found.position_sigma, found.normal_sigma, found.roll_sigma],
            },
            "needle/truth": {
                "stamp": frame.time,
                "pose": _pose(truth),
                "line_px": [np.round(frame.project(line, eye), 2).tolist() for eye in range(2)],
                "visible": [float(share) for share in seen],
            },
        }

    def messages(self) -> dict[str, Any]:
        """Return estimate and truth of the newest images."""
        found, self._messages = self._messages, {}
        return found

    def figures(self) -> dict[str, float]:
        """Return errors of the tracker, by name with their units."""
        rows = np.array(self._rows).reshape(-1, 7)
        known = rows[np.isfinite(rows[:, 3])]
        if not len(known):
            return {"found [s]": np.inf}
        seen = known[(known[:, 2] > 0.0) & (known[:, 1] >= 0.5)]
        medians = np.median(seen[:, 3:6], axis=0) if len(seen) else np.full(3, np.nan)
        return {
            "found [s]": float(known[0, 0] - rows[0, 0]),
            "tracked [%]": float(100.0 * known[:, 2].mean()),
            "position [mm]": 1e3 * float(medians[0]),
            "normal [deg]": float(np.degrees(medians[1])),
            "roll [deg]": float(np.degrees(medians[2])),
            "NEES": float(seen[:, 6].mean()) if len(seen) else np.nan,
        }

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        hand = Hand(self, self.arms[0])
        return together(self, **{hand.arm: self._carry(hand)})

    def _carry(self, hand: Hand) -> Motion:
        ((_, at),) = self.goals
        yield from hand.wait(0.5)
        T = self.object_pose(self.name)
        middle = T[:3, 3] + self.needle.radius * T[:3, 1] + self.RAISED_M * UP
        angle = float(np.arctan2(T[1, 1], T[0, 1]))
        yield from hand.pick(middle, angle, self.WAY_M, 0.5)
        yield from hand.shift(self.MIDDLE - self.object_pose(self.name)[:3, 3])
        yield from self._about(hand, self.controller.target(hand.arm), self.CARRY_S)
        self._worked = True
        yield from hand.shift(at - self.object_pose(self.name)[:3, 3])

    def _about(self, hand: Hand, start: Array, time: float) -> Motion:
        """Carry the needle along a path that returns to where it begins."""
        count = round(time / PERIOD_S)
        for k in range(1, count + 1):
            phase = 2.0 * np.pi * k / count
            swing = np.array([np.sin(phase), np.sin(2.0 * phase), 1.0 - np.cos(phase)])
            turn = self.TURN_RAD * swing * [1.0, 0.6, 0.5]
            goal = transform(
                matrix_from_rotation_vector(turn) @ start[:3, :3],
                start[:3, 3] + self.PATH_M * swing,
            )
            yield _towards(hand, goal)


class AugmentedReality(NeedleTracking):
    """The scope moves; what the tracker found and what is planned stays where it belongs."""

    task = "augmented-reality"

    #: Planned stitch on the bed, a region that tools shall not enter, in the world. Source: our own
    #: choice. [m]
    ENTRY, EXIT = np.array([-0.022, 0.012, 0.005]), np.array([-0.022, -0.004, 0.005])
    REGION = np.array([[0.02, -0.02], [0.045, -0.02], [0.045, 0.015], [0.02, 0.015]])
    #: The scope's swing in its first two joints, and its time. Source: our own choice. [rad, s]
    SWING, SWING_S = np.array([0.05, 0.04]), 4.0

    def see(self, frame: StereoFrame) -> list[Item]:
        """Track the needle; draw it, the plan, distances and a forbidden region."""
        banner, *items = super().see(frame)
        arm = self.arms[0]
        tip = self._measured(arm) @ [0.0, 0.0, self._reach, 1.0]
        corners = np.column_stack([self.REGION, np.full(len(self.REGION), 0.0051)])
        inside = bool((tip[:2] > self.REGION.min(0)).all() and (tip[:2] < self.REGION.max(0)).all())
        items += stitch(self.ENTRY, self.EXIT, -UP, self.needle.radius)
        items += [Area(corners)]
        items += axes(transform(np.eye(3), [0.0, -0.03, 0.0051]))
        found = self.tracker.estimate
        if found.T_left_needle is not None:
            point = frame.T_world_camera[0] @ found.T_left_needle @ self.needle.tip
            items += distance(point[:3, 3], self.ENTRY)
        return [Banner("keep out", ORANGE) if inside else banner, *items]

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy: the needle is carried, the scope swings."""
        hand = Hand(self, self.arms[0])
        return together(self, **{hand.arm: self._carry(hand), self.arms[1]: self._swing()})

    def _swing(self) -> Motion:
        k = 0
        while not self.done:
            phase = 2.0 * np.pi * k * PERIOD_S / self.SWING_S
            rate = 2.0 * np.pi / self.SWING_S * self.SWING * [np.cos(phase), np.cos(2.0 * phase)]
            yield np.array([*rate, 0.0, 0.0])
            k += 1


class VisualServoing(EndoscopeTask):
    """The ECM keeps a blue block in view by its images, while a PSM carries it about."""

    task = "visual-servoing"

    #: Time of the scripted work, and half the range of the block's places. Source: our own choice.
    #: [s, m]
    WORK_S, RANGE_M = 60.0, np.array([0.026, 0.022, 0.008])
    #: Speed of the block. Source: the goals have 10 mm/s. [m/s]
    SPEED_M_S = 0.02
    #: Depth from the camera at which the block is kept [m]. Source: our own choice.
    DEPTH_M = 0.09
    #: Blue minus red of the block, at least, and pixels of it. Source: our own choice. [, px]
    BLUE, LEAST_PX = 25.0, 25
    topics: Mapping[str, str] = {
        "servo/target": "pixels of the target in both eyes, and its visible share, as JSON"
    }

    def begin(self) -> None:
        """Begin to count, with a new servo."""
        self._rows: list[tuple[float, ...]] = []
        self._messages: dict[str, Any] = {}
        self._ecm = next(
            name for name in self.arms if self.world.arms[name].description.type == "ECM"
        )
        super().begin()
        self.servo = VisualServo(
            self.world.arms[self._ecm].description,
            self._eyes,
            self._T_tip_left,
            ServoSettings(depth=self.DEPTH_M),
        )

    def see(self, frame: StereoFrame) -> list[Item]:
        """Find the block in both eyes, and record its pixels."""
        pixels = [blue_box(image) for image in frame.eyes]
        left, right = pixels
        q = self.world.arms[self._ecm].joints.positions()
        if left is not None and right is not None:
            with suppress(InputError):  # a blob of something else, whose rays do not meet
                self.servo.see(frame.time, q, left, right)
        size = np.array(self._eyes.left.size)
        at = self.object_pose("block")[:3, 3]
        true = [frame.project(at, eye) for eye in range(2)]
        inside = all(bool(((p > 0.0) & (p < size - 1.0)).all()) for p in true)
        share = float(np.nan_to_num(frame.visible["block"]).min())
        x, y, depth = transform_points(
            self._eyes.mounts[0] @ inverse(frame.T_world_camera[0]), at
        )  # midway between the eyes
        off = self._eyes.left.K[0, 0] / depth * np.array([x, y])
        rcm = self.world.health().rcm_error_m
        self._rows.append((frame.time, float(inside and share > 0.0), np.hypot(*off), depth, rcm))
        self._messages = {
            "servo/target": {
                "stamp": frame.time,
                "pixels": [None if p is None else p.tolist() for p in pixels],
                "visible": share,
            }
        }
        items: list[Item] = [Banner("target seen" if left is not None else "target lost", WHITE)]
        if left is not None:
            point = transform_points(frame.T_world_camera[0], self._ahead(left, depth))
            items += [Curve(point + 0.006 * ring, BLUE) for ring in (_ring(frame),)]
        return items

    def _ahead(self, pixel: Array, depth: float) -> Array:
        flat = undistort(plane_from_pixels(pixel, self._eyes.left.K), self._eyes.left.distortion)
        return depth * np.append(flat, 1.0)

    def messages(self) -> dict[str, Any]:
        """Return the block's pixels in the newest images."""
        found, self._messages = self._messages, {}
        return found

    def figures(self) -> dict[str, float]:
        """Return the errors of keeping the block in view, by name with units."""
        rows = np.array(self._rows).reshape(-1, 5)
        if not len(rows):
            return {}
        late = rows[rows[:, 0] >= min(rows[0, 0] + 2.0, rows[-1, 0])]
        return {
            "visible [%]": float(100.0 * rows[:, 1].mean()),
            "off the middle, median [px]": float(np.median(late[:, 2])),
            "90 % [px]": float(np.percentile(late[:, 2], 90)),
            "depth error, median [mm]": 1e3 * float(np.median(np.abs(late[:, 3] - self.DEPTH_M))),
            "RCM error [um]": 1e6 * float(rows[:, 4].max()),
        }

    def policy(self) -> Iterator[Array]:
        """Yield the actions: the PSM works for a minute, the ECM follows the images."""
        hand = Hand(self, next(name for name in self.arms if name != self._ecm))
        return together(self, **{hand.arm: self._work(hand), self._ecm: self._follow()})

    def _work(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals
        name = goal.object
        yield from hand.wait(1.0)
        end = self.world.time + self.WORK_S
        T = self.object_pose(name)
        yield from hand.pick(T[:3, 3], float(np.arctan2(T[1, 1], T[0, 1])), 0.02, 0.7)
        rng = np.random.default_rng(round(1e6 * abs(float(T[0, 3]))))
        while self.world.time < end:
            place = np.array([0.0, 0.0, 0.026]) + self.RANGE_M * rng.uniform(-1.0, 1.0, 3)
            yield from hand.shift(place - self.object_pose(name)[:3, 3], self.SPEED_M_S)
        self._worked = True
        yield from hand.shift(at - self.object_pose(name)[:3, 3])

    def _follow(self) -> Motion:
        arm = self.world.arms[self._ecm]
        while not self.done:
            yield self.servo.velocity(self.world.time, arm.joints.positions())


def blue_box(image: Picture) -> Array | None:
    """Return the middle of the largest blue box in an image, (2,) [px], None without one.

    A box's outline is symmetrical about its middle, so the two lines that touch it in a direction
    have the middle halfway. Where jaws hide a corner some directions are off, and weigh little:
    least absolute deviations, by iterated weights.
    """
    cv2 = opencv()
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5).astype(np.float32)
    blue = (smooth[..., 2] - smooth[..., 1] > VisualServoing.BLUE).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(blue)
    if count < 2:
        return None
    best = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    if stats[best, cv2.CC_STAT_AREA] < VisualServoing.LEAST_PX:
        return None
    inside = np.argwhere(labels == best)[:, ::-1].astype(np.int32)
    outline = cv2.convexHull(inside)[:, 0].astype(np.float64)
    angles = np.linspace(0.0, np.pi, DIRECTIONS, endpoint=False)
    normals = np.stack([np.cos(angles), np.sin(angles)])
    reach = outline @ normals
    halfway = 0.5 * (reach.max(axis=0) + reach.min(axis=0))
    middle, weight = outline.mean(axis=0), np.ones(DIRECTIONS)
    for _ in range(ROUNDS):
        weighed = normals * weight
        middle = np.asarray(np.linalg.solve(weighed @ normals.T, weighed @ halfway), np.float64)
        weight = 1.0 / np.maximum(np.abs(halfway - middle @ normals), 0.3)
    return middle


def pose_errors(found: Array, truth: Array) -> tuple[float, float, float]:
    """Return errors of the circle's centre [m], the plane's normal and the roll in it [rad]."""
    tilt = np.cross(found[:3, 2], truth[:3, 2])
    sine, cosine = float(np.linalg.norm(tilt)), float(found[:3, 2] @ truth[:3, 2])
    angle = float(np.arctan2(sine, cosine))
    level = matrix_from_rotation_vector(tilt / max(sine, 1e-12) * angle) @ found[:3, :3]
    x = truth[:3, :3].T @ level[:, 0]
    shift = float(np.linalg.norm(found[:3, 3] - truth[:3, 3]))
    return shift, angle, abs(float(np.arctan2(x[1], x[0])))


def _towards(hand: Hand, goal: Array) -> Array:
    """Return the action that brings a tip to a pose within a command."""
    now = hand.task.controller.target(hand.arm)
    turn = rotation_vector_from_matrix(goal[:3, :3] @ now[:3, :3].T)
    way = goal[:3, 3] - now[:3, 3]
    return np.array([*(way / PERIOD_S), *(turn / PERIOD_S), hand.jaw])


def _ring(frame: StereoFrame) -> Array:
    """Return a circle that faces the left eye, (n, 3)."""
    a = np.linspace(0.0, 2.0 * np.pi, 33)[:, None]
    R = frame.T_world_camera[0, :3, :3]
    return np.cos(a) * R[:, 0] + np.sin(a) * R[:, 1]


def _colour(found: NeedleEstimate) -> tuple[int, int, int]:
    return GREEN if found.status == "tracking" else ORANGE


def _pose(T: Array) -> list[float]:
    """Return position and quaternion wxyz."""
    return [*T[:3, 3].tolist(), *quaternion_from_matrix(T[:3, :3]).tolist()]

"""A needle in the images of both eyes, from frame to frame: an iterated extended Kalman filter.

The state is the needle's pose, an offset of each eye's images (2 px each), and an offset of the
visible ends along the arc: shading and calibration err alike all along the needle and over many
frames, and without states for that the covariance is too small. A needle moves with its carrier:
the tool that holds it, whose pose follows from kinematics, or the world that it lies in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.descriptions.needles import Needle
from trocar.errors import InputError
from trocar.geometry import inverse, rotation_vector_from_matrix
from trocar.inputs import check_numbers, check_type, check_whole
from trocar.tasks.vision.eyes import Eyes, Picture, checked_pose
from trocar.tasks.vision.needle_fit import (
    END_RAD,
    SIGMA_PX,
    WORTH,
    Colours,
    FitQuality,
    NeedleFit,
    Rod,
    change,
    moved,
)
from trocar.tasks.vision.needle_search import NeedleSearch, flipped, mirrored

Array = NDArray[np.float64]
Status = Literal["searching", "tracking", "predicting"]

#: Standard deviation of each eye's offset [px] and of the ends' [rad], and how long they last [s].
#: Source: the goals' calibrations, 0.3 px off; prototypes on the rendered endoscope.
BIAS_PX, BIAS_RAD, LASTS_S = 0.3, np.deg2rad(2.0), 0.6
#: Random walk of a needle in its carrier [m, rad per root of a second], and errors of the carrier's
#: motion, as a share of it. Source: our own choice; the second is 1 degree of a hand-eye error.
WALK_M, WALK_RAD, MOTION = 3e-4, np.deg2rad(0.6), 0.02
#: The same after another carrier has taken it. Source: our own choice. [m, rad]
TAKEN_M, TAKEN_RAD = 0.003, np.deg2rad(15.0)
#: Standard deviations of a found pose. Source: our own choice, above those of prototypes. [m, rad]
FOUND_M, FOUND_RAD = 0.0015, np.deg2rad(6.0)
#: Conditions of an update: least ratios of the profiles (both eyes, the worse eye), largest
#: residuals [px] and squared distance from the prediction. Source: prototypes.
SHARE, WORST, RMS_PX, GATE = 0.22, 0.1, 0.9, 45.0
#: Least ratio of the worse eye's profiles in clear images. Source: our own choice.
CLEAR = 0.4
#: Least ratio of the profiles of a found pose. Source: our own choice.
BELIEVED = 0.3
#: Largest residuals of a found pose [px], and the ratio of the worse eye's profiles above which no
#: other pose is tried. Source: needles in 60 rendered scenes: right ones have 0.1 to 0.4 px and 0.5
#: or more, wrong ones 0.5 to 1 px or fewer.
FOUND_PX, SURE = 0.45, 0.55
#: Time without an image of the needle after which it is searched anew. Source: our own choice. [s]
LOST_S = 2.0
#: Lengths of profiles [px]. Source: our own choice.
SHORTEST, LONGEST = 4, 20
#: Iterations of an update, one fewer where profiles are no longer than this [px]; and updates from
#: one look at the needle's colours to the next. Source: prototypes; more change nothing.
ITERATIONS, NEAR_PX, COLOURS_EVERY = 3, 8.0, 4


class NeedleEstimate(NamedTuple):
    """Estimate of a needle's pose.

    Attributes:
        time: of the images [s]
        status: "tracking": seen in these images; "predicting": not seen, carried on;
            "searching": never seen, or lost
        T_left_needle: its pose in the left eye's frame, (4, 4), None while searching
        covariance: of (translation, rotation about the circle's centre) in the left eye's axes,
            (6, 6) [m, rad]
        quality: its agreement with the images, None while searching or predicting
    """

    time: float
    status: Status
    T_left_needle: Array | None
    covariance: Array
    quality: FitQuality | None

    @property
    def position_sigma(self) -> float:
        """Standard deviation of the circle's centre, root of the sum over axes [m]."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def normal_sigma(self) -> float:
        """Standard deviation of the plane's normal, root of the sum of both tilts [rad]."""
        if self.T_left_needle is None:
            return float(np.sqrt(np.trace(self.covariance[3:, 3:])))
        R = self.T_left_needle[:3, :3]
        own = R.T @ self.covariance[3:, 3:] @ R
        return float(np.sqrt(own[0, 0] + own[1, 1]))

    @property
    def roll_sigma(self) -> float:
        """Standard deviation of the rotation in the plane [rad]."""
        if self.T_left_needle is None:
            return float(np.sqrt(self.covariance[5, 5]))
        n = self.T_left_needle[:3, 2]
        return float(np.sqrt(n @ self.covariance[3:, 3:] @ n))


@dataclass(frozen=True)
class Holder:
    """Carrier of a needle: the tool that holds it, or the surface that it lies on.

    Attributes:
        name: "PSM1", "world", ...
        T_left_holder: its pose in the left eye's frame at the images' stamp, (4, 4); of a tool the
            tip's, z along the fingers, x along the jaws' hinge
        reach: distance from a tool's tip to its grip [m]; None of a surface
        rods: parts of the tool that may cover the needle, in the holder's frame: start, end, radius
    """

    name: str
    T_left_holder: Array
    reach: float | None = None
    rods: tuple[Rod, ...] = ()

    def __post_init__(self) -> None:
        """Check the pose, lengths and rods."""
        name = check_type(self.name, str, "name of a holder")
        T = checked_pose(self.T_left_holder, f"T_left_holder of {name}")
        object.__setattr__(self, "T_left_holder", T)
        if self.reach is not None:
            check_numbers(self.reach, (), f"reach of {name} [m]", 0.0)
        check_type(self.rods, tuple, f"rods of {name}")
        for k, rod in enumerate(self.rods):
            what = f"rods[{k}] of {name}"
            check_type(rod, tuple, what)
            if len(rod) != 3:
                raise InputError(f"{what}: got {len(rod)} entries; allowed: start, end, radius")
            for end, side in zip(rod, ("start", "end"), strict=False):
                check_numbers(end, (3,), f"{what}: {side} [m]")
            check_numbers(rod[2], (), f"{what}: radius [m]", 0.0)


#: The jaws of a large needle driver about its tip. Source: its solids, with room. [m]
JAWS: tuple[Rod, ...] = (
    (np.array([0.0, 0.0, -0.012]), np.zeros(3), 0.0046),
    (np.zeros(3), np.array([0.0, 0.0, 0.0105]), 0.0024),
)
#: A needle that lies still before a camera that stands still.
RESTING = Holder("world", np.eye(4))


class NeedleTracker:
    """Follows a needle in stereo images.

    Args:
        calibration: of both eyes, with lenses
        needle: its dimensions
        seed: of the random choices of a search

    Attributes:
        estimate: the newest
    """

    def __init__(self, calibration: StereoCalibration, needle: Needle, seed: int = 0) -> None:
        self._fit = NeedleFit(Eyes(calibration), check_type(needle, Needle, "needle"))
        self._rng = np.random.default_rng(check_whole(seed, "seed"))
        self._holder: Holder | None = None
        self.estimate = NeedleEstimate(-np.inf, "searching", None, np.full((6, 6), np.inf), None)
        self._forget()

    def _forget(self) -> None:
        self._pose: Array | None = None
        self._covariance: Array = np.zeros((11, 11))
        self._bias = np.zeros(5)
        self._colours: Colours | None = None
        self._seen = -np.inf
        self._updates = 0

    def start(self, time: float, T_left_needle: ArrayLike, covariance: ArrayLike) -> None:
        """Begin with a pose that is known from elsewhere, instead of a search.

        Args:
            time: of the next images, or before [s]
            T_left_needle: (4, 4)
            covariance: (6, 6) [m, rad]

        Raises:
            InputError: no time, no pose, or no covariance: not symmetric and positive
        """
        given = check_numbers(time, (), "time [s]"), check_numbers(covariance, (6, 6), "covariance")
        T = checked_pose(T_left_needle, "T_left_needle")
        if not np.allclose(given[1], given[1].T) or np.linalg.eigvalsh(given[1])[0] <= 0.0:
            raise InputError(
                f"covariance: got {given[1].tolist()}; allowed: symmetric with positive eigenvalues"
            )
        self._forget()
        self._pose, self._covariance[:6, :6] = T.copy(), given[1]
        self._covariance[6:, 6:] = np.diag([BIAS_PX**2] * 4 + [BIAS_RAD**2])
        self._seen = float(given[0])

    def update(
        self, time: float, left: ArrayLike, right: ArrayLike, holder: Holder = RESTING
    ) -> NeedleEstimate:
        """Estimate the needle's pose from a pair of images.

        Args:
            time: stamp of the images, later than of those before [s]
            left, right: (h, w, 3) bytes, red, green, blue
            holder: carrier of the needle

        Raises:
            InputError: images out of order, or of another size or type than the calibration's
        """
        before = self.estimate.time
        time = float(check_numbers(time, (), "time of the images [s]"))
        check_type(holder, Holder, "holder")
        if not time > before:
            raise InputError(f"images: got {time:g} s after {before:g} s; allowed: in order")
        images = self._fit.eyes.check(left, right)
        if not np.isfinite(before):
            self._fit.eyes.check_order(*images)
        self._predict(time - before if np.isfinite(before) else 0.0, holder)
        rods = _placed(holder)
        quality: FitQuality | None = None
        if self._pose is not None and time - self._seen > LOST_S:
            self._pose = None
        if self._pose is None:
            quality = self._search(images, holder, rods)
        else:
            quality = self._update(images, rods)
        if quality is not None:
            self._seen = time
        self._holder = holder
        if self._pose is None:
            status: Status = "searching"
            covariance = np.full((6, 6), np.inf, np.float64)
        else:
            status = "predicting" if quality is None else "tracking"
            covariance = self._covariance[:6, :6].copy()
        T = None if self._pose is None else self._pose.copy()
        self.estimate = NeedleEstimate(time, status, T, covariance, quality)
        return self.estimate

    # ------------------------------------------------------------------ filter

    def _predict(self, passed: float, holder: Holder) -> None:
        """Carry the needle on, with its carrier."""
        before = self._holder
        if self._pose is None or before is None:
            return
        same = before.name == holder.name
        D = holder.T_left_holder @ inverse(before.T_left_holder) if same else np.eye(4)
        old = self._pose[:3, 3].copy()
        self._pose = D @ self._pose
        way = float(np.linalg.norm(self._pose[:3, 3] - old))
        turn = float(np.linalg.norm(rotation_vector_from_matrix(D[:3, :3])))
        keep = float(np.exp(-passed / LASTS_S))
        B = np.diag([0.0] * 6 + [keep] * 5)
        B[:3, :3] = B[3:6, 3:6] = D[:3, :3]
        self._bias *= keep
        shift = WALK_M**2 * passed + (MOTION * way) ** 2 + (0.0 if same else TAKEN_M**2)
        spin = WALK_RAD**2 * passed + (MOTION * turn) ** 2 + (0.0 if same else TAKEN_RAD**2)
        fresh = (1.0 - keep**2) * np.array([BIAS_PX**2] * 4 + [BIAS_RAD**2])
        self._covariance = B @ self._covariance @ B.T + np.diag([shift] * 3 + [spin] * 3 + [*fresh])

    def _update(
        self, images: Sequence[Picture], rods: Sequence[Rod], *, again: bool = True
    ) -> FitQuality | None:
        """Take in images about the predicted pose; None where they do not show the needle.

        Images that show it clearly, elsewhere than predicted, are taken in once more without trust
        in the prediction: something else moved it.
        """
        fit, T0, bias0 = self._fit, self._pose, self._bias
        assert T0 is not None  # noqa: S101
        if self._colours is None:
            self._colours = fit.metallic(images, T0)
        information = np.linalg.inv(self._covariance)
        arm = 1.2 * fit.needle.radius
        spread = np.sqrt(np.trace(self._covariance[:3, :3]) / 3.0)
        spread += arm * np.sqrt(np.trace(self._covariance[3:6, 3:6]) / 3.0)
        reach = 3.0 * spread * fit.eyes.focal / max(float(T0[2, 3]), 0.01) + 3.0
        longest = float(np.clip(np.ceil(reach), SHORTEST, LONGEST))
        views = fit.views(images, T0, self._colours, 2.0 * longest + 12.0)
        covers = fit.covers(rods)
        pose, bias = T0, bias0
        count = len(fit.angles)
        hessian, quality = information, FitQuality(0.0, 0.0, np.inf)
        for k in range(ITERATIONS if longest > NEAR_PX else ITERATIONS - 1):
            length = longest if k == 0 else max(float(SHORTEST), np.ceil(0.5 * longest))
            rows = fit.rows(views, pose, length, covers)
            by_bias = np.zeros((2 * count, 5))
            by_bias[:count, 0:2], by_bias[count:, 2:4] = rows.normal[:count], rows.normal[count:]
            rest = rows.offset - by_bias @ bias
            limit = max(1.5, 0.25 * length if k == 0 else 0.0)
            pull = np.minimum(1.0, limit / np.maximum(np.abs(rest), 1e-6))
            weight = rows.weight * fit.thick * pull
            H = np.concatenate([rows.jacobian, by_bias], axis=1)
            scaled = (H * weight[:, None]).T * (WORTH / SIGMA_PX**2)
            matrix, b = scaled @ H, scaled @ rest
            if k:
                ends = fit.ends(views, pose, covers)
                row = np.concatenate([np.zeros(3), pose[:3, 2], np.zeros(4), [1.0]])
                rest = ends.angle - bias[4]
                pull = np.minimum(1.0, 2.0 * END_RAD / np.maximum(np.abs(rest), 1e-9))
                strength = (ends.weight > 0.3) * pull / END_RAD**2
                matrix = matrix + strength.sum() * np.outer(row, row)
                b = b + (strength @ rest) * row
            hessian = matrix + information
            back = np.concatenate([change(pose, T0), bias0 - bias])
            x = np.asarray(np.linalg.solve(hessian, b + information @ back), np.float64)
            pose, bias = moved(pose, x), bias + x[6:]
            # What the step leaves of the offsets, without another look at the images.
            quality = fit.quality(rows._replace(offset=rows.offset - rows.jacobian @ x[:6]))
        moves = np.concatenate([change(T0, pose), bias - bias0])
        if quality.share < SHARE or quality.worst < WORST or quality.rms > RMS_PX:
            return None
        if moves @ information @ moves > GATE:
            if not again or quality.worst < CLEAR:
                return None
            self._covariance[:6, :6] += np.diag([TAKEN_M**2] * 3 + [TAKEN_RAD**2] * 3)
            return self._update(images, rods, again=False)
        self._pose, self._bias = pose, bias
        self._covariance = np.asarray(np.linalg.inv(hessian), np.float64)
        self._updates += 1
        if quality.share > 0.4 and self._updates % COLOURS_EVERY == 1:
            colours = fit.colours(images, pose)
            if colours.separation > 0.6 * self._colours.separation:
                self._colours = colours
        return quality

    # ------------------------------------------------------------------ search

    def _search(
        self, images: Sequence[Picture], holder: Holder, rods: Sequence[Rod]
    ) -> FitQuality | None:
        """Look for the needle in the whole images; None where it is not found."""
        fit = self._fit
        search = NeedleSearch(fit.eyes, fit.needle, images)
        if holder.reach is None:
            poses = search.free(self._rng)
        else:
            poses = search.held(holder.T_left_holder, holder.reach)
        found: list[tuple[float, Array, FitQuality, Colours]] = []
        for pose in poses:
            pose, quality, colours = fit.refine(images, pose, rods=rods)
            found.append((_score(quality), pose, quality, colours))
            if quality.worst > SURE and quality.rms < FOUND_PX:
                break
        if not found:
            return None
        found.sort(key=lambda one: one[0], reverse=True)
        for _, pose, _, colours in found[:2]:
            pose, quality, colours = fit.refine(
                images, mirrored(pose), (8.0, 6.0, 5.0, 4.0), colours, rods
            )
            found.append((_score(quality), pose, quality, colours))
        _, pose, quality, colours = max(found, key=lambda one: one[0])
        if min(quality.share, 2.0 * quality.worst) < BELIEVED:
            return None
        # Both ways round: the thicker end is the swage.
        ways: list[tuple[float, Array, FitQuality, Colours]] = []
        for start in (pose, flipped(fit.needle, pose)):
            views = fit.views(images, start, colours, 24.0)
            limit = np.pi if holder.reach is None else np.pi / 4.0
            turned = fit.roll(views, start, limit)
            pose, quality, own = fit.refine(images, turned, (5.0, 4.0, 4.0), colours, rods)
            views = fit.views(images, pose, own, 24.0)
            ways.append((quality.share + fit.blunter(views, pose), pose, quality, own))
        _, pose, quality, colours = max(ways, key=lambda one: one[0])
        if quality.share < BELIEVED or quality.rms > FOUND_PX:
            return None
        self._forget()
        self._pose, self._colours = pose, colours
        self._covariance = np.diag(
            [FOUND_M**2] * 3 + [FOUND_RAD**2] * 3 + [BIAS_PX**2] * 4 + [BIAS_RAD**2]
        )
        return quality


def _score(quality: FitQuality) -> float:
    """Return the score of a found pose; offsets separate a plane from its mirror image."""
    return quality.share + quality.worst - quality.rms


def _placed(holder: Holder) -> list[Rod]:
    T = holder.T_left_holder
    return [(T[:3, :3] @ a + T[:3, 3], T[:3, :3] @ b + T[:3, 3], r) for a, b, r in holder.rods]

"""Velocities of tips become set-points of joints, in n worlds at once, as tensors.

The file loads PyTorch; import it where a tensor is needed. Files that need `torch` take it from
here, with the error of an installation without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError, MissingExtraError
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.closed_form import fit_chain
from trocar.kinematics.inverse import EXACT, chain_ends
from trocar.kinematics.inverse_rcm import (
    SHAFT_ON_YAW_AXIS,
    TIP_ON_AXIS,
    WRIST_AT_CENTRE,
    RcmArmGeometry,
)
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.solutions import LIMIT_TOLERANCE, TURN
from trocar.modeling.joints import JointTable
from trocar.simulation import World
from trocar.tasks.controller import GRIP_RAD, JAW_RAD_S, LAG, PERIOD_S, SLOWED, TipController

try:
    import torch
    from torch import Tensor
except ImportError as error:
    raise MissingExtraError("PyTorch", "gpu", "a scene on a GPU") from error

#: Angle below which a rotation vector's axis is not divided by it. Source: its square is below
#: rounding. [rad]
TINY = 1e-9


def rcm_geometry(arm: ArmDescription) -> RcmArmGeometry | None:
    """Return the chain of an instrument's arm whose closed-form inverse is exact, or None."""
    mechanism, structure = arm.mechanism, arm.inverse_kinematics
    if structure != "rcm_arm" or not loops_are_parallelograms(mechanism):
        return None
    fit = fit_chain(mechanism, structure)
    nearest = fit.chain.nearest
    if fit.deviation > EXACT or not isinstance(nearest, partial):
        return None
    geometry: RcmArmGeometry = nearest.args[0]
    return geometry


def _length(v: Tensor) -> Tensor:
    return (v * v).sum(-1).sqrt()


def rotation_matrices(v: Tensor) -> Tensor:
    """Turn by |v| about v, (n, 3) [rad] -> (n, 3, 3), as `matrix_from_rotation_vector`."""
    angle = _length(v)[:, None]
    x, y, z = (v / torch.where(angle > TINY, angle, 1.0)).unbind(1)
    o = torch.zeros_like(x)
    K = torch.stack([o, -z, y, z, o, -x, -y, x, o], 1).reshape(-1, 3, 3)
    s, c = angle.sin()[:, :, None], angle.cos()[:, :, None]
    eye = torch.eye(3, dtype=v.dtype, device=v.device)
    return eye + s * K + (1.0 - c) * (K @ K)


def nearest_rcm_arms(
    geometry: RcmArmGeometry, T: Tensor, low: Tensor, high: Tensor, seed: Tensor
) -> Tensor:
    """Find the solutions of `inverse_rcm_arm` that are nearest to seeds.

    Args:
        geometry: with the tip's axes those of frame 6
        T: poses of the tip in frame 0, (n, 4, 4)
        low, high: joint limits, (6,) [rad, insertion m]
        seed: (n, 6)

    Returns:
        (n, 6); NaN where there is no solution or joints are not determined
    """
    shift = geometry.insertion_offset - geometry.tool_length
    R, p = T[:, :3, :3], T[:, :3, 3]
    x6, z6 = R[:, :, 0], R[:, :, 2]
    across = p - (p * z6).sum(1, keepdim=True) * z6
    distance = _length(across)[:, None]
    x5 = across / distance
    x5 = torch.stack([x5, -x5], 1)  # both directions of the wrist
    wrist = p[:, None] - geometry.wrist_length * x5
    norm = _length(wrist)
    (ax, ay, az), (bx, by, bz) = x5.unbind(-1), z6[:, None].unbind(-1)
    ex, ey, ez = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    e = torch.stack([ex, ey, ez], -1)
    q6 = torch.atan2((x5 * x6[:, None]).sum(2), (e * x6[:, None]).sum(2))
    depth = torch.stack([norm, -norm], 2)  # both sides of the remote centre
    u = wrist[:, :, None] / depth[..., None]
    q5 = torch.atan2(-(u * z6[:, None, None]).sum(3), (u * x5[:, :, None]).sum(3))
    level = torch.hypot(u[..., 0], u[..., 2])
    yaw, pitch = torch.atan2(u[..., 0], -u[..., 2]), torch.atan2(-u[..., 1], level)
    q1, q2 = torch.stack([yaw, yaw + math.pi], 3), torch.stack([pitch, math.pi - pitch], 3)
    s1, c1, s2, c2 = q1.sin(), q1.cos(), q2.sin(), q2.cos()
    ex, ey, ez = ex[:, :, None, None], ey[:, :, None, None], ez[:, :, None, None]
    q4 = torch.atan2(ex * s1 * s2 + ey * c2 - ez * c1 * s2, -ex * c1 - ez * s1)
    wide = q1.shape
    q3 = (depth + shift)[..., None].expand(wide)
    rest = q5[..., None].expand(wide), q6[:, :, None, None].expand(wide)
    q = torch.stack([q1, q2, q3, q4, *rest], -1).reshape(len(T), 8, 6)
    near = _nearest_turns(q, seed[:, None], low, high)
    near[..., 2] = _inside(q[..., 2], low[2], high[2])
    far = (((near - seed[:, None]) / (high - low)) ** 2).sum(-1)
    least, best = torch.where(far.isnan(), torch.inf, far).min(1)
    found = near[torch.arange(len(T), device=T.device), best]
    fixed = (distance[:, 0] >= TIP_ON_AXIS) & (norm >= WRIST_AT_CENTRE).all(1) & ~least.isinf()
    fixed &= (level >= SHAFT_ON_YAW_AXIS).flatten(1).all(1)
    return torch.where(fixed[:, None], found, torch.nan)


def _nearest_turns(q: Tensor, seed: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Add the whole turns that bring angles nearest to a seed inside limits; NaN without any."""
    q = q + TURN * torch.floor((seed - q + LIMIT_TOLERANCE) / TURN + 0.5)
    above, below = q > high + LIMIT_TOLERANCE, q < low - LIMIT_TOLERANCE
    q = torch.where(above, q - TURN, torch.where(below, q + TURN, q))
    return _inside(q, low, high)


def _inside(q: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Clip values that rounding moved beyond limits; NaN for those farther beyond."""
    fits = (q >= low - LIMIT_TOLERANCE) & (q <= high + LIMIT_TOLERANCE)
    return torch.where(fits, torch.minimum(torch.maximum(q, low), high), torch.nan)


@dataclass(frozen=True, eq=False)
class _TensorChain:
    """Forward kinematics of an arm: constant matrices as `ChainPose` has them, and its base."""

    ratios: Tensor
    slides: Tensor
    parts: Tensor
    base: Tensor

    def __call__(self, q: Tensor) -> Tensor:
        """Return the tip's poses in the world, (n, j) -> (n, 4, 4)."""
        where = q @ self.ratios.T
        turn = torch.where(self.slides, 0.0, where)
        n, hinges = where.shape
        factors = torch.zeros(n, len(self.parts), 1, 4, dtype=q.dtype, device=q.device)
        factors[..., 0] = 1.0
        factors[:, :hinges, 0, 1], factors[:, :hinges, 0, 2] = turn.cos(), turn.sin()
        factors[:, :hinges, 0, 3] = where - turn
        links = (factors @ self.parts).reshape(n, -1, 4, 4)
        while links.shape[1] > 1:
            links = links[:, ::2] @ links[:, 1::2]
        return self.base @ links[:, 0]


@dataclass(frozen=True, eq=False)
class _TensorArm:
    """An arm that actions drive.

    Attributes:
        rows: its joints in the table, the jaw last
        part: of an action
        tip: forward kinematics
        geometry: of a PSM's closed-form inverse; None of an ECM
        own, after: poses before and behind that chain, (4, 4)
        low, high: limits of its joints, (j,)
        fastest, tolerances: of a PSM's joints without the jaw [rad/s or m/s, rad or m]
    """

    rows: slice
    part: slice
    tip: _TensorChain
    geometry: RcmArmGeometry | None
    own: Tensor
    after: Tensor
    low: Tensor
    high: Tensor
    fastest: Tensor
    tolerances: Tensor


class TorchController:
    """Turns actions into set-points of joints in n worlds, as `TipController` does in one.

    Tensors are float64: a target that is moved by single steps drifts in float32.

    Args:
        world, controller: of the scene's task
        table: joints that set-points are for; those of the model that is stepped
        n: number of worlds
        device: of all tensors

    Attributes:
        limits: least and largest values of an action, (k,) each
        q: set-points, (n, J) [rad or m]
        targets: set-points of the PSMs' tips in the world, {arm: (n, 4, 4)}
        stalled: whether a PSM stayed though the last action moves it, {arm: (n,)}

    Raises:
        InputError: an arm whose inverse has no exact closed form, or that stands on another
    """

    def __init__(
        self, world: World, controller: TipController, table: JointTable, n: int, device: str
    ) -> None:
        self.limits = tuple(self._tensor(row, device) for row in controller.limits)
        self.q = torch.zeros(n, len(table), dtype=torch.float64, device=device)
        self.targets: dict[str, Tensor] = {}
        self.stalled: dict[str, Tensor] = {}
        self._driven: dict[str, _TensorArm] = {}
        begin = 0
        for name in controller.arms:
            driven = self._describe(world, name, table, begin, device)
            begin = driven.part.stop
            self._driven[name] = driven
            if driven.geometry is not None:
                self.targets[name] = torch.zeros(n, 4, 4, dtype=torch.float64, device=device)
                self.stalled[name] = torch.zeros(n, dtype=torch.bool, device=device)

    @staticmethod
    def _tensor(values: object, device: str) -> Tensor:
        return torch.as_tensor(np.array(values, np.float64), device=device)

    def _describe(
        self, world: World, name: str, table: JointTable, begin: int, device: str
    ) -> _TensorArm:
        place, t = world.rig.arm(name), partial(self._tensor, device=device)
        arm = place.arm
        if place.on:
            raise InputError(f"{name}: stands on {place.on}; allowed on a GPU: arms in the world")
        if not loops_are_parallelograms(arm.mechanism):
            raise InputError(f"{name}: is calibrated; allowed on a GPU: loops as parallelograms")
        rows, moves = table.arms[name].rows, arm.type == "PSM"
        geometry = rcm_geometry(arm) if moves else None
        if moves and geometry is None:
            raise InputError(
                f"{name}: {arm.name} has no exact closed-form inverse; allowed on a GPU: arms"
                " without calibration whose axes meet"
            )
        chain, base = chain_pose(arm.mechanism), world.reference_pose(name)
        own, after = np.eye(4), np.eye(4)
        if moves:
            ends = chain_ends(arm.mechanism, arm.inverse_kinematics)
            own, after = ends.before @ np.linalg.inv(base), ends.after
        joints = arm.joints[:-1] if moves else arm.joints
        return _TensorArm(
            rows,
            slice(begin, begin + (7 if moves else len(joints))),
            _TensorChain(
                t(chain.ratios),
                torch.as_tensor(chain.slides, device=device),
                t(chain.parts),
                t(base),
            ),
            geometry,
            t(own),
            t(after),
            t(table.lower[rows]),
            t(table.upper[rows]),
            t([joint.velocity_max for joint in joints]),
            t([joint.tracking_tolerance for joint in joints]),
        )

    @property
    def rows(self) -> Mapping[str, slice]:
        """Joints of each driven arm among those of the table, {arm: slice}."""
        return {name: driven.rows for name, driven in self._driven.items()}

    @property
    def jaws(self) -> tuple[int, ...]:
        """Columns of an action that open the PSMs' jaws."""
        return tuple(d.part.stop - 1 for d in self._driven.values() if d.geometry is not None)

    def begin(self, mask: Tensor, q: Tensor, targets: Mapping[str, Tensor]) -> None:
        """Hold arms at set-points in some worlds.

        Args:
            mask: which worlds, (n,) bool
            q: joints, (n, J)
            targets: of the PSMs' tips, {arm: (n, 4, 4)}
        """
        self.q = torch.where(mask[:, None], q, self.q)
        for name, T in targets.items():
            self.targets[name] = torch.where(mask[:, None, None], T, self.targets[name])
            self.stalled[name] = self.stalled[name] & ~mask

    def tips(self, q: Tensor) -> dict[str, Tensor]:
        """Return the poses of all tips in the world at joint positions (n, J), (n, 4, 4) each."""
        return {name: d.tip(q[:, d.rows]) for name, d in self._driven.items()}

    def advance(self, actions: Tensor, measured: Tensor) -> tuple[Tensor, Tensor]:
        """Move the set-points on by a period of 20 ms.

        Args:
            actions: (n, k), clipped to `limits`
            measured: joints, (n, J)

        Returns:
            set-points before and after, (n, J) each
        """
        least, largest = self.limits
        values = torch.minimum(torch.maximum(actions.to(torch.float64), least), largest)
        before, after = self.q, self.q.clone()
        for name, driven in self._driven.items():
            rows, part = driven.rows, values[:, driven.part]
            if driven.geometry is None:
                q = before[:, rows] + part * PERIOD_S
                after[:, rows] = torch.minimum(torch.maximum(q, driven.low), driven.high)
                continue
            own = slice(rows.start, rows.stop - 1)
            after[:, own] = self._onward(name, driven, measured[:, own], part[:, :6])
            jaw, opening = rows.stop - 1, part[:, 6]
            grip = torch.maximum(opening, measured[:, jaw] - GRIP_RAD)
            opening = torch.where(opening < 0.0, grip, opening)
            fastest = JAW_RAD_S * PERIOD_S
            change = (opening - before[:, jaw]).clamp(-fastest, fastest)
            after[:, jaw] = before[:, jaw] + change
        self.q = after
        return before, after

    def _onward(self, name: str, driven: _TensorArm, measured: Tensor, twist: Tensor) -> Tensor:
        """Move a PSM's target on, as fast as its joints may; return its set-points, (n, 6)."""
        seed = self.q[:, driven.rows.start : driven.rows.stop - 1]
        moves = (twist != 0.0).any(1)
        worst = self._tried(name, driven, seed, twist)[2]
        slow = torch.where(worst > 1.0, SLOWED / worst, 1.0)  # NaN compares false
        goal, after, worst = self._tried(name, driven, seed, twist * slow[:, None])
        ahead, was = (after - measured).abs(), (seed - measured).abs()
        pushed = ((ahead > LAG * driven.tolerances) & (ahead > was)).any(1)
        take = moves & (worst <= 1.0) & ~pushed
        self.stalled[name] = moves & ~take
        self.targets[name] = torch.where(take[:, None, None], goal, self.targets[name])
        return torch.where(take[:, None], after, seed)

    def _tried(
        self, name: str, driven: _TensorArm, seed: Tensor, twist: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return a PSM's target after a period, its joints, and their largest relative speed."""
        geometry = driven.geometry
        if geometry is None:
            raise InputError(f"{name}: has no closed-form inverse; allowed: an instrument's arm")
        goal = self.targets[name].clone()
        goal[:, :3, 3] += twist[:, :3] * PERIOD_S
        goal[:, :3, :3] = rotation_matrices(twist[:, 3:] * PERIOD_S) @ goal[:, :3, :3]
        in_chain = driven.own @ goal @ driven.after
        low, high = driven.low[:6], driven.high[:6]
        after = nearest_rcm_arms(geometry, in_chain, low, high, seed)
        worst = ((after - seed).abs() / (driven.fastest * PERIOD_S)).amax(1)
        return goal, after, worst

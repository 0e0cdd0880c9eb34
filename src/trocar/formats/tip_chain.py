"""Helper joints that place the tip of a calibrated arm in a tree of links.

In a tree, passive joints follow a motor along straight lines (`links`), which a loop that is no
parallelogram does not: the tip is off by millimetres. Here three helper joints behind the last
passive joint follow the motor, too. With coordinates q, -2 q and q about x, and small fixed turns c
about z between them, they turn their child about z by about 2 c cos(q), which is not linear in q.
The poses of all these joints are fitted to the tip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize  # pyright: ignore[reportMissingTypeStubs] - scipy has no types

from trocar.descriptions.records import RigArm, RigDescription
from trocar.formats.links import (
    SHARE,
    SLACK,
    LinkJoint,
    LinkModel,
    helper_link,
    joint_motion,
    joint_values,
    joints_above,
    line_error,
    link_name,
    link_poses,
    range_samples,
)
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform, transform_points
from trocar.kinematics.forward import coordinates
from trocar.modeling.hinges import Hinge

Array = NDArray[np.float64]

#: Ratios of the helper joints to their leader. Their sum is 0, so that their turns cancel.
HELPERS = (1.0, -2.0, 1.0)
#: Initial turns between the helpers, of which the better fit is kept [rad]. Source: our own choice,
#: the deviation from a straight line of a loop with sides off by 1 mm.
FIRST_TURNS = (0.02, -0.02)
#: Weights of displacements of passive joints and of helpers against errors of the tip.
#: Source: measured on PSM and ECM with loops off by 1 mm: at a third of this the tip is 0.2 mm
#: nearer and a passive link 25 mm off, instead of 3 mm.
KEPT, HELPER_KEPT = 3e-2, 1e-3
#: Distance from the shaft of a third fitted point, for the turn about the shaft [m].
#: Source: measured: 0.05 m leaves a tip turned by 16 mrad.
BESIDE = 0.2
#: Number of joint vectors in the fit. Source: measured: twice as many, twice as slow, bring the tip
#: nearer by 0.2 mm of 4 to 13 mm.
FITTED = 128
#: Largest number of steps of the fit. Source: measured: later ones improve the tip by less than
#: 0.02 mm.
MOST_STEPS = 50
#: Pose of a frame whose z axis is the x axis.
ALONG_X = transform(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))


def fit_tips(model: LinkModel, rig: RigDescription) -> LinkModel:
    """Return a model whose calibrated arms have helper joints, fitted to their tips.

    Arms whose loops are parallelograms, or do not carry the tip, stay as they are.

    Args:
        model: of the rig, by `links.rig_links`
        rig: its description
    """
    for name in model.line_errors:
        model = _fit(model, rig.arm(name))
    return model


@dataclass(frozen=True, eq=False)
class _Chain:
    """The joints that loops determine between an arm's motor and its tip, with helpers behind.

    Each joint stands at pose @ displacement and has the coordinate (offset + ratio * leader); a
    parameter vector holds displacements (6), offset and ratio of each, and a last displacement.

    Attributes:
        joints: passive joints and helpers
        leader: the joint that all of them follow
        end: pose of the last link in the last helper's child, (4, 4)
    """

    joints: tuple[LinkJoint, ...]
    leader: LinkJoint
    end: Array

    @property
    def kept(self) -> Array:
        """Return the weight of each parameter."""
        count = len(self.joints) - len(HELPERS)
        return np.repeat([KEPT] * count + [HELPER_KEPT] * (len(HELPERS) + 1), 8)[:-2]

    def moved(self, x: Array) -> tuple[tuple[LinkJoint, ...], Array]:
        """Return joints and end at a parameter vector."""
        joints = tuple(
            replace(
                joint,
                pose=joint.pose @ _displacement(row[:6]),
                offset=joint.offset + float(row[6]),
                follows=((self.leader.name, joint.follows[0][1] + float(row[7])),),
            )
            for joint, row in zip(self.joints, x[:-6].reshape(-1, 8), strict=True)
        )
        return joints, self.end @ _displacement(x[-6:])

    def poses(self, x: Array, leader: Array) -> Array:
        """Return T_first_last at coordinates of the leader (k,), (k, 4, 4)."""
        found = np.eye(4)
        for joint, row in zip(self.joints, x[:-6].reshape(-1, 8), strict=True):
            at = joint.offset + row[6] + (joint.follows[0][1] + row[7]) * leader
            found = found @ (joint.pose @ _displacement(row[:6]) @ joint_motion(joint.kind, at))
        return found @ (self.end @ _displacement(x[-6:]))


def _displacement(x: Array) -> Array:
    return transform(matrix_from_rotation_vector(x[3:]), x[:3])


def _fit(model: LinkModel, place: RigArm) -> LinkModel:
    mechanism = place.arm.mechanism
    tip = link_name(place.name, mechanism.tip)
    chain = joints_above(model.joints, tip)[::-1]
    passive = [joint for joint in chain if joint.in_loop]
    leaders = {name for joint in passive for name, _ in joint.follows}
    if len(leaders) != 1 or passive != chain[chain.index(passive[0]) :][: len(passive)]:
        return model
    leader, last = model.joint(leaders.pop()), passive[-1]
    after = chain[chain.index(last) + 1]
    helpers = _helpers(last, leader)
    start = _Chain((*passive, *helpers), leader, inverse(ALONG_X))

    values, true = _true_poses(model, place, 0, FITTED)
    goal = inverse(true[passive[0].parent]) @ true[last.child]
    in_last = inverse(true[last.child]) @ true[tip]
    beside = (in_last @ np.array([BESIDE, 0.0, 0.0, 1.0]))[:, :3]
    shaft = (inverse(true[last.child]) @ true[after.child])[:, :3, 3]
    points = np.stack([in_last[:, :3, 3], beside, shaft], axis=1)
    expected = transform_points(goal[:, None], points)
    kept = np.sqrt(len(points)) * start.kept

    def off(x: Array) -> Array:
        at = transform_points(start.poses(x, values[leader.name])[:, None], points)
        return np.concatenate([(at - expected).ravel(), kept * x])

    solver = cast(Any, optimize)
    fits = [
        solver.least_squares(off, _first(start, turn), max_nfev=MOST_STEPS) for turn in FIRST_TURNS
    ]
    joints, end = start.moved(min(fits, key=lambda fit: fit.cost).x)
    return _with_helpers(model, place, joints, end)


def _first(chain: _Chain, turn: float) -> Array:
    """Return initial parameters, with `turn` [rad] between helpers."""
    x = np.zeros(8 * len(chain.joints) + 6)
    x[-6 - 8 * (len(HELPERS) - 1) : -6].reshape(-1, 8)[:, 3] = turn
    return x


def _helpers(last: LinkJoint, leader: LinkJoint) -> Iterator[LinkJoint]:
    """Yield the joints behind the last passive one, about x of its child."""
    free = replace(cast(Hinge, last.hinge), armature=0.0, damping=0.0, frictionloss=0.0)
    for k, ratio in enumerate(HELPERS, 1):
        yield replace(
            last,
            name=f"{last.name}_{k}",
            kind="revolute",
            parent=f"{last.child}_{k}",
            child=f"{last.child}_{k + 1}",
            pose=ALONG_X if k == 1 else np.eye(4),
            hinge=free,
            offset=0.0,
            follows=((leader.name, ratio),),
        )


def _true_poses(
    model: LinkModel, place: RigArm, seed: int, count: int | None = None
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return coordinates of an arm's joints with its loops closed, and the poses of its links."""
    mechanism = place.arm.mechanism
    closed = coordinates(mechanism, range_samples(mechanism, seed)[:count])
    index = mechanism.frame_index
    moving = [j for j in model.joints if j.arm == place.name and j.hinge is not None]
    values = {joint.name: closed[:, index[joint.frame]] for joint in moving}
    return values, link_poses(model, values)


def _with_helpers(
    model: LinkModel, place: RigArm, chain: tuple[LinkJoint, ...], end: Array
) -> LinkModel:
    """Return a model with a fitted chain in place of the passive joints that it replaces."""
    passive, helpers = chain[: -len(HELPERS)], chain[-len(HELPERS) :]
    last, leader = passive[-1], model.joint(chain[0].follows[0][0])
    found = {joint.name: joint for joint in passive}
    links, joints = [model.links[0]], list[LinkJoint]()
    for joint, link in zip(model.joints, model.links[1:], strict=True):
        if joint.name != last.name:
            links.append(link)
            joints.append(_limited(found[joint.name], leader) if joint.name in found else joint)
            continue
        names = [f"{link.name}_{k}" for k in range(1, len(HELPERS) + 2)]
        links += [helper_link(link, name) for name in names]
        left = 1.0 - SHARE * len(names)
        links.append(replace(link, mass=left * link.mass, inertia=left * link.inertia))
        joints.append(_limited(replace(last, child=names[0]), leader))
        joints += [_limited(helper, leader) for helper in helpers]
        joints.append(LinkJoint(f"{link.name}_end", "fixed", names[-1], link.name, end))
    made = replace(model, links=tuple(links), joints=tuple(joints))
    new = {j.name: j for j in chain}
    start, zero = (
        {**at, **{n: j.offset + j.follows[0][1] * at[leader.name] for n, j in new.items()}}
        for at in (model.start, model.zero)
    )
    values, true = _true_poses(model, place, 1)
    own = {joint.name: values[joint.name] for joint in model.joints
           if joint.name in values and not joint.follows}  # fmt: skip
    stand = link_poses(made, joint_values(made, own))
    mechanism = place.arm.mechanism
    named = {frame.name: link_name(place.name, frame.name) for frame in mechanism.frames}
    error = line_error({f: (true[n], stand[n]) for f, n in named.items()}, mechanism.tip)
    errors = {**model.line_errors, place.name: error}
    return replace(made, start=start, zero=zero, line_errors=errors)


def _limited(joint: LinkJoint, leader: LinkJoint) -> LinkJoint:
    """Return a joint with the limits that its leader's imply."""
    ratio = joint.follows[0][1]
    lower, upper = np.sort(joint.offset + ratio * np.array([leader.lower, leader.upper]))
    return replace(
        joint,
        lower=float(lower) - SLACK,
        upper=float(upper) + SLACK,
        velocity=abs(ratio) * leader.velocity,
    )

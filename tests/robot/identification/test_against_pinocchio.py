"""Gravity, mass matrix and Coriolis forces of the Si's arms are those that pinocchio has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.forward import coordinates, pose
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.identification import JointMotion, rigid_efforts

pinocchio: Any = pytest.importorskip(
    "pinocchio", reason="pinocchio is not installed (extra judges)"
)

Array = NDArray[np.float64]


def depth_first(mechanism: Mechanism) -> list[int]:
    """Return the rows of frames, those of each subtree together, as pinocchio needs its joints."""

    def below(i: int) -> list[int]:
        name = mechanism.frames[i].name
        children = [j for j, frame in enumerate(mechanism.frames) if frame.parent == name]
        return [i, *(row for j in children for row in below(j))]

    return [row for i, f in enumerate(mechanism.frames) if f.parent is None for row in below(i)]


def tree(arm: ArmDescription, up: Array) -> tuple[Any, list[int]]:
    """Return a chain as pinocchio's model, and the rows of the frames that its joints move."""
    mechanism, model = arm.mechanism, pinocchio.Model()
    root = mechanism.frames[0].name
    rest = np.zeros((1, len(mechanism.joints)))
    turn = pose(mechanism, rest, mechanism.reference, root)[0, :3, :3]
    model.gravity.linear = -STANDARD_GRAVITY * (turn @ up)
    at: dict[str | None, tuple[int, Any]] = {None: (0, pinocchio.SE3.Identity())}
    moving: list[int] = []
    for i in depth_first(mechanism):
        frame = mechanism.frames[i]
        parent, place = at[frame.parent]
        place = place * pinocchio.SE3(frame.before)
        if frame.motion != "fixed":
            kind = pinocchio.JointModelPZ if frame.motion == "prismatic" else pinocchio.JointModelRZ
            parent, place = (
                model.addJoint(parent, kind(), place, frame.name),
                pinocchio.SE3.Identity(),
            )
            moving.append(i)
        at[frame.name] = (parent, place * pinocchio.SE3(frame.after))
    for body in arm.bodies:
        joint, place = at[body.frame]
        inertia = pinocchio.Inertia(body.mass, body.com, body.inertia)
        model.appendBodyToJoint(joint, inertia, place)
    return model, moving


@pytest.mark.parametrize("name", ["psm_si", "ecm_si"])
@pytest.mark.parametrize("lean", [0.0, -45.0, -70.0])
def test_rigid_body_terms_agree(name: str, lean: float, rng: np.random.Generator) -> None:
    arm = load_arm(name)
    up = np.array([0.0, np.sin(np.radians(lean)), np.cos(np.radians(lean))])
    model, moving = tree(arm, up)
    data, mechanism = model.createData(), arm.mechanism
    ratios = mechanism.ratios[moving]
    count, joints = 20, len(mechanism.joints)
    q = rng.uniform(mechanism.lower, mechanism.upper, (count, joints))
    qd, one, still = rng.normal(size=q.shape), np.eye(joints), np.zeros_like(q)

    def efforts(rates: Array, growths: Array) -> Array:
        return rigid_efforts(arm, JointMotion(q, rates, growths, up=up))

    gravity = efforts(still, still)
    mass = np.stack([efforts(still, still + one[j]) - gravity for j in range(joints)], axis=2)
    coriolis = efforts(qd, still) - gravity
    where = coordinates(mechanism, q)
    for k in range(count):
        at, rate = where[k, moving], ratios @ qd[k]
        expected = ratios.T @ pinocchio.computeGeneralizedGravity(model, data, at)
        np.testing.assert_allclose(gravity[k], expected, rtol=0.0, atol=1e-9)
        inertia = pinocchio.crba(model, data, at)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        for frame, rotor in arm.rotor.items():
            row = mechanism.frame_index[frame]
            inertia[moving.index(row), moving.index(row)] += rotor
        np.testing.assert_allclose(mass[k], ratios.T @ inertia @ ratios, rtol=0.0, atol=1e-9)
        forces = pinocchio.nonLinearEffects(model, data, at, rate)
        np.testing.assert_allclose(coriolis[k], ratios.T @ forces - expected, rtol=0.0, atol=1e-9)

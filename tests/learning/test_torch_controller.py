"""Set-points of batches as tensors are those that `TipController` computes for one world."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.kinematics.forward import pose
from trocar.kinematics.inverse import chain_ends, inverse_kinematics
from trocar.tasks.registry import make_task

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'trocar[learn]'")

from trocar.learning.torch_controller import (  # noqa: E402  after the skip
    TorchController,
    nearest_rcm_arms,
    rcm_geometry,
)

#: Both compute in float64 with other orders of sums; 3e-15 was measured over these episodes.
SAME = 1e-12


@pytest.mark.parametrize("scene", ["needle-pick", "bi-peg-transfer", "ecm-reach"])
def test_set_points_are_those_of_the_tip_controller_whatever_the_actions(scene):
    task = make_task(scene)
    table, world = task.world.joints, task.world
    names = [name for name in task.arms if world.arms[name].description.type == "PSM"]
    rng = np.random.default_rng(3)
    ours = TorchController(world, task.controller, table, 2, "cpu")
    every = torch.ones(2, dtype=torch.bool)
    stalls = slowed = 0
    for seed in range(2):
        task.reset(seed)
        start = np.zeros(len(table))
        for name, rows in ours.rows.items():
            start[rows] = world.arms[name].joints.setpoints()
        targets = {name: torch.as_tensor(task.controller.target(name)) for name in names}
        ours.begin(every, torch.as_tensor(start), targets)
        low, high = task.limits
        action = high
        for period in range(80):
            if period % 40 == 0:  # for so long that limits and the table stop the arms
                action = rng.uniform(low, high) * (0.3 if period else 1.5)
            measured = np.zeros((2, len(table)))
            for name, rows in ours.rows.items():
                measured[:, rows] = world.arms[name].joints.positions()
            was = ours.q
            task.command(action)
            before, after = ours.advance(
                torch.as_tensor(np.stack([action] * 2)), torch.as_tensor(measured)
            )
            assert torch.equal(before, was)
            for name, rows in ours.rows.items():
                want = world.arms[name].joints.setpoints()
                np.testing.assert_allclose(after[0, rows].numpy(), want, atol=SAME, rtol=0)
            for name in names:
                want = task.controller.target(name)
                np.testing.assert_allclose(ours.targets[name][1].numpy(), want, atol=SAME, rtol=0)
                stalled = bool(task.controller.stalls()[name])
                assert bool(ours.stalled[name][0]) == stalled
                stalls += stalled
                slowed += not stalled
            if task.done:
                break
    if names:
        assert stalls and slowed


def test_tips_of_tensors_are_those_of_the_world():
    task = make_task("bi-peg-transfer")
    ours = TorchController(task.world, task.controller, task.world.joints, 1, "cpu")
    q = np.zeros((1, len(task.world.joints)))
    for name, rows in ours.rows.items():
        q[0, rows] = task.world.arms[name].joints.positions()
    for name, T in ours.tips(torch.as_tensor(q)).items():
        want = task.world.arms[name].measured_cp("world").matrix
        np.testing.assert_allclose(T[0].numpy(), want, atol=1e-12)


def test_the_inverse_of_tensors_is_the_nearest_solution_all_over_the_workspace():
    arm = make_task("needle-pick").world.arms["PSM1"].description
    mechanism, structure = arm.mechanism, arm.inverse_kinematics
    ends, geometry = chain_ends(mechanism, structure), rcm_geometry(arm)
    assert geometry is not None
    low, high = (torch.tensor(side, dtype=torch.float64) for side in zip(*ends.limits, strict=True))
    rng = np.random.default_rng(0)
    lower, upper = mechanism.lower.copy(), mechanism.upper
    lower[2] = 0.05  # the wrist away from the remote centre
    q = rng.uniform(lower, upper, (200, len(lower)))
    seed = rng.uniform(lower, upper, (200, len(lower)))[:, :6]
    T = pose(mechanism, q)
    chain = torch.as_tensor(ends.before @ T @ ends.after)
    found = nearest_rcm_arms(geometry, chain, low, high, torch.as_tensor(seed)).numpy()
    for row in range(200):
        want = inverse_kinematics(mechanism, structure, T[row], seed[row])[0]
        np.testing.assert_allclose(found[row], want, atol=1e-8)

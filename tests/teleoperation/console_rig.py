"""The cart with its console, teleoperated: ticks and hands in the thread of the test."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.live import Loop
from trocar.simulation import World
from trocar.teleoperation import Teleoperation

Array = NDArray[np.float64]
TICK_S = 0.001


class Bench:
    """A world, its loop and its teleoperation; what components publish lies in `published`."""

    def __init__(
        self, rig: str = "full_cart_mtm", *, pose: str = "start", tick_s: float = TICK_S, **world
    ) -> None:
        self.world = World(rig, setup_joints="locked", **world)
        self.world.reset(pose=pose)
        self.loop = Loop(self.world, tick_s=tick_s, speed="max")
        self.engine = Teleoperation(self.loop)
        self.stop = self.engine.start()
        self.published: list[tuple[str, str, object]] = []
        for name, one in self.engine.components.items():
            one.publish = lambda key, value, name=name: self.published.append((name, key, value))
        self.console = self.engine.console

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.loop.tick_s)):
            self.loop.tick()

    def states(self, name: str) -> list[object]:
        return [
            value for who, key, value in self.published if (who, key) == (name, "current_state")
        ]

    def enable(self, name: str = "MTMR_PSM1", *, hand: bool = True, wait: float = 2.0) -> None:
        """Enable a component; once it is aligned a hand pinches."""
        one = self.engine.components[name]
        one.command("enable")
        self.run(wait)
        if hand:
            self.pinch(*one.description.masters)
        assert one.current == "ENABLED", (one.current, self.published)
        assert one.following

    def pinch(self, *masters: str) -> None:
        for shut in (True, False):
            for name in masters:
                gripper = self.world.arm(name).gripper
                assert gripper is not None
                gripper.squeeze_to(0.2) if shut else gripper.release()
            self.run(0.3)

    def carry(self, name: str, T: Array, seconds: float = 0.4) -> None:
        """Carry a master's handle evenly to a pose in the frame of the stereo display."""
        arm = self.world.arm(name)
        T0 = arm.measured_cp().matrix
        turn = rotation_vector_from_matrix(T[:3, :3] @ T0[:3, :3].T)
        count = round(seconds / TICK_S)
        for k in range(1, count + 1):
            s = k / count
            s = s * s * (3.0 - 2.0 * s)
            at = np.eye(4)
            at[:3, :3] = matrix_from_rotation_vector(s * turn) @ T0[:3, :3]
            at[:3, 3] = T0[:3, 3] + s * (T[:3, 3] - T0[:3, 3])
            arm.servo_cp(at)
            self.loop.tick()


def tip_in_image(world: World, arm: str) -> Array:
    """Return the tip that an arm is told, in the endoscope's optical frame, (4, 4)."""
    camera = world.cameras()["endoscope"].T_world_camera
    tip = world.reference_pose(arm) @ world.arm(arm).local.setpoint_cp().matrix
    return np.linalg.inv(camera) @ tip

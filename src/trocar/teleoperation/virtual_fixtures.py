"""Virtual fixtures in a world: forces at masters, and filtered set-points of slaves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.fixtures import WORLD, Fixture
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import inverse
from trocar.live.inbox import Command
from trocar.simulation.records import checked_pose

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]


class Fixtures:
    """The fixtures of a world.

    Args:
        world: arms and objects are looked up in it
        fixtures: as read from a file; filters of an arm act in their order

    Raises:
        DescriptionError: an arm or a frame that the rig does not have, or an arm that is no PSM
    """

    def __init__(self, world: World, fixtures: Sequence[Fixture]) -> None:
        self._world, self._fixtures = world, tuple(fixtures)
        able = [name for name, arm in world.arms.items() if arm.description.type == "PSM"]
        frames = (WORLD, *world.arms, *world.objects)
        for one in self._fixtures:
            for key, got, known in (("arm", one.arm, able), ("frame", one.frame, frames)):
                if got not in known:
                    allowed = ", ".join(known) or f"none, for rig {world.rig.name} has no PSM"
                    problem = f"got {got!r}; allowed: {allowed}"
                    raise DescriptionError(one.file, f"{one.key}.{key}", problem)

    def check_masters(self, arms: Collection[str]) -> None:
        """Check that each force has a master; `arms` are those that such masters move.

        Raises:
            DescriptionError: it has none
        """
        for one in self._fixtures:
            if one.mode == "force" and one.arm not in arms:
                raise DescriptionError(
                    one.file,
                    f"{one.key}.mode",
                    f"got 'force', but no master that exerts forces moves {one.arm} here; allowed:"
                    " 'filter', or a rig with masters, e.g. full_cart_mtm",
                )

    def acts_on(self, arm: str, mode: str) -> bool:
        """Return whether there is a fixture of a mode for an arm."""
        return any(one.arm == arm and one.mode == mode for one in self._fixtures)

    def force(self, arm: str, p: Array, scale: float) -> Array:
        """Return the sum of the forces at the master of an arm, in axes of the world, (3,) [N].

        Args:
            arm: the slave
            p: where the hand brings its tip, in the world, (3,) [m]
            scale: the slave's translation over the master's
        """
        total = np.zeros(3)
        for one, T in self._of(arm, "force"):
            total += T[:3, :3] @ one.force(_moved(inverse(T), p), scale)
        return total

    def filtered(self, arm: str, p: Array) -> Array:
        """Return a tip position after the filters of an arm, in the world, (3,) [m]."""
        for one, T in self._of(arm, "filter"):
            inside = _moved(inverse(T), p)
            nearest = one.region.nearest(inside)
            if (nearest != inside).any():
                p = _moved(T, nearest)
        return p

    def filter_command(self, command: Command) -> Command:
        """Return a command with the pose of `servo_cp` filtered; every other one as it is."""
        if command.verb != "servo_cp" or not self.acts_on(command.arm, "filter"):
            return command
        try:
            T = checked_pose(command.arm, command.kwargs["T"]).copy()
        except InputError:
            return command  # the arm rejects it, with a warning
        frame = self._world.reference_pose(command.arm)
        frame = frame @ inverse(self._world.arm(command.arm).local.base_frame()[0])
        p = _moved(frame, T[:3, 3])
        q = self.filtered(command.arm, p)
        if (q == p).all():
            return command
        T[:3, 3] = _moved(inverse(frame), q)
        return Command(
            command.arm, command.verb, {**command.kwargs, "T": T}, command.topic, command.stream
        )

    def _of(self, arm: str, mode: str) -> list[tuple[Fixture, Array]]:
        return [
            (one, self._frame(one.frame))
            for one in self._fixtures
            if one.arm == arm and one.mode == mode
        ]

    def _frame(self, name: str) -> Array:
        """Return the pose of a fixture's frame in the world now, (4, 4)."""
        if name == WORLD:
            return np.eye(4)
        if name in self._world.arms:
            return self._world.reference_pose(name)
        return self._world.object(name).measured_cp().matrix


def _moved(T: Array, p: Array) -> Array:
    return T[:3, :3] @ p + T[:3, 3]

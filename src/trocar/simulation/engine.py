"""What the physics engine itself has to say of a world."""

from __future__ import annotations

import mujoco

from trocar.simulation.world import World


def engine_warnings(world: World) -> dict[str, int]:
    """Return {kind: how often} of the engine's warnings since the last reset, those that came."""
    counts = world._data.warning.number
    kinds = (kind for kind in mujoco.mjtWarning.__members__.values() if kind.value < len(counts))
    return {
        kind.name.removeprefix("mjWARN_").lower(): int(counts[kind.value])
        for kind in kinds
        if counts[kind.value]
    }

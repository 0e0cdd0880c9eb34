"""Marks in the scene that can be switched: remote centres and tool frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import quaternion_from_matrix

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import Snapshot

Floats = NDArray[np.float64]
Anchor = Literal["bottom-left", "bottom-right"]

CENTRE_RADIUS_M = 0.009
"""Radius of the sphere that marks a remote centre [m]. Source: chosen by eye."""

CENTRE_COLOUR = (255, 120, 20)
ANCHORS: tuple[Anchor, Anchor] = ("bottom-left", "bottom-right")
"""Neighbours' labels lean to different sides, so that they hide each other less."""

LABEL_LIFT = np.array([0.0, 0.0, 0.012])
"""From a remote centre up to its label [m]. Source: chosen by eye."""

TOOL_BEARERS = ("PSM", "ECM", "MTM")
AXES_M, AXES_RADIUS_M = 0.05, 0.0014
"""Length and radius of a tool frame's axes [m]. Source: chosen by eye."""


class RemoteCentres:
    """A small sphere and the arm's name at each point that the trocar keeps still."""

    def __init__(self, scene: viser.SceneApi, snapshot: Snapshot) -> None:
        names = [name for name, arm in snapshot.arms.items() if arm.remote_centre is not None]
        self._nodes = {name: _centre(scene, name, ANCHORS[k % 2]) for k, name in enumerate(names)}
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Send where they are."""
        for name, nodes in self._nodes.items():
            centre = snapshot.arms[name].remote_centre
            if centre is not None:
                sphere, label = nodes
                sphere.position, label.position = centre, centre + LABEL_LIFT

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        for nodes in self._nodes.values():
            for node in nodes:
                node.visible = visible


class ToolFrames:
    """Three axes at the tip of each arm: x red, y green, z blue."""

    def __init__(self, scene: viser.SceneApi, arms: Iterable[str]) -> None:
        self.visible = False
        self._nodes = {
            name: scene.add_frame(
                f"/marks/tip_{name}", axes_length=AXES_M, axes_radius=AXES_RADIUS_M, visible=False
            )
            for name in arms
        }

    def show(self, tips: Mapping[str, Floats]) -> None:
        """Send where they are: {arm: T_world_tip (4, 4)}."""
        for name, tip in tips.items():
            node = self._nodes[name]
            node.position, node.wxyz = tip[:3, 3], quaternion_from_matrix(tip[:3, :3])

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        self.visible = visible
        for node in self._nodes.values():
            node.visible = visible


def tips_of(world: World) -> dict[str, Floats]:
    """Find the tip of every arm in the world, T_world_tip (4, 4); to be asked of the loop."""
    return {
        name: world.reference_pose(name) @ arm.local_measured_cp().T
        for name, arm in world.arms.items()
        if arm.type in TOOL_BEARERS
    }


def _centre(
    scene: viser.SceneApi, name: str, anchor: Anchor
) -> tuple[viser.IcosphereHandle, viser.LabelHandle]:
    sphere = scene.add_icosphere(
        f"/marks/centre_{name}",
        radius=CENTRE_RADIUS_M,
        color=CENTRE_COLOUR,
        subdivisions=3,
        cast_shadow=False,
        receive_shadow=False,
    )
    label = scene.add_label(f"/marks/label_{name}", name, anchor=anchor, font_screen_scale=0.75)
    return sphere, label

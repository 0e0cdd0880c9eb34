"""Marks in the scene that can be switched: remote centres and tool frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser

if TYPE_CHECKING:
    from trocar.simulation import Snapshot

CENTRE_RADIUS_M = 0.009
"""Radius of the sphere that marks a remote centre [m]. Source: chosen by eye."""

CENTRE_COLOUR = (255, 120, 20)
AXES_M, AXES_RADIUS_M = 0.05, 0.0014
"""Length and radius of a tool frame's axes [m]. Source: chosen by eye."""


class RemoteCentres:
    """A small sphere and the arm's name at each point that the trocar keeps still."""

    def __init__(self, scene: viser.SceneApi, snapshot: Snapshot) -> None:
        names = [name for name, arm in snapshot.arms.items() if arm.remote_centre is not None]
        self._nodes = {name: _centre(scene, name) for name in names}
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Send where they are."""
        for name, nodes in self._nodes.items():
            centre = snapshot.arms[name].remote_centre
            for node in nodes:
                node.position = centre

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        for nodes in self._nodes.values():
            for node in nodes:
                node.visible = visible


class ToolFrames:
    """Three axes at the tip of each arm: x red, y green, z blue."""

    def __init__(self, scene: viser.SceneApi, snapshot: Snapshot) -> None:
        names = [name for name, arm in snapshot.arms.items() if arm.tip is not None]
        self._nodes = {
            name: scene.add_frame(
                f"/marks/tip_{name}", axes_length=AXES_M, axes_radius=AXES_RADIUS_M, visible=False
            )
            for name in names
        }
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Send where they are."""
        for name, node in self._nodes.items():
            tip = snapshot.arms[name].tip
            node.position = tip[:3, 3]
            node.wxyz = viser.transforms.SO3.from_matrix(tip[:3, :3]).wxyz

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of them."""
        for node in self._nodes.values():
            node.visible = visible


def _centre(scene: viser.SceneApi, name: str) -> list[viser.SceneNodeHandle]:
    sphere = scene.add_icosphere(
        f"/marks/centre_{name}",
        radius=CENTRE_RADIUS_M,
        color=CENTRE_COLOUR,
        subdivisions=3,
        cast_shadow=False,
        receive_shadow=False,
    )
    label = scene.add_label(
        f"/marks/label_{name}", name, anchor="bottom-center", font_screen_scale=0.9
    )
    return [sphere, label]

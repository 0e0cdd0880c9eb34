"""What Gazebo wants beside a model: a world with ground and sun, and the model's card."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trocar.descriptions.meshes import Mesh
from trocar.geometry.se3 import transform
from trocar.modeling.links import LinkModel
from trocar.modeling.markup import child, document, element
from trocar.modeling.sdf import add_model, model_name, sdf_root
from trocar.modeling.sdf_shapes import add_pose, exact

#: The prop that people stand on, and where the ground is in a rig without one: where rigs whose
#: arms hang on stands have it [m]. Source: data/rigs.
FLOOR, FLOOR_Z = "floor", -0.75
#: Period of Gazebo's physics. Source: that of our own simulation. [s]
STEP = 0.001
#: Where the sun comes from, and how bright it is. Source: our own choice.
SUN_DIRECTION, SUN_COLOUR = (-0.5, 0.3, -0.9), (0.8, 0.8, 0.8, 1.0)
GREY = (0.7, 0.7, 0.72, 1.0)


def world(model: LinkModel, version: str, meshes: Mapping[Mesh, str] | None = None) -> bytes:
    """Return an SDF world with a rig in it, a ground to fall on and a sun.

    The model is in it and not included by name: Gazebo then opens the file wherever it lies.

    Args:
        model, version, meshes: as for `sdf`
    """
    root = sdf_root(version)
    made = child(root, "world", {"name": f"{model_name(model)}_world"})
    physics = child(made, "physics", {"name": "millisecond", "type": "ode"})
    child(physics, "max_step_size", text=exact([STEP]))
    child(physics, "real_time_factor", text=exact([1.0]))
    _add_sun(made)
    _add_ground(made, model)
    add_model(made, model, version, meshes)
    return document(root, f"{model.title}, in a world; SI units and radians")


def card(model: LinkModel, version: str, file: str) -> bytes:
    """Return the `model.config` by which Gazebo finds a model's file."""
    root = element("model")
    child(root, "name", text=model_name(model))
    child(root, "version", text="1.0")
    child(root, "sdf", {"version": version}, file)
    child(child(root, "author"), "name", text="the trocar authors")
    child(root, "description", text=model.title)
    return document(root)


def _add_sun(parent: Any) -> None:
    sun = child(parent, "light", {"name": "sun", "type": "directional"})
    child(sun, "cast_shadows", text="true")
    add_pose(sun, transform(np.eye(3), np.array([0.0, 0.0, 10.0])))
    child(sun, "diffuse", text=exact(SUN_COLOUR))
    child(sun, "specular", text=exact(SUN_COLOUR))
    child(sun, "direction", text=exact(SUN_DIRECTION))


def _add_ground(parent: Any, model: LinkModel) -> None:
    height = next((j.pose[2, 3] for j in model.joints if j.child == FLOOR), FLOOR_Z)
    made = child(parent, "model", {"name": "ground_plane"})
    child(made, "static", text="true")
    add_pose(made, transform(np.eye(3), np.array([0.0, 0.0, height])))
    link = child(made, "link", {"name": "plane"})
    for tag in ("visual", "collision"):
        part = child(link, tag, {"name": tag})
        plane = child(child(part, "geometry"), "plane")
        child(plane, "normal", text=exact([0.0, 0.0, 1.0]))
        child(plane, "size", text=exact([20.0, 20.0]))
        if tag == "visual":
            child(child(part, "material"), "diffuse", text=exact(GREY))

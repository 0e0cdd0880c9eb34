"""A scene to look at a robot in: the robot's file, light, sky and a floor."""

from __future__ import annotations

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.kinematics.forward import poses
from trocar.modeling.markup import child, document, element
from trocar.modeling.menagerie.sheet import file_name
from trocar.modeling.menagerie.text import exact, row
from trocar.modeling.menagerie.variants import POSITION, Variant

#: Joint vectors that say how low a lone arm reaches, and how far below the floor lies [m].
SAMPLES, CLEARANCE_M = 256, 0.15
#: Room that is left around the frames in the first look. Source: by eye.
MARGIN = 1.3


def scene_document(rig: RigDescription, variant: Variant = POSITION) -> bytes:
    """Return a scene that includes a rig's file; it has a floor where the rig has no props."""
    name = f"{file_name(rig)}{variant.suffix}"
    root = element("mujoco", {"model": f"{name} scene"})
    child(root, "include", {"file": f"{name}.xml"})
    child(root, "statistic", {"center": row(_middle(rig)), "extent": exact(_extent(rig))})
    visual = child(root, "visual")
    light = {"diffuse": "0.3 0.3 0.3", "ambient": "0.35 0.35 0.35", "specular": "0 0 0"}
    child(visual, "headlight", light)
    child(visual, "quality", {"shadowsize": "8192"})
    child(visual, "rgba", {"haze": "0.85 0.88 0.91 1"})
    child(visual, "global", {"azimuth": "-130", "elevation": "-18"})
    assets = child(root, "asset")
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": "0.95 0.96 0.97", "rgb2": "0.6 0.7 0.8"}
    child(assets, "texture", {**sky, "width": "512", "height": "3072"})
    world = child(root, "worldbody")
    lamp = {"pos": "1 1.5 4", "dir": "-0.2 -0.3 -0.8", "diffuse": "0.5 0.5 0.5"}
    child(world, "light", {**lamp, "directional": "true"})
    if not rig.props:
        squares = {"type": "2d", "name": "groundplane", "builtin": "checker", "mark": "edge"}
        colours = {"rgb1": "0.78 0.80 0.82", "rgb2": "0.72 0.74 0.77", "markrgb": "0.9 0.9 0.9"}
        child(assets, "texture", {**squares, **colours, "width": "300", "height": "300"})
        looks = {"texture": "groundplane", "texuniform": "true", "texrepeat": "5 5"}
        child(assets, "material", {"name": "groundplane", **looks, "reflectance": "0.1"})
        lies = {"type": "plane", "size": "0 0 0.05", "pos": row([0.0, 0.0, _floor(rig)])}
        child(world, "geom", {"name": "floor", **lies, "material": "groundplane"})
    return document(root)


def _floor(rig: RigDescription) -> float:
    """Return the height of a floor that no joint position reaches, at most 0 [m]."""
    rng = np.random.default_rng(0)
    lowest = 0.0
    for place in rig.arms:
        mechanism = place.arm.mechanism
        q = rng.uniform(mechanism.lower, mechanism.upper, (SAMPLES, len(mechanism.joints)))
        for at in poses(mechanism, q, place.arm.root).values():
            heights = (place.pose @ at)[..., 2, 3]
            lowest = min(lowest, float(heights.min()) - CLEARANCE_M)
    return round(lowest, 2)


def _middle(rig: RigDescription) -> np.ndarray:
    return np.round(0.5 * (_points(rig).min(axis=0) + _points(rig).max(axis=0)), 2)


def _extent(rig: RigDescription) -> float:
    return round(MARGIN * float(np.ptp(_points(rig), axis=0).max()), 2)


def _points(rig: RigDescription) -> np.ndarray:
    """Return where frames are at the pose "start", (n, 3) [m]."""
    found: list[np.ndarray] = []
    stands: dict[str, dict[str, np.ndarray]] = {}
    for place in rig.arms:
        mount = stands[place.on][place.frame] if place.on else np.eye(4)
        at = poses(place.arm.mechanism, rig.poses["start"][place.name], place.arm.root)
        stands[place.name] = {name: mount @ place.pose @ pose for name, pose in at.items()}
        found += [pose[:3, 3] for pose in stands[place.name].values()]
    return np.array(found)

"""The formats that `trocar export` writes: a row each."""

from __future__ import annotations

from trocar.apps.exports.mjcf import write_mjcf
from trocar.apps.exports.sdf import write_sdf
from trocar.apps.exports.task import Format
from trocar.apps.exports.urdf import write_urdf

#: {what --format takes: the format}
FORMATS: dict[str, Format] = {
    "mjcf": Format("MJCF: MuJoCo, as MuJoCo Menagerie has robots", write_mjcf),
    "urdf": Format("URDF: ROS, RViz, pinocchio, Drake, MuJoCo, yourdfpy", write_urdf, ("package",)),
    "sdf": Format("SDF: Gazebo, Drake", write_sdf, ("sdf_version",)),
}

"""Where things are: rotations, poses, screws and Denavit-Hartenberg rows, with numpy only."""

from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.rotations import (
    angle_between,
    check_rotation,
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    matrix_from_rpy,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
    rotation_x,
    rotation_y,
    rotation_z,
    skew,
)
from trocar.geometry.screws import (
    nearest_point_to_lines,
    point_line_distance,
    prismatic_screw,
    revolute_screw,
    screw_motion,
)
from trocar.geometry.se3 import (
    adjoint,
    check_transform,
    exp_twist,
    inverse,
    log_transform,
    pose_difference,
    transform,
    transform_points,
    translation,
)

__all__ = [
    "adjoint",
    "angle_between",
    "check_rotation",
    "check_transform",
    "exp_twist",
    "inverse",
    "log_transform",
    "matrix_from_quaternion",
    "matrix_from_rotation_vector",
    "matrix_from_rpy",
    "modified_dh",
    "nearest_point_to_lines",
    "point_line_distance",
    "pose_difference",
    "prismatic_screw",
    "quaternion_from_matrix",
    "revolute_screw",
    "rotation_vector_from_matrix",
    "rotation_x",
    "rotation_y",
    "rotation_z",
    "screw_motion",
    "skew",
    "standard_dh",
    "transform",
    "transform_points",
    "translation",
]

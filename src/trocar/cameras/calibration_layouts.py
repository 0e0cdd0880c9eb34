"""Calibrations in the settings of visual SLAM programs, as keys of ROS and OpenCV.

Kalibr has a table for each camera (`cam0`, `cam1`); ORB-SLAM numbers with names such as
`Camera.fx`, and matrices of both eyes; VINS and camodocal tables of parameters; SVO `cam_fx`.
All have OpenCV's pinhole with radial and tangential distortion among their models.

Source: the documentation of Kalibr ("YAML formats"), and the settings that come with ORB-SLAM2 and
3, VINS-Fusion (camodocal) and SVO.
"""

from __future__ import annotations

import re
from typing import Any, cast

import numpy as np

from trocar.cameras.calibration_text import Keys
from trocar.errors import DescriptionError
from trocar.geometry.se3 import inverse
from trocar.inputs import got

#: A number of one eye: `fx`, `cam_fx`, `Camera.fx`, `Camera2.k1`.
SCALAR = re.compile(
    r"(?:cam(?:era)?(?P<eye>[12]?)[._])?(?P<name>f[xy]|c[xy]|k[1-6]|p[12]|d[0-3]|width|height)",
    re.IGNORECASE,
)
FOCUS = ("fx", "fy", "cx", "cy")
#: Distortion in OpenCV's order; SVO numbers the first four.
ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
NUMBERED = {"d0": "k1", "d1": "k2", "d2": "p1", "d3": "p2"}
#: Names of a model, and those of OpenCV's. Source: as above; "none" is Kalibr's perfect lens.
MODEL_KEYS = ("model_type", "cam_model", "Camera.type", "camera_model", "distortion_model")
MODELS = ("pinhole", "rectified", "radtan", "plumb_bob", "rational_polynomial", "none")
#: Tables of camodocal.
TABLES = ("projection_parameters", "distortion_parameters")
#: {key of ORB-SLAM2: that of ROS} of an eye's size, matrix, coefficients and rectification.
SIDE = {
    "width": "image_width",
    "height": "image_height",
    "K": "camera_matrix",
    "D": "distortion_coefficients",
    "R": "rectification_matrix",
    "P": "projection_matrix",
}


def with_common_keys(keys: Keys, file: str) -> list[Keys]:
    """Return the keys of a file as ROS or OpenCV would name them, those of two eyes as two.

    Args:
        keys: of the file; other layouts come back as they are
        file: its name, for messages

    Raises:
        DescriptionError: another model than OpenCV's, or a part that is missing; the entry and what
            is allowed are named
    """
    chain = sorted(key for key in keys if re.fullmatch(r"cam\d+", key))
    if chain and all(isinstance(keys[key], dict) for key in chain):
        return [_kalibr(keys, chain, file)]
    if "LEFT.K" in keys and "RIGHT.K" in keys:
        return [_side(keys, side) for side in ("LEFT", "RIGHT")]
    flat = {key: value for key, value in keys.items() if key not in TABLES}
    for table in TABLES:
        if isinstance(keys.get(table), dict):
            flat |= cast(Keys, keys[table])
    eyes, used = _eyes(flat)
    if not eyes:
        if any(isinstance(keys.get(table), dict) for table in TABLES):
            _check_model(keys, file)
        return [keys]
    _check_model(keys, file)
    rest = {key: value for key, value in flat.items() if key not in used}
    for idle in (*MODEL_KEYS, "camera_name"):
        rest.pop(idle, None)
    return [{**_named(eyes, file, _pose(rest, eyes, file)), **rest}]


def _check_model(keys: Keys, file: str, where: str = "") -> None:
    for key in MODEL_KEYS:
        value = keys.get(key)
        if value is not None and str(value).lower() not in MODELS:
            allowed = "a pinhole with radial and tangential distortion, which OpenCV can calibrate"
            raise DescriptionError(file, where + key, got(value, allowed))


def _eyes(flat: Keys) -> tuple[dict[str, dict[str, Any]], set[str]]:
    """Return the numbers of each eye ("1", "2") that has all of `FOCUS`, and the keys of these."""
    found: dict[str, dict[str, Any]] = {}
    used: dict[str, set[str]] = {}
    for key, value in flat.items():
        match = SCALAR.fullmatch(str(key))
        if match is None or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        eye, name = match["eye"] or "1", match["name"].lower()
        found.setdefault(eye, {})[NUMBERED.get(name, name)] = value
        used.setdefault(eye, set()).add(key)
    whole = {eye: found[eye] for eye in sorted(found) if all(name in found[eye] for name in FOCUS)}
    return whole, {key for eye in whole for key in used[eye]}


def _pose(rest: Keys, eyes: dict[str, Any], file: str) -> Any:
    """Take the second eye's pose out of ORB-SLAM's keys; None where there is one eye.

    Returns:
        T_first_second, (4, 4) [m]
    """
    pose, base, bf = (rest.pop(key, None) for key in ("Stereo.T_c1_c2", "Stereo.b", "Camera.bf"))
    if pose is not None:
        data = cast(Keys, pose).get("data") if isinstance(pose, dict) else pose
        return _transform(data, file, "Stereo.T_c1_c2")
    if base is None and bf is not None and not any("DepthMapFactor" in key for key in rest):
        base = bf / eyes["1"]["fx"]  # of depth cameras bf is a choice
    if base is None:
        return None
    T = np.eye(4)
    T[0, 3] = base
    return T


def _named(eyes: dict[str, dict[str, Any]], file: str, T_first_second: Any) -> Keys:
    """Return OpenCV's keys of one eye, or of two where the pose of the second is known."""
    first = eyes["1"] if "1" in eyes else next(iter(eyes.values()))
    keys: Keys = {}
    if "width" in first and "height" in first:
        keys |= {"image_width": first["width"], "image_height": first["height"]}
    if T_first_second is None:
        if len(eyes) > 1:
            raise DescriptionError(file, "Stereo.T_c1_c2", "is missing; two cameras need it")
        return {**keys, "camera_matrix": _matrix(first), "distortion_coefficients": _bent(first)}
    second = eyes.get("2", first)
    return {
        **keys,
        "M1": _matrix(first),
        "D1": _bent(first),
        "M2": _matrix(second),
        "D2": _bent(second),
        **_relative(inverse(T_first_second)),
    }


def _matrix(eye: dict[str, Any]) -> list[list[float]]:
    return [[eye["fx"], 0.0, eye["cx"]], [0.0, eye["fy"], eye["cy"]], [0.0, 0.0, 1.0]]


def _bent(eye: dict[str, Any]) -> list[float]:
    found = [float(eye.get(name, 0.0)) for name in ORDER]
    return found if any(found[5:]) else found[:5]


def _relative(T_second_first: Any) -> Keys:
    return {"R": T_second_first[:3, :3].tolist(), "T": T_second_first[:3, 3].tolist()}


def _side(keys: Keys, side: str) -> Keys:
    """Return ROS's keys of one eye of ORB-SLAM2."""
    own = {name: keys[f"{side}.{key}"] for key, name in SIDE.items() if f"{side}.{key}" in keys}
    return {"distortion_model": "plumb_bob", **own}


def _kalibr(keys: Keys, chain: list[str], file: str) -> Keys:
    """Return OpenCV's keys of Kalibr's chain of one or two cameras."""
    if len(chain) > 2:
        raise DescriptionError(file, "", f"has {len(chain)} cameras; allowed: one or two")
    single = ("camera_matrix", "distortion_coefficients")
    names = (single,) if len(chain) == 1 else (("M1", "D1"), ("M2", "D2"))
    found: Keys = {}
    for key, (matrix, coefficients) in zip(chain, names, strict=True):
        table = cast(Keys, keys[key])
        _check_model(table, file, f"{key}.")
        focus, size = table.get("intrinsics"), table.get("resolution")
        for name, value, count in (("intrinsics", focus, 4), ("resolution", size, 2)):
            if not isinstance(value, list) or len(cast(list[Any], value)) != count:
                problem = got(cast(object, value), f"{count} numbers")
                raise DescriptionError(file, f"{key}.{name}", problem)
        if found.setdefault("imageSize", size) != size:
            raise DescriptionError(file, f"{key}.resolution", got(size, "that of the other camera"))
        found[matrix] = _matrix(dict(zip(FOCUS, cast(list[Any], focus), strict=True)))
        found[coefficients] = table.get("distortion_coeffs", [])
    if len(chain) == 2:
        found |= _relative(_between(keys, chain, file))
    return found


def _between(keys: Keys, chain: list[str], file: str) -> Any:
    """Return T_second_first of two of Kalibr's cameras, (4, 4) [m]."""
    first, second = (cast(Keys, keys[key]) for key in chain)
    direct, last = second.get("T_cn_cnm1"), chain[-1]
    if direct is not None:
        return _transform(direct, file, f"{last}.T_cn_cnm1")
    for key in ("T_cam_imu", "T_imu_cam"):
        if key in first and key in second:
            poses = [
                _transform(table[key], file, f"{name}.{key}")
                for name, table in zip(chain, (first, second), strict=True)
            ]
            a, b = poses if key == "T_cam_imu" else map(inverse, poses)
            return b @ inverse(a)
    raise DescriptionError(file, f"{last}.T_cn_cnm1", "is missing (or T_cam_imu, T_imu_cam)")


def _transform(value: Any, file: str, key: str) -> Any:
    """Return a pose in a file as (4, 4)."""
    try:
        return np.array(value, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError):
        raise DescriptionError(file, key, got(value, "a pose of 4 x 4 numbers")) from None

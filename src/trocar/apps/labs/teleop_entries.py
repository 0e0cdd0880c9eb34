"""Who moves whom: the teleoperations of a system's consoles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from trocar.apps.labs.json_file import Node
from trocar.apps.labs.records import LabTeleop

#: Entry of the dVRK's file -> key of a rig's [[teleop]]. Source: schema dvrk-teleop-PSM.
NUMBERS = {
    "scale": "scale",
    "start_orientation_tolerance": "orientation_tolerance_rad",
    "start_gripper_threshold": "gripper_threshold_rad",
    "start_roll_threshold": "roll_threshold_rad",
    "jaw_rate": "jaw_rate_rad_s",
    "jaw_rate_after_clutch": "jaw_rate_after_clutch_rad_s",
    "jaw_rate_back_from_clutch": "jaw_rate_after_clutch_rad_s",
}
FLAGS = {
    "ignore_jaw": "ignore_jaw",
    "rotation_locked": "rotation_locked",
    "translation_locked": "translation_locked",
    "align_MTM": "align",
}
#: What a console has beside its teleoperations: pedals and sensors.
CONSOLE_IDLE = (
    *("name", "input_type", "IO_pedals", "IO_head_sensor", "HID_file", "IO_clutch", "IO_camera"),
    *("IO_operator_present", "component_clutch", "component_camera", "pedals", "operator_present"),
    *("physical_footpedals_required", "component_operator_present", "IO_pedals_interfaces"),
)


def read_consoles(root: Node, arms: Mapping[str, str], said: list[str]) -> list[LabTeleop]:
    """Return every teleoperation, each pair once.

    Args:
        root: the system's file
        arms: {name: type} of the system's arms
        said: takes what the reader should know

    Raises:
        DescriptionError: an arm that the system does not have, or a number beyond its range
    """
    found: dict[tuple[str, ...], LabTeleop] = {}
    for teleop in _all(root, arms):
        pair = (*teleop.masters, teleop.slave)
        if pair in found:
            said.append(f"{teleop.place}: {' and '.join(pair)} are paired twice; the first counts")
        found.setdefault(pair, teleop)
    return list(found.values())


def _all(root: Node, arms: Mapping[str, str]) -> Iterator[LabTeleop]:
    consoles = root.nodes("consoles")
    for console in consoles:
        console.without_use(*CONSOLE_IDLE)
    for place in (*consoles, root):
        for key in ("teleop_PSMs", "psm_teleops"):
            for node in place.nodes(key):
                masters = (_arm(node, "MTM", arms),)
                yield _teleop(node, masters, _arm(node, "PSM", arms), "psm")
        if "ecm_teleop" in place:  # as older systems have it
            node = place.node("ecm_teleop")
            masters = (_arm(node, "mtm_left", arms), _arm(node, "mtm_right", arms))
            yield _teleop(node, masters, _arm(node, "ecm", arms), "ecm")
        for node in place.nodes("teleop_ECMs"):
            masters = (_arm(node, "MTML", arms), _arm(node, "MTMR", arms))
            yield _teleop(node, masters, _arm(node, "ECM", arms), "ecm")


def _arm(node: Node, key: str, arms: Mapping[str, str]) -> str:
    name = node.text(key)
    able = [arm for arm, kind in arms.items() if kind.startswith(key[:3].upper())]
    if name not in able:
        known = ", ".join(able) or "none"
        raise node.fail(key, f"got {name!r}; allowed: {known} (the system's arms of that type)")
    return name


def _teleop(node: Node, masters: tuple[str, ...], slave: str, kind: str) -> LabTeleop:
    node.without_use("type", "period", "PSM_base_frame", "clutch", "component", "interface")
    given: dict[str, float | bool] = {}
    if "configure_parameter" in node:
        given = _given(node.node("configure_parameter"))
    return LabTeleop(
        f"{node.file}: {node.path}", masters, slave, "psm" if kind == "psm" else "ecm", given
    )


def _given(node: Node) -> dict[str, float | bool]:
    """Return what a file says of a teleoperation, as a rig has it."""
    found: dict[str, float | bool] = {}
    node.without_use("MTM_is_haptic", "use_MTM_linear_velocity", "use_MTM_angular_velocity")
    for key, ours in NUMBERS.items():
        if key not in node:
            continue
        value = node.number(key)
        most = 1.0 if ours == "scale" else float("inf")
        if not 0.0 <= value <= most or (value == 0.0 and not ours.startswith(("g", "r", "o"))):
            least = "0 or more" if ours.startswith(("g", "r", "o")) else "above 0"
            top = " to 1" if ours == "scale" else ""
            raise node.fail(key, f"got {value:g}; allowed: {least}{top}")
        found[ours] = value
    for key, ours in FLAGS.items():
        flag = node.flag(key) if key in node else None
        if flag is not None:
            found[ours] = flag
    if "gripper_scaling" in node:
        scaling = node.node("gripper_scaling")
        for key in ("zero", "max"):
            if key in scaling:
                found[f"gripper_{key}_rad"] = scaling.number(key)
    return found

"""Friction, rotors, gains, couplings and counterweights from TOML."""

from __future__ import annotations

from trocar.descriptions.records import Control, Counterweight, Friction, Gains
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.kinematics.coupling import Coupling


def read_friction(table: Table) -> dict[str, dict[str, Friction]]:
    """Return {model: {frame or joint: friction}}."""
    models = table.optional_table("friction")
    found: dict[str, dict[str, Friction]] = {}
    for name in models.entries():
        model = models.table(name)
        model.text("source", "")
        found[name] = {}
        for key in model.entries():
            row = model.table(key)
            found[name][key] = Friction(
                row.quantity("coulomb", "torque", "force", default=0.0),
                row.quantity("viscous", "angular damping", "linear damping", default=0.0),
            )
            if min(found[name][key].coulomb, found[name][key].viscous) < 0.0:
                raise row.fail("", "friction must not be negative")
            row.done()
    return found


def read_rotor(table: Table) -> dict[str, float]:
    """Return {frame: reflected inertia or mass}."""
    rotors = table.optional_table("rotor")
    rotors.text("source", "")
    found: dict[str, float] = {}
    for key in rotors.entries():
        row = rotors.table(key)
        found[key] = row.quantity("inertia" if "inertia_kgm2" in row else "mass", "inertia", "mass")
        if found[key] < 0.0:
            raise row.fail("", f"got {found[key]:g}; allowed: 0 or more")
        row.done()
    return found


def read_control(table: Table) -> dict[str, Control]:
    """Return {name: gains and what goes with them}."""
    presets = table.optional_table("control")
    found: dict[str, Control] = {}
    for name in presets.entries():
        row = presets.table(name)
        pid = row.table("pid")
        gains: dict[str, Gains] = {}
        for joint in pid.entries():
            gains[joint] = Gains(*pid.numbers(joint, 3))
            if min(gains[joint].p, gains[joint].i, gains[joint].d) < 0.0:
                raise pid.fail(joint, f"got {pid.raw(joint)}; allowed: 0 or more")
        found[name] = Control(
            name,
            gains,
            row.flag("gravity_compensation", True),
            row.flag("effort_limits", True),
            row.text("source", ""),
        )
        row.done()
    return found


def read_coupling(table: Table) -> Coupling | None:
    """Return a tool's coupling of actuators and joints, None without one."""
    if "coupling" not in table:
        return None
    row = table.table("coupling")
    joints = row.texts("joints")
    matrix = row.matrix("actuator_to_joint", len(joints), len(joints))
    row.text("source", "")
    row.done()
    try:
        return Coupling(matrix, joints)
    except InputError as problem:
        raise row.fail("actuator_to_joint", str(problem)) from problem


def read_counterweight(table: Table) -> Counterweight | None:
    """Return what balances a joint, None without one."""
    if "counterweight" not in table:
        return None
    row = table.table("counterweight")
    found = Counterweight(row.text("body"), row.text("joint"), row.number("ratio"))
    if found.ratio <= 0.0:
        raise row.fail("ratio", f"got {found.ratio:g}; allowed: above 0")
    row.done()
    return found

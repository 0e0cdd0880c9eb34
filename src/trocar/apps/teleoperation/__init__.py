"""Teleoperation: hands at masters move instruments and the endoscope."""

from trocar.apps.teleoperation.engine import Teleoperation
from trocar.apps.teleoperation.served import component
from trocar.interfaces.crtk import Component
from trocar.interfaces.loop import Loop

__all__ = ["Teleoperation", "component", "components"]


def components(loop: Loop) -> tuple[Component, ...]:
    """Return what a core serves of the teleoperation of a loop's rig: nothing where it has none."""
    arms = loop.world.arms
    able = tuple(t for t in loop.world.rig.teleops if set(t.masters) <= set(arms))
    return (component(Teleoperation(loop, able)),) if able else ()

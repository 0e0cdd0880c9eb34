"""The teleoperation of a rig, and what a core serves of it."""

from trocar.apps.teleoperation.engine import Teleoperation
from trocar.apps.teleoperation.remote import component_of
from trocar.apps.teleoperation.remote_master import RemoteMaster
from trocar.apps.teleoperation.served import component
from trocar.interfaces.crtk import Component
from trocar.interfaces.loop import Loop


def engine_and_components(loop: Loop) -> tuple[Teleoperation, tuple[Component, ...]]:
    """Return the teleoperation of a loop's rig, and what a core serves of it.

    Masters that are no arms of the rig are listened to over topics of their names.
    """
    names = {name for says in loop.world.rig.teleops for name in says.masters}
    away = {
        name: RemoteMaster(name, lambda: loop.now) for name in sorted(names - set(loop.world.arms))
    }
    engine = Teleoperation(loop, None, away)
    return engine, (component(engine), *(component_of(master) for master in away.values()))


def components(loop: Loop) -> tuple[Component, ...]:
    """Return what a core serves of the teleoperation of a loop's rig: nothing where it has none."""
    return engine_and_components(loop)[1] if loop.world.rig.teleops else ()

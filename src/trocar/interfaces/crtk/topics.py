"""Every topic and service of a rig, in one table."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.arm_topics import arm_topics
from trocar.interfaces.crtk.console import Bedside, console_topics, teleop_topics
from trocar.interfaces.crtk.scene import scene_topics
from trocar.interfaces.crtk.services import service_rows
from trocar.interfaces.crtk.tf import viewer_topics
from trocar.interfaces.crtk.topic import (
    Direction,
    Emit,
    Service,
    Topic,
    by_name,
    prefix,
    served,
)

__all__ = [
    "Direction",
    "Service",
    "Topic",
    "prefix",
    "served",
    "service_table",
    "topic_table",
]


def _nowhere(name: str, fields: object) -> None:
    """Publish nothing."""


def topic_table(
    rig: RigDescription, emit: Emit = _nowhere, bedside: Bedside | None = None
) -> tuple[Topic, ...]:
    """Return every topic of a rig, those that come later included.

    Args:
        rig: the rig
        emit: publishes an event
        bedside: does what is no verb of an arm; its own when omitted
    """
    beside = bedside or Bedside(emit)
    arms = (arm_topics(arm, beside.acts(arm.arm.type)) for arm in rig.arms)
    later = (replace(row, later=True) for row in teleop_topics(rig.teleops))
    rows = chain(*arms, viewer_topics(), console_topics(rig, emit), scene_topics(rig), later)
    return tuple(by_name(rows).values())  # each name once: arms of a kind share some


def service_table(rig: RigDescription) -> tuple[Service, ...]:
    """Return every service of a rig."""
    return tuple(
        replace(row, name=f"{prefix(arm.name, arm.arm)}/{row.key}", arm=arm.name)
        for arm in rig.arms
        for row in service_rows(arm.arm)
    )

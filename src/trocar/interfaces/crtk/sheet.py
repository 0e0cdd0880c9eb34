"""States told every period as rows of one table of numbers: most of what is published.

Their messages are not made one by one: their bytes are filled in from the table, in a third of the
time. What they say is what the makers of `arm_messages` and `scene_messages` say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.messages.forms import STAMP, Form, Packing, form, marks
from trocar.interfaces.crtk.sample import RigFigures
from trocar.interfaces.crtk.scene import WORLD
from trocar.interfaces.crtk.topics import Topic
from trocar.simulation.readout import Reader

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Topics of joints: whether they tell set-points, and whether the joints are those at the end.
JOINTS = {
    "measured_js": (False, False),
    "potentiometers/measured_js": (False, False),
    "setpoint_js": (True, False),
    "jaw/measured_js": (False, True),
    "jaw/setpoint_js": (True, True),
    "gripper/measured_js": (False, True),
}
GRAVITY = "gravity_compensation/setpoint_js"
#: Topics of tips: the part of the table that tells of them, and which of its two halves.
TIPS = {
    "measured_cp": ("measured", 1),
    "setpoint_cp": ("setpoint", 1),
    "local/measured_cp": ("measured", 0),
    "local/setpoint_cp": ("setpoint", 0),
    "measured_cv": ("twists", 1),
    "local/measured_cv": ("twists", 0),
    "body/measured_cf": ("wrenches", 0),
    "spatial/measured_cf": ("wrenches", 1),
    "body/jacobian": ("jacobians", 0),
    "spatial/jacobian": ("jacobians", 1),
}
#: Those in the frame of public poses, which may change.
PUBLIC = ("measured_cp", "setpoint_cp", "measured_cv")
#: Parts of the table that are computed only where somebody wants them.
PARTS: dict[str, Callable[[RigFigures], Array]] = {
    "measured": lambda rig: rig.readout.measured_rows,
    "setpoint": lambda rig: rig.readout.setpoint_rows,
    "twists": lambda rig: rig.readout.twists,
    "wrenches": lambda rig: rig.readout.wrenches,
    "jacobians": lambda rig: rig.readout.jacobians,
}


@dataclass(frozen=True)
class Row:
    """A topic.

    Attributes:
        topic: which
        where: its numbers in the table, in the order in which its message has them
        part: of the table, which is only computed for those who want it; "": it is always there
        arm: whose public poses' frame it is told in, "" where that never changes
        words: names of joints, or the frame
    """

    topic: Topic
    where: tuple[int, ...]
    part: str = ""
    arm: str = ""
    words: tuple[str, ...] = ()

    def form(self, packing: Packing, frames: Mapping[str, str]) -> Form:
        """Return the form of its messages, for frames of arms as they are now."""
        numbers, kind = marks(len(self.where)), self.topic.type
        frame = frames[self.arm] if self.arm else next(iter(self.words), "")
        if self.topic.key == GRAVITY:
            message = say.joints(STAMP, self.words, np.zeros(0), np.zeros(0), numbers)
        elif kind == "sensor_msgs/JointState":
            message = say.joints(STAMP, self.words, *np.split(numbers, 3))
        elif kind == "std_msgs/Float64MultiArray":
            message = say.matrix(numbers.reshape(6, -1))
        elif kind == "geometry_msgs/TwistStamped":
            message = say.twist_stamped(STAMP, frame, numbers)
        elif kind == "geometry_msgs/WrenchStamped":
            message = say.wrench_stamped(STAMP, frame, numbers)
        else:
            message = say.row_stamped(STAMP, frame, numbers)
        return form(packing, kind, message, self.where)


class Sheet:
    """The rows of a rig.

    Args:
        reader: of the rig, as its tools are now
        topics: every topic

    Attributes:
        rows: by the name of the topic
    """

    def __init__(self, reader: Reader, topics: Iterable[Topic]) -> None:
        self._reader = reader
        rig, arms, moving = reader.model.rig, len(reader.names), len(reader.moving)
        sizes = [len(arm.arm.mechanism.joint_names) for arm in rig.arms]
        self._own = [arm.arm.own_joints for arm in rig.arms]
        starts = np.cumsum([0, *(6 * size for size in sizes), *self._own]).tolist()
        self._joints = dict(zip(reader.names, starts, strict=False))
        self._loads = dict(zip(reader.names, starts[arms:], strict=False))
        shapes = {
            "measured": (2, arms, 7),
            "setpoint": (2, arms, 7),
            "twists": (2, moving, 6),
            "wrenches": (2, moving, 6),
            "jacobians": (2, moving, 6, reader.columns),
        }
        first, self._parts = starts[-1], dict[str, Index]()
        for part, shape in shapes.items():
            self._parts[part] = np.arange(first, first + prod(shape)).reshape(shape)
            first += prod(shape)
        self._nothing = {part: np.zeros(where.size) for part, where in self._parts.items()}
        self._first_object = first
        self._objects = {f"scene/{prop.name}/measured_cp": k for k, prop in enumerate(rig.objects)}
        self._forms: dict[tuple[int, str], tuple[str, Form]] = {}
        found = ((topic.name, self._row(topic)) for topic in topics)
        self.rows = {name: row for name, row in found if row is not None}

    def form(self, packing: Packing, row: Row, frames: Mapping[str, str]) -> Form:
        """Return the form of a row's messages, made once for a frame."""
        key, frame = (id(packing), row.topic.name), frames.get(row.arm, "")
        found = self._forms.get(key)
        if found is None or found[0] != frame:
            found = self._forms[key] = frame, row.form(packing, frames)
        return found[1]

    def table(self, rig: RigFigures, wanted: frozenset[str]) -> Array:
        """Return the numbers of every row; those of parts that nobody wants are 0."""
        arms = [rig.sample.arms[name] for name in self._reader.names]
        parts: list[Array] = []
        for s in arms:
            parts += (s.q, s.qd, s.effort, s.told_q, s.told_qd, s.told_effort)
        for s, own in zip(arms, self._own, strict=True):
            parts.append(s.load[:own] if s.balanced else np.zeros(own))
        for part, nothing in self._nothing.items():
            parts.append(PARTS[part](rig).ravel() if part in wanted else nothing)
        scene = rig.sample.scene
        if scene is not None and scene.objects is not None:
            parts += (scene.objects.positions.ravel(), scene.objects.quaternions.ravel())
        return np.concatenate(parts)

    def _row(self, topic: Topic) -> Row | None:
        if topic.name in self._objects:
            at = self._first_object + 3 * self._objects[topic.name]
            turn = self._first_object + 3 * len(self._objects) + 4 * self._objects[topic.name]
            where = at, at + 1, at + 2, turn + 1, turn + 2, turn + 3, turn
            return Row(topic, where, words=(WORLD,))
        if topic.direction != "pub" or topic.arm not in self._joints:
            return None
        arm = self._reader.model.rig.arm(topic.arm)
        own, names = arm.arm.own_joints, arm.arm.mechanism.joint_names
        if topic.key in JOINTS:
            told, end = JOINTS[topic.key]
            which = range(own, len(names)) if end else range(own)
            if not which:
                return None
            first, count = self._joints[topic.arm] + 3 * told * len(names), len(names)
            where = tuple(first + k * count + j for k in range(3) for j in which)
            return Row(topic, where, words=tuple(names[j] for j in which))
        if topic.key == GRAVITY:
            first = self._loads[topic.arm]
            return Row(topic, tuple(range(first, first + own)), words=names[:own])
        if topic.key not in TIPS:
            return None
        part, half = TIPS[topic.key]
        rows = self._reader.prepared if part in ("measured", "setpoint") else self._reader.moving
        if topic.arm not in rows:
            return None
        numbers = self._parts[part][half, rows[topic.arm]]
        where = tuple((numbers[:, :own] if part == "jacobians" else numbers).ravel().tolist())
        if topic.key in PUBLIC:
            return Row(topic, where, part, topic.arm)
        frame = arm.name if topic.key == "body/measured_cf" else arm.own_frame
        return Row(topic, where, part, words=(frame,))


class Page:
    """What one transport wants of a sheet.

    Args:
        sheet: of the rig
        packing: of the transport
        names: of the topics that it wants

    Attributes:
        sheet, names: as given
        rest: names of topics that are not on the sheet
    """

    def __init__(self, sheet: Sheet, packing: Packing, names: frozenset[str]) -> None:
        self.sheet, self.names, self._packing = sheet, names, packing
        self._rows = [sheet.rows[name] for name in names if name in sheet.rows]
        self.rest = names.difference(sheet.rows)
        self._arms = {row.arm for row in self._rows if row.arm}
        self._parts = frozenset(row.part for row in self._rows)
        self._frames: dict[str, str] | None = None
        self._forms: list[tuple[Topic, Form]] = []

    def filled(self, rig: RigFigures, stamp: Stamp) -> list[tuple[Topic, Any]]:
        """Return messages as the transport writes them."""
        if not self._rows:
            return []
        frames = {arm: rig.arm(arm).base_frame for arm in self._arms}
        if frames != self._frames:
            rows, form = self._rows, self.sheet.form
            self._forms = [(row.topic, form(self._packing, row, frames)) for row in rows]
            self._frames = frames
        source = self._packing.source(stamp, self.sheet.table(rig, self._parts))
        return [(topic, form.filled(source)) for topic, form in self._forms]

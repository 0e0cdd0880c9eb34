"""States told every period as rows of one table of numbers: most of what is published.

Their messages are not made one by one: their bytes are filled in from the table, in a third of the
time. What they say is what the makers of `arm_messages` and `scene_messages` say.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.figures import RigFigures, joints_of
from trocar.interfaces.crtk.messages.forms import STAMP, Form, Packing, form, marks
from trocar.interfaces.crtk.plan import Plan
from trocar.interfaces.crtk.scene import WORLD
from trocar.interfaces.crtk.topics import Topic

Array = NDArray[np.float64]

#: Topics of joints: whether they tell set-points, and whether the joints are those at the end.
JOINTS = {
    "measured_js": (False, False),
    "setpoint_js": (True, False),
    "jaw/measured_js": (False, True),
    "jaw/setpoint_js": (True, True),
    "gripper/measured_js": (False, True),
}
#: Topics of tips: whether they tell set-points, and whether in the arm's own base.
TIPS = {
    "measured_cp": (False, False),
    "setpoint_cp": (True, False),
    "local/measured_cp": (False, True),
    "local/setpoint_cp": (True, True),
}


@dataclass(frozen=True)
class Row:
    """A topic.

    Attributes:
        topic: which
        where: its numbers in the table, in the order in which its message has them
        arm: whose frame its pose is told in, "" where that never changes
        words: names of joints, or the frame
    """

    topic: Topic
    where: tuple[int, ...]
    arm: str = ""
    words: tuple[str, ...] = ()

    def form(self, packing: Packing, frames: Mapping[str, str]) -> Form:
        """Return the form of its messages, for frames of arms as they are now."""
        numbers, words = marks(len(self.where)), self.words
        if self.topic.type == "sensor_msgs/JointState":
            message = say.joints(STAMP, words, *np.split(numbers, 3))
        else:
            x, y, z, a, b, c, w = numbers.tolist()
            frame = frames[self.arm] if self.arm else words[0]
            message = say.row_stamped(STAMP, frame, ([x, y, z], [w, a, b, c]))
        return form(packing, self.topic.type, message, self.where)


class Sheet:
    """The rows of a rig.

    Args:
        plan: of the rig, as its tools are now
        topics: every topic

    Attributes:
        rows: by the name of the topic
    """

    def __init__(self, plan: Plan, topics: Iterable[Topic]) -> None:
        arms, objects = plan.rig.arms, plan.rig.objects
        sizes = [len(joints_of(arm.arm)[1]) for arm in arms]
        starts = np.cumsum([0, *(6 * size for size in sizes)]).tolist()
        self._joints = dict(zip((arm.name for arm in arms), starts, strict=False))
        self._tips, self._poses = starts[-1], 4 * len(plan.tips)
        self._no_tips = np.zeros(7 * self._poses)
        self._objects = {f"scene/{prop.name}/measured_cp": k for k, prop in enumerate(objects)}
        self._forms: dict[tuple[int, str], tuple[str, Form]] = {}
        found = ((topic.name, self._row(topic, plan)) for topic in topics)
        self.rows = {name: row for name, row in found if row is not None}

    def form(self, packing: Packing, row: Row, frames: Mapping[str, str]) -> Form:
        """Return the form of a row's messages, made once for a frame."""
        key, frame = (id(packing), row.topic.name), frames.get(row.arm, "")
        found = self._forms.get(key)
        if found is None or found[0] != frame:
            found = self._forms[key] = frame, row.form(packing, frames)
        return found[1]

    def table(self, rig: RigFigures, tips: bool) -> Array:
        """Return the numbers of every row; those of tips are 0 where nobody wants them."""
        parts: list[Array] = []
        for arm in rig.sample.rig.arms:
            s = rig.sample.arms[arm.name]
            parts += (s.q, s.qd, s.effort, s.told_q, s.told_qd, s.told_effort)
        parts += (part.ravel() for part in rig.tip_places) if tips else (self._no_tips,)
        scene = rig.sample.scene
        if scene is not None and scene.objects is not None:
            parts += (scene.objects.positions.ravel(), scene.objects.quaternions.ravel())
        return np.concatenate(parts)

    def _row(self, topic: Topic, plan: Plan) -> Row | None:
        if topic.name in self._objects:
            first, count = self._tips + 7 * self._poses, len(self._objects)
            return Row(topic, _place(first, count, self._objects[topic.name]), words=(WORLD,))
        if topic.direction != "pub" or topic.arm not in self._joints:
            return None
        arm = plan.rig.arm(topic.arm).arm
        if topic.key in JOINTS:
            told, end = JOINTS[topic.key]
            own, names = joints_of(arm)
            which = range(own.stop, len(names)) if end else range(own.stop)
            if not which:
                return None
            first, count = self._joints[topic.arm] + 3 * told * len(names), len(names)
            where = tuple(first + k * count + j for k in range(3) for j in which)
            return Row(topic, where, words=tuple(names[j] for j in which))
        if topic.key in TIPS and topic.arm in plan.tips:
            told, local = TIPS[topic.key]
            which = plan.tips[topic.arm] + told + (0 if local else self._poses // 2)
            where = _place(self._tips, self._poses, which)
            return Row(topic, where, "" if local else topic.arm, (f"{topic.arm}_base",))
        return None


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
        self._tips = any(row.topic.key in TIPS for row in self._rows)
        self._frames: dict[str, str] | None = None
        self._forms: list[tuple[Topic, Form]] = []

    def filled(self, rig: RigFigures, stamp: Stamp) -> list[tuple[Topic, Any]]:
        """Return messages as the transport writes them."""
        if not self._rows:
            return []
        frames = {arm: rig.arm(arm).base[1] for arm in self._arms}
        if frames != self._frames:
            rows, form = self._rows, self.sheet.form
            self._forms = [(row.topic, form(self._packing, row, frames)) for row in rows]
            self._frames = frames
        source = self._packing.source(stamp, self.sheet.table(rig, self._tips))
        return [(topic, form.filled(source)) for topic, form in self._forms]


def _place(first: int, count: int, index: int) -> tuple[int, ...]:
    """Return where a pose is among so many positions, then quaternions wxyz: x y z, x y z w."""
    at, turn = first + 3 * index, first + 3 * count + 4 * index
    return at, at + 1, at + 2, turn + 1, turn + 2, turn + 3, turn

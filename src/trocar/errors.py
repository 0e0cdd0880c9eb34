"""Exceptions, which keep their numbers as attributes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches


class TrocarError(Exception):
    """Root of every error that trocar raises on purpose."""


class InputError(TrocarError):
    """A file, message or argument that cannot be used; nothing was changed."""


class RejectedError(TrocarError):
    """A command that an arm rejected; nothing moved. Raised where the world's `on_reject` says so.

    Args:
        arm: its name
        verb: of the command, "servo_jp", "jaw.move_jp", ...
        reason: as warnings have it
    """

    def __init__(self, arm: str, verb: str, reason: str) -> None:
        self.arm, self.verb, self.reason = arm, verb, reason
        super().__init__(f"{arm}: {verb}: {reason}")


class OvertakenError(InputError):
    """A record of a world as it was before a tool was exchanged; ask for a new one."""


class UnknownNameError(InputError):
    """An unknown name.

    Args:
        kind: what was looked for ("arm", "rig", "joint", ...)
        name: what was got
        known: every name that would have been accepted
        where: the file or object that was searched, if that helps
        more: what else is known of that name, if that helps
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str], where: str = "", more: str = ""
    ) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(known)
        near = get_close_matches(str(name)[:200], self.known, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        place = f"{where}: " if where else ""
        tail = f"; {more}" if more else ""
        super().__init__(
            f"{place}unknown {kind} {name!r}{hint}; known: {', '.join(self.known) or 'none'}{tail}"
        )


class DescriptionError(InputError):
    """A description that is broken or contradicts itself.

    Args:
        file: where it was read
        key: the entry, as a path such as ``joint[2].lower_mm``
        problem: what is wrong, with what was got and what is allowed
    """

    def __init__(self, file: str, key: str, problem: str) -> None:
        self.file = file
        self.key = key
        self.problem = problem
        super().__init__(f"{file}: {key}: {problem}" if key else f"{file}: {problem}")


class LogError(InputError):
    """A recording that cannot be read; `row` counts from 1."""

    def __init__(self, file: str, problem: str, row: int | None = None) -> None:
        self.file = file
        self.row = row
        place = f"{file}: row {row}" if row is not None else file
        super().__init__(f"{place}: {problem}")


class RecordingError(TrocarError):
    """A recording that could not be written to its end.

    Args:
        file: the recording
        until: simulation time of the last state in the file [s]
        reason: what went wrong
    """

    def __init__(self, file: str, until: float, reason: str) -> None:
        self.file = file
        self.until = until
        self.reason = reason
        super().__init__(
            f"{file}: nothing is recorded after t = {until:.3f} s: {reason}; the file can be read"
            " up to there"
        )


class TracksError(InputError):
    """A file of motion capture that cannot be used; `line` counts from 1."""

    def __init__(self, file: str, problem: str, line: int | None = None) -> None:
        self.file = file
        self.line = line
        place = f"{file}: line {line}" if line is not None else file
        super().__init__(f"{place}: {problem}")


class FarFromNominalError(TracksError):
    """Tracks of a mechanism that is no robot of the described kind.

    Args:
        file: the tracks
        problem: what is too far off, with what is allowed
        off: {distance, angle or place: (measured, nominal)} of what is too far off [m or rad]
        cause: the likely one
    """

    def __init__(
        self, file: str, problem: str, off: Mapping[str, tuple[float, float]], cause: str
    ) -> None:
        self.problem, self.off, self.cause = problem, dict(off), cause
        super().__init__(file, f"{problem}. {cause}")


class LabelsError(TracksError):
    """Tracks whose bodies have one another's names.

    Args:
        file: the tracks
        problem: what does not fit the description under these names
        labels: {file: {body: the name that it has there}} of those under which the tracks fit
        exchanged: the same in words
    """

    def __init__(
        self, file: str, problem: str, labels: Mapping[str, Mapping[str, str]], exchanged: str
    ) -> None:
        self.labels = {path: dict(names) for path, names in labels.items()}
        super().__init__(file, f"{problem}. {exchanged}")


class UndeterminedError(InputError):
    """Measurements that do not fix what is sought.

    Args:
        problem: what is open, and why
        got: the angle by which the poses differ in the way that counts [rad]
        wanted: the angle required at least [rad]
        condition: condition number of the normal matrix
        direction: along which the answer is open, a unit vector, if it is one
    """

    def __init__(
        self,
        problem: str,
        got: float,
        wanted: float,
        condition: float,
        direction: Iterable[float] | None = None,
    ) -> None:
        self.got = got
        self.wanted = wanted
        self.condition = condition
        self.direction = None if direction is None else tuple(float(v) for v in direction)
        way = "" if self.direction is None else f" {tuple(round(v, 3) for v in self.direction)}"
        super().__init__(
            f"{problem}{way}: got {got:.4f} rad (condition number {condition:.3g}), "
            f"expected at least {wanted:g} rad"
        )


class UnreachableError(TrocarError):
    """A pose that the arm cannot take.

    Args:
        reason: why, and by how much
        excess: by how much each thing in the way is passed, such as {"insertion": 0.021} [rad or m]
    """

    def __init__(self, reason: str, excess: Mapping[str, float] | None = None) -> None:
        self.excess = dict(excess or {})
        super().__init__(reason)


class SingularError(TrocarError):
    """A pose where the arm's joints are not determined."""


class LoopError(TrocarError):
    """A linkage whose loops do not close, or close by the wrong branch."""


class DivergedError(TrocarError):
    """A simulation whose state is no longer finite, with time, joint and last target."""

    def __init__(self, time: float, joint: str, target: float | None, detail: str = "") -> None:
        self.time = time
        self.joint = joint
        self.target = target
        told = "no target" if target is None else f"last target {target:.6g}"
        tail = f": {detail}" if detail else ""
        super().__init__(f"simulation diverged at t = {time:.6f} s in joint {joint} ({told}){tail}")


class MissingExtraError(TrocarError):
    """An optional library that is not installed."""

    def __init__(self, library: str, extra: str, purpose: str) -> None:
        self.library = library
        self.extra = extra
        super().__init__(
            f"{purpose} needs {library}, which is not installed: pip install 'trocar[{extra}]'"
        )

"""Compare the record of a plan with the recorded answers of the dVRK's own software."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

#: A set-point within this is the same. Source: steps of 5 ms and brakes that yield by 0.2 mrad,
#: below the least motion that a step commands (0.02 rad, 1 mm). [rad, m]
SAME = 2e-3
#: A number of a service's answer within this is the same. Source: answers are rounded to 1e-6, and
#: the dVRK's Denavit-Hartenberg table has 1.5708 for pi/2.
SAME_FACT = 2e-4
#: The same where a command interrupts a move: this share of the way beside `SAME`. Source: time of
#: the robot's trajectories is off by up to 30 % on a loaded machine, as they advance by the mean
#: period of a thread; measured.
SAME_INTERRUPTED = 0.35
INTERRUPTED = frozenset((
    "A26 disable during a move", "A28 pause during a move", "B5 servo_jp in a move",
    "B6 hold in a move",
    "E12 servo_jp in a jaw move",
))  # fmt: skip
SETPOINTS = ("setpoint_js", "jaw/setpoint_js")
HANG = "a move while the arm is not homed: the robot stays busy for ever, ours refuses"
RESUME = "pause twice, then resume: ours is ENABLED; the robot stays PAUSED until disabled"
UNSET = "move_jr during a move: the jaw's goal stays; the robot adds a number that it never set"
#: Limits of the jaw, where set-points wait for a trajectory beyond. Source: recorded. [rad]
JAW_LIMITS = (-0.698132, 1.39626)
#: Words of a walk's steps that begin a move.
MOVING = frozenset(("move_jp", "jaw/move_jp", "move_jr"))
OUTCOME = ("operating_state", "desired_state", "goal_reached", "status")
Verdict = Literal["same", "purpose", "differs", "follows"]


@dataclass(frozen=True)
class Row:
    """One step or fact compared.

    Attributes:
        step: its name
        differences: each with both values; empty: same
        verdict: `follows` where the arm stood elsewhere or in another state before the step
        reason: of a difference on purpose
    """

    step: str
    differences: tuple[str, ...]
    verdict: Verdict
    reason: str = ""


def compared(
    got: Mapping[str, Any], recorded: Mapping[str, Any], purpose: Mapping[str, str]
) -> list[Row]:
    """Compare each recorded step and fact.

    Args:
        got: a record of the same plan, of the simulation
        recorded: the dVRK's
        purpose: {step: reason} of intended differences
    """
    rows = []
    hanging = stuck = pending = unset = False
    other = dict(zip(_keys(got), got["steps"], strict=True))
    state: list[Any] = [None, None]
    ends: list[dict[str, Any]] = [{}, {}]
    for key, a in zip(_keys(recorded), recorded["steps"], strict=True):
        b = other.get(key)
        if b is None:
            rows.append(_row(key[0], ["no such step here"], purpose, False))
            continue
        follows = state[0] not in (None, state[1]) or (
            _held(state[0])
            and any(
                not _near(ends[0][k], ends[1][k])
                for k in SETPOINTS
                if k in ends[0] and k in ends[1]
            )
        )
        unset = (unset and not _jaws_agree(ends)) or _takes_unset(a)
        seen = [outcome(a), outcome(b)]
        walk = key[0][0].isdecimal()
        for each in seen if walk else ():
            each["goals"] = _without_repeats(each["goals"])
        for i, each in enumerate(seen):
            state[i] = each["state"] = each["state"] or state[i]
        if seen[0]["state"] is None:  # not reported yet
            seen[0]["state"] = seen[1]["state"]
        interrupted = key[0] in INTERRUPTED or (
            walk and False in seen[0]["goals"] and False in seen[1]["goals"]
        )
        found = [
            f"{k}: {a[k]} here {b.get(k)}"
            for k in SETPOINTS
            if _held(seen[0]["state"])
            and a.get(k)
            and b.get(k)
            and not _near(a[k], b[k])
            and not _moved_alike(a[k], b[k], ends[0].get(k), ends[1].get(k), interrupted)
        ]
        for end, each in zip(ends, (a, b), strict=True):
            end |= {k: each[k] for k in SETPOINTS if each.get(k)}
        found += [
            f"{k}: {seen[0][k]} here {seen[1][k]}"
            for k in seen[0]
            if seen[0][k] != seen[1][k] and not (k == "warning" and seen[1][k])
        ]  # a warning more is no fault
        stuck = _paused(state[0]) and not _paused(state[1]) and (stuck or "resume" in key[0])
        hung = hangs(seen[0]["state"], seen[1]["state"])
        pending = (pending and False not in seen[0]["goals"]) or hung
        unhomed = "homed=0" in _words(state[0]) and "move_cp" in key[0]
        if found and (
            ((hung or hanging) and _only_hang(seen[0], seen[1], found))
            or (unhomed and _only_unsolved(seen[0], seen[1]))
        ):
            rows.append(Row(key[0], tuple(found), "purpose", HANG))
        elif found and stuck:
            rows.append(Row(key[0], tuple(found), "purpose", RESUME))
        elif found and unset and all(each.startswith("jaw/setpoint_js:") for each in found):
            rows.append(Row(key[0], tuple(found), "purpose", UNSET))
        else:
            rows.append(_row(key[0], found, purpose, follows and not hanging))
        hanging = pending
    for name, a in recorded.get("facts", {}).items():
        b = got.get("facts", {}).get(name)
        found = [] if same_fact(a, b) else [f"{a} here {b}"]
        rows.append(_row(name, found, purpose, False))
    return rows


def _without_repeats(goals: Sequence[bool]) -> list[bool]:
    """Return goals without repeats: a move ended just before the next command, or did not."""
    return [goal for i, goal in enumerate(goals) if i == 0 or goal != goals[i - 1]]


def hangs(robot: Any, ours: Any) -> bool:
    """Return whether the robot is busy for ever where the simulation refused a move."""
    a, b = _words(robot), _words(ours)
    return "busy=1" in a and a.replace("busy=1", "busy=0") == b


def _paused(state: Any) -> bool:
    return _words(state).startswith("PAUSED")


def _words(state: Any) -> str:
    return " ".join(state) if isinstance(state, list) else str(state)


def _only_unsolved(robot: Mapping[str, Any], ours: Mapping[str, Any]) -> bool:
    """Return whether the robot found no solution from joints that its simulation had zeroed.

    A real arm's are where it stands, and it would be busy for ever.
    """
    refused = ours["warning"] and not ours["goals"] and robot["state"] == ours["state"]
    return bool(refused and robot["error"] and robot["goals"] == [False])


def _only_hang(robot: Mapping[str, Any], ours: Mapping[str, Any], found: Sequence[str]) -> bool:
    """Return whether two outcomes differ in the hang alone, or in the goal that ended it."""
    state = robot["state"] == ours["state"] or hangs(robot["state"], ours["state"])
    goals = robot["goals"] == ours["goals"] or robot["goals"] == [False, *ours["goals"]]
    return state and goals and all(each.startswith(("state:", "goals:")) for each in found)


def _takes_unset(robot: Mapping[str, Any]) -> bool:
    """Return whether a walk's move_jr came while the robot moved, by its own record.

    Its goal of the jaw then has a number that its code never sets. It is another in each
    recording of the same walk: 0.017, 0.033 and -0.007 rad in three of 43.03.
    """
    words = robot["step"].split()[1:]
    if "move_jr" not in words[1:]:
        return False
    before = [word for word in words[: words.index("move_jr", 1)] if word != "ratio"]
    states = [str(value) for _, topic, value in robot["events"] if topic == "operating_state"]
    began = sum("busy=1" in state for state in states)
    return bool(before) and before[-1] in MOVING and began == 1


def _jaws_agree(ends: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether two records' jaws ended in the same place, not both at a limit.

    At a limit their trajectories may be in different places beyond it.
    """
    a, b = (end.get("jaw/setpoint_js", []) for end in ends)
    return _near(a, b) and not any(_near(a, [limit]) for limit in JAW_LIMITS)


def before_parting(found: Sequence[Row]) -> dict[str, tuple[int, int]]:
    """Return {seed: (commands before the first that differs, commands)} of a walk's rows.

    Args:
        found: rows of steps named `SEED.NUMBER ...`; those without a number prepare the walk
    """
    counted: dict[str, tuple[int, int]] = {}
    parted: set[str] = set()
    for row in found:
        seed, _, command = row.step.partition(".")
        if not command[:1].isdecimal():
            continue
        if row.verdict in ("differs", "follows"):
            parted.add(seed)
        same, count = counted.get(seed, (0, 0))
        counted[seed] = (same + (seed not in parted), count + 1)
    return counted


def outcome(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a step's events that a client acts on.

    That is the last state, the last desired state, goals in their order, and whether an error or
    a warning came; of other topics the last message.
    """
    events = [(topic, value) for _, topic, value in step["events"]]

    def values(topic: str) -> list[Any]:
        return [value for name, value in events if name == topic]

    return {
        "state": values("operating_state")[-1:],
        "desired": values("desired_state")[-1:],
        "goals": values("goal_reached"),
        "error": bool(values("error")),
        "warning": bool(values("warning")),
        "others": {
            topic: value for topic, value in events if topic not in (*OUTCOME, "error", "warning")
        },
    }


def same_fact(a: Any, b: Any) -> bool:
    """Return whether two answers are the same, numbers within `SAME_FACT`."""
    if isinstance(a, dict) and isinstance(b, dict):
        if {"x", "y", "z", "w"} == set(a) == set(b):  # q and -q are one rotation
            p, q = (np.array([each[k] for k in "xyzw"], dtype=float) for each in (a, b))
            return min(np.abs(p - q).max(), np.abs(p + q).max()) <= SAME_FACT
        return set(a) == set(b) and all(same_fact(a[k], b[k]) for k in a if k != "message")
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same_fact, a, b))
    if isinstance(a, bool | str) or isinstance(b, bool | str) or a is None or b is None:
        return type(a) is type(b) and a == b
    return abs(a - b) <= SAME_FACT


def _keys(record: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Return (name, how many of that name came before) of each step."""
    seen: dict[str, int] = {}
    keys = []
    for step in record["steps"]:
        name = step["step"]
        keys.append((name, seen.get(name, 0)))
        seen[name] = seen.get(name, 0) + 1
    return keys


def _held(state: Any) -> bool:
    """Return whether an arm holds its set-points: with power, and homed.

    Without, the robot's own simulation zeroes them, as it sets them to what it measures, and
    measures what was set.
    """
    words = _words(state)
    return "homed=0" not in words and not words.startswith(("DISABLED", "FAULT"))


def _near(a: Sequence[float], b: Sequence[float]) -> bool:
    p, q = np.array(a, dtype=float), np.array(b, dtype=float)
    return p.shape == q.shape and bool(np.all((np.abs(p - q) <= SAME) | np.isnan(p) & np.isnan(q)))


def _moved_alike(
    a: Sequence[float],
    b: Sequence[float],
    a0: Sequence[float] | None,
    b0: Sequence[float] | None,
    interrupted: bool,
) -> bool:
    """Return whether set-points moved by the same, from a0 to a and from b0 to b."""
    if a0 is None or b0 is None or not len(a) == len(a0) == len(b0) == len(b):
        return False
    p, q = np.subtract(a, a0), np.subtract(b, b0)
    share = SAME_INTERRUPTED if interrupted else 0.0
    return bool(np.all(np.abs(p - q) <= SAME + share * np.maximum(np.abs(p), np.abs(q))))


def _row(step: str, found: Sequence[str], purpose: Mapping[str, str], follows: bool) -> Row:
    if not found:
        return Row(step, (), "same")
    if step in purpose:
        return Row(step, tuple(found), "purpose", purpose[step])
    return Row(step, tuple(found), "follows" if follows else "differs")

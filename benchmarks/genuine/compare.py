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
#: The same where a command interrupts a move: time of the recorded moves is off by up to 30 %, as
#: the robot's trajectories advance by the mean period of a thread that other processes delay.
#: Source: the data's notes. [rad, m]
SAME_INTERRUPTED = 0.1
INTERRUPTED = frozenset((
    "A26 disable during a move", "A28 pause during a move", "B5 servo_jp in a move",
    "B6 hold in a move", "E11 jaw servo in an arm move",
))  # fmt: skip
SETPOINTS = ("setpoint_js", "jaw/setpoint_js")
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
    other = dict(zip(_keys(got), got["steps"], strict=True))
    state: list[Any] = [None, None]
    ends: list[dict[str, Any]] = [{}, {}]
    for key, a in zip(_keys(recorded), recorded["steps"], strict=True):
        b = other.get(key)
        if b is None:
            rows.append(_row(key[0], ["no such step here"], purpose, False))
            continue
        follows = state[0] not in (None, state[1]) or any(
            not _near(ends[0][k], ends[1][k]) for k in SETPOINTS if k in ends[0] and k in ends[1]
        )
        found = [
            f"{k}: {a[k]} here {b.get(k)}"
            for k in SETPOINTS
            if a.get(k)
            and b.get(k)
            and not _near(a[k], b[k], SAME_INTERRUPTED if key[0] in INTERRUPTED else SAME)
            and not _moved_alike(a[k], b[k], ends[0].get(k), ends[1].get(k))
        ]
        seen = [outcome(a), outcome(b)]
        for i, (step, each) in enumerate(zip((a, b), seen, strict=True)):
            ends[i] |= {k: step[k] for k in SETPOINTS if step.get(k)}
            state[i] = each["state"] = each["state"] or state[i]
        if seen[0]["state"] is None:  # not reported yet
            seen[0]["state"] = seen[1]["state"]
        found += [
            f"{k}: {seen[0][k]} here {seen[1][k]}"
            for k in seen[0]
            if seen[0][k] != seen[1][k] and not (k == "warning" and seen[1][k])
        ]  # a warning more is no fault
        rows.append(_row(key[0], found, purpose, follows))
    for name, a in recorded.get("facts", {}).items():
        b = got.get("facts", {}).get(name)
        found = [] if same_fact(a, b) else [f"{a} here {b}"]
        rows.append(_row(name, found, purpose, False))
    return rows


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
    a warning came.
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


def _near(a: Sequence[float], b: Sequence[float], within: float = SAME) -> bool:
    p, q = np.array(a, dtype=float), np.array(b, dtype=float)
    return p.shape == q.shape and bool(
        np.all((np.abs(p - q) <= within) | np.isnan(p) & np.isnan(q))
    )


def _moved_alike(
    a: Sequence[float], b: Sequence[float], a0: Sequence[float] | None, b0: Sequence[float] | None
) -> bool:
    """Return whether set-points moved by the same, from a0 to a and from b0 to b."""
    if a0 is None or b0 is None or not len(a) == len(a0) == len(b0) == len(b):
        return False
    return _near(np.subtract(a, a0).tolist(), np.subtract(b, b0).tolist())


def _row(step: str, found: Sequence[str], purpose: Mapping[str, str], follows: bool) -> Row:
    if not found:
        return Row(step, (), "same")
    if step in purpose:
        return Row(step, tuple(found), "purpose", purpose[step])
    return Row(step, tuple(found), "follows" if follows else "differs")

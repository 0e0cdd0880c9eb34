"""Checks by reading: topics and services, and the messages of an arm at rest."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.conformance.expectations import (
    BRIDGE,
    CRTK,
    DESIRED,
    JOINT_STATE,
    LISTED,
    RATES,
    REP,
    SNAPSHOT,
    STATES,
    STATES_TABLE,
    VALUED,
    ArmExpectation,
)
from trocar.conformance.observation import (
    ArmObserver,
    Arrival,
    Message,
    numbers,
    pose,
    pose_error,
    quaternion,
    stamp,
    stamps,
    twist,
)
from trocar.conformance.report import CheckResult, check, skipped
from trocar.errors import TrocarError
from trocar.ros.client import Graph

Array = NDArray[np.float64]

# Tolerances. Source: our own choice where nothing else is named.
#: Share of intervals between stamps that may be longer than LONG times the mean.
LATE_SHARE, LONG = 0.05, 3.0
#: Stamps go back by no more than this: the dVRK's do by a period of its control now and then,
#: measured on its software [s].
BACK_S = 0.02
#: Clock of the stamps against that of arrivals: share and offset [s] of what may be missing.
CLOCK_SHARE, CLOCK_S = 0.1, 0.2
#: Stamps that are farther from the wall clock are simulated time: a day [s].
WALL_S = 86400.0
#: Pause of the kit above which it cannot judge rates and stamps [s].
PAUSE_S = 0.1
#: Newest stamps of an arm's topics may differ by this [s].
APART_S = 0.25
#: Time for a late subscriber to get a latched message [s].
LATE_S = 2.0
#: Norm of a quaternion: messages of the dVRK carry double precision.
NORM = 1e-4
#: Poses of two computations: 0.2 mm and 2 mrad.
PLACE_M, TURN_RAD = 2e-4, 2e-3
#: Joints at rest: speed below which they are [rad/s or m/s], and the tip's [m/s, rad/s].
REST, TIP_REST = 5e-3, 0.02
#: Measured beside commanded positions of an arm that holds [rad, m].
HOLD_RAD, HOLD_M = 0.05, 0.005
POSES = ("measured_cp", "setpoint_cp", "local/measured_cp", "local/setpoint_cp")


def offered(graph: Graph, arm: str, expected: ArmExpectation) -> Iterator[CheckResult]:
    """Check names and types of topics and services."""
    group, core = "Topics and services", expected.required
    out = {**expected.streams, **expected.events}
    tables = (
        ("published topics are there", out, graph.published),
        ("commands are subscribed to", expected.commands, graph.subscribed),
        ("services are there", expected.services, graph.services),
    )
    source = LISTED if expected.kind != "CRTK" else CRTK
    for name, wanted, found in tables:
        missing = [key for key in wanted if key in core and f"{arm}/{key}" not in found]
        text = f"missing: {', '.join(missing)}" if missing else f"{len(wanted)} names"
        if not any(key in core for key in wanted):
            yield skipped(group, name, "no name is required of an arm of CRTK", source)
        else:
            yield check(group, name, not missing, text, source=source)
        kinds = [(key, found.get(f"{arm}/{key}", "")) for key in wanted]
        other = [f"{key}: {kind}" for key, kind in kinds if kind and kind != wanted[key]]
        typed = [key for key, kind in kinds if kind]
        what = name.removesuffix(" are there").removesuffix(" are subscribed to")
        if typed:
            text = "; ".join(other) or f"{len(typed)} types"
            yield check(group, f"{what} have their types", not other, text, source=source)
        else:
            yield skipped(group, f"{what} have their types", "types are not listed", source)


def late(watch: ArmObserver) -> Iterator[CheckResult]:
    """Check that subscribers that come late get events; `watch` is the late subscriber."""
    group = "Late subscribers"
    for key in VALUED:
        name = f"{key} comes at once"
        if key not in watch.subscribed:
            yield skipped(group, name, "not published, or of another type", BRIDGE)
            continue
        rows = watch.since(watch.subscribed[key], key)
        after = rows[0].time - watch.subscribed[key] if rows else float("inf")
        text = f"after {after:.2f} s" if rows else "no message"
        yield check(group, name, after <= LATE_S, text, f"<= {LATE_S:g} s", BRIDGE)
    marks = {
        key: watch.client.latched(f"{watch.arm}/{key}")
        for key in watch.expected.events
        if key in watch.subscribed
    }
    name = "events are offered as latched (ROS 2: TRANSIENT_LOCAL)"
    if all(mark is None for mark in marks.values()):
        yield skipped(group, name, f"{watch.client.name} does not show it", BRIDGE)
        return
    volatile = [key for key, mark in marks.items() if mark is False]
    text = f"not latched: {', '.join(volatile)}" if volatile else f"{len(marks)} events"
    yield check(group, name, not volatile, text, source=BRIDGE)


def streams(
    watch: ArmObserver, begin: float, end: float, rate_hz: float, paused: float
) -> Iterator[CheckResult]:
    """Check rates, stamps and numbers of messages that arrived between two times [s].

    Args:
        watch: observes the arm
        begin, end: the times
        rate_hz: lowest rate
        paused: the longest pause of this program; a long one makes rates and stamps meaningless
    """
    rows = {
        key: [row for row in watch.since(begin, key) if row.time <= end]
        for key in watch.expected.streams
        if key in watch.subscribed
    }
    silent = [key for key, found in rows.items() if not found]
    text = f"no message of {', '.join(silent)}" if silent else f"{len(rows)} topics"
    yield check("Streams", "every stream is published", not silent, text, source=LISTED)
    if paused > PAUSE_S:
        reason = f"this computer is busy: the kit paused for {paused:.2f} s"
        yield skipped("Streams", "rates and stamps", reason, RATES)
    else:
        headed = {k: found for k, found in rows.items() if found and "header" in found[0].message}
        part = f"{watch.expected.part}/measured_js"
        if part in headed and not stamps(headed[part]).any():
            del headed[part]  # a simulated gripper of the dVRK has no stamps: recorded
        yield from _rates(rows, end - begin, rate_hz)
        yield from _stamps(headed, watch.arm)
    wrong = [key for key, found in rows.items() if any(not _finite(r.message) for r in found)]
    text = f"NaN or infinity in {', '.join(wrong)}" if wrong else f"{len(rows)} topics"
    yield check("Streams", "numbers are finite", not wrong, text, source=JOINT_STATE)


def _rates(
    rows: Mapping[str, Sequence[Arrival]], seconds: float, rate_hz: float
) -> Iterator[CheckResult]:
    group = "Streams"
    rates = {key: len(found) / seconds for key, found in rows.items() if found}
    if not rates:
        yield skipped(group, "rate", "no message", RATES)
        return
    least = min(rates, key=lambda key: rates[key])
    slow = [f"{key} {rate:.0f} Hz" for key, rate in rates.items() if rate < rate_hz]
    text = ", ".join(slow) or f"{rates[least]:.0f} Hz ({least}) to {max(rates.values()):.0f} Hz"
    yield check(group, "rate", not slow, text, f">= {rate_hz:g} Hz", RATES)


def _stamps(rows: Mapping[str, Sequence[Arrival]], arm: str) -> Iterator[CheckResult]:
    group = "Streams"
    times = {key: stamps(found) for key, found in rows.items()}
    if not any(len(found) > 1 for found in times.values()):
        yield skipped(group, "stamps do not go back", "no two messages with a header", REP)
        return
    falls = {key: -float(np.diff(found).min(initial=0.0)) for key, found in times.items()}
    back = [f"{key}: {1e3 * fall:.0f} ms" for key, fall in falls.items() if fall > BACK_S]
    text = ", ".join(back) or f"{1e3 * max(falls.values()):.0f} ms at most"
    allowed = f"<= {1e3 * BACK_S:g} ms"
    yield check(group, "stamps do not go back", not back, text, allowed, REP)
    uneven: list[str] = []
    for key, found in times.items():
        gaps = np.diff(np.sort(found))
        share = float((gaps > LONG * gaps.mean()).mean()) if len(gaps) else 0.0
        if share > LATE_SHARE:
            uneven.append(f"{key}: {100.0 * share:.0f} %")
    text = ", ".join(uneven) or f"{len(times)} topics"
    allowed = f"<= {100.0 * LATE_SHARE:g} % of intervals above {LONG:g} times the mean"
    yield check(group, "stamps are even", not uneven, text, allowed, RATES)
    if abs(max(float(found[-1]) for found in times.values()) - time.time()) > WALL_S:
        yield skipped(group, "stamps keep time", "stamps are not of the wall clock", REP)
    else:
        wrong: list[str] = []
        for key, found in times.items():
            arrived = rows[key][-1].time - rows[key][0].time
            passed = float(found[-1] - found[0])
            if abs(passed - arrived) > CLOCK_SHARE * arrived + CLOCK_S:
                wrong.append(f"{key}: {passed:.2f} s in {arrived:.2f} s")
        text = ", ".join(wrong) or f"{len(times)} topics"
        yield check(group, "stamps keep time", not wrong, text, source=REP)
    newest = {key: float(found[-1]) for key, found in times.items()}
    latest = max(newest.values())
    old = [f"{key}: {latest - s:.2f} s" for key, s in newest.items() if latest - s > APART_S]
    text = ", ".join(old) or f"{latest - min(newest.values()):.3f} s"
    yield check(group, f"newest stamps of {arm}/* agree", not old, text, f"<= {APART_S:g} s", REP)


def at_home(watch: ArmObserver) -> bool:
    """Test whether the arm is enabled and homed."""
    return watch.state == "ENABLED" and watch.flag("is_homed")


def _finite(message: Any) -> bool:
    if isinstance(message, Mapping):
        return all(_finite(value) for value in cast(Mapping[str, Any], message).values())
    if isinstance(message, float | np.ndarray):
        return bool(np.isfinite(np.asarray(message, np.float64)).all())
    return True


def joints(watch: ArmObserver) -> Iterator[CheckResult]:
    """Check names and sizes of joint states, and set-points beside measurements."""
    group = "Joints"
    q = watch.positions("measured_js")
    if not at_home(watch) and (q is None or not len(q)):
        yield skipped(group, "names and sizes", f"{watch.state}: no joints are published", SNAPSHOT)
        return
    last = {key: watch.last(key) for key in watch.expected.streams}
    states = {key: r.message for key, r in last.items() if r is not None and key.endswith("js")}
    sizes: list[str] = []
    for key, message in states.items():
        count = len(message["name"])
        for field in ("position", "velocity", "effort"):
            if len(message[field]) not in (0, count):
                sizes.append(f"{key}: {len(message[field])} in {field} of {count} joints")
    text = "; ".join(sizes) or f"{len(states)} topics"
    yield check(group, "one number per joint, or none", not sizes, text, source=JOINT_STATE)
    measured = states.get("measured_js")
    if measured is None:
        yield skipped(group, "names", "no measured_js", SNAPSHOT)
        return
    names = tuple(map(str, measured["name"]))
    indices = tuple(str(k) for k in range(len(names)))
    wanted = watch.expected.joints or names
    met = bool(names) and len(set(names)) == len(names) and names in (wanted, indices)
    yield check(
        group, "names of measured_js", met, ", ".join(names) or "none", ", ".join(wanted), SNAPSHOT
    )
    setpoint = states.get("setpoint_js")
    if setpoint is not None:
        other = tuple(map(str, setpoint["name"]))
        yield check(
            group, "setpoint_js has the same joints", other == names, ", ".join(other),
            ", ".join(names), SNAPSHOT,
        )  # fmt: skip
    part = watch.expected.part
    if part:
        found = {k: tuple(m["name"]) for k, m in states.items() if k.startswith(f"{part}/")}
        wrong = [f"{k}: {', '.join(v)}" for k, v in found.items() if v not in ((part,), ("0",))]
        text = "; ".join(wrong) or ", ".join(found) or "no message"
        yield check(group, f"one joint, {part}", bool(found) and not wrong, text, part, SNAPSHOT)
    yield _holds(watch, measured, setpoint)


def _holds(watch: ArmObserver, measured: Message, setpoint: Message | None) -> CheckResult:
    group, name = "Joints", "measured positions are at the set-points"
    if setpoint is None:
        return skipped(group, name, "no setpoint_js", CRTK)
    if not at_home(watch):
        return skipped(group, name, f"the arm is {watch.state or 'without a state'}", CRTK)
    q, goal = numbers(measured, "position"), numbers(setpoint, "position")
    if q.shape != goal.shape:
        return check(group, name, False, f"{len(q)} and {len(goal)} positions", "", CRTK)
    slides = np.array([str(n) in ("insertion", "2") for n in measured["name"]], bool)
    share = np.abs(q - goal) / np.where(slides, HOLD_M, HOLD_RAD)
    worst = int(np.argmax(share))
    text = f"{measured['name'][worst]}: {abs(q - goal)[worst]:.2g}"
    return check(
        group, name, bool(share[worst] <= 1.0), text, f"<= {HOLD_RAD:g} rad, {HOLD_M:g} m", CRTK
    )


def frames(watch: ArmObserver) -> Iterator[CheckResult]:
    """Check frames, quaternions, and that an arm at rest has no velocity."""
    group = "Frames"
    last = {key: watch.last(key) for key in (*POSES, "measured_cv", "local/measured_cv")}
    rows = {key: row.message for key, row in last.items() if row is not None}
    posed = {key: rows[key] for key in POSES if key in rows}
    named = {key: str(message["header"]["frame_id"]) for key, message in rows.items()}
    if not posed:
        yield skipped(group, "poses name their frame", "no pose", SNAPSHOT)
        return
    bare = [key for key in posed if not named[key]]
    text = f"no frame_id in {', '.join(bare)}" if bare else ", ".join(sorted(set(named.values())))
    yield check(group, "poses name their frame", not bare, text, source=SNAPSHOT)
    base = f"{watch.arm.rpartition('/')[2]}_base"
    own = {key: frame for key, frame in named.items() if key.startswith("local/")}
    name = "local poses and velocities are in the arm's own base frame"
    if own and watch.expected.kind != "CRTK":
        wrong = [f"{key}: {frame}" for key, frame in own.items() if frame != base]
        yield check(group, name, not wrong, "; ".join(wrong) or base, base, SNAPSHOT)
    else:
        yield skipped(group, name, "no name of the frame is agreed on", SNAPSHOT)
    shared = {named[key] for key in ("measured_cp", "setpoint_cp") if key in named}
    yield check(
        group, "measured_cp and setpoint_cp share a frame", len(shared) <= 1,
        ", ".join(sorted(shared)), source=SNAPSHOT,
    )  # fmt: skip
    if "measured_cv" in named:
        allowed = {named.get("measured_cp", base), base}
        yield check(
            group, "measured_cv is in that frame, or names the base",
            named["measured_cv"] in allowed, named["measured_cv"], " or ".join(sorted(allowed)),
            SNAPSHOT,
        )  # fmt: skip
    norms = {
        key: float(np.linalg.norm(quaternion(message["pose"]["orientation"])))
        for key, message in posed.items()
    }
    wrong = [f"{key}: {norm:.6g}" for key, norm in norms.items() if not abs(norm - 1.0) <= NORM]
    text = "; ".join(wrong) or f"{len(norms)} topics"
    yield check(group, "quaternions have norm 1", not wrong, text, f"1 +- {NORM:g}", REP)
    yield _rests(watch, rows)


def _rests(watch: ArmObserver, rows: Mapping[str, Message]) -> CheckResult:
    group, name = "Frames", "the tip of an arm at rest has no velocity"
    joint = watch.last("measured_js")
    speeds = np.zeros(0) if joint is None else np.abs(numbers(joint.message, "velocity"))
    if not speeds.size or speeds.max() > REST or "measured_cv" not in rows:
        return skipped(group, name, "the arm moves, or publishes no velocities", CRTK)
    found = twist(rows["measured_cv"]["twist"])
    most = float(np.abs(found).max())
    return check(group, name, most <= TIP_REST, f"{most:.2g}", f"<= {TIP_REST:g} m/s, rad/s", CRTK)


def kinematics(watch: ArmObserver) -> Iterator[CheckResult]:
    """Check that services and topics describe one arm; it must be at rest."""
    group = "Kinematics"
    moving = _moving(watch)
    q = watch.positions("measured_js")
    if not at_home(watch) and (q is None or not len(q)):
        yield skipped(group, "services and topics", f"{watch.state}: no joints are published", CRTK)
        return
    pairs = (
        ("forward_kinematics", "measured_js", "measured_cp"),
        ("forward_kinematics", "setpoint_js", "setpoint_cp"),
        ("local/forward_kinematics", "measured_js", "local/measured_cp"),
    )
    for service, joint, placed in pairs:
        name = f"{service} of {joint} is {placed}"
        q, at = watch.positions(joint), watch.last(placed)
        if moving or q is None or at is None:
            yield skipped(group, name, moving or f"no {joint} or {placed}", CRTK)
            continue
        if f"{watch.arm}/{service}" not in watch.graph.services:
            yield skipped(group, name, "no such service", CRTK)
            continue
        try:
            reply = watch.call(service, {"jp": q})
        except TrocarError as error:
            yield check(group, name, False, str(error), source=CRTK)
            continue
        if reply["result"]:
            yield _agree(group, name, pose(reply["cp"]), pose(at.message["pose"]))
        else:
            text = f"result false: {reply['message']}"
            yield check(group, name, False, text, source=CRTK)
    yield _inverse(watch, moving)
    yield from _jacobians(watch)
    yield _version(watch)


def _moving(watch: ArmObserver) -> str:
    """Return that the arm moves, "" at rest."""
    newest = watch.last("measured_js")
    speeds = np.zeros(0) if newest is None else np.abs(numbers(newest.message, "velocity"))
    return "the arm moves" if speeds.size and speeds.max() > REST else ""


def _inverse(watch: ArmObserver, moving: str) -> CheckResult:
    """Check inverse kinematics by forward kinematics: an arm may have several answers."""
    group, name = "Kinematics", "inverse_kinematics is the inverse of local/forward_kinematics"
    q, at = watch.positions("measured_js"), watch.last("local/measured_cp")
    services = ("inverse_kinematics", "local/forward_kinematics")
    if any(f"{watch.arm}/{key}" not in watch.graph.services for key in services):
        return skipped(group, name, "no such service", CRTK)
    if moving or q is None or at is None:
        return skipped(group, name, moving or "no measured_js or local/measured_cp", CRTK)
    try:
        reply = watch.call(services[0], {"jp": q, "cp": at.message["pose"]})
        if not reply["result"]:
            return check(group, name, False, f"result false: {reply['message']}", source=CRTK)
        again = watch.call(services[1], {"jp": numbers(reply, "jp")[: len(q)]})
    except TrocarError as error:
        return check(group, name, False, str(error), source=CRTK)
    return _agree(group, name, pose(again["cp"]), pose(at.message["pose"]))


def _agree(group: str, name: str, Ta: Array, Tb: Array) -> CheckResult:
    off, turn = pose_error(Ta, Tb)
    text = f"{1e3 * off:.3g} mm, {1e3 * turn:.3g} mrad"
    allowed = f"<= {1e3 * PLACE_M:g} mm, {1e3 * TURN_RAD:g} mrad"
    return check(group, name, off <= PLACE_M and turn <= TURN_RAD, text, allowed, CRTK)


def _jacobians(watch: ArmObserver) -> Iterator[CheckResult]:
    group, q = "Kinematics", watch.positions("measured_js")
    for key in ("body/jacobian", "spatial/jacobian"):
        newest, name = watch.last(key), f"{key} has 6 rows, and a column per joint"
        if newest is None or q is None:
            yield skipped(group, name, f"no {key}", SNAPSHOT)
            continue
        sizes = [int(dim["size"]) for dim in newest.message["layout"]["dim"]]
        count = len(numbers(newest.message, "data"))
        met = sizes == [6, len(q)] and count == 6 * len(q)
        yield check(group, name, met, f"{sizes}, {count} numbers", f"[6, {len(q)}]", SNAPSHOT)


def _version(watch: ArmObserver) -> CheckResult:
    group, name = "Kinematics", "crtk_version answers"
    if f"{watch.arm}/crtk_version" not in watch.graph.services:
        return skipped(group, name, "no such service", CRTK)
    try:
        reply = watch.call("crtk_version", {})
    except TrocarError as error:
        return check(group, name, False, str(error), source=CRTK)
    return check(group, name, bool(reply["success"]), str(reply["message"]), source=CRTK)


def states(watch: ArmObserver) -> Iterator[CheckResult]:
    """Check the operating state, as topic and service, and what goes with it."""
    group, newest = "States", watch.last("operating_state")
    if newest is None:
        yield skipped(group, "operating_state is one of CRTK's", "no operating_state", CRTK)
        return
    state = watch.state
    yield check(
        group, "operating_state is one of CRTK's", state in STATES, state, ", ".join(STATES), CRTK
    )
    stamped = stamp(newest.message) > 0.0
    yield check(
        group, "operating_state is stamped", stamped, f"{stamp(newest.message):.3f}", "> 0", REP
    )
    name = "the service operating_state agrees with the topic"
    if f"{watch.arm}/operating_state" in watch.graph.services:
        try:
            reply = watch.call("operating_state", {})["operating_state"]
        except TrocarError as error:
            yield check(group, name, False, str(error), source=CRTK)
        else:
            both = [f"{m['state']}, homed {bool(m['is_homed'])}" for m in (reply, newest.message)]
            yield check(group, name, both[0] == both[1], " / ".join(both), source=CRTK)
    else:
        yield skipped(group, name, "no such service", CRTK)
    desired = watch.last("desired_state")
    if desired is None:
        yield skipped(group, "desired_state is a state, or HOMED", "no message", STATES_TABLE)
    else:
        text = str(desired.message["data"])
        allowed = ", ".join(DESIRED)
        yield check(
            group,
            "desired_state is a state, or HOMED",
            text in DESIRED,
            text,
            allowed,
            STATES_TABLE,
        )
    for key in ("trajectory_j/ratio", "trajectory_j/ratio_v", "trajectory_j/ratio_a"):
        row = watch.last(key)
        if row is not None:
            # 0 where the two others differ: B17 of the recording
            ratio, least = float(row.message["data"]), 0.0 if key.endswith("ratio") else 1e-9
            met = least <= ratio <= 1.0
            yield check(group, f"{key} is a ratio", met, f"{ratio:g}", "above 0, up to 1", CRTK)

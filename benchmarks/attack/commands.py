"""Random commands with extreme arguments, called from Python.

Every verb of a world, its arms, their jaws and grippers, its objects and tissues is called, found
by the mark that `trocar.simulation.journal.command` leaves. A case is one call and the steps after
it. It fails when the call raises something else than a TrocarError, when a step raises, when the
state is not finite, when MuJoCo warns, or when an arm without power moves.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from inspect import signature
from operator import attrgetter
from typing import Any

import numpy as np

from benchmarks.attack import SCENE, Tally
from trocar.descriptions import fitting_tools
from trocar.descriptions.catalogue import load_scene
from trocar.errors import TrocarError
from trocar.simulation import World
from trocar.simulation.arm import VERBS, Arm
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains

#: Rigs with every kind of arm, tool and object; the last three and the scenes are slow.
RIGS = ("psm", "mtm", "ecm", "pegs", SCENE, "thread-handover", "suturing", "full_cart")
SCENES = (SCENE, "thread-handover", "suturing")
#: Calls until another rig's turn. Source: our own choice.
CALLS = 200
#: An arm without power moves less than this. Source: its loops relax by 4e-11 (measured) from
#: wherever they were when it was switched off. [rad or m]
STILL = 1e-6
#: Bodies that overlap by more were put into each other; they push arms apart that brakes hold.
#: Source: our own choice. [m]
OVERLAP = -1e-3
EXTREME = (
    0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e-150, -1e-12, 1e-6, 1e-3, -0.1, 1.0, -1.0, 3.2, 100.0,
    1e3, 1e6, -1e6, 1e9, 1e12, -1e100, 1e154, 1e200, 1e300, 1.7e308, -1.7e308,
)  # fmt: skip
RUBBISH: tuple[Any, ...] = ("", "yaw", True, [], {}, float("nan"), float("-inf"), 10**400, 1j)
#: Commands that put an arm elsewhere by other means than motion.
ELSEWHERE = {"reset", "set_state", "exchange_tool", "set_tool_type", "play", "set_mode"}
#: Commands that switch the power on; a fault may switch it off within the case.
ELSEWHERE |= {"enable", "home", "state_command"}
#: Calls that take as long as a hundred others, and how often they are left out.
SLOW = {"exchange_tool": 0.97, "set_tool_type": 0.97, "play": 0.7}

Rng = np.random.Generator
Verb = tuple[str, Any, Callable[..., Any]]


def attack(seed: int, seconds: float) -> Tally:
    """Call commands for so long [s]."""
    tally = Tally("commands")
    end = time.monotonic() + seconds
    with quiet():
        for number in range(1 << 30):
            rng = np.random.default_rng((seed, number))
            rig = RIGS[number % len(RIGS)]
            for failure in episode(rng, rig, CALLS, lambda: time.monotonic() > end, tally):
                tally.failed.append(f"seed {seed}, episode {number}: {failure}")
            if time.monotonic() > end:
                return tally
    return tally


def episode(
    rng: Rng, rig: str, calls: int, over: Callable[[], bool], tally: Tally
) -> Iterator[str]:
    """Call verbs of a world; yield what failed, at most one, since the world is then broken."""
    homed = bool(rng.random() < 0.8)
    if rig in SCENES:
        scene = load_scene(rig)
        world = World(scene.rig, homed=homed, welded=scene.welded)
    else:
        world = World(rig, homed=homed)
    for _ in range(calls):
        if over():
            return
        found = verbs(world)
        name, owner, verb = found[rng.integers(len(found))]
        if rng.random() < SLOW.get(verb.__name__, 0.0):
            continue
        given = arguments(rng, world, owner, verb)
        tally.tried += 1
        problem = outcome(world, verb, given, int(rng.integers(1, 30)))
        if problem:
            yield f"{rig}: {name}({shown(given)}): {problem}"
            return


def outcome(world: World, verb: Callable[..., Any], given: Mapping[str, Any], steps: int) -> str:
    """Call a verb and step; return what went wrong, "" where nothing did."""
    before = {
        arm.name: (arm.runtime.motors.powered, arm.joints.positions())
        for arm in world.arms.values()
    }
    try:
        verb(**given)
    except TrocarError:
        pass  # a rejection
    except Exception as error:  # noqa: BLE001  that is what is looked for
        return f"{type(error).__name__}: {error}"
    try:
        world.step(steps)
    except Exception as error:  # noqa: BLE001  that is what is looked for
        return f"step: {type(error).__name__}: {error}"
    data = world.mj_data
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        return "the state is not finite"
    if world.engine_warnings():
        return f"MuJoCo warns: {world.engine_warnings()}"
    overlap = bool((data.contact.dist < OVERLAP).any())
    pressed = touched(world)
    for arm in world.arms.values():
        powered, was = before[arm.name]
        if overlap or powered or arm.runtime.motors.powered or verb.__name__ in ELSEWHERE:
            continue
        if arm.name in pressed:
            continue
        inside = (arm.joints.lower < was) & (
            was < arm.joints.upper
        )  # a stop pushes back what was beyond it
        moved = float(np.abs(arm.joints.positions() - was)[: arm.description.own_joints].max())
        if inside.all() and not moved < STILL:
            return f"{arm.name} has no power and moved by {moved:g}"
    return ""


def touched(world: World) -> set[str]:
    """Return the names of the arms that another arm overlaps with, and so pushes."""
    model, contact = world.mj_model, world.mj_data.contact
    found: set[str] = set()
    for pair in contact.geom[contact.dist < 0.0]:
        owners = {model.body(model.geom_bodyid[geom]).name.split("/")[0] for geom in pair}
        if len(owners & world.arms.keys()) > 1:
            found |= owners
    return found


def verbs(world: World) -> list[Verb]:
    """Return (name, owner, method) of every command of a world."""
    owners: list[tuple[str, Any]] = [("world", world)]
    moved: list[Verb] = []
    for arm in world.arms.values():
        owners.append((arm.name, arm))
        for verb, path in VERBS.items():
            moved.append((f"{arm.name}.{verb}", arm, attrgetter(path)(arm)))
        owners += [(f"{arm.name}.{n}", part) for n in PARTS if (part := getattr(arm, n))]
    owners += [*world.objects.items(), *world.tissues.items()]
    return moved + [
        (f"{name}.{verb}", owner, getattr(owner, verb))
        for name, owner in owners
        for verb, method in vars(type(owner)).items()
        if getattr(method, "is_command", False)
    ]


PARTS = ("jaw", "gripper")


def arguments(rng: Rng, world: World, owner: Any, verb: Callable[..., Any]) -> dict[str, Any]:
    """Return arguments of a verb by the names of its parameters, some of them left out.

    Raises:
        KeyError: a parameter that no maker is known for: add it to `MAKERS`
    """
    count = 1
    if isinstance(owner, Arm):
        count = owner.description.own_joints
    given: dict[str, Any] = {}
    for name, parameter in signature(verb).parameters.items():
        if parameter.default is not parameter.empty and rng.random() < 0.5:
            continue
        maker = MAKERS.get(f"{verb.__name__}.{name}") or MAKERS[name]
        spoilt = name in NUMERIC and rng.random() < 0.05
        given[name] = rubbish(rng) if spoilt else maker(rng, world, owner, count)
    return given


def shown(given: Mapping[str, Any]) -> str:
    """Return arguments as they are written in Python."""
    with np.printoptions(precision=17, threshold=200, linewidth=1000):
        return ", ".join(f"{name}={value!r}" for name, value in given.items())[:2000]


@contextmanager
def quiet() -> Iterator[None]:
    """Log no rejections; raise numpy's warnings of overflows as errors, as tests do."""
    log = logging.getLogger("trocar")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        log.setLevel(before)


# ---------------------------------------------------------------------- values


def extreme(rng: Rng) -> float:
    """Return a finite number."""
    return float(EXTREME[rng.integers(len(EXTREME))])


def rubbish(rng: Rng) -> Any:
    """Return a value that is of no use."""
    return RUBBISH[rng.integers(len(RUBBISH))]


def number(rng: Rng) -> float:
    """Return a number that may be of use, or an extreme one."""
    return extreme(rng) if rng.random() < 0.5 else float(rng.normal())


def numbers(rng: Rng, count: int) -> Any:
    """Return so many numbers, most of them finite; now and then another count, or none."""
    kind = rng.random()
    if kind < 0.05:
        return np.zeros(count + 1)
    if kind < 0.08:
        return np.full(count, np.nan)
    if kind < 0.1:
        return [rubbish(rng)] * count
    small = 0.2 * rng.standard_normal(count)
    if kind < 0.4:
        return small
    wild = np.array([extreme(rng) for _ in range(count)])
    return np.where(rng.random(count) < 0.4, wild, small) if kind < 0.8 else wild.tolist()


def rotation(rng: Rng) -> Any:
    """Return a rotation matrix or a quaternion, sometimes not quite."""
    turn = rng.standard_normal(4)
    turn /= np.linalg.norm(turn)
    if rng.random() < 0.3:
        return turn if rng.random() < 0.7 else turn * extreme(rng)
    w, x, y, z = turn
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    if rng.random() < 0.1:
        with np.errstate(over="ignore"):
            matrix *= extreme(rng)
    return matrix


def pose(rng: Rng, _: World, owner: Any, count: int) -> Any:  # noqa: ARG001
    """Return a pose near the tip, or far away, sometimes not quite."""
    T = np.eye(4)
    R = rotation(rng)
    if np.shape(R) == (3, 3):
        T[:3, :3] = R
    if isinstance(owner, Arm) and rng.random() < 0.6:
        T = owner.setpoint_cp().matrix.copy()
        T[:3, 3] += 0.02 * rng.standard_normal(3)
        return T
    T[:3, 3] = [number(rng) for _ in range(3)]
    return T if rng.random() < 0.9 else T[:3]


def points(rng: Rng, *_: Any) -> Any:
    """Return points of a curve, sometimes too few, or extreme ones."""
    kind = rng.random()
    if kind < 0.2:
        return numbers(rng, 3)
    curve = np.cumsum(0.02 * rng.standard_normal((rng.integers(1, 20), 3)), axis=0)
    if kind < 0.5:
        curve[rng.integers(len(curve))] = number(rng)
    return curve if kind < 0.8 else np.linspace([0.0, 0.0, 0.1], [0.3, 0.0, 0.1], 5)


def plan(rng: Rng, world: World, owner: Any, count: int) -> Any:  # noqa: ARG001
    """Return channel points of stitches in a tissue, moved a little or to extremes."""
    if rng.random() < 0.2:
        return numbers(rng, 3)
    moved = owner.plan + 1e-4 * rng.standard_normal(owner.plan.shape)
    if rng.random() < 0.4:
        moved[rng.integers(len(moved)), rng.integers(4)] = number(rng)
    return moved


def impedance(rng: Rng) -> CartesianImpedance:
    """Return springs and dampers, some of them extreme."""

    def three() -> np.ndarray:
        wild = rng.random() < 0.4
        return np.array([extreme(rng) if wild else rng.normal(scale=20.0) for _ in range(3)])

    sides = [HalfPlaneGains(three(), three(), three(), np.abs(three())) for _ in range(4)]
    axes = [R if np.shape(R := rotation(rng)) == (3, 3) else np.eye(3) for _ in range(2)]
    return CartesianImpedance(three(), axes[0], axes[1], *sides)


def some_joints(rng: Rng, world: World, owner: Any, count: int) -> Any:  # noqa: ARG001
    """Return names of some joints of an arm."""
    names = [n for n in owner.joints.names if rng.random() < 0.5]
    return [*names, "elbow"] if rng.random() < 0.1 else names


def any_joint(rng: Rng, world: World, owner: Any, count: int) -> str:  # noqa: ARG001
    """Return the name of a joint of an arm, or of none."""
    return str(rng.choice([*owner.joints.names, "elbow"]))


def any_pose(rng: Rng, world: World, owner: Any, count: int) -> str:  # noqa: ARG001
    """Return the name of a pose of an arm, or of none."""
    return str(rng.choice([*owner.joints.poses, "nowhere"]))


def any_arm(rng: Rng, world: World, owner: Any, count: int) -> str:  # noqa: ARG001
    """Return the name of an arm, or of nobody."""
    return str(rng.choice([*world.arms, "PSM9"]))


def any_tool(rng: Rng, world: World, owner: Any, count: int) -> str:  # noqa: ARG001
    """Return the name of a tool."""
    arms = [owner] if isinstance(owner, Arm) else list(world.arms.values())
    known = [tool for arm in arms for tool in fitting_tools(arm.description)]
    return str(rng.choice([*known, "none", "SPOON:1"]))


def table(rng: Rng, world: World, owner: Any, count: int) -> dict[str, Any]:  # noqa: ARG001
    """Return a table of an arm's joints."""
    name = any_arm(rng, world, owner, 0)
    width = len(world.arms[name].joints.names) if name in world.arms else 3
    return {name: [numbers(rng, width) for _ in range(3)]}


def chosen(*values: Any) -> Callable[..., Any]:
    """Return a maker of one of some values."""
    return lambda rng, *_: values[rng.integers(len(values))]


def joint_numbers(rng: Rng, world: World, owner: Any, count: int) -> Any:
    """Return a number per joint; of the whole arm for the world's `set_state`."""
    if owner is world:
        count = len(next(iter(world.arms.values())).joints.names)
    return numbers(rng, count)


def one(rng: Rng, *_: Any) -> float:
    """Return a number."""
    return number(rng)


#: Parameters that take numbers, for which anything else is a rejection, too; of names and of lists
#: of names, Python's own TypeError is one.
NUMERIC = {
    "q",
    "v",
    "dq",
    "effort",
    "angle",
    "T",
    "R",
    "wrench",
    "impedance",
    "timeout_s",
    "p",
    "i",
}
NUMERIC |= {"d", "ratio", "on", "anew", "every"}
#: {parameter, or verb.parameter: makes a value of (rng, world, owner, its number of joints)}.
MAKERS: dict[str, Callable[..., Any]] = {
    **dict.fromkeys(("q", "v", "dq", "effort"), joint_numbers),
    "squeeze.effort": one,
    "angle": one,
    "T": pose,
    "points": points,
    "set_plan.points": plan,
    "stiffness": one,
    "stitch": chosen(0, 1, -1, 2**70, 0.5, "", None),
    "R": lambda rng, *_: rotation(rng),
    "wrench": lambda rng, *_: numbers(rng, 6),
    "impedance": lambda rng, *_: impedance(rng),
    "frame": chosen("body", "spatial", "tip"),
    **dict.fromkeys(("on", "anew", "record"), chosen(True, False)),
    "timeout_s": one,
    **dict.fromkeys(("p", "i", "d"), one),
    "ratio": one,
    "of": chosen("both", "velocity", "acceleration", "jerk"),
    "mode": chosen("position", "effort", "set", "torque"),
    "joints": some_joints,
    "joint": any_joint,
    "frame_id": chosen("", "Cart", "x" * 300),
    "name": any_arm,
    "set_tool_type.name": any_tool,
    "tool": any_tool,
    "use_controller.name": chosen("", "nobody"),
    "settings": chosen({}, {"gain": float("nan")}),
    "state_command.name": chosen("enable", "disable", "home", "unhome", "pause", "resume", "fly"),
    "move_to.name": any_pose,
    "seed": chosen(0, 1, -1, 2**40),
    "load.state": lambda rng, world, *_: world.save() if rng.random() < 0.9 else rubbish(rng),
    "pose": chosen("start", "home", "nowhere"),
    **dict.fromkeys(("positions", "velocities", "efforts"), table),
    "every": chosen(1, 5, 0, -1),
}

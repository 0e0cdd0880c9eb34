"""Options that say which world a command simulates."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibrations, number
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.simulation import World

DEFAULT_TOOL = "LARGE_NEEDLE_DRIVER:400006"


def add_world(parser: ArgumentParser, rig: str | None = "full_cart") -> None:
    """Let the user choose a rig, its tools and how it is simulated; None: it is found out."""
    default = rig or "the fastest that has every arm that is named"
    parser.add_argument(
        "--rig",
        default=rig,
        help=f"a built-in rig (trocar list), or a TOML file; default: {default}",
    )
    parser.add_argument(
        "--tool",
        action="append",
        default=[],
        metavar="ARM=TOOL",
        help="mount another tool (trocar list tools, or a TOML file); may be repeated",
    )
    add_calibrations(parser)
    parser.add_argument("--control", choices=("dvrk", "paper"), default="dvrk", help="gains")
    parser.add_argument(
        "--friction", choices=("identified", "paper"), default="identified", help="joint model"
    )
    parser.add_argument(
        "--setup-joints",
        choices=("braked", "locked"),
        default="braked",
        help="simulated and held by brakes, or welded (faster)",
    )
    parser.add_argument(
        "--timestep", type=number, default=0.001, metavar="S", help="physics period"
    )


def add_record(parser: ArgumentParser) -> None:
    """Let the user record the run."""
    parser.add_argument(
        "--record", metavar="FILE", help="write states, commands and events to a new MCAP file"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="--record: replace a file that exists"
    )


def recording(world: World, args: Namespace) -> Callable[[], AbstractContextManager[object]]:
    """Return what opens the recording that the options ask for, and closes it again."""
    if args.record is None:
        return nullcontext
    from trocar.recording import record

    return partial(record, world, args.record, overwrite=args.overwrite)


def make_world(args: Namespace, tip_load_n: float = 0.0) -> World:
    """Build the world that the options say.

    Raises:
        InputError: an option that cannot be used
    """
    from trocar.simulation import World

    world = World(
        args.rig,
        timestep_s=args.timestep,
        control=args.control,
        friction=args.friction,
        setup_joints=args.setup_joints,
        tip_load_n=tip_load_n,
        calibration=args.calibration,
    )
    for arm, tool in _tools(args):
        world.exchange_tool(arm, tool)
    if args.tool:
        world.reset()
    return world


def _tools(args: Namespace) -> list[tuple[str, str]]:
    """Return (arm, tool) of every --tool."""
    pairs = [wanted.partition("=") for wanted in args.tool]
    for arm, given, tool in pairs:
        if not (arm and given and tool):
            raise InputError(
                f"--tool: got {arm + given + tool!r}; allowed: ARM=TOOL, as PSM1={DEFAULT_TOOL}"
            )
    return [(arm, tool) for arm, _, tool in pairs]

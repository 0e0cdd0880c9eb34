"""Teleoperate a rig by keyboard, gamepad, SpaceMouse, or the masters of a surgeon console.

Serves the web viewer and topics like `trocar sim`, and moves one instrument (--arm) relative to
the endoscope image. See docs/teleoperation.md.

keyboard (in the web viewer: first click on the frame in tab "Drive")
  A  D                       left, right
  W  S                       up, down
  R  F                       away, closer
  arrows                     turn up, down, left, right
  Q  E                       roll left, right
  C  O                       close, open the jaw
  X (held)                   fine: 0.2 of the speed
  Shift (held)               fast: 3 times the speed
  1  2 ...                   select the first, second ... instrument
  V (held)                   camera pedal: move the endoscope instead
  K (held)                   clutch: hold the tool
  G  B  M (held)             pedals coag, bicoag, mono
  Y  U (held)                pedals cam -, cam +

gamepad (on this machine, extra gamepad; or in the web viewer with --device keyboard)
  left stick                 left, right, up, down
  right, left trigger        away, closer
  right stick                turn left, right, up, down
  left, right shoulder       roll left, right
  A  B                       close, open the jaw
  X (held)                   fine: 0.2 of the speed
  Y (held)                   move the endoscope instead
  left, right on the D-pad   select the previous, next instrument

spacemouse (on this machine, extra spacemouse)
  push the cap               left, right, up, down, away, closer
  turn the cap               turn about the same axes
  left, right button         close, open the jaw

masters (rig with masters, e.g. full_cart_mtm; mtm: masters of a console elsewhere)
  rings and arrows           drag the simulated masters in the web viewer
  gripper sliders            pinch to start teleoperation; the jaw follows
  K  V  G  B  M  Y  U  P     press and release pedals, as labelled
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from contextlib import closing

from trocar.cli.arguments import allow_overwrite, options
from trocar.cli.serving import add_serving, serve
from trocar.cli.worlds import add_record, add_world, make_world
from trocar.errors import InputError

SUMMARY = "teleoperate by keyboard, gamepad, SpaceMouse or masters"
ORDER = 40

#: Default rigs, of devices and of masters. Source: our own choice.
RIG, RIG_OF_MASTERS = "pegs", "full_cart_mtm"
#: Start pose with the tools in view, if the rig defines it.
POSE = "work"


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, f"""
        --device keyboard|gamepad|spacemouse|masters  input device (default: masters if the rig has
                                            some, else keyboard)
        --arm ARM                           instrument to drive at the start (default: the first of
                                            the rig)
        --scale SCALE:number                scale of the device speed, or of the masters'
                                            translation, above 0 to 1
        --motion FILE                       device masters: replay the masters' motion from a
                                            recording
        --pose NAME                         initial pose of the rig (default: {POSE}, if the rig has
                                            it)
        --duration S:number                 stop after S seconds of simulated time
    """)  # fmt: skip
    add_world(parser, None, f"{RIG}, for masters {RIG_OF_MASTERS}")
    add_record(parser)
    parser.set_defaults(speed="realtime")
    add_serving(parser)


def run(args: Namespace) -> int:
    """Serve until Ctrl-C or for --duration."""
    from trocar.teleoperation.devices import table
    from trocar.teleoperation.session import Session

    kind = args.device or _device_of(args.rig)
    if kind == "keyboard" and (args.no_page or args.no_websocket):
        raise InputError(
            "--device keyboard: requires the web viewer and the WebSocket; leave out --no-page and"
            " --no-websocket, or use another --device"
        )
    if args.duration is not None and not 0.0 < args.duration < float("inf"):
        raise InputError(f"--duration: got {args.duration:g}; allowed: above 0 s")
    args.rig = args.rig or (RIG_OF_MASTERS if kind == "masters" else RIG)
    allow_overwrite(args, "record", "foxglove_record")
    with closing(Session(kind, args.arm, args.scale, args.motion)) as session:
        world = make_world(args)
        if args.pose is not None or POSE in world.rig.poses:
            world.reset(pose=args.pose or POSE)
        print(f"trocar: {args.rig}: starting ...", file=sys.stderr, flush=True)
        instruments = [arm.name for arm in world.rig.arms if arm.arm.type == "PSM"]
        for line in table(kind, instruments):
            print(f"  {line.touch:<26} {line.does}")
        serve(world, args, session)
    return 0


def _device_of(rig: str | None) -> str:
    from trocar.descriptions import load_rig

    if rig is None:
        return "keyboard"
    loaded = load_rig(rig)
    types = {arm.arm.type for arm in loaded.arms}
    only_masters = "MTM" in types and "PSM" not in types  # for a console elsewhere
    return "masters" if loaded.teleops or only_masters else "keyboard"

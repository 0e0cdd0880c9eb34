"""Drive a rig by hand: keyboard, gamepad, SpaceMouse, or the masters of a surgeon's console.

Serve the web viewer and topics as `trocar sim` does, and move the first instrument, or that of
--arm, in the directions of the endoscope's picture. More in docs/teleoperation.md.

keyboard (in the page: click on the frame in the tab "Drive" first)
  A  D                       left, right
  W  S                       up, down
  R  F                       away, nearer
  arrows                     turn up, down, left, right
  Q  E                       roll left, right
  C  O                       close, open the jaw
  X (held)                   fine: 0.2 of the speed
  Shift (held)               fast: 3 times the speed
  1  2 ...                   use the first, second ... instrument
  V (held)                   camera pedal: drag the endoscope's picture instead
  K (held)                   clutch: the tool stays
  G  B  M (held)             pedals coag, bicoag, mono
  Y  U (held)                pedals cam -, cam +

gamepad (of this machine, extra gamepad; or in the page with --device keyboard)
  left stick                 left, right, up, down
  right trigger, left trigger  away, nearer
  right stick                turn left, right, up, down
  left, right shoulder       roll left, right
  A  B                       close, open the jaw
  X (held)                   fine: 0.2 of the speed
  Y (held)                   drag the endoscope's picture instead
  left, right on the cross   use the instrument before, the next one

spacemouse (of this machine, extra spacemouse)
  push the cap               left, right, up, down, away, nearer
  turn the cap               turn about the same axes
  left, right button         close, open the jaw

masters (of a rig that has some, as full_cart_mtm)
  rings and arrows at the handles  carry the simulated masters (drag them in the page)
  gripper sliders            pinch to begin; the jaw follows
  K  V  G  B  M  Y  U  P     press and release pedals: the letters at their boxes
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from contextlib import closing

from trocar.cli.arguments import number
from trocar.cli.serving import add_serving, serve
from trocar.cli.worlds import add_record, add_world, make_world
from trocar.errors import InputError

#: Default rigs, of devices and of masters. Source: our own choice.
RIG, RIG_OF_MASTERS = "pegs", "full_cart_mtm"
#: Pose that has the tools in view, of rigs that have it.
POSE = "work"


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_world(parser, None)
    parser.set_defaults(rig=None)
    parser.add_argument(
        "--device",
        choices=("keyboard", "gamepad", "spacemouse", "masters"),
        help="input device; default: keyboard, or masters where the rig has some",
    )
    parser.add_argument("--arm", help="first instrument to drive; default: the rig's first")
    parser.add_argument(
        "--scale",
        type=number,
        help="factor of a device's speeds or of the masters' translation, above 0 to 1",
    )
    parser.add_argument(
        "--motion", metavar="FILE", help="move the masters as in a recording (with masters)"
    )
    parser.add_argument(
        "--pose", metavar="NAME", help=f"start pose of the arms; default: {POSE}, if the rig has it"
    )
    parser.add_argument(
        "--duration", type=number, metavar="S", help="stop after this much simulated time"
    )
    add_record(parser)
    parser.set_defaults(speed="realtime")
    add_serving(parser)


def run(args: Namespace) -> int:
    """Serve until Ctrl-C or for --duration."""
    from trocar.apps.teleoperation.devices import table
    from trocar.apps.teleoperation.session import Session

    kind = args.device or _device_of(args.rig)
    if kind == "keyboard" and (args.no_page or args.no_websocket):
        raise InputError(
            "--device keyboard: the page takes the keys and sends them over the WebSocket; "
            "leave out --no-page and --no-websocket, or drive by another --device"
        )
    if args.duration is not None and not 0.0 < args.duration < float("inf"):
        raise InputError(f"--duration: got {args.duration:g}; allowed: above 0 s")
    args.rig = args.rig or (RIG_OF_MASTERS if kind == "masters" else RIG)
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

    return "masters" if rig is not None and load_rig(rig).teleops else "keyboard"

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
from typing import TYPE_CHECKING

from trocar.cli.arguments import allow, allow_overwrite, options
from trocar.cli.serving import add_serving, serve
from trocar.cli.worlds import add_pose, add_record, add_world, make_world, take_pose
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.teleoperation.force_feedback import FeedbackSettings

SUMMARY = "teleoperate by keyboard, gamepad, SpaceMouse or masters"
ORDER = 40

#: Default rigs, of devices and of masters. Source: our own choice.
RIG, RIG_OF_MASTERS = "pegs", "full_cart_mtm"


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --device keyboard|gamepad|spacemouse|masters  input device (default: masters if the rig has
                                            some, else keyboard)
        --arm ARM                           instrument to drive at the start (default: the first of
                                            the rig)
        --scale SCALE:number                scale of the device speed, or of the masters'
                                            translation, above 0 to 1
        --motion FILE                       device masters: replay the masters' motion from a
                                            recording
        --duration S:number                 stop after S seconds of simulated time
    """)  # fmt: skip
    add_pose(parser)
    feedback = parser.add_argument_group("force feedback to the masters (docs/teleoperation.md)")
    options(feedback, """
        --feedback position-force|position-position  exert forces at the masters: of the
                                       instrument's contact, or towards where the instrument is
                                       (default: none)
        --feedback-scale SCALE:number  force at the hand over that at the instrument (default: 1)
        --delay S:number               delay between console and instrument, each way (default: 0)
        --feedback-source contact|efforts  force on the instrument: of its contacts in the
                                       simulation, or estimated from its motors' efforts (default:
                                       contact)
        --no-passivity                 do not limit the energy that the feedback gives to the hand
        --feedback-real                also at real masters
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
    with closing(Session(kind, args.arm, args.scale, args.motion, _feedback(args))) as session:
        world = make_world(args)
        take_pose(world, args.pose)
        print(f"trocar: {args.rig}: starting ...", file=sys.stderr, flush=True)
        instruments = [arm.name for arm in world.rig.arms if arm.arm.type == "PSM"]
        for line in table(kind, instruments):
            print(f"  {line.touch:<26} {line.does}")
        serve(world, args, session)
    return 0


def _feedback(args: Namespace) -> FeedbackSettings | None:
    """Return the settings of the force feedback, None without any."""
    from trocar.teleoperation.force_feedback import FeedbackSettings

    if args.feedback is None:
        names = ("feedback_scale", "delay", "feedback_source", "no_passivity", "feedback_real")
        allow(args, "with --feedback", *names)
        return None
    given = {"scale": args.feedback_scale, "delay": args.delay, "source": args.feedback_source}
    return FeedbackSettings(
        args.feedback,
        **{name: value for name, value in given.items() if value is not None},
        passive=not args.no_passivity,
        real_masters=args.feedback_real,
    )


def _device_of(rig: str | None) -> str:
    from trocar.descriptions import load_rig

    if rig is None:
        return "keyboard"
    loaded = load_rig(rig)
    types = {arm.arm.type for arm in loaded.arms}
    only_masters = "MTM" in types and "PSM" not in types  # for a console elsewhere
    return "masters" if loaded.teleops or only_masters else "keyboard"

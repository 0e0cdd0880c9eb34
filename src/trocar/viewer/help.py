"""Hints of the page's labels, and its sheet of help: keys, and where to read more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import viser

HINTS: Mapping[str, str] = {
    "Policy": "Take control stops the policy, so that the sliders act; Give back lets it go on from"
    " where the arms are. docs/scenes.md",
    "Episode": "Again resets to the same seed; Next seed places the objects anew. docs/scenes.md",
    "Loop": "Begin the episode of the next seed 2 s after the end of one.",
    "Time": "Pause: commands given meanwhile take effect at Resume. Reset returns the rig, or the"
    " episode, to its start. docs/viewer.md",
    "Look back": "The last minute [s]: shows a moment of before, and pauses. docs/viewer.md, Time",
    "Speed": "Simulated, or recorded, seconds over wall time. docs/viewer.md, Time",
    "Step": "While paused: a moment back or forth [s], or one physics step [ms]."
    " docs/viewer.md, Time",
    "Moment": "Continue from here begins a branch: the simulation goes on from the moment that is"
    " shown, without the policy. Now returns to the present. docs/viewer.md, Time",
    "Moment s": "The moment of the recording that is shown, from its beginning [s]."
    " docs/viewer.md, Recordings",
    "Recording": "Continue from here: the simulation goes on from the moment that is shown, as a"
    " branch. docs/viewer.md, Recordings",
    "Moment by moment": "Back or forth by 0.1 s, or by one physics step or row of the recording.",
    "Tip handles": "Drag or turn a handle: the tip follows at 100 mm/s at most, and stays where you"
    " let go. docs/viewer.md, Hands",
    "Object handle": "While paused: drag the object's handle; it lies where you let go."
    " docs/viewer.md, Hands",
    "Placement": "Bring back the tip or the object that was placed last. docs/viewer.md, Hands",
    "Contact forces": "Arrows at every contact, 10 mm a newton, with the largest in newtons [N]."
    " docs/viewer.md, See",
    "Tip paths": "The ways of the tips in the last 10 s. docs/viewer.md, See",
    "Workspace": "All that the tip of the chosen arm reaches in some orientation within the limits"
    " of its joints, and its volume [l]. docs/viewer.md, See",
    "Pick": "The next click in the scene marks a link: its name and the axes of its frame, x red,"
    " y green, z blue, 120 mm long. docs/viewer.md, Outline",
    "Plot": "A quantity of a joint over the last minute [deg, mm, their rates, N m, N].",
    "Last minute": "Save the chosen quantities, or all, as CSV in SI, 10 samples a second.",
    "All arms to": "Named poses of the rig, in joint space; setup joints stay. docs/simulation.md",
    "Arm": "The arm of the sliders, the table and the plot.",
    "State": "DISABLED, ENABLED, PAUSED or FAULT, as on the dVRK; an arm moves when it is ENABLED"
    " and homed. docs/as-on-the-robot.md",
    "Clients": "Programs that commanded this arm within the last 5 s. docs/topics.md",
    "Power": "Enable (also after a fault), Home, Disable. docs/as-on-the-robot.md",
    "Move to": "Named poses of the arm, and stay where it is. docs/arm.md",
    "Brakes": "Release or lock the brakes of the setup joints. docs/simulation.md",
    "Instrument": "Exchange the tool; 'none' is a bare arm. docs/simulation.md, Exchanging tools",
    "Mode": "Position: the servo follows the slider [deg, mm]. Effort: the slider is a torque or a"
    " force [N m, N]. Set: joints jump. docs/simulation.md, Control",
    "Applies to": "The joints whose mode changes.",
    "Gravity comp.": "Add the torque that holds the arm against gravity [N m, N]."
    " docs/simulation.md, Control",
    "slider": "Moves the joint with its velocity limits [{unit}]; {lower:g} to {upper:g}.",
    "effort": "Torque or force of the joint [{unit}].",
    "gains": "P [{gain}], I [{gain} per second], D [{gain} times second]."
    " docs/simulation.md, Control",
    "Remote centres": "Orange spheres: points that do not move as the arms turn. docs/mechanism.md",
    "Tool frames": "Axes at the tips, 50 mm long: x red, y green, z blue. docs/conventions.md",
    "Drawing": "How much this browser draws; automatic: what it manages, without shadows below 8"
    " frames a second. docs/viewer.md",
    "Camera": "A camera of the rig. docs/endoscope.md",
    "View": "One eye, both side by side, or an anaglyph for red (left) and cyan glasses."
    " docs/endoscope.md",
    "Content": "Colours; depth along the view [mm]; or ids: each object its colour. Overlays and"
    " the anaglyph are of colours. docs/viewer.md, Cameras",
    "Overlays": "What the scene draws into the image. docs/vision.md",
    "Last 10 s of": "Joint of the plots [deg or mm], over simulated time [s].",
    "Load": "Another rig or scene in place of this one, with pictures. docs/scenes.md",
    "Upload a file": "STL, OBJ, URDF, MJCF, or JSON of a dVRK's system; 50 MB at most. Meshes of a"
    " robot and arms of a system first. docs/viewer.md, Own files",
    "Unit": "Unit of a mesh's numbers; metres where the file has none. docs/import.md",
    "Contact": "Collide as convex pieces, or as one convex hull. docs/import.md",
    "Movable": "An object that instruments can move; else it stands fast.",
    "Thing": "Save: a ZIP with the rig's file for trocar sim --rig. Load: that rig in place of this"
    " one, from its start. docs/viewer.md, Own files",
    "Driver": "One browser drives, the others watch. Request control asks the driver; without an"
    " answer it is given after 10 s.",
}
"""Hints by label, with the unit and the page of the documentation."""

KEYS: Sequence[tuple[str, str]] = (
    ("drag", "turn the view"),
    ("drag with the right button", "move the view"),
    ("wheel", "zoom"),
    ("?", "this sheet"),
    ("letter behind a pedal", "press and release the pedal (tab Pedals)"),
    ("arrow keys on a slider", "one step: 0.1 deg or 0.1 mm"),
    ("Esc", "leave the full screen, close a sheet"),
)
"""Keys and the mouse."""

PAGES: Sequence[tuple[str, str]] = (
    ("docs/viewer.md", "this page"),
    ("docs/arm.md", "verbs of an arm"),
    ("docs/scenes.md", "scenes, scores"),
    ("docs/teleoperation.md", "drive by keys, gamepad, masters"),
    ("docs/topics.md", "programs that command arms"),
    ("docs/endoscope.md", "cameras"),
    ("docs/troubleshooting.md", "what to do when something fails"),
)
"""Pages of the documentation."""


def hint(label: str, **values: object) -> str:
    """Return the hint of a label, with values in its braces."""
    return HINTS[label].format(**values)


def show_help(gui: viser.GuiApi, drive_keys: Mapping[str, Sequence[tuple[str, str]]]) -> None:
    """Open the sheet in one browser.

    Args:
        gui: of the browser
        drive_keys: {device: (key, effect)} of the tab that drives
    """
    with gui.add_modal("Help") as sheet:
        tables = {"keys and mouse": KEYS, **drive_keys, "documentation": PAGES}
        gui.add_html("".join(_table(title, rows) for title, rows in tables.items()))
        close = gui.add_button("Close")

    @close.on_click
    async def _(_: object) -> None:
        sheet.close()


def _table(title: str, rows: Sequence[tuple[str, str]]) -> str:
    lines = "".join(f"<tr><td>{escape(a)}</td><td>{escape(b)}</td></tr>" for a, b in rows)
    return (
        f'<h4 style="margin:8px 0 2px">{escape(title)}</h4>'
        f'<table data-trocar="help" style="border-spacing:14px 1px">{lines}</table>'
    )

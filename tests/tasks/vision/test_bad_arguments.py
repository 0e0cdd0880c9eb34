"""Every argument of vision's public classes and functions: what it cannot be is an InputError."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.tasks.vision.drawn import NEEDLE, before_the_eyes, small_eyes
from trocar.descriptions import load_arm
from trocar.descriptions.needles import Needle
from trocar.errors import InputError
from trocar.rendering import StereoFrame
from trocar.tasks.vision import (
    Holder,
    NeedleTracker,
    ServoSettings,
    VisualServo,
    find_marker,
    find_tip,
    find_wound,
)
from trocar.tasks.vision.instruments import instrument_masks
from trocar.tasks.vision.overlay import (
    Area,
    Banner,
    Curve,
    Label,
    View,
    axes,
    distance,
    ghost,
    overlaid,
    stitch,
)
from trocar.tasks.vision.streams import video_pairs

pytest.importorskip("cv2", reason="needs the extra vision")

EYES = small_eyes()
GREY = np.full((EYES.left.height, EYES.left.width, 3), 90, np.uint8)
FRAME = StereoFrame(
    "endoscope", GREY, GREY, None, np.zeros((2, *GREY.shape[:2]), np.int32), None,
    {1: "PSM1/finger_right"}, 0.0, 0, EYES, np.stack([np.eye(4)] * 2),
)  # fmt: skip
VIEW, POINT, LINE = View(EYES.left, np.eye(4)), [0.0, 0.0, 0.1], [[0, 0, 0.1], [0.01, 0, 0.1]]
STILL = [0.3, -0.5, 0.1, 0.0]


def tracker() -> NeedleTracker:
    return NeedleTracker(EYES, NEEDLE)


def servo() -> VisualServo:
    return VisualServo(load_arm("ecm"), EYES, np.eye(4))


#: Calls that are right but for what they find, by name, and what is also allowed beside.
CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "Needle": (Needle, {"radius": 0.01, "arc": 3.0, "wire": 1e-3, "taper": 3e-3}),
    "Holder": (
        Holder,
        {"name": "PSM1", "T_left_holder": np.eye(4), "reach": 0.0085,
         "rods": ((POINT, POINT, 0.002),)},
    ),
    "Holder of a rod": (
        lambda **rod: Holder("PSM1", np.eye(4), 0.0085, (tuple(rod.values()),)),
        {"start": POINT, "end": POINT, "radius": 0.002},
    ),
    "NeedleTracker": (NeedleTracker, {"calibration": EYES, "needle": NEEDLE, "seed": 1}),
    "start": (
        lambda **given: tracker().start(**given),
        {"time": 0.0, "T_left_needle": before_the_eyes(), "covariance": np.eye(6)},
    ),
    "update": (
        lambda **given: tracker().update(**given),
        {"time": 0.0, "left": GREY, "right": GREY, "holder": Holder("world", np.eye(4))},
    ),
    "ServoSettings": (ServoSettings, {"depth": 0.1, "gain": 6.0, "lost_after": 0.5}),
    "VisualServo": (
        VisualServo,
        {"arm": load_arm("ecm"), "calibration": EYES, "T_tip_left": np.eye(4),
         "settings": ServoSettings()},
    ),
    "see": (
        lambda **given: servo().see(**given),
        {"time": 0.0, "q": STILL, "left": [210, 150], "right": [180, 150]},
    ),
    "velocity": (lambda **given: servo().velocity(**given), {"time": 0.0, "q": STILL}),
    "instrument_masks": (instrument_masks, {"frame": FRAME, "arm": "PSM1"}),
    "find_tip": (
        find_tip,
        {"calibration": EYES, "left": GREY, "right": GREY, "predicted": FRAME.eyes,
         "masks": [GREY[..., 0] > 0] * 2, "tip": POINT},
    ),
    "find_marker": (
        find_marker, {"calibration": EYES, "left": GREY, "right": GREY, "colour": (40, 180, 60)},
    ),
    "find_wound": (
        find_wound,
        {"calibration": EYES, "left": GREY, "right": GREY, "guess": LINE, "half_width": 0.006,
         "count": 24, "T_world_left": np.eye(4)},
    ),
    "video_pairs": (
        lambda **given: next(video_pairs(**given)), {"source": "nothing.mp4", "rate_hz": 30.0},
    ),
    "View": (View, {"lens": EYES.left, "T_world_eye": np.eye(4)}),
    "View.of": (View.of, {"frame": FRAME, "eye": 1}),
    "pixels": (VIEW.pixels, {"points": LINE}),
    "project": (FRAME.project, {"points": POINT, "eye": 0}),
    "Curve": (Curve, {"points": LINE, "colour": (1, 2, 3), "width": 2}),
    "Area": (Area, {"points": [*LINE, POINT], "colour": (1, 2, 3), "alpha": 0.3}),
    "Label": (Label, {"text": "tip", "point": POINT, "colour": (1, 2, 3)}),
    "Banner": (Banner, {"text": "lost", "colour": (1, 2, 3)}),
    "overlaid": (overlaid, {"image": GREY, "view": VIEW, "items": [Banner("lost")]}),
    "axes": (axes, {"T": np.eye(4), "length": 0.01}),
    "ghost": (ghost, {"needle": NEEDLE, "T_world_needle": np.eye(4), "colour": (1, 2, 3)}),
    "distance": (distance, {"a": POINT, "b": POINT, "colour": (1, 2, 3)}),
    "stitch": (
        stitch, {"entry": POINT, "exit_": [0.01, 0, 0.1], "down": [0, 0, 1], "radius": 0.01},
    ),
}  # fmt: skip
#: Bad values of anything, by name, and the arguments for which they are none.
BAD: Mapping[str, tuple[Any, set[str]]] = {
    "nothing": (None, {"reach", "settings", "T_world_left"}),
    "a text": ("12", {"name", "text", "arm", "source"}),
    "true": (True, set()),
    "not a number": (np.nan, set()),
    "below zero": (-1.0, {"time", "length"}),
    "a complex number": (1j, set()),
    "a large integer": (10**400, set()),
    "an object": (object(), set()),
    "unequal rows": ([[1.0], [2.0, 3.0]], set()),
    "an empty array": (np.zeros((0, 3)), {"items", "project: points"}),
    "NaN of the shape": (..., {"name", "text", "arm", "source", "rods"}),
    "a plane image": (GREY[..., 0], set()),
    "a small image": (GREY[::2, ::2], {"project: points"}),
}  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_what_an_argument_cannot_be_is_an_input_error(call: str) -> None:
    function, given = CALLS[call]
    for name, right in given.items():
        for what, (value, allowed) in BAD.items():
            if not {name, f"{call}: {name}"} & allowed:
                wrong = np.full(np.shape(right), np.nan) if value is ... else value
                try:
                    function(**{**given, name: wrong})
                except InputError:
                    continue
                pytest.fail(f"{call} takes {what} as {name}")


def test_the_calls_themselves_are_right() -> None:
    finds_nothing = {"find_tip", "find_marker", "find_wound", "video_pairs"}
    for name, (function, given) in CALLS.items():
        if name not in finds_nothing:
            function(**given)


def test_a_frame_says_what_it_is_of_in_a_line() -> None:
    assert repr(FRAME) == "<StereoFrame of endoscope at 0 s: 2 x 400x300, ids>"
    assert "1 x 400x300>" in repr(replace(FRAME, right=None, ids=None))

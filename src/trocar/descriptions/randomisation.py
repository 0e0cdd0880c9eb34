"""Spreads of what differs between a simulated and a real setup: presets and files."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from trocar.descriptions.keys import key
from trocar.descriptions.robot_errors import LONGEST_LATENCY_S, PERFECT, robot_errors
from trocar.descriptions.table import read_table
from trocar.errors import UnknownNameError

PRESETS = Path(__file__).parent / "data" / "randomisation.toml"
NONE = "none"
#: Source of the tips that a policy observes: encoders, or encoders corrected by images of the tips.
TipSource = Literal["robot", "camera"]


@dataclass(frozen=True)
class Randomisation:
    """Spreads of what differs between a simulated and a real setup.

    Spreads of ratios are half their range about 1; others are standard deviations along or about
    each axis.

    Attributes:
        errors: preset of the robots' errors; "": the scene's own
        gains: ratio of each joint's servo gains, as its motor's effort per ampere differs
        dry, viscous: ratio of each joint's friction
        object_mass, object_friction: ratio of each object's
        object_bias, object_bias_turn: error of an object's observed pose that lasts an episode
            [m], [rad]
        object_noise, object_noise_turn: of its error in each period of 20 ms [m], [rad]
        tip_bias, tip_noise: of a tip in the camera, as for objects; of `tips="camera"` [m]
        vision_age: age of observed objects, and of corrections of tips [s]
        camera, camera_turn: of the pose from which images are taken [m], [rad]
        exposure: of images [stops]
        colour_noise: of images, share of white
    """

    errors: str = field(default="", metadata=key())
    gains: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    dry: float = field(default=0.0, metadata=key(least=0.0))
    viscous: float = field(default=0.0, metadata=key(least=0.0))
    object_mass: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    object_friction: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    object_bias: float = field(default=0.0, metadata=key("length", least=0.0))
    object_bias_turn: float = field(
        default=0.0, metadata=key("angle", name="object_bias", least=0.0)
    )
    object_noise: float = field(default=0.0, metadata=key("length", least=0.0))
    object_noise_turn: float = field(
        default=0.0, metadata=key("angle", name="object_noise", least=0.0)
    )
    tip_bias: float = field(default=0.0, metadata=key("length", least=0.0))
    tip_noise: float = field(default=0.0, metadata=key("length", least=0.0))
    vision_age: float = field(
        default=0.0, metadata=key("time", least=0.0, most=LONGEST_LATENCY_S, shown="s")
    )
    camera: float = field(default=0.0, metadata=key("length", least=0.0))
    camera_turn: float = field(default=0.0, metadata=key("angle", name="camera", least=0.0))
    exposure: float = field(default=0.0, metadata=key(least=0.0, most=5.0))
    colour_noise: float = field(default=0.0, metadata=key(least=0.0, most=0.5))


def read_randomisation(name: str | Path) -> Randomisation:
    """Return a preset ("none", "lab" or "wide"), or the randomisation of a TOML file.

    A file has the keys of `Randomisation` with units, and optionally `preset`, the name of a
    preset that they replace values of.

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        DescriptionError: a broken file; file, key, got and allowed are named
    """
    if not str(name).endswith(".toml"):
        table = read_table(PRESETS).without("schema", "source")
        known = NONE, *table.entries()
        if name not in known:
            raise UnknownNameError("randomisation", str(name), (*known, "FILE.toml"))
        return Randomisation() if name == NONE else table.table(str(name)).record(Randomisation)
    table = read_table(Path(name)).without("schema", "source")
    base = Randomisation()
    if "preset" in table:
        try:
            base = read_randomisation(table.text("preset"))
        except UnknownNameError as problem:
            raise table.fail("preset", str(problem)) from problem
    found = table.record(
        Randomisation, defaults={f.name: getattr(base, f.name) for f in fields(base)}
    )
    table.done()
    try:
        robot_errors(found.errors or PERFECT)
    except UnknownNameError as problem:
        raise table.fail("errors", str(problem)) from problem
    return found

"""What the parts of one file share while it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Control, RigArm, RigDescription
from trocar.errors import InputError
from trocar.modeling.contacts import WORLD_BIT, ContactMask, contact_masks
from trocar.modeling.menagerie.classes import Classes
from trocar.modeling.menagerie.text import prefix
from trocar.modeling.menagerie.variants import Variant
from trocar.modeling.options import ModelOptions

#: What a lone arm is, and whom it touches: whatever has MuJoCo's default of 1, but not itself, nor
#: another arm from such a file. Source: our own choice.
LONE_MASK = ContactMask(2, WORLD_BIT)


@dataclass(frozen=True, eq=False)
class Sheet:
    """A file while it is written.

    Attributes:
        rig: what it shows
        variant: which of the files
        options: choices for the whole model
        meshes: {mesh: its name in the file}
        classes: the default classes so far
        masks: {arm: whom it touches}, of the props under ""
    """

    rig: RigDescription
    variant: Variant
    options: ModelOptions
    meshes: Mapping[Mesh, str]
    classes: Classes
    masks: Mapping[str, ContactMask]

    @staticmethod
    def of(rig: RigDescription, variant: Variant, meshes: Mapping[Mesh, str]) -> Sheet:
        """Return the sheet of a file that has nothing on it yet."""
        options = ModelOptions()
        lone = len(rig.arms) == 1 and not rig.props
        masks = {"": LONE_MASK, rig.arms[0].name: LONE_MASK} if lone else contact_masks(rig)
        classes = Classes(file_name(rig), variant, options.timestep)
        return Sheet(rig, variant, options, meshes, classes, masks)

    def name(self, arm: str, name: str) -> str:
        """Return what something of an arm is called in the file."""
        return f"{prefix(self.rig, arm)}{name}"

    def weightless(self, place: RigArm) -> bool:
        """Tell whether the bodies of an arm are spared their weight.

        So they are where the arm's own controller carries it, and the file's servos take positions
        alone. Setup joints are counterbalanced.
        """
        balanced = place.arm.type == "SUJ" or preset(place).gravity_compensation
        return balanced and self.variant.servo == "position"

    def braked(self, place: RigArm) -> bool:
        """Tell whether brakes hold an arm."""
        return place.arm.type == "SUJ" and self.variant.servo == "pid"


def preset(place: RigArm) -> Control:
    """Return the gains of an arm: the dVRK's, or the first that it has.

    Raises:
        InputError: it has none
    """
    presets = place.arm.control
    if not presets:
        raise InputError(f"{place.arm.name}: has no control gains; its joints have no servos")
    return presets.get("dvrk", next(iter(presets.values())))


def file_name(rig: RigDescription) -> str:
    """Return what the file and its outermost class are called: letters, digits, underscores."""
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in rig.name)

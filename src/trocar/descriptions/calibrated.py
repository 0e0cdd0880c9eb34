"""Application of overlays to the arms of a rig."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, reduce
from pathlib import Path

import numpy as np

from trocar.cameras import CameraDescription
from trocar.descriptions.overlay import Overlay, apply_overlay, overlay_text, read_overlay
from trocar.descriptions.overlay_records import CameraPatch, FramePatch
from trocar.descriptions.records import ArmDescription, RigArm, RigDescription
from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError, UnknownNameError
from trocar.geometry import inverse, matrix_from_rpy, transform
from trocar.inputs import is_file
from trocar.kinematics.forward import pose

#: An overlay, or the path of its file.
One = Overlay | str | Path
#: Of a rig: one for every arm of its kind; {arm of the rig: its own}; or several, of which a text
#: "ARM=FILE" is for one arm.
Calibration = One | Mapping[str, One] | Sequence[One]

#: Built-in dynamics overlays, and what their names look like.
DYNAMICS = Path(__file__).parent / "data" / "dynamics"
NAME = re.compile(r"[a-z0-9_]+")
#: Name that selects the dynamics of the descriptions, masses of CAD models, in place of an overlay.
CAD = "cad"
#: The name of an arm ahead of a "=", and what follows it.
NAMED = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=(.+)")


def as_overlay(calibration: One) -> Overlay:
    """Return an overlay, read from its file where it is a path.

    The text of a built-in dynamics overlay is its name ("psm").

    Raises:
        DescriptionError: the file is broken
    """
    if isinstance(calibration, Overlay):
        return calibration
    built_in = DYNAMICS / f"{calibration}.toml"
    if isinstance(calibration, str) and NAME.fullmatch(calibration) and is_file(built_in):
        return read_overlay(built_in)
    return read_overlay(calibration)


def combined(one: Overlay, other: Overlay) -> Overlay:
    """Return the geometry, the dynamics and the camera with bases of two overlays.

    Raises:
        InputError: they are for different arms, or both have geometry, dynamics, or a camera
    """
    if one.arm != other.arm:
        raise InputError(
            f"calibration: got overlays for {one.arm!r} and {other.arm!r}; allowed: the same arm"
        )
    if any(all(both) for both in zip(_parts(one), _parts(other), strict=True)):
        raise InputError(
            f"calibration: got two for {one.arm!r}; allowed: one, or one with geometry, one with"
            " dynamics and one with a camera"
        )
    geometry, second = (one, other) if _parts(one)[0] or not _parts(other)[0] else (other, one)
    return replace(
        geometry,
        dynamics=geometry.dynamics or second.dynamics,
        camera=geometry.camera or second.camera,
        bases=geometry.bases or second.bases,
    )


def _parts(overlay: Overlay) -> tuple[bool, bool, bool]:
    """Return whether an overlay has geometry, dynamics, and a camera or bases."""
    return (
        bool(overlay.frames or overlay.closures),
        overlay.dynamics is not None,
        overlay.camera is not None or bool(overlay.bases),
    )


def selects_cad(calibration: Calibration | None) -> bool:
    """Return whether "cad" is among the overlays: the descriptions' dynamics."""
    alone = isinstance(calibration, Overlay | str | Path)
    return CAD in ((calibration,) if alone else calibration or ())


def calibrated(arm: ArmDescription, calibration: One | Sequence[One] | None) -> ArmDescription:
    """Return an arm with a calibration, its dynamics or both laid over it; itself without one.

    Raises:
        InputError, DescriptionError: the overlay is broken, or for another arm
    """
    if calibration is None:
        return arm
    several = [calibration] if isinstance(calibration, Overlay | str | Path) else calibration
    overlays = [as_overlay(one) for one in several if one != CAD]
    return apply_overlay(arm, reduce(combined, overlays)) if overlays else arm


def calibrated_rig(
    rig: RigDescription, calibration: Calibration | None, *, identified: bool = False
) -> RigDescription:
    """Return a rig whose arms carry their calibrations.

    Roots stay where they are, but those of arms whose bases an overlay has. A camera of an overlay
    takes the place of its arm's endoscope.

    Args:
        rig: the nominal rig
        calibration: overlays; None: none
        identified: whether arms without dynamics of their own get the built-in identified ones,
            where there are any for their kind and the rig's `dynamics` are "identified"

    Raises:
        UnknownNameError: an arm that the rig does not have
        InputError: no arm of the rig is of an overlay's kind, or two are for the same arm
        DescriptionError: an overlay is broken
    """
    if selects_cad(calibration):
        rig = replace(rig, dynamics="cad")
    identified = identified and rig.dynamics == "identified"
    named, general = _sorted([] if calibration is None else calibration)
    known = [arm.name for arm in rig.arms]
    for name in named:
        if name not in known:
            raise UnknownNameError("arm", name, known, f"rig {rig.name}")
    kinds = {arm.arm.name for arm in rig.arms}
    for kind, overlay in general.items():
        if kind not in kinds:
            raise InputError(
                f"{overlay.file or 'overlay'}: is a calibration of {kind!r}; the arms of rig"
                f" {rig.name} are of {', '.join(sorted(kinds))}"
            )
    done: dict[tuple[ArmDescription, int], ArmDescription] = {}

    def one(arm: RigArm) -> RigArm:
        own, common = named.get(arm.name), general.get(arm.arm.name)
        overlay = own or common
        if own and common and not any(map(all, zip(_parts(own), _parts(common), strict=True))):
            overlay = combined(own, common)
        built_in = DYNAMICS / f"{arm.arm.name}.toml"
        if identified and (overlay or arm.arm.overlay) is None and built_in.is_file():
            overlay = _built_in(built_in)
        elif identified and overlay is not None and not overlay.dynamics and built_in.is_file():
            overlay = combined(overlay, _built_in(built_in))
        if overlay is None or _carries(arm.arm, overlay):
            return arm
        key = (arm.arm, id(overlay))
        if key not in done:
            done[key] = apply_overlay(arm.arm, overlay)
        return replace(arm, arm=done[key])

    rig = replace(rig, arms=tuple(one(arm) for arm in rig.arms))
    for arm in rig.arms:
        if arm.arm.overlay is not None and arm.arm.overlay.camera is not None:
            rig = _with_camera(rig, arm, arm.arm.overlay.camera)
    for arm in rig.arms:
        if arm.arm.overlay is not None:
            for name, patch in arm.arm.overlay.bases.items():
                rig = _with_base(rig, arm.name, name, patch)
    return rig


@cache
def _built_in(path: Path) -> Overlay:
    """Return a built-in overlay, read once: reading one takes as long as compiling a PSM."""
    return read_overlay(path)


def _with_camera(rig: RigDescription, arm: RigArm, patch: CameraPatch) -> RigDescription:
    """Return a rig whose endoscopes on an arm are as calibrated."""
    mechanism = arm.arm.mechanism

    def one(camera: CameraDescription) -> CameraDescription:
        if camera.kind != "endoscope" or camera.arm != arm.name:
            return camera
        zero = np.zeros(len(mechanism.joints))
        tip = pose(mechanism, zero, mechanism.tip, camera.frame)
        place = transform(matrix_from_rpy(*patch.place.rpy), patch.place.xyz)
        return replace(camera, pose=tip @ place, angle=0.0, calibration=patch.calibration)

    return replace(rig, cameras=tuple(one(camera) for camera in rig.cameras))


def _with_base(rig: RigDescription, arm: str, name: str, patch: FramePatch) -> RigDescription:
    """Return a rig in which an arm's reference frame stands in another's, in the pose "start"."""
    moved = rig.arm(name)
    start = rig.poses["start"]
    places = Places(rig, lambda one: start[one])
    wanted = places.reference_pose(arm) @ transform(matrix_from_rpy(*patch.rpy), patch.xyz)
    turn = wanted @ inverse(places.reference_pose(name))
    mount = places.root_pose(name) @ inverse(moved.pose)
    placed = inverse(mount) @ turn @ places.root_pose(name)
    arms = tuple(replace(a, pose=placed) if a.name == name else a for a in rig.arms)
    return replace(rig, arms=arms)


def rig_overlays(rig: RigDescription) -> dict[str, Overlay]:
    """Return the calibrations that a rig's arms carry, {arm: overlay}."""
    return {arm.name: arm.arm.overlay for arm in rig.arms if arm.arm.overlay is not None}


def _carries(arm: ArmDescription, overlay: Overlay) -> bool:
    """Return whether an arm carries this very calibration already."""
    return arm.overlay is not None and overlay_text(arm.overlay) == overlay_text(overlay)


def _sorted(calibration: Calibration) -> tuple[dict[str, Overlay], dict[str, Overlay]]:
    """Return the overlays of single arms by the arm's name, and the others by their kind."""
    if isinstance(calibration, Mapping):
        return {name: as_overlay(one) for name, one in calibration.items()}, {}
    alone = isinstance(calibration, Overlay | str | Path)
    several = [one for one in ([calibration] if alone else calibration) if one != CAD]
    named: dict[str, Overlay] = {}
    general: dict[str, Overlay] = {}
    for one in several:
        match = NAMED.fullmatch(one) if isinstance(one, str) else None
        overlay = as_overlay(match[2] if match else one)
        place, key = (named, match[1]) if match else (general, overlay.arm)
        place[key] = combined(place[key], overlay) if key in place else overlay
    return named, general

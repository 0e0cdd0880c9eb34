"""A calibrated linkage as an overlay of its description, with standard deviations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.geometry import slots
from trocar.apps.calibration.placement import Centre, calibrated
from trocar.apps.calibration.refine import Refined
from trocar.apps.calibration.start import Robot
from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay import ClosurePatch, FramePatch, closure_patch, frame_patch
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

# Source: our own choice; the placement is smooth on this scale. [m, rad]
STEP = 1e-6


def patches(
    arm: ArmDescription, refined: Refined, centre: Centre | None
) -> tuple[dict[str, FramePatch], dict[str, ClosurePatch]]:
    """Return what the calibrated linkage replaces in its description.

    Returns:
        {frame: patch} and {closure: patch}
    """
    linkage = refined.robot.linkage
    frames = [hinge.name for hinge in linkage.hinges if not hinge.closure]
    frames += [centre.slide] if centre is not None else []
    mechanism = calibrated(arm, refined.robot, centre)
    sigma = _sigmas(arm, refined, centre, frames)
    tilted = _tilted(refined, centre)
    found: dict[str, FramePatch] = {}
    for i, name in enumerate(frames):
        patch = frame_patch(mechanism.frame(name))
        tilt = sigma[3 * len(frames) + 6 * len(mechanism.closures) :].reshape(-1, 3)
        turned = tilt[tilted.index(name)] if name in tilted else None
        found[name] = replace(patch, xyz_sigma=sigma[3 * i : 3 * i + 3], rpy_sigma=turned)
    closures: dict[str, ClosurePatch] = {}
    for i, closure in enumerate(mechanism.closures):
        at = 3 * len(frames) + 6 * i
        closures[closure.name] = replace(
            closure_patch(closure, slides=bool(refined.tilted)),
            point_a_sigma=sigma[at : at + 3],
            point_b_sigma=sigma[at + 3 : at + 6],
        )
    return found, closures


def _sigmas(
    arm: ArmDescription, refined: Refined, centre: Centre | None, frames: list[str]
) -> Array:
    """Return the standard deviations of all places, frames first, then of the tilts."""
    size = len(refined.covariance)
    slope = np.stack(
        [
            (
                _places(calibrated(arm, _moved(refined, step), centre), frames, refined, centre)
                - _places(calibrated(arm, _moved(refined, -step), centre), frames, refined, centre)
            )
            / (2.0 * STEP)
            for step in STEP * np.eye(size)
        ],
        axis=1,
    )
    variance = np.einsum("ij,jk,ik->i", slope, refined.covariance, slope)
    if centre is not None and centre.axis is not None:
        variance += _of_axis(arm, refined, centre, frames)
    return np.sqrt(np.maximum(variance, 0.0))


def _of_axis(arm: ArmDescription, refined: Refined, centre: Centre, frames: list[str]) -> Array:
    """Return the variances that the place of the ground's own axis brings, in the same order."""
    axis = centre.axis
    assert axis is not None  # noqa: S101  the caller looked

    def places(step: Array) -> Array:
        moved = replace(axis, point=axis.point + step[:3], direction=axis.direction + step[3:])
        there = calibrated(arm, refined.robot, replace(centre, axis=moved))
        return _places(there, frames, refined, centre)

    slope = np.stack([(places(s) - places(-s)) / (2.0 * STEP) for s in STEP * np.eye(6)], axis=1)
    return np.asarray(np.einsum("ij,jk,ik->i", slope, axis.covariance, slope), dtype=np.float64)


def _tilted(refined: Refined, centre: Centre | None) -> tuple[str, ...]:
    """Return the frames whose hinges may tilt, by themselves or with the whole linkage."""
    if centre is None or centre.axis is None:
        return refined.tilted
    linkage = refined.robot.linkage
    ground = (h.name for h in linkage.hinges if not h.closure and h.body_a == linkage.ground)
    return tuple(dict.fromkeys((*refined.tilted, *ground)))


def _places(
    mechanism: Mechanism, frames: list[str], refined: Refined, centre: Centre | None
) -> Array:
    parts: list[Any] = [mechanism.frame(name).before[:3, 3] for name in frames]
    for closure in mechanism.closures:
        parts += [closure.point_a, closure.point_b]
    # A small turn of a frame about its own x and y shows in its z axis as the parent has it.
    for name in _tilted(refined, centre):
        start = refined.robot.linkage.mechanism.frame(name).before[:3, :3]
        z = start.T @ mechanism.frame(name).before[:3, 2]
        parts.append(np.array([-z[1], z[0], 0.0]))
    return np.concatenate(parts)


def _moved(refined: Refined, step: Array) -> Robot:
    robot, free = refined.robot, refined.basis.shape[1]
    moved = robot.moved + (refined.basis @ step[:free]).reshape(len(slots(robot.linkage)), 2)
    tilts = {
        name: robot.tilts[name] + step[free + 2 * i : free + 2 * i + 2]
        for i, name in enumerate(refined.tilted)
    }
    return replace(robot, moved=moved, tilts=tilts)

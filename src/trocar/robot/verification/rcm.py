"""Table 7 and Figure 9: where the remote centre is, how far it wanders, and beside its hardware."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import TOWARDS, axes_frame
from trocar.descriptions.calibration_plan import link_of
from trocar.descriptions.paper import TABLE7, TABLE7_ERROR_M
from trocar.fitting import PivotFit, fit_hinge, fit_pivot
from trocar.geometry.se3 import inverse
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.verification.figures import Figure, ReportPart
from trocar.robot.verification.subject import MARKERS, Drive, Ranges, Subject, SweepResult, sweep

Array = NDArray[np.float64]

#: Largest RMS without servo error [m]. Source: the project's own goal.
MOST_RMS_M = 1e-5
#: Noise of the poses' rotations: a simulation measures nothing, so the estimate is plain least
#: squares, the paper's equation 4. Source: our own choice, below any mechanism's play. [rad]
ROUNDING_RAD = 1e-9
#: Largest distance of the remote centre of an arm with general loops from its hardware's, and
#: spread. Source: the project's own goal; the paper's simulation misses its hardware by 3.46 and
#: 3.91 mm. [m]
MOST_MISSED_M = 1e-3
#: Smallest RMS displacement that stands out from noise, as a ratio of the noise's RMS, which is
#: estimated to 4 %. Source: measured, tracks of 1000 to 6000 samples.
NOISE_SHARE = 0.3
TOLD: dict[Drive, str] = {"set": "no servo error", "servo": "with servos"}


@dataclass(frozen=True, eq=False)
class Cloud:
    """Remote centre of one run, in the axes of Table 7.

    Attributes:
        kind: type of the arm
        drive: how the arm was moved
        centre: the estimate, relative to the pitch axis, (3,) [m]
        points: where it was at each pose, (k, 3) [m]
        rms: root mean squared distance of the points from the centre, per axis, (3,) [m]
        rms_distance: the same, not per axis [m]
        yaw, pitch: actual joint positions, (k,) [rad]
        servo_error: RMS of actual minus commanded, of yaw and pitch, (2,) [rad]
    """

    kind: str
    drive: Drive
    centre: Array
    points: Array
    rms: Array
    rms_distance: float
    yaw: Array
    pitch: Array
    servo_error: Array


def has_remote_centre(mechanism: Mechanism) -> bool:
    """Test for the chain of PSM and ECM: yaw, pitch, and an insertion past both."""
    frames = {"rcm", "insertion"} <= mechanism.frame_index.keys()
    return frames and {"yaw", "pitch"} <= mechanism.joint_index.keys()


def rcm(
    subject: Subject, sweeps: tuple[SweepResult, ...], beside: Sequence[Figure] = ()
) -> ReportPart:
    """Estimate the remote centre from the motion of the link that carries the insertion.

    Args:
        subject: the arm
        sweeps: of yaw and pitch over their ranges
        beside: what a calibrated arm has beside its hardware (`hardware.beside_hardware`)
    """
    title, command = "Remote centre: Table 7 and Figure 9 of the paper", subject.command("rcm")
    if not sweeps:
        note = (f"{subject.arm.name}: no remote centre, or no simulation model",)
        return ReportPart("rcm", subject.name, title, (), command, note)
    clouds = tuple(cloud(subject, sweep) for sweep in sweeps)
    figures = [figure for each in clouds for figure in _figures(subject, each)]
    figures += beside
    notes = [
        "Position relative to the pitch axis, in the frame of the first two joint axes at home. Of"
        " a PSM y is along the yaw axis, of an ECM x; z is along the pitch axis. Estimated by pivot"
        " calibration (the paper's equations 3 to 5) from the poses of the link that carries the"
        " insertion.",
        "The paper's equation 5 lacks the 1/n that its Table 7 needs; it is in ours.",
    ]
    notes.append(f"Swept: {swept_ranges(subject, sweeps[0])}, 95 % of the joint range.")
    if subject.calibrated:
        notes.append("A calibrated arm: Table 7 is of another robot and not compared.")
    if is_general(subject):
        notes.append("General four-bar loops have no fixed remote centre: its motion is stated.")
    return ReportPart("rcm", subject.name, title, tuple(figures), command, tuple(notes), clouds)


def cloud(subject: Subject, motion: SweepResult) -> Cloud:
    """Fit the pivot of one sweep."""
    mechanism = subject.arm.mechanism
    at = motion.link_poses(mechanism)
    link = at[link_of(mechanism, mechanism.frame("insertion").parent or "")]
    pivot: PivotFit = fit_pivot(link[:, :3, :3], link[:, :3, 3], rotation_sigma=ROUNDING_RAD)
    frame = _table7_frame(subject, motion, at, pivot.post)
    points = _moved(frame, pivot.points)
    centre = _moved(frame, pivot.post)
    off = points - centre
    joints = [mechanism.joint_index[name] for name in ("yaw", "pitch")]
    missed = (motion.actual - motion.commanded)[:, joints]
    return Cloud(
        subject.arm.type,
        motion.drive,
        centre,
        points,
        np.sqrt(np.mean(off**2, axis=0)),
        float(np.sqrt(np.mean(cast("Array", np.sum(off**2, axis=1))))),
        motion.actual[:, joints[0]],
        motion.actual[:, joints[1]],
        np.sqrt(np.mean(missed**2, axis=0)),
    )


def _table7_frame(
    subject: Subject, motion: SweepResult, at: dict[str, Array], centre: Array
) -> Array:
    """Return the root in Table 7's frame, T_table7_root (4, 4), as motion shows the two axes.

    Its origin is the point of the pitch axis nearest to the yaw axis; both axes are found from the
    motion of the links that they join, and told where they are at the first sample, at home.
    """
    mechanism = subject.arm.mechanism
    root = mechanism.frames[0].name
    yaw_link, pitch_link = (_driven(mechanism, name) for name in ("yaw", "pitch"))
    yaw = fit_hinge(inverse(at[root]) @ at[yaw_link] @ MARKERS)
    pitch = fit_hinge(inverse(at[yaw_link]) @ at[pitch_link] @ MARKERS)
    home = at[yaw_link][0]
    side = home[:3, :3] @ _rising(pitch.direction_a, pitch.angles, motion, mechanism)
    x = np.concatenate([centre, _moved(home, pitch.point_a), side, yaw.point_a, yaw.direction_a])
    return inverse(axes_frame(x, 1.0, np.array(TOWARDS.get(subject.arm.type, TOWARDS["PSM"]))))


def _driven(mechanism: Mechanism, joint: str) -> str:
    """Return the link that a joint's motor turns."""
    return mechanism.joints[mechanism.joint_index[joint]].drive[0][0]


def _rising(direction: Array, angles: Array, motion: SweepResult, mechanism: Mechanism) -> Array:
    """Return the direction about which the pitch turns as it grows, right-handed."""
    pitch = motion.actual[:, mechanism.joint_index["pitch"]]
    used = np.isfinite(angles)
    return direction * np.sign(np.cov(angles[used], pitch[used])[0, 1])


def _moved(T: Array, points: Array) -> Array:
    return points @ T[:3, :3].T + T[:3, 3]


def is_general(subject: Subject) -> bool:
    """Test whether a calibrated arm's loops are four-bars with any sides."""
    return subject.arm.overlay is not None and subject.arm.overlay.closure == "general"


def _figures(subject: Subject, found: Cloud) -> list[Figure]:
    kind = subject.arm.type
    rows = (None, None) if subject.calibrated else TABLE7.get(kind, (None, None))
    hardware = rows[0]
    told = TOLD[found.drive]
    table = "closed-loop paper, Table 7; " if hardware else ""
    source = f"{table}ours: pivot calibration on the simulated motion"
    figures: list[Figure] = []
    for index, axis in enumerate("XYZ"):
        paper, theirs = (None if row is None else row.position[index] for row in rows)
        figures.append(
            Figure(f"{told}: position {axis}", float(found.centre[index]), "m", shown="mm",
                   paper=paper, paper_simulation=theirs, source=source)
        )  # fmt: skip
    for index, axis in enumerate("XYZ"):
        paper, theirs = (None if row is None else row.rms[index] for row in rows)
        figures.append(
            Figure(f"{told}: RMS {axis}", float(found.rms[index]), "m", shown="mm",
                   paper=paper, paper_simulation=theirs, source=source)
        )  # fmt: skip
    bounded = found.drive == "set" and not is_general(subject)
    figures.append(
        Figure(f"{told}: RMS distance", found.rms_distance, "m", shown="mm",
               upper=MOST_RMS_M if bounded else None,
               source=f"{source}; limit: the project's own goal" if bounded else source)
    )  # fmt: skip
    if hardware is not None:
        away = float(np.linalg.norm(found.centre - np.array(hardware.position)))
        error = TABLE7_ERROR_M[kind]
        figures.append(
            Figure(f"{told}: distance from the hardware's", away, "m", shown="mm",
                   paper_simulation=error, upper=error,
                   source="closed-loop paper, 4.2; limit: no farther than its own simulation")
        )  # fmt: skip
    for name, error in zip(("yaw", "pitch"), found.servo_error, strict=True):
        figures.append(
            Figure(f"{told}: servo error of {name}, RMS", float(error), "rad", shown="mrad",
                   source="ours: actual minus commanded while the remote centre is estimated")
        )  # fmt: skip
    return figures


def swept_ranges(subject: Subject, motion: SweepResult) -> str:
    """Describe the commanded ranges of yaw and pitch."""
    index = subject.arm.mechanism.joint_index
    told = {name: motion.commanded[:, index[name]] for name in ("yaw", "pitch")}
    return ", ".join(f"{name} {q.min():.2f} to {q.max():.2f} rad" for name, q in told.items())


def beside_hardware(subject: Subject, ranges: Ranges) -> list[Figure]:
    """Compare the remote centre of a calibrated arm with its hardware and its description.

    Args:
        subject: a calibrated arm
        ranges: over which its hardware was swept; empty: not known

    Returns:
        the spread as it was measured, and over the same ranges place and spread in the axes of
        Table 7 where the hardware's are known, and the spread as a distance; of an arm with general
        loops, bounds on what is missed
    """
    overlay = subject.arm.overlay
    found: dict[str, Any] = {} if overlay is None else overlay.measured.get("rcm", {})
    if overlay is None or not found:
        return []
    file = overlay.source.get("file", overlay.file)
    figures: list[Figure] = []
    if isinstance(rms := found.get("rms_m"), float):
        source = f"measured, noise included: {file}"
        figures.append(Figure("measured: RMS distance", rms, "m", shown="mm", source=source))
    if not ranges or subject.nominal is None:
        return figures
    motion = sweep(subject, "set", ranges)
    drawn = replace(subject, arm=subject.nominal)
    ours, nominal = cloud(subject, motion), cloud(drawn, sweep(drawn, "set", ranges))
    source = (
        f"hardware: {file}; nominal and calibrated: without servo error, over its range"
        f" ({swept_ranges(subject, motion)})"
    )
    wander, noise = found.get("wander_rms_m"), found.get("noise_rms_m")
    told = source
    if isinstance(noise, float):
        told += (
            "; of the hardware's, noise is taken off as squares, and less than"
            f" {1e3 * NOISE_SHARE * noise:.2g} mm may be noise still"
        )
    figures.append(
        Figure("as measured: RMS distance", ours.rms_distance, "m", shown="mm",
               hardware=wander if isinstance(wander, float) else None,
               nominal=nominal.rms_distance, source=told)
    )  # fmt: skip
    table: dict[str, Any] = found.get("table7", {})
    if {"position_m", "rms_xyz_m"} <= table.keys():
        place = np.array(table["position_m"], dtype=np.float64)
        square = np.array(table["rms_xyz_m"], dtype=np.float64) ** 2
        spread = np.sqrt(np.maximum(square - (noise or 0.0) ** 2 / 3.0, 0.0))
        figures += _by_axis(place, spread, nominal, ours, (source, told))
        figures += _missed(subject, place, spread, nominal, ours)
    return figures


def _by_axis(
    place: Array, spread: Array, nominal: Cloud, ours: Cloud, sources: tuple[str, str]
) -> list[Figure]:
    """State place and spread along each axis."""
    rows = (
        ("position", place, nominal.centre, ours.centre, sources[0]),
        ("RMS", spread, nominal.rms, ours.rms, sources[1]),
    )
    return [
        Figure(f"as measured: {what} {axis}", float(of_ours[index]), "m", shown="mm",
               hardware=float(hardware[index]), nominal=float(of_nominal[index]), source=source)
        for what, hardware, of_nominal, of_ours, source in rows
        for index, axis in enumerate("XYZ")
    ]  # fmt: skip


def _missed(
    subject: Subject, place: Array, spread: Array, nominal: Cloud, ours: Cloud
) -> list[Figure]:
    """State by how much the hardware is missed, with a bound where the loops are general."""
    most = MOST_MISSED_M if is_general(subject) else None
    limit = "; limit: the project's own goal" if most else ""
    rows = (
        ("distance from the hardware's", place, nominal.centre, ours.centre, "of the centres"),
        ("spread missed", spread, nominal.rms, ours.rms,
         "root of the sum of squares of the differences along the three axes"),
    )  # fmt: skip
    return [
        Figure(
            f"as measured: {what}",
            float(np.linalg.norm(of_ours - hardware)),
            "m",
            shown="mm",
            upper=most,
            nominal=float(np.linalg.norm(of_nominal - hardware)),
            source=f"ours: {how}{limit}",
        )
        for what, hardware, of_nominal, of_ours, how in rows
    ]

"""Table 7 and Figure 9: where the remote centre is, and how far it wanders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.figures import Figure, Part
from trocar.apps.verification.subject import MARKERS, Drive, Subject, Sweep
from trocar.descriptions.calibration_plan import link_of
from trocar.fitting import PivotFit, fit_hinge, fit_pivot
from trocar.geometry.se3 import inverse
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class PaperRcm:
    """A row of Table 7: where the remote centre is, and the RMS of where it was seen [m]."""

    position: Vector
    rms: Vector


#: {type of arm: (hardware, the paper's simulation)}. The positions are printed in mm, and so are
#: the RMS errors, whatever the garbled head of the table says. Source: closed-loop paper, Table 7.
TABLE7: dict[str, tuple[PaperRcm, PaperRcm]] = {
    "PSM": (
        PaperRcm((-1.49e-3, -516.11e-3, 2.19e-3), (0.62e-3, 0.62e-3, 0.31e-3)),
        PaperRcm((0.56e-3, -518.60e-3, 0.93e-3), (0.85e-3, 1.91e-3, 1.08e-3)),
    ),
    "ECM": (
        PaperRcm((341.11e-3, -0.08e-3, -3.39e-3), (3.72e-3, 2.45e-3, 1.33e-3)),
        PaperRcm((338.44e-3, -0.05e-3, -0.54e-3), (2.17e-3, 1.14e-3, 0.85e-3)),
    ),
}
#: How far the paper's simulation is from its hardware [m]. Source: closed-loop paper, 4.2.
TABLE7_ERROR_M = {"PSM": 3.46e-3, "ECM": 3.91e-3}

#: Most RMS without servo error. Source: the project's own goal. [m]
MOST_RMS_M = 1e-5
#: Noise of the poses' rotations: a simulation measures nothing, so the estimate is plain least
#: squares, the paper's equation 4. Source: our own choice, below any mechanism's play. [rad]
ROUNDING_RAD = 1e-9
#: Noise is told to 4 % of its RMS, whose square is 0.3 of that. Source: our own measurement, tracks
#: of 1000 to 6000 samples.
NOISE_SHARE = 0.3
TOLD: dict[Drive, str] = {"set": "no servo error", "servo": "with servos"}


@dataclass(frozen=True, eq=False)
class Cloud:
    """Where one run saw the remote centre, in the axes of Table 7.

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
    """Tell whether an arm is built as PSM and ECM are: yaw, pitch, and an insertion past both."""
    frames = {"rcm", "insertion"} <= mechanism.frame_index.keys()
    return frames and {"yaw", "pitch"} <= mechanism.joint_index.keys()


def rcm(subject: Subject, sweeps: tuple[Sweep, ...], as_measured: Sweep | None = None) -> Part:
    """Estimate the remote centre from the motion of the link that carries the insertion.

    Args:
        subject: the arm
        sweeps: of yaw and pitch over their ranges
        as_measured: over the ranges of the tracks that a calibrated arm comes from
    """
    title, command = "Remote centre: Table 7 and Figure 9 of the paper", subject.command("rcm")
    if not sweeps:
        note = (f"{subject.arm.name}: no remote centre, or no simulation model",)
        return Part("rcm", subject.name, title, (), command, note)
    clouds = tuple(cloud(subject, sweep) for sweep in sweeps)
    figures = [figure for each in clouds for figure in _figures(subject, each)]
    figures += _measured(subject, as_measured)
    notes = [
        "Position relative to the pitch axis, in the frame of the first two joint axes at home. Of"
        " a PSM y is along the yaw axis, of an ECM x; z is along the pitch axis. Estimated by pivot"
        " calibration (the paper's equations 3 to 5) from the poses of the link that carries the"
        " insertion.",
        "The paper's equation 5 lacks the 1/n that its Table 7 needs; it is in ours.",
    ]
    notes.append(f"Swept: {_swept(subject, sweeps[0])}, 95 % of the joint range.")
    if subject.calibrated:
        notes.append("A calibrated arm: Table 7 is of another robot and not compared.")
    if _general(subject):
        notes.append("General four-bar loops have no fixed remote centre: its motion is stated.")
    return Part("rcm", subject.name, title, tuple(figures), command, tuple(notes), clouds)


def cloud(subject: Subject, motion: Sweep) -> Cloud:
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
        float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        motion.actual[:, joints[0]],
        motion.actual[:, joints[1]],
        np.sqrt(np.mean(missed**2, axis=0)),
    )


def _table7_frame(subject: Subject, motion: Sweep, at: dict[str, Array], centre: Array) -> Array:
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
    along = _towards(yaw.direction_a, centre - yaw.point_a)
    side = home[:3, :3] @ _rising(pitch.direction_a, pitch.angles, motion, mechanism)
    origin = _nearest(_moved(home, pitch.point_a), side, yaw.point_a, along)
    if subject.arm.type == "ECM":
        x, z = along, side - (side @ along) * along
        z /= np.linalg.norm(z)
        axes = np.stack([x, np.cross(z, x), z])
    else:
        y, z = -along, side - (side @ along) * along
        z /= np.linalg.norm(z)
        axes = np.stack([np.cross(y, z), y, z])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = axes, -axes @ origin
    return frame


def _driven(mechanism: Mechanism, joint: str) -> str:
    """Return the link that a joint's motor turns."""
    return mechanism.joints[mechanism.joint_index[joint]].drive[0][0]


def _towards(direction: Array, there: Array) -> Array:
    return direction if direction @ there >= 0.0 else -direction


def _rising(direction: Array, angles: Array, motion: Sweep, mechanism: Mechanism) -> Array:
    """Return the direction about which the pitch turns as it grows, right-handed."""
    pitch = motion.actual[:, mechanism.joint_index["pitch"]]
    used = np.isfinite(angles)
    return direction * np.sign(np.cov(angles[used], pitch[used])[0, 1])


def _nearest(point: Array, direction: Array, other: Array, other_direction: Array) -> Array:
    """Return the point of a line that is nearest to another, both through unit directions."""
    cosine = float(direction @ other_direction)
    between = other - point
    along = (between @ direction - cosine * (between @ other_direction)) / (1.0 - cosine**2)
    return point + along * direction


def _moved(T: Array, points: Array) -> Array:
    return points @ T[:3, :3].T + T[:3, 3]


def _general(subject: Subject) -> bool:
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
    bounded = found.drive == "set" and not _general(subject)
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


def _swept(subject: Subject, motion: Sweep) -> str:
    """Return between which positions yaw and pitch were told to go."""
    index = subject.arm.mechanism.joint_index
    told = {name: motion.commanded[:, index[name]] for name in ("yaw", "pitch")}
    return ", ".join(f"{name} {q.min():.2f} to {q.max():.2f} rad" for name, q in told.items())


def _measured(subject: Subject, as_measured: Sweep | None) -> list[Figure]:
    """State how far the tracks of a calibrated arm had the remote centre wander, beside ours."""
    overlay = subject.arm.overlay
    found = {} if overlay is None else overlay.measured.get("rcm", {})
    rms = found.get("rms_m")
    if overlay is None or not isinstance(rms, float):
        return []
    file = overlay.source.get("file", overlay.file)
    source = f"measured, noise included: {file}"
    figures = [Figure("measured: RMS distance", rms, "m", shown="mm", source=source)]
    wander = found.get("wander_rms_m")
    if isinstance(wander, float):
        source = f"measured, what noise alone would make taken off as squares: {file}"
        if isinstance(noise := found.get("noise_rms_m"), float):
            source += f"; less than {1e3 * NOISE_SHARE * noise:.2g} mm may be noise still"
        figures.append(Figure("measured without noise: RMS distance", wander, "m", shown="mm",
                              source=source))  # fmt: skip
    if as_measured is not None:
        source = (
            f"ours, over the range of the tracks: {_swept(subject, as_measured)}; no servo error"
        )
        figures.append(
            Figure("over the measured range: RMS distance",
                   cloud(subject, as_measured).rms_distance, "m", shown="mm", source=source)
        )  # fmt: skip
    return figures

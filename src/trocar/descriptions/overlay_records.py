"""Measured values of one robot that replace those of its description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import StereoCalibration
from trocar.descriptions.keys import key

Array = NDArray[np.float64]
ClosureKind = Literal["parallelogram", "general"]

#: Terms of a drivetrain and the number of their coefficients; 0: as many as its stops or cable has.
TERMS = {
    "rotor": 1,
    "coulomb": 1,
    "viscous": 1,
    "offset": 1,
    "stiffness": 1,
    "harmonic": 2,
    "stops": 0,
    "cable": 0,
}
#: Terms that must not be negative: they store energy or dissipate it.
POSITIVE = ("rotor", "coulomb", "viscous", "stiffness", "stops")


@dataclass(frozen=True, eq=False)
class BodyDynamics:
    """Mass distribution of a body.

    Attributes:
        mass: [kg]
        com: centre of mass in the frame, (3,) [m]
        inertia: about the centre of mass in the frame's axes, (3, 3) [kg m^2]
        mass_sigma, com_sigma, inertia_sigma: one standard deviation; None: not known
    """

    mass: float = field(metadata=key("mass"))
    com: Array = field(metadata=key("length", size=3))
    inertia: Array
    mass_sigma: float | None = field(default=None, metadata=key("mass"))
    com_sigma: Array | None = field(default=None, metadata=key("length", size=3))
    inertia_sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class Drivetrain:
    """Forces along one coordinate c, a linear combination of the joint positions.

    The force on c is rotor * c'' + coulomb * sign(c') + viscous * c' + offset + stiffness * c
    + harmonic . (sin c, cos c) + stops . z + cable . T(c) with the following states and functions.
    z: stop elements of a Maxwell-slip model of friction; element i follows c elastically, slips
    beyond `stop_limits[i]`: z_i <- clip(z_i + dc, -limit_i, limit_i).
    T: Chebyshev polynomials of the first to n-th order on `cable_range`, constant outside of it.
    Source: Al-Bender, Lampaert, Swevers 2005, The generalized Maxwell-slip model.

    Attributes:
        along: {joint: weight}, c = sum(weight * q)
        terms: {term: coefficients}, SI units of c
        sigma: {term: one standard deviation of its coefficients}
        stop_limits: of c, in the order of `terms["stops"]` [rad or m]
        cable_range: lowest and highest c of the cable's polynomial [rad or m]
    """

    along: Mapping[str, float]
    terms: Mapping[str, tuple[float, ...]]
    sigma: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    stop_limits: tuple[float, ...] = ()
    cable_range: tuple[float, float] = (0.0, 0.0)

    def one(self, term: str) -> float:
        """Return a term with one coefficient, 0 if the drivetrain lacks it."""
        return self.terms.get(term, (0.0,))[0]

    @property
    def dry_friction(self) -> float:
        """Coulomb friction after long travel in one direction, all stop elements slipping."""
        slipping = zip(self.terms.get("stops", ()), self.stop_limits, strict=True)
        return self.one("coulomb") + sum(k * limit for k, limit in slipping)


@dataclass(frozen=True)
class FilterSettings:
    """Zero-phase low-pass filters of a log, each run forwards and backwards.

    Attributes:
        rate_hz: sample rate that the logs had [Hz]
        cutoff_hz: of positions, velocities, efforts and of the predicted efforts [Hz]
        order: of the Butterworth filter
        acceleration_cutoff_hz: {joint: cut-off of a second filter of its acceleration} [Hz]
        differentiated: joints whose velocity is the derivative of the filtered position
    """

    rate_hz: float = field(default=200.0, metadata=key())
    cutoff_hz: float = field(default=17.0, metadata=key())
    order: int = field(default=6, metadata=key())
    acceleration_cutoff_hz: Mapping[str, float] = field(
        default_factory=dict[str, float], metadata=key()
    )
    differentiated: tuple[str, ...] = field(default=(), metadata=key())


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The identified dynamics of a robot.

    Attributes:
        bodies: {frame of the arm itself: mass distribution of its body}
        drivetrains: {name: forces}; the name of a joint or frame of the arm where it moves along
        filters: with which the logs were filtered
    """

    bodies: Mapping[str, BodyDynamics]
    drivetrains: Mapping[str, Drivetrain]
    filters: FilterSettings = FilterSettings()


@dataclass(frozen=True, eq=False)
class FramePatch:
    """The pose of a frame in its parent, at coordinate 0: for a hinge, that of its axis.

    T_parent_frame = transform(matrix_from_rpy(*rpy), xyz) @ motion_z(coordinate) @ after, with
    what comes after the motion (of standard DH rows) as the description has it.

    Attributes:
        xyz: position in the parent, (3,) [m]
        rpy: angles about the parent's fixed axes x, y, z, (3,) [rad]
        xyz_sigma: one standard deviation of xyz, (3,) [m]; None: not known
        rpy_sigma: of small turns about the frame's own axes x, y, z, (3,) [rad]; None: not known.
            Not of the three angles: these have no meaning each where the frame is pitched by 90 deg
    """

    xyz: Array = field(metadata=key("length", size=3))
    rpy: Array = field(metadata=key("angle", size=3))
    xyz_sigma: Array | None = field(default=None, metadata=key("length", size=3, least=0.0))
    rpy_sigma: Array | None = field(default=None, metadata=key("angle", size=3, least=0.0))


@dataclass(frozen=True, eq=False)
class ClosurePatch:
    """The position of a closing hinge on each of its two frames.

    Attributes:
        point_a, point_b: the hinge on frame_a and on frame_b, (3,) [m]
        point_a_sigma, point_b_sigma: one standard deviation, (3,) [m]; None: not known
        slides: whether the pin may shift along frame_a's axis, as loops whose axes are not
            parallel need
    """

    point_a: Array = field(metadata=key("length", size=3))
    point_b: Array = field(metadata=key("length", size=3))
    point_a_sigma: Array | None = field(default=None, metadata=key("length", size=3, least=0.0))
    point_b_sigma: Array | None = field(default=None, metadata=key("length", size=3, least=0.0))
    slides: bool = field(default=False, metadata=key())


@dataclass(frozen=True, eq=False)
class CameraPatch:
    """The camera at the end of an ECM's scope.

    Attributes:
        place: T_tip_camera in the arm's tip frame: the middle of both eyes, which looks midway
        calibration: both eyes
    """

    place: FramePatch
    calibration: StereoCalibration


@dataclass(frozen=True, eq=False)
class Overlay:
    """One robot's own geometry and dynamics, to be laid over the description of its kind.

    Attributes:
        arm: name of the description that it belongs to ("psm")
        closure: "parallelogram": the loops close by the couplings alone; "general": four-bars with
            any sides, closed numerically
        frames: {frame: where it stands}
        closures: {closure: where its hinge sits}
        measured: what was measured besides, for reports: tables of numbers, texts and lists
        source: {"file", "sha256", "version"}: the measurements and software that it comes from
        warnings: of the calibration
        file: where the overlay was read from, "" for one made in Python
        dynamics: its identified bodies and drivetrains; None: those of the description
        camera: what an ECM carries; None: what the rig has
        bases: {other arm of the rig: its reference frame in this arm's}; those that are not named
            stand where the rig has them
    """

    arm: str = field(metadata=key())
    closure: ClosureKind = field(default="parallelogram", metadata=key())
    frames: Mapping[str, FramePatch] = field(default_factory=dict[str, FramePatch])
    closures: Mapping[str, ClosurePatch] = field(default_factory=dict[str, ClosurePatch])
    measured: Mapping[str, Any] = field(default_factory=dict[str, Any])
    source: Mapping[str, str] = field(default_factory=dict[str, str])
    warnings: tuple[str, ...] = field(default=(), metadata=key())
    file: str = ""
    dynamics: Dynamics | None = None
    camera: CameraPatch | None = None
    bases: Mapping[str, FramePatch] = field(default_factory=dict[str, FramePatch])

"""Supervision of all arms every 20 ms: gravity compensation, and tracking errors."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.modeling.gravity import GravityModel
from trocar.simulation.drives import Drivetrains
from trocar.simulation.parts import Attached, Part, steps_in
from trocar.simulation.tip_load import PERIOD_S as LOAD_PERIOD_S

Array = NDArray[np.float64]

#: Gravity compensation is renewed this often. Source: our own choice; at 0.6 rad/s a PSM's gravity
#: torque changes by less than 0.02 N m in this time, which its servos answer with 0.2 mrad. [s]
GRAVITY_PERIOD_S = 0.02
#: Tracking errors are looked at this often. Source: our own choice. [s]
TRACKING_PERIOD_S = 0.02
#: Set-points that moved farther since the last look may have made a step, whose error is largest at
#: its beginning. Source: our own choice; in this time the fastest joint moves by 0.1 rad, far less
#: than its tolerance. [rad or m]
STEP = 0.015


class GravityCompensation:
    """Computes the efforts that controllers feed forward, in a MjData of its own.

    Args:
        model: chains of the controllers
        drive: as of the joint table, (J, nq)
    """

    def __init__(self, model: GravityModel, drive: Array) -> None:
        self._model, self._drive, self._data = model, drive, mujoco.MjData(model.mj)

    def write(self, qpos: Array, out: Array) -> None:
        """Write the efforts of the joints that have coefficients; leave those of others.

        Args:
            qpos: coordinates of the rig as the encoders report them, (nq,)
            out: written, (J,) [N m or N]
        """
        model, data = self._model, self._data
        data.qpos[:] = model.couple.dot(self._drive.dot(qpos))
        mujoco.mj_kinematics(model.mj, data)
        mujoco.mj_comPos(model.mj, data)
        mujoco.mj_rne(model.mj, data, 0, data.qfrc_bias)
        np.copyto(out, data.qfrc_bias.dot(model.couple), where=model.rows)


class Supervision(Part):
    """Feeds forward what holds the arms, and watches masters' grippers.

    Args:
        drivetrains: whose springs, cables and biases are held as well
    """

    def __init__(self, drivetrains: Drivetrains) -> None:
        self._drivetrains = drivetrains

    def attach(self, physics: Attached) -> None:
        """Take the physics that the arms are in."""
        self._physics, self._servos = physics, physics.servos
        table = physics.joints
        self._coefficients = (
            None if table.gravity is None else GravityCompensation(table.gravity, table.drive)
        )
        load = steps_in(LOAD_PERIOD_S, physics.timestep)
        self.before_every = load * max(1, round(GRAVITY_PERIOD_S / LOAD_PERIOD_S))
        self._frames, self._model, self._data = physics.true_frames, physics.model, physics.data
        self._share = table.share if self._frames.linear else None
        #: Bodies where the physics has them, made when they are first needed.
        self._bodies: mujoco.MjData | None = None
        self._grippers = [a.gripper for a in physics.arms.values() if a.gripper is not None]

    def before_step(self) -> None:
        """Renew the holding efforts, look at grippers."""
        self.balance()
        for gripper in self._grippers:
            gripper.watch()

    def balance(self, arm: str = "") -> None:
        """Feed forward what holds every motor's load, or only those of one arm, where they are."""
        holding = self._servos.holding
        kept = holding.copy() if arm else None
        self.holding_efforts(holding)
        if self._drivetrains.drives is not None or self._coefficients is not None:
            self._correct()
        if kept is not None:
            rows = self._physics.joints.arms[arm].rows
            kept[rows] = holding[rows]
            holding[:] = kept
        servos = self._servos
        if servos.plain:  # write_efforts without its call, for steps come here
            np.add(servos.commanded, servos.balanced * holding, out=servos.feed)
        else:
            servos.write_efforts()

    def holding_efforts(self, out: Array) -> Array:
        """Compute the efforts that hold every motor's load still now, (J,) [N m or N].

        See `Frames.joint_efforts`.

        Args:
            out: written and returned, (J,)
        """
        model, bodies = self._model, self._bodies
        if bodies is None:
            bodies = self._bodies = self._frames.bodies()
            self._coordinates, self._weight = bodies.qpos, bodies.qfrc_inverse
        self._coordinates[:] = self._data.qpos
        mujoco.mj_kinematics(model, bodies)
        mujoco.mj_comPos(model, bodies)
        mujoco.mj_rne(model, bodies, 0, self._weight)
        if self._share is None:
            return self._frames.joint_efforts(self._weight, out)
        return np.dot(self._share, self._weight, out=out)

    def balance_at_rest(self) -> None:
        """Feed forward what holds every motor's load from the bias forces of arms at rest."""
        self._frames.joint_efforts(self._data.qfrc_bias, self._servos.holding)
        self._correct()
        self._servos.write_efforts()

    def _correct(self) -> None:
        """Add efforts of springs; controllers with coefficients replace the sum by their own."""
        drives, holding = self._drivetrains.drives, self._servos.holding
        if drives is not None:
            holding += drives.holding(self._data.qpos)
        if self._coefficients is not None:
            self._coefficients.write(self._servos.qpos(), holding)


class Tracking(Part):
    """Switches off arms whose joints, or whose instrument's discs, left their set-points.

    Source: SAW, mtsPID.cpp: errors are those of actuators, which an instrument couples.
    """

    def __init__(self) -> None:
        #: Positions and set-points at the last look, (J,) each; none after they were put somewhere.
        self._before: tuple[Array, ...] = ()

    def attach(self, physics: Attached) -> None:
        """Take the physics that the arms are in."""
        self._physics, self._servos, self._table = physics, physics.servos, physics.joints
        self._coordinates, self._setpoint = physics.data.qpos, physics.servos.setpoint[:, 0]
        self.before_every = steps_in(TRACKING_PERIOD_S, physics.timestep)
        #: Actuators of joints that their servos drive, as of a revision of the servos.
        self._actuators = self._ratios = np.zeros((0, 0))
        self._revision = -1

    def placed(self, arm: str) -> None:  # noqa: ARG002  as every part
        """Forget where joints and set-points were."""
        self._before = ()

    def save(self) -> tuple[Array, ...]:
        """Return positions and set-points at the last look; they are never written to."""
        return self._before

    def load(self, state: tuple[Array, ...]) -> None:
        """Restore what `save` returned."""
        self._before = state

    def before_step(self) -> None:
        """Look at tracking errors, of a step of set-points from where joints were before it."""
        servos, before = self._servos, self._before
        if self._revision != servos.revision:
            self._actuators = self._table.actuators * servos.servoed
            self._ratios = self._actuators / self._table.tolerance[:, None]
            self._revision = servos.revision
        q = self._table.drive.dot(self._coordinates)
        if servos.errors is not None:
            q += servos.errors.error
        setpoint = self._setpoint.copy()
        self._before = q, setpoint
        beyond = self._beyond(q - setpoint)
        if beyond is None and before:
            moved = setpoint - before[1]
            far = moved.dot(moved) > 0.99 * STEP**2  # quick, and true where any is far
            ways: list[float] = moved.tolist() if far else []
            if max(map(abs, ways), default=0.0) > STEP:  # abs().max() takes 2 us
                beyond = self._beyond(before[0] - setpoint)
        if beyond is None:
            return
        for arm in self._physics.arms.values():
            motors, described = arm.runtime.motors, arm.description
            if motors.welded:
                continue
            coupled = described.own_joints - 3 if described.coupling else 0
            joints = [
                f"{joint.name}{' disc' if coupled and k > 2 else ''} ({found:.3g} {unit},"
                f" allowed {joint.tracking_tolerance:g})"
                for k, joint in enumerate(described.joints)
                if (found := beyond[motors.index.rows.start + k])
                for unit in ("m" if joint.kind == "prismatic" else "rad",)
            ]
            if joints:
                arm.runtime.states.fault(f"tracking error of {', '.join(joints)}")

    def _beyond(self, lag: Array) -> Array | None:
        """Return errors of actuators above tolerance, 0 for all others; None if all are below.

        Args:
            lag: of joints behind their set-points, (J,) [rad or m]

        Returns:
            (J,) [rad or m]
        """
        ratios = self._ratios.dot(lag)
        if not ratios.dot(ratios) > 0.99:  # quick: none is 1
            return None
        error = np.abs(self._actuators.dot(lag))
        beyond = error > self._table.tolerance
        return np.where(beyond, error, 0.0) if beyond.any() else None

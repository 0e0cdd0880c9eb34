"""The joint table: one row per public joint of a compiled rig, an arm is a slice of rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import (
    ArmDescription,
    Control,
    JointDescription,
    RigArm,
    RigDescription,
)
from trocar.errors import InputError
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.modeling import naming
from trocar.modeling.gravity import GravityModel, gravity_model

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Effort limit of joints without one, since MuJoCo needs a number. [N m or N]
UNLIMITED = 1e6
#: Inputs of a servo in `ctrl`: position, velocity, effort fed forward.
INPUTS = 3


@dataclass(frozen=True, eq=False)
class ArmIndex:
    """Rows and bodies of one arm in a compiled model.

    Attributes:
        rows: its joints in the table, the jaw last; none where the arm is welded into the model
        hinges: indices of the frames that are hinges in the model, (h,)
        qpos, dof: their addresses, (h,)
        turned: which hinges each joint's motor turns, (n, h) bool
        group: actuator group of its servos
        bodies: {frame: body id} of the frames that are bodies
        parallel: whether hinges follow the joints by fixed ratios
    """

    rows: slice
    hinges: Index
    qpos: Index
    dof: Index
    turned: NDArray[np.bool_]
    group: int
    bodies: Mapping[str, int]
    parallel: bool

    def carrier(self, arm: RigArm, frame: str) -> tuple[int, Array]:
        """Return the id of the body that carries a frame, and T_body_frame (4, 4)."""
        found, at = arm.arm.mechanism.frame(frame), np.eye(4)
        while found.name not in self.bodies and found.parent is not None:
            at = found.before @ found.after @ at
            found = arm.arm.mechanism.frame(found.parent)
        return self.bodies[found.name], at


@dataclass(frozen=True, eq=False)
class JointTable:
    """The public joints of a rig that move, in the order of the rig's arms; J rows.

    Row k is also actuator k of the model, its inputs are `ctrl.reshape(J, 3)[k]` and its integral
    is `act[k]`.

    Attributes:
        names: "PSM1/yaw", ...
        arms: {arm: where it is in the model}
        drive: q = drive @ qpos, (J, nq)
        rate: qd = rate @ qvel, (J, nv)
        share: generalised force on q = share @ force on hinges, (J, nv); loops as parallelograms
        couple: hinge coordinates = couple @ q, (nq, J), for arms whose loops are parallelograms
        lower, upper: joint limits [rad or m]
        effort_max: the motors' limits, UNLIMITED without one [N m or N]
        slope, corner: beyond the speed `corner` the supply's voltage takes this much of a motor's
            effort for each unit of speed; 0 and inf where it does not [N m s/rad or N s/m, rad/s or
            m/s]
        gains: P, I, D that the rig starts with, (J, 3)
        compensated: whether its control feeds gravity forward, (J,) bool
        actuators: errors of actuators = actuators @ errors of joints, (J, J); an instrument's
            discs are coupled
        tolerance: error of an actuator that trips the arm, inf where none does [rad or m]
        fingers: joints that have a spring and no motor, as a master's gripper, (J,) bool
        braked: joints of setup arms, whose brakes hold them rigidly, (J,) bool
        observer: nominal mass and cut-off of a disturbance observer, 0 without one, (J, 2)
            [kg m^2 or kg, rad/s]; rows of joints that discs drive may be those of these discs
        observed: velocities that observers see = observed @ velocities of joints, (J, J): the
            identity but for observers of discs
        output_max: largest effort of PID and observer, inf without such a limit [N m or N]
        brake: effort that an engaged brake holds, 0 of joints without one [N m or N]
        gravity: chains that controllers compute gravity compensation from, None without any
    """

    names: tuple[str, ...]
    arms: Mapping[str, ArmIndex]
    drive: Array
    rate: Array
    share: Array
    couple: Array
    lower: Array
    upper: Array
    effort_max: Array
    slope: Array
    corner: Array
    gains: Array
    compensated: NDArray[np.bool_]
    actuators: Array
    tolerance: Array
    fingers: NDArray[np.bool_]
    braked: NDArray[np.bool_]
    observer: Array
    observed: Array
    output_max: Array
    brake: Array
    gravity: GravityModel | None

    def __len__(self) -> int:
        return len(self.names)


def joint_table(
    rig: RigDescription,
    model: mujoco.MjModel,
    control: str = "dvrk",
    compensated: bool | None = None,
) -> JointTable:
    """Resolve a rig's joints in its compiled model.

    Args:
        rig: its description
        model: as compiled from it
        control: name of the gains, "dvrk" or "paper"
        compensated: whether gravity is fed forward; None: as the gains' source has it

    Raises:
        InputError: an arm without control gains
    """
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    arms: dict[str, ArmIndex] = {}
    names: list[str] = []
    count = np.count_nonzero(model.actuator_ctrlnum)  # limits of voltage have no inputs
    drive, couple = np.zeros((count, model.nq)), np.zeros((model.nq, count))
    rate, share = np.zeros((count, model.nv)), np.zeros((count, model.nv))
    lower, upper, effort, slope, corner, tolerance = (np.zeros(count) for _ in range(6))
    actuators, observed = np.eye(int(count)), np.eye(int(count))
    gains, observer = np.zeros((count, INPUTS)), np.zeros((count, 2))
    output_max, brake = np.full(count, np.inf), np.zeros(count)
    balanced, fingers, braked = (np.zeros(count, np.bool_) for _ in range(3))
    for rig_arm in rig.arms:
        index = arms[rig_arm.name] = _arm_index(rig_arm, model, joints, len(names))
        rows, mechanism = index.rows, rig_arm.arm.mechanism
        gains_of = preset(rig_arm.arm, control)
        if rows.start == rows.stop:
            continue
        column: dict[str, int] = {
            mechanism.frames[int(h)].name: k for k, h in enumerate(index.hinges)
        }
        for row, joint in enumerate(rig_arm.arm.joints, start=rows.start):
            names.append(naming.scoped(rig_arm.name, joint.name))
            for frame, weight in joint.drive:
                drive[row, index.qpos[column[frame]]] = weight
                rate[row, index.dof[column[frame]]] = weight
            pid = gains_of.pid[joint.name]
            effort[row] = min(effort_limit(joint, gains_of), UNLIMITED)
            slope[row], corner[row] = speed_line(joint, gains_of)
            # A jaw below 0 or on an object is force, not error, but of its discs; a master is moved
            # by hand. Source: SAW mtsIntuitiveResearchKitMTM.h, should_use_measured_setpoint_check.
            held = joint.name == "jaw" and rig_arm.arm.coupling is None
            held |= rig_arm.arm.type == "MTM"
            tolerance[row] = np.inf if held else joint.tracking_tolerance
            gains[row] = pid.p, pid.i, pid.d
            if joint.name in gains_of.observer:
                watched = gains_of.observer[joint.name]
                observer[row] = watched.mass, watched.cutoff
            output_max[row] = gains_of.pid_output_max.get(joint.name, np.inf)
            brake[row] = joint.brake
            fingers[row] = joint.spring is not None
        coupling = rig_arm.arm.coupling
        if coupling is not None:
            discs = slice(rows.stop - len(coupling.joint_to_actuator), rows.stop)
            actuators[discs, discs] = coupling.joint_to_actuator
            if gains_of.disc_observer:
                observer[discs] = [(one.mass, one.cutoff) for one in gains_of.disc_observer]
                observed[discs, discs] = coupling.joint_to_actuator
        lower[rows], upper[rows] = mechanism.lower, mechanism.upper
        braked[rows] = rig_arm.arm.type == "SUJ"
        balanced[rows] = gains_of.gravity_compensation if compensated is None else compensated
        ratios = mechanism.ratios[index.hinges]
        share[rows, index.dof] = ratios.T
        couple[index.qpos, rows] = ratios
    if [model.actuator(k).name for k in range(count)] != names:
        raise InputError(f"rig {rig.name}: its servos are not in the order of its joints")
    numbers = (
        drive,
        rate,
        share,
        couple,
        lower,
        upper,
        effort,
        slope,
        corner,
        gains,
        actuators,
        tolerance,
        observer,
        observed,
        output_max,
        brake,
    )
    for array in numbers:
        array.setflags(write=False)
    return JointTable(
        tuple(names),
        arms,
        drive,
        rate,
        share,
        couple,
        lower,
        upper,
        effort,
        slope,
        corner,
        gains,
        balanced,
        actuators,
        tolerance,
        fingers,
        braked,
        observer,
        observed,
        output_max,
        brake,
        gravity_model(rig, tuple(names), {name: index.rows for name, index in arms.items()}),
    )


def _arm_index(
    rig_arm: RigArm, model: mujoco.MjModel, joints: Mapping[str, int], first: int
) -> ArmIndex:
    arm, mechanism = rig_arm.arm, rig_arm.arm.mechanism
    scoped = [naming.scoped(rig_arm.name, frame.name) for frame in mechanism.frames]
    hinges = [k for k, name in enumerate(scoped) if name in joints]
    ids = [joints[scoped[k]] for k in hinges]
    live = arm.joints if hinges else ()
    turned = np.zeros((len(live), len(hinges)), np.bool_)
    for row, joint in enumerate(live):
        driven = {frame for frame, weight in joint.drive if weight}
        turned[row] = [mechanism.frames[h].name in driven for h in hinges]
    body = mujoco.mjtObj.mjOBJ_BODY
    bodies = {
        frame.name: found
        for frame, name in zip(mechanism.frames, scoped, strict=True)
        if (found := mujoco.mj_name2id(model, body, name)) >= 0
    }
    return ArmIndex(
        slice(first, first + len(live)),
        np.array(hinges, dtype=np.intp),
        np.array([model.jnt_qposadr[i] for i in ids], dtype=np.intp),
        np.array([model.jnt_dofadr[i] for i in ids], dtype=np.intp),
        turned,
        int(model.actuator_group[first]) if live else 0,
        bodies,
        loops_are_parallelograms(mechanism),
    )


def preset(arm: ArmDescription, name: str = "dvrk") -> Control:
    """Return an arm's gains; an arm without the preset has its first.

    Raises:
        InputError: it has none
    """
    if not arm.control:
        raise InputError(f"{arm.name}: has no control gains; its joints have no servos")
    return arm.control.get(name, next(iter(arm.control.values())))


def effort_limit(joint: JointDescription, control: Control) -> float:
    """Return the largest effort of a joint's motor, infinite without limit [N m or N].

    A jaw's grip is always limited, and so are the fingers in a gripper.
    """
    limited = control.effort_limits or joint.name == "jaw" or joint.spring is not None
    return joint.effort_max if limited else np.inf


def speed_line(joint: JointDescription, control: Control) -> tuple[float, float]:
    """Return by how much the supply's voltage lowers a motor's effort, and above which speed.

    A motor at a voltage exerts at most stall - stall / no_load * speed, where its current's limit
    is not less.

    Returns:
        the slope [N m s/rad or N s/m], the speed from which on it counts [rad/s or m/s]; 0 and inf
        where the voltage is no limit
    """
    limit = effort_limit(joint, control)
    if not np.isfinite([limit, joint.stall]).all():
        return 0.0, np.inf
    slope = joint.stall / joint.no_load
    return slope, joint.no_load - limit / slope

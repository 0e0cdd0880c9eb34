"""A rig as a MuJoCo model: a pure function of its description and a few options."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.descriptions.inertial import merged
from trocar.descriptions.records import (
    ArmDescription,
    Body,
    JointDescription,
    Prop,
    RigArm,
    RigDescription,
)
from trocar.descriptions.threads import ChainThread
from trocar.errors import DescriptionError, InputError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.chain_pose import standing_pose
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Frame
from trocar.kinematics.tree import local_pose
from trocar.modeling import naming
from trocar.modeling.drives import Drive, add_tendons, arm_drives, frames_of_drives
from trocar.modeling.geoms import LONE_MASK, OBJECTS, ContactMask, Geoms, contact_masks
from trocar.modeling.hinges import followers, hinge_of
from trocar.modeling.joints import JointTable, effort_limit, joint_table, preset, speed_line
from trocar.modeling.mujoco_log import log_mujoco_warnings
from trocar.modeling.options import (
    BELT_LOSS_S,
    HOLD,
    IMPRATIO,
    ISLAND_JOINTS,
    LAYERS,
    STIFF_IMPEDANCE,
    STIFF_STEPS,
    STILL_M_S,
    STOP_STEPS,
    THREAD,
    THREAD_TOLERANCE,
    TOLERANCE,
    ModelOptions,
)
from trocar.modeling.props import add_band, add_prop, extend, pair_grips, soften
from trocar.modeling.threads import add_thread, bodies_of, rests_of
from trocar.modeling.tissues import add_tissue, tissue_bit

Array = NDArray[np.float64]

#: Inputs of a PID servo: position, velocity, feed-forward effort.
SERVO_INPUTS = 7
SITE_RADIUS_M = 0.002
#: Fields by which compiled models of the same structure differ.
DIGESTED = (
    "body_pos",
    "body_quat",
    "body_mass",
    "body_inertia",
    "dof_damping",
    "dof_frictionloss",
    "dof_armature",
    "geom_size",
    "geom_contype",
    "geom_conaffinity",
    "geom_friction",
    "jnt_stiffness",
    "tendon_stiffness",
    "tendon_damping",
    "tendon_frictionloss",
    "tendon_armature",
    "tendon_lengthspring",
    "pair_solref",
)
#: Degrees of freedom up to which MuJoCo Warp takes dense models. Source: its `put_model`, 4.0.0.
WARP_DENSE = 60
#: Ratio of the cone in single precision, in place of `IMPRATIO`. Source: measured on Warp's CPU
#: backend with a needle between the pads of a PSM: 300 and more give NaN at the first grip.
WARP_IMPRATIO = 10.0


@dataclass(frozen=True, eq=False)
class RigModel:
    """A rig, the choices made for it, and its model.

    Attributes:
        rig: the description
        options: choices for the whole model
        spec: the model before compiling
        mj: the compiled model
    """

    rig: RigDescription
    options: ModelOptions
    spec: mujoco.MjSpec
    mj: mujoco.MjModel

    @cached_property
    def joints(self) -> JointTable:
        """The rig's public joints.

        Raises:
            InputError: an arm without control gains
        """
        options = self.options
        return joint_table(self.rig, self.mj, options.control, options.gravity_compensation)

    @cached_property
    def digest(self) -> str:
        """A short name of what was compiled: the same for the same rig, tools and options."""
        found = hashlib.sha256(str(self.mj.signature).encode())
        for name in DIGESTED:
            found.update(np.ascontiguousarray(getattr(self.mj, name)).tobytes())
        found.update(repr((self.options.timestep, self.options.control, self.rig.grasp)).encode())
        for place in self.rig.arms:
            control = place.arm.control.get(self.options.control)
            own: tuple[object, ...] = ()
            if control is not None:
                own = control.observer, control.pid_output_max
                own += (control.disc_observer,) if control.disc_observer else ()
            brakes = [joint.brake for joint in place.arm.joints]
            if any(brakes) or any(own):
                found.update(repr((place.name, own, brakes)).encode())
        if any(place.arm.gravity_links for place in self.rig.arms):
            found.update(b"" if self.joints.gravity is None else self.joints.gravity.digested)
        return found.hexdigest()[:12]


def build(rig: RigDescription | str | Path, options: ModelOptions | None = None) -> RigModel:
    """Compile a rig.

    Args:
        rig: a description, the name of a built-in rig, or the path of a TOML file
        options: choices for the whole model

    Raises:
        UnknownNameError: no such rig
        InputError: an arm has no masses; with position servos: or no gains
        DescriptionError: MuJoCo rejects the description; with its reason
    """
    chosen = options or ModelOptions()
    if not isinstance(rig, RigDescription):
        rig = load_rig(rig)
    draft = Draft(rig, chosen)
    try:
        return RigModel(rig, chosen, draft.spec, draft.compile())
    except ValueError as problem:
        raise DescriptionError(rig.file, "", f"MuJoCo rejects it: {problem}") from problem


def gpu_model(model: RigModel) -> mujoco.MjModel:
    """Return a copy of a model with position servos that `mujoco_warp.put_model` accepts.

    Warp has no PID servos and needs MuJoCo's automatic reset; above 60 degrees of freedom it needs
    a sparse Jacobian, too. Nothing sleeps, and friction yields more (`WARP_IMPRATIO`). Never step
    that model with MuJoCo itself, whose sparse solver opens the loops by millimetres (4.0.0,
    measured on the cart).

    Raises:
        InputError: the model has PID servos
    """
    if model.options.servo != "position":
        raise InputError(f"servo: got {model.options.servo!r}; allowed on a GPU: 'position'")
    made = copy(model.mj)
    made.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    made.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    made.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    made.opt.impratio = WARP_IMPRATIO
    if made.nv > WARP_DENSE:
        made.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_SPARSE)
    return made


def position_inputs(model: RigModel, setpoints: Array) -> Array:
    """Return `ctrl` with which position servos exert what PID servos do without integral gain.

    ctrl = q + (D v + effort) / P: the servo then exerts P (ctrl - x) - D x' = P (q - x) +
    D (v - x') + effort. A master's gripper has no gains; its `ctrl` is the effort.

    Args:
        model: with position servos
        setpoints: position, velocity and fed-forward effort of each joint, (..., n, 3)

    Returns:
        (..., n)
    """
    p, d = -model.mj.actuator_biasprm[:, 1], -model.mj.actuator_biasprm[:, 2]
    q, v, effort = np.moveaxis(setpoints, -1, 0)
    servo: Array = q + (d * v + effort) / np.where(p > 0.0, p, 1.0)
    found: Array = np.where(p > 0.0, servo, effort)
    return found


def lone_rig(arm: ArmDescription, name: str = "arm") -> RigDescription:
    """Return a rig of one arm whose root stands at the world's origin."""
    rest = np.clip(np.zeros(len(arm.joints)), arm.mechanism.lower, arm.mechanism.upper)
    return RigDescription(
        arm.name,
        arm.title,
        arm.source,
        arm.file,
        (RigArm(name, arm, "", "", np.eye(4)),),
        (),
        {"start": {name: rest}},
    )


@dataclass(frozen=True, eq=False)
class Anchor:
    """The place of a frame in the model: on a body, at a fixed pose T_body_frame (4, 4)."""

    body: mujoco.MjsBody
    pose: Array


class Draft:
    """A rig's model before compiling.

    Source of the solver's settings: measured on these arms, docs/simulation.md (integrator
    `discrete`, Newton, dense Jacobian: the sparse one of MuJoCo 4.0.0 diverges on these chains).

    Attributes:
        spec: ready to compile
        meshes: {name in the model: mesh}
        masks: contact masks, as `contact_masks` has them

    Raises:
        InputError: an arm has no masses; with position servos: or no gains
    """

    def __init__(self, rig: RigDescription, options: ModelOptions) -> None:
        log_mujoco_warnings()
        self.spec, self._options, self._rig = mujoco.MjSpec(), options, rig
        self._geoms = Geoms(self.spec, options)
        self.meshes = self._geoms.meshes
        self.spec.modelname = rig.name
        self._set_solver()
        self.masks = contact_masks(rig)
        if options.standalone and len(rig.arms) == 1 and not rig.props:
            self.masks = {"": LONE_MASK, rig.arms[0].name: LONE_MASK}
        world = Anchor(self.spec.worldbody, np.eye(4))
        poses = {prop.name: prop.pose for prop in rig.props}
        for prop in rig.props:
            body = add_prop(self.spec, prop, poses, options.timestep)
            if prop.thread is not None:
                self._add_links(prop, prop.thread, body)
                continue
            if prop.movable is not None:
                _set_mass(body, prop.movable.mass, prop.movable.com, prop.movable.inertia)
            mask = self.masks[OBJECTS if prop.movable else ""]
            for number, shape in enumerate(prop.shapes):
                self._geoms.add(body, f"{prop.name}/{number}", shape, mask)
        for band in rig.bands:
            add_band(self.spec, band)
        anchors: dict[str, dict[str, Anchor]] = {}
        for group, arm in enumerate(rig.arms, start=1):
            mount = anchors[arm.on][arm.frame] if arm.on else world
            at = Anchor(mount.body, mount.pose @ arm.pose)
            anchors[arm.name] = self._add_arm(arm, at, self.masks[arm.name], group)
        if options.servo == "pid" and not options.standalone:  # behind all servos
            for arm in rig.arms:
                if arm.name not in options.locked:
                    self._add_voltage_limits(arm)
        self._set_islands(rig.objects)
        if options.servo == "pid" and options.collisions and not options.standalone:
            for prop in rig.props:
                if prop.tissue is not None:
                    bit = tissue_bit(len(rig.arms))
                    step = options.timestep
                    add_tissue(self.spec, prop.name, prop.tissue, bit=bit, timestep=step)
        if rig.extension:
            extend(self.spec, rig.extension)
        soften(self.spec, self._geoms, options.timestep, self.compile)
        if options.collisions and not options.standalone:
            for arm in rig.arms:
                self._add_grasp(arm, [p for p in rig.objects if p.thread or not p.joint])

    def _add_links(self, prop: Prop, thread: ChainThread, body: mujoco.MjsBody) -> None:
        """Add the links of a thread with their shapes; it touches itself only where it may knot."""
        mask = self.masks[OBJECTS]
        if not thread.knots:
            mask = ContactMask(0, mask.conaffinity)
        step, geoms = self._options.timestep, self._geoms
        soft = any(s.stiffness is not None for other in self._rig.props for s in other.shapes)
        links = add_thread(body, prop, thread, step)
        for number, link in enumerate(links):
            before = len(geoms.surfaces)
            geoms.add(link, f"{prop.name}/{number}", prop.shapes[0], mask)
            for row, surface in enumerate(geoms.surfaces[before:], start=before):
                surface.geom.condim = 3  # too thin to resist rotation
                surface.geom.solref = [k * step ** (n - 2) for n, k in enumerate(THREAD)]
                if soft:
                    rests = rests_of(link, surface, number, thread)
                    geoms.surfaces[row] = replace(surface, rests=rests)

    def _set_solver(self) -> None:
        compiler, option = self.spec.compiler, self.spec.option
        compiler.degree = False
        compiler.autolimits = True
        compiler.boundmass = 0.0
        option.timestep = self._options.timestep
        option.gravity = [0.0, 0.0, -9.81]
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = IMPRATIO
        # Divergence is an error, and no reason to start again.
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET

    def _set_islands(self, objects: Sequence[Prop]) -> None:
        option = self.spec.option
        if not objects and len(self.spec.joints) < ISLAND_JOINTS:
            option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        if objects:
            option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
            option.sleep_tolerance = STILL_M_S
            threads = any(prop.thread for prop in objects)
            option.tolerance = THREAD_TOLERANCE if threads else TOLERANCE

    def _add_arm(
        self, place: RigArm, mount: Anchor, mask: ContactMask, group: int
    ) -> dict[str, Anchor]:
        """Add an arm on its mount, and return where each of its frames is.

        Args:
            place: the arm
            mount: of its root
            mask: of its geoms
            group: of its servos, which can be switched off together
        """
        arm = place.arm
        massed = {body.frame for body in arm.bodies}
        moving = [f.name for f in arm.mechanism.frames if f.motion != "fixed"]
        if bare := [name for name in moving if name not in massed]:
            why = "".join(f"; {m.what}: {m.why}" for m in arm.missing)
            raise InputError(f"{arm.name}: cannot be simulated, no mass for {', '.join(bare)}{why}")
        anchors = self._add_frames(place, mount, mask)
        if not self._options.standalone:
            self._add_frame_sites(place, anchors)
        if place.name not in self._options.locked:
            self._add_loops(place, anchors)
            for frame, leader, ratio in followers(arm):
                name = naming.scoped(place.name, frame)
                hinges = (name, naming.scoped(place.name, leader))
                if self._options.belts == "stretch" and frame in arm.belts:
                    self._add_belt(name, hinges, ratio, arm.belts[frame])
                else:
                    self._tie(name, hinges, ratio)
            for joint in arm.joints:
                self._add_servo(place, joint, group)
            add_tendons(self.spec, place.name, self._drives(place), self._options.timestep)
        return anchors

    def compile(self) -> mujoco.MjModel:
        """Compile the model.

        MuJoCo scales the softness of constraints by each side's own inverse weight. Identified
        rotors of a jaw are on tendons to one finger: the other one, which follows by a constraint,
        would yield to it by 0.2 rad/(N m), so it counts as heavy as the one it follows.
        """
        model = self.spec.compile()
        for place in self._rig.arms:
            driven = place.name not in self._options.locked and self._drives(place)
            for frame, leader, _ in followers(place.arm) if driven else ():
                one, other = (model.joint(naming.scoped(place.name, f)) for f in (frame, leader))
                for field, k, m in (
                    (model.dof_invweight0, one.dofadr, other.dofadr),
                    (model.body_invweight0, model.jnt_bodyid[one.id], model.jnt_bodyid[other.id]),
                ):
                    field[k] = np.minimum(field[k], field[m])
        return model

    def _drives(self, place: RigArm) -> tuple[Drive, ...]:
        """Return an arm's drives in simulations; files for others have friction of hinges."""
        options = self._options
        if options.servo != "pid" or options.standalone or options.decoration:
            return ()
        return arm_drives(place.arm, options.friction)

    def _add_frame_sites(self, place: RigArm, anchors: Mapping[str, Anchor]) -> None:
        """Add the sites that the poses of an arm are read from: its tip and its reference."""
        arm, mechanism = place.arm, place.arm.mechanism
        root = anchors[arm.root]
        own = root.pose @ standing_pose(mechanism, mechanism.reference, arm.root)
        tip = anchors[mechanism.tip]
        _add_site(tip.body, naming.frame_site(place.name, "tip"), tip.pose)
        _add_site(root.body, naming.frame_site(place.name, "reference"), own)

    def _add_frames(self, place: RigArm, mount: Anchor, mask: ContactMask) -> dict[str, Anchor]:
        arm, name = place.arm, place.name
        locked = self._options.locked.get(name)
        at = None if locked is None else coordinates(arm.mechanism, locked)
        massed: dict[str, list[Body]] = {}
        for body in arm.bodies:
            massed.setdefault(body.frame, []).append(body)
        anchors: dict[str, Anchor] = {}
        for index, frame in enumerate(arm.mechanism.frames):
            parent = mount if frame.parent is None else anchors[frame.parent]
            zero = np.zeros(()) if at is None else at[index]
            pose = parent.pose @ local_pose(frame, zero)
            moves = frame.motion != "fixed" and at is None
            if not moves and frame.name not in massed and frame.parent is not None and at is None:
                anchors[frame.name] = Anchor(parent.body, pose)
                if self._options.decoration or self._options.standalone:
                    _add_site(parent.body, naming.scoped(name, frame.name), pose)
                continue
            made = parent.body.add_body(
                name=naming.scoped(name, frame.name),
                pos=pose[:3, 3],
                quat=quaternion_from_matrix(pose[:3, :3]),
            )
            anchors[frame.name] = Anchor(made, np.eye(4))
            if moves:
                self._add_hinge(made, place, frame)
            bodies = massed.get(frame.name, [])
            _set_mass(made, *merged(bodies))
            for number, shape in enumerate(s for b in bodies for s in b.shapes):
                geom = naming.scoped(name, f"{frame.name}/{number}")
                self._geoms.add(made, geom, shape, mask)
        return anchors

    def _add_hinge(self, body: mujoco.MjsBody, place: RigArm, frame: Frame) -> None:
        """Give a body its hinge or slide: the axis is z ahead of the frame's fixed `after`."""
        back = inverse(frame.after)
        slides = frame.motion == "prismatic"
        passive = hinge_of(place.arm, frame.name, self._options.friction)
        drives = self._drives(place)
        if frame.name in frames_of_drives(place.arm, drives):
            own = next((d for d in drives if d.name == frame.name), Drive("", {}, ()))
            passive = replace(
                passive,
                armature=own.armature,
                damping=own.damping,
                frictionloss=own.frictionloss,
            )
        hinge = body.add_joint(
            name=naming.scoped(place.name, frame.name),
            type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
            pos=back[:3, 3],
            axis=back[:3, 2],
            armature=passive.armature,
            damping=[passive.damping, 0.0, 0.0],
            frictionloss=passive.frictionloss,
        )
        if drives:
            hinge.solref_friction = [STOP_STEPS * self._options.timestep, 1.0]
            hinge.solimp_friction = STIFF_IMPEDANCE
        if passive.stiffness:
            hinge.stiffness = [passive.stiffness, 0.0, 0.0]
            hinge.springref = passive.rest
        if np.isfinite([passive.lower, passive.upper]).all():
            hinge.range = [passive.lower, passive.upper]
            hinge.solref_limit = [STOP_STEPS * self._options.timestep, 1.0]
            hinge.solimp_limit = STIFF_IMPEDANCE

    def _add_loops(self, place: RigArm, anchors: Mapping[str, Anchor]) -> None:
        name, mechanism = place.name, place.arm.mechanism
        # A guard relies on the other loops: beside an open one it would hold what has come apart.
        parallel = loops_are_parallelograms(mechanism)
        guarded = parallel and not any(c.open for c in mechanism.closures)
        for closure in mechanism.closures:
            sites = [naming.closing_site(name, closure.name, side) for side in "ab"]
            ends = (closure.frame_a, closure.point_a), (closure.frame_b, closure.point_b)
            for site, (frame, point) in zip(sites, ends, strict=True):
                anchor = anchors[frame]
                _add_site(anchor.body, site, anchor.pose @ transform(np.eye(3), point))
            if closure.open:  # its passive frames are tied by nothing else: they swing
                continue
            for layer in range(1 if parallel else LAYERS):
                self.spec.add_equality(
                    name=naming.connect(name, closure.name, layer),
                    type=mujoco.mjtEq.mjEQ_CONNECT,
                    objtype=mujoco.mjtObj.mjOBJ_SITE,
                    name1=sites[0],
                    name2=sites[1],
                    data=np.zeros(12),
                    solref=[STIFF_STEPS * self._options.timestep, 1.0],
                    solimp=STIFF_IMPEDANCE,
                )
            if closure.guard and guarded:
                one, other = (naming.scoped(name, frame) for frame in closure.guard)
                self._tie(naming.guard(name, closure.name), (one, other), 1.0)

    def _tie(self, name: str, hinges: tuple[str, str], ratio: float) -> None:
        """Add an equality: coordinate of the first hinge = ratio * that of the second."""
        self.spec.add_equality(
            name=name,
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=hinges[0],
            name2=hinges[1],
            data=[0.0, ratio, *[0.0] * 10],
            solref=[STIFF_STEPS * self._options.timestep, 1.0],
            solimp=STIFF_IMPEDANCE,
        )

    def _add_belt(self, name: str, hinges: tuple[str, str], ratio: float, stiffness: float) -> None:
        """Add a spring between two hinges: its stretch is the first - ratio * the second."""
        belt = self.spec.add_tendon(name=name)
        belt.wrap_joint(hinges[0], 1.0)
        belt.wrap_joint(hinges[1], -ratio)
        belt.stiffness = [stiffness, 0.0, 0.0]
        belt.damping = [stiffness * BELT_LOSS_S, 0.0, 0.0]
        belt.springlength = [0.0, 0.0]

    def _add_grasp(self, place: RigArm, objects: Sequence[Prop]) -> None:
        """Add what a jaw holds free props by: an inactive weld each, beside PID servos.

        Those whose friction prevails get pairs with its pads, which can be made frictionless apart.
        """
        fingers = [naming.scoped(place.name, frame) for frame in place.arm.fingers]
        pads = [pad for pad in self._geoms.surfaces if pad.body in fingers]
        if {pad.body for pad in pads} != set(fingers) or len(fingers) != len("lr"):
            return
        for prop in objects if self._options.servo == "pid" else ():
            self.spec.add_equality(
                name=naming.grasp(place.name, prop.name),
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1=fingers[0],
                name2=prop.name,
                active=False,
                data=[*[0.0] * 6, 1.0, *[0.0] * 3, 1.0, 0.0],
                solref=[k / self._options.timestep ** (2 - n) for n, k in enumerate(HOLD)],
                solimp=STIFF_IMPEDANCE,
            )
        names = [n for prop in objects for n in bodies_of(prop)]
        pair_grips(self.spec, pads, [s for s in self._geoms.surfaces if s.body in names])

    def _add_servo(self, place: RigArm, joint: JointDescription, group: int) -> None:
        """Add a joint's actuator on the hinge that it drives."""
        ((hinge, weight),) = joint.drive
        servo = self.spec.add_actuator(
            name=naming.scoped(place.name, joint.name),
            target=naming.scoped(place.name, hinge),
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        servo.gear = [weight, 0, 0, 0, 0, 0]
        servo.group = group
        limit = joint.effort_max
        if self._options.servo == "pid":
            servo.set_to_pid(kp=1.0, kv=1.0, ki=1.0, ctrlspec=SERVO_INPUTS)
        else:
            control = preset(place.arm, self._options.control)
            gains, limit = control.pid[joint.name], effort_limit(joint, control)
            if joint.spring is None:
                servo.set_to_position(kp=gains.p, kv=gains.d)
            else:  # a gripper has no motor: its effort is that of a person's fingers
                servo.set_to_motor()
        if self._options.servo == "pid" or np.isfinite(limit):
            servo.forcerange = [-limit, limit]

    def _add_voltage_limits(self, place: RigArm) -> None:
        """Limit the effort of fast motors by the voltage of their supply.

        Each direction has one actuator without an input, MuJoCo's DC motor. It brakes above the
        speed at which the voltage limits the effort more than the current does; below, its force
        is clamped to 0.
        """
        control = preset(place.arm, self._options.control)
        for joint in place.arm.joints:
            slope, corner = speed_line(joint, control)
            if not slope:
                continue
            ((hinge, weight),) = joint.drive
            most = 2.0 * effort_limit(joint, control)
            for sign, span in ((1.0, [-most, 0.0]), (-1.0, [0.0, most])):
                made = self.spec.add_actuator(
                    name=naming.voltage_limit(place.name, joint.name, sign),
                    target=naming.scoped(place.name, hinge),
                    trntype=mujoco.mjtTrn.mjTRN_JOINT,
                )
                made.set_to_dcmotor([1.0, 1.0], 1.0, ctrlspec=mujoco.mjtCtrlInput.mjINPUT_NONE)
                made.biastype = mujoco.mjtBias.mjBIAS_AFFINE
                made.biasprm[:3] = sign * slope * corner, 0.0, -slope
                made.gear = [weight, 0, 0, 0, 0, 0]
                made.forcerange = span


def _set_mass(made: mujoco.MjsBody, mass: float, com: Array, inertia: Array) -> None:
    """Give a body its mass, its centre and the inertia about it; nothing where it has none."""
    made.explicitinertial = True
    made.mass = mass
    if not mass:
        return
    made.ipos = com
    made.fullinertia = [inertia[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _add_site(body: mujoco.MjsBody, name: str, pose: Array) -> None:
    body.add_site(
        name=name,
        pos=pose[:3, 3],
        quat=quaternion_from_matrix(pose[:3, :3]),
        size=[SITE_RADIUS_M] * 3,
    )

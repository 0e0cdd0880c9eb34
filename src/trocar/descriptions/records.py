"""Contents of descriptions: frozen records in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import CameraDescription
from trocar.descriptions.calibration_plan import CalibrationPlan
from trocar.descriptions.keys import key
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.needles import Needle
from trocar.descriptions.overlay_records import Overlay
from trocar.descriptions.robot_errors import RobotErrors
from trocar.descriptions.sensor_records import SensorDescription
from trocar.descriptions.teleops import TeleopDescription
from trocar.descriptions.threads import ChainThread
from trocar.descriptions.tissues import Tissue
from trocar.errors import UnknownNameError
from trocar.kinematics.coupling import Coupling
from trocar.kinematics.mechanism import JointKind, Mechanism, Motion

Array = NDArray[np.float64]
#: Colliding part of a drawn solid: nothing, its convex pieces, or a box or capsule about them all.
Touches = Literal["nothing", "pieces", "box", "capsule"]
ShapeKind = Literal["box", "capsule", "cylinder", "sphere", "mesh"]
PropJointKind = Literal["hinge", "slide", "ball"]
Generation = Literal["Classic", "Si"]
GraspKind = Literal["friction+stick", "friction", "attach"]
DynamicsKind = Literal["identified", "cad"]
Surroundings = Literal["table", "cavity"]

#: The material of surfaces that look like tissue.
TISSUE = "tissue"

#: Name of the stereo display's frame, of the poses of masters. Source: the dVRK's
#: console files.
DISPLAY = "HRSV"
#: Name of the patient cart's frame, and the arm in whose tip frame the poses of the others on its
#: setup joints are. Source: the dVRK's mtsIntuitiveResearchKitSUJ.cpp, constructor and Configure.
CART = "Cart"
REFERENCE_ARM = "ECM"
#: Radius of the drawing of a band. Source: our own choice. [m]
BAND_RADIUS_M = 5e-4


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive solid on a frame, or triangles: those that are seen, or a convex piece.

    Attributes:
        kind: box, capsule, cylinder, sphere or mesh
        pose: T_frame_shape (4, 4); a capsule or cylinder lies along its z axis
        size: box: half edges (x, y, z); capsule, cylinder: (radius, half length of the straight
            part, 0); sphere: (radius, 0, 0); mesh: farthest from its origin (x, y, z) [m]
        material: name of a row in `materials`
        rounding: radius of a box's edges as it is drawn [m]
        collide: takes part in contacts
        hull: what it collides as: itself, or a "capsule" along its longest edge (ten times cheaper)
        weigh: counts for mass properties that come from the shape
        mesh: the triangles of a mesh, which weighs nothing; what collides is its convex hull
        visible: whether it is looked at
        friction: sliding coefficient; None: as all shapes that give none
        density: [kg/m^3]; None: its body has a mass of its own
        stiffness: normal force per depth at each contact point of a soft shape; None: rigid [N/m]
    """

    kind: ShapeKind
    pose: Array
    size: Array
    material: str
    rounding: float = 0.0
    collide: bool = True
    weigh: bool = True
    hull: Literal["same", "capsule"] = "same"
    mesh: Mesh | None = None
    visible: bool = True
    friction: float | None = None
    density: float | None = None
    stiffness: float | None = None


@dataclass(frozen=True, eq=False)
class Body:
    """Mass and shape that move with a frame.

    Attributes:
        frame: the frame it moves with
        mass: [kg]
        com: centre of mass in the frame, (3,) [m]
        inertia: about the centre of mass in the frame's axes, (3, 3) [kg m^2]
        shapes: what it looks like and collides with
        inertia_from: "source", "shape" or "solid"
        source: where the numbers are from
        part: the file's name: the arm's or the tool's
        solid: the drawn solid, "set/link", whose meshes are among the shapes; "" without one
        touches: what of that solid collides
    """

    frame: str
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[Shape, ...]
    inertia_from: str
    source: str
    part: str
    solid: str = ""
    touches: Touches = "nothing"


@dataclass(frozen=True)
class Spring:
    """The spring of a joint without a motor.

    Attributes:
        stiffness: torque = stiffness (rest - q) [N m/rad]
        rest: angle without torque, also beyond the limits [rad]
    """

    stiffness: float = field(metadata=key("angular stiffness", above=0.0))
    rest: float = field(metadata=key("angle"))


@dataclass(frozen=True)
class JointDescription:
    """A public joint with its motor and servo.

    Attributes:
        name, kind: of the joint
        lower, upper: limits [rad or m]
        effort_max: of the motor; default: unlimited [N m or N]
        velocity_max, acceleration_max: of `move_jp`; default: unlimited [per s, per s^2]
        tracking_tolerance: tracking error that causes FAULT; not of jaws and masters; default:
            unlimited [rad or m]
        drive: frame that the motor moves, `{ yaw = 1.0 }`: q = weight times its coordinate. A jaw
            drives one finger with weight 2
        stop_lower, stop_upper: mechanical stops inside the limits (of a jaw: 0) [rad or m]
        no_load, stall: of the motor at its supply's voltage: speed without effort, effort at rest
            if only the winding limited it; default: no such limit [rad/s or m/s, N m or N]
        brake: effort that its brake holds when engaged; default: no brake [N m or N]
        spring: of a joint that has a sensor and no motor
        source: of the numbers
    """

    name: str = field(metadata=key())
    kind: JointKind = field(metadata=key())
    lower: float = field(metadata=key("angle", "length"))
    upper: float = field(metadata=key("angle", "length"))
    effort_max: float = field(metadata=key("torque", "force", above=0.0, default=np.inf))
    velocity_max: float = field(
        metadata=key("angular velocity", "linear velocity", above=0.0, default=np.inf)
    )
    acceleration_max: float = field(
        metadata=key("angular acceleration", "linear acceleration", above=0.0, default=np.inf)
    )
    tracking_tolerance: float = field(
        metadata=key("angle", "length", above=0.0, default=np.inf, see="arm.md#states")
    )
    drive: tuple[tuple[str, float], ...] = field(metadata=key(form="weights"))
    stop_lower: float = field(metadata=key("angle", "length", like="lower"))
    stop_upper: float = field(metadata=key("angle", "length", like="upper"))
    no_load: float = field(
        metadata=key(
            "angular velocity",
            "linear velocity",
            above=0.0,
            default=np.inf,
            see="dynamics.md#in-the-simulation",
        )
    )
    stall: float = field(metadata=key("torque", "force", above=0.0, default=np.inf))
    brake: float = field(
        metadata=key("torque", "force", above=0.0, default=0.0, see="si.md#brakes")
    )
    spring: Spring | None
    source: str = field(metadata=key(default=""))


@dataclass(frozen=True)
class Friction:
    """Friction of a joint or frame.

    Attributes:
        coulomb: dry friction [N m or N]
        viscous: damping [N m s/rad or N s/m]
    """

    coulomb: float = field(metadata=key("torque", "force", least=0.0, default=0.0))
    viscous: float = field(
        metadata=key("angular damping", "linear damping", least=0.0, default=0.0)
    )


@dataclass(frozen=True)
class Gains:
    """PID gains of a joint [N m/rad, N m/(rad s), N m s/rad], or in N and m."""

    p: float
    i: float
    d: float


@dataclass(frozen=True)
class Observer:
    """A disturbance observer: d = low-pass(u + mass cutoff v) - mass cutoff v is added to u.

    Attributes:
        mass: nominal inertia or mass that the motor moves [kg m^2 or kg]
        cutoff: of the low-pass filter; 0 of one that adds nothing [rad/s]
    """

    mass: float
    cutoff: float


@dataclass(frozen=True)
class Control:
    """A named set of gains.

    Attributes:
        name: of the set
        pid: {joint: gains}; in a file P, I, D in SI, `{ yaw = [120.0, 0.0, 6.0] }`
        gravity_compensation, effort_limits: whether the servo has them
        observer: {joint: disturbance observer}; in a file nominal mass in SI and cut-off in rad/s,
            `{ yaw = [0.01, 50.0] }`; default: none
        disc_observer: disturbance observers of the discs that drive an instrument, in the order of
            its coupling; in a file as those of joints, `[[0.0005, 10.0], ...]`; default: none
        pid_output_max: {joint: largest effort of PID and observer, without gravity}; in a file in
            SI, `{ yaw = 10.0 }`; default: the motor's
        source: of the numbers
    """

    name: str
    pid: Mapping[str, Gains] = field(metadata=key(form="any"))
    gravity_compensation: bool = field(metadata=key(default=True))
    effort_limits: bool = field(metadata=key(default=True))
    observer: Mapping[str, Observer] = field(
        default_factory=dict[str, Observer], metadata=key(form="any", see="si.md#the-controller")
    )
    disc_observer: tuple[Observer, ...] = field(
        default=(), metadata=key(form="any", default=(), see="si.md#the-controller")
    )
    pid_output_max: Mapping[str, float] = field(
        default_factory=dict[str, float], metadata=key(see="si.md#the-controller")
    )
    source: str = field(default="", metadata=key())


@dataclass(frozen=True, eq=False)
class GravityLink:
    """A link of the chain that an arm's controller computes gravity compensation from.

    Each hangs on the one before, the first on the arm's root, by modified DH parameters.

    Attributes:
        name: of the link
        a, alpha, d, theta: the motion adds to theta or d [m, rad, m, rad]
        motion: about or along z
        q: `{ pitch = -1.0 }`: coordinate = sum of ratio times joint
        mass: [kg]
        com: centre of mass, (3,) [m]
        source: of the numbers
    """

    name: str = field(metadata=key())
    a: float = field(default=0.0, metadata=key("length"))
    alpha: float = field(default=0.0, metadata=key("angle"))
    d: float = field(default=0.0, metadata=key("length"))
    theta: float = field(default=0.0, metadata=key("angle"))
    motion: Motion = field(default="fixed", metadata=key())
    q: Mapping[str, float] = field(default_factory=dict[str, float], metadata=key())
    mass: float = field(default=0.0, metadata=key("mass", least=0.0))
    com: Array = field(default_factory=lambda: np.zeros(3), metadata=key("length", size=3))
    source: str = field(default="", metadata=key())


@dataclass(frozen=True)
class Counterweight:
    """A body that balances the load on a joint, tool included: its mass is the load's over `ratio`.

    Attributes:
        body: frame of the counterweight
        joint: of the load
        ratio: of the body's travel to the joint's
    """

    body: str = field(metadata=key())
    joint: str = field(metadata=key())
    ratio: float = field(metadata=key(above=0.0))


@dataclass(frozen=True)
class Missing:
    """A quantity that the description of an arm lacks.

    Attributes:
        what: the quantity
        why: the reason
    """

    what: str = field(metadata=key())
    why: str = field(metadata=key())


@dataclass(frozen=True, eq=False)
class ArmDescription:
    """One arm with its mounted tool: the only truth about it.

    Attributes:
        name, type, generation, title, source: its identification; `type` is PSM, ECM, SUJ or MTM
        file: the TOML file
        mechanism: frames, joints and loops, with the tool's
        joints: what is known of each public joint, in the mechanism's order
        bodies: masses and shapes
        friction: {"identified" | "paper": {frame or joint: Friction}}
        rotor: {frame: reflected inertia [kg m^2] or mass [kg]}
        belts: {frame that follows a joint by a belt: the belt's stiffness [N m/rad]}
        control: {"dvrk" | "paper": Control}
        poses: {name: q (n,)}
        tool: name of the mounted tool, "" when none
        tool_frame: the frame that tools hang on, "" when it takes none
        coupling: the tool's actuators, None without a tool
        inverse_kinematics: structure that has a closed form, "" when none
        missing: the unknown data
        row_sources: {frame: source}
        block_sources: {block: source} of the other blocks ("friction identified", "rotor", the
            mounted tool, ...); a block of the tool has the tool's name in front
        calibration: plan of its calibration report, None where its file has none
        gravity_links: what its controller computes gravity compensation from; () where that
            carries the true weight
        overlay: the calibration that it carries, None of a nominal arm
    """

    name: str
    type: str
    generation: str
    title: str
    source: str
    file: str
    mechanism: Mechanism
    joints: tuple[JointDescription, ...]
    bodies: tuple[Body, ...]
    friction: Mapping[str, Mapping[str, Friction]]
    rotor: Mapping[str, float]
    belts: Mapping[str, float]
    control: Mapping[str, Control]
    poses: Mapping[str, Array]
    tool: str
    tool_frame: str
    coupling: Coupling | None
    inverse_kinematics: str
    missing: tuple[Missing, ...]
    row_sources: Mapping[str, str]
    block_sources: Mapping[str, str]
    calibration: CalibrationPlan | None = None
    overlay: Overlay | None = None
    gravity_links: tuple[GravityLink, ...] = ()

    @property
    def root(self) -> str:
        """The frame that is mounted."""
        return self.mechanism.frames[0].name

    @property
    def has_jaw(self) -> bool:
        """Whether the last joint is a jaw."""
        return self.joints[-1].name == "jaw"

    @property
    def has_gripper(self) -> bool:
        """Whether the last joint is a gripper: a spring and a sensor, no motor."""
        return self.joints[-1].spring is not None

    @property
    def fingers(self) -> tuple[str, ...]:
        """The frames that a jaw opens and shuts, () without one."""
        jaw = self.joints[-1].name
        frames = self.mechanism.frames if self.has_jaw else ()
        return tuple(f.name for f in frames if jaw in [joint for joint, _ in f.couplings])

    @property
    def own_joints(self) -> int:
        """The number of joints in `measured_js`: all but a jaw or a gripper."""
        return len(self.joints) - (self.has_jaw or self.has_gripper)

    def joint(self, name: str) -> JointDescription:
        """Return the joint called `name`.

        Raises:
            UnknownNameError: no such joint; the known ones are listed
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise UnknownNameError("joint", name, self.mechanism.joint_names, self.name)

    def pose(self, name: str) -> Array:
        """Return the joint positions of a named pose, (n,) [rad or m]."""
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        return self.poses[name].copy()


@dataclass(frozen=True, eq=False)
class BaseFrame:
    """The frame of an arm's poses, where the rig gives it.

    Attributes:
        name: in messages
        pose: the arm's own reference frame in it, (4, 4)
    """

    name: str = field(metadata=key(form="name"))
    pose: Array


@dataclass(frozen=True, eq=False)
class RigArm:
    """An arm in a rig.

    Attributes:
        name: "PSM1", "SUJ_PSM1", "ECM", ...
        arm: its description with its tool
        on: the arm that carries it, "" for the world
        frame: the frame of that arm that it is mounted on, "" for the world
        pose: T_mount_root, the arm's root in that frame (4, 4)
        base_frame: the frame of `measured_cp`, None where that follows from the rig
        mounting_pitch: turn of its root about x from upright, for gravity compensation by
            `gravity_links`, None where that is as the arm stands at the start [rad]
    """

    name: str
    arm: ArmDescription
    on: str
    frame: str
    pose: Array
    base_frame: BaseFrame | None = None
    mounting_pitch: float | None = None

    @property
    def own_frame(self) -> str:
        """Name of the arm's reference frame in messages: the cart for setup joints."""
        return CART if self.arm.type == "SUJ" else f"{self.name}_base"


@dataclass(frozen=True, eq=False)
class Movable:
    """The mass properties of a prop that can fall and be pushed.

    Attributes:
        mass: [kg]
        com: centre of mass in the prop's frame, (3,) [m]
        inertia: about the centre of mass in the frame's axes, (3, 3) [kg m^2]
        inertia_from: "source", "shape" or "solid"
    """

    mass: float
    com: Array
    inertia: Array
    inertia_from: str


def _origin() -> Array:
    return np.zeros(3)


def _upward() -> Array:
    return np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class PropJoint:
    """A joint between two props, or between a prop and the world; vectors in the prop's frame.

    Attributes:
        kind: of the joint
        on: carrier: a prop before this one, or the world ("" in Python)
        point: on the axis, or centre of a ball, (3,) [m]
        axis: its direction, a unit vector, (3,)
        lower, upper: limits of the coordinate, which is 0 where the prop is placed; both or none
            [rad or m]
        damping: [N m s/rad or N s/m]
        stiffness: of a spring: effort = stiffness (rest - coordinate); the spring of a ball turns
            it back to its placement [N m/rad or N/m]
        rest: of the spring [rad or m]
    """

    kind: PropJointKind = field(metadata=key())
    on: str = field(metadata=key(default="world"))
    point: Array = field(default_factory=_origin, metadata=key("length", size=3))
    axis: Array = field(
        default_factory=_origin,
        metadata=key(form="direction", of=("hinge", "slide"), default=_upward),
    )
    lower: float = field(default=-np.inf, metadata=key("angle", "length", of=("hinge", "slide")))
    upper: float = field(default=np.inf, metadata=key("angle", "length", of=("hinge", "slide")))
    damping: float = field(
        default=0.0, metadata=key("angular damping", "linear damping", least=0.0)
    )
    stiffness: float = field(
        default=0.0, metadata=key("angular stiffness", "linear stiffness", least=0.0)
    )
    rest: float = field(default=0.0, metadata=key("angle", "length", of=("hinge", "slide")))


@dataclass(frozen=True, eq=False)
class Prop:
    """A body that stands in the world, or one that lies there until something moves it.

    Attributes:
        name: its name
        pose: T_world_prop, where a movable one begins (4, 4)
        shapes: what it looks like and collides with
        movable: None of one that stands still
        joint: of a movable prop; None: it is free
        script: path of the Python file whose `before_step` is called, "" for none
        needle: its dimensions, where it is a curved needle
        tissue: soft halves of a pad with a wound between them, where it is tissue
        thread: where it is a thread: `shapes` has its first link
    """

    name: str
    pose: Array
    shapes: tuple[Shape, ...]
    movable: Movable | None = None
    joint: PropJoint | None = None
    script: str = ""
    needle: Needle | None = None
    tissue: Tissue | None = None
    thread: ChainThread | None = None


@dataclass(frozen=True, eq=False)
class Band:
    """An elastic band through points of props; it pulls and never pushes.

    Attributes:
        name: of the band
        points: (prop, point in its frame (3,) [m]) of each, in the order of the band
        rest_length: the length up to which it is slack [m]
        stiffness: tension per length beyond that [N/m]
        damping: tension per speed of the length, also while it is slack [N s/m]
        radius: of its drawing [m]
        material: of its drawing
    """

    name: str = field(metadata=key(form="name"))
    points: tuple[tuple[str, Array], ...]
    rest_length: float = field(metadata=key("length", above=0.0))
    stiffness: float = field(metadata=key("linear stiffness", above=0.0))
    damping: float = field(metadata=key("linear damping", least=0.0, default=0.0))
    radius: float = field(metadata=key("length", above=0.0, default=BAND_RADIUS_M))
    material: str = field(metadata=key(choices=tuple(MATERIALS), default="accent"))


@dataclass(frozen=True, eq=False)
class BandPoint:
    """Keys of a point of an elastic band.

    Attributes:
        prop: that has the point
        xyz: in the prop's frame, (3,) [m]
    """

    prop: str = field(metadata=key())
    xyz: Array = field(default_factory=_origin, metadata=key("length", size=3))


@dataclass(frozen=True, eq=False)
class RigDescription:
    """A rig: arms with their bases, props, poses, sensors, masters' pairs and cameras.

    Attributes:
        name, title, source, file: its identification
        arms: carriers before what they carry
        props: bodies that stand in the world, and those that can be moved
        poses: {pose: {arm: q (n,)}}; "start" has every arm
        test_share: share of the test trajectory's amplitude at which the arms do not meet; they
            then swing about the pose "test"
        display: the stereo display's pose in the world, (4, 4), None without a console
        sensors: those that `World.sensor` reads, in the order of the file
        teleops: pairs of a master and the arm that it moves, in the order of the file
        cameras: those of `World.cameras`, in the order of the file
        reference_arm: arm on setup joints whose tip frame the poses of the others are in
        bands: elastic bands between props
        extension: path of the Python file whose `extend_spec` adds to the model, "" for none
        grasp: how a jaw holds a free prop: by the friction of its pads alone; by "friction+stick",
            which does not creep and lets go where friction would; or "attach", which lets go when
            the jaw opens
        errors: by which readings of the robots differ from the truth, None for none
        dynamics: of arms whose overlays have none: "identified", from recordings of real arms
            where there are any for the kind of arm, or "cad", masses and friction as described
        surroundings: drawn about its tissue: nothing more than the rig's "table", or a body's
            "cavity", which touches nothing
    """

    name: str
    title: str
    source: str
    file: str
    arms: tuple[RigArm, ...]
    props: tuple[Prop, ...]
    poses: Mapping[str, Mapping[str, Array]]
    test_share: float = 1.0
    display: Array | None = None
    sensors: tuple[SensorDescription, ...] = ()
    teleops: tuple[TeleopDescription, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    reference_arm: str = REFERENCE_ARM
    bands: tuple[Band, ...] = ()
    extension: str = ""
    grasp: GraspKind = "friction+stick"
    errors: RobotErrors | None = None
    dynamics: DynamicsKind = "identified"
    surroundings: Surroundings = "table"

    @property
    def setup_joints(self) -> tuple[str, ...]:
        """The arm that each of the setup joints was made for: "PSM1" of SUJ_PSM1."""
        return tuple(a.name.removeprefix("SUJ_") for a in self.arms if a.arm.type == "SUJ")

    @property
    def tissue(self) -> Prop | None:
        """The first prop of tissue: soft, or of the material "tissue"."""
        for prop in self.props:
            if prop.tissue is not None or any(s.material == TISSUE for s in prop.shapes):
                return prop
        return None

    @property
    def objects(self) -> tuple[Prop, ...]:
        """The props that can be moved, in the order of the file."""
        return tuple(prop for prop in self.props if prop.movable is not None)

    def arm(self, name: str) -> RigArm:
        """Return the arm called `name`.

        Raises:
            UnknownNameError: no such arm; the known ones are listed
        """
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise UnknownNameError("arm", name, (a.name for a in self.arms), f"rig {self.name}")

    def pose_frame(self, name: str, reference_arm: str) -> str:
        """Return the name of the frame that the poses of an arm are in.

        The arm's `base_frame`, if it has one. Setup joints and the arms that they carry: the tip
        of the arm on the setup joints of `reference_arm`; the cart for these joints and this arm,
        and for all where the rig has no such arm. Source: the dVRK's
        mtsIntuitiveResearchKitSUJ.cpp, update_forward_kinematics. Otherwise the ECM's tip for a
        PSM, the stereo display for an MTM, and the arm's own frame without these.
        """
        arm = self.arm(name)
        if arm.base_frame is not None:
            return arm.base_frame.name
        setup = name if arm.arm.type == "SUJ" else arm.on
        if setup and self.arm(setup).arm.type == "SUJ":
            reference = f"SUJ_{reference_arm}"
            tip = next((a.name for a in self.arms if a.on == reference), CART)
            return CART if setup == reference else tip
        if arm.arm.type == "PSM":
            return next((a.name for a in self.arms if a.arm.type == "ECM"), arm.own_frame)
        return DISPLAY if arm.arm.type == "MTM" and self.display is not None else arm.own_frame

"""Drake reads the SDF of every arm and rig and has links, masses and limits where we have them.

Drake rejects joints that close a loop, so each of the file's is replaced by a ball at its pose.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.records import RigDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.export import export
from trocar.formats.links import LinkModel, rig_links
from trocar.formats.sdf import joint_name, sdf
from trocar.kinematics.forward import coordinates, poses
from trocar.modeling.geoms import contact_masks

pydrake = pytest.importorskip("pydrake.all", reason="pydrake is not installed (extra: judges)")
etree = pytest.importorskip("lxml.etree", reason="lxml is not installed (extra: export)")

Array = NDArray[np.float64]
ARMS = names("arms")
#: Both sides multiply about twenty matrices of size 1.
AGREED = 1e-9
#: Drake's solver stops when loops gape by some 1e-8 m; what is asked of exports is this.
SOLVED = 1e-6


@dataclass(frozen=True, eq=False)
class Reading:
    """A file as Drake has it, and the balls in place of its loop joints."""

    model: LinkModel
    plant: Any
    context: Any
    balls: tuple[tuple[Any, Array, Any, Array], ...]

    @staticmethod
    def of(model: LinkModel, version: str = "1.9") -> Reading:
        root = etree.fromstring(sdf(model, version))
        closing = [_taken(root, joint_name(loop.name)) for loop in model.loops]
        for gear in root.xpath("//joint[@type='gearbox']"):
            gear.getparent().remove(gear)
        plant = pydrake.MultibodyPlant(0.001)
        plant.set_discrete_contact_approximation(pydrake.DiscreteContactApproximation.kSap)
        parser = pydrake.Parser(plant)
        parser.SetStrictParsing()  # a warning is an error
        parser.AddModelsFromString(etree.tostring(root).decode(), "sdf")
        plant.Finalize()
        context = plant.CreateDefaultContext()
        balls = tuple(_ball(plant, context, joint) for joint in closing)
        return Reading(model, plant, context, balls)

    def move(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            joint = self.plant.GetJointByName(joint_name(name))
            at = value - self.model.zero[name]
            (joint.set_angle if joint.type_name() == "revolute" else joint.set_translation)(
                self.context, at
            )

    def pose(self, frame: str) -> Array:
        found = self.plant.GetFrameByName(frame).CalcPoseInWorld(self.context)
        return found.GetAsMatrix4()

    def gaps(self) -> list[float]:
        def at(frame: Any, point: Array) -> Array:
            return frame.CalcPoseInWorld(self.context).multiply(point)

        return [
            float(np.linalg.norm(at(a, point_a) - at(b, point_b)))
            for a, point_a, b, point_b in self.balls
        ]

    def lean(self) -> float:
        """Return the angle between the axes of a loop's hinge on its two sides [rad]."""
        axes = [
            (a.CalcPoseInWorld(self.context), b.CalcPoseInWorld(self.context))
            for a, _, b, _ in self.balls
        ]
        cross = [np.cross(a.rotation().col(2), b.rotation().col(2)) for a, b in axes]
        return max((float(np.linalg.norm(c)) for c in cross), default=0.0)


def _taken(root: Any, name: str) -> Any:
    (joint,) = root.xpath(f"//joint[@name='{name}']")
    joint.getparent().remove(joint)
    return joint


def _ball(plant: Any, context: Any, joint: Any) -> tuple[Any, Array, Any, Array]:
    pose = joint.find("pose")
    assert pose.get("relative_to") == joint.findtext("parent")
    a = plant.GetFrameByName(joint.findtext("parent"))
    b = plant.GetFrameByName(joint.findtext("child"))
    point = np.array([float(word) for word in pose.text.split()[:3]])
    world = a.CalcPoseInWorld(context).multiply(point)
    return a, point, b, b.CalcPoseInWorld(context).inverse().multiply(world)


def hinged(model: LinkModel) -> bool:
    """Return whether every loop of the file closes by a hinge."""
    root = etree.fromstring(sdf(model))
    kinds = {
        root.xpath(f"//joint[@name='{joint_name(loop.name)}']/@type")[0] for loop in model.loops
    }
    return kinds <= {"revolute"}


def own_values(rig: RigDescription, model: LinkModel, q: dict[str, Array]) -> dict[str, float]:
    """Return every joint's coordinate with the loops closed."""
    found: dict[str, float] = {}
    for place in rig.arms:
        mechanism = place.arm.mechanism
        at = coordinates(mechanism, q[place.name])
        for joint in model.joints:
            if joint.arm == place.name and joint.hinge is not None:
                found[joint.name] = float(at[mechanism.frame_index[joint.frame]])
    return found


def own_poses(rig: RigDescription, q: dict[str, Array]) -> dict[str, Array]:
    """Return the pose in the world of every frame, by our kinematics."""
    found: dict[str, Array] = {}
    for place in rig.arms:
        arm = place.arm
        mount = found[f"{place.on}_{place.frame}"] if place.on else np.eye(4)
        for frame, pose in poses(arm.mechanism, q[place.name], arm.root).items():
            found[f"{place.name}_{frame}"] = mount @ place.pose @ pose
    return found


def agree(rig: RigDescription, reading: Reading, q: dict[str, Array]) -> None:
    reading.move(own_values(rig, reading.model, q))
    expected = own_poses(rig, q)
    for link in reading.model.links[1:]:
        if link.frame and link.name in expected:
            assert np.abs(reading.pose(link.name) - expected[link.name]).max() < AGREED, link.name
    for place in rig.arms:
        tip = f"{place.name}_{place.arm.mechanism.tip}"
        assert np.abs(reading.pose(tip) - expected[tip]).max() < AGREED
    assert max(reading.gaps(), default=0.0) < AGREED
    assert reading.lean() < AGREED or not hinged(reading.model)


@pytest.mark.parametrize("version", ["1.9", "1.7", "1.11"])
@pytest.mark.parametrize("name", ARMS)
def test_drake_has_every_link_of_an_arm_where_our_kinematics_have_it(
    name, version, rng, random_positions
) -> None:
    rig = lone_arm_rig(load_arm(name))
    reading = Reading.of(rig_links(rig), version)
    for q in random_positions(rig.arms[0].arm, rng, 10):
        agree(rig, reading, {rig.arms[0].name: q})


@pytest.mark.parametrize("name", names("rigs"))
def test_drake_has_every_link_of_a_rig_where_our_kinematics_have_it(
    name, rng, random_positions
) -> None:
    rig = load_rig(name)
    reading = Reading.of(rig_links(rig))
    for _ in range(3):
        agree(rig, reading, {a.name: random_positions(a.arm, rng, 1)[0] for a in rig.arms})


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("kind", ["parallel_overlay", "skew_overlay"])
@pytest.mark.parametrize("version", ["1.9", "1.7"])
def test_the_loops_of_a_calibrated_arm_are_exact(
    name, kind, version, request, rng, random_positions
) -> None:
    overlay = request.getfixturevalue(kind)(name, rng)
    rig = lone_arm_rig(load_arm(name, calibration=overlay))
    model = rig_links(rig)
    off = max(abs(value) for value in model.zero.values())
    assert (off > 1e-4) == (kind == "skew_overlay")  # whose loops are no parallelograms
    reading = Reading.of(model, version)
    for q in random_positions(rig.arms[0].arm, rng, 10):
        agree(rig, reading, {rig.arms[0].name: q})


@pytest.mark.parametrize("kind", ["drawn", "skew_overlay"])
def test_drake_closes_the_loops_of_the_file_by_itself_as_our_kinematics_do(
    kind, request, rng, random_positions
) -> None:
    overlay = None if kind == "drawn" else request.getfixturevalue(kind)("psm", rng)
    rig = lone_arm_rig(load_arm("psm", calibration=overlay))
    reading = Reading.of(rig_links(rig))
    for q in random_positions(rig.arms[0].arm, rng, 3):
        by_name = {rig.arms[0].name: q}
        known = own_values(rig, reading.model, by_name)
        passive = [j.name for j in reading.model.joints if j.in_loop]
        reading.move(known | {n: known[n] + 0.02 for n in passive if "pin" not in n})
        assert max(reading.gaps()) > 1e-3
        _solve(reading, passive)
        assert max(reading.gaps()) < SOLVED
        for frame, pose in own_poses(rig, by_name).items():
            if reading.plant.HasFrameNamed(frame):
                assert np.abs(reading.pose(frame) - pose)[:3].max() < SOLVED, frame


def _solve(reading: Reading, passive: list[str]) -> None:
    """Close the loops with Drake's inverse kinematics, the other joints held."""
    plant, context = reading.plant, reading.context
    program = pydrake.InverseKinematics(plant, context, with_joint_limits=False)
    for a, point_a, b, point_b in reading.balls:
        program.AddPositionConstraint(a, point_a, b, point_b, point_b)  # in b's frame
    q, start = program.q(), plant.GetPositions(context)
    free = {plant.GetJointByName(joint_name(n)).position_start() for n in passive}
    held = [k for k in range(len(start)) if k not in free]
    program.prog().AddBoundingBoxConstraint(start[held], start[held], q[held])
    options = pydrake.SolverOptions()
    snopt = pydrake.SnoptSolver()
    options.SetOption(snopt.id(), "Major feasibility tolerance", 1e-12)
    result = snopt.Solve(program.prog(), start, options)
    plant.SetPositions(context, result.GetSolution(q))


@pytest.mark.parametrize("name", ARMS)
def test_drake_has_our_masses_inertias_limits_dampings_and_springs(name) -> None:
    model = rig_links(lone_arm_rig(load_arm(name)))
    plant = Reading.of(model).plant
    for link in model.links:
        if link.mass:
            inertia = plant.GetBodyByName(link.name).default_spatial_inertia()
            about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
            assert inertia.get_mass() == link.mass
            assert np.abs(inertia.get_com() - link.com).max() < 1e-15
            worst = np.abs(about_com.CopyToFullMatrix3() - link.inertia).max()
            assert worst < 1e-12 * (1.0 + np.abs(link.inertia).max())
    for joint in model.joints:
        if joint.hinge is None or joint.in_loop:
            continue
        found = plant.GetJointByName(joint_name(joint.name))
        lower = max(joint.lower, joint.hinge.lower)
        assert found.position_lower_limits()[0] == lower
        assert found.position_upper_limits()[0] == min(joint.upper, joint.hinge.upper)
        assert found.velocity_upper_limits()[0] == joint.velocity
        assert found.default_damping_vector()[0] == joint.hinge.damping
        (actuator,) = (
            plant.get_joint_actuator(k)
            for k in plant.GetJointActuatorIndices()
            if plant.get_joint_actuator(k).joint().name() == found.name()
        )
        assert actuator.effort_limit() == joint.effort
        assert actuator.default_rotor_inertia() == joint.hinge.armature


def test_joints_that_only_a_loop_moves_have_no_motor_in_drake() -> None:
    plant = Reading.of(rig_links(lone_arm_rig(load_arm("psm")))).plant
    driven = {plant.get_joint_actuator(k).joint().name() for k in plant.GetJointActuatorIndices()}
    assert "PSM1_pitch_joint" in driven
    assert not driven & {"PSM1_pitch_front_joint", "PSM1_pitch_end_joint"}


def test_drake_couples_the_counterweight_and_the_second_finger() -> None:
    plant = Reading.of(rig_links(lone_arm_rig(load_arm("psm")))).plant
    assert plant.num_constraints() == 2


@pytest.mark.parametrize("name", ["full_cart", "psm"])
def test_the_same_links_touch_in_drake_as_in_our_simulation(name, tmp_path) -> None:
    rig = load_rig(name)
    export(rig, "sdf", tmp_path / name)
    tree = etree.parse(tmp_path / name / "model.sdf")
    for loop in rig_links(rig).loops:
        _taken(tree.getroot(), joint_name(loop.name))
    tree.write(tmp_path / name / "open.sdf")
    builder = pydrake.DiagramBuilder()
    plant, scene = pydrake.AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = pydrake.Parser(plant)
    parser.SetStrictParsing()  # shapes, materials and meshes are read as well
    parser.AddModels(str(tmp_path / name / "open.sdf"))
    plant.Finalize()
    inspector = scene.model_inspector()
    pairs = {
        tuple(sorted(_arm(plant.GetBodyFromFrameId(inspector.GetFrameId(g)).name()) for g in pair))
        for pair in inspector.GetCollisionCandidates()
    }
    masks = contact_masks(rig)
    touching = {link.arm for link in rig_links(rig).links for s in link.shapes if s.collide}
    expected = {
        (a, b)
        for a in touching
        for b in touching
        if a <= b and masks[a].contype & masks[b].conaffinity
    }
    assert pairs == expected


def _arm(link: str) -> str:
    """Return the arm that a link of a rig belongs to, "" for what stands in the world."""
    if link == "ground":
        return ""
    return re.match(r"(SUJ_)?[A-Z]+[0-9]?", link)[0]  # type: ignore[index]

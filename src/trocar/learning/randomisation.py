"""Randomised worlds: gains, friction, objects, robot errors and cameras, drawn at resets."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.keys import key
from trocar.descriptions.robot_errors import LONGEST_LATENCY_S, PERFECT, robot_errors
from trocar.descriptions.scenes import Goal, Scene
from trocar.descriptions.table import read_table
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import inverse, transform, translation
from trocar.learning.readings import SceneReadings
from trocar.rendering import Look
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.parts import Attached, Part, steps_in
from trocar.simulation.world import World
from trocar.tasks import Task
from trocar.tasks.controller import PERIOD_S, TipController
from trocar.tasks.registry import make_task

Array = NDArray[np.float64]

PRESETS = Path(__file__).with_suffix(".toml")
NONE = "none"
#: Source of the tips that a policy observes: encoders, or encoders corrected by a camera.
TipSource = Literal["robot", "camera"]
TIP_SOURCES: tuple[TipSource, ...] = ("robot", "camera")
#: Name of the randomisation among the parts of a world.
PART = "randomisation"
#: Fields of MjModel that a randomisation writes.
FIELDS = (
    "body_mass",
    "body_inertia",
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
    "geom_friction",
    "pair_friction",
    "dof_frictionloss",
    "dof_damping",
    "tendon_frictionloss",
    "tendon_damping",
)
#: Images of a tip are taken this often, and the median of the last few corrects the encoders.
#: Source: docs/vision.md, registration of instruments: 25 images a second, five of them. [s]
IMAGE_S, IMAGES = 0.04, 5
#: Least ratio that is drawn, of friction that a file spreads by more than 1. Source: our own
#: choice.
LEAST_RATIO = 0.05


@dataclass(frozen=True)
class Randomisation:
    """Spreads of what differs between a simulated and a real setup.

    Spreads of ratios are half their range about 1; others are standard deviations along or about
    each axis.

    Attributes:
        errors: preset of the robots' errors; "": the scene's own
        gains: ratio of each joint's servo gains, as its motor's effort per ampere differs
        dry, viscous: ratio of each joint's friction
        object_mass, object_friction: ratio of each object's
        object_bias, object_bias_turn: error of an object's observed pose that lasts an episode
            [m], [rad]
        object_noise, object_noise_turn: of its error in each period of 20 ms [m], [rad]
        tip_bias, tip_noise: of a tip in the camera, as for objects; of `tips="camera"` [m]
        vision_age: age of observed objects and of corrections of tips, in periods of 20 ms [s]
        camera, camera_turn: of the pose from which images are taken [m], [rad]
        exposure: of images [stops]
        colour_noise: of images, share of white
    """

    errors: str = field(default="", metadata=key())
    gains: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    dry: float = field(default=0.0, metadata=key(least=0.0))
    viscous: float = field(default=0.0, metadata=key(least=0.0))
    object_mass: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    object_friction: float = field(default=0.0, metadata=key(least=0.0, most=0.9))
    object_bias: float = field(default=0.0, metadata=key("length", least=0.0))
    object_bias_turn: float = field(
        default=0.0, metadata=key("angle", name="object_bias", least=0.0)
    )
    object_noise: float = field(default=0.0, metadata=key("length", least=0.0))
    object_noise_turn: float = field(
        default=0.0, metadata=key("angle", name="object_noise", least=0.0)
    )
    tip_bias: float = field(default=0.0, metadata=key("length", least=0.0))
    tip_noise: float = field(default=0.0, metadata=key("length", least=0.0))
    vision_age: float = field(
        default=0.0, metadata=key("time", least=0.0, most=LONGEST_LATENCY_S, shown="s")
    )
    camera: float = field(default=0.0, metadata=key("length", least=0.0))
    camera_turn: float = field(default=0.0, metadata=key("angle", name="camera", least=0.0))
    exposure: float = field(default=0.0, metadata=key(least=0.0, most=5.0))
    colour_noise: float = field(default=0.0, metadata=key(least=0.0, most=0.5))


def read_randomisation(name: str | Path) -> Randomisation:
    """Return a preset ("none", "lab" or "wide"), or the randomisation of a TOML file.

    A file has the keys of `Randomisation` with units, and optionally `preset`, the name of a
    preset that they replace values of.

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        DescriptionError: a broken file; file, key, got and allowed are named
    """
    if not str(name).endswith(".toml"):
        table = read_table(PRESETS).without("schema", "source")
        known = NONE, *table.entries()
        if name not in known:
            raise UnknownNameError("randomisation", str(name), (*known, "FILE.toml"))
        return Randomisation() if name == NONE else table.table(str(name)).record(Randomisation)
    table = read_table(Path(name)).without("schema", "source")
    base = Randomisation()
    if "preset" in table:
        try:
            base = read_randomisation(table.text("preset"))
        except UnknownNameError as problem:
            raise table.fail("preset", str(problem)) from problem
    found = table.record(
        Randomisation, defaults={f.name: getattr(base, f.name) for f in fields(base)}
    )
    table.done()
    try:
        robot_errors(found.errors or PERFECT)
    except UnknownNameError as problem:
        raise table.fail("errors", str(problem)) from problem
    return found


def with_errors(scene: Scene | str | Path, errors: str) -> Scene:
    """Return a scene whose robots have errors of a preset: "perfect", "lab" or "wide".

    Arms that stand still are not welded then, as their encoders have errors as well.

    Raises:
        UnknownNameError: no such scene or preset; the known ones are listed
    """
    found = scene if isinstance(scene, Scene) else load_scene(scene)
    preset = robot_errors(errors)
    welded = found.welded if preset is None else ()
    return replace(found, rig=replace(found.rig, errors=preset), welded=welded)


def randomised_task(
    scene: Scene | str | Path,
    randomisation: Randomisation | str | Path = "lab",
    *,
    tips: TipSource = "robot",
) -> Task:
    """Return the task of a scene in a world that each reset draws anew, after a reset with seed 0.

    With "none" and tips of the robot it is `make_task`, bit for bit. Success is judged by true
    poses; `Task.observation` has tips as the robot reports them, and `read_varied` objects as
    cameras see them, too.

    Args:
        scene: a scene, its name, or the path of its TOML file
        randomisation: a preset, the path of a TOML file, or the spreads
        tips: "robot": by encoders and registration; "camera": corrected by images of the tips

    Raises:
        UnknownNameError, DescriptionError: as `read_randomisation` and `make_task`
        InputError: other tips
    """
    if tips not in TIP_SOURCES:
        raise InputError(f"tips: got {tips!r}; allowed: {', '.join(TIP_SOURCES)}")
    spreads = (
        randomisation
        if isinstance(randomisation, Randomisation)
        else read_randomisation(randomisation)
    )
    task = make_task(with_errors(scene, spreads.errors) if spreads.errors else scene)
    if spreads != Randomisation() or tips != "robot":
        task.world.add(PART, RandomisedWorld(spreads, task.world, task.controller, tips))
        task.reset(0)
    return task


def randomised_world(task: Task) -> RandomisedWorld | None:
    """Return the randomisation of a task's world, None where it has none."""
    part = task.world.parts.get(PART)
    return part if isinstance(part, RandomisedWorld) else None


class RandomisedWorld(Part):
    """Draws a world's gains, friction, objects and cameras at each reset, from its seed.

    Everything starts from the values of the compiled model, so that a reset depends on its seed
    alone, and each quantity has random numbers of its own: a spread does not move the others.

    Tips are registered (`TipController.registration`): by the registration errors of the robots,
    and with tips="camera" by the median of the last five images' corrections, which are
    translations: true less measured place of the tip, with bias, noise and age.

    Args:
        randomisation: spreads
        world: its own, to which it is added
        controller: of the task
        tips: source of the tips that a policy observes

    Attributes:
        randomisation, tips: as given
        seed: of the last draw
        gains: ratio of each joint's, (J,)
        camera: pose of the camera in its nominal frame, (4, 4)
    """

    def __init__(
        self,
        randomisation: Randomisation,
        world: World,
        controller: TipController,
        tips: TipSource = "robot",
    ) -> None:
        self.randomisation, self.tips = randomisation, tips
        self._world, self._controller = world, controller
        self.seed, self.camera, self.gains = 0, np.eye(4), np.ones(0)
        arms = world.arms
        self._psms = tuple(a for a in controller.arms if arms[a].description.type == "PSM")
        self._bases: dict[str, Array] = {}
        self._bias: dict[str, Array] = {}
        self._images: dict[str, deque[Array]] = {}
        self._rng = np.random.default_rng(0)
        self._age = round(randomisation.vision_age / IMAGE_S)

    # ------------------------------------------------------------------ as a part

    def attach(self, physics: Attached) -> None:
        """Take the physics, with nominal values as compiled."""
        self._physics = physics
        self._nominal = {name: getattr(physics.model, name).copy() for name in FIELDS}
        if self.tips == "camera":
            self.every = steps_in(IMAGE_S, physics.timestep)
        dry, viscous = physics.servos.friction  # brakes may hold in the model now
        self._nominal |= {"dof_frictionloss": dry, "dof_damping": viscous}

    def placed(self, arm: str) -> None:
        """Draw everything after a reset."""
        if arm:
            return
        self.seed = self._physics.seed()
        self._draw()
        self._write()
        self._register()

    def look(self) -> None:
        """Take an image of the tips and correct the encoders by it."""
        self._take_images()
        self._correct()

    def save(self) -> dict[str, Any]:
        """Return what was drawn, and the images of tips."""
        return {
            "seed": self.seed,
            "images": {arm: [one.copy() for one in row] for arm, row in self._images.items()},
            "random": self._rng.bit_generator.state,
            "registration": {a: T.copy() for a, T in self._controller.registration.items()},
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Draw as the seed of what `save` returned does, and go on from its images."""
        self.seed = state["seed"]
        self._draw()
        self._write()
        self._register()
        for arm, row in state["images"].items():
            self._images[arm].clear()
            self._images[arm].extend(one.copy() for one in row)
        self._rng.bit_generator.state = state["random"]
        self._controller.registration.clear()
        self._controller.registration.update(
            {a: T.copy() for a, T in state["registration"].items()}
        )

    # ------------------------------------------------------------------ images

    def look_of(self, look: Look) -> Look:
        """Return settings of an image with the exposure and the noise of this episode."""
        spread = self.randomisation
        rng = stream(self.seed, "look")
        stops = spread.exposure * rng.standard_normal()
        exposure = look.exposure
        if stops and not isinstance(exposure, str):
            exposure = float(np.clip(exposure + stops, -20.0, 20.0))
        noise = max(look.noise, spread.colour_noise)
        return replace(look, exposure=exposure, noise=noise, seed=int(rng.integers(2**31 - 1)))

    def seen_from(self, camera: CameraRecord) -> CameraRecord:
        """Return a camera where it is in this episode."""
        return replace(camera, T_body_mount=camera.T_body_mount @ self.camera)

    # ------------------------------------------------------------------ inside

    def _draw(self) -> None:
        """Draw everything from the seed."""
        spread, seed, physics = self.randomisation, self.seed, self._physics
        model, nominal = physics.model, self._nominal
        self._fields = {name: values.copy() for name, values in nominal.items()}
        names = physics.joints.names
        self.gains = np.array(
            [_ratio(stream(seed, f"gains {name}"), spread.gains) for name in names]
        )
        for field_, width in (("frictionloss", spread.dry), ("damping", spread.viscous)):
            for kind in ("dof", "tendon"):
                values = self._fields[f"{kind}_{field_}"]
                rng = stream(seed, f"{kind} {field_}")
                values *= [_ratio(rng, width) for _ in values]
        for name in self._world.objects:
            mass = _ratio(stream(seed, f"mass {name}"), spread.object_mass)
            slip = _ratio(stream(seed, f"friction {name}"), spread.object_friction)
            self._scale_object(model, name, mass, slip)
        rng = stream(seed, "camera")
        turn, place = spread.camera_turn * rng.standard_normal(3), rng.standard_normal(3)
        self.camera = transform(matrix_from_rotation_vector(turn), spread.camera * place)
        self._rng = stream(seed, "tips")
        self._bias = {arm: spread.tip_bias * self._rng.standard_normal(3) for arm in self._psms}

    def _scale_object(self, model: Any, name: str, mass: float, slip: float) -> None:
        """Scale an object's masses and friction in the fields.

        Args:
            model: MjModel
            name: of a movable object
            mass, slip: ratios
        """
        own, nominal = self._fields, self._nominal
        root = model.body(name).id
        bodies = [root]
        for body in range(root + 1, model.nbody):
            if model.body_parentid[body] in bodies:
                bodies.append(body)
        dofs = np.flatnonzero(np.isin(model.dof_bodyid, bodies))
        for field_, rows, ratio in (
            ("body_mass", bodies, mass),
            ("body_inertia", bodies, mass),
            ("body_subtreemass", bodies, mass),
            ("dof_M0", dofs, mass),
            ("body_invweight0", bodies, 1.0 / mass),
            ("dof_invweight0", dofs, 1.0 / mass),
        ):
            own[field_][rows] = ratio * nominal[field_][rows]
        above = int(model.body_parentid[root])
        while True:
            own["body_subtreemass"][above] += (mass - 1.0) * nominal["body_subtreemass"][root]
            if above == 0:
                break
            above = int(model.body_parentid[above])
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
        own["geom_friction"][geoms] = slip * nominal["geom_friction"][geoms]
        touching = np.isin(model.pair_geom1, geoms) | np.isin(model.pair_geom2, geoms)
        own["pair_friction"][touching] = slip * nominal["pair_friction"][touching]

    def _write(self) -> None:
        """Write what was drawn into the model and the servos."""
        model, servos = self._physics.model, self._physics.servos
        for name, values in self._fields.items():
            if not name.startswith("dof_f") and name != "dof_damping":
                getattr(model, name)[:] = values
        servos.set_friction(self._fields["dof_frictionloss"], self._fields["dof_damping"])
        servos.gains[:] = self._physics.joints.gains * self.gains[:, None]
        servos.apply()

    def _register(self) -> None:
        """Register the tips by the errors of the robots, and by first images of them."""
        registration = self._controller.registration
        registration.clear()
        self._bases = {}
        errors = self._physics.servos.errors
        if errors is not None and errors.registration:
            scopes = [c for c in self._world.cameras().values() if c.kind == "endoscope"]
            T = scopes[0].T_world_camera if scopes else np.eye(4)
            reported = {a: R for a, R in errors.registration.items() if a in self._psms}
            self._bases = {arm: T @ R @ inverse(T) for arm, R in reported.items()}
        registration.update(self._bases)
        if self.tips == "camera":
            self._images = {arm: deque(maxlen=IMAGES + self._age) for arm in self._psms}
            for _ in range(IMAGES):
                self._take_images()
            self._correct()

    def _take_images(self) -> None:
        """Measure the true places of the tips less those that encoders and registration report.

        Both of one moment: images are compared with the joints of their stamp, so that the age of
        readings does not enter.
        """
        errors, rows = self._physics.servos.errors, self._physics.joints.arms
        for name in self._psms:
            arm, true = self._world.arms[name], self._world.true_state(name)
            q = true.q if errors is None else true.q + errors.error[rows[name].rows]
            local = arm.local.forward_kinematics(q[: arm.description.own_joints]).matrix
            T = self._bases.get(name, np.eye(4)) @ self._world.reference_pose(name) @ local
            noise = self.randomisation.tip_noise * self._rng.standard_normal(3)
            self._images[name].append(true.world[:3, 3] - T[:3, 3] + self._bias[name] + noise)

    def _correct(self) -> None:
        for arm, images in self._images.items():
            way = np.median(list(images)[:IMAGES], axis=0)
            base = self._bases.get(arm, np.eye(4))
            self._controller.registration[arm] = translation(way) @ base


class Sight:
    """Poses of objects of n worlds as cameras see them: with bias, noise and age.

    Args:
        randomisation: spreads
        goals: of the scene, without those on hidden objects, in the order of the readings
        n: number of worlds

    The true readings go in once in every period of 20 ms; white noise is drawn then.
    """

    def __init__(self, randomisation: Randomisation, goals: Sequence[Goal], n: int = 1) -> None:
        self.randomisation, self._goals, self._n = randomisation, tuple(goals), n
        self._age = round(randomisation.vision_age / PERIOD_S)
        self._rngs = [np.random.default_rng(0) for _ in range(n)]
        self._bias: dict[str, Array] = {}
        self._past: deque[dict[str, Array]] = deque(maxlen=1 + self._age)
        self._begun = np.zeros(n, np.bool_)

    def begin(self, seeds: Sequence[int], which: Sequence[int] | None = None) -> None:
        """Draw the biases of worlds that were reset.

        Args:
            seeds: of their episodes
            which: their rows; all when omitted
        """
        for world, seed in zip(range(self._n) if which is None else which, seeds, strict=True):
            self._rngs[world] = stream(seed, "sight")
            self._begun[world] = False

    def observe(self, readings: SceneReadings) -> SceneReadings:
        """Return readings with the objects, and goals and places by them, as they are seen."""
        spread = self.randomisation
        fresh = np.flatnonzero(~self._begun)
        for name, poses in readings.objects.items():
            self._bias.setdefault(name, np.zeros((len(poses), 6)))
        for world in fresh:
            for bias in self._bias.values():
                bias[world] = self._rngs[world].standard_normal(6)
        self._begun[fresh] = True
        now = {name: poses.copy() for name, poses in readings.objects.items()}
        for past in self._past:
            for name, poses in past.items():
                poses[fresh] = now[name][fresh]
        self._past.append(now)
        objects: dict[str, Array] = {}
        scale = np.repeat([spread.object_bias, spread.object_bias_turn], 3)
        noisy = np.repeat([spread.object_noise, spread.object_noise_turn], 3)
        for name, poses in self._past[0].items():
            error = scale * self._bias[name]
            if noisy.any():
                error = error + noisy * np.array([r.standard_normal(6) for r in self._rngs])
            turn = matrix_from_rotation_vector(error[:, 3:]) @ matrix_from_quaternion(poses[:, 3:])
            place = poses[:, :3] + error[:, :3]
            objects[name] = np.concatenate([place, quaternion_from_matrix(turn)], axis=1)
        goals, achieved = readings.goals.copy(), readings.achieved.copy()
        for g, goal in enumerate(self._goals):
            if goal.object in objects:
                off = objects[goal.object][:, :3] - readings.objects[goal.object][:, :3]
                (goals if goal.arm and not goal.held else achieved)[:, g] += off
            if goal.on in objects:
                seen, true = objects[goal.on], readings.objects[goal.on]
                turn = matrix_from_quaternion(seen[:, 3:])
                back = matrix_from_quaternion(true[:, 3:]).swapaxes(1, 2)
                at = np.einsum("nij,nj->ni", back, goals[:, g] - true[:, :3])
                goals[:, g] = seen[:, :3] + np.einsum("nij,nj->ni", turn, at)
        return replace(readings, objects=objects, goals=goals, achieved=achieved)


def sight_of(task: Task) -> Sight | None:
    """Return the sight of a task's objects, None where it is perfect."""
    part = randomised_world(task)
    if part is None:
        return None
    hidden = task.scene.hidden
    return Sight(part.randomisation, [g for g in task.scene.goals if g.on not in hidden])


def stream(seed: int, name: str) -> np.random.Generator:
    """Return random numbers of one quantity of an episode."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def _ratio(rng: np.random.Generator, width: float) -> float:
    return max(LEAST_RATIO, 1.0 + width * rng.uniform(-1.0, 1.0))

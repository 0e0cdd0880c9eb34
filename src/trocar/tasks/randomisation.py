"""Randomised worlds: gains, friction, objects, robot errors and cameras, drawn at resets."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.randomisation import Randomisation, TipSource
from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.parts import Attached, Part, steps_in
from trocar.tasks.controller import PERIOD_S, TipController

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Fields of MjModel that a randomisation draws.
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
#: Of these, the ones that servos write, as brakes take their place.
BRAKED = ("dof_frictionloss", "dof_damping")
#: Images of a tip are taken this often, and the median of the last few corrects the encoders.
#: Source: docs/vision.md, tips of instruments: 25 images a second, five of them. [s]
IMAGE_S, IMAGES = 0.04, 5
#: Least ratio that is drawn, of friction that a file spreads by more than 1. Source: our own
#: choice.
LEAST_RATIO = 0.05


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random numbers of one quantity of an episode."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


class ModelDraws:
    """Draws fields of a world's model and gains of its servos, functions of a seed.

    Each quantity has random numbers of its own: a spread does not move what others draw.

    Args:
        randomisation: spreads
        world: whose model has the nominal values
    """

    def __init__(self, randomisation: Randomisation, world: World) -> None:
        self._spread, self._model = randomisation, world.mj_model
        self._names, self._gains = world.joints.names, world.joints.gains
        self._nominal: dict[str, Array] = {n: getattr(self._model, n).copy() for n in FIELDS}
        self._nominal |= dict(zip(BRAKED, world.servos.friction, strict=True))
        model = self._model
        names = [model.body(body).name for body in range(model.nbody)]
        self._bodies: dict[str, list[int]] = {}
        for name in world.objects:
            own = self._bodies[name] = [
                body for body, of in enumerate(names) if of == name or of.startswith(f"{name}/")
            ]
            for body in range(1, model.nbody):
                if model.body_parentid[body] in own and body not in own:
                    own.append(body)

    def gains(self, seed: int) -> Array:
        """Return gains P, I, D of each joint, (J, 3)."""
        width = self._spread.gains
        ratios = [_ratio(stream(seed, f"gains {name}"), width) for name in self._names]
        return self._gains * np.array(ratios)[:, None]

    def fields(self, seed: int) -> dict[str, Array]:
        """Return the fields of the model, {name of `FIELDS`: values}."""
        found = {name: values.copy() for name, values in self._nominal.items()}
        widths = {"frictionloss": self._spread.dry, "damping": self._spread.viscous}
        for field, width in widths.items():
            for kind in ("dof", "tendon"):
                rng = stream(seed, f"{kind} {field}")
                found[f"{kind}_{field}"] *= [_ratio(rng, width) for _ in found[f"{kind}_{field}"]]
        for name, bodies in self._bodies.items():
            mass = _ratio(stream(seed, f"mass {name}"), self._spread.object_mass)
            slip = _ratio(stream(seed, f"friction {name}"), self._spread.object_friction)
            self._scale(found, bodies, mass, slip)
        if self._spread.object_mass:
            subtree = found["body_subtreemass"]
            subtree[:] = found["body_mass"]
            for body in range(len(subtree) - 1, 0, -1):
                subtree[self._model.body_parentid[body]] += subtree[body]
        return found

    def _scale(self, fields: dict[str, Array], bodies: list[int], mass: float, slip: float) -> None:
        """Scale masses and friction of an object's bodies in fields, by ratios."""
        model = self._model
        dofs = np.flatnonzero(np.isin(model.dof_bodyid, bodies))
        for field, rows, ratio in (
            ("body_mass", bodies, mass),
            ("body_inertia", bodies, mass),
            ("dof_M0", dofs, mass),
            ("body_invweight0", bodies, 1.0 / mass),
            ("dof_invweight0", dofs, 1.0 / mass),
        ):
            fields[field][rows] *= ratio
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
        touching = np.isin(model.pair_geom1, geoms) | np.isin(model.pair_geom2, geoms)
        fields["geom_friction"][geoms] *= slip
        fields["pair_friction"][touching] *= slip


class RandomisedWorld(Part):
    """Draws a world's gains, friction, objects and cameras at each reset, from its seed.

    With tips="camera" the median of the last five images' corrections moves the measured tips
    (`TipController.correct`): true less measured places, with bias, noise and age.

    Args:
        randomisation: spreads
        tips: source of the tips that a policy observes
        world: its own, to which it is added
        controller: of the task

    Attributes:
        randomisation, tips: as given
        seed: of the last draw
        camera: pose from which images are taken in the camera's nominal frame, (4, 4)
        stops: by which images are brighter
        sight: of the objects
    """

    def __init__(
        self,
        randomisation: Randomisation,
        tips: TipSource,
        world: World,
        controller: TipController,
    ) -> None:
        self.randomisation, self.tips = randomisation, tips
        self._world, self._controller = world, controller
        self.seed, self.camera, self.stops = 0, np.eye(4), 0.0
        self.sight = Sight(randomisation, len(world.objects))
        arms = world.arms
        self._psms = tuple(a for a in controller.arms if arms[a].description.type == "PSM")
        self._bias: dict[str, Array] = {}
        self._images: dict[str, deque[Array]] = {}
        self._rng = np.random.default_rng(0)
        self._age = round(randomisation.vision_age / IMAGE_S)

    # ------------------------------------------------------------------ as a part

    def attach(self, physics: Attached) -> None:
        """Take the physics, with nominal values as compiled."""
        self._physics, self._draws = physics, ModelDraws(self.randomisation, self._world)
        if self.tips == "camera":
            self.every = steps_in(IMAGE_S, physics.timestep)

    def placed(self, arm: str) -> None:
        """Draw everything after a reset."""
        if arm:
            return
        self.seed = self._physics.seed()
        self.sight.begin([self.seed])
        self._draw()

    def start(self) -> None:
        """Take the first images, of objects and tips where they are now."""
        self.sight.forget()
        if self.tips == "camera":
            self._images = {arm: deque(maxlen=IMAGES + self._age) for arm in self._psms}
            for _ in range(IMAGES):
                self._take_images()
            self._correct()

    def look(self) -> None:
        """Take an image of the tips and correct the encoders by it."""
        self._take_images()
        self._correct()

    def aim(self, seed: int) -> None:
        """Draw the camera and the exposure of images of an episode."""
        spread, rng = self.randomisation, stream(seed, "camera")
        turn, place = rng.standard_normal((2, 3))
        turn = matrix_from_rotation_vector(spread.camera_turn * turn)
        self.camera = transform(turn, spread.camera * place)
        self.stops = spread.exposure * float(stream(seed, "exposure").standard_normal())

    def seen_from(self, camera: CameraRecord) -> CameraRecord:
        """Return a camera at the pose from which images are taken in this episode."""
        return replace(camera, T_body_mount=camera.T_body_mount @ self.camera)

    def save(self) -> dict[str, Any]:
        """Return the seed of the draws, and the images of tips."""
        return {
            "seed": self.seed,
            "images": {arm: [one.copy() for one in row] for arm, row in self._images.items()},
            "random": self._rng.bit_generator.state,
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Draw as the seed of what `save` returned does, and go on from its images."""
        self.seed = state["seed"]
        self._draw()
        self._controller.register()
        self._images = {
            arm: deque(row, maxlen=IMAGES + self._age) for arm, row in state["images"].items()
        }
        self._rng.bit_generator.state = state["random"]
        self._correct()

    # ------------------------------------------------------------------ inside

    def _draw(self) -> None:
        """Draw everything from the seed, and write it into the model and the servos."""
        spread, seed, servos = self.randomisation, self.seed, self._physics.servos
        fields = self._draws.fields(seed)
        for name, values in fields.items():
            if name not in BRAKED:
                getattr(self._physics.model, name)[:] = values
        servos.set_friction(*(fields[name] for name in BRAKED))
        servos.gains[:] = self._draws.gains(seed)
        servos.apply()
        self._rng = stream(seed, "tips")
        self._bias = {arm: spread.tip_bias * self._rng.standard_normal(3) for arm in self._psms}
        self.aim(seed)

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
            base = self._controller.bases.get(name, np.eye(4)) @ self._world.reference_pose(name)
            measured = (base @ local)[:3, 3]
            noise = self.randomisation.tip_noise * self._rng.standard_normal(3)
            self._images[name].append(true.world[:3, 3] - measured + self._bias[name] + noise)

    def _correct(self) -> None:
        for arm, images in self._images.items():
            self._controller.correct(arm, np.median(list(images)[:IMAGES], axis=0))


class Sight:
    """Poses of the objects of n worlds as cameras see them: with bias, noise and age.

    Args:
        randomisation: spreads
        objects: number of objects
        n: number of worlds
    """

    def __init__(self, randomisation: Randomisation, objects: int, n: int = 1) -> None:
        spread = randomisation
        self._bias_scale = np.repeat([spread.object_bias, spread.object_bias_turn], 3)
        self._noise_scale = np.repeat([spread.object_noise, spread.object_noise_turn], 3)
        self._rngs: list[np.random.Generator] = [np.random.default_rng(0)] * n
        self._bias = np.zeros((n, objects, 6))
        self._past = np.zeros((1 + round(spread.vision_age / PERIOD_S), n, objects, 7))
        self._fresh = np.ones(n, np.bool_)

    def forget(self, worlds: Sequence[int] | Index = (0,)) -> None:
        """Forget the past of worlds in which objects were placed anew, at rest."""
        self._fresh[np.asarray(worlds)] = True

    def begin(self, seeds: Sequence[int], worlds: Sequence[int] = (0,)) -> None:
        """Draw the biases of worlds that were reset, with the seeds of their episodes."""
        for world, seed in zip(worlds, seeds, strict=True):
            self._rngs[world] = stream(seed, "sight")
            self._bias[world] = self._rngs[world].standard_normal(self._bias[world].shape)
        self.forget(worlds)

    def see(self, poses: Array, worlds: Sequence[int] | Index = (0,)) -> Array:
        """Return poses as cameras see them; call it once in every period of 20 ms.

        Args:
            poses: position and quaternion wxyz of each object in each of these worlds, (k, O, 7)
            worlds: their numbers, (k,)
        """
        which: Index = np.asarray(worlds)
        self._past[1:, which] = self._past[:-1, which]
        self._past[0, which] = poses
        fresh = self._fresh[which]
        self._past[:, which[fresh]] = poses[fresh]
        self._fresh[which] = False
        error = self._bias_scale * self._bias[which]
        if self._noise_scale.any():
            white = np.empty_like(error)
            for row, world in enumerate(which.tolist()):
                rng: np.random.Generator = self._rngs[int(world)]
                white[row] = rng.standard_normal(white.shape[1:])
            error = error + self._noise_scale * white
        found = self._past[-1, which]
        found[..., :3] += error[..., :3]
        if error[..., 3:].any():
            turn = matrix_from_rotation_vector(error[..., 3:])
            turned = turn @ matrix_from_quaternion(found[..., 3:])
            found[..., 3:] = quaternion_from_matrix(turned)
        return found


def _ratio(rng: np.random.Generator, width: float) -> float:
    return max(LEAST_RATIO, 1.0 + width * rng.uniform(-1.0, 1.0))

"""Errors of encoder readings: offsets, backlash, cable hysteresis and stretch, noise, latency."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Mapping
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.robot_errors import JointErrors, RobotErrors
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform
from trocar.modeling.joints import INPUTS, JointTable

Array = NDArray[np.float64]

#: Errors and the history of late readings are renewed this often. Source: our own choice; every
#: millisecond would take three times as long as a PSM's physics. [s]
PERIOD_S = 0.005
#: Cables stretch with this time constant. Source: our own choice; above it they would add an
#: oscillation of their own to the servos'. [s]
STRETCH_S = 0.02
#: Potentiometers are read once in so many periods. Source: our own choice, as often as gravity
#: compensation is renewed.
NOISE_PERIODS = 4
#: Arrays that change with each step, and copies of which `save` returns.
SAVED = ("offset", "play", "slip", "stretch", "noise", "before", "setpoint")


class ReadingErrors:
    """Errors of all joints of a world; the reading of a joint = where it is + its error.

    The error of a joint whose set-point moves by d, and whose motor exerts u, each PERIOD_S:

        play <- clip(play + d, -backlash / 2, backlash / 2)
        slip <- clip(slip + d, -travel / 2, travel / 2)
        stretch <- stretch + (compliance u - stretch) PERIOD_S / STRETCH_S
        error = offset + play + slip hysteresis / travel + stretch + noise

    Servos bring the *reading* to the set-point, so that the joint is off by the error. Play and
    slip follow the set-point; a joint that is moved by hand keeps its own.

    Args:
        rig: the arms
        table: their joints
        model, data: the physics; of the latter `ctrl`, `qpos` and `qvel`
        errors: of the joints

    Attributes:
        every: physics steps in a period
        setpoint: position, velocity and effort fed forward, (J, 3), as for `Servos`
        error: reading - truth without the encoders' steps, (J,) [rad or m]
        registration: {arm: pose of the reported camera's frame in the true one, (4, 4)}
    """

    def __init__(
        self,
        rig: RigDescription,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData | SimpleNamespace,
        errors: RobotErrors,
    ) -> None:
        self._rig, self._table, self._data, self._errors = rig, table, data, errors
        self._ctrl = data.ctrl.reshape(len(table), INPUTS)
        self.every = max(1, round(PERIOD_S / float(model.opt.timestep)))
        self._stretched = min(1.0, self.every * float(model.opt.timestep) / STRETCH_S)
        self._arms = {arm.name: arm.arm.type for arm in rig.arms}
        of = [errors.of(arm, self._arms[arm], joint)
              for arm, _, joint in (name.partition("/") for name in table.names)]  # fmt: skip
        found = {f.name: np.array([getattr(e, f.name) for e in of]) for f in fields(JointErrors)}
        self._step, self._compliance = found["step"], found["compliance"]
        self._offset_sigma, self._noise_sigma = found["offset"], found["noise"]
        self._play, self._slip = found["backlash"] / 2.0, found["travel"] / 2.0
        self._share = found["hysteresis"] / np.where(found["travel"] > 0.0, found["travel"], 1.0)
        zeros = np.zeros(len(table))
        self.setpoint = np.zeros((len(table), INPUTS))
        self.error, self.offset, self.play = zeros.copy(), zeros.copy(), zeros.copy()
        self.slip, self.stretch, self.noise = zeros.copy(), zeros.copy(), zeros.copy()
        self.before = zeros.copy()
        self.registration: Mapping[str, Array] = {}
        self._rng = np.random.default_rng(0)
        late = round(errors.latency / (self.every * float(model.opt.timestep)))
        self._late: deque[tuple[Array, Array]] = deque(maxlen=1 + late)

    # ------------------------------------------------------------------ time

    def draw(self, seed: int) -> None:
        """Draw what is constant until the next reset; each joint and arm from numbers of its own.

        So a joint keeps its error whatever tools are mounted on other arms.
        """
        self._rng = np.random.default_rng([seed, zlib.crc32(b"noise")])
        for k, name in enumerate(self._table.names):
            own = np.random.default_rng([seed, zlib.crc32(name.encode())])
            normal, first, second = own.standard_normal(), *own.uniform(-1.0, 1.0, 2)
            self.offset[k] = self._offset_sigma[k] * normal
            self.play[k], self.slip[k] = self._play[k] * first, self._slip[k] * second
        along, about = self._errors.registration
        self.registration = {}
        if along or about:
            for arm, type_ in self._arms.items():
                if type_ == "PSM":
                    own = np.random.default_rng([seed, zlib.crc32(arm.encode())])
                    T = transform(
                        matrix_from_rotation_vector(about * own.standard_normal(3)),
                        along * own.standard_normal(3),
                    )
                    self.registration[arm] = T
        self.stretch[:] = 0.0
        self._draw_noise()
        self._add()

    def begin(self) -> None:
        """Start from the set-points as they are, with readings as old as the world."""
        self.before[:] = self.setpoint[:, 0]
        self._late.clear()
        self.command()
        self._keep()

    def command(self) -> None:
        """Write the set-points into the servos, moved by the errors; twice is as good as once."""
        change = self.setpoint[:, 0] - self.before
        if change.any():
            np.clip(self.play + change, -self._play, self._play, out=self.play)
            np.clip(self.slip + change, -self._slip, self._slip, out=self.slip)
            self.before[:] = self.setpoint[:, 0]
            self._add()
        self._ctrl[:] = self.setpoint
        self._ctrl[:, 0] -= self.error

    def step(self, effort: Array, periods: int) -> None:
        """Go on after a period, at the end of which motors exert efforts, (J,) [N m or N].

        Args:
            effort: of each joint's motor
            periods: physics steps since the reset
        """
        self.stretch += (self._compliance * effort - self.stretch) * self._stretched
        if periods % (NOISE_PERIODS * self.every) == 0:
            self._draw_noise()
        self._add()
        self._keep()
        self._ctrl[:] = self.setpoint
        self._ctrl[:, 0] -= self.error

    def _draw_noise(self) -> None:
        if self._noise_sigma.any():
            self.noise[:] = self._noise_sigma * self._rng.standard_normal(len(self.noise))

    def _add(self) -> None:
        self.error[:] = self.offset + self.play + self._share * self.slip + self.stretch
        self.error += self.noise

    def _keep(self) -> None:
        if self._late.maxlen != 1:
            self._late.append((self._reported(), self._data.qvel.copy()))

    # ------------------------------------------------------------------ readings

    def qpos(self) -> Array:
        """Return the coordinates at which joints are where their encoders report them, (nq,)."""
        return self._late[0][0] if self._late else self._reported()

    def report(self, qpos: Array, qvel: Array, ctrl: Array) -> None:
        """Overwrite a copy of the physics state with what the robots report of it.

        Args:
            qpos, qvel: coordinates and rates, (nq,), (nv,)
            ctrl: inputs of the servos, (3 J,)
        """
        if self._late:
            qpos[:], qvel[:] = self._late[0]
        else:
            qpos[:] = self._reported()
        ctrl.reshape(self.setpoint.shape)[:] = self.setpoint

    def _reported(self) -> Array:
        qpos = self._data.qpos
        q = self._table.drive.dot(qpos)
        read = q + self.error
        steps = np.where(self._step > 0.0, self._step, 1.0)
        read = np.where(self._step > 0.0, steps * np.round(read / steps), read)
        return qpos + self._table.couple.dot(read - q)

    # ------------------------------------------------------------------ state

    def save(self) -> dict[str, Any]:
        """Return copies of everything that readings depend on beside the physics."""
        found: dict[str, Any] = {name: getattr(self, name).copy() for name in SAVED}
        late = [(qpos.copy(), qvel.copy()) for qpos, qvel in self._late]
        random = self._rng.bit_generator.state
        return found | {"late": late, "random": random, "registration": dict(self.registration)}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore everything that `save` returned."""
        for name in SAVED:
            getattr(self, name)[:] = saved[name]
        self._late.clear()
        self._late.extend((qpos.copy(), qvel.copy()) for qpos, qvel in saved["late"])
        self._rng.bit_generator.state = saved["random"]
        self.registration = dict(saved["registration"])
        self._add()

    def go_on(self, old: ReadingErrors, seed: int, name: str) -> None:
        """Go on from the errors of a model in which the arm `name` had another tool."""
        self.draw(seed)
        index = {joint: k for k, joint in enumerate(old._table.names)}
        pairs = [
            (k, index[joint])
            for k, joint in enumerate(self._table.names)
            if joint in index and not joint.startswith(f"{name}/")
        ]
        here, there = np.array(pairs, np.intp).reshape(-1, 2).T
        for field in SAVED:
            getattr(self, field)[here] = getattr(old, field)[there]
        self._rng.bit_generator.state = old._rng.bit_generator.state
        self._add()

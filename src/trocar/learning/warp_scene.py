"""A scene in n worlds on a GPU: MuJoCo Warp steps the physics, all else is tensors beside it.

The file loads PyTorch and Warp; import it where they are needed.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.scenes import Goal, Scene
from trocar.errors import InputError, MissingExtraError
from trocar.inputs import check_whole
from trocar.learning.readings import NOTHING, SceneReadings
from trocar.learning.scene_support import warp_obstacle
from trocar.learning.torch_controller import Tensor, TorchController, torch
from trocar.modeling.build import build
from trocar.modeling.gpu_scene import FORCE_SIZE, gpu_scene
from trocar.modeling.options import ModelOptions
from trocar.simulation.grasps import LOOSE_N, PRESS_N, PRESSED_S
from trocar.simulation.grasps import PERIOD_S as LOOK_S
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.referee import LOST_M, ROUNDING_S, SETTLED_S
from trocar.tasks.registry import make_task
from trocar.tasks.task import Task

try:
    import mujoco_warp  # pyright: ignore[reportMissingTypeStubs]  it has none
    import warp  # pyright: ignore[reportMissingTypeStubs]  it has none
except ImportError as error:
    raise MissingExtraError("MuJoCo Warp", "gpu", "a scene on a GPU") from error

mjw: Any = mujoco_warp
wp: Any = warp

#: Devices, and Warp's name of each.
DEVICES = {"cuda": "cuda:0", "cpu": "cpu"}
#: Episodes whose beginnings resets draw from. Source: our own choice; `Task.reset` takes 1 ms.
POOL = 256
#: Contacts and rows of constraints of a world: so many, and so many more for each arm and object.
#: Source: measured on Warp's CPU backend: a scripted needle pick has 26 contacts and 121 rows at
#: most, fls-peg-transfer with two arms and six rings 114 and 491 before a grip.
CONTACTS, CONTACTS_EACH = 32, 16
CONSTRAINTS, CONSTRAINTS_EACH = 160, 64
#: Beginnings of episodes, beside the targets of tips: state, set-points, goals, and the count.
POOLED = ("qpos", "q", "at", "floor", "met_count", "settling")
#: Ratio of free memory that worlds may fill. Source: our own choice; the solver needs some, too.
FILLED = 0.8


@dataclass(frozen=True, eq=False)
class TensorReadings:
    """Readings of n worlds as `SceneReadings` has them, float64 tensors on the scene's device.

    Attributes:
        time, tips, targets, q, v, setpoints, objects, held, names, stalled, goals, achieved, met:
            as of `SceneReadings`
    """

    time: Tensor
    tips: Mapping[str, Tensor]
    targets: Mapping[str, Tensor]
    q: Mapping[str, Tensor]
    v: Mapping[str, Tensor]
    setpoints: Mapping[str, Tensor]
    objects: Mapping[str, Tensor]
    held: Mapping[str, Tensor]
    names: tuple[str, ...]
    stalled: Mapping[str, Tensor]
    goals: Tensor
    achieved: Tensor
    met: Tensor

    def numpy(self) -> SceneReadings:
        """Return copies as arrays."""

        def each(rows: Mapping[str, Tensor]) -> dict[str, Any]:
            return {name: _array(row) for name, row in rows.items()}

        return SceneReadings(
            _array(self.time),
            each(self.tips),
            each(self.targets),
            each(self.q),
            each(self.v),
            each(self.setpoints),
            each(self.objects),
            each(self.held),
            self.names,
            each(self.stalled),
            _array(self.goals),
            _array(self.achieved),
            _array(self.met),
        )


def _array(values: Tensor) -> NDArray[Any]:
    found: NDArray[Any] = values.cpu().numpy().copy()
    return found


class WarpScene:
    """n worlds of a scene, whose actions, rewards and resets stay on the device.

    Actions are those of `TipController`. Servos are position servos with the task's gains, jaws
    hold by friction, arms are weightless, and no drop is counted; all else follows `Task`. A world
    whose numbers are no longer finite begins anew: MuJoCo Warp does not notice. Episodes that
    ended go on until `reset`.

    Args:
        scene: a scene, its name, or the path of its TOML file
        n: number of worlds
        device: "cuda", or "cpu" for tests, which compiles for minutes the first time
        seed: of the first episode in the pool that resets draw from, and of these draws
        timestep: of the physics; 10 ms are a whole multiple [s]
        pool: number of episodes in the pool

    Attributes:
        n, device, timestep: as given
        task: the scene's task, which sets rules and limits
        seeds: of the pool's episodes, with which `Task.reset` places the same
        time: of each episode, (n,) [s]
        reward: of the last command, the change of the ratio of goals met, (n,)
        success, failed, late: how episodes ended, if they did, (n,) bool
        broken: worlds that began anew in the last command as they were not finite, (n,) bool
        broken_count: of all commands so far, a tensor
        limits, jaws: least and largest values of an action, (k,) each; columns that open jaws
        qpos, qvel, ctrl: of the physics, float32 views
        made: the model, with its addresses
        world_bytes: size of the physics state of a world [bytes]

    Raises:
        MissingExtraError: PyTorch or MuJoCo Warp is not installed
        InputError: no CUDA device, a scene that cannot run on Warp with the reason, n that memory
            cannot hold, or a timestep of which 10 ms are no whole multiple
        UnknownNameError, DescriptionError: as `load_scene`
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        n: int,
        *,
        device: str = "cuda",
        seed: int = 0,
        timestep: float = 0.001,
        pool: int = POOL,
    ) -> None:
        described = scene if isinstance(scene, Scene) else load_scene(scene)
        check_whole(n, "WarpScene: n", 1)
        check_whole(pool, "WarpScene: pool", 1)
        check_device(device)
        if reason := warp_obstacle(described):
            raise InputError(f"{described.name}: cannot run on MuJoCo Warp: {reason}")
        self._steps = round(LOOK_S / timestep) if timestep > 0.0 else 0
        if self._steps < 1 or abs(self._steps * timestep - LOOK_S) > ROUNDING_S:
            raise InputError(
                f"WarpScene: got timestep={timestep}; allowed: a whole fraction of {LOOK_S} s"
            )
        rig = replace(described.rig, grasp="friction")
        self.task: Task = make_task(replace(described, rig=rig))
        self.n, self.device, self.timestep = n, device, timestep
        locked = {arm: rig.poses["start"][arm] for arm in described.welded}
        options = ModelOptions(timestep=timestep, servo="position", locked=locked)
        self.made = made = gpu_scene(build(rig, options))
        self._table = made.model.joints
        self._hidden = described.hidden
        count = len(described.arms) + len(made.objects)
        nconmax, njmax = CONTACTS + count * CONTACTS_EACH, CONSTRAINTS + count * CONSTRAINTS_EACH
        with self._stream():
            self.world_bytes = self._check_memory(nconmax, njmax)
            self._model: Any = mjw.put_model(made.mj)
            self._model.opt.warn_overflow = 0
            self._data: Any = mjw.make_data(made.mj, nworld=n, nconmax=nconmax, njmax=njmax)
        self.qpos, self.qvel, self.ctrl, self._sensed, self._overflow = (
            self._view(name) for name in ("qpos", "qvel", "ctrl", "sensordata", "overflow")
        )
        self._fields = self._world_fields()
        self._read_model()
        world = self.task.world
        self._controller = TorchController(world, self.task.controller, self._table, n, device)
        self.limits = self._controller.limits
        self.jaws = self._controller.jaws
        self._psms = tuple(self._controller.targets)
        self._fill_pool(seed, pool)
        self._rng = torch.Generator(device).manual_seed(seed)
        self._begin()
        self._graph: Any = None
        if device == "cuda":
            self._capture()
        self.reset()

    # ------------------------------------------------------------------ an episode

    def reset(self, mask: Tensor | None = None, rows: Tensor | None = None) -> None:
        """Begin episodes anew.

        Args:
            mask: in which worlds, (n,) bool; None: in all
            rows: of the pool, whose `seeds` they have, (n,); None: drawn
        """
        n, device, most = self.n, self.device, len(self.seeds)
        every = torch.ones(n, dtype=torch.bool, device=device)
        anew: Tensor = every if mask is None else mask
        if rows is None:
            rows = torch.randint(most, (n,), generator=self._rng, device=device)
        with self._stream():
            mjw.reset_data(self._model, self._data, reset=wp.from_torch(anew.contiguous()))
        pool = self._pool
        self.qpos.copy_(torch.where(anew[:, None], pool["qpos"][rows].float(), self.qpos))
        q = pool["q"][rows]
        self.ctrl.copy_(torch.where(anew[:, None], q.float(), self.ctrl))
        self._controller.begin(anew, q, {name: pool[name][rows] for name in self._psms})
        self._at = torch.where(anew[:, None, None], pool["at"][rows], self._at)
        self._floor = torch.where(anew, pool["floor"][rows], self._floor)
        begun = {"_met_count": pool["met_count"][rows].long(), "_settling": pool["settling"][rows]}
        for name, value in {**self._fresh(), **begun}.items():
            old = getattr(self, name)
            wide = anew.reshape(-1, *[1] * (old.dim() - 1))
            setattr(self, name, torch.where(wide, value, old))
        for jaws in self._jaws.values():
            jaws.forget(anew)
        self._readings = None

    def command(self, actions: Tensor) -> None:
        """Drive all worlds for 20 ms.

        Args:
            actions: (n, k), as `TipController` has them; clipped to its limits

        Raises:
            InputError: another shape, or numbers that are not finite; nothing moves
        """
        self._check_actions(actions)
        measured = self.measured()
        before, after = self._controller.advance(actions.to(self.device), measured)
        change = after - before
        faults = self._faults(measured, before + 0.5 * change)
        for part in (0.5, 1.0):
            ctrl = before + part * change + self._lead * (change / PERIOD_S)
            self.ctrl.copy_(ctrl)
            self.physics()
            for jaws in self._jaws.values():
                jaws.look(self._sensed)
        self.time = self.time + PERIOD_S
        self._readings = None
        bad = ~(torch.isfinite(self.qpos).all(1) & torch.isfinite(self.qvel).all(1))
        self._judge(faults & ~bad)
        self.broken = bad
        self.broken_count = self.broken_count + bad.sum()
        if bool(bad.any()):
            self._clear(bad)
            reward = torch.where(bad, 0.0, self.reward)
            self.reset(bad)
            self.reward = reward

    def physics(self) -> None:
        """Step all worlds for 10 ms."""
        with self._stream():
            if self._graph is not None:
                wp.capture_launch(self._graph)
                return
            for _ in range(self._steps):
                mjw.step(self._model, self._data)

    # ------------------------------------------------------------------ looking

    def measured(self) -> Tensor:
        """Return the measured joint positions, (n, J) [rad or m], in the model's order."""
        return self.qpos.double() @ self._drive.T

    @property
    def readings(self) -> TensorReadings:
        """Readings of all worlds, as of the last command or reset."""
        if self._readings is None:
            self._readings = self._read()
        return self._readings

    @property
    def overflows(self) -> Tensor:
        """Worlds with more contacts or constraints than there was room for since their reset."""
        kinds = mjw.OverflowType
        iterations = int(kinds.ITERATIONS | kinds.LS_ITERATIONS)
        return (self._overflow & ~iterations) != 0

    def _read(self) -> TensorReadings:
        q = self.measured()
        v = self.qvel.double() @ self._rate.T
        tips, controller = self._controller.tips(q), self._controller
        rows = controller.rows
        objects = {
            name: self.qpos[:, at : at + 7].double() for name, at in self.made.objects.items()
        }
        goals, achieved, met = self._look_at_goals(tips, objects)
        seen = [k for k, goal in enumerate(self._goals) if goal.on not in self._hidden]
        return TensorReadings(
            self.time,
            {name: tips[name] for name in self._psms},
            dict(controller.targets),
            {name: q[:, of] for name, of in rows.items()},
            {name: v[:, of] for name, of in rows.items()},
            {name: controller.q[:, of] for name, of in rows.items()},
            {name: row for name, row in objects.items() if name not in self._hidden},
            {name: self._held(name) for name in self._psms},
            tuple(objects),
            dict(controller.stalled),
            goals[:, seen],
            achieved[:, seen],
            met[:, seen],
        )

    def _held(self, arm: str) -> Tensor:
        jaws = self._jaws.get(arm)
        if jaws is None:
            return torch.full((self.n,), NOTHING, device=self.device)
        return jaws.read

    def _look_at_goals(
        self, tips: Mapping[str, Tensor], objects: Mapping[str, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return places of goals, of what shall be there, (n, G, 3) each, and goals met, (n, G)."""
        names = list(objects)
        held = {arm: self._held(arm) for arm in self._psms}
        places: list[Tensor] = []
        found: list[Tensor] = []
        met: list[Tensor] = []
        for k, goal in enumerate(self._goals):
            place = self._at[:, k]
            if goal.on:
                place = _turned(objects[goal.on][:, 3:], place) + objects[goal.on][:, :3]
            fits = torch.ones(self.n, dtype=torch.bool, device=self.device)
            if goal.arm and not goal.held:
                if goal.object:
                    place = place + objects[goal.object][:, :3]
                at = tips[goal.arm][:, :3, 3]
            else:
                row = names.index(goal.object)
                at = objects[goal.object][:, :3]
                fits = ~fits
                for arm in [goal.arm] if goal.arm else self._psms:
                    fits = fits | (held[arm] == row)
                fits = fits == goal.held
            off = at - place
            near = torch.hypot(off[:, 0], off[:, 1]) <= goal.radius
            places.append(place)
            found.append(at)
            met.append(fits & near & (off[:, 2].abs() <= goal.height))
        return torch.stack(places, 1), torch.stack(found, 1), torch.stack(met, 1)

    # ------------------------------------------------------------------ rules

    def _judge(self, faults: Tensor) -> None:
        """Count goals that are met, and end episodes, by the rules of `Referee`."""
        running = ~(self.success | self.failed | self.late)
        readings = self.readings
        met, stage = readings.met, self._stage[:, None]
        now, earlier = self._stages == stage, self._stages < stage
        count = (met & now).sum(1) + earlier.sum(1)
        gained = (count - self._met_count) / len(self._goals)
        self.reward = torch.where(running, gained.double(), 0.0)
        self._met_count = count
        whole = count >= (now | earlier).sum(1)
        since = torch.where(self._settling.isinf(), self.time, self._settling)
        self._settling = torch.where(whole, since, torch.inf)
        settled = whole & (self.time - self._settling >= SETTLED_S - ROUNDING_S)
        following = torch.where(self._stages > stage, self._stages, self._last_stage + 1).amin(1)
        goes_on = settled & (following <= self._last_stage)
        self._stage = torch.where(goes_on, following, self._stage)
        self._settling = torch.where(goes_on, torch.inf, self._settling)
        late = self.time >= self.task.scene.time_limit - ROUNDING_S
        heights = [self.qpos[:, at + 2] for at in self.made.objects.values()]
        lost = faults.clone()
        for height in heights:
            lost = lost | (height < self._floor)
        self.success = self.success | (running & settled & ~goes_on)
        running = running & ~self.success
        self.failed = self.failed | (running & lost)
        self.late = self.late | (running & late & ~self.failed)

    def _faults(self, measured: Tensor, setpoints: Tensor) -> Tensor:
        """Return the worlds in which an actuator left its set-point too far, (n,) bool."""
        errors = (measured - setpoints) @ self._actuators.T
        return (errors.abs() > self._tolerance).any(1)

    # ------------------------------------------------------------------ inside

    @contextmanager
    def _stream(self) -> Generator[None, None, None]:
        """Let Warp work on the scene's device, on a GPU in PyTorch's current stream."""
        with wp.ScopedDevice(DEVICES[self.device]):
            if self.device == "cpu":
                yield
                return
            with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream())):
                yield

    def _view(self, name: str) -> Tensor:
        """Return a field of the physics state as a tensor that shares its memory."""
        found: Tensor = wp.to_torch(getattr(self._data, name))
        return found

    def _world_fields(self) -> list[Tensor]:
        """Return the numbers that the physics keeps of each world, (n, ...) views."""
        views: list[Tensor] = []
        for field in [*_arrays(self._data), *_arrays(self._data.efc)]:
            if field.shape[:1] == (self.n,) and field.capacity:
                view: Tensor = wp.to_torch(field)
                if view.is_floating_point():
                    views.append(view)
        return views

    def _clear(self, mask: Tensor) -> None:
        """Take what is not finite out of some worlds, (n,) bool.

        `reset_data` leaves it in the rows of constraints, from where it comes back.
        """
        for view in self._fields:
            view[mask] = torch.nan_to_num(view[mask], nan=0.0, posinf=0.0, neginf=0.0)

    def _tensor(self, values: object) -> Tensor:
        return torch.as_tensor(np.array(values, np.float64), device=self.device)

    def _read_model(self) -> None:
        """Copy what the model fixes: rows of joints, gains, goals."""
        table, mj = self._table, self.made.mj
        self._drive, self._rate = self._tensor(table.drive), self._tensor(table.rate)
        self._actuators = self._tensor(table.actuators)
        self._tolerance = self._tensor(table.tolerance)
        p, d = -mj.actuator_biasprm[:, 1], -mj.actuator_biasprm[:, 2]
        self._lead = self._tensor(d / np.where(p > 0.0, p, 1.0))  # ctrl = q + (D / P) v
        self._goals: list[Goal] = [goal for goal, _ in self.task.goals]
        self._stages = torch.as_tensor([goal.stage for goal in self._goals], device=self.device)
        self._last_stage = max(goal.stage for goal in self._goals)
        looks = max(1, round(PRESSED_S / LOOK_S))
        self._jaws = {
            arm: _WarpJaws(self.n, torch.as_tensor(addresses, device=self.device), looks)
            for arm, addresses in self.made.touch.items()
            if addresses.size and len(addresses) == len("lr")
        }

    def _fill_pool(self, seed: int, count: int) -> None:
        """Copy the beginnings of episodes from `Task.reset`."""
        task = self.task
        self.seeds = range(seed, seed + count)
        rows: dict[str, list[Any]] = {k: [] for k in (*POOLED, *self._psms)}
        for one in self.seeds:
            task.reset(one)
            rows["qpos"].append(task.world.mj_data.qpos.copy())
            q = np.zeros(len(self._table))
            for name, of in self._controller.rows.items():
                q[of] = task.world.arms[name].joints.setpoints()
            rows["q"].append(q)
            rows["at"].append([at for _, at in task.goals])
            heights = [task.referee.place(goal, at)[2] for goal, at in task.goals]
            rows["floor"].append(min(heights) - LOST_M)
            met = task.referee.met_count
            rows["met_count"].append(met)
            first = sum(goal.stage == 0 for goal in self._goals)
            rows["settling"].append(0.0 if met >= first else np.inf)
            for name in self._psms:
                rows[name].append(task.controller.target(name))
        self._pool = {name: self._tensor(row) for name, row in rows.items()}

    def _fresh(self) -> dict[str, Tensor]:
        """Return the count of an episode at its beginning, {attribute: (n,)}."""
        n, device = self.n, self.device
        zeros = torch.zeros(n, dtype=torch.float64, device=device)
        no = torch.zeros(n, dtype=torch.bool, device=device)
        whole = torch.zeros(n, dtype=torch.int64, device=device)
        return {
            "time": zeros,
            "reward": zeros,
            "success": no,
            "failed": no,
            "late": no,
            "_stage": whole,
            "_met_count": whole,
            "_settling": zeros + torch.inf,
        }

    def _begin(self) -> None:
        fresh = self._fresh()
        self.time: Tensor = fresh["time"]
        self.reward: Tensor = fresh["reward"]
        self.success: Tensor = fresh["success"]
        self.failed: Tensor = fresh["failed"]
        self.late: Tensor = fresh["late"]
        self.broken = torch.zeros_like(fresh["late"])
        self.broken_count: Tensor = self.broken.sum()
        self._stage: Tensor = fresh["_stage"]
        self._met_count: Tensor = fresh["_met_count"]
        self._settling: Tensor = fresh["_settling"]
        self._floor = torch.zeros_like(fresh["time"])
        self._at = torch.zeros_like(self._pool["at"][:1]).repeat(self.n, 1, 1)
        self._readings: TensorReadings | None = None

    def _capture(self) -> None:
        """Record 10 ms of physics as a CUDA graph, after a step that compiles all kernels."""
        with self._stream():
            mjw.step(self._model, self._data)
        torch.cuda.synchronize()
        with wp.ScopedDevice(DEVICES[self.device]), wp.ScopedCapture() as capture:
            for _ in range(self._steps):
                mjw.step(self._model, self._data)
        self._graph = capture.graph
        torch.cuda.synchronize()

    def _check_actions(self, actions: Tensor) -> None:
        shape = self.n, len(self.limits[0])
        if tuple(actions.shape) != shape:
            raise InputError(
                f"{self.task.scene.name}: got actions of shape {tuple(actions.shape)}; allowed:"
                f" {shape}"
            )
        fine = torch.isfinite(actions).all(1)
        if not bool(fine.all()):
            first = int(torch.nonzero(~fine)[0, 0])
            raise InputError(
                f"{self.task.scene.name}: got an action that is not finite in world {first} and"
                f" {int((~fine).sum()) - 1} others; allowed: finite numbers"
            )

    def _check_memory(self, nconmax: int, njmax: int) -> int:
        """Reject more worlds than free memory holds; return the size of one [bytes]."""
        one, two = (
            _size(mjw.make_data(self.made.mj, nworld=k, nconmax=nconmax, njmax=njmax))
            for k in (1, 2)
        )
        free, each = _free_memory(self.device), two - one
        most = FILLED * free / each
        if self.n > most:
            raise InputError(
                f"WarpScene: got n={self.n}, of which a world takes {each / 2**20:.2f} MiB"
                f" and {free / 2**30:.1f} GiB are free; allowed: up to {int(most)}"
            )
        return each


class _WarpJaws:
    """Grasps of one arm in n worlds, by the rules of `Grasps` with friction alone.

    Args:
        n: number of worlds
        addresses: of forces in `sensordata`, (fingers, objects)
        looks: for which an object is pressed before it is held

    Attributes:
        read: row of the object that both fingers press, or `NOTHING`, (n,)
    """

    def __init__(self, n: int, addresses: Tensor, looks: int) -> None:
        self._columns = addresses[..., None] + torch.arange(FORCE_SIZE, device=addresses.device)
        self._enough = looks
        count = addresses.shape[1]
        self._looks = torch.zeros(n, count, dtype=torch.int64, device=addresses.device)
        self._hold = torch.full((n,), NOTHING, device=addresses.device)
        self.read = self._hold

    def forget(self, mask: Tensor) -> None:
        """Hold nothing in some worlds, (n,) bool."""
        self._looks = torch.where(mask[:, None], 0, self._looks)
        self._hold = torch.where(mask, NOTHING, self._hold)
        self.read = torch.where(mask, NOTHING, self.read)

    def look(self, sensed: Tensor) -> None:
        """Take hold and let go by the forces of the last step."""
        forces = sensed[:, self._columns]
        press = (forces * forces).sum(-1).sqrt()  # (n, fingers, objects)
        held, rows = self._hold >= 0, self._hold.clamp(min=0)[:, None]
        held = held & (press[:, 1].gather(1, rows)[:, 0] >= LOOSE_N)
        weaker = press.amin(1)
        looks = torch.where((weaker > PRESS_N) & (self._hold < 0)[:, None], self._looks + 1, 0)
        least, most = weaker.max(1)
        presses = (least > PRESS_N) & (self._hold < 0)
        takes = presses & (looks.gather(1, most[:, None])[:, 0] >= self._enough)
        kept = torch.where(held, self._hold, NOTHING)
        self.read = torch.where(presses, most, kept)
        self._hold = torch.where(takes, most, kept)
        self._looks = torch.where(takes[:, None], 0, looks)


def _turned(w: Tensor, v: Tensor) -> Tensor:
    """Turn vectors (n, 3) by quaternions wxyz (n, 4)."""
    axis = w[:, 1:]
    across = torch.stack(_cross(axis, v), 1) * 2.0
    return v + w[:, :1] * across + torch.stack(_cross(axis, across), 1)


def _cross(a: Tensor, b: Tensor) -> list[Tensor]:
    (ax, ay, az), (bx, by, bz) = a.unbind(1), b.unbind(1)
    return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]


def check_device(device: str) -> None:
    """Reject devices that are not there.

    Raises:
        InputError: neither "cuda" nor "cpu", or no CUDA device; says what is missing
    """
    if device not in DEVICES:
        raise InputError(f"WarpScene: got device={device!r}; allowed: {', '.join(DEVICES)}")
    if device == "cpu":
        return
    if not torch.backends.cuda.is_built():
        why = f"PyTorch {torch.__version__} is built without CUDA"
    elif not torch.cuda.is_available():
        why = "PyTorch finds no CUDA device"
    elif not wp.is_cuda_available():
        why = "Warp finds no CUDA device"
    else:
        return
    raise InputError(f"WarpScene: got device='cuda', but {why}; allowed: 'cpu', for tests")


def _arrays(record: Any) -> list[Any]:
    """Return the arrays of a record of Warp's."""
    fields: dict[str, Any] = {**vars(record)}
    return [field for field in fields.values() if isinstance(field, wp.array)]


def _size(state: Any) -> int:
    """Return the memory of a state's arrays [bytes]."""
    arrays = [*_arrays(state), *_arrays(state.contact), *_arrays(state.efc)]
    return sum(int(array.capacity) for array in arrays)


def _free_memory(device: str) -> float:
    """Return the free memory of a device [bytes]; infinite where the system does not say."""
    if device == "cuda":
        free, _ = torch.cuda.mem_get_info()
        return float(free)
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return float("inf")
    (line,) = [line for line in lines if line.startswith("MemAvailable:")]
    return 1024.0 * float(line.split()[1])

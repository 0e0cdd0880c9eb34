"""Policy files: Python, trained networks, and archives of Stable-Baselines3, played as scripts."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import time
import tomllib
import traceback
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray

from trocar import __version__
from trocar.descriptions.scenes import Scene
from trocar.errors import (
    DescriptionError,
    InputError,
    MissingExtraError,
    TrocarError,
    UnknownNameError,
)
from trocar.learning.features import SceneFeatures
from trocar.learning.networks import (
    EnsembleSettings,
    Perceptron,
    TemporalEnsemble,
    goal_difference,
    perceptron_from_tensors,
)
from trocar.learning.readings import read_task
from trocar.learning.task_env import TaskEnv
from trocar.modeling.props import run_script
from trocar.outputs import check_file, whole_file
from trocar.tasks import Task
from trocar.tasks.play import PATIENCE_S

Array = NDArray[np.float64]
#: Returns an action from an observation of `TaskEnv`.
EnvPolicy = Callable[[Any], ArrayLike]

logger = logging.getLogger(__name__)

#: Format of trained policies that this version writes and reads.
FORMAT = 1
KINDS = ("clone", "actor")
#: Inputs of an actor's network: the flat observation, or that with the ways to the goals.
INPUTS = ("observation", "goal-difference")
#: Settings of `TaskEnv` by which a policy acts, and all that a file may have.
ACTING = ("obs", "action", "action_period", "image_size", "channels", "eyes")
SETTINGS = (*ACTING, "scene", "reward", "max_steps", "randomise", "tips")
#: Suffixes of files whose reading runs code that they contain.
PICKLES = (".pt", ".pth", ".pkl", ".pickle", ".ckpt", ".joblib", ".bin")
ALLOWED = (
    "a .py file with make_policy(env), a .toml file with its .safetensors (trocar learn train), or"
    " a .zip of Stable-Baselines3 with --trust"
)


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """A trained policy as it stands in NAME.toml and NAME.safetensors.

    Attributes:
        kind: "clone", plans of set-points from features (`TemporalEnsemble`), or "actor", actions
            of `TaskEnv` from its observations
        scene: name of the scene that it was trained on
        network: from features to plans, or from observations to actions
        env: of an actor, the settings of `TaskEnv`
        inputs: of an actor, one of `INPUTS`
        features: of a clone, names of the columns, see `SceneFeatures`
        ensemble: of a clone
        training: the command, seeds and results; for readers
        trocar: version that trained it
    """

    kind: str
    scene: str
    network: Perceptron
    env: Mapping[str, Any] = field(default_factory=dict[str, Any])
    inputs: str = INPUTS[0]
    features: tuple[str, ...] = ()
    ensemble: EnsembleSettings = field(default_factory=EnsembleSettings)
    training: Mapping[str, Any] = field(default_factory=dict[str, Any])
    trocar: str = __version__


def save_policy(path: str | Path, policy: TrainedPolicy, overwrite: bool = False) -> None:
    """Write a trained policy, as NAME.toml and NAME.safetensors beside it.

    Args:
        path: of the .toml file
        policy: to write
        overwrite: existing files are replaced

    Raises:
        InputError: another suffix, or the files exist
        MissingExtraError: safetensors is not installed
        TrocarError: a file could not be written to its end
    """
    target = check_file(path, overwrite)
    if target.suffix != ".toml":
        raise InputError(f"{path}: allowed: a file that ends in .toml")
    save = _safetensors(target).save
    beside = check_file(target.with_suffix(".safetensors"), overwrite)
    tensors: bytes = save(policy.network.tensors())
    network = policy.network
    content: dict[str, Any] = {
        "format": FORMAT,
        "kind": policy.kind,
        "trocar": policy.trocar,
        "scene": policy.scene,
        "sha256": hashlib.sha256(tensors).hexdigest(),
        "training": dict(policy.training),
        "network": {
            "sizes": list(network.sizes),
            "activation": network.activation,
            "output": network.output,
        },
    }
    if policy.kind == "clone":
        content["clone"] = {"features": list(policy.features), **asdict(policy.ensemble)}
    else:
        content["actor"] = {"inputs": policy.inputs, "env": dict(policy.env)}
    with whole_file(beside, overwrite) as part:
        part.write_bytes(tensors)
    with whole_file(target, overwrite) as part:
        part.write_text(tomli_w.dumps(content), encoding="utf-8")


class PolicyFile:
    """A policy in a file, which plays a task as the task's own scripted policy does.

    It can be pickled, with the content of the file.

    Args:
        path: a file of `ALLOWED`
        trust: whether archives that unpickle, which can run any code, may be read

    Attributes:
        path, name: of the file
        scene: on which it was trained; "" of one for any scene

    Raises:
        InputError: no such file, one that is not a policy or is broken, or one that needs `trust`
        MissingExtraError: safetensors is not installed
    """

    def __init__(self, path: str | Path, trust: bool = False) -> None:
        self.path = Path(path).expanduser()
        self.name, suffix = self.path.name, self.path.suffix.lower()
        if suffix in PICKLES:
            raise InputError(
                f"{path}: is a pickle, whose reading can run any code; allowed: {ALLOWED}; trocar"
                " learn train exports networks"
            )
        if suffix not in (".py", ".toml", ".safetensors", ".zip"):
            raise InputError(f"{path}: is not a policy file; allowed: {ALLOWED}")
        if suffix == ".zip" and not trust:
            raise InputError(
                f"{path}: archives of Stable-Baselines3 hold pickled objects, whose reading can run"
                " any code; allowed: with --trust, if you trust its origin"
            )
        self._trained: TrainedPolicy | None = None
        self._settings: dict[str, Any] = {}
        self._content = b""
        if suffix in (".toml", ".safetensors"):
            self._trained = _load(self.path.with_suffix(".toml"))
        else:
            self._content = _read(self.path)
            beside = self.path.with_suffix(".toml")
            if suffix == ".zip" and beside.exists():
                self._settings = _table(beside)
                _check_settings(self._settings, beside)
        self._maker: Callable[[TaskEnv], EnvPolicy] | None = None
        self._made: TaskEnv | None = None
        if suffix == ".py":
            self._python()
        self.scene = self._trained.scene if self._trained else self._settings.get("scene", "")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_maker": None, "_made": None}

    def check(self, scene: Scene) -> None:
        """Check that a scene is the one on which the policy was trained.

        Raises:
            InputError: it is another one
        """
        if self.scene and self.scene != scene.name:
            raise InputError(
                f"{self.path}: was trained on the scene {self.scene}; got {scene.name}; allowed:"
                f" {self.scene}, or train one for {scene.name} (trocar learn train)"
            )

    def script(self, task: Task) -> Iterator[Array]:
        """Return the actions of an episode, as `Task.policy` yields them: one every 20 ms.

        Args:
            task: after the reset; the iterator reads it and steps nothing

        Raises:
            InputError: the task's scene, features, observations or actions are not those of the
                policy; nothing moves
            TrocarError: of the iterator: the policy raised, took longer than 10 s, or returned no
                finite action
        """
        self.check(task.scene)
        if self._trained is not None and self._trained.kind == "clone":
            actions = self._clone(task, self._trained)
        elif self._trained is not None:
            actions = self._actor(task, self._trained)
        else:
            make = self._maker or (self._python() if self.path.suffix == ".py" else self._archive())
            self._maker = make
            env = self._env(task, self._settings)
            try:
                policy = make(env)
            except Exception as problem:
                raise InputError(str(self._raised(problem))) from problem
            if not callable(policy):
                raise InputError(
                    f"{self.path}: make_policy returned {policy!r}; allowed: a function from"
                    " observation to action"
                )
            actions = env.script(self._checked(env, policy))
        return self._guarded(actions)

    # ------------------------------------------------------------------ kinds

    def _clone(self, task: Task, policy: TrainedPolicy) -> Iterator[Array]:
        names = SceneFeatures(task).names
        if policy.features != names:
            off = next((n for n in names if n not in policy.features), "their order")
            raise InputError(
                f"{self.path}: reads {len(policy.features)} features; this version has"
                f" {len(names)} of {task.scene.name}, which differ in {off}; allowed: a policy"
                " trained with this version"
            )
        try:
            ensemble = TemporalEnsemble(policy.network, policy.ensemble, task)
        except InputError as problem:
            raise InputError(f"{self.path}: {problem}") from None

        def actions() -> Iterator[Array]:
            while True:
                yield ensemble.act(read_task(task))[0]

        return actions()

    def _actor(self, task: Task, policy: TrainedPolicy) -> Iterator[Array]:
        env, network = self._env(task, policy.env), policy.network

        def inputs(obs: Any) -> NDArray[np.float32]:
            if policy.inputs == "observation":
                return np.asarray(obs, np.float32)[None]
            parts = ("observation", "achieved_goal", "desired_goal")
            return goal_difference(*(np.asarray(obs[name])[None] for name in parts))

        try:
            sizes = inputs(env.observe()).shape[1], len(env.actions.low)
        except (TypeError, KeyError, IndexError, ValueError):
            raise InputError(
                f"{self.path}: actor.inputs: got {policy.inputs!r} with the observations"
                f" {policy.env.get('obs')!r}; allowed: those that belong together"
            ) from None
        found = network.sizes[0], network.sizes[-1]
        if found != sizes:
            raise InputError(
                f"{self.path}: its network has {found[0]} inputs and {found[1]} outputs;"
                f" {task.scene.name} has {sizes[0]} and {sizes[1]}; allowed: a policy trained with"
                " this version"
            )
        return env.script(lambda obs: network(inputs(obs))[0])

    def _python(self) -> Callable[[TaskEnv], EnvPolicy]:
        """Run the Python file and return its `make_policy`, with its `SETTINGS` kept."""
        make = run_script(str(self.path), "make_policy", self._content)
        settings = getattr(make, "__globals__", {}).get("SETTINGS", {})
        if not isinstance(settings, dict):
            raise DescriptionError(
                str(self.path), "SETTINGS", f"got {settings!r}; allowed: a dict of TaskEnv's"
            )
        self._settings = cast(dict[str, Any], settings)
        self._maker = make
        return make

    def _archive(self) -> Callable[[TaskEnv], EnvPolicy]:
        """Load an archive of Stable-Baselines3 and return a function that makes its policy."""
        try:
            import stable_baselines3 as installed  # pyright: ignore[reportMissingTypeStubs]
        except ImportError:
            raise MissingExtraError("Stable-Baselines3", "learn", str(self.path)) from None
        sb3 = cast(Any, installed)
        try:
            with zipfile.ZipFile(io.BytesIO(self._content)) as archive:
                data = json.loads(archive.read("data"))
            module = data["policy_class"]["__module__"].split(".")[1]
        except (zipfile.BadZipFile, KeyError, TypeError, IndexError, ValueError):
            raise InputError(
                f"{self.path}: is no archive of Stable-Baselines3; allowed: one that its save wrote"
            ) from None
        # the algorithm stands nowhere in an archive, but those that share a module differ so
        shared = "PPO" if "clip_range" in data else "A2C"
        kinds = {"sac": "SAC", "td3": "TD3", "dqn": "DQN", "common": shared}
        if module not in kinds:
            raise UnknownNameError("algorithm", module, kinds, str(self.path))
        try:
            model = getattr(sb3, kinds[module]).load(io.BytesIO(self._content), device="cpu")
        except Exception as problem:
            raise InputError(
                f"{self.path}: cannot be loaded: {type(problem).__name__}: {problem}"
            ) from problem
        seen = _shapes(getattr(model.observation_space, "spaces", model.observation_space))
        found = seen, tuple(getattr(model.action_space, "shape", ()))
        self._settings = {"obs": _observation(seen), **self._settings}

        def make(env: TaskEnv) -> EnvPolicy:
            allowed = _shapes(env.observe()), env.actions.low.shape
            if found != allowed:
                raise InputError(
                    f"{self.path}: observations and actions have the shapes {found[0]} and"
                    f" {found[1]}; those of {env.task.scene.name} with {env.settings} have"
                    f" {allowed[0]} and {allowed[1]}; allowed: the same; {self.path.stem}.toml"
                    f" beside it may have the settings ({', '.join(ACTING)})"
                )
            return lambda obs: model.predict(obs, deterministic=True)[0]

        return make

    def _env(self, task: Task, settings: Mapping[str, Any]) -> TaskEnv:
        """Return the environment of a task, with the settings of the policy.

        The next episode of the task has the same one: a renderer of images takes a second to make.
        """
        made = self._made
        if made is not None and made.task is task:
            made.begin()
            return made
        if made is not None and made.camera is not None:
            made.camera.close()
        _check_settings(settings, self.path)
        try:
            given = {name: settings[name] for name in ACTING if name in settings}
            self._made = made = TaskEnv(task, **given)
        except InputError as problem:
            raise InputError(f"{self.path}: {problem}") from None
        return made

    # ------------------------------------------------------------------ guards

    def _checked(self, env: TaskEnv, policy: EnvPolicy) -> EnvPolicy:
        """Return a policy whose actions are checked."""
        shape = env.actions.low.shape

        def checked(obs: Any) -> Array:
            action = policy(obs)
            try:
                values = np.asarray(action, np.float64)
            except (TypeError, ValueError, OverflowError):
                values = np.full(0, np.nan)
            if values.shape != shape or not np.isfinite(values).all():
                raise TrocarError(
                    f"{self.path}: the policy returned the action {action!r}; allowed: {shape[0]}"
                    " finite numbers"
                )
            return values

        return checked

    def _guarded(self, actions: Iterator[Array]) -> Iterator[Array]:
        """Yield actions; errors name the file and the line, and none may take too long."""
        while True:
            begin = time.perf_counter()
            try:
                action = next(actions, None)
            except TrocarError:
                raise
            except Exception as problem:
                raise self._raised(problem) from problem
            if (taken := time.perf_counter() - begin) > PATIENCE_S:
                raise TrocarError(
                    f"{self.path}: the policy took {taken:.1f} s for an action; allowed:"
                    f" {PATIENCE_S:g} s"
                )
            if action is None:
                return
            yield action

    def _raised(self, problem: Exception) -> TrocarError:
        """Return the error of a policy that raised, with the last of its lines that ran."""
        if isinstance(problem, TrocarError):
            return problem
        name = str(self.path)
        lines = [
            f.lineno for f in traceback.extract_tb(problem.__traceback__) if f.filename == name
        ]
        where = f": line {lines[-1]}" if lines else ""
        return TrocarError(f"{name}{where}: {type(problem).__name__}: {problem}")


def _shapes(values: Any) -> Any:
    """Return the shape of an observation, or of each of its parts.

    Stable-Baselines3 puts the channels of images first, and takes both orders: they are last here.
    """
    if isinstance(values, Mapping):
        named = cast(Mapping[str, Any], values).items()
        return {name: _shapes(value) for name, value in sorted(named)}
    shape = tuple(values.shape)
    return (*shape[1:], shape[0]) if len(shape) == 3 and shape[0] < min(shape[1:]) else shape


def _observation(shapes: Any) -> str:
    """Return the kind of observations that have these shapes."""
    if isinstance(shapes, Mapping):
        return "state+image" if "image" in shapes else "goal"
    return "image" if len(shapes) == 3 else "state"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _table(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(_read(path).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not TOML: {error}") from None


def _check_settings(settings: Mapping[str, Any], where: Path) -> None:
    for name in settings:
        if name not in SETTINGS:
            raise UnknownNameError("setting", name, SETTINGS, str(where))


def _safetensors(path: Path) -> Any:
    try:
        import safetensors.numpy as installed
    except ImportError:
        raise MissingExtraError("safetensors", "learn", str(path)) from None
    return installed


def _load(path: Path) -> TrainedPolicy:
    """Read and check NAME.toml and the tensors beside it."""
    table, beside = _Table(path, "", _table(path)), path.with_suffix(".safetensors")
    found = table.get("format", int)
    if found != FORMAT:
        raise InputError(
            f"{path}: format: got {found}; allowed: {FORMAT}; perhaps a newer trocar's"
        )
    kind, version = table.get("kind", str), table.get("trocar", str)
    if kind not in KINDS:
        raise UnknownNameError("kind", kind, KINDS, str(path))
    if version != __version__:
        logger.warning(
            "%s: was trained with trocar %s; this is %s, whose scenes may differ",
            path, version, __version__,
        )  # fmt: skip
    content = _read(beside)
    if hashlib.sha256(content).hexdigest() != table.get("sha256", str):
        raise InputError(
            f"{beside}: is not the file that was written with {path.name}; allowed: both of one"
            " training"
        )
    load = _safetensors(beside).load
    try:
        tensors = load(content)
    except Exception as problem:  # noqa: BLE001  errors of safetensors derive from Exception alone
        raise InputError(f"{beside}: cannot be read: {problem}") from None
    layout = table.table("network")
    sizes = layout.get("sizes", list)
    if len(sizes) < 2 or not all(isinstance(n, int) and n > 0 for n in sizes):
        raise InputError(f"{path}: network.sizes: got {sizes}; allowed: 2 or more whole numbers")
    activation, output = layout.get("activation", str), layout.get("output", str)
    network = perceptron_from_tensors(tensors, sizes, activation, output, str(beside))
    scene, training = table.get("scene", str), table.get("training", dict)
    if kind == "clone":
        clone = table.table("clone")
        given = {f.name: clone.get(f.name, int if f.type == "int" else float)
                 for f in fields(EnsembleSettings)}  # fmt: skip
        for name, value in given.items():
            if value < (0 if name == "decay" else 1e-9):
                raise InputError(f"{path}: clone.{name}: got {value}; allowed: above 0")
        return TrainedPolicy(
            kind, scene, network, features=tuple(clone.get("features", list)),
            ensemble=EnsembleSettings(**given), training=training, trocar=version,
        )  # fmt: skip
    actor = table.table("actor")
    inputs = actor.get("inputs", str)
    if inputs not in INPUTS:
        raise UnknownNameError("inputs", inputs, INPUTS, str(path))
    return TrainedPolicy(
        kind, scene, network, env=actor.get("env", dict), inputs=inputs,
        training=training, trocar=version,
    )  # fmt: skip


@dataclass(frozen=True)
class _Table:
    """A table of a policy file, whose entries are checked as they are read."""

    path: Path
    label: str
    values: dict[str, Any]

    def get(self, key: str, kind: type) -> Any:
        found = self.values.get(key)
        if kind is float and type(found) is int:
            found = float(found)
        if type(found) is not kind:
            got = "nothing" if found is None else repr(found)
            raise InputError(f"{self.path}: {self.label}{key}: got {got}; allowed: {kind.__name__}")
        return found

    def table(self, key: str) -> _Table:
        return _Table(self.path, f"{self.label}{key}.", self.get(key, dict))

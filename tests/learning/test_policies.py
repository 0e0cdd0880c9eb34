"""Policy files: the same episodes wherever they run, and one clear error for each that cannot."""

import json
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from trocar import __version__
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError, MissingExtraError, TrocarError
from trocar.learning.features import SceneFeatures, SetpointPlans
from trocar.learning.networks import EnsembleSettings, TemporalEnsemble, make_perceptron
from trocar.learning.policies import PolicyFile, TrainedPolicy, save_policy
from trocar.learning.readings import read_task
from trocar.learning.task_env import TaskEnv
from trocar.live import Loop
from trocar.tasks import Task, make_task, play, run_episode
from trocar.tasks.served import ServedTask

ROOT = Path(__file__).parents[2]
REACH = ROOT / "examples" / "policies" / "reach.py"
SAFETENSORS = "safetensors is not installed (extra learn)"


@pytest.fixture(scope="module")
def task() -> Task:
    return make_task("needle-reach")


def python(folder: Path, act: str, before: str = "") -> Path:
    """Write a policy in Python whose `act` has one statement, in line 4 or so."""
    path = folder / "own.py"
    text = (
        f"import numpy as np\n{before}\ndef make_policy(env):\n    def act(obs):\n        {act}\n"
    )
    path.write_text(f"{text}    return act\n", encoding="utf-8")
    return path


def clone(task: Task, seed: int = 0, **more: Any) -> TrainedPolicy:
    """Return a clone with random weights, which moves a little."""
    rng, features, width = (
        np.random.default_rng(seed),
        SceneFeatures(task),
        SetpointPlans(task).width,
    )
    settings = EnsembleSettings(length=3, most=2)
    layers = [
        (rng.normal(size=(8, features.size)), rng.normal(size=8)),
        (rng.normal(size=(3 * width, 8)), rng.normal(size=3 * width)),
    ]
    network = make_perceptron(layers, "gelu", outputs=(0.0, 0.01))
    given = {"features": features.names, "ensemble": settings, **more}
    return TrainedPolicy("clone", task.scene.name, network, **given)


def actor(env: TaskEnv, inputs: str, size: int) -> TrainedPolicy:
    """Return an actor with random weights."""
    rng = np.random.default_rng(0)
    layers = [
        (rng.normal(size=(len(env.actions.low), size)) / 10.0, np.zeros(len(env.actions.low)))
    ]
    network = make_perceptron(layers, "relu", "tanh")
    return TrainedPolicy("actor", env.task.scene.name, network, env=env.settings, inputs=inputs)


# ---------------------------------------------------------------------- where they run


def test_the_example_reaches_every_goal() -> None:
    found = list(play("needle-reach", range(10), script=PolicyFile(REACH).script))
    assert [one.success for one in found] == [True] * 10


@pytest.mark.parametrize("kind", ["python", "clone"])
def test_a_served_policy_moves_as_without_a_loop_and_again_after_a_reset(
    kind: str, task: Task, tmp_path: Path
) -> None:
    path = REACH
    if kind == "clone":
        pytest.importorskip("safetensors", reason=SAFETENSORS)
        path = tmp_path / "clone.toml"
        save_policy(path, clone(task))
    script = PolicyFile(path).script
    scene = replace(load_scene("needle-reach"), time_limit=1.5)
    alone = run_episode(make_task(scene), 2, script=script)
    assert alone.distance_m["PSM1"] > 0.005
    live = make_task(scene)
    served = ServedTask(live, 2, script=script, driver="policy own")
    loop = Loop(live.world, tick_s=0.001, speed="max")
    served.watch(loop)
    for _ in range(2):
        while not live.done:
            loop.tick(loop.quiet_ticks())
        assert live.result(2) == alone
        assert (served.driver, served.state()["reason"]) == ("policy own", alone.reason)
        live.world.reset()  # as somebody on the page does
        loop.tick(loop.quiet_ticks())
        assert not live.done and live.world.time < 0.01


@pytest.mark.slow
def test_workers_change_nothing() -> None:
    script = PolicyFile(REACH).script
    alone = list(play("needle-reach", range(4), script=script))
    assert list(play("needle-reach", range(4), 2, script=script)) == alone


@pytest.mark.slow
def test_a_cluster_changes_nothing() -> None:
    pytest.importorskip("ray", reason="the extra cluster is not installed")
    code = f"""
from trocar.learning.policies import PolicyFile
from trocar.tasks import play
script = PolicyFile({str(REACH)!r}).script
print("digests", [one.digest for one in play("needle-reach", range(4), 2, "local", script=script)])
print("digests", [one.digest for one in play("needle-reach", range(4), script=script)])
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    found, alone = (line for line in done.stdout.splitlines() if line.startswith("digests"))
    assert found == alone


def test_a_pickled_policy_plays_without_its_file(task: Task, tmp_path: Path) -> None:
    path = python(tmp_path, "return np.full(7, 0.1)")
    found = PolicyFile(path)
    wanted = run_episode(task, 0, script=found.script, duration_s=0.1)
    sent = pickle.dumps(found.script)
    path.unlink()
    assert run_episode(task, 0, script=pickle.loads(sent), duration_s=0.1) == wanted


def test_each_episode_makes_its_policy_anew(task: Task, tmp_path: Path) -> None:
    text = "count.append(0); return np.full(7, 0.01 * len(count))"
    path = python(tmp_path, text)
    inside = path.read_text(encoding="utf-8").replace("    def act", "    count = []\n    def act")
    path.write_text(inside, encoding="utf-8")
    script = PolicyFile(path).script
    one, two = (run_episode(task, 0, script=script, duration_s=0.2) for _ in range(2))
    assert one == two


def test_a_policy_sees_the_beginning_of_each_episode(task: Task, tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(
        "SEEN = []\ndef make_policy(env):\n    SEEN.append(env.observe())\n"
        "    return lambda obs: SEEN[-1][:7]\n",
        encoding="utf-8",
    )
    script = PolicyFile(path).script
    both = [run_episode(task, seed, script=script, duration_s=0.2) for seed in (0, 1)]
    alone = run_episode(task, 1, script=PolicyFile(path).script, duration_s=0.2)
    assert both[1] == alone


# ---------------------------------------------------------------------- kinds


def test_a_written_clone_acts_as_its_ensemble(task: Task, tmp_path: Path) -> None:
    pytest.importorskip("safetensors", reason=SAFETENSORS)
    policy, path = clone(task), tmp_path / "clone.toml"
    save_policy(path, policy)
    found = PolicyFile(path.with_suffix(".safetensors"))
    task.reset(1)
    script, ensemble = found.script(task), TemporalEnsemble(policy.network, policy.ensemble, task)
    for _ in range(5):
        wanted = ensemble.act(read_task(task))[0]
        action = next(script)
        np.testing.assert_array_equal(action, wanted)
        task.command(action)


@pytest.mark.parametrize(("obs", "inputs"), [("state", "observation"), ("goal", "goal-difference")])
def test_a_written_actor_acts_by_observations(
    obs: str, inputs: str, task: Task, tmp_path: Path
) -> None:
    pytest.importorskip("safetensors", reason=SAFETENSORS)
    env = TaskEnv(task, obs=obs, action="surrol", action_period=0.2, max_steps=20)
    seen = env.observe()
    size = len(seen) if obs == "state" else len(seen["observation"]) + 6
    policy = actor(env, inputs, size)
    save_policy(tmp_path / "actor.toml", policy)
    script = PolicyFile(tmp_path / "actor.toml").script
    env.reset(3)
    actions: list[np.ndarray] = []
    by_env = env.script(lambda obs: actions.append(obs) or policy.network(flat(obs))[0])
    by_file = script(task)
    for _ in range(12):  # two actions
        one, two = next(by_env), next(by_file)
        np.testing.assert_array_equal(one, two)
        task.command(one)
    assert len(actions) == 2


def flat(obs: Any) -> np.ndarray:
    """Return an observation as one row, with goals by their differences."""
    if not isinstance(obs, dict):
        return obs[None]
    way = obs["desired_goal"] - obs["achieved_goal"]
    return np.concatenate([obs["observation"], np.float32(5) * way, np.tanh(np.float32(25) * way)])[
        None
    ]


def archive(path: Path, env: TaskEnv) -> Any:
    """Save a fresh actor of Stable-Baselines3 for an environment, and return its model."""
    gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")
    sb3 = pytest.importorskip(
        "stable_baselines3", reason="Stable-Baselines3 is not installed (extra learn)"
    )

    def box(values: np.ndarray) -> Any:
        return gymnasium.spaces.Box(-10.0, 10.0, values.shape, np.float32)

    class Spaces(gymnasium.Env):
        observation_space = gymnasium.spaces.Dict({k: box(v) for k, v in env.observe().items()})
        action_space = gymnasium.spaces.Box(env.actions.low, env.actions.high)

    model = sb3.SAC("MultiInputPolicy", Spaces(), seed=0, buffer_size=10, device="cpu")
    model.save(path)
    return model


def test_an_archive_of_stable_baselines_acts_by_its_predictions(task: Task, tmp_path: Path) -> None:
    env = TaskEnv(task, obs="goal", action="tip", action_period=0.1)
    model = archive(tmp_path / "sac.zip", env)
    env.reset(3)
    wanted = env.script(lambda obs: model.predict(obs, deterministic=True)[0])
    found = PolicyFile(tmp_path / "sac.zip", trust=True).script(task)
    for _ in range(6):
        one, two = next(wanted), next(found)
        np.testing.assert_array_equal(one, two)
        task.command(one)
    surrol = 'obs = "goal"\naction = "surrol"\n'
    (tmp_path / "sac.toml").write_text(surrol, encoding="utf-8")
    with pytest.raises(InputError, match=r"sac\.zip: observations and actions have the shapes"):
        PolicyFile(tmp_path / "sac.zip", trust=True).script(task)


@pytest.mark.parametrize(("kind", "layers"), [("image", 3), ("state+image", 4)])
def test_an_archive_that_sees_images_acts_by_its_predictions(
    kind: str, layers: int, tmp_path: Path
) -> None:
    sb3 = pytest.importorskip(
        "stable_baselines3", reason="Stable-Baselines3 is not installed (extra learn)"
    )
    scene_env = pytest.importorskip("trocar.learning.scene_env", reason="needs Gymnasium")
    channels = ["rgb", "depth"][: layers - 2]
    settings = {"obs": kind, "image_size": 36, "channels": channels}
    env = scene_env.SceneEnv("needle-reach", **settings)
    name = "CnnPolicy" if kind == "image" else "MultiInputPolicy"
    model = sb3.PPO(name, env, n_steps=8, batch_size=8, seed=0, device="cpu")
    model.save(tmp_path / "ppo.zip")
    (tmp_path / "ppo.toml").write_text(tomli_w.dumps(settings), encoding="utf-8")
    seen, _ = env.reset(seed=3)
    wanted = env.env.script(lambda obs: model.predict(obs, deterministic=True)[0])
    one, task = next(wanted), make_task("needle-reach")
    task.reset(3)
    two = next(PolicyFile(tmp_path / "ppo.zip", trust=True).script(task))
    np.testing.assert_array_equal(one, two)
    assert (seen if kind == "image" else seen["image"]).shape == (36, 36, layers)
    env.close()


def test_settings_beside_an_archive_are_checked(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"")
    (tmp_path / "a.toml").write_text("action_perod = 0.1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.toml: unknown setting 'action_perod' \(did you mean"):
        PolicyFile(tmp_path / "a.zip", trust=True)


def test_an_archive_is_rejected_without_trust(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"can run any code; allowed: with --trust"):
        PolicyFile(path)


def test_a_broken_archive_is_one_error(task: Task, tmp_path: Path) -> None:
    pytest.importorskip(
        "stable_baselines3", reason="Stable-Baselines3 is not installed (extra learn)"
    )
    path = tmp_path / "a.zip"
    path.write_bytes(b"PK")
    with pytest.raises(InputError, match=r"is no archive of Stable-Baselines3"):
        PolicyFile(path, trust=True).script(task)


# ---------------------------------------------------------------------- policies that fail


def test_a_policy_that_raises_names_file_and_line(task: Task, tmp_path: Path) -> None:
    path = python(tmp_path, "return [1 / (obs.sum() * 0)] * 7 if obs.size else missing(obs)")
    path.write_text(path.read_text(encoding="utf-8").replace("obs.sum() * 0", "0"))
    with pytest.raises(TrocarError, match=r"own\.py: line 5: ZeroDivisionError: ") as found:
        run_episode(task, 0, script=PolicyFile(path).script)
    assert not isinstance(found.value, InputError)


@pytest.mark.parametrize(
    "action", ["np.full(7, np.nan)", "np.zeros(6)", "None", "'up'", "[np.inf] * 7"]
)
def test_an_action_that_is_not_allowed_names_the_file(
    action: str, task: Task, tmp_path: Path
) -> None:
    path = python(tmp_path, f"return {action}")
    with pytest.raises(TrocarError, match=r"own\.py: the policy returned .* allowed: 7 finite"):
        run_episode(task, 0, script=PolicyFile(path).script)


def test_a_policy_that_takes_too_long_is_one_error(
    task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trocar.learning.policies.PATIENCE_S", 0.01)
    path = python(tmp_path, "time.sleep(0.02); return np.zeros(7)", "import time")
    with pytest.raises(TrocarError, match=r"own\.py: the policy took 0\.. s for an action"):
        run_episode(task, 0, script=PolicyFile(path).script)


def test_a_served_policy_that_raises_leaves_the_arms_where_they_are(
    task: Task, tmp_path: Path
) -> None:
    path = python(
        tmp_path,
        "count.append(0); return np.full(7, 0.1 / (len(count) < 4))",
        "count = []",
    )
    served = ServedTask(task, 0, script=PolicyFile(path).script, driver="policy own.py")
    loop = Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    for _ in range(500):
        loop.tick()
    assert f"{path}: line 5: ZeroDivisionError" in served.state()["reason"]
    before = task.world.arms["PSM1"].joints.setpoints()
    for _ in range(100):
        loop.tick()
    np.testing.assert_array_equal(task.world.arms["PSM1"].joints.setpoints(), before)
    assert task.world.arms["PSM1"].operating_state().state == "ENABLED"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def make_policy(:", r"own\.py: line 1: is no Python"),
        ("1 / 0", r"own\.py: line 1: ZeroDivisionError"),
        ("def policy(env): pass", r"own\.py: got the functions policy; allowed: with make_policy"),
        ("def make_policy(env):\n    env.fail()", r"own\.py: line 2: AttributeError"),
        ("def make_policy(env):\n    pass", r"make_policy returned None; allowed: a function"),
        ("SETTINGS = 3\ndef make_policy(env): pass", r"own\.py: SETTINGS: got 3; allowed: a dict"),
        ("SETTINGS = {'ob': 3}\ndef make_policy(env): pass", r"own\.py: unknown setting 'ob'"),
        ("SETTINGS = {'obs': 'x'}\ndef make_policy(env): pass", r"own\.py: .*unknown observation"),
        (
            "SETTINGS = {'action': 'orbit-ik'}\ndef make_policy(env): pass",
            r"own\.py: .*did you mean 'orbit-ik-",
        ),
    ],
)
def test_a_broken_policy_in_python_is_one_error(
    text: str, message: str, task: Task, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        PolicyFile(tmp_path / "own.py").script(task)


# ---------------------------------------------------------------------- files that do not fit


def edited(change: Callable[[dict[str, Any]], object], folder: Path, task: Task) -> Path:
    """Write a clone and change its TOML."""
    pytest.importorskip("safetensors", reason=SAFETENSORS)
    path = folder / "clone.toml"
    save_policy(path, clone(task))
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    change(table)
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update(format=2), r"clone\.toml: format: got 2; allowed: 1"),
        (lambda t: t.pop("scene"), r"clone\.toml: scene: got nothing; allowed: str"),
        (lambda t: t.update(kind="clonk"), r"unknown kind 'clonk' \(did you mean 'clone'\?\)"),
        (
            lambda t: t.update(scene="needle-pick"),
            r"trained on the scene needle-pick; got needle-r",
        ),
        (lambda t: t.update(sha256="0"), r"clone\.safetensors: is not the file that was written"),
        (lambda t: t["network"].update(sizes=[3]), r"network\.sizes: got \[3\]; allowed: 2 or"),
        (lambda t: t["network"].update(sizes=[3, 4]), r"tensor layers\.1\.bias: got"),
        (lambda t: t["network"].update(output="tan"), r"unknown activation 'tan'"),
        (lambda t: t["clone"].update(most="all"), r"clone\.most: got 'all'; allowed: int"),
        (
            lambda t: t["clone"].update(length=4),
            r"clone\.toml: network: got .* 21 outputs; allowed",
        ),
        (lambda t: t["clone"]["features"].pop(), r"reads .* features; this version has"),
    ],
)
def test_a_changed_file_is_one_error(
    change: Callable[[dict[str, Any]], object], message: str, task: Task, tmp_path: Path
) -> None:
    path = edited(change, tmp_path, task)
    with pytest.raises(InputError, match=message):
        PolicyFile(path).script(task)


def test_an_actor_of_other_observations_is_one_error(task: Task, tmp_path: Path) -> None:
    pytest.importorskip("safetensors", reason=SAFETENSORS)
    env = TaskEnv(task)
    save_policy(tmp_path / "a.toml", actor(env, "observation", 5))
    with pytest.raises(InputError, match=r"network has 5 inputs and 7 outputs; needle-reach has"):
        PolicyFile(tmp_path / "a.toml").script(task)
    save_policy(tmp_path / "b.toml", actor(env, "goal-difference", 5))
    with pytest.raises(InputError, match=r"actor.inputs: got 'goal-difference' with the observ"):
        PolicyFile(tmp_path / "b.toml").script(task)


def test_an_older_version_is_a_warning(
    task: Task, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = edited(lambda table: table.update(trocar="0.0.1"), tmp_path, task)
    PolicyFile(path)
    assert f"was trained with trocar 0.0.1; this is {__version__}" in caplog.text


def test_missing_safetensors_name_the_extra(
    task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = edited(lambda _: None, tmp_path, task)
    monkeypatch.setitem(sys.modules, "safetensors.numpy", None)
    with pytest.raises(MissingExtraError, match=r"safetensors, which is not installed: pip inst"):
        PolicyFile(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.pt", "is a pickle, whose reading can run any code; allowed: a .py file"),
        ("a.pkl", "is a pickle"),
        ("a.onnx", "is not a policy file; allowed: a .py file"),
        ("none.py", "cannot be read: No such file"),
        ("none.safetensors", r"none\.toml: cannot be read: No such file"),
        ("text.toml", r"text\.toml: is not TOML"),
    ],
)
def test_other_files_are_one_error(name: str, message: str, tmp_path: Path) -> None:
    if not name.startswith("none"):
        (tmp_path / name).write_text("= 3", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        PolicyFile(tmp_path / name)


def test_existing_files_are_not_replaced_unasked(task: Task, tmp_path: Path) -> None:
    path = edited(lambda _: None, tmp_path, task)
    with pytest.raises(InputError, match=r"exists already"):
        save_policy(path, clone(task))
    save_policy(path, clone(task, seed=1), overwrite=True)
    PolicyFile(path)


# ---------------------------------------------------------------------- the command


def trocar(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "trocar", "play", *words],
        capture_output=True,
        text=True,
        timeout=100,
    )


def test_the_command_names_the_policy() -> None:
    done = trocar("needle-reach", "--policy", str(REACH), "--headless", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["policy"], document["successes"]) == ("reach.py", 1)


def test_a_policy_that_fails_is_one_line_and_status_1(tmp_path: Path) -> None:
    path = python(tmp_path, "raise ValueError('no idea')")
    done = trocar("needle-reach", "--policy", str(path), "--headless")
    assert done.returncode == 1
    assert done.stderr.endswith(f"trocar: error: {path}: line 5: ValueError: no idea\n")


def test_a_policy_of_another_scene_is_one_line_and_status_2(task: Task, tmp_path: Path) -> None:
    path = edited(lambda _: None, tmp_path, task)
    done = trocar("needle-pick", "--policy", str(path), "--headless")
    assert done.returncode == 2
    assert "was trained on the scene needle-reach; got needle-pick" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--policy", "scriptd"], "got 'scriptd'; allowed: scripted, none, or a file"),
        (["--trust"], "--trust: has no effect here; allowed with --policy FILE.zip only"),
        (["--policy", "x.py", "--trust"], "allowed with --policy FILE.zip only"),
    ],
)
def test_bad_options_are_one_line_and_status_2(words: list[str], message: str) -> None:
    done = trocar("needle-reach", "--headless", *words)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1

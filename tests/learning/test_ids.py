from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import gymnasium
import pytest

import trocar
from trocar.descriptions.catalogue import names
from trocar.errors import InputError, UnknownNameError
from trocar.learning.ids import IDS, SCENES, register
from trocar.learning.task_env import TaskEnv
from trocar.tasks import Task

ROOT = Path(__file__).parents[2]


def run(code: str, *paths: Path) -> str:
    """Run code in a fresh Python with folders before all others."""
    kept = {**os.environ, "PYTHONPATH": os.pathsep.join(str(path) for path in paths)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_every_scene_has_an_id() -> None:
    assert set(SCENES) == set(names("scenes"))
    assert "trocar/Icra2026PegTransfer-v0" in IDS


def test_ids_are_registered_with_gymnasium() -> None:
    register()
    for name, settings in IDS.items():
        assert gymnasium.spec(name).kwargs == settings


def test_gymnasium_after_trocar_has_the_ids() -> None:
    code = (
        "import sys, trocar; assert 'gymnasium' not in sys.modules; import gymnasium;"
        "print(gymnasium.make('trocar/NeedleReach-v0').spec.id)"
    )
    assert run(code, ROOT / "src") == "trocar/NeedleReach-v0"


def test_the_id_may_name_the_package() -> None:
    code = "import gymnasium; print(gymnasium.make('trocar:SurRoL/NeedleReach-v0').spec.id)"
    assert run(code, ROOT / "src") == "SurRoL/NeedleReach-v0"


def test_gymnasium_alone_has_the_ids_where_trocar_is_installed(tmp_path: Path) -> None:
    built = pytest.importorskip("hatchling.build", reason="builds the wheel")
    code = f"import hatchling.build as b; print(b.build_wheel({str(tmp_path)!r}))"
    wheel = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()[-1]
    assert built
    site = tmp_path / "site"
    zipfile.ZipFile(tmp_path / wheel).extractall(site)
    code = (
        f"import site, sys; site.addsitedir({str(site)!r});"
        "assert not {'trocar', 'gymnasium', 'numpy', 'importlib.util'} & (set(sys.modules) - had);"
        "import gymnasium; assert 'mujoco' not in sys.modules;"
        "env = gymnasium.make('trocar/NeedleReach-v0');"
        "import trocar; print(trocar.__file__)"
    )
    found = run("import sys; had = set(sys.modules);" + code, site)
    assert Path(found).is_relative_to(site)


def test_importing_trocar_imports_no_gymnasium() -> None:
    assert run("import trocar, sys; print('gymnasium' in sys.modules)", ROOT / "src") == "False"


def test_make_takes_scenes_and_ids() -> None:
    assert isinstance(trocar.make("needle-reach"), Task)
    env = trocar.make("SurRoL/NeedleReach-v0", max_steps=20)
    assert isinstance(env, TaskEnv)
    assert env.settings["max_steps"] == 20
    assert env.settings["action"] == "surrol"
    with pytest.raises(UnknownNameError, match=r"did you mean 'trocar/NeedlePick-v0'"):
        trocar.make("trocar/NeedelPick-v0")
    with pytest.raises(InputError, match="needle-reach: got the settings obs; allowed: with the"):
        trocar.make("needle-reach", obs="goal")


@pytest.mark.parametrize("name", [name for name in IDS if not name.startswith("trocar/")])
def test_environments_of_others_step(name: str) -> None:
    env = trocar.make(name)
    env.reset(1)
    for _ in range(2):
        env.step(env.actions.high * 0.1)
    env.close()

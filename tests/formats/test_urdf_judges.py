"""Other people's tools load the URDF of every arm and rig, and find what we say of it."""

from __future__ import annotations

import logging
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from tests.formats.truth import frames_in_world, leading, random_rig_positions
from tests.formats.urdf_readers import (
    Reading,
    by_drake,
    by_mujoco,
    by_pinocchio,
    by_yourdfpy,
)
from trocar.descriptions import names
from trocar.descriptions.calibrated import calibrated_rig
from trocar.descriptions.records import RigDescription
from trocar.formats.export import export, find_rig
from trocar.formats.links import SHARE, LinkModel, joint_values, link_poses, rig_links
from trocar.formats.tip_chain import fit_tips
from trocar.formats.urdf import urdf_tree

pytest.importorskip("lxml", reason="exports need the extra 'export'")

ARMS = names("arms")
RIGS = [name for name in names("rigs") if name not in names("arms")]
SUBJECTS = [*ARMS, *(pytest.param(name, marks=pytest.mark.slow) for name in RIGS)]

#: What the files must hold. Numbers have 12 digits; yourdfpy stores transforms in float64 too.
AGREED_M = 1e-6
#: Links behind a joint that follows two give a share of their mass to the link before them.
AGREED_MASS = 2.0 * SHARE

Reader = Callable[[Path, LinkModel], Reading]
#: Each library with the ending of the file that it reads.
READERS = {
    "mujoco": (by_mujoco, ""),
    "yourdfpy": (by_yourdfpy, ""),
    "pinocchio": (by_pinocchio, ""),
    "drake": (by_drake, "_drake"),
}

#: yourdfpy 0.0.60 calls a method that trimesh 5 means to take away; nothing of the file's.
QUIET = pytest.mark.filterwarnings("ignore:`Scene.dump:DeprecationWarning")


@dataclass(frozen=True, eq=False)
class Exported:
    """A rig and the folder that it was exported to."""

    rig: RigDescription
    model: LinkModel
    folder: Path

    def file(self, ending: str = "") -> Path:
        return self.folder / f"{self.rig.name}{ending}.urdf"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Exported]:
    """Return the function that exports an arm or a rig, once."""
    done: dict[str, Exported] = {}

    def once(name: str) -> Exported:
        if name not in done:
            rig = find_rig(name)
            folder = tmp_path_factory.mktemp(name)
            export(rig, "urdf", folder)
            done[name] = Exported(rig, rig_links(rig), folder)
        return done[name]

    return once


@pytest.fixture
def silence(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Fail when anything was printed or logged, in whatever language."""
    caplog.set_level(logging.WARNING)
    yield
    said = capfd.readouterr()
    assert not caplog.records
    assert (said.out, said.err) == ("", "")


@QUIET
@pytest.mark.usefixtures("silence")
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", SUBJECTS)
def test_every_link_stands_where_the_kinematics_say(name, reader, exported, rng) -> None:
    subject = exported(name)
    read, ending = READERS[reader]
    tree = urdf_tree(subject.model)
    found = read(subject.file(ending), tree)
    moving = [joint for joint in tree.joints if joint.kind != "fixed"]
    assert found.couplings == sum(bool(joint.follows) for joint in moving)
    assert found.free == len(moving) - found.couplings
    for _ in range(10):
        q = random_rig_positions(subject.rig, rng)
        stand = found.stand(leading(subject.model, subject.rig, q))
        for link, pose in frames_in_world(subject.rig, q).items():
            assert np.abs(stand[link] - pose).max() < AGREED_M, link


@QUIET
@pytest.mark.usefixtures("silence")
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", SUBJECTS)
def test_every_link_weighs_what_the_description_says(name, reader, exported) -> None:
    subject = exported(name)
    read, ending = READERS[reader]
    found = read(subject.file(ending), urdf_tree(subject.model))
    wanted = fixed_together(subject.model) if reader == "pinocchio" else bodies(subject.model)
    for link, (mass, com, inertia) in wanted.items():
        if mass == 0.0:
            assert link not in found.bodies or found.bodies[link][0] == 0.0
            continue
        own_mass, own_com, own_inertia = found.bodies[link]
        assert own_mass == pytest.approx(mass, rel=AGREED_MASS)
        assert own_com == pytest.approx(com, abs=1e-9)
        assert np.abs(own_inertia - inertia).max() < AGREED_MASS * np.trace(inertia)
    if reader != "pinocchio":
        total = sum(mass for mass, _, _ in found.bodies.values())
        assert total == pytest.approx(sum(b[0] for b in wanted.values()), rel=1e-9)


@QUIET
@pytest.mark.usefixtures("silence")
@pytest.mark.parametrize("reader", READERS)
def test_a_calibrated_arm_is_off_by_no_more_than_is_said(
    reader, skew_overlay, rng, tmp_path
) -> None:
    rig = calibrated_rig(find_rig("ecm"), skew_overlay("ecm", rng))
    export(rig, "urdf", tmp_path)
    model = rig_links(rig)
    read, ending = READERS[reader]
    found = read(tmp_path / f"ecm{ending}.urdf", urdf_tree(model))
    for _ in range(10):
        q = random_rig_positions(rig, rng)
        own = leading(model, rig, q)
        stand, truth = found.stand(own), frames_in_world(rig, q)
        for link, pose in link_poses(model, joint_values(model, own)).items():
            assert np.abs(stand[link] - pose).max() < AGREED_M
        worst = max(np.linalg.norm(stand[link][:3, 3] - truth[link][:3, 3]) for link in truth)
        assert worst < 1.2 * model.line_errors["ECM"].worst


@pytest.mark.slow
@pytest.mark.usefixtures("silence")
def test_a_chain_fitted_to_the_tip_has_the_tip_several_times_nearer(
    skew_overlay, rng, tmp_path
) -> None:
    rig = calibrated_rig(find_rig("ecm"), skew_overlay("ecm", rng))
    (said,) = export(rig, "urdf", tmp_path, {"fit_tip": True}).warnings
    straight = rig_links(rig)
    model = fit_tips(straight, rig)
    error, before = model.line_errors["ECM"], straight.line_errors["ECM"]
    assert error.tip < 0.5 * before.tip and error.worst < before.worst
    told = f"up to {1e3 * error.tip:.3f} mm and {1e3 * error.tip_angle:.2f} mrad at the tip"
    assert told in said and told in (tmp_path / "README.md").read_text(encoding="utf-8")
    readers = [by_mujoco, *([by_pinocchio] if find_spec("pinocchio") else [])]
    for found in [read(tmp_path / "ecm.urdf", urdf_tree(model)) for read in readers]:
        for _ in range(20):
            q = random_rig_positions(rig, rng)
            stand = found.stand(leading(straight, rig, q))
            off = (stand["ECM_tip"] - frames_in_world(rig, q)["ECM_tip"])[:3, 3]
            assert np.linalg.norm(off) < 1.2 * error.tip
    assert sum(m for m, _, _ in bodies(model).values()) == pytest.approx(
        sum(m for m, _, _ in bodies(straight).values())
    )


def bodies(model: LinkModel) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    return {link.name: (link.mass, link.com, link.inertia) for link in model.links[1:]}


def fixed_together(model: LinkModel) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    """Mass, centre and inertia of each moving link with all that is fixed to it."""
    found = {"world": (0.0, np.zeros(3), np.zeros((3, 3)))} | bodies(model)
    for joint in reversed(model.joints):
        if joint.kind == "fixed":
            mass, com, inertia = found.pop(joint.child)
            turn, shift = joint.pose[:3, :3], joint.pose[:3, 3]
            moved = (mass, turn @ com + shift, turn @ inertia @ turn.T)
            found[joint.parent] = together(found[joint.parent], moved)
    del found["world"]
    return found


def together(one, other):
    mass = one[0] + other[0]
    if mass == 0.0:
        return one
    com = (one[0] * one[1] + other[0] * other[1]) / mass
    inertia = np.zeros((3, 3))
    for m, c, i in (one, other):
        off = c - com
        inertia += i + m * (off @ off * np.eye(3) - np.outer(off, off))
    return mass, com, inertia


@pytest.mark.parametrize("name", SUBJECTS)
def test_check_urdf_finds_every_link_and_nothing_to_say(name, exported) -> None:
    program = shutil.which("check_urdf")
    if program is None:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    subject = exported(name)
    for ending in ("", "_drake"):
        file = subject.file(ending)
        said = subprocess.run([program, file], capture_output=True, text=True, timeout=60)
        assert (said.returncode, said.stderr) == (0, "")
        assert len(re.findall(r"child\(\d+\)", said.stdout)) == len(urdf_tree(subject.model).joints)


def test_drake_warns_of_dry_friction_alone_and_its_own_file_has_none(exported, caplog) -> None:
    subject = exported("psm")
    by_drake(subject.file(), urdf_tree(subject.model))
    assert caplog.records
    assert all("joint friction" in record.getMessage() for record in caplog.records)
    own = subject.file().read_text(encoding="utf-8")
    assert "friction=" in own
    assert "friction=" not in subject.file("_drake").read_text(encoding="utf-8")

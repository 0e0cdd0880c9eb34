"""Props that can be moved, in models and files: whom they touch, and which files have them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.formats.export import export
from trocar.formats.links import rig_links
from trocar.modeling.build import build
from trocar.modeling.geoms import OBJECTS, contact_masks


def test_objects_touch_arms_props_and_each_other_and_nothing_else_changes() -> None:
    rig = load_rig("pegs")
    masks = contact_masks(rig)
    own = masks[OBJECTS]
    for name, mask in masks.items():
        assert own.conaffinity & mask.contype or mask.conaffinity & own.contype, name
    still = contact_masks(load_rig("two_psm_ecm"))
    for name, mask in still.items():
        assert masks[name].contype == mask.contype
        assert masks[name].conaffinity & ~own.contype == mask.conaffinity
    assert OBJECTS not in still


def test_the_solver_takes_objects_apart() -> None:
    off = mujoco.mjtDisableBit.mjDSBL_ISLAND
    assert not build(load_rig("pegs")).mj.opt.disableflags & off
    assert build(load_rig("two_psm_ecm")).mj.opt.disableflags & off


@pytest.mark.parametrize("rig", ["psm", "pegs", "full_cart"])
def test_the_solver_starts_from_its_last_solution(rig: str) -> None:
    assert not build(rig).mj.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART


def test_links_and_joints_leave_objects_out() -> None:
    links = rig_links(load_rig("pegs"))
    names = {link.name for link in links.links}
    assert "board" in names and not names & {"ring1", "block1"}
    assert len(links.joints) == len(links.links) - 1


@pytest.mark.slow
def test_a_file_of_mjcf_has_objects_where_the_simulation_has_them(tmp_path: Path) -> None:
    pytest.importorskip("lxml", reason="files of MJCF are written with lxml")
    rig = load_rig("pegs")
    ours = build(rig).mj
    export(rig, "mjcf", tmp_path / "pegs")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "pegs" / "pegs_pid.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    for prop in rig.objects:
        assert np.allclose(data.body(prop.name).xpos, prop.pose[:3, 3], atol=1e-9)
        here, there = ours.body(prop.name), model.body(prop.name)
        assert np.allclose(here.mass, there.mass, rtol=1e-9)
        assert np.allclose(here.inertia, there.inertia, rtol=1e-6)
    mujoco.mj_step(model, data, nstep=300)
    for prop in rig.objects:
        assert np.allclose(data.body(prop.name).xpos, prop.pose[:3, 3], atol=1e-5)

"""Contacts and divergence name flexes and bodies that no description has, and never another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.simulation.test_sensors import NEAR, TIP, TOUCH, rig_with, touching, wrench
from trocar.descriptions import RigDescription
from trocar.errors import DivergedError
from trocar.modeling.build import RigModel, build
from trocar.modeling.options import ModelOptions
from trocar.simulation import World

MASS = 0.02
#: A sheet that lies on the table of the rig `psm`, off the arm.
TISSUE = f"""
<flexcomp name="tissue" type="grid" dim="2" count="4 4 1" spacing="0.02 0.02 0.02"
          pos="0.15 0.15 0.083" radius="0.002" mass="{MASS}">
  <contact selfcollide="none" contype="255" conaffinity="255"/>
  <edge equality="true"/>
</flexcomp>"""
STRAY = '<body name="stray" pos="-0.2 -0.2 0.5"><freejoint/><geom size="0.01"/></body>'
TRAY = '<body pos="-0.2 -0.2 0.5"><joint name="tray" type="slide"/><geom size="0.01"/></body>'

WithMore = Callable[[str], None]


@pytest.fixture
def with_more(monkeypatch: pytest.MonkeyPatch) -> WithMore:
    """Make worlds that have more in them than their rig describes."""

    def add(xml: str) -> None:
        def build_more(rig: RigDescription, options: ModelOptions) -> RigModel:
            model = build(rig, options)
            more = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{xml}</worldbody></mujoco>")
            frame = model.spec.worldbody.add_frame()
            model.spec.attach(more, frame=frame, prefix="lab_")
            return replace(model, mj=model.spec.compile())

        monkeypatch.setattr("trocar.simulation.world.build", build_more)

    return add


def test_contacts_name_the_flex_that_lies_on_the_table(with_more: WithMore) -> None:
    with_more(TISSUE)
    world = World("psm")
    world.step(500)
    table = world.contact_table()
    listed = world.contacts().contacts
    assert {(c.body, c.other) for c in listed} == {("table", "lab_tissue")}
    assert {(c.shape, c.other_shape) for c in listed} == {("table/0", "lab_tissue")}
    pairs = [tuple(table.names[k] for k in row) for row in table.bodies]
    assert pairs == [(c.body, c.other) for c in listed]
    np.testing.assert_allclose(table.forces, [c.force for c in listed], atol=1e-12)
    load = sum(c.force for c in listed)
    np.testing.assert_allclose(load, [0.0, 0.0, -9.81 * MASS], atol=1e-4)  # it still settles


def test_what_touches_a_flex_is_no_contact_of_an_arm(with_more: WithMore, tmp_path: Path) -> None:
    with_more(TISSUE)
    world = World(rig_with(tmp_path, TOUCH + TIP + NEAR))
    world.step(200)
    assert world.contacts().contacts
    assert touching(world).contacts == ()
    assert not wrench(world).force.any()


def test_an_arm_that_presses_on_a_flex_names_it(with_more: WithMore, tmp_path: Path) -> None:
    with_more(TISSUE.replace("0.15 0.15 0.083", "0 0 0.083"))
    world = World(rig_with(tmp_path, TOUCH + TIP))
    world.set_state("PSM1", np.array([0.0, 0.0, 0.2235, 0.0, 0.0, 0.0, 0.0]))
    world.step(20)
    felt = touching(world).contacts
    assert "lab_tissue" in {c.other for c in felt}
    assert {c.body.split("/")[0] for c in felt} == {"PSM1"}
    push = np.linalg.norm(sum(c.force for c in felt))
    assert push > 0.0
    assert np.linalg.norm(wrench(world).force) == pytest.approx(push, rel=1e-9)


@pytest.mark.parametrize(
    ("xml", "joint", "moving"),
    [
        (TISSUE.replace("255", "0"), None, "lab_tissue"),
        (STRAY, None, "lab_stray"),
        (STRAY.replace('name="stray"', ""), None, "body"),
        (TRAY, "lab_tray", "body"),
    ],
)
def test_a_divergence_of_what_no_rig_describes_is_an_error_with_its_time(
    xml: str,
    joint: str | None,
    moving: str,
    with_more: WithMore,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it runs
    with_more(xml)
    world = World("psm")
    world.step(100)
    last = world.mj_model.njnt - 1
    world.mj_data.qvel[int(world.mj_model.jnt_dofadr[last])] = np.nan
    with pytest.raises(DivergedError) as caught:
        world.step()
    error = caught.value
    assert error.time == pytest.approx(0.1, abs=2e-3)
    assert error.target is None
    assert error.joint == (joint or str(last))
    assert f"of {moving}" in str(error) and "is not finite" in str(error)

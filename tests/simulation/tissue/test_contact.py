"""Fingers that press tissue and pads that grip it: against the whole mesh, Hertz, and walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.tissue.test_tissues import TEXT, described
from trocar.descriptions.catalogue import load_scene
from trocar.errors import DivergedError
from trocar.geometry.se3 import transform
from trocar.modeling.tissues import PLACES
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.simulation.tissue.contact import TissueSurface, compliance_of, press, underside
from trocar.simulation.tissue.elastic import pad_of
from trocar.simulation.tissue.tissues import SoftTissue, default_plan
from trocar.tasks.suturing.planning import TipWorkspace

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def world() -> World:
    """The scene's rig with a coarse tissue that tears at 5 N."""
    rig = load_scene("suturing").rig
    props = [
        replace(p, tissue=replace(p.tissue, element=1.5e-3, tear=5.0)) if p.tissue else p
        for p in rig.props
    ]
    return World(replace(rig, props=tuple(props)))


class Finger:
    """PSM1 with its jaw pointing straight down on the tissue.

    Args:
        world: with the arm
        x, y: below the tip, in the tissue's frame [m]
        turn: of the fingers about the vertical [rad]
    """

    def __init__(self, world: World, x: float, y: float, jaw: float, turn: float = 0.0) -> None:
        world.reset()
        self.world, self.arm, self.reach = world, world.arms["PSM1"], TipWorkspace(world, "PSM1")
        self.tissue: SoftTissue = world.tissues["pad"]
        across, down = np.array([-np.sin(turn), np.cos(turn), 0.0]), np.array([0.0, 0.0, -1.0])
        facing = np.column_stack([np.cross(across, down), across, down])
        self.at = transform(facing, self.tissue.pose[:3, 3] + [x, y, 0.03])
        start, self.jaw = self.arm.joints.setpoints()[:-1], jaw
        q = self.reach.all(self.at)[0]
        for k in range(100):
            self.drive(start + (q - start) * (k + 1) / 100)

    def drive(self, q: Array | None = None) -> None:
        """Command joint positions, those of the tip's set-point when omitted, for 5 ms."""
        found = self.reach.near(self.at, self.arm.joints.setpoints()[:-1]) if q is None else q
        assert found is not None
        self.arm.servo_jp(found)
        assert self.arm.jaw is not None
        self.arm.jaw.servo_jp([self.jaw])
        self.world.step(5)

    def low(self) -> float:
        """Return the height of the lowest corner of both fingers above the surface at rest [m]."""
        model, data = self.world.mj_model, self.world.mj_data
        return min(
            float(
                data.geom(f"PSM1/{side}/2").xpos[2]
                - np.abs(data.geom(f"PSM1/{side}/2").xmat.reshape(3, 3)[2])
                @ model.geom(f"PSM1/{side}/2").size
                - self.tissue.pose[2, 3]
            )
            for side in ("finger_left", "finger_right")
        )

    def down(self, height: float, speed: float) -> Iterator[float]:
        """Move the lowest corner to a height [m] at a speed [m/s]; yield after each 5 ms."""
        way = self.low() - height
        for _ in range(int(abs(way) / (speed * 0.005))):
            self.at[2, 3] -= np.sign(way) * speed * 0.005
            self.drive()
            yield self.low()
        for _ in range(20):
            self.drive()
            yield self.low()


def test_pressing_opens_every_gap_and_pulls_nowhere() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        factor = rng.normal(size=(30, 30))
        compliance, gaps = factor @ factor.T + 0.1 * np.eye(30), rng.normal(size=30)
        forces = press(compliance, gaps)
        after = gaps + compliance @ forces
        assert (forces >= 0.0).all()
        assert after.min() > -1e-6
        assert np.abs(forces * after).max() < 1e-6


def test_the_underside_of_a_box_is_that_of_a_level_and_of_a_tilted_one() -> None:
    at = np.array([[0.0, 0.0], [0.9, 0.0], [1.1, 0.0]])
    half = np.array([1.0, 1.0, 0.5])
    level = underside(at, np.array([0.0, 0.0, 3.0]), np.eye(3), half)
    assert level == pytest.approx([2.5, 2.5, np.inf])
    c = s = np.sqrt(0.5)
    tilted = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    low = underside(at[:1], np.array([0.0, 0.0, 3.0]), tilted, half)
    assert low == pytest.approx([3.0 - 0.5 / c])


def test_a_sphere_sinks_into_a_deep_block_as_the_mesh_and_hertz_have_it() -> None:
    """With places held by nothing but the mesh; to 3 % of the mesh, 15 % of Hertz."""
    text = TEXT.replace("depth_mm = 6", "depth_mm = 10").replace("length_mm = 20", "length_mm = 14")
    tissue = described(text.replace("element_mm = 1.5", "element_mm = 1"))
    pad, radius, deep = pad_of(tissue), 5e-3, 3e-4
    condensed = pad.condense(default_plan(tissue)[0])
    surface = TissueSurface(tissue, pad, condensed.response, condensed.stiffness)
    middle = np.array([0.0, 0.5 * tissue.gap + 0.5 * tissue.width])
    free = surface.compliance[0] + surface.rise[0] @ np.linalg.inv(condensed.stiffness) @ (
        surface.rise[0].T
    )
    flat = np.linalg.norm(surface.at[0] - middle, axis=1)
    under = flat < radius
    bottom = radius - deep - np.sqrt(radius**2 - flat[under] ** 2)
    forces = press(free[np.ix_(under, under)], bottom)
    loads = np.zeros((len(pad.nodes), 3))
    loads[surface.nodes[0][under], 2] = -forces
    moved = pad.solve(loads.ravel()).reshape(-1, 3)[surface.nodes[0][under], 2]
    assert (moved <= bottom + 0.03 * deep).all()
    assert moved[forces > 0.0] == pytest.approx(bottom[forces > 0.0], abs=0.03 * deep)
    stiff = tissue.modulus / (1.0 - tissue.poisson**2)
    assert forces.sum() == pytest.approx(4.0 / 3.0 * stiff * radius**0.5 * deep**1.5, rel=0.15)


def test_the_compliance_of_a_surface_is_that_of_a_load_on_any_of_its_nodes() -> None:
    tissue = described(TEXT)
    pad, (top, compliance) = pad_of(tissue), compliance_of(tissue)
    for node in np.random.default_rng(3).choice(len(top), 8, replace=False):
        load = np.zeros(3 * len(pad.nodes))
        load[3 * top[node] + 2] = 1.0
        assert pad.solve(load)[3 * top + 2] == pytest.approx(compliance[:, node], rel=1e-9)


@pytest.mark.parametrize("speed", [0.02, 0.1])
def test_a_jaw_does_not_pass_through_tissue(world: World, speed: float) -> None:
    finger = Finger(world, 0.004, 0.007, 0.0)
    tissue, model, data = finger.tissue, world.mj_model, world.mj_data
    for low in finger.down(-3e-3, speed):
        if tissue.read().pressed > 0.5:
            heights = tissue.displacements()[:, 2]
            assert heights.min() < low + 0.15 * speed * 0.005 + 1e-4  # as of the last step
    read = tissue.read()
    assert 1.0 < read.pressed < 6.0
    fingers = [model.body(f"PSM1/{side}").id for side in ("finger_left", "finger_right")]
    assert data.xfrc_applied[fingers, 2].sum() == pytest.approx(read.pressed)
    assert world.contact_forces()["PSM1"][2] == pytest.approx(read.pressed)
    for _ in finger.down(0.01, 0.1):
        pass
    assert tissue.read().pressed == 0.0
    assert not data.xfrc_applied[fingers].any()
    assert not world.contact_forces()["PSM1"].any()


def test_a_saved_state_goes_on_to_the_last_bit_and_worlds_repeat(world: World) -> None:
    """With a finger in the tissue, and a force on a place of it."""

    def run() -> Array:
        finger = Finger(world, 0.002, 0.006, 0.0)
        place = world.mj_model.body("pad/0/entry").id
        world.mj_data.xfrc_applied[place, :3] = 0.1, 0.4, -0.3
        for _ in finger.down(-1.5e-3, 0.1):
            pass
        world.step(3)
        saved = world.save()
        world.step(40)
        row = world.save().row
        world.load(saved)
        world.step(40)
        assert np.array_equal(world.save().row, row)
        world.mj_data.xfrc_applied[place] = 0.0
        return row

    assert np.array_equal(run(), run())


def test_pads_that_close_in_tissue_take_it_along_until_they_open_or_it_slips(world: World) -> None:
    heard: list[Entry] = []

    def hear(entry: Entry) -> None:
        if entry.source == "pad":
            heard.append(entry)

    finger = Finger(world, 0.003, 0.005, 0.7)
    for _ in finger.down(-2.5e-3, 0.1):
        pass
    stop = world.listen(hear)
    finger.jaw = -0.3
    for _ in range(60):
        finger.drive()
    assert [entry.name for entry in heard] == ["grip"]
    for _ in range(45):
        finger.at[2, 3] += 1e-4
        finger.drive()
    (force,) = finger.tissue.read().gripped.values()
    assert force[2] < -0.3  # it pulls the jaw back down
    assert finger.tissue.displacements()[:, 2].max() > 4e-4
    finger.jaw = 0.5
    for _ in range(40):
        finger.drive()
    assert not finger.tissue.read().gripped
    for _ in finger.down(-2.5e-3, 0.1):
        pass
    finger.jaw = -0.3
    for _ in range(60):
        finger.drive()
    assert finger.tissue.read().gripped
    for _ in finger.down(0.02, 0.1):
        pass
    stop()
    assert [entry.name for entry in heard][-1] == "slip"
    assert float(str(heard[-1].values["force"])) > finger.tissue.tissue.tear
    assert not finger.tissue.read().gripped


@pytest.mark.parametrize("seed", range(3))
def test_random_motion_of_a_jaw_in_tissue_does_not_diverge(world: World, seed: int) -> None:
    rng = np.random.default_rng(seed)
    finger = Finger(world, 0.0, 0.006, 0.2, float(rng.uniform(-1.0, 1.0)))
    for _ in finger.down(0.0, 0.1):
        pass
    start = finger.at[:3, 3].copy()
    for _ in range(4):
        finger.jaw = float(rng.uniform(-0.3, 0.6))
        goal = start + rng.uniform([-8e-3, -6e-3, -4e-3], [8e-3, 6e-3, 2e-3])
        for _ in range(20):
            way = goal - finger.at[:3, 3]
            finger.at[:3, 3] += way * min(1.0, 5e-4 / max(float(np.linalg.norm(way)), 1e-9))
            finger.drive()
    assert np.isfinite(world.mj_data.qpos).all()
    assert np.abs(finger.tissue.displacements()).max() < finger.tissue.tissue.depth


def test_tissue_that_is_turned_inside_out_is_an_error_with_element_and_time(world: World) -> None:
    world.reset()
    tissue = world.tissues["pad"]
    tissue.set_cp(tissue.pose, stiffness=0.05)
    places = [world.mj_model.body(f"pad/0/{place}").id for place in PLACES[:4]]

    def pull() -> None:
        for k in range(100):
            world.mj_data.xfrc_applied[places, 2] = 0.03 * k
            world.step(5)

    with pytest.raises(DivergedError, match=r"elements are turned inside out.* element \d+ at"):
        pull()
    world.mj_data.xfrc_applied[:] = 0.0

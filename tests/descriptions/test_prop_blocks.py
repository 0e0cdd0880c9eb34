"""Joints, bands, surfaces and scripts of props: what a file may not say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.records import RigDescription
from trocar.errors import DescriptionError
from trocar.recording.metadata import rig_fingerprint

HEAD = """
[[prop]]
name = "post"
shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [10, 10, 10] }]
"""
BALL = '{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10%s }'
BOB = '[[prop]]\nname = "bob"\nmovable = true\nmass_g = 5\nshape = [{ball}]\n{more}\n'
BAND = '[[band]]\nname = "b"\nrest_length_mm = 10\nstiffness_n_per_m = 5\n'
ENDS = 'point = [{ prop = "post" }, { prop = "bob" }]\n'


def rig_with(folder: Path, more: str) -> RigDescription:
    text = Path(load_rig("psm").file).read_text(encoding="utf-8")
    file = folder / "mine.toml"
    file.write_text(text + HEAD + more, encoding="utf-8")
    return load_rig(file)


def bob(more: str = "", ball: str = BALL % "") -> str:
    return BOB.format(ball=ball, more=more)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (
            bob('joint = { kind = "screw" }'),
            r"joint.kind: got 'screw'; allowed: hinge, slide, ball",
        ),
        (
            bob('joint = { kind = "hinge", on = "pots" }'),
            r"joint.on: got 'pots'; .* allowed: world, .*post",
        ),
        (
            bob('joint = { kind = "hinge", axis = [0, 0, 0] }'),
            r"axis: got \[0.0, 0.0, 0.0\]; allowed: a dir",
        ),
        (
            bob('joint = { kind = "hinge", lower_deg = 5, upper_deg = 9 }'),
            "lower: got 0.087.*around 0",
        ),
        (bob('joint = { kind = "slide", damping_nms = 1 }'), "joint.damping_nms: unknown key"),
        (
            bob('joint = { kind = "slide", damping_ns_per_m = -1 }'),
            "damping: got -1; allowed: 0 or more",
        ),
        (bob('joint = { kind = "ball", lower_deg = -5 }'), "lower_deg: unknown key"),
        (bob('before_step = "no.py"'), "before_step: got 'no.py'; allowed: a Python file"),
        (bob(ball=BALL % ", friction = -0.1"), "friction: got -0.1; allowed: 0 or more"),
        (bob(ball=BALL % ", stiffness_n_per_m = 0"), "stiffness: got 0; allowed: above 0"),
        (bob(ball=BALL % ", density_kg_per_m3 = 0"), "density: got 0; allowed: above 0"),
        (bob(ball=BALL % ", density_kg_per_m3 = 9"), "mass: contradicts the density of a shape"),
        (
            bob(ball=BALL % ", density_kg_per_m3 = 9, weigh = false"),
            "density: contradicts weigh = false",
        ),
        (
            bob(ball=f"{BALL % ', density_kg_per_m3 = 9'}, {BALL % ''}").replace("mass_g = 5", ""),
            "got a density of 1 of 2 shapes that weigh; allowed: of all",
        ),
        ('[[prop]]\nname = "p"\njoint = { kind = "ball" }\n', "movable: is missing; .* no joint"),
        (
            f'[[prop]]\nname = "p"\nshape = [{BALL % ", density_kg_per_m3 = 9"}]\n',
            "movable: is missing; .* no density",
        ),
        (
            bob() + BAND + 'point = [{ prop = "post" }, { prop = "bib" }]',
            r"got 'bib'; allowed: .*bob",
        ),
        (bob() + BAND + 'point = [{ prop = "bob" }]', "point: got 1; allowed: two points"),
        (bob() + BAND + 'point = [{ prop = "post" }, { prop = "post" }]', "that stand still"),
        (bob() + BAND.replace("5", "0") + ENDS, "stiffness: got 0; allowed: above 0"),
        (bob() + BAND.replace("10", "0") + ENDS, "rest_length: got 0; allowed: above 0"),
        (bob() + 2 * (BAND + ENDS), "got 'b' a second time"),
        ('[[sensor]]\nname = "s"\nkind = "tension"\nband = "b"\n', "no such band; allowed: none"),
        ('[[sensor]]\nname = "s"\nkind = "imu"\nprop = "pots"\n', "got 'pots'; .* allowed: .*post"),
        ('[[sensor]]\nname = "s"\nkind = "imu"\narm = "PSM1"\nprop = "post"\n', "contradicts arm"),
    ],
)
def test_a_fault_is_one_clear_error(more: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=problem):
        rig_with(tmp_path, more)


def test_shapes_of_two_densities_weigh_as_the_sum_of_both(tmp_path: Path) -> None:
    shapes = (
        '{ kind = "box", center_mm = [10, 0, 0], size_mm = [20, 20, 20], density_g_per_cm3 = 1 },'
        '{ kind = "box", center_mm = [-10, 0, 0], size_mm = [20, 20, 20], density_g_per_cm3 = 3 }'
    )
    (found,) = rig_with(tmp_path, bob(ball=shapes).replace("mass_g = 5", "")).objects
    assert found.movable is not None
    assert found.movable.mass == pytest.approx(0.032)
    assert np.allclose(found.movable.com, [-0.005, 0.0, 0.0])
    own = 4e-4 / 6.0  # of a cube of 1 kg
    across = 0.032 * own + 0.008 * 0.015**2 + 0.024 * 0.005**2
    assert np.allclose(np.diag(found.movable.inertia), [0.032 * own, across, across])


def test_a_changed_script_is_another_rig(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def before_step(object, world): pass\n")
    first = rig_fingerprint(rig_with(tmp_path, bob('before_step = "a.py"')))
    (tmp_path / "a.py").write_text("def before_step(object, world): object.set_jp(0)\n")
    assert rig_fingerprint(rig_with(tmp_path, bob('before_step = "a.py"'))) != first

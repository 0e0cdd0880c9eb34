"""Props that can be moved: what they weigh, and what a description of one may not be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.records import RigDescription
from trocar.errors import DescriptionError
from trocar.recording.metadata import rig_fingerprint
from trocar.simulation import World

BOX = 'shape = [{ kind = "box", center_mm = [1, 2, 3], size_mm = [10, 20, 30] }]'
FLAT = """solid flat
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 10 0 0
vertex 0 10 0
endloop
endfacet
endsolid flat
"""


def rig_with(folder: Path, prop: str) -> RigDescription:
    text = Path(load_rig("psm").file).read_text(encoding="utf-8")
    (folder / "flat.stl").write_text(FLAT)
    (folder / "mine.toml").write_text(f"{text}\n[[prop]]\n{prop}\n", encoding="utf-8")
    return load_rig(folder / "mine.toml")


def test_an_object_weighs_what_its_shape_does_at_its_mass(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, f'name = "block"\nmovable = true\nmass_g = 6\n{BOX}')
    (prop,) = rig.objects
    assert prop.movable is not None and prop.movable.inertia_from == "shape"
    assert prop.movable.mass == pytest.approx(0.006)
    assert np.allclose(prop.movable.com, [0.001, 0.002, 0.003])
    a, b, c = 0.01, 0.02, 0.03
    expected = 0.006 / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert np.allclose(prop.movable.inertia, expected, rtol=1e-12)
    model = World(rig).mj_model
    body = model.body("block")
    assert float(body.mass[0]) == pytest.approx(0.006)
    assert np.allclose(np.sort(body.inertia), np.sort(np.diag(expected)), rtol=1e-9)


def test_a_drawn_solid_gives_an_object_its_inertia(tmp_path: Path) -> None:
    prop = 'name = "link"\nmovable = true\nmass_kg = 0.5\nsolid = "psm/yaw"\ntouches = true'
    (found,) = rig_with(tmp_path, prop).objects
    assert found.movable is not None and found.movable.inertia_from == "solid"
    assert np.linalg.eigvalsh(found.movable.inertia).min() > 0.0


def test_a_file_of_its_own_may_give_an_object_its_mass(tmp_path: Path) -> None:
    (tmp_path / "thing.toml").write_text(
        'schema = 1\nname = "thing"\n'
        f'[[body]]\nframe = "thing"\nmass_kg = 0.3\n{BOX}\n'
        f'[[body]]\nframe = "thing"\nmass_kg = 0.1\n{BOX.replace("[1, 2, 3]", "[1, 2, 43]")}\n'
    )
    text = 'name = "thing"\ndescription = "thing.toml"\nmovable = true'
    movable = rig_with(tmp_path, text).objects[0].movable
    assert movable is not None and movable.mass == pytest.approx(0.4)
    assert np.allclose(movable.com, [0.001, 0.002, 0.013])
    half = rig_with(tmp_path, f"{text}\nmass_kg = 0.2").objects[0].movable
    assert half is not None and half.mass == 0.2
    assert np.allclose(half.inertia, 0.5 * movable.inertia)


def test_a_rig_without_objects_is_the_rig_that_it_was(tmp_path: Path) -> None:
    still = rig_with(tmp_path, f'name = "block"\n{BOX}')
    assert still.objects == () and still.props[-1].movable is None
    moves = rig_with(tmp_path, f'name = "block"\nmovable = true\nmass_g = 6\n{BOX}')
    heavier = rig_with(tmp_path, f'name = "block"\nmovable = true\nmass_g = 7\n{BOX}')
    assert len({rig_fingerprint(rig) for rig in (still, moves, heavier)}) == 3


@pytest.mark.parametrize(
    ("prop", "problem"),
    [
        (f'name = "a"\nmovable = true\n{BOX}', r"mass: is missing; allowed keys: mass_kg, mass_g"),
        (f'name = "a"\nmovable = true\nmass_kg = 0\n{BOX}', "got 0; allowed: above 0"),
        (f'name = "a"\nmass_kg = 1\n{BOX}', "movable: is missing; a prop that stands still"),
        (f'name = "a"\nmovable = 1\nmass_kg = 1\n{BOX}', "movable: got 1; allowed: true, false"),
        (
            'name = "a"\nmovable = true\nmass_kg = 1\n'
            + BOX.replace(" }", ", collide = false }"),
            "no shape of the prop collides and it would fall through everything",
        ),
        (
            'name = "a"\nmovable = true\nmass_kg = 1\nshape = [{ kind = "mesh", file = "flat.stl",'
            " collide = true }]",
            "inertia_kgm2: is missing, and there is no shape to compute it from",
        ),
        (
            'name = "a"\nmovable = true\nmass_kg = 1\ninertia_kgm2 = [1, 1, 1, 0, 0, 0]\n'
            'shape = [{ kind = "mesh", file = "flat.stl", collide = true }]',
            "the mesh 'flat' that collides is flat and has no volume",
        ),
        (
            f'name = "a"\nmovable = true\nmass_kg = 1\ninertia_kgm2 = [1, 1, 3, 0, 0, 0]\n{BOX}',
            "no possible body",
        ),
        (f'name = "a b"\nmovable = true\nmass_kg = 1\n{BOX}', "allowed for a movable prop"),
        (f'name = "PSM1"\nmovable = true\nmass_kg = 1\n{BOX}', "an arm or the world itself"),
        (f'name = "world"\nmovable = true\nmass_kg = 1\n{BOX}', "an arm or the world itself"),
    ],
)  # fmt: skip
def test_a_fault_in_a_movable_prop_is_named(prop: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=problem) as caught:
        rig_with(tmp_path, prop)
    assert caught.value.file.endswith("mine.toml") and "prop" in caught.value.key


def test_a_shape_may_have_a_free_colour(tmp_path: Path) -> None:
    shape = 'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 5, color = "#B8352f" }]'
    world = World(rig_with(tmp_path, f'name = "bead"\nmovable = true\nmass_g = 1\n{shape}'))
    (record,) = (each for each in world.shapes() if each.name.startswith("bead"))
    assert np.allclose(record.rgba, [0xB8 / 255, 0x35 / 255, 0x2F / 255, 1.0])

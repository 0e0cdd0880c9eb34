"""Setup joints, cart and table as solids: on their axes, clear of each other, within budget."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")


from tests.tools.cad.solids import links_of, off_axis, parts, shared
from tools.cad import kit, table
from tools.cad.links import Link, drawn
from tools.cad.sets import solid_sets

# Whole arms are drawn.
pytestmark = pytest.mark.slow

ARMS = ("suj_psm1", "suj_psm3", "suj_ecm")
SI = ("suj_si_psm1", "suj_si_psm3", "suj_si_ecm")


@pytest.mark.parametrize(
    ("name", "kind", "budget"),
    [
        *((arm, "suj", 6000) for arm in ARMS),
        *((arm, "suj_si", 7000) for arm in SI),
        ("cart", "cart", 8000),
        ("cart_si", "cart_si", 8000),
        ("table", "table", 3000),
    ],
)
def test_every_part_is_a_closed_solid_and_the_budget_is_kept(name, kind, budget):
    count = 0
    for link in links_of(name):
        assert all(part.solid.is_valid for part in link.parts)
        made = drawn(link, solid_sets()[kind].fineness)
        count += sum(len(piece.faces) for piece in made.visual)
        assert all(len(piece.faces) <= 64 for piece in made.convex)
    assert count <= budget


@pytest.mark.parametrize("name", [*ARMS, *SI])
def test_each_link_turns_about_its_own_axis_and_carries_the_next(name):
    arm = load_arm(name)
    chain = links_of(name)

    def stands_off(link: Link, pose: np.ndarray) -> float:
        return off_axis(parts(link), 1e3 * pose[:3, 3], pose[:3, 2])

    for link, following in zip(chain, [*chain[1:], None], strict=True):
        at = poses(arm.mechanism, np.zeros(len(arm.mechanism.joints)), relative_to=link.frame)
        if link.frame != "suj_1":
            assert stands_off(link, at[link.frame]) < 1e-6, link.name
        if following:
            assert stands_off(link, at[following.frame]) < 1e-6, (link.name, following.name)


@pytest.mark.parametrize("name", ARMS)
def test_the_arm_bases_stand_on_what_is_drawn_for_them(name):
    """The PSM's foot lies 158 mm below its base's frame, the ECM's 101.5 mm."""
    arm, last = load_arm(name), links_of(name)[-1]
    at = poses(arm.mechanism, np.zeros(len(arm.mechanism.joints)), relative_to=last.frame)
    down = 101.5 if name == "suj_ecm" else 158.0
    back = np.array([0.0, -14.0, -down - 0.5]) if name == "suj_ecm" else None
    point = back if back is not None else np.array([0.0, -283.5, -down - 0.7])
    spot = 1e3 * at["mount"][:3, 3] + at["mount"][:3, :3] @ point
    held = [s for p in last.parts if p.material == "casting" for s in p.solid.solids()]
    assert any(solid.is_inside(tuple(spot)) for solid in held)


@pytest.mark.parametrize("name", [*ARMS, *SI])
def test_neighbours_are_clear_where_the_cart_starts(name):
    arm, links = load_arm(name), links_of(name)
    at = poses(arm.mechanism, arm.pose("simulated"), relative_to=arm.root)
    where = [[p.solid.moved(kit.location(at[k.frame])) for p in k.parts] for k in links]
    for a, b in combinations(range(len(links)), 2):
        volume = sum(shared(x, y) for x in where[a] for y in where[b])
        assert volume < 1e-3, (links[a].name, links[b].name)


@pytest.mark.parametrize("kind", ["suj", "suj_si"])
def test_the_arms_of_psm1_and_psm2_are_the_same(kind):
    other, first = links_of(f"{kind}_psm2"), links_of(f"{kind}_psm1")
    assert [k.name for k in other] == [k.name for k in first]
    for a, b in zip(other, first, strict=True):
        for one, two in zip(a.parts, b.parts, strict=True):
            assert one.solid.bounding_box().diagonal == pytest.approx(
                two.solid.bounding_box().diagonal, rel=1e-9
            )


def test_carriages_slide_beside_the_column_and_not_through_it():
    """Wherever they are: a carriage's outline and the column's do not meet."""
    rig = load_rig("full_cart")
    (stand,) = links_of("cart")
    column = next(p.solid for p in stand.parts if p.material == "joint").bounding_box()
    for arm in (a for a in rig.arms if a.arm.type == "SUJ"):
        at = poses(arm.arm.mechanism, np.zeros(len(arm.arm.joints)), relative_to=arm.arm.root)
        carriage = links_of(arm.arm.name)[0]
        for part in carriage.parts:
            box = part.solid.moved(kit.location(at["suj_1"])).bounding_box()
            apart = (
                box.min.X > column.max.X
                or box.max.X < column.min.X
                or box.min.Y > column.max.Y
                or box.max.Y < column.min.Y
            )
            assert apart, (arm.name, part.material)


def test_the_tables_top_is_what_the_arms_may_touch():
    (one,) = links_of("table")
    (slab,) = one.convex
    cushions = next(p.solid for p in one.parts if p.material == "drape").bounding_box()
    assert slab.bounding_box().max.Z == pytest.approx(cushions.max.Z) == pytest.approx(table.TOP)
    assert pytest.approx(cushions.size.Y) == slab.bounding_box().size.Y


@pytest.mark.parametrize(("name", "carried"), [("suj_psm1", "psm"), ("suj_ecm", "ecm")])
def test_what_holds_an_arm_does_not_run_through_its_base(name, carried):
    base = next(k for k in links_of(carried) if k.frame == "base")
    arm, last = load_arm(name), links_of(name)[-1]
    at = poses(arm.mechanism, np.zeros(len(arm.mechanism.joints)), relative_to=last.frame)
    stands = [part.solid.moved(kit.location(at["mount"])) for part in base.parts]
    held = sum(shared(a, p.solid) for a in stands for p in last.parts)
    assert held < 20.0  # at most a hair of the foot in its seat [mm^3]

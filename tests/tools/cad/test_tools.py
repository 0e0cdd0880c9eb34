"""The instruments as solids: on the axes of the description, clear of each other; jaws meet."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.errors import InputError
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")

from build123d import Plane
from build123d.topology import Shape

from tests.tools.cad.solids import off_axis, parts, shared
from tools.cad import tools
from tools.cad.links import Link, drawn
from tools.cad.sets import solid_sets

# Whole arms are drawn.
pytestmark = pytest.mark.slow

#: Of each family one: the others have longer shafts.
FAMILIES = [name for name in names("tools") if ":400" in name]
FINENESS = solid_sets()["tools"].fineness
BUDGET = 5500


@cache
def arm_with(tool: str):
    return load_arm("psm", tool)


@cache
def drawn_links(tool: str) -> tuple[Link, ...]:
    return tools.links(arm_with(tool))


def frames_in(arm, link: Link) -> dict[str, np.ndarray]:
    return poses(arm.mechanism, np.zeros(len(arm.mechanism.joints)), relative_to=link.frame)


def placed(arm, links: tuple[Link, ...], **q: float) -> dict[str, list[Shape]]:
    """Every part where the joints put it, by link."""
    at = poses(arm.mechanism, [q.get(n, 0.0) for n in arm.mechanism.joint_names], "insertion")
    where = {
        link.name: Plane(
            origin=tuple(1e3 * at[link.frame][:3, 3]),
            x_dir=tuple(at[link.frame][:3, 0]),
            z_dir=tuple(at[link.frame][:3, 2]),
        ).location
        for link in links
    }
    return {link.name: [p.solid.moved(where[link.name]) for p in link.parts] for link in links}


@pytest.mark.parametrize("tool", FAMILIES)
def test_every_part_is_a_closed_solid_and_the_tool_keeps_its_budget(tool):
    count = 0
    for link in drawn_links(tool):
        for part in link.parts:
            assert part.solid.is_valid
            assert all(s.volume > 0.0 and s.is_manifold for s in part.solid.solids())
        made = drawn(link, FINENESS)
        count += sum(len(piece.faces) for piece in made.visual)
        assert all(len(piece.faces) <= 64 for piece in made.convex)
    assert count <= BUDGET


@pytest.mark.parametrize("tool", FAMILIES)
def test_shaft_wrist_and_fingers_turn_about_the_frames(tool):
    arm = arm_with(tool)
    links = {link.frame: link for link in drawn_links(tool)}
    for frame, axes in {
        "roll": ("roll", "wrist_pitch"),
        "wrist_pitch": ("wrist_pitch", "wrist_yaw"),
        "wrist_yaw": ("wrist_yaw",),
        "finger_left": ("wrist_yaw",),
        "finger_right": ("wrist_yaw",),
    }.items():
        at = frames_in(arm, links[frame])
        for axis in axes:
            T = at[axis]
            away = off_axis(parts(links[frame]), 1e3 * T[:3, 3], T[:3, 2])
            assert away < 1e-6, (frame, axis)


@pytest.mark.parametrize("tool", FAMILIES)
def test_the_jaws_meet_and_do_not_run_into_each_other(tool):
    arm = arm_with(tool)
    left, right = drawn_links(tool)[-2:]
    for opening in (0.0, 0.8):
        at = placed(arm, (left, right), jaw=opening)
        pairs = [(a, b) for a in at[left.name] for b in at[right.name]]
        assert sum(shared(a, b) for a, b in pairs) < 1e-3
        if opening == 0.0:
            assert any(a.distance_to(b) < 0.11 for a, b in pairs)  # the air between the pulleys
    for link, side in ((left, 1.0), (right, -1.0)):
        if "SCISSORS" not in tool:
            inner = [side * v.X for pad in link.convex for v in pad.vertices()]
            assert min(inner) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("tool", ["LARGE_NEEDLE_DRIVER:400006", "PROGRASP_FORCEPS:400093"])
def test_wrist_and_jaws_are_clear_of_their_neighbours_over_the_whole_range(tool):
    """The shortest and the broadest jaws; the shaft's fork, the wrist, the fingers."""
    arm, links = arm_with(tool), {link.frame: link for link in drawn_links(tool)}
    wanted = ("roll", "wrist_pitch", "finger_left", "finger_right")
    chosen = tuple(links[frame] for frame in wanted)
    shaft, wrist, *fingers = (links[frame].name for frame in wanted)
    for q in ({"wrist_pitch": 1.396}, {"wrist_pitch": -0.7}):
        at = placed(arm, chosen, **q)
        assert shared(at[shaft][-1], at[wrist][0]) < 1e-3, q
    for q in ({"wrist_yaw": 1.396, "jaw": 1.396}, {"wrist_yaw": -1.396, "jaw": 1.396}, {}):
        at = placed(arm, chosen, **q)
        for finger in fingers:
            assert sum(shared(part, at[wrist][0]) for part in at[finger]) < 1e-3, (q, finger)


def test_links_of_one_name_are_one_solid():
    seen: dict[str, tuple[float, float]] = {}
    for tool in names("tools"):
        for link in drawn_links(tool):
            box = link.parts[0].solid.bounding_box()
            size = (sum(s.volume for s in link.parts[0].solid.solids()), box.diagonal)
            assert seen.setdefault(link.name, size) == pytest.approx(size, rel=1e-9), link.name
    assert {"shaft_4162", "shaft_4670", "wrist_91", "wrist_107", "housing"} <= set(seen)


def test_the_shaft_reaches_from_the_collar_to_the_wrist():
    for tool in names("tools"):
        shaft = next(k for k in drawn_links(tool) if k.frame == "roll")
        tube = shaft.parts[0].solid.bounding_box()
        length = float(shaft.name.split("_")[1]) / 10
        assert pytest.approx(tools.COLLAR - length) == tube.min.Z
        assert pytest.approx(8.4) == tube.size.X


def test_an_arm_without_a_tool_has_no_tool_to_draw():
    with pytest.raises(InputError, match="no tool; allowed: LARGE_NEEDLE_DRIVER"):
        tools.links(load_arm("psm", "none"))

"""What a browser shows over the scene: the workspace of an arm, the outline, pictures of depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from viser import ClientHandle

from tests.viewer.visitor import visiting
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.kinematics.workspace import workspace
from trocar.live import Command, Loop
from trocar.rendering.primitives import joined, surface
from trocar.simulation import World
from trocar.simulation.journal import WORLD
from trocar.viewer.outline import CLICK, OBJECTS, PICK, Outline, first_hit, outline
from trocar.viewer.scene import body_names, node_of
from trocar.viewer.server import LocalServer, run_there, serving
from trocar.viewer.workspace import WorkspaceSurface


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


@pytest.fixture(scope="module")
def loop() -> Iterator[Loop]:
    loop = Loop(World("full_cart"))
    loop.post(Command(WORLD, "pause"))
    loop.start()
    yield loop
    loop.stop()


def browser(server: LocalServer | ClientHandle, arm: str = "ECM") -> Any:
    panel = SimpleNamespace(arm=SimpleNamespace(name=arm))
    return SimpleNamespace(browser=server, panel=panel, pressers={})


def until(met: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not met():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.01)


def test_the_surface_stands_where_the_arm_does_and_says_why_it_does_not(
    server: LocalServer, loop: Loop
) -> None:
    desk = browser(server)
    surface = WorkspaceSurface(desk, loop)

    def shows(line: str) -> bool:
        surface.show()
        return line in surface.line

    surface.show()
    assert surface.node is None and surface.line == ""  # off by default
    surface.box.value = True
    until(lambda: shows("ECM: "))
    until(lambda: surface.node is not None or shows("never"))
    assert surface.node is not None
    T, mechanism = loop.ask(
        lambda world: (world.reference_pose("ECM"), world.arm("ECM").description.mechanism)
    ).result()
    assert np.allclose(surface.node.position, T[:3, 3])
    assert np.allclose(matrix_from_quaternion(surface.node.wxyz), T[:3, :3])
    assert np.allclose(surface.node.vertices, workspace(mechanism).vertices, atol=1e-6)
    desk.panel.arm.name = "SUJ_ECM"
    until(lambda: shows("SUJ_ECM has no tip"))
    assert surface.node is None
    surface.close()
    assert surface.line == ""


# ---------------------------------------------------------------------- the outline


@pytest.mark.parametrize("rig", ["full_cart", "pegs", "full_cart_si"])
def test_bodies_have_the_names_that_mujoco_has(rig: str) -> None:
    world = World(rig)
    names = body_names(world.shapes())
    model = world.model.mj
    assert {k: name for k, name in names.items() if k < model.nbody} == {
        k: model.body(k).name for k in names if k < model.nbody
    }
    assert len(set(names.values())) == len(names)


def made_outline(server: LocalServer | ClientHandle, loop: Loop) -> tuple[Any, Outline]:
    desk = browser(server)
    return desk, Outline(desk, loop)


def filled(tree: Outline, loop: Loop) -> bool:
    tree.show(loop.state)
    return bool(tree.groups)


def outline_of(server: LocalServer, loop: Loop) -> tuple[Any, Outline]:
    desk, tree = made_outline(server, loop)
    until(lambda: filled(tree, loop))
    return desk, tree


def test_a_ray_at_a_triangle_of_a_link_picks_that_link(server: LocalServer, loop: Loop) -> None:
    _, tree = outline_of(server, loop)
    now, rng = loop.latest, np.random.default_rng(0)
    shapes = loop.ask(lambda world: world.shapes()).result()
    names = body_names(shapes)
    others = 0  # faces of hinges lie on each other
    name, at, normal = "", np.zeros(3), np.zeros(3)
    for body, name in names.items():
        found = joined([surface(shape) for shape in shapes if shape.body == body])
        a, b, c = found.points[found.faces[rng.integers(len(found.faces))]]
        normal = np.cross(b - a, c - a)
        R = matrix_from_quaternion(now.quaternions[body])
        normal = np.asarray(R @ normal / np.linalg.norm(normal))
        at = np.asarray(R @ (a + b + c) / 3 + now.positions[body])
        others += tree.under(at + 1e-6 * normal, -normal) != name
    assert others <= 3 < len(names)
    tree.press(f"see/{name}")
    assert tree.under(at + 1e-6 * normal, -normal) != name  # what is hidden is not picked
    tree.close()


def test_a_ray_meets_a_ball_where_geometry_has_it() -> None:
    shapes = World("psm").shapes()
    ball = replace(shapes[0], kind="sphere", size=np.array([0.03, 0, 0]), triangles=None)
    found, radius = surface(ball), float(ball.size[0])
    for aside in (0.0, 0.5, 1.5):
        origin = ball.pose[:3, 3] + np.array([aside * radius, 0.0, 3.0 * radius])
        far = first_hit(found, origin, np.array([0.0, 0.0, -2.0]))
        exact = 3.0 * radius - radius * np.sqrt(1 - aside**2) if aside < 1 else np.inf
        assert 2.0 * far == pytest.approx(exact, abs=0.03 * radius)


def test_links_are_hidden_in_one_browser_alone_and_come_back(
    server: LocalServer, loop: Loop
) -> None:
    with visiting(server) as one, visiting(server) as other:
        browser = server.get_clients()[one.who]
        desk, tree = run_there(server, lambda: made_outline(browser, loop))
        until(lambda: run_there(server, lambda: filled(tree, loop)))
        links = {entry.name for entry in tree.groups["PSM1"]}
        assert OBJECTS in tree.groups

        def press(words: str) -> None:
            run_there(server, lambda: desk.pressers["outline"](words))

        press("see/PSM1/yaw")
        assert tree.hidden == {"PSM1/yaw"}
        cover = one.node(node_of("PSM1/yaw"))
        assert cover is not None and cover.kind == "FrameMessage" and not cover.props["show_axes"]
        assert other.node(node_of("PSM1/yaw")) is None
        press("see/PSM1")
        assert tree.hidden == links
        press("see/PSM1")
        assert not tree.hidden and one.node(node_of("PSM1/yaw")) is None
        press("see/nothing")
        press("pick/nothing")
        assert not tree.hidden and tree.picked is None
        press("see/table")
        run_there(server, tree.close)
        assert one.node(node_of("table")) is None


def test_a_picked_link_has_its_name_and_axes_in_the_scene(server: LocalServer, loop: Loop) -> None:
    _, tree = outline_of(server, loop)
    with visiting(server) as visitor:
        tree.press("pick/PSM2/insertion")
        assert tree.picked is not None and tree.picked.body is not None and "PSM2" in tree.opened
        label, axes = visitor.node("/see/picked_name"), visitor.node("/see/picked")
        assert label is not None and label.props["text"] == "PSM2/insertion"
        assert axes is not None
        assert np.allclose(axes.position, loop.latest.positions[tree.picked.body])
        assert np.allclose(axes.wxyz, loop.latest.quaternions[tree.picked.body])
        assert 'class="picked"' in visitor.text("outline")
        tree.press("pick/PSM2/insertion")
        assert tree.picked is None and visitor.node("/see/picked_name") is None
        for name, next_name in ((PICK, CLICK), (CLICK, PICK)):
            assert visitor.widget("Pick").options == (name,)
            visitor.use("Pick", name)
            assert visitor.widget("Pick").options == (next_name,)
        tree.close()


def test_the_outline_has_each_body_once_and_what_bends_last() -> None:
    shapes = World("pegs").shapes()
    groups = outline(shapes, ["thread"])
    names = [entry.name for entries in groups.values() for entry in entries]
    assert sorted(names) == sorted([*body_names(shapes).values(), "thread"])
    assert list(groups)[-2] == OBJECTS and groups["PSM1"][0].name.startswith("PSM1/")

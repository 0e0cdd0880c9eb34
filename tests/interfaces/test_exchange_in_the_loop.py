"""An instrument exchanged while the loop runs: at a tick boundary, and in sight on the page."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from trocar.interfaces import ExchangeTool, JawMove, Loop, MoveTo
from trocar.interfaces.viewer.instrument import NONE, InstrumentChoice
from trocar.interfaces.viewer.page import Page
from trocar.interfaces.viewer.scene import Bodies
from trocar.interfaces.viewer.server import LocalServer, serving
from trocar.interfaces.viewer.sheet import read_sheet
from trocar.interfaces.viewer.tuning import SETTLED
from trocar.simulation import World

MARYLAND = "MARYLAND_BIPOLAR_FORCEPS:400172"
PROGRASP = "PROGRASP_FORCEPS:420093"


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


def test_an_exchange_is_applied_between_two_ticks() -> None:
    world = World("three_psm")
    loop = Loop(world, speed="max")
    loop.post(MoveTo("PSM2", "work"))
    loop.start(duration_s=1.0)
    loop.post(ExchangeTool("PSM1", MARYLAND))
    loop.post(ExchangeTool("PSM1", "SPOON"))
    loop.post(JawMove("PSM1", 0.5))
    loop.wait()
    assert world.arm("PSM1").tool == MARYLAND == loop.latest.arms["PSM1"].tool
    assert loop.state.refused == 1  # the spoon
    assert loop.latest.build == 2
    assert loop.latest.arms["PSM1"].q[6] == pytest.approx(0.5, abs=0.01)
    assert loop.latest.arms["PSM2"].q[:2] == pytest.approx(
        world.arm("PSM2").poses["work"][:2], abs=0.02
    )


def test_only_the_bodies_that_look_otherwise_are_sent_again(server: LocalServer) -> None:
    world = World("three_psm")
    bodies = Bodies(server.scene, world.shapes())
    assert bodies.renew(world.shapes()) == 0
    world.exchange_tool("PSM1", MARYLAND)
    assert bodies.renew(world.shapes()) == 3  # the wrist, and two fingers
    assert bodies.show(world.snapshot()) == len(bodies._nodes)


def test_a_sheet_tells_which_instruments_fit() -> None:
    world = World("psm")
    sheet = read_sheet(world, "PSM1")
    assert sheet.tool == "LARGE_NEEDLE_DRIVER:400006" and PROGRASP in sheet.tools
    assert read_sheet(World("ecm"), "ECM").tools == ()


def test_a_person_chooses_an_instrument(server: LocalServer) -> None:
    world, posted = World("psm"), []
    sheet = read_sheet(world, "PSM1")

    class Desk:
        def post(self, command: object) -> None:
            posted.append(command)

    choice = InstrumentChoice(server.gui, Desk(), sheet)  # type: ignore[arg-type]
    assert choice._choice.value == sheet.tool
    assert set(choice._choice.options) == {*sheet.tools, NONE}
    choice._choice._impl.value = MARYLAND
    choice._chosen(MARYLAND)
    assert posted == [ExchangeTool("PSM1", MARYLAND)]
    choice.follow(sheet)  # still the old one: the exchange is on its way
    assert choice._choice.value == MARYLAND
    for _ in range(SETTLED):
        choice.follow(sheet)  # it was refused
    assert choice._choice.value == sheet.tool


def test_the_page_shows_the_new_instrument_and_its_limits(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World("psm")
    loop = Loop(world, speed="max")
    page = Page(server, world, loop)
    monkeypatch.setattr(server, "get_clients", lambda: {0: None})
    assert page._panel._controls is not None
    wide = page._panel._controls._sliders._handles[5]
    assert wide.label == "wrist_yaw deg" and wide.max == pytest.approx(80.0, abs=0.1)
    looks = dict(page._bodies._looks)

    def look() -> None:
        for _ in range(12):
            loop.run(0.02)
            page.refresh()

    look()
    loop.post(ExchangeTool("PSM1", MARYLAND))
    look()
    assert page._panel._controls is not None
    sliders = page._panel._controls._sliders._handles
    assert sliders[5].max == pytest.approx(90.0, abs=0.1)
    changed = [body for body, packed in page._bodies._looks.items() if looks[body] != packed]
    assert len(changed) == 3 and page._build == 2
    assert page._panel._controls._instrument is not None
    assert page._panel._controls._instrument._choice.value == MARYLAND
    loop.post(ExchangeTool("PSM1", "none"))  # fewer joints and bodies than the page knew
    look()
    assert page._panel._controls is not None
    assert len(page._panel._controls._sliders._handles) == 3
    assert len(page._bodies._looks) == len(looks) - 5
    assert "PSM1/insertion/measured" in page._tables._joints.content
    assert "jaw" not in page._tables._joints.content
    sent = page._bodies._sent
    assert sent is not None and np.isfinite(sent).all()


def test_another_arm_s_controls_wait_for_its_sheet(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arm that lost its jaw while another one was on the panel, and is chosen then."""
    world = World("three_psm")
    loop = Loop(world, speed="max")
    page = Page(server, world, loop)
    monkeypatch.setattr(server, "get_clients", lambda: {0: None})
    loop.post(ExchangeTool("PSM2", "none"))
    for _ in range(6):
        loop.run(0.02)
        page.refresh()
    page._panel._choice._impl.value = "PSM2"
    page._panel._choose()
    assert page._panel._controls is None
    for _ in range(12):
        page.refresh()
        loop.run(0.02)
    assert page._panel._controls is not None
    assert len(page._panel._controls._sliders._handles) == 3

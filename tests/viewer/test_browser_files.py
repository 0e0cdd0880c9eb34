"""Files in a real browser: one's own are uploaded and loaded, recordings played and continued."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.live import Loop
from trocar.live.player import Player
from trocar.simulation import World
from trocar.viewer import Choice, Gallery, serve

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.webdriver.common.by import By

from tests.viewer.browser import Browser, chromium

pytestmark = pytest.mark.browser

OPEN = """
const title = [...document.querySelectorAll('*')]
  .find(e => e.children.length < 3 && e.innerText?.trim() === 'Own files');
title.click();
"""


def ball(file: Path, triangles: int) -> Path:
    """Write a ball as binary STL, which has 50 bytes for each of its triangles."""
    rings = round(np.sqrt(triangles / 2))
    u, v = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, rings + 1))
    p = 20.0 * np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3)
    rows = np.zeros(len(faces), np.dtype([("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")]))
    rows["p"] = faces[:, ::-1]
    file.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return file


@pytest.mark.slow
def test_a_file_is_uploaded_previewed_and_loaded_and_bad_ones_get_a_notice(tmp_path: Path) -> None:
    gallery = Gallery(lambda: (), "psm")
    urls: list[str] = []
    chosen: list[Choice | None] = []
    ready = threading.Event()

    def greet(url: str) -> None:
        urls.append(url)
        ready.set()

    def run() -> None:
        chosen.append(serve(World("psm"), port=0, on_ready=greet, gallery=gallery))

    server = threading.Thread(target=run, daemon=True)
    server.start()
    assert ready.wait(60.0)
    with chromium(tmp_path / "profile") as browser:
        browser.open(urls[0])
        browser.tab.execute_script(OPEN)
        upload(browser, tmp_path, "nothing.stl", b"nothing of the kind")
        notice = "//*[contains(text(), 'Not imported')]"
        browser.wait(lambda: bool(browser.tab.find_elements(By.XPATH, notice)), "the notice")
        assert "nothing.stl" in own(browser)
        with (tmp_path / "large.stl").open("wb") as stream:
            stream.truncate(50_000_001)
        send(browser, tmp_path / "large.stl")
        browser.wait(lambda: "allowed: up to 50 MB" in own(browser), "the bound")
        browser.choose("Contact", "convex hull")
        browser.choose("Unit", "mm")
        file = ball(tmp_path / "ball.stl", 40_000)
        assert file.stat().st_size > 1_900_000  # several messages
        send(browser, file)
        browser.wait(
            lambda: "39.99 x 40 x 40 mm" in own(browser) or "40 x 40" in own(browser), "it"
        )
        browser.click("Load")
        server.join(120.0)
    assert chosen and chosen[0] is not None
    assert "ball" in World(chosen[0].name).objects


def own(browser: Browser) -> str:
    return browser.read("own") or ""


def upload(browser: Browser, folder: Path, name: str, content: bytes) -> None:
    (folder / name).write_bytes(content)
    send(browser, folder / name)


def send(browser: Browser, file: Path) -> None:
    inputs: list[Any] = browser.tab.find_elements(By.CSS_SELECTOR, "input[type=file]")
    inputs[-1].send_keys(str(file))


def test_a_recording_is_played_by_its_slider_and_continued(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `record` is not there")
    from trocar.recording import record
    from trocar.robot.follow import RepeatedRecording

    world = World("psm")
    with record(world, tmp_path / "run.mcap"):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(2000)
    played = RepeatedRecording(tmp_path / "run.mcap")
    loop = Loop(played.world)
    player = Player(loop, played)
    loop.watch(player)
    ready = threading.Event()
    urls: list[str] = []

    def greet(url: str) -> None:
        urls.append(url)
        ready.set()

    def run() -> None:
        serve(played.world, port=0, on_ready=greet, loop=loop, player=player)

    server = threading.Thread(target=run, daemon=True)
    server.start()
    assert ready.wait(60.0)
    with chromium(tmp_path / "profile") as browser:
        browser.open(urls[0], "recording")
        browser.type_number("Moment s", 1.25)
        browser.wait(lambda: "1.250 of 2.000 s" in (browser.read("recording") or ""), "1.25 s")
        assert played.world.time == pytest.approx(1.25)
        browser.click("+0.1 s")
        browser.wait(lambda: player.time_s == pytest.approx(1.35), "a step")
        browser.click("Play")
        browser.wait(lambda: player.time_s == played.end_s, "the end")
        browser.click("Continue from here")
        browser.wait(lambda: played.world.time > 2.5, "the branch goes on")
        assert "this is a branch" in (browser.read("recording") or "")
        browser.click("Back to the recording")
        browser.wait(lambda: player.active and played.world.time == pytest.approx(2.0), "the end")
    loop.close()
    server.join(60.0)

"""A page with every control: an arm of each kind, a scene with a policy, cameras, pedals."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.live.fake_renderer import FakeRenderer
from trocar.cli.gallery import controls
from trocar.descriptions.catalogue import load_scene
from trocar.live import Loop
from trocar.live.images import Pictures
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.tasks import Task, make_task
from trocar.tasks.served import ServedTask
from trocar.teleoperation.session import Session
from trocar.viewer import Card, Choice, Gallery, serve

RIG = """
schema = 1
name = "all_kinds"
title = "an arm of each kind"
source = "this test"

[display]
xyz_m = [0.0, 1.5, 1.15]
rpy_deg = [150.0, 0.0, 0.0]
source = "this test"

[[arm]]
name = "PSM1"
description = "psm"
tool = "LARGE_NEEDLE_DRIVER:400006"
place = "rcm"
xyz_m = [0.0, 0.0, 0.25]
source = "this test"

[[arm]]
name = "ECM"
description = "ecm"
place = "rcm"
xyz_m = [-1.5, 0.0, 0.5]
source = "this test"

[[arm]]
name = "SUJ_PSM1"
description = "suj_psm1"
on = "world"
xyz_m = [1.5, 0.0, 0.0]
source = "this test"

[[arm]]
name = "MTMR"
description = "mtmr"
on = "HRSV"
xyz_m = [-0.18, 0.4, 0.475]
rpy_deg = [150.0, 0.0, 180.0]
source = "this test"

[[prop]]
name = "table"
source = "this test"
shape = [{ kind = "box", center_mm = [0, 0, -15], size_mm = [420, 420, 30], material = "drape" }]

[[prop]]
name = "block"
movable = true
mass_g = 50
xyz_mm = [60, 0, 10.01]
source = "this test"
shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [20, 20, 20], material = "accent" }]

[[camera]]
name = "endoscope"
kind = "endoscope"
arm = "ECM"
preset = "dvrk_sd_640x480"

[[camera]]
name = "room"
kind = "view"
xyz_mm = [0, -900, 300]
look_at_mm = [0, 0, 0]
size_px = [320, 200]
fov_deg = 60

[[pose]]
name = "start"
source = "this test"
[pose.q_rad_m]
PSM1 = [0.0, 0.0, 0.12, 0, 0, 0, 0]
ECM = [0.0, 0.0, 0.1, 0.0]
SUJ_PSM1 = [0.0007, -0.5892, -0.859, -0.6241, -0.2479, -0.4422]
MTMR = [-0.1, 0.3, 0.1, 0, 0.6, 0, 0, 1.0]

[[pose]]
name = "aside"
source = "this test"
q_rad_m = { PSM1 = [0.3, -0.1, 0.12, 0, 0, 0, 0.5], ECM = [0.1, 0.0, 0.1, 0.0] }
"""
SCENE = """
schema = 1
name = "all-controls"
title = "The tip goes to a place"
source = "this test"
rig = "RIG"
task = "reach"
arms = ["PSM1"]
time_limit_s = 3600

[[goal]]
arm = "PSM1"
at_mm = [60, 40, 50]
radius_mm = 0.1
height_mm = 0.1
"""


def sway(task: Task) -> Iterator[np.ndarray]:
    """Move to and fro, for ever."""
    for k in range(10**6):
        action = np.array(task.stay())
        action[0] = 0.1 if (k // 25) % 2 else -0.1
        yield action


@dataclass
class AllKinds:
    """The world that is served.

    Attributes:
        url, rosbridge: addresses of the page and the WebSocket
        loop, task, gallery: of the world
        chosen: what ended it
        overlaid: whether the last picture has overlays
    """

    url: str
    rosbridge: str
    loop: Loop
    task: ServedTask
    gallery: Gallery
    chosen: list[Choice | None] = field(default_factory=list)
    thread: threading.Thread = field(default_factory=threading.Thread)

    def world(self, read: Any) -> Any:
        """Return what a function reads of the world, between two steps."""
        return self.loop.ask(read).result(20.0)


@contextmanager
def all_kinds(folder: Path) -> Iterator[AllKinds]:
    """Serve it from this process, as `trocar play` does, with a renderer that needs no GPU."""
    rig, scene = folder / "all_kinds.toml", folder / "all-controls.toml"
    rig.write_text(RIG, encoding="utf-8")
    scene.write_text(SCENE.replace("RIG", rig.name), encoding="utf-8")
    free = replace(load_scene(str(scene)), welded=())
    task = ServedTask(make_task(free), 0, script=sway)
    world = task.task.world
    loop = Loop(world, tick_s=SERVER_TICK_S)
    task.watch(loop)
    session, socket = Session(), WebSocketTransport(port=0)
    pictures = Pictures(loop, lambda: FakeRenderer([[0.0, 0.0, 0.0]]), rate_hz=5.0)
    pictures.overlay = lambda frame, eye: np.full_like((frame.left, frame.right)[eye], 200)
    gallery = Gallery(lambda: [Card(Choice("rig", "psm"), "one arm")], "all-controls")
    ready = threading.Event()
    with (
        closing(pictures),
        closing(
            Core(
                loop,
                pictures=pictures,
                components=(*session.components(loop), task.component()),
            )
        ) as core,
        closing(loop),
    ):
        core.attach(socket)
        pictures.start()
        core.start()
        made = AllKinds("", socket.address, loop, task, gallery)

        def greet(url: str) -> None:
            made.url = url
            ready.set()

        def run() -> None:
            made.chosen.append(
                serve(
                    world,
                    port=0,
                    on_ready=greet,
                    loop=loop,
                    pictures=pictures,
                    driving=session.driving(None),
                    scene=controls(task),
                    gallery=gallery,
                    start="viewer",
                )
            )

        made.thread = threading.Thread(target=run)
        made.thread.start()
        assert ready.wait(60.0)
        try:
            yield made
        finally:
            loop.stop()
            made.thread.join()

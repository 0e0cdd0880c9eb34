"""Drawing leaves the interpreter to others: a thread that draws keeps nobody from running."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pytest

from trocar.rendering import Endoscope, context
from trocar.simulation import World

pytest.importorskip("moderngl")


@pytest.fixture(scope="module")
def scope():
    try:
        scope = Endoscope(World("two_psm_ecm"), "endoscope", preset="dvrk_sd_640x480")
        scope.capture()
    except Exception as problem:  # noqa: BLE001  a machine without OpenGL
        pytest.skip(str(problem))
    return scope


def ticks_while_drawing(scope: Endoscope) -> float:
    """Return the share of a picture's time in which another thread ran, slept 0.2 ms at a time."""
    beats: list[float] = []
    stop = threading.Event()

    def beat() -> None:
        while not stop.is_set():
            time.sleep(0.0002)
            beats.append(time.perf_counter())

    other = threading.Thread(target=beat)
    other.start()
    began = time.perf_counter()
    for _ in range(10):
        scope.capture()
    took = time.perf_counter() - began
    stop.set()
    other.join()
    waits = np.diff([began, *beats])
    return float(waits[waits < 0.003].sum() / took)


@pytest.mark.skipif(sys.platform != "linux", reason="only there are calls made without the lock")
def test_another_thread_runs_while_a_picture_is_drawn(scope: Endoscope, monkeypatch) -> None:
    free = ticks_while_drawing(scope)
    monkeypatch.setattr(context, "opengl_library", lambda: None)
    assert free > ticks_while_drawing(scope) + 0.1


def test_both_ways_draw_the_same_picture(scope: Endoscope, monkeypatch) -> None:
    free = scope.capture()
    monkeypatch.setattr(context, "opengl_library", lambda: None)
    kept = scope.capture()
    assert np.array_equal(free.left, kept.left)
    assert free.right is not None and kept.right is not None
    assert np.array_equal(free.right, kept.right)

"""Pictures that follow each other: how each is exposed, and which of them are drawn at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.rendering.scenes import camera, mesh, plate, snapshot, stereo
from trocar.descriptions.cameras import load_stereo_camera
from trocar.geometry.se3 import transform
from trocar.rendering import Look, Renderer, Series, StereoFrame
from trocar.rendering.gpu import Gpu
from trocar.rendering.series import STILL

EYES = {"eye": camera(stereo())}


@pytest.mark.usefixtures("opengl")
def test_a_series_repeats_and_begins_anew_after_a_gap_and_when_time_runs_back() -> None:
    def exposures(times: tuple[float, ...]) -> list[float]:
        shapes = [mesh("near", plate(transform(np.eye(3), [0, 0, 0.1]), 0.1, 0.1), body=1)]
        series = Series(Renderer(lambda: (1, shapes)))
        away = [transform(np.eye(3), [0.0, 0.0, 0.3 * (k > 0)]) for k in range(len(times))]
        return [
            series.render(snapshot([T], time), EYES, "eye").exposure
            for T, time in zip(away, times, strict=True)
        ]

    first, second, third = exposures((0.0, 0.02, 0.04))
    assert exposures((0.0, 0.02, 0.04)) == [first, second, third]
    alone = exposures((0.0, 5.0))[1]
    assert second == first  # what was seen before says how the next is taken
    assert first < third < alone
    assert exposures((5.0, 0.0))[1] == alone
    assert exposures((0.0, 0.02, 0.02))[2] == pytest.approx(second, abs=1e-9)  # time stands still


@pytest.mark.usefixtures("opengl")
def test_while_nothing_moves_no_picture_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    draw = Gpu.draw

    def counted(self: Gpu, *args: Any) -> Any:
        drawn.append(1)
        return draw(self, *args)

    monkeypatch.setattr(Gpu, "draw", counted)
    ball = mesh("ball", plate(transform(np.eye(3), [0, 0, 0.1]), 0.02, 0.02), body=1)

    def series(look: Look) -> Series:
        return Series(Renderer(lambda: (1, [ball]), look=look))

    def shot(own: Series, x: float, time: float, **kind: Any) -> tuple[StereoFrame, int]:
        drawn.clear()
        at = transform(np.eye(3), [x, 0.0, 0.0])
        return own.render(snapshot([at], time), EYES, "eye", **kind), len(drawn)

    plain = series(Look(exposure=0.0))
    first, count = shot(plain, 0.0, 0.0)
    assert count == 1
    again, count = shot(plain, 0.5 * STILL, 0.02)
    assert count == 0 and again.left is first.left and (again.time, first.time) == (0.02, 0.0)
    # it creeps on: what counts is how far it is from where it was drawn
    assert [shot(plain, k * 0.5 * STILL, 0.02 * k)[1] for k in range(2, 6)] == [1, 0, 1, 0]
    assert shot(plain, 0.002, 0.2)[1] == 1
    assert (shot(plain, 0.002, 0.22, beside=("depth",))[0].depth is not None) and drawn
    largest = load_stereo_camera("hd_1920x1080")
    assert STILL / 0.010 * largest.left.K[0, 0] < 0.1  # px, 10 mm ahead of the eye
    grainy = series(Look(exposure=0.0, noise=0.02))
    assert [shot(grainy, 0.0, 0.02 * k)[1] for k in range(3)] == [1, 1, 1]

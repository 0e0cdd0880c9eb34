"""The surgical style: structure, moisture, mirrors and soft shadows, and what must not change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rendering.scenes import camera, disc, mesh, snapshot, stereo
from trocar.errors import InputError
from trocar.rendering import Channels, Look, Renderer, Series, StereoFrame
from trocar.rendering.exposure import LEAST, MOST
from trocar.rendering.look import BLOOD_M, POOL_M
from trocar.rendering.textures import tissue
from trocar.simulation.records import Drawing, DrawnCurve, DrawnSurface

SURGICAL = Look(style="surgical", exposure=-1.0)
DULL = replace(SURGICAL, wet=0.0, shadows=False)
EYES = {"eye": camera(stereo())}
RED = (0.35, 0.08, 0.07, 1.0)


def sheet(shift: float = 0.0, **settings: object) -> DrawnSurface:
    """Return a plane of tissue across the camera's axis, shifted to the right [m]."""
    line = np.arange(-0.08, 0.0801, 0.001)
    x, y = np.meshgrid(line, line)
    at = np.stack([x + shift, y, np.full_like(x, 0.1)], axis=-1).reshape(-1, 3)
    n = len(line)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + n + 1, a + 1], 1), np.stack([a, a + n, a + n + 1], 1)])
    return DrawnSurface("sheet", at, faces, material="tissue")._replace(**settings)


def seen(look: Look, *drawings: Drawing, shapes: tuple = ()) -> StereoFrame:
    renderer = Renderer(lambda: (1, shapes), Channels(True, True, True), look)
    frame = renderer.render(snapshot()._replace(drawings=drawings), EYES, "eye")
    renderer.close()
    return frame


def grey(frame: StereoFrame) -> np.ndarray:
    return frame.left.astype(float).mean(axis=-1)


@pytest.mark.parametrize("blood", [0.0, 0.3])
def test_tissue_repeats_without_a_seam(blood: float) -> None:
    pixels = tissue(blood).astype(float)
    for axis in (0, 1):
        steps = np.abs(np.diff(pixels, axis=axis, append=pixels.take([0], axis))).mean(
            axis=1 - axis
        )
        assert (steps[-1] < 1.5 * steps[:-1].mean(axis=0)).all()


@pytest.mark.usefixtures("opengl")
def test_depth_ids_and_normals_are_those_of_the_plain_style() -> None:
    ball = DrawnCurve("wire", np.array([[-0.02, 0, 0.09], [0.02, 0, 0.09]]), 0.003, metal=1.0)
    plain, surgical = (seen(look, sheet(), ball) for look in (Look(), SURGICAL))
    assert (plain.depth == surgical.depth).all() and (plain.ids == surgical.ids).all()
    assert (plain.normals == surgical.normals).all()
    assert (plain.left != surgical.left).any(axis=-1).mean() > 0.9


@pytest.mark.usefixtures("opengl")
def test_structure_sticks_to_tissue_that_moves() -> None:
    pixels = 12
    shift = pixels * 0.1 / EYES["eye"].calibration.eyes[0].K[0, 0]
    still = sheet(gloss=0.0)
    before = grey(seen(DULL, still))
    stuck, loose = (
        grey(seen(DULL, sheet(shift, gloss=0.0, rest=rest))) for rest in (still.vertices, None)
    )

    def alike(after: np.ndarray) -> float:
        a, b = before[150:300, 200:400], after[150:300, 200 + pixels : 400 + pixels]
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    assert alike(stuck) > 0.98 and alike(loose) < 0.8


@pytest.mark.usefixtures("opengl")
def test_shadows_have_soft_edges() -> None:
    rod = DrawnCurve("rod", np.array([[-0.03, 0, 0.07], [0.03, 0, 0.07]]), 0.004)
    plain_sheet = sheet(material="")
    edges = []
    for look in (Look(exposure=-1.0, wet=0.0), replace(SURGICAL, wet=0.0)):
        lit, dark = (
            grey(seen(replace(look, shadows=on), plain_sheet, rod)) for on in (False, True)
        )
        ratio = dark[:, 300] / np.maximum(lit[:, 300], 1.0)
        edges.append(np.count_nonzero((ratio > 0.3) & (ratio < 0.97)))
    assert edges[1] > edges[0] + 1


@pytest.mark.usefixtures("opengl")
def test_smooth_cloth_is_dithered_and_shows_no_bands() -> None:
    plain, surgical = (
        seen(look, sheet(material="")).left[100:300, 150:450]
        for look in (replace(DULL, style="plain"), DULL)
    )
    bands, dithered = ((np.diff(i, axis=1) == 0).mean() for i in (plain, surgical))
    assert bands > 0.8 and 0.4 < dithered < 0.6


@pytest.mark.usefixtures("opengl")
def test_tissue_close_below_something_is_darker_beside_its_shadow() -> None:
    lid = mesh("lid", disc(np.array([0.0, 0.0, 0.0985]), 0.012)[0])
    bare, below = (grey(seen(replace(DULL, shadows=True), sheet(), shapes=s)) for s in ((), (lid,)))
    frame = seen(SURGICAL, sheet(), shapes=(lid,))
    row = round(float(frame.project([0.0, -0.0135, 0.1])[1]))  # the light is above: shadow is below
    far = round(float(frame.project([0.0, -0.03, 0.1])[1]))
    column = slice(310, 340)
    assert below[row, column].mean() < 0.97 * bare[row, column].mean()
    assert np.abs(below[far, column] - bare[far, column]).max() <= 1.0


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_exposure_of_dark_red_tissue_does_not_run_to_its_end_and_a_series_agrees() -> None:
    def frames(look: Look) -> list[StereoFrame]:
        series = Series(Renderer(lambda: (1, ()), None, look))
        shots = [
            series.render(snapshot(time=0.1 * k)._replace(drawings=(sheet(rgba=RED),)), EYES, "eye")
            for k in range(30)
        ]
        series.close()
        return shots

    plain, surgical = frames(Look()), frames(Look(style="surgical"))
    assert plain[-1].exposure == MOST
    assert LEAST + 0.5 < surgical[0].exposure < 1.0
    assert abs(surgical[-1].exposure - surgical[0].exposure) < 0.5


@pytest.mark.usefixtures("opengl")
def test_moisture_glitters_and_burns_nothing() -> None:
    dry, wet = (seen(replace(SURGICAL, wet=wet), sheet()).left for wet in (0.0, 1.0))
    assert (wet.min(axis=-1) > 150).sum() > 2 * (dry.min(axis=-1) > 150).sum()
    assert (wet == 255).all(axis=-1).mean() < 0.002


@pytest.mark.usefixtures("opengl")
def test_metal_mirrors_light_and_dark_and_stays_grey() -> None:
    rod = DrawnCurve("rod", np.array([[-0.03, 0, 0.08], [0.03, 0, 0.08]]), 0.005,
                     (0.75, 0.75, 0.75, 1.0), 0.7, 1.0)  # fmt: skip
    dull, mirroring = (
        seen(replace(SURGICAL, wet=0.0), rod._replace(metal=metal)).left.astype(int)
        for metal in (0.0, 1.0)
    )
    on = dull.max(axis=-1) > 0
    off = mirroring[on].max(axis=-1) - mirroring[on].min(axis=-1)
    assert (off <= 0.06 * mirroring[on].max(axis=-1) + 1).all()  # pink tools had a fifth
    row = dull.shape[0] // 2 + np.arange(-20, 20)
    across = [image[row, 320].mean(axis=-1) for image in (dull, mirroring)]
    assert np.abs(np.diff(across[1])).max() > 1.2 * np.abs(np.diff(across[0])).max()


@pytest.mark.usefixtures("opengl")
def test_smoke_blood_and_compression_show() -> None:
    clear = seen(DULL, sheet()).left.astype(float)
    smoke, blood, coarse = (
        seen(replace(DULL, **more), sheet()).left.astype(float)
        for more in ({"smoke": 1.0}, {"blood": 0.5}, {"jpeg": 30})
    )
    assert smoke.std() < 0.8 * clear.std()
    assert blood.mean() < 0.9 * clear.mean()
    off = coarse - clear
    assert np.abs(off).max() > 3.0 and abs(off.mean()) < 1.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"style": "cartoon"}, "style: got 'cartoon'; allowed: plain, surgical"),
        ({"smoke": 2.0}, "smoke: got 2.0; allowed: 0 to 1"),
        ({"jpeg": 200}, "jpeg: got 200; allowed: 0 to 95"),
    ],
)
def test_a_look_that_cannot_be_is_rejected(given: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Look(**given)


@pytest.mark.usefixtures("opengl")
def test_blood_spreads_with_time_as_its_volume_has_it_and_is_dark_and_red() -> None:
    look = replace(DULL, exposure=0.5, bleeding=2.0, bleeding_at=(0.025, 0.015, 0.1))
    renderer = Renderer(lambda: (1, ()), look=look)

    def shot(time: float) -> np.ndarray:
        frame = renderer.render(snapshot(time=time)._replace(drawings=(sheet(),)), EYES, "eye")
        return frame.left.astype(float)

    before, areas = shot(0.0), []
    for time in (1.0, 2.0, 4.0):
        now = shot(time)
        changed = np.abs(now - before).max(axis=-1) > 30.0
        areas.append(changed.sum())
        dark = now[changed]
        assert (dark[:, 0] > 3.0 * dark[:, 1]).mean() > 0.9
        assert dark.mean() < 0.7 * before[changed].mean()
    assert areas[1] == pytest.approx(2.0 * areas[0], rel=0.25)
    assert areas[2] == pytest.approx(2.0 * areas[1], rel=0.25)
    assert (shot(4.0) == now).all() and (shot(0.0) == before).all()
    renderer.close()


def test_a_pool_of_blood_has_the_volume_that_flowed_up_to_its_largest_radius() -> None:
    look = Look("surgical", bleeding=6.0)  # 0.1 ml/s
    assert np.pi * look.pool(2.0) ** 2 * BLOOD_M == pytest.approx(2e-7)
    assert look.pool(-1.0) == 0.0 and look.pool(1e6) == POOL_M and Look().pool(1e6) == 0.0
    for wrong in ({"bleeding": 61.0}, {"bleeding": -1.0}, {"bleeding_at": (0.0, 1.0)}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            Look("surgical", **wrong)  # type: ignore[arg-type]

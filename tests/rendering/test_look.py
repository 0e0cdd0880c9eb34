"""Effects of light, lens and sensor on a picture, and values that are rejected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rendering.scenes import disc, mesh, plate, seen, snapshot, stereo
from trocar.errors import InputError
from trocar.geometry.se3 import transform
from trocar.rendering import Look

BACK = mesh("back", plate(transform(np.eye(3), [0.0, 0.0, 0.12]), 0.4, 0.4))
DISC = mesh("disc", disc(np.array([0.0, 0.0, 0.06]), 0.008)[0], body=1)
WHERE = snapshot([np.eye(4)])
#: Nothing glitters, and light is as it is.
PLAIN = Look(wet=0.0, exposure=0.0)

pytestmark = pytest.mark.usefixtures("opengl")


def grey(look: Look, shapes: list | None = None) -> np.ndarray:
    return seen(shapes or [BACK], stereo(), look, WHERE).left.mean(axis=-1)


def test_light_falls_off_from_the_scopes_tip() -> None:
    near = mesh("near", plate(transform(np.eye(3), [0.0, 0.0, 0.10]), 0.4, 0.4))
    far = mesh("far", plate(transform(np.eye(3), [0.0, 0.0, 0.25]), 0.9, 0.9))
    assert grey(PLAIN, [near]).mean() > 1.3 * grey(PLAIN, [far]).mean()


def test_a_shadow_lies_below_what_throws_it_and_darkens_only() -> None:
    with_shadow, without = (grey(replace(PLAIN, shadows=on), [BACK, DISC]) for on in (True, False))
    darker = without - with_shadow
    assert darker.min() > -2.0 and darker.max() > 30.0
    rows = np.argwhere(darker > 30.0)[:, 0]
    middle = np.argwhere(seen([DISC], stereo(), None, WHERE).ids[0] > 0)[:, 0].mean()  # type: ignore[index]
    assert rows.mean() > middle  # the light stands above the lenses


def test_no_surface_is_striped_by_its_own_shadow() -> None:
    slanted = transform(
        np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]], dtype=float), [0, 0, 0.1]
    )
    tilted = mesh("tilted", plate(slanted, 0.2, 0.2))
    off = np.abs(grey(Look(), [tilted]) - grey(Look(shadows=False), [tilted]))
    assert off.max() <= 1.0


def test_a_stop_brighter_is_brighter() -> None:
    dark, normal, bright = (grey(Look(exposure=stops)).mean() for stops in (-1.0, 0.0, 1.0))
    assert dark < normal < bright


def test_a_vignette_darkens_corners_and_not_the_middle() -> None:
    plain, dimmed = grey(PLAIN), grey(replace(PLAIN, vignette=1.0))
    assert dimmed[0, 0] < 0.8 * plain[0, 0]
    assert abs(dimmed[228, 327] - plain[228, 327]) < 3.0


def test_wet_surfaces_glitter_more() -> None:
    assert grey(replace(PLAIN, wet=1.0)).max() > grey(PLAIN).max() + 10.0


def test_noise_is_as_large_as_asked_without_a_mean_and_repeats() -> None:
    look = replace(PLAIN, exposure=-1.0, noise=0.03, seed=5)
    plain = seen([BACK], stereo(), replace(PLAIN, exposure=-1.0), WHERE).left.astype(float)
    noisy = seen([BACK], stereo(), look, WHERE).left.astype(float)
    grain = noisy - plain
    assert abs(grain.mean()) < 0.1
    assert grain.std() == pytest.approx(0.03 * 255.0, rel=0.03)
    assert (seen([BACK], stereo(), look, WHERE).left == noisy).all()
    later = snapshot([np.eye(4)], time=0.5)
    assert (seen([BACK], stereo(), look, later).left != noisy).any()


def test_samples_soften_edges_and_leave_ids_and_depth_alone() -> None:
    plain, soft = (seen([DISC], stereo(), Look(samples=n), WHERE) for n in (0, 4))
    assert len(np.unique(soft.left)) > len(np.unique(plain.left))
    assert (plain.ids == soft.ids).all() and (plain.depth == soft.depth).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"exposure": float("nan")}, "exposure: got nan; allowed: -20 to 20"),
        ({"exposure": "bright"}, "exposure: got 'bright'; allowed: a number or \"auto\""),
        ({"vignette": 1.5}, "vignette: got 1.5; allowed: 0 to 1"),
        ({"noise": -0.1}, "noise: got -0.1; allowed: 0 to 0.5"),
        ({"wet": "very"}, "wet: got 'very'; allowed: a number"),
        ({"samples": 2.5}, "samples: got 2.5; allowed: a number"),
        ({"seed": -1}, "seed: got -1; allowed: 0 to"),
    ],
)
def test_a_look_that_cannot_be_is_rejected(given: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Look(**given)

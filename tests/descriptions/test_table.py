"""TOML that trocar writes: exact, with vectors on one line, and without what TOML lacks."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from trocar.descriptions.catalogue import DATA
from trocar.descriptions.table import toml_text
from trocar.errors import InputError


def test_every_file_of_the_catalogue_comes_back_to_the_last_bit() -> None:
    files = sorted(DATA.rglob("*.toml"))
    assert len(files) > 40
    for file in files:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
        assert tomllib.loads(toml_text(document)) == document, file


def test_vectors_and_rows_of_matrices_stand_on_one_line() -> None:
    text = toml_text({"xyz_m": np.array([0.1, -1e-17, 2.0]), "rotation": np.eye(2), "of": ["a"]})
    assert text == (
        "xyz_m = [0.1, -1e-17, 2.0]\n"
        "rotation = [\n    [1.0, 0.0],\n    [0.0, 1.0],\n]\n"
        'of = [\n    "a",\n]\n'
    )


def test_texts_that_look_like_vectors_stay_as_they_are() -> None:
    document = {"odd key": "[\n1,\n2,\n]", "texts": ["[\n    1,\n]", '"', "\\", "\u2028"]}
    assert tomllib.loads(toml_text(document)) == document


def test_what_toml_lacks_is_left_out_or_rejected_by_key() -> None:
    assert toml_text({"a": None, "b": {"c": None, "d": 1}}) == "[b]\nd = 1\n"
    with pytest.raises(InputError, match=r"frames.yaw.xyz_m: got nan; allowed: a finite number"):
        toml_text({"frames": {"yaw": {"xyz_m": [0.0, math.nan]}}})
    with pytest.raises(InputError, match=r"a: got 1j; allowed: texts, numbers, lists and tables"):
        toml_text({"a": 1j})

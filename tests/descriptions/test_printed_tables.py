"""The paper's tables as printed, and what each of their errata does."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import trocar.descriptions
from trocar.descriptions import ArmDescription, load_arm
from trocar.kinematics import loops
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

PAPER = Path(trocar.descriptions.__file__).parent / "data" / "paper"
TABLES = {
    "table1": "suj_psm1",
    "table2": "suj_psm3",
    "table3": "suj_ecm",
    "table4": "psm",
    "table5": "ecm",
}
#: Rounding of a product of fifteen transforms of metre size.
EXACT = 1e-12
#: The ECM's remote centre in its base.
SCOPE_CENTRE = np.array([0.0, 0.6126, 0.0, 1.0])


def printed(name: str) -> ArmDescription:
    return load_arm(PAPER / f"{name}.toml")


def raw(name: str) -> dict[str, Any]:
    return tomllib.loads((PAPER / f"{name}.toml").read_text(encoding="utf-8"))


def errata(name: str, frame: str, key: str) -> dict[str, Any]:
    rows = raw(name)["erratum"]
    return next(row for row in rows if (row["frame"], row["key"]) == (frame, key))


def numeric(name: str) -> list[dict[str, Any]]:
    return [row for row in raw(name).get("erratum", []) if not isinstance(row["printed"], str)]


def mended(name: str, tmp_path: Path, *only: tuple[str, str]) -> ArmDescription:
    """Load a printed table with its errata put right: all of them, or `only` (frame, key)."""
    blocks = (PAPER / f"{name}.toml").read_text(encoding="utf-8").split("\n\n")
    for row in numeric(name):
        if only and (row["frame"], row["key"]) not in only:
            continue
        head = f'[[frame]]\nname = "{row["frame"]}"\n'
        (index,) = (i for i, block in enumerate(blocks) if block.startswith(head))
        old, new = (f"\n{row['key']} = {row[which]!r}\n" for which in ("printed", "mended"))
        assert old in blocks[index]
        blocks[index] = blocks[index].replace(old, new)
    path = tmp_path / f"{name}.toml"
    path.write_text("\n\n".join(close_again(blocks, path)), encoding="utf-8")
    return load_arm(path)


def close_again(blocks: list[str], path: Path) -> list[str]:
    """Put the closing points, which follow from the rows, where the changed rows have them."""
    rows = [block for block in blocks if not block.startswith("[[closure]]")]
    path.write_text("\n\n".join(rows), encoding="utf-8")
    found = at_zero(load_arm(path))
    for closure in tomllib.loads("\n\n".join(blocks)).get("closure", []):
        point = found[closure["frame_a"]] @ [*closure["point_a_m"], 1.0]
        closure["point_b_m"] = (np.linalg.inv(found[closure["frame_b"]]) @ point)[:3].tolist()
        lines = [f"{key} = {value!r}".replace("'", '"') for key, value in closure.items()]
        rows.append("\n".join(["[[closure]]", *lines]))
    return rows


def at_zero(arm: ArmDescription) -> dict[str, Array]:
    return poses(arm.mechanism, np.zeros(len(arm.joints)), arm.root)


def virtual_centre(arm: ArmDescription) -> Array:
    """Where the pitch axis of the double parallelogram lies: pitch_end - (bottom - driven)."""
    found = at_zero(arm)
    driven = "pitch_back" if arm.type == "PSM" else "pitch_front"
    return (found["pitch_end"] - found["pitch_bottom"] + found[driven])[:3, 3]


def shaft_miss(arm: ArmDescription, centre: Array) -> float:
    shaft = at_zero(arm)["insertion"]
    return float(np.linalg.norm(np.cross(shaft[:3, 2], shaft[:3, 3] - centre)))


def flat_below(mechanism: Mechanism, closure: str) -> float:
    return next(p.below for p in loops.flattenings(mechanism) if p.closure == closure)


@pytest.mark.parametrize("name", sorted(TABLES))
def test_each_erratum_says_what_it_is(name: str) -> None:
    for row in raw(name).get("erratum", []):
        assert set(row) == {"frame", "key", "printed", "mended", "effect", "source"}
        assert row["printed"] != row["mended"] and row["effect"] and row["source"]
    for row in numeric(name):
        frame = next(f for f in raw(name)["frame"] if f["name"] == row["frame"])
        assert frame[row["key"]] == row["printed"]


@pytest.mark.parametrize("name", sorted(TABLES))
def test_printed_loops_close(name: str) -> None:
    mechanism = printed(name).mechanism
    q = mechanism.lower + (mechanism.upper - mechanism.lower) * np.linspace(0, 1, 30)[:, None]
    coordinates = loops.coupled_coordinates(mechanism, q)
    assert loops.gaps(mechanism, coordinates).max(initial=0.0) < EXACT


@pytest.mark.parametrize("name", sorted(TABLES))
def test_mended_table_is_the_arm_we_ship(name: str, tmp_path: Path) -> None:
    table, arm = mended(name, tmp_path), load_arm(TABLES[name])
    rng = np.random.default_rng(3)
    lower, upper = table.mechanism.lower, table.mechanism.upper
    for _ in range(20):
        q = lower + (upper - lower) * rng.random(len(lower))
        ours = q.copy()
        if name == "table4":  # its last two joints are the fingers, ours wrist yaw and jaw
            ours[5:] = 0.5 * (q[5] + q[6]), q[5] - q[6]
        found = poses(table.mechanism, q, table.root)
        expected = poses(arm.mechanism, ours, table.root)
        if name == "table3":
            expected["suj_7"] = expected["mount"]
        for frame in found.keys() & expected.keys() - {"c1", "c2"}:
            np.testing.assert_allclose(
                found[frame], expected[frame], rtol=0, atol=EXACT, err_msg=frame
            )


def test_table4_as_printed_is_mirrored(tmp_path: Path) -> None:
    np.testing.assert_allclose(
        virtual_centre(printed("table4")), [0, -0.4864, 0], rtol=0, atol=EXACT
    )
    turned = mended("table4", tmp_path, ("pitch_plane", "alpha_deg"))
    np.testing.assert_allclose(virtual_centre(turned), [0, 0.4864, 0], rtol=0, atol=EXACT)


def test_table4_beta2_moves_the_upper_link_and_flattens_its_loop(tmp_path: Path) -> None:
    turned = mended("table4", tmp_path, ("pitch_plane", "alpha_deg"))
    wrong, right = at_zero(turned)["pitch_top"][:3, 3], at_zero(load_arm("psm"))["pitch_top"][:3, 3]
    np.testing.assert_allclose(wrong - right, [0.0, -0.0271, -0.0081], rtol=0, atol=1e-4)
    below = at_zero(turned)["pitch_bottom"][:3, 3]
    for upper in (wrong, right):  # 6 to 7 cannot tell: 36.5 mm either way
        assert np.linalg.norm(upper - below) == pytest.approx(0.0365, abs=5e-5)
    assert flat_below(turned.mechanism, "c2") == pytest.approx(-0.88, abs=0.005)
    assert min(p.margin for p in loops.flattenings(turned.mechanism)) < 0.0


def test_table4_rounding_leaves_the_shaft_beside_the_remote_centre(tmp_path: Path) -> None:
    turned = mended("table4", tmp_path, ("pitch_plane", "alpha_deg"))
    assert shaft_miss(turned, virtual_centre(turned)) == pytest.approx(7.8e-6, abs=5e-7)
    assert shaft_miss(mended("table4", tmp_path), np.array([0.0, 0.4864, 0.0])) < EXACT


def test_table5_as_printed_folds_back(tmp_path: Path) -> None:
    np.testing.assert_allclose(
        virtual_centre(printed("table5")), [0, 0.0682, 0], rtol=0, atol=EXACT
    )
    forward = mended("table5", tmp_path, ("yaw", "d_m"))
    np.testing.assert_allclose(virtual_centre(forward), [0, 0.6126, 0], rtol=0, atol=EXACT)


def test_table5_a4_puts_the_back_link_in_front_and_flattens_near_the_range(tmp_path: Path) -> None:
    forward = mended("table5", tmp_path, ("yaw", "d_m"))
    both = mended("table5", tmp_path, ("yaw", "d_m"), ("pitch_back", "a_m"))
    assert at_zero(forward)["pitch_back"][1, 3] > at_zero(forward)["pitch_front"][1, 3]
    assert at_zero(both)["pitch_back"][1, 3] < at_zero(both)["pitch_front"][1, 3]
    assert flat_below(forward.mechanism, "c1") == pytest.approx(-0.96, abs=0.005)
    assert min(p.margin for p in loops.flattenings(forward.mechanism)) < 0.2
    assert min(p.margin for p in loops.flattenings(load_arm("ecm").mechanism)) > 0.5


def test_table5_rounding_moves_the_scope(tmp_path: Path) -> None:
    forward = mended("table5", tmp_path, ("yaw", "d_m"))
    assert shaft_miss(forward, np.array([0.0, 0.6126, 0.0])) == pytest.approx(9e-6, abs=1e-6)
    short = at_zero(forward)["roll"][2, 3] - at_zero(load_arm("ecm"))["tip"][2, 3]
    assert abs(short) == pytest.approx(0.13e-3, abs=1e-5)


def test_table3_rounded_45_degrees_moves_the_remote_centre(tmp_path: Path) -> None:
    literal = at_zero(printed("table3"))["suj_7"]
    meant = at_zero(mended("table3", tmp_path, ("suj_5", "alpha_rad")))["suj_7"]
    apart = (literal - meant) @ SCOPE_CENTRE
    assert np.linalg.norm(apart) == pytest.approx(60e-6, abs=10e-6)


def test_table3_row7_turns_the_scope_round(tmp_path: Path) -> None:
    theta = errata("table3", "suj_7", "theta_rad")
    assert theta["mended"] == -theta["printed"]
    one = at_zero(printed("table3"))["suj_7"]
    other = at_zero(mended("table3", tmp_path, ("suj_7", "theta_rad")))["suj_7"]
    apart = (one - other) @ SCOPE_CENTRE
    assert np.linalg.norm(apart) == pytest.approx(1.2252, abs=1e-9)


def test_table3_row7_is_close_to_saws_transform() -> None:
    row = errata("table3", "suj_7", "d_m")
    assert row["printed"] - row["mended"] == pytest.approx(0.0013)


def test_dvrk_envs_psm3_stands_lower(tmp_path: Path) -> None:
    text = (PAPER / "table2.toml").read_text(encoding="utf-8")
    path = tmp_path / "env.toml"
    path.write_text(text.replace("d_m = 0.1429", "d_m = -0.1429"), encoding="utf-8")
    drop = at_zero(printed("table2"))["suj_6"][2, 3] - at_zero(load_arm(path))["suj_6"][2, 3]
    assert drop == pytest.approx(0.2858)

"""A recording is drawn: which arms, which joints, in which units, and what cannot be drawn."""

from __future__ import annotations

import base64
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from trocar.errors import InputError, LogError, MissingExtraError, UnknownNameError
from trocar.plotting import plot
from trocar.plotting.plot import arm_figure, steps, thinned
from trocar.recording import open_recording, record
from trocar.simulation import World

pytest.importorskip("mcap")
pytest.importorskip("matplotlib")
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    world = World("full_cart")
    path = tmp_path_factory.mktemp("plots") / "run.mcap"
    with record(world, path):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.arm("PSM1").servo_jp([np.nan] * 6)
        world.arm("ECM").move_jp([0.1, 0.1, 0.1, 0.0])
        world.step(600)
    return path


def test_each_arm_that_moved_has_its_own_png(file: Path, tmp_path: Path) -> None:
    report = plot(file, tmp_path / "x.png", joint="yaw")
    assert set(report.arms) == {"PSM1", "ECM"}
    assert report.files == tuple(str(tmp_path / f"x-{arm}.png") for arm in report.arms)
    assert all(Path(name).read_bytes().startswith(PNG) for name in report.files)


def test_one_arm_has_the_name_that_was_asked_for(file: Path, tmp_path: Path) -> None:
    assert plot(file, tmp_path / "x.png", "PSM2", "yaw").files == (str(tmp_path / "x.png"),)


def test_a_page_holds_every_arm_and_asks_nobody_for_anything(file: Path, tmp_path: Path) -> None:
    plot(file, tmp_path / "x.html")
    page = (tmp_path / "x.html").read_text(encoding="utf-8")
    assert page.count("<canvas") == 3 * (7 + 4)  # PSM1 and ECM
    assert "move_jp" in page and "insertion" in page
    assert not re.search(r"https?://|@import|<link|<img| src=", page)


def test_the_page_carries_the_curves_to_the_last_sample(file: Path, tmp_path: Path) -> None:
    plot(file, tmp_path / "x.html", "PSM1", "yaw")
    page = (tmp_path / "x.html").read_text(encoding="utf-8")
    charts = json.loads(page.partition("const CHARTS = ")[2].partition(";\n")[0])
    assert [chart["unit"] for chart in charts] == ["deg", "mrad", "N m"]
    setpoint, measured = charts[0]["curves"]
    assert (setpoint["held"], measured["held"]) == (True, False)
    time, values = (np.frombuffer(base64.b64decode(measured[k]), "<f4") for k in "tv")
    recorded = open_recording(file)
    columns = recorded.columns("PSM1")
    assert columns is not None
    states = recorded.states(columns)
    np.testing.assert_allclose(time, states.time, rtol=1e-6)
    np.testing.assert_allclose(values, np.degrees(states.position[:, 0]), rtol=1e-5, atol=1e-6)


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of set-points at 50 Hz, each held for 20 periods."""
    world, path = World("psm"), tmp_path_factory.mktemp("held") / "run.mcap"
    with record(world, path):
        for k in range(100):
            world.arm("PSM1").servo_jp([0.002 * k, 0.0, 0.12, 0.0, 0.0, 0.0])
            world.step(20)
    return path


def test_held_set_points_are_steps_and_their_saw_teeth_are_pale_under_a_mean(held: Path) -> None:
    recorded = open_recording(held)
    columns = recorded.columns("PSM1")
    assert columns is not None
    states = recorded.states(columns)
    figure = arm_figure(states, [0], "PSM1", [])
    position, error, _ = figure.get_axes()
    (setpoint,) = [x for x in position.get_lines() if x.get_label() == "set-point"]
    assert setpoint.get_drawstyle() == "steps-post"
    assert len(np.asarray(setpoint.get_xdata())) <= 102
    pale, mean = error.get_lines()
    assert (pale.get_alpha(), mean.get_label()) == (0.25, "error")
    settled = np.asarray(mean.get_ydata())[500:-200]
    teeth = np.asarray(pale.get_ydata())[500:-200]
    assert np.abs(np.diff(settled)).max() < 0.1 * np.abs(np.diff(teeth)).max()


def test_steps_keep_each_change_and_the_end() -> None:
    time, values = steps(np.arange(6.0), np.array([1.0, 1.0, 2.0, 2.0, 2.0, 2.0]))
    assert (time.tolist(), values.tolist()) == ([0.0, 2.0, 5.0], [1.0, 2.0, 2.0])


def test_a_figure_names_joints_units_and_lines(file: Path) -> None:
    recorded = open_recording(file)
    columns = recorded.columns("PSM1")
    assert columns is not None
    states = recorded.states(columns)
    figure = arm_figure(states, range(7), "PSM1", [0.1])
    axes = figure.get_axes()
    assert len(axes) == 21
    assert [a.get_ylabel() for a in axes[6:9]] == ["insertion\n[mm]", "[mm]", "[N]"]
    assert [a.get_ylabel() for a in axes[:3]] == ["yaw\n[deg]", "[mrad]", "[N m]"]
    assert {t.get_text() for t in figure.legends[0].get_texts()} == {
        "set-point", "measured", "error", "effort", "warning or fault",
    }  # fmt: skip
    drawn = {line.get_label(): line for line in axes[0].get_lines()}
    assert np.asarray(drawn["measured"].get_ydata())[-1] == pytest.approx(
        np.degrees(states.position[-1, 0])
    )


def test_one_joint_alone(file: Path, tmp_path: Path) -> None:
    report = plot(file, tmp_path / "x.png", joint="wrist_yaw")
    assert report.arms == ("PSM1",)


def test_a_thinned_curve_reaches_as_far_as_the_whole_one() -> None:
    time = np.arange(100_000.0)
    values = np.random.default_rng(1).normal(size=len(time))
    values[77_777] = 50.0
    t, v = thinned(time, values, 500)
    assert len(t) <= 1002 and (np.diff(t) > 0).all()
    assert (v.min(), v.max()) == (values.min(), 50.0)
    assert t[np.argmax(v)] == 77_777
    assert thinned(time[:50], values[:50], 500)[0].size == 50


def test_a_truncated_recording_is_drawn_as_far_as_it_goes(tmp_path: Path) -> None:
    world, path = World("psm"), tmp_path / "run.mcap"
    with record(world, path):
        world.step(1000)
    path.write_bytes(path.read_bytes()[:-3_000])
    report = plot(path, tmp_path / "x.html")
    assert "breaks off" in report.problem
    assert "breaks off" in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_what_cannot_be_drawn_is_refused(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown arm 'PSM9'.*known: SUJ_PSM1"):
        plot(file, tmp_path / "x.png", "PSM9")
    with pytest.raises(UnknownNameError, match=r"unknown joint 'elbow'.*known: .*insertion"):
        plot(file, tmp_path / "x.png", "PSM1", "elbow")
    with pytest.raises(InputError, match=r"got extension '\.pdf'; allowed: \.png, \.html"):
        plot(file, tmp_path / "x.pdf")
    with pytest.raises(InputError, match=r"no/x\.png: cannot be written: No such file"):
        plot(file, tmp_path / "no" / "x.png", "PSM1", "yaw")
    with pytest.raises(LogError, match="there is no such file"):
        plot(tmp_path / "none.mcap")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[plot\]'"):
        plot(file, tmp_path / "x.png", "PSM1")
    assert plot(file, tmp_path / "x.html", "PSM1").files  # a page draws itself

"""Touches whose joints come from a recording of the arms: as typed ones, or one clear error."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.cli import main
from trocar.descriptions import ArmDescription, load_arm, load_rig
from trocar.errors import TrocarError
from trocar.geometry.se3 import inverse
from trocar.recording import record
from trocar.recording.bags import JointSamples, write_joint_states
from trocar.robot.calibration.registration import between, register
from trocar.robot.calibration.touches import TouchReadings, read_touches
from trocar.robot.mocap.touches import TouchSettings, write_touches
from trocar.robot.recordings import ReadSettings
from trocar.simulation import World

Array = NDArray[np.float64]

PSM = load_arm("psm")
JOINTS = tuple(joint.name for joint in PSM.joints[: PSM.own_joints])
COUNT, RATE_HZ = 12, 100.0
#: Time from one touch to the next, and of the rest in its middle [s].
EACH_S, HELD_S = 2.0, 1.0
#: A date as the clock of a robot counts it [s].
DATE = 1_764_000_000.0


def session(folder: Path) -> tuple[Path, dict[str, TouchReadings], Array, dict[str, Array]]:
    """Write timed touches: (their file, typed readings, times (k,), {arm: positions (k, 6)})."""
    path = folder / "touches.toml"
    arms: dict[str, tuple[str, ArmDescription]] = {"PSM1": ("psm", PSM), "PSM2": ("psm", PSM)}
    write_touches(path, arms, TouchSettings(count=COUNT, noise_m=0.0))
    typed = read_touches(path)
    middle = EACH_S * (np.arange(COUNT) + 0.5)
    ends = np.column_stack([middle - 0.5 * HELD_S, middle + 0.5 * HELD_S]).ravel()
    times = np.arange(round(COUNT * EACH_S * RATE_HZ)) / RATE_HZ
    rows = ["arm,point,time"]
    motion: dict[str, Array] = {}
    for name, one in typed.items():
        held = np.repeat(one.q[:, : len(JOINTS)], 2, axis=0)
        motion[name] = np.stack([np.interp(times, ends, q) for q in held.T], axis=1)
        rows += [f"{name},{point},{t:g}" for point, t in zip(one.names, middle, strict=True)]
    path.with_suffix(".csv").write_text("\n".join(rows))
    return path, typed, times, motion


def write_csv(file: Path, times: Array, motion: dict[str, Array]) -> Path:
    head = ["time [s]", *(f"{arm}_{joint}_position" for arm in motion for joint in JOINTS)]
    table = np.column_stack([times, *motion.values()])
    np.savetxt(file, table, fmt="%.12g", delimiter=",", header=",".join(head), comments="")
    return file


def write_bag(file: Path, times: Array, motion: dict[str, Array]) -> Path:
    write_joint_states(
        file,
        {f"/{arm}/measured_js": JointSamples(JOINTS, times, q) for arm, q in motion.items()},
    )
    return file


def relative(readings: dict[str, TouchReadings]) -> Array:
    found = register(readings)
    return between(found["PSM1"], found["PSM2"])[0]


@pytest.mark.parametrize("start", [0.0, DATE])
@pytest.mark.parametrize("name", ["log.csv", "log.mcap"])
def test_a_recording_registers_as_typed_readings_do(
    tmp_path: Path, name: str, start: float
) -> None:
    path, typed, times, motion = session(tmp_path)
    write = write_csv if name.endswith("csv") else write_bag
    log = write(tmp_path / name, times + start, motion)
    found = read_touches(path, log)
    np.testing.assert_allclose(relative(found), relative(typed), atol=1e-6)
    assert found["PSM2"].understood.startswith("PSM2: 6 joints at 100.0 Hz")


def test_joints_of_a_touch_are_the_mean_of_its_rest(tmp_path: Path) -> None:
    path, typed, times, motion = session(tmp_path)
    flicker = 5e-5 * np.resize([1.0, -1.0], len(times))[:, None]
    log = write_csv(tmp_path / "log.csv", times, {n: q + flicker for n, q in motion.items()})
    # 19 to 21 samples, as the ends round: at most one is left over
    off = read_touches(path, log)["PSM1"].q[:, :6] - typed["PSM1"].q[:, :6]
    np.testing.assert_allclose(off, 0.0, atol=5e-5 / 18)


def test_times_may_be_those_of_the_recordings_own_clock(tmp_path: Path) -> None:
    path, typed, times, motion = session(tmp_path)
    table = path.with_suffix(".csv")
    head, *rows = table.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    for start in (7.0, DATE):
        late = [f"{arm},{point},{float(time) + start:.6f}" for arm, point, time in cells]
        table.write_text("\n".join([head, *late]))
        log = write_csv(tmp_path / f"{start:g}.csv", times + start, motion)
        found = read_touches(path, log)
        np.testing.assert_allclose(found["PSM1"].q, typed["PSM1"].q, atol=1e-9)


def test_times_of_a_table_with_times_of_day_count_from_its_start(tmp_path: Path) -> None:
    path, typed, times, motion = session(tmp_path)
    log = write_csv(tmp_path / "log.csv", times, motion)
    head, *rows = log.read_text().splitlines()
    days = [
        f"12:00:{float(time):09.6f},{values}"
        for time, _, values in (row.partition(",") for row in rows)
    ]
    log.write_text("\n".join([head, *days]))
    np.testing.assert_allclose(read_touches(path, log)["PSM2"].q, typed["PSM2"].q, atol=1e-9)


def test_a_recording_of_a_simulation_has_the_joints_of_its_world(tmp_path: Path) -> None:
    path, typed, _, _ = session(tmp_path)
    world, rests = World(load_rig("two_psm_ecm")), list[Array]()
    rows, file = ["arm,point,time"], tmp_path / "run.mcap"
    with record(world, file):
        for k in range(3):
            for name in typed:
                world.set_state(
                    name, PSM.poses["home"] + [0.1 * k, 0.1, 0.01 * k, 0.1, 0.1, 0.1, 0]
                )
            world.step(round(0.5 / world.timestep))
            middle = world.time
            rests.append(np.stack([world.true_state(name).q for name in typed]))
            world.step(round(0.2 / world.timestep))
            rows += [f"{name},{one.names[k]},{middle:.6f}" for name, one in typed.items()]
    path.with_suffix(".csv").write_text("\n".join(rows))
    found = read_touches(path, file)
    for arm, one in enumerate(found.values()):
        for k, rest in enumerate(rests):
            np.testing.assert_allclose(one.q[k, :6], rest[arm, :6], atol=2e-4)


def test_one_arm_need_not_be_named_in_the_recording(tmp_path: Path) -> None:
    path, typed, times, motion = session(tmp_path)
    text = path.read_text()
    path.write_text(text.replace('[arms.PSM2]\ndescription = "psm"\ntip_m = [0.0, 0.0, 0.0]', ""))
    table = path.with_suffix(".csv")
    table.write_text("\n".join(table.read_text().splitlines()[: COUNT + 1]))
    bare = tmp_path / "bare.npy"
    np.save(bare, np.column_stack([times, motion["PSM1"]]))
    found = read_touches(path, bare, ReadSettings(wrist="joint"))
    np.testing.assert_allclose(found["PSM1"].q, typed["PSM1"].q, atol=1e-9)
    log = write_csv(tmp_path / "log.csv", times, {"PSM2": motion["PSM1"], "PSM3": motion["PSM2"]})
    found = read_touches(path, log, ReadSettings(of="PSM2"))
    np.testing.assert_allclose(found["PSM1"].q, typed["PSM1"].q, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "PSM1,P3,5",
            "PSM1,P3,5.45",
            r"line 4: PSM1 at 5.45 s: \w+ moved by .* within 0.1 s of it",
        ),
        ("PSM1,P3,5", "PSM1,P3,99", r"line 4: PSM1 at 99 s: outside .*; allowed: 0 to 23.99 s"),
        ("PSM1,P3,5", "PSM1,P3,", r"line 4: time is blank"),
        ("PSM1,P3,5", "PSM1,P3,x", r"line 4: time: got 'x'"),
        ("point,time", "point,when", r"has no column time; allowed with a recording: arm, point"),
        ("point,time", "point,time,yaw", r"has a column yaw; allowed with a recording: arm, point"),
        ("point,time", "x_m,y_m,z_m,qw,qx,qy,qz", r"line 1: has views of a board; allowed with"),
    ],
)
def test_touches_that_a_recording_cannot_give_are_refused_with_their_line(
    tmp_path: Path, old: str, new: str, text: str
) -> None:
    path, _, times, motion = session(tmp_path)
    table = path.with_suffix(".csv")
    assert old in table.read_text()
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(TrocarError, match=text):
        read_touches(path, write_csv(tmp_path / "log.csv", times, motion))


def test_recordings_that_lack_an_arm_or_samples_are_refused(tmp_path: Path) -> None:
    path, _, times, motion = session(tmp_path)
    both = write_csv(tmp_path / "both.csv", times, motion)
    one = write_csv(tmp_path / "one.csv", times, {"PSM1": motion["PSM1"]})
    with pytest.raises(TrocarError, match="unknown arm 'PSM2'"):
        read_touches(path, one)
    few = tmp_path / "few.csv"
    head = ["time", *(f"{arm}_{joint}_position" for arm in motion for joint in JOINTS[:3])]
    table = np.column_stack([times, *(q[:, :3] for q in motion.values())])
    np.savetxt(few, table, delimiter=",", header=",".join(head), comments="")
    with pytest.raises(TrocarError, match=r"few.csv: PSM1: lacks roll, wrist_pitch, wrist_yaw"):
        read_touches(path, few)
    bare = tmp_path / "bare.npy"
    np.save(bare, np.column_stack([times, motion["PSM1"]]))
    with pytest.raises(TrocarError, match="names no arm"):
        read_touches(path, bare)
    gap = np.abs(times - 5.0) > 0.2
    cut = write_csv(tmp_path / "cut.csv", times[gap], {n: q[gap] for n, q in motion.items()})
    with pytest.raises(TrocarError, match=r"line 4: PSM1 at 5 s: .* has 0 samples within 0.1 s"):
        read_touches(path, cut)
    with pytest.raises(TrocarError, match="got it for 2 arms"):
        read_touches(path, both, ReadSettings(of="PSM1"))
    with pytest.raises(TrocarError, match="has times; allowed without them only: --rate"):
        read_touches(path, both, ReadSettings(rate_hz=50.0))
    with pytest.raises(TrocarError, match=r"times of touches need a recording, --from FILE"):
        read_touches(path)


def test_the_command_says_what_it_understood_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, _, times, motion = session(tmp_path)
    truth = json.loads((tmp_path / "touches.toml.truth.json").read_text())
    log = write_csv(tmp_path / "log.csv", times, motion)
    assert main(["calibrate-bases", str(path), "--from", str(log), "--json"]) == 0
    out, err = capsys.readouterr()
    assert "PSM1: 6 joints at 100.0 Hz" in err
    assert "PSM2: 6 joints at 100.0 Hz" in err
    one, two = (np.array(truth[name]["T_reference_base"]) for name in motion)
    found = json.loads(out)["bases"]["T_PSM1_PSM2"]["xyz_m"]
    assert found == pytest.approx((inverse(one) @ two)[:3, 3].tolist(), abs=1e-3)
    for words, text in (
        (["--units", "deg/mm"], "--units: has no effect here; allowed with --from only"),
        (["--from", str(log), "--topic", "/a"], "--topic: has no effect here; allowed with a bag"),
        (["--from", str(tmp_path / "none.csv")], "none.csv"),
    ):
        assert main(["calibrate-bases", str(path), *words]) == 2
        assert text in capsys.readouterr().err

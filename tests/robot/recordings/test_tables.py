"""Tables of any layout hold the same motion: headers, units, rates, several arms, poses."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.geometry.rotations import quaternion_from_matrix, rpy_from_matrix
from trocar.kinematics.chain_pose import chain_pose
from trocar.robot.recordings import ReadSettings, read_arm_motion, tip_motions
from trocar.robot.recordings.columns import taken_apart

Array = NDArray[np.float64]
PSM = load_arm("psm")
JOINTS = PSM.mechanism.joint_names
TURNS = np.array([joint.kind == "revolute" for joint in PSM.joints])


def motion(rate_hz: float = 30.0, count: int = 60) -> tuple[Array, Array, Array]:
    """Times, positions and velocities of all joints of a PSM."""
    time = np.arange(count) / rate_hz
    phase = time[:, None] + np.arange(7)
    middle = np.array([0.1, -0.2, 0.15, 0.3, 0.1, 0.2, 0.5])
    size = np.array([0.2, 0.2, 0.03, 0.4, 0.2, 0.2, 0.2])
    return time, middle + size * np.sin(phase), size * np.cos(phase)


def csv(path: Path, header: Sequence[str], table: Array, separator: str = ",") -> Path:
    lines = [separator.join(header)] if header else []
    lines += [separator.join(f"{value:.12g}" for value in row) for row in table]
    path.write_text("\n".join(lines) + "\n")
    return path


def dvrk(name: str) -> str:
    return name if name == "jaw" else f"outer_{name}"


HEADERS: dict[str, Callable[[], list[str]]] = {
    "ours": lambda: ["time", *(f"{j}_position" for j in JOINTS)],
    "dvrk names": lambda: ["timestamp", *(f"PSM1_{dvrk(j)}" for j in JOINTS)],
    "numbers": lambda: ["Time (s)", *(f"q{k}" for k in range(1, 8))],
    "numbers from 0": lambda: ["t", *(f"joint_{k}.pos" for k in range(7))],
    "rostopic": lambda: ["field.header.stamp", *(f"field.position{k}" for k in range(7))],
    "plotjuggler": lambda: [
        "__time",
        *(f"/PSM1/measured_js/{dvrk(j)}/position" for j in JOINTS[:6]),
        "/PSM1/jaw/measured_js/jaw/position",
    ],
    "dvrk 1": lambda: [
        "%time",
        *(f"dvrk_PSM1_state_joint_current_{k}" for k in range(6)),
        "dvrk_PSM1_state_jaw_current_0",
    ],
    "camel": lambda: ["Timestamp", *(f"psm1JointPosition{k}" for k in range(1, 8))],
    "spaces": lambda: ["time", *(f"PSM1 {j.replace('_', ' ')}" for j in JOINTS)],
}


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_a_header_of_any_style_names_the_same_motion(
    tmp_path: Path, header: Callable[[], list[str]]
) -> None:
    time, q, v = motion()
    names = header()
    nanoseconds = names[0] in ("%time", "field.header.stamp")
    stamp = 1e9 * (1_700_000_000 + time) if nanoseconds else time
    lines = [",".join(names)]
    for t, row in zip(stamp, q, strict=True):
        lines.append(",".join([f"{t:.9f}", *(f"{value:.12g}" for value in row)]))
    (tmp_path / "log.csv").write_text("\n".join(lines))
    found = read_arm_motion(tmp_path / "log.csv", PSM)
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    # nanoseconds of today are rounded to 256 by float64
    assert found.rate_hz == pytest.approx(30.0, rel=1e-4)
    # differences of five points: h^4 / 30
    np.testing.assert_allclose(found.rows[2:-2, 1], v[2:-2], atol=1e-4)
    assert found.recorded[1] == found.recorded[2] == frozenset()
    assert "7 joints at 30.0 Hz, velocities by differences, no efforts" in found.understood()


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("decimal", [".", ","])
def test_separators_and_decimal_commas_are_found(
    tmp_path: Path, separator: str, decimal: str
) -> None:
    if decimal == "," and separator != ";":
        pytest.skip("a decimal comma needs semicolons")
    time, q, _ = motion()
    names = ["time", *(f"{j}_position" for j in JOINTS)]
    path = csv(tmp_path / "log.txt", names, np.column_stack([time, q]), separator)
    if decimal == ",":
        path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)


def test_columns_in_lists_comments_and_a_gzip_file_are_read(tmp_path: Path) -> None:
    time, q, _ = motion()
    lines = ["# recorded on a Tuesday", "time,name,position"]
    lines += [f'{t:.6f},"PSM1","[{", ".join(map(str, row))}]"'
              for t, row in zip(time, q.tolist(), strict=True)]  # fmt: skip
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)


def test_units_are_those_of_the_header_or_the_given_ones(tmp_path: Path) -> None:
    time, q, _ = motion()
    scaled = np.column_stack([1e3 * time, np.where(TURNS, np.rad2deg(q), 1e3 * q)])
    named = ["t [ms]", *(f"{j} [{'deg' if t else 'mm'}]" for j, t in zip(JOINTS, TURNS,
                                                                      strict=True))]  # fmt: skip
    path = csv(tmp_path / "named.csv", named, scaled)
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)
    suffixed = [
        "t_ms",
        *(f"{j}_{'deg' if t else 'mm'}" for j, t in zip(JOINTS, TURNS, strict=True)),
    ]
    path = csv(tmp_path / "suffixed.csv", suffixed, scaled)
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)
    path = csv(tmp_path / "bare.csv", ["t", *JOINTS], scaled)
    with pytest.raises(LogError, match="would fit in other units: --units deg/mm"):
        read_arm_motion(path, PSM)
    found = read_arm_motion(path, PSM, ReadSettings(units="deg/mm"))
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    assert found.rate_hz == pytest.approx(30.0)  # times of 33.3 are milliseconds
    with pytest.raises(UnknownNameError, match="furlong"):
        read_arm_motion(path, PSM, ReadSettings(units="furlong"))


def test_one_of_two_arms_is_chosen_by_its_name(tmp_path: Path) -> None:
    time, q, _ = motion()
    names = ["time", *(f"{arm}.{j}_rad" if j != "insertion" else f"{arm}.{j}_m"
                       for arm in ("PSM1", "PSM2") for j in JOINTS)]  # fmt: skip
    path = csv(tmp_path / "log.csv", names, np.column_stack([time, q, 0.5 * q]))
    with pytest.raises(LogError, match="holds 2 arms; select one with --of: PSM1, PSM2"):
        read_arm_motion(path, PSM)
    found = read_arm_motion(path, PSM, ReadSettings(of="psm2"))
    np.testing.assert_allclose(found.rows[:, 0], 0.5 * q, atol=1e-9)
    assert found.label == "PSM2"
    with pytest.raises(UnknownNameError, match="PSM3"):
        read_arm_motion(path, PSM, ReadSettings(of="PSM3"))


def test_measured_columns_are_taken_beside_commanded_ones(tmp_path: Path) -> None:
    time, q, _ = motion()
    names = [f"{j}_{what}" for what in ("setpoint_position", "position") for j in JOINTS]
    path = csv(tmp_path / "log.csv", ["time", *names], np.column_stack([time, 0.5 * q, q]))
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)


def test_columns_are_chosen_by_hand(tmp_path: Path) -> None:
    time, q, v = motion()
    table = np.column_stack([np.where(TURNS, np.rad2deg(q), q), 1e3 * time, v, 0.0 * time])
    path = csv(tmp_path / "log.csv", [], table)
    columns = ("time=7[ms]", "PSM1.position=0:7[deg/m]", "PSM1.velocity=8:15")
    found = read_arm_motion(path, PSM, ReadSettings(columns=columns))
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    np.testing.assert_allclose(found.rows[:, 1], v, atol=1e-9)
    assert (found.label, found.rate_hz) == ("PSM1", pytest.approx(30.0))
    for text, problem in {
        "position": "allowed: .*WHAT=COLUMNS",
        "speed=1:3": "allowed: .*WHAT one of time, position",
        "position=0:99": "allowed: FIRST:LAST in 0:16",
        "position=0:9": "9 columns; allowed: 7",
    }.items():
        with pytest.raises(InputError, match=problem):
            read_arm_motion(path, PSM, ReadSettings(columns=(text,)))
    with pytest.raises(UnknownNameError, match="nowhere"):
        read_arm_motion(path, PSM, ReadSettings(columns=("position=nowhere",)))


@pytest.mark.parametrize("width", [6, 7, 14, 21])
@pytest.mark.parametrize("timed", [False, True])
def test_rows_without_a_header_may_lack_velocities_and_have_times(
    tmp_path: Path, width: int, timed: bool
) -> None:
    time, q, v = motion(200.0)
    table = np.column_stack([q, v, 0.1 + 0.0 * q])[:, :width]
    path = csv(tmp_path / "log.csv", [], np.column_stack([time, table]) if timed else table)
    how = ReadSettings(wrist="joint", rate_hz=None if timed or width > 7 else 200.0)
    found = read_arm_motion(path, PSM, how)
    joints = min(width, 7)
    np.testing.assert_allclose(found.rows[:, 0, :joints], q[:, :joints], atol=1e-9)
    np.testing.assert_allclose(found.rows[2:-2, 1, :joints], v[2:-2, :joints], atol=1e-6)
    assert (found.timed, found.has_efforts) == (timed, width == 21)
    assert found.rate_hz == pytest.approx(200.0)


def test_a_rate_is_asked_for_and_a_wrong_one_is_noticed(tmp_path: Path) -> None:
    _, q, v = motion(30.0, 200)
    path = csv(tmp_path / "alone.csv", [], q)
    with pytest.raises(InputError, match="has no times; give the rate of its rows, --rate HZ"):
        read_arm_motion(path, PSM)
    path = csv(tmp_path / "log.csv", [], np.hstack([q, v, 0.0 * q]))
    with pytest.raises(LogError, match=r"at 200 Hz: the rate is perhaps 30 Hz \(--rate\)"):
        read_arm_motion(path, PSM, ReadSettings(wrist="joint"))
    found = read_arm_motion(path, PSM, ReadSettings(wrist="joint", rate_hz=30.0))
    assert found.rate_hz == pytest.approx(30.0)
    # a given rate is doubted, not overruled
    doubted = read_arm_motion(path, PSM, ReadSettings(wrist="joint", rate_hz=100.0))
    assert "the rate is perhaps 30 Hz" in doubted.understood()
    fast = read_arm_motion(tmp_path / "alone.csv", PSM, ReadSettings(wrist="joint", rate_hz=3000.0))
    assert "times its limit: a wrong rate or unit?" in fast.understood()


def test_two_arms_without_a_header_are_not_taken_for_velocities(tmp_path: Path) -> None:
    _, q, _ = motion()
    path = csv(tmp_path / "log.csv", [], np.hstack([q, q[::-1]]))
    with pytest.raises(InputError, match="14 columns are not positions and their velocities"):
        read_arm_motion(path, PSM)


def tips(q: Array) -> Array:
    return chain_pose(PSM.mechanism)(q)


def test_poses_of_the_tip_with_a_jaw_become_joints(tmp_path: Path) -> None:
    time, q, _ = motion()
    poses = tips(q)
    turn = poses[:, :3, :3].reshape(-1, 9)
    header = ["time", *(f"PSM1_position_{a}" for a in "xyz"),
              *(f"PSM1_R_{k}" for k in range(9)), "PSM1_jaw"]  # fmt: skip
    path = csv(
        tmp_path / "log.csv", header, np.column_stack([time, poses[:, :3, 3], turn, q[:, 6]])
    )
    found = read_arm_motion(path, PSM)
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-6)
    assert "joints from poses of the tip" in found.understood()
    moved = np.eye(4)
    moved[:3, 3] = 0.3, -0.1, 0.2
    with pytest.raises(LogError, match=r"60 of 60 poses are out of reach, the first in row 2: .*"
                                       r"is its base \(--base\) in the frame"):  # fmt: skip
        read_arm_motion(path, PSM, ReadSettings(base=moved))


def test_a_base_is_placed_where_the_mean_pose_is_home(tmp_path: Path) -> None:
    time, q, _ = motion()
    home = PSM.poses["home"]
    q = home + 0.2 * (q - q.mean(axis=0))
    q[:, 2] = 0.12 + 0.2 * (motion()[1][:, 2] - 0.15)
    away = tips(np.array([[0.5, 0.3, 0.2, 0.1, 0.2, 0.3, 0.0]]))[0]
    poses = away @ tips(q)
    header = ["t", "x", "y", "z", *(f"r{k}" for k in range(9))]
    table = np.column_stack([time, poses[:, :3, 3], poses[:, :3, :3].reshape(-1, 9)])
    path = csv(tmp_path / "log.csv", header, table)
    found = read_arm_motion(path, PSM, ReadSettings(base="centred"))
    assert "base placed so that the mean pose is home" in found.understood()
    # the tip moves as it was recorded
    own = found.rows[:, 0].copy()
    moved = tips(own)[:, :3, 3]
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(moved, axis=0), axis=1),
        np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1),
        atol=1e-6,
    )


def test_jigsaws_columns_are_known(tmp_path: Path) -> None:
    """76 columns at 30 Hz: masters, then slaves; position, rotation, velocities, gripper."""
    _, q, _ = motion()
    poses = tips(q)
    table = np.zeros((len(q), 76))
    table[:, 57:60], table[:, 60:69] = poses[:, :3, 3], poses[:, :3, :3].reshape(-1, 9)
    table[:, 75] = q[:, 6]
    path = csv(tmp_path / "Suturing_B001.txt", [], table, "     ")
    found = read_arm_motion(path, PSM, ReadSettings(of="slave_right"))
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-6)
    assert found.rate_hz == pytest.approx(30.0)
    (seen,) = tip_motions(path, "slave_right")
    np.testing.assert_allclose(seen.positions, poses[:, :3, 3], atol=1e-9)


def test_tips_to_score_have_a_unit_in_which_they_are_near(tmp_path: Path) -> None:
    time = np.arange(20) / 10.0
    p = np.column_stack([0.1 * np.cos(time), 0.1 * np.sin(time), 0.05 + 0.0 * time])
    path = csv(tmp_path / "tips.csv", [], np.column_stack([time, 1e6 * p]))
    columns = "time=0[s]", "tip=1:4"
    with pytest.raises(LogError, match=r"the tip is .* m away; allowed: 2 m"):
        tip_motions(path, how=ReadSettings(columns=columns))
    named = ReadSettings(columns=("time=0[s]", "tip=1:4[um]"))
    for how in (named, ReadSettings(columns=columns, units="rad/um")):
        (seen,) = tip_motions(path, how=how)
        np.testing.assert_allclose(seen.positions, p, atol=1e-12)


@pytest.mark.parametrize(
    ("header", "problem"),
    [
        (["time", "yaw_position", "pitch_position"], "lacks columns insertion_position, roll"),
        (["time", "a", "b"], "has no columns of the joints of psm: time, a, b; allowed"),
        (
            ["time", "yaw_position", "pitch_position", "insertion_position", "roll_position"],
            "lacks columns wrist_pitch_position, wrist_yaw_.* --columns position=NAME1",
        ),
    ],
)
def test_missing_columns_are_named(tmp_path: Path, header: list[str], problem: str) -> None:
    path = csv(
        tmp_path / "log.csv", header, np.zeros((3, len(header))) + np.arange(3)[:, None] * 0.1
    )
    with pytest.raises(LogError, match=problem):
        read_arm_motion(path, PSM)


def test_words_in_a_needed_column_are_named_and_others_ignored(tmp_path: Path) -> None:
    time, q, _ = motion()
    path = csv(tmp_path / "log.csv", ["time", *JOINTS, "gesture"], np.column_stack([time, q, time]))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(line.rpartition(",")[0] + ",G3" for line in lines[1:])]))
    np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)
    lines[5] = lines[5].replace(lines[5].split(",")[1], "oops", 1)
    path.write_text("\n".join(lines))
    with pytest.raises(LogError, match="row 6: yaw: got 'oops'; allowed: a number"):
        read_arm_motion(path, PSM)


def test_a_dataset_is_read_episode_by_episode(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra learn)")
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    time, q, _ = motion()
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    names = [f"PSM2.{j}_{'rad' if t else 'm'}" for j, t in zip(JOINTS, TURNS, strict=True)]
    text = '{"features": {"observation.state": {"names": [%s]}}}'
    (tmp_path / "meta" / "info.json").write_text(text % ", ".join(f'"{n}"' for n in names))
    file = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    table = arrow.table(
        {
            "observation.state": [*(0.5 * q).tolist(), *q.tolist()],
            "action": np.zeros((2 * len(q), 2)).tolist(),
            "timestamp": [*time, *time],
            "episode_index": [0] * len(q) + [1] * len(q),
            "task": ["sew"] * (2 * len(q)),
        }
    )
    parquet.write_table(table, file)
    for path in (tmp_path, file):
        found = read_arm_motion(path, PSM, ReadSettings(episode=1))
        np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-6)
        assert (found.label, found.rate_hz) == ("PSM2", pytest.approx(30.0))
    with pytest.raises(InputError, match="holds 2 episodes, 0 to 1; select one with --episode"):
        read_arm_motion(tmp_path, PSM)
    with pytest.raises(LogError, match="has no episode 7; allowed: 0 to 1"):
        read_arm_motion(tmp_path, PSM, ReadSettings(episode=7))
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(LogError, match="cannot be read as Parquet"):
        read_arm_motion(tmp_path, PSM, ReadSettings(episode=1))


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("PSM1_joint_3", ("PSM1", False, "position", 3)),
        ("measured_q2", ("", False, "position", 2)),
        ("setpoint_q2", ("", True, "position", 2)),
        ("psm2.outer_wrist_yaw.vel", ("PSM2", False, "velocity", "wrist_yaw")),
        ("PSM1_ee_yaw", ("PSM1", False, "tip", "yaw")),
        ("PSM1_orientation_matrix_[2,3]", ("PSM1", False, "tip", "r5")),
        ("SLAVE_LEFT_ROT_R12", ("slave_left", False, "tip", "r1")),
        ("SLAVE_LEFT_LIN_VEL_X", ("slave_left_lin_x", False, "velocity", None)),
        ("psm1_pose.orientation.w", ("PSM1", False, "tip", "qw")),
        ("MTML_1", ("MTML", False, "position", 1)),
        ("observation.state PSM1.jaw", ("PSM1", False, "position", "jaw")),
        ("action PSM1.jaw", ("PSM1", True, "position", "jaw")),
        ("Frame Number", ("number", False, "other", None)),
    ],
)
def test_names_of_public_recordings_are_taken_apart(
    name: str, found: tuple[str, bool, str, str | int | None]
) -> None:
    one = taken_apart(name, JOINTS)
    assert (one.arm, one.setpoint, one.quantity, one.joint) == found


def test_a_header_over_groups_of_columns_numbers_them(tmp_path: Path) -> None:
    time, q, _ = motion()
    header = ["t", "tracker positions", "", "", "dvrk cartesian positions", "", ""]
    header += ["dvrk joint positions", *[""] * 6]
    table = np.column_stack([time, np.zeros((len(q), 6)), q])
    for names in (header, header[:8]):
        path = csv(tmp_path / "log.csv", names, table)
        np.testing.assert_allclose(read_arm_motion(path, PSM).rows[:, 0], q, atol=1e-9)


WRIST = ("roll", "wrist_pitch", "wrist_yaw", "jaw")


@pytest.mark.parametrize("header", [True, False])
def test_the_first_three_joints_alone_are_read(tmp_path: Path, header: bool) -> None:
    time, q, v = motion(200.0, 300)
    table = np.column_stack([q[:, :3], v[:, :3], 0.1 * q[:, :3]])
    names = [f"{joint}_{what}" for what in ("position", "velocity", "effort")
             for joint in JOINTS[:3]]  # fmt: skip
    if header:
        path = csv(tmp_path / "log.csv", ["time", *names], np.column_stack([time, table]))
    else:
        path = csv(tmp_path / "log.csv", [], table)
    found = read_arm_motion(path, PSM)
    np.testing.assert_allclose(found.rows[:, 0], np.column_stack([q[:, :3], 0 * q[:, 3:]]))
    assert [sorted(known) for known in found.recorded] == [sorted(JOINTS[:3])] * 3
    assert f"3 joints at 200.0 Hz, no {', '.join(WRIST)} (at 0)" in found.understood()
    with pytest.raises(LogError, match="holds no roll, wrist_pitch, wrist_yaw: the tip"):
        tip_motions(path)


def test_three_bare_columns_are_refused_with_the_option_that_reads_them(tmp_path: Path) -> None:
    _, q, _ = motion(200.0, 300)
    path = csv(tmp_path / "log.csv", [], q[:, :3])
    with pytest.raises(LogError, match=r"got 3 columns; .* e.g. --columns position=0:3"):
        read_arm_motion(path, PSM)
    how = ReadSettings(columns=("position=0:3",), rate_hz=200.0)
    np.testing.assert_allclose(read_arm_motion(path, PSM, how).rows[:, 0, :3], q[:, :3])


#: Headers of several rows, as spreadsheets and pandas write them.
HEADS = {
    "name, unit": (["time", *JOINTS], ["s", *("m" if j == "insertion" else "rad" for j in JOINTS)]),
    "joint, quantity": (["", *JOINTS], ["time", *["position"] * 7]),
    "arm, joint": (["", "PSM1", *[""] * 6], ["time", *JOINTS]),
    "quantity, number": (["", "PSM1 position", *[""] * 6], ["t [s]", *"1234567"]),
    "arm, quantity, joint": (
        ["", "PSM1", *[""] * 6],
        ["", "position", *[""] * 6],
        ["time", *(f"q{k}" for k in range(1, 8))],
    ),
    "one name": (["time", *["position"] * 7],),
    "group of blanks": (["time", "current joint positions"],),
    "preamble": (["coefficient:", "0.25"], ["time", *JOINTS]),
    "words before": (["Recorded by", "the lab"], ["operator 3"], ["time", *JOINTS]),
    "blank rows before": ([""] * 5, ["time", *JOINTS]),
    "numbered by pandas": (["", *map(str, range(8))],),
    "title": (["log of PSM1"], ["rate", "30"], ["time", *JOINTS]),
}


@pytest.mark.parametrize("heads", HEADS.values(), ids=HEADS)
def test_rows_of_words_before_the_numbers_are_a_header(
    tmp_path: Path, heads: Sequence[Sequence[str]]
) -> None:
    time, q, _ = motion()
    indexed = heads[-1][1] == "0"
    table = np.column_stack([np.arange(float(len(time))), time, q] if indexed else [time, q])
    path = csv(tmp_path / "log.csv", [], table)
    head = "\n".join(",".join(head) for head in heads)
    path.write_text(f"{head}\n\n{path.read_text()}" if len(heads) == 3 else
                    f"{head}\n{path.read_text()}")  # fmt: skip
    how = ReadSettings(wrist="joint")
    np.testing.assert_allclose(read_arm_motion(path, PSM, how).rows[:, 0], q, atol=1e-9)


def test_lines_before_a_table_are_said_to_be_left_out(tmp_path: Path) -> None:
    time, q, _ = motion()
    path = csv(tmp_path / "log.csv", ["time", *JOINTS], np.column_stack([time, q]))
    path.write_text(f"coefficient:,0.25\n{path.read_text()}")
    assert "1 lines before the table left out" in read_arm_motion(path, PSM).understood()


def test_an_array_of_numpy_is_read_as_rows_are(tmp_path: Path) -> None:
    time, q, _ = motion()
    np.save(tmp_path / "log.npy", np.column_stack([time, q]))
    how = ReadSettings(wrist="joint")
    np.testing.assert_allclose(read_arm_motion(tmp_path / "log.npy", PSM, how).rows[:, 0], q)


@pytest.mark.parametrize(
    ("array", "problem"),
    [
        (np.zeros(3), "has 1 dimensions; allowed: 2"),
        (np.array([{"a": 1}]), "cannot be read: Object arrays"),
        (np.zeros((7, 400)), "transposed"),
    ],
)
def test_arrays_of_another_shape_are_refused(tmp_path: Path, array: Array, problem: str) -> None:
    np.save(tmp_path / "log.npy", array)
    with pytest.raises(LogError, match=problem):
        read_arm_motion(tmp_path / "log.npy", PSM)


@pytest.mark.parametrize(
    ("names", "how"),
    [
        (("Rot R", "Rot P", "Rot Y", "Pos X", "Pos Y", "Pos Z"), {}),
        (("ee_roll_deg", "ee_pitch_deg", "ee_yaw_deg", "ee_x", "ee_y", "ee_z"), {}),
        ((), {"columns": ("time=0", "rpy=1:4", "tip=4:7")}),
    ],
)
def test_poses_of_a_tip_by_three_angles_become_joints(
    tmp_path: Path, names: Sequence[str], how: dict[str, Any]
) -> None:
    time, q, _ = motion(count=20)
    poses = chain_pose(PSM.mechanism)(q)
    rpy = np.array([rpy_from_matrix(pose[:3, :3]) for pose in poses])
    if names and names[0].endswith("deg"):
        rpy = np.degrees(rpy)
    header = ["t", *names] if names else []
    path = csv(tmp_path / "log.csv", header, np.column_stack([time, rpy, poses[:, :3, 3]]))
    found = read_arm_motion(path, PSM, ReadSettings(**how))
    np.testing.assert_allclose(found.rows[:, 0, :6], q[:, :6], atol=1e-6)
    assert "joints from poses of the tip" in found.understood()


def test_a_header_that_is_written_again_is_left_out(tmp_path: Path) -> None:
    time, q, _ = motion()
    path = csv(tmp_path / "log.csv", ["time", *JOINTS], np.column_stack([time, q]))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:30], lines[0], *lines[30:]]))
    found = read_arm_motion(path, PSM)
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    assert "the header written again 1 times left out" in found.understood()


def test_lists_in_fields_are_columns_as_converters_of_bags_write_them(tmp_path: Path) -> None:
    time, q, v = motion()
    head = "timestamp,header.stamp.sec,header.stamp.nanosec,header.frame_id,name,position,velocity"
    lines = ["# Topic: /PSM1/measured_js", "# Type: sensor_msgs/msg/JointState", f"{head},effort"]
    names = ", ".join(repr(name) for name in JOINTS[:6])
    for t, row, speed in zip(time, q, v, strict=True):
        sec, nano = 1_700_000_000 + int(t), round(1e9 * (t % 1.0))
        lists = ",".join(f'"{values[:6].tolist()}"' for values in (row, speed))
        lines.append(f'{sec}{nano:09},{sec},{nano},,"[{names}]",{lists},[]')
    (tmp_path / "PSM1_measured_js.csv").write_text("\n".join(lines))
    found = read_arm_motion(tmp_path / "PSM1_measured_js.csv", PSM)
    np.testing.assert_allclose(found.rows[:, 0, :6], q[:, :6], atol=1e-9)
    np.testing.assert_allclose(found.rows[:, 1, :6], v[:, :6], atol=1e-9)
    assert found.rate_hz == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("start", "problem"),
    [
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "is a spreadsheet .*: save it as CSV"),
        (b"PK\x03\x04\x14", "is a spreadsheet .*: save it as CSV"),
        (b"MATLAB 5.0 MAT-file", "is a MAT-file: write its table"),
        (b"\x89HDF\r\n", "is an HDF5 file"),
        (b"\x80\x04\x95", "is a pickle"),
    ],
)
def test_files_of_other_programs_are_refused_with_a_way(
    tmp_path: Path, start: bytes, problem: str
) -> None:
    (tmp_path / "log").write_bytes(start + bytes(100))
    with pytest.raises(LogError, match=problem):
        read_arm_motion(tmp_path / "log", PSM)


def test_bare_poses_are_not_taken_for_joints(tmp_path: Path) -> None:
    time, q, _ = motion()
    poses = chain_pose(PSM.mechanism)(q)
    turns = np.array([quaternion_from_matrix(pose[:3, :3])[[1, 2, 3, 0]] for pose in poses])
    path = csv(tmp_path / "log.txt", [], np.column_stack([time, poses[:, :3, 3], turns]), " ")
    with pytest.raises(InputError, match="are quaternions of poses, no joints; name them, --colu"):
        read_arm_motion(path, PSM)
    how = ReadSettings(columns=("time=0", "tip=1:8"))
    np.testing.assert_allclose(read_arm_motion(path, PSM, how).rows[:, 0, :6], q[:, :6], atol=1e-6)


def test_stamps_that_nobody_set_are_no_times(tmp_path: Path) -> None:
    time, q, _ = motion()
    stamp = "header.stamp.secs", "header.stamp.nsecs"
    header = ["Time", *stamp, *(f"position_{k}" for k in range(6))]
    none = np.zeros((len(time), 2))
    path = csv(tmp_path / "log.csv", header, np.column_stack([time, none, q[:, :6]]))
    assert read_arm_motion(path, PSM).rate_hz == pytest.approx(30.0)


def test_rows_in_brackets_are_read(tmp_path: Path) -> None:
    _, q, _ = motion()
    lines = [f"[ {'  '.join(f'{value:.9e}' for value in row)} ]" for row in q]
    (tmp_path / "log.txt").write_text("\n".join(lines))
    how = ReadSettings(rate_hz=30.0, wrist="joint")
    np.testing.assert_allclose(read_arm_motion(tmp_path / "log.txt", PSM, how).rows[:, 0], q)


def test_a_file_of_words_alone_holds_no_numbers(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text('{"t": 0, "q": "a"}\n{"t": 1, "q": "b"}\n')
    with pytest.raises(LogError, match="holds no rows of numbers"):
        read_arm_motion(tmp_path / "log.jsonl", PSM)


@pytest.mark.parametrize("form", [
    "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f", "%Y/%m/%d/%H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f",
    "%m/%d/%Y %H:%M:%S.%f", "%H:%M:%S.%f",
])  # fmt: skip
@pytest.mark.parametrize("head", ["time", "Recorded at"])
def test_dates_are_times(tmp_path: Path, form: str, head: str) -> None:
    """Rows of 10 s at 30 Hz, and those of one each two seconds."""
    for step in (1.0 / 30.0, 2.0):
        _, q, _ = motion(30.0, 300)
        begin = datetime(2026, 5, 1, 12, 0, 0, 500, UTC)
        lines = [",".join([head, *(f"q{k}" for k in range(1, 8))])]
        for k, row in enumerate(q):
            when = (begin + timedelta(seconds=k * step)).strftime(form)
            lines.append(",".join([when, *map(str, row)]))
        path = tmp_path / "log.csv"
        path.write_text("\n".join(lines))
        found = read_arm_motion(path, PSM)
        assert found.rate_hz == pytest.approx(1.0 / step, rel=1e-4)
        assert found.times[-1] - found.times[0] == pytest.approx(299 * step, abs=1e-5)
        np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)


def test_a_date_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,q1,q2,q3,q4,q5,q6,q7\n" + "12:99:00.0,0,0,0.1,0,0,0,0\n" * 3)
    with pytest.raises(LogError, match=r"row 2: time: got '12:99:00\.0'; allowed: a number"):
        read_arm_motion(path, PSM, ReadSettings(columns=("time=0", "position=1:8")))


@pytest.mark.parametrize("kind", ["joints", "tips"])
def test_playfiles_of_two_arms_are_known(tmp_path: Path, kind: str) -> None:
    """Joints, or position, x axis, z axis and jaw, of two PSMs; the time of arrival last."""
    _, q, _ = motion()
    time = 2.0 + 1.5 * np.linspace(0.0, 59.0, 60)
    if kind == "joints":
        table = np.column_stack([0.5 * q, q, time])
    else:
        arms: list[Array] = []
        for joints in (0.5 * q, q):
            T = tips(joints)
            arms.append(np.column_stack([T[:, :3, 3], T[:, :3, 0], T[:, :3, 2], joints[:, 6]]))
        table = np.column_stack([*arms, time])
    path = csv(tmp_path / "handoff.txt", [], table)
    with pytest.raises(LogError, match="holds 2 arms; select one with --of: PSM1, PSM2"):
        read_arm_motion(path, PSM)
    for of, expected in (("PSM1", 0.5 * q), ("PSM2", q)):
        found = read_arm_motion(path, PSM, ReadSettings(of=of))
        np.testing.assert_allclose(found.rows[:, 0], expected, atol=1e-6)
        steps = np.diff(found.times)
        assert np.ptp(steps) < 1e-9 < 1.4 < steps[0] < 1.6


def test_rows_like_a_playfile_are_joints_where_the_last_column_falls(tmp_path: Path) -> None:
    time, q, v = motion(200.0)
    table = np.column_stack([q, v, np.zeros((len(q), 7))])
    found = read_arm_motion(csv(tmp_path / "log.txt", [], table), PSM, ReadSettings(wrist="joint"))
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    path = csv(tmp_path / "timed.txt", [], np.column_stack([time, q, v]))
    found = read_arm_motion(path, PSM, ReadSettings(wrist="joint"))
    np.testing.assert_allclose(found.rows[:, 1], v, atol=1e-9)


def test_the_time_may_be_the_last_column(tmp_path: Path) -> None:
    time, q, v = motion(50.0, count=150)
    table = np.column_stack([q, v, np.zeros_like(q), time])
    found = read_arm_motion(csv(tmp_path / "log.txt", [], table), PSM, ReadSettings(wrist="joint"))
    np.testing.assert_allclose(found.rows[:, 0], q, atol=1e-9)
    assert found.rate_hz == pytest.approx(50.0)


def test_two_columns_like_times_are_a_question(tmp_path: Path) -> None:
    time, q, v = motion(50.0)
    path = csv(tmp_path / "log.txt", [], np.column_stack([time, q, v[:, :6], 2.0 * time]))
    with pytest.raises(InputError, match="the first and the last of 15 columns rise as times do"):
        read_arm_motion(path, PSM)


def test_velocities_of_zero_confirm_no_rate(tmp_path: Path) -> None:
    _, q, _ = motion()
    path = csv(tmp_path / "log.txt", [], np.column_stack([q, np.zeros_like(q)]))
    with pytest.raises(InputError, match="has no times; give the rate of its rows, --rate HZ"):
        read_arm_motion(path, PSM)

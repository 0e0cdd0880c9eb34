"""How a script runs and ends: time, threads, errors, what it imports, and what stays behind."""

from __future__ import annotations

import sys
import threading
import time
from io import StringIO
from pathlib import Path

import pytest

from tests.scripts.playing import play
from trocar.errors import InputError
from trocar.scripts import Live, ScriptError, rig_for, run_script
from trocar.simulation import World

MOVE = """
    import crtk, dvrk, numpy as np, hashlib
    from sensor_msgs.msg import JointState
    ral = crtk.ral("mover")
    arm = dvrk.psm(ral, "PSM1")
    ral.check_connections()
    heard = []
    ral.subscriber("PSM1/measured_js", JointState, lambda m: heard.append(m.position))
    goal = np.array([0.2, -0.1, 0.14, 0.3, 0.1, -0.1])
    assert arm.move_jp(goal).wait()
    rate = ral.create_rate(200)
    for k in range(200):
        arm.servo_jp(goal + 0.0005 * k)
        heard.append(arm.measured_jp()[0])
        rate.sleep()
    arm.jaw.open().wait()
    print(len(heard), hashlib.sha256(np.concatenate(heard).tobytes()).hexdigest())
"""


def test_two_runs_are_the_same_to_the_last_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    outcomes = [play(tmp_path, MOVE) for _ in range(2)]
    first, second = capsys.readouterr().out.splitlines()
    assert first == second
    assert outcomes[0].simulated_s == outcomes[1].simulated_s


def test_time_is_simulated_and_stands_still_while_the_script_computes(tmp_path: Path):
    began = time.monotonic()
    play(
        tmp_path,
        """
        import time
        from time import sleep, monotonic
        start = time.time()
        sum(range(2_000_000))
        assert time.time() == start == monotonic() == time.perf_counter()
        sleep(30)
        time.sleep(0.0005)
        assert abs(time.time() - start - 30.001) < 1e-9, time.time()
        assert time.time_ns() == round(1e9 * time.time())
        try:
            sleep(-1)
        except ValueError as told:
            assert "non-negative" in str(told)
        """,
    )
    assert time.monotonic() - began < 30.0


def test_a_loop_that_only_looks_comes_to_an_end(tmp_path: Path):
    play(
        tmp_path,
        """
        import time, threading
        start = time.time()
        while time.time() < start + 1.0:
            pass
        flag = threading.Event()
        threading.Timer(0.5, flag.set).start()
        while not flag.is_set():
            pass
        assert 1.5 <= time.time() - start < 1.51
        """,
    )


def test_threads_take_turns_in_simulated_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    text = """
    import queue, threading, time
    boxes, lock, full = queue.Queue(2), threading.Lock(), threading.Condition()
    def work(k):
        for i in range(3):
            time.sleep(0.1 * k)
            with lock:
                time.sleep(0.01)
                boxes.put((k, i))
        with full:
            full.notify_all()
    threads = [threading.Thread(target=work, args=(k,)) for k in (1, 2)]
    for thread in threads:
        thread.start()
    order = []
    for _ in range(6):
        order.append((*boxes.get(timeout=5), round(time.time(), 3)))
    for thread in threads:
        thread.join()
    print(order)
    try:
        boxes.get(timeout=2.0)
    except queue.Empty:
        print(round(time.time() - order[-1][2], 3))
    places = threading.Semaphore(1)
    with places:
        print(places.acquire(timeout=0.5), lock.acquire(timeout=1), lock.acquire(timeout=1))
    with full:
        print(full.wait(0.1), full.wait_for(lambda: True))
    def broken():
        raise KeyError("inside")
    thread = threading.Thread(target=broken)
    thread.start(); thread.join(); print(thread.is_alive(), time.time())
    """
    for _ in range(2):
        play(tmp_path, text)
    said = capsys.readouterr()
    lines = said.out.splitlines()
    half = len(lines) // 2
    assert lines[:half] == lines[half:]
    assert float(lines[1]) == pytest.approx(2.0, abs=2e-3)
    assert lines[2:4] == ["False True False", "False True"]
    assert lines[4].startswith("False")
    assert "KeyError: 'inside'" in said.err


def test_a_script_that_raises_shows_its_own_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    outcome = play(tmp_path, "def deep():\n    raise ValueError('mine')\ndeep()\n")
    said = capsys.readouterr().err
    assert outcome.status == 1
    assert said.splitlines()[0] == "Traceback (most recent call last):"
    assert f'File "{tmp_path}/script.py", line 3, in <module>' in said.splitlines()[1]
    assert "trocar" not in said.replace(str(tmp_path), "")
    assert said.endswith("ValueError: mine\n")


def test_what_the_library_builds_on_locks_waits_in_simulated_time(tmp_path: Path):
    text = """
    import threading, time
    gate, met = threading.Barrier(2), []
    def work():
        time.sleep(1.0)
        met.append(gate.wait())
    began = time.time()
    threading.Thread(target=work).start()
    met.append(gate.wait(5.0))
    assert sorted(met) in ([0], [1], [0, 1]) and 0.99 < time.time() - began < 1.02
    try:
        threading.BoundedSemaphore(1).release()
    except ValueError:
        met.append("bounded")
    assert met[-1] == "bounded"
    with threading.RLock() as held, threading.Condition() as own:
        assert held and own
    """
    assert play(tmp_path, text).status == 0


@pytest.mark.parametrize(
    ("text", "status"), [("0", 0), ("", 0), ("3", 3), ("None", 0), ("'no arm'", 1)]
)
def test_the_exit_status_is_what_the_script_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, status: int
):
    assert play(tmp_path, f"import sys; sys.exit({text})").status == status
    assert ("no arm" in capsys.readouterr().err) == ("arm" in text)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("import threading\nthreading.Event().wait()\n", "line 2: threading.Event().wait()"),
        (
            "import time\ntry:\n    time.sleep(1e6)\nexcept Exception:\n    pass\n",
            "line 3: time.sle",
        ),
        ("import threading as t\nx = t.Thread(target=t.Event().wait)\nx.start()\n", "not finished"),
    ],
)
def test_a_script_that_waits_for_ever_is_ended(tmp_path: Path, text: str, where: str):
    with pytest.raises(ScriptError, match=r"script\.py: not finished after 5 s") as told:
        play(tmp_path, text, timeout_s=5.0)
    assert where in str(told.value)


@pytest.mark.skipif(not hasattr(__import__("signal"), "pthread_kill"), reason="no such signals")
def test_a_script_that_does_nothing_for_ever_is_ended(tmp_path: Path):
    with pytest.raises(
        ScriptError, match=r"not finished after 0\.3 s; it was at line 1: while True"
    ):
        play(tmp_path, "while True: pass", timeout_s=0.3)


@pytest.mark.parametrize("module", ["tf2_ros", "actionlib", "moveit_commander", "moveit_msgs.msg"])
def test_a_part_of_ros_that_is_missing_is_named(tmp_path: Path, module: str):
    with pytest.raises(InputError, match=r"script\.py: line 2: needs the ROS package") as told:
        play(tmp_path, f"import sys\nimport {module}\n")
    assert repr(module.split(".")[0]) in str(told.value)
    assert "crtk, crtk_msgs, cv_bridge, dvrk" in str(told.value)


@pytest.mark.parametrize(
    "text", ["import tf\ntf.TransformBroadcaster()", "from tf import Listener"]
)
def test_transforms_of_topics_are_a_part_that_is_missing(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"needs the ROS package 'tf\.\w+'.* tf.transformations"):
        play(tmp_path, text)


def test_a_script_may_do_without_a_part_of_ros(tmp_path: Path):
    text = "try:\n    import tf2_ros\nexcept ImportError:\n    found = False\nassert not found\n"
    assert play(tmp_path, text).status == 0


def test_a_message_that_is_missing_is_told_with_those_that_are_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    assert play(tmp_path, "from geometry_msgs.msg import Nothing").status == 1
    assert "geometry_msgs.msg has: Point, " in capsys.readouterr().err


def test_a_module_beside_the_script_is_taken_before_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    (tmp_path / "dvrk.py").write_text("own = 'mine'\n", encoding="utf-8")
    play(tmp_path, "import dvrk, crtk; print(dvrk.own, crtk.ral)")
    assert capsys.readouterr().out.startswith("mine <class")
    assert "dvrk" not in sys.modules


ROSPY = """
    import rospy, threading
    from sensor_msgs.msg import JointState
    from crtk_msgs.srv import QueryForwardKinematics
    rospy.init_node("plain", anonymous=True)
    assert rospy.get_name() == "/plain" and rospy.get_node_uri()
    first = rospy.wait_for_message("/PSM1/measured_js", JointState, timeout=2)
    assert first.header.stamp > rospy.Time(0)
    assert first.header.stamp - rospy.Time() > rospy.Duration(1)
    told = []
    rospy.Subscriber("PSM1/setpoint_js", JointState, lambda m, more: told.append(more), "more")
    publisher = rospy.Publisher("/PSM1/servo_jp", JointState, queue_size=1)
    assert publisher.get_num_connections() == 1
    rate, start = rospy.Rate(100), rospy.get_time()
    told.clear()
    while rospy.get_time() - start < 1.0 and not rospy.is_shutdown():
        publisher.publish(JointState(position=[0.05, 0.0, 0.12, 0.0, 0.0, 0.0]))
        rate.sleep()
    assert told == ["more"] * len(told) and 99 <= len(told) <= 101, len(told)
    rospy.wait_for_service("PSM1/forward_kinematics", 1.0)
    proxy = rospy.ServiceProxy("PSM1/forward_kinematics", QueryForwardKinematics)
    assert proxy(jp=[0.0, 0.0, 0.12, 0.0, 0.0, 0.0]).result
    try:
        rospy.ServiceProxy("PSM9/forward_kinematics", QueryForwardKinematics)()
    except rospy.ServiceException as told:
        assert "unavailable" in str(told)
    try:
        rospy.wait_for_message("/nothing", JointState, 0.5)
    except rospy.ROSException as told:
        assert "timeout exceeded" in str(told)
    rospy.set_param("~gain", 3)
    assert rospy.get_param("~gain") == 3 and rospy.get_param("other", 4) == 4
    rospy.loginfo("said %d", 1)
    rospy.logwarn_throttle(10, "twice"); rospy.logwarn_throttle(10, "twice")
    beats = []
    timer = rospy.Timer(rospy.Duration(0.1), lambda event: beats.append(rospy.get_time()))
    rospy.sleep(1.05)
    timer.shutdown()
    assert len(beats) == 10 and abs(beats[-1] - beats[0] - 0.9) < 1e-6, beats
    timer.join()
    assert isinstance(timer, threading.Thread) and not timer.is_alive() and len(beats) == 10
    rospy.on_shutdown(lambda: print("bye"))
    rospy.signal_shutdown("enough")
    try:
        rospy.sleep(1.0)
    except rospy.ROSInterruptException:
        print("interrupted")
"""


def test_a_script_may_use_rospy_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert play(tmp_path, ROSPY).status == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[1:] == ["bye", "interrupted"]
    assert said.out.startswith("[INFO] [") and said.err.count("twice") == 1


def test_a_script_may_import_what_is_inside_rospy(tmp_path: Path):
    text = """
    import roslib; roslib.load_manifest("my_package")
    import rospy
    import rospy.core
    from rospy.exceptions import ROSException
    from rospy.rostime import Time
    assert not rospy.core.is_initialized()
    rospy.init_node("any")
    assert rospy.core.is_initialized() and not rospy.core.is_shutdown()
    assert ROSException is rospy.ROSException and Time is rospy.Time
    """
    assert play(tmp_path, text).status == 0


def test_a_cloud_of_points_goes_from_a_script_to_itself(tmp_path: Path):
    text = """
    import rospy
    from geometry_msgs.msg import Point32
    from sensor_msgs.msg import ChannelFloat32, PointCloud
    rospy.init_node("any")
    got = []
    rospy.Subscriber("/balls", PointCloud, got.append)
    sender = rospy.Publisher("/balls", PointCloud, queue_size=1)
    rospy.sleep(0.1)
    channel = ChannelFloat32(name="size", values=[4.0])
    sender.publish(PointCloud(points=[Point32(1.0, 2.0, 3.0)], channels=[channel]))
    rospy.sleep(0.1)
    assert got[0].points[0].y == 2.0 and list(got[0].channels[0].values) == [4.0]
    """
    assert play(tmp_path, text).status == 0


def test_names_of_the_command_line_replace_those_of_the_script(tmp_path: Path):
    text = """
    import rospy, sys
    from sensor_msgs.msg import JointState
    rospy.init_node("any")
    assert rospy.wait_for_message("/robot/joints", JointState, timeout=1).position
    assert rospy.resolve_name("/robot/joints") == "/PSM1/measured_js"
    assert rospy.get_param("~gain") == 2.5 and rospy.myargv()[1:] == ["plain"]
    """
    words = ("plain", "/robot/joints:=/PSM1/measured_js", "_gain:=2.5")
    assert play(tmp_path, text, arguments=words).status == 0


def test_a_script_for_python_2_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"script\.py: line 1: .*2to3"):
        play(tmp_path, "print 'hello'\n")


def test_a_sleep_after_the_end_is_an_error_of_the_script(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    outcome = play(tmp_path, "import rospy\nrospy.signal_shutdown('')\nrospy.sleep(1.0)\n")
    assert outcome.status == 1
    assert "ROSInterruptException: ROS shutdown request" in capsys.readouterr().err


def test_a_timer_tells_its_callback_when_it_was_due_and_when_it_came(tmp_path: Path):
    text = """
    import rospy
    period, told = rospy.Duration(0.1), []
    def beat(event):
        assert event.current_real == rospy.get_rostime()
        told.append(event)
        rospy.sleep(0.25 if len(told) == 2 else 0.02)
    begun = rospy.get_rostime()
    timer = rospy.Timer(period, beat)
    rospy.sleep(1.0)
    assert timer.is_alive()
    first, *others = told
    assert (first.last_expected, first.last_real, first.last_duration) == (None, None, None)
    assert first.current_expected == begun + period
    for before, event in zip(told, others):
        assert event.last_expected == before.current_expected
        assert event.last_real == before.current_real
        assert event.current_expected == before.current_expected + period
    lasted = [event.last_duration for event in others]
    assert abs(lasted[0] - 0.02) < 1e-6 and abs(lasted[1] - 0.25) < 1e-6, lasted
    late = [(event.current_real - event.current_expected).to_sec() for event in told]
    tick = 1.1e-3  # what time passes by at least is 1 ms
    assert max(map(abs, late[:2])) < tick and abs(late[2] - 0.15) < tick, late
    """
    assert play(tmp_path, text).status == 0


def test_beside_the_wall_clock_a_timer_is_a_thread_that_is_told_of_its_calls(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "import rospy, threading\n"
        "told, enough = [], threading.Event()\n"
        "def beat(event):\n"
        "    told.append(event)\n"
        "    if len(told) == 2:\n"
        "        enough.set()\n"
        "timer = rospy.Timer(rospy.Duration(0.01), beat)\n"
        "assert isinstance(timer, threading.Thread) and timer.daemon\n"
        "enough.wait()\n"
        "timer.shutdown(); timer.join()\n"
        "first, second, *_ = told\n"
        "assert second.last_real == first.current_real <= second.current_real\n"
        "assert first.last_duration is None and second.last_duration > 0.0\n",
        encoding="utf-8",
    )
    assert run_script(script, [], Live(World("psm"), rate_hz=100.0), 60.0).status == 0


def test_the_client_that_is_tested_with_ros_1_runs_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    client = Path(__file__).parents[1] / "clients" / "rospy" / "move.py"
    assert play(tmp_path, client.read_text(encoding="utf-8"), arguments=("PSM1",)).status == 0
    assert "at the goal" in capsys.readouterr().out


def test_nothing_stays_behind(tmp_path: Path):
    before = dict(sys.modules), list(sys.path), list(sys.argv), list(sys.meta_path)
    threads = threading.active_count()
    play(tmp_path, MOVE)
    left = [name for name in sys.modules if name not in before[0]]
    assert not [name for name in left if name.split(".")[0] in ("crtk", "dvrk", "std_msgs")]
    assert all(sys.modules[name] is module for name, module in before[0].items())
    assert (sys.path, sys.argv, sys.meta_path) == before[1:]
    assert threading.active_count() == threads


def test_a_script_is_run_as_python_runs_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "beside.py").write_text("value = 7\n", encoding="utf-8")
    text = """
    import sys, beside
    if __name__ == "__main__":
        print(sys.argv[1:], __file__ == sys.argv[0], beside.value)
    """
    play(tmp_path, text, arguments=("-a", "PSM1", "-0.5"))
    assert capsys.readouterr().out == "['-a', 'PSM1', '-0.5'] True 7\n"


def test_what_cannot_be_obeyed_is_told_and_the_script_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):  # fmt: skip
    text = """
    import crtk, dvrk, time
    from std_msgs.msg import String
    ral = crtk.ral("wrong"); arm = dvrk.psm(ral, "PSM1"); told = []
    ral.subscriber("PSM1/warning", String, told.append)
    arm.move_jp([0.0, 0.1]); time.sleep(0.1)
    assert "got 2 numbers in position" in told[-1].data, told
    """
    assert play(tmp_path, text).status == 0
    assert "got 2 numbers in position; allowed: 6" in caplog.text


def test_a_callback_that_raises_is_told_and_the_script_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    text = """
    import crtk, time
    from crtk_msgs.msg import OperatingState
    def heard(message):
        raise RuntimeError("in the callback")
    crtk.ral("bad").subscriber("PSM1/operating_state", OperatingState, heard)
    time.sleep(0.1)
    """
    assert play(tmp_path, text).status == 0
    assert "RuntimeError: in the callback" in capsys.readouterr().err


def test_a_callback_may_wait_itself(tmp_path: Path):
    text = """
    import crtk, dvrk, time
    from std_msgs.msg import Bool
    ral = crtk.ral("nested"); arm = dvrk.psm(ral, "PSM1"); depths, ends = [0.14, 0.13], []
    def arrived(message):
        if depths:
            assert arm.insert_jp(depths.pop()).wait()
            ends.append(arm.setpoint_jp()[0][2])
    ral.subscriber("PSM1/goal_reached", Bool, arrived)
    arm.insert_jp(0.15)
    time.sleep(5.0)
    assert [round(end, 6) for end in ends] == [0.13, 0.14], ends
    """
    assert play(tmp_path, text).status == 0


def test_time_goes_on_while_the_simulation_is_paused(tmp_path: Path):
    text = """
    import crtk, dvrk, time
    from std_msgs.msg import Empty
    ral = crtk.ral("paused"); arm = dvrk.psm(ral, "PSM1")
    pause, go_on = (ral.publisher(f"scene/{word}", Empty) for word in ("pause", "resume"))
    handle = arm.insert_jp(0.15)
    time.sleep(0.2)
    pause.publish(); time.sleep(0.01)
    before, start = arm.measured_jp()[0], time.time()
    time.sleep(1.0)
    assert abs(time.time() - start - 1.0) < 1e-9 and (arm.measured_jp()[0] == before).all()
    go_on.publish()
    assert handle.wait() and abs(arm.setpoint_jp()[0][2] - 0.15) < 1e-9
    """
    assert play(tmp_path, text).status == 0


def test_a_folder_that_is_no_package_is_not_taken_for_one(tmp_path: Path):
    (tmp_path / "dvrk").mkdir()
    assert play(tmp_path, "import dvrk; assert dvrk.psm").status == 0


def test_what_is_sent_after_the_end_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = """
    import crtk, dvrk
    ral = crtk.ral("late"); arm = dvrk.arm(ral, "PSM1")
    handle = arm.move_jp([0.0] * 6)
    ral.shutdown()
    assert handle.wait() is False
    arm.hold()
    """
    assert play(tmp_path, text).status == 1
    assert "RuntimeError: cannot send: this script has shut ROS down" in capsys.readouterr().err


def test_beside_the_wall_clock_the_same_script_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):  # fmt: skip
    script = tmp_path / "script.py"
    script.write_text(
        "import crtk, dvrk, time\nral = crtk.ral('live'); arm = dvrk.psm(ral, 'PSM1')\n"
        "ral.check_connections(); start = time.time()\n"
        "assert arm.enable(5) and arm.home(10)\n"
        "assert arm.insert_jp(0.13).wait() and arm.jaw.open(0.5).wait()\n"
        "position, when = arm.measured_jp()\n"
        "assert abs(position[2] - 0.13) < 2e-3 and abs(when - time.time()) < 5.0\n"
        "print(time.time() - start)\n",
        encoding="utf-8",
    )
    outcome = run_script(script, [], Live(World("psm"), rate_hz=100.0), 60.0)
    assert outcome.status == 0
    assert float(capsys.readouterr().out) > 0.3  # the insertion alone takes longer


@pytest.mark.parametrize(
    ("text", "arguments", "rig"),
    [
        ("dvrk.psm(ral, 'PSM1')", (), "psm"),
        ('"PSM2 is no text"\ndvrk.psm(ral, name)  # PSM3', ("-a", "ECM"), "ecm"),
        ("dvrk.psm(ral, 'PSM2')", (), "three_psm"),
        ("dvrk.psm(ral, 'PSM2')", ("PSM1",), "psm"),
        ("('PSM1', 'ECM')", (), "two_psm_ecm"),
        ("import dvrk\ndvrk.teleop_psm(ral, name)", (), "full_cart_mtm"),
        ("import dvrk\ndvrk.suj(ral)", ("PSM1",), "full_cart"),
        ("import dvrk.suj as carriers\ncarriers(ral)", ("PSM1",), "full_cart"),
        ("from dvrk import suj", ("PSM1",), "full_cart"),
        ("from dvrk.suj import *", ("PSM1",), "full_cart"),
        ("import dvrk\ndvrk.console(ral, 'console')", (), "full_cart_mtm"),
        ("import dvrk as d\nd.console(ral)", ("-a", "PSM1"), "full_cart_mtm"),
        ("import dvrk, rich.console\nrich.console.Console()", ("PSM1",), "psm"),
        ("import dvrk\nself.console = self.suj = self.teleop_psm", ("PSM1",), "psm"),
        ("import dvrk as d\ndvrk.console(ral)", ("PSM1",), "psm"),
        ("print(1)", (), "full_cart"),
    ],
)
def test_the_rig_is_the_fastest_that_has_the_arms(text: str, arguments: tuple[str, ...], rig: str):
    assert rig_for(text.encode(), arguments) == rig


def test_a_script_that_cannot_be_read_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"script\.py: line 2: "):
        play(tmp_path, "x = 1\ny = = 2\n")


def test_an_answer_takes_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):  # fmt: skip
    monkeypatch.setattr("sys.stdin", StringIO("yes\n"))
    text = """
    import time
    before = time.time()
    print(input("go? "), f"{time.time() - before:.3f}")
    """
    assert play(tmp_path, text).status == 0
    assert capsys.readouterr().out == "go? yes 1.000\n"

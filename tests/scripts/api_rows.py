"""What a script may call, row by row as docs/script-calls.md lists it, and what has to come of it.

{part: (rig, what comes first, {row: check})}; the rows of a part run in one script, in this order.
"""

from __future__ import annotations

FIRST = "import math, time, crtk, dvrk, PyKDL, numpy as np\nral = crtk.ral('rows')\n"
HOME = "home = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])\n"
PSM = "arm = dvrk.psm(ral, 'PSM1')\nral.check_connections()\n" + HOME
EACH = "import numpy as np\nassert np.shape({0}[0]) == ({1},) and {0}[1] > 0.0, {0}"


def read(call: str, count: int) -> str:
    return f"found = {call}\n" + EACH.format("found", count)


RAL = {
    "crtk.ral(name, namespace)": "assert crtk.ral('n', '/a/').namespace() == 'a'",
    "crtk.ral.parse_argv(argv)": "assert crtk.ral.parse_argv(['-a', 'x:=y', 'b']) == ['-a', 'b']",
    "ral.ros_version()": "assert ral.ros_version() == 1",
    "ral.node_name()": "assert ral.node_name() == 'rows'",
    "ral.namespace()": "assert ral.namespace() == ''",
    "ral.create_child(name)": (
        "child = ral.create_child('PSM1')\nassert child.namespace() == 'PSM1'\n"
        "try:\n    ral.create_child('PSM1')\nexcept RuntimeError as told:\n"
        "    assert 'already has child' in str(told)\nelse:\n    raise AssertionError"
    ),
    "ral.now()": "before = ral.now()\ntime.sleep(0.5)\nassert ral.now() > before",
    "ral.to_sec(t)": "assert abs(ral.to_sec(ral.now() - before) - 0.5) < 1e-6",
    "ral.get_timestamp(message)": (
        "from std_msgs.msg import Header\nfrom sensor_msgs.msg import JointState\n"
        "assert ral.get_timestamp(JointState(header=Header(stamp=before))) == before"
    ),
    "ral.set_timestamp(message)": ("assert ral.set_timestamp(JointState()).header.stamp >= before"),
    "ral.create_time()": "assert ral.create_time().to_sec() == 0.0",
    "ral.create_duration(seconds)": "assert ral.create_duration(1.5).to_sec() == 1.5",
    "ral.create_rate(hz)": (
        "rate = ral.create_rate(100)\nfor _ in range(50):\n    rate.sleep()\n"
        "assert abs(time.time() - before.to_sec() - 1.0) < 0.002, time.time()"
    ),
    "ral.publisher(topic, type, queue_size, latch)": (
        "from std_msgs.msg import Float64\n"
        "half = child.publisher('trajectory_j/set_ratio', Float64)\n"
        "assert half.get_num_connections() == 1\nhalf.publish(0.5)"
    ),
    "ral.subscriber(topic, type, callback, queue_size, latch)": (
        "told = []\nears = child.subscriber('trajectory_j/ratio', Float64, told.append)\n"
        "time.sleep(0.1)\nassert told[-1].data == 0.5, told\nhalf.publish(Float64(1.0))"
    ),
    "ral.service_client(name, type)": (
        "from crtk_msgs.srv import QueryForwardKinematics\n"
        "answer = child.service_client('local/forward_kinematics', QueryForwardKinematics)\n"
        "found = answer(jp=[0.0, 0.0, 0.12, 0.0, 0.0, 0.0])\n"
        "assert found.result and abs(found.cp.position.z + 0.1135) < 1e-3, found"
    ),
    "ral.get_topic_name(end)": "assert ral.get_topic_name(half) == '/PSM1/trajectory_j/set_ratio'",
    "ral.check_connections(timeout, check_children)": (
        "ral.check_connections(1.0)\nlost = ral.publisher('PSM9/move_jp', JointState)\n"
        "try:\n    ral.check_connections(1.0)\nexcept TimeoutError as told:\n"
        "    assert '[/PSM9/move_jp]' in str(told) and 'The rig has PSM1' in str(told), told\n"
        "else:\n    raise AssertionError"
    ),
    "ral.on_shutdown(callback)": "ends = []\nral.on_shutdown(lambda: ends.append(1))",
    "ral.spin()": "ral.spin()",
    "ral.is_shutdown()": "assert not ral.is_shutdown()",
    "ral.shutdown()": "ral.shutdown()\nassert ends == [1] and ral.is_shutdown()",
    "ral.spin_and_execute(function, *arguments)": (
        "sums = []\nral.spin_and_execute(lambda a, b: sums.append(a + b), 1, 2)\nassert sums == [3]"
    ),
}

ARM = {
    "arm.name()": "assert arm.name() == 'PSM1'",
    "arm.ral()": "assert arm.ral().namespace() == 'PSM1'",
    "arm.check_connections(timeout)": "arm.check_connections(1.0)",
    "arm.enable(timeout)": "assert arm.enable(5)",
    "arm.disable(timeout)": "assert arm.disable(5) and arm.is_disabled()",
    "arm.is_enabled()": "assert not arm.is_enabled() and arm.enable(5) and arm.is_enabled()",
    "arm.is_disabled()": "assert not arm.is_disabled()",
    "arm.unhome(timeout)": "assert arm.unhome(5) and not arm.is_homed()",
    "arm.home(timeout)": "assert arm.home(10) and not arm.is_busy(ral.create_time())",
    "arm.is_homed()": "assert arm.is_homed() is True and arm.is_homed(extra=True)[1] > 0.0",
    "arm.operating_state()": "assert arm.operating_state() == 'ENABLED'",
    "arm.wait_for_operating_state(state, timeout)": (
        "assert arm.wait_for_operating_state('ENABLED', 1)\n"
        "assert not arm.wait_for_operating_state('FAULT', 0.5)"
    ),
    "arm.state_command(command)": "arm.state_command('enable')",
    "arm.measured_js()": (
        "p, v, f, when = arm.measured_js()\nassert when > 0.0\n"
        "assert p.shape == v.shape == f.shape == (6,)"
    ),
    "arm.measured_jp()": read("arm.measured_jp()", 6),
    "arm.measured_jv()": read("arm.measured_jv()", 6),
    "arm.measured_jf()": read("arm.measured_jf()", 6),
    "arm.setpoint_js()": "assert len(arm.setpoint_js()) == 4",
    "arm.setpoint_jp()": read("arm.setpoint_jp(wait_timeout=5.0)", 6),
    "arm.setpoint_jv()": read("arm.setpoint_jv(age=0.1, wait=0.2)", 6),
    "arm.setpoint_jf()": read("arm.setpoint_jf(extra=True)", 6),
    "arm.measured_cp()": (
        "cp, when = arm.measured_cp()\nassert isinstance(cp, PyKDL.Frame) and when > 0.0"
    ),
    "arm.setpoint_cp()": "cp, when = arm.setpoint_cp()\nassert isinstance(cp, PyKDL.Frame)",
    "arm.measured_cv()": read("arm.measured_cv()", 6),
    "arm.move_jp(goal)": (
        "handle = arm.move_jp(home + [0.1, 0.0, 0.02, 0.0, 0.0, 0.0])\nassert handle.wait()\n"
        "assert np.allclose(arm.setpoint_jp()[0], [0.1, 0, 0.14, 0, 0, 0])"
    ),
    "arm.move_jr(step)": (
        "assert arm.move_jr(np.array([-0.1, 0, 0, 0, 0, 0])).wait()\n"
        "assert abs(arm.setpoint_jp()[0][0]) < 1e-9"
    ),
    "arm.move_cp(goal)": (
        "goal = arm.setpoint_cp()[0]\ngoal.p[0] += 0.01\nassert arm.move_cp(goal).wait()\n"
        "assert PyKDL.Equal(arm.setpoint_cp()[0], goal, 1e-6)"
    ),
    "handle.wait(is_busy, timeout)": (
        "handle = arm.move_jp(home)\nassert handle.wait(is_busy=True) and handle.wait()\n"
        "assert not arm.move_jp(home + 0.1 * np.eye(6)[0]).wait(timeout=0.01)"
    ),
    "handle.is_busy(timeout)": (
        "handle = arm.move_jp(home)\ncount = 0\nwhile handle.is_busy():\n    count += 1\n"
        "assert count > 100 and np.allclose(arm.setpoint_jp()[0], home)"
    ),
    "arm.is_busy(start_time)": "assert arm.is_busy(ral.now())",
    "arm.wait_for_busy(is_busy, start_time, timeout)": (
        "since = ral.now()\narm.move_jp(home)\nassert arm.wait_for_busy(False, since, 5.0)\n"
        "assert not arm.wait_for_busy(timeout=0.1)"
    ),
    "arm.servo_jp(positions, velocities)": (
        "one = np.eye(6)[0]\nfor k in range(20):\n"
        "    arm.servo_jp(home + 0.005 * k * one, 0.5 * one)\n"
        "    time.sleep(0.01)\narm.servo_jp(home + 0.095 * np.eye(6)[0])\ntime.sleep(0.3)\n"
        "assert abs(arm.measured_jp()[0][0] - 0.095) < 5e-3, arm.measured_jp()"
    ),
    "arm.servo_jr(step)": (
        "arm.servo_jr(-0.005 * np.eye(6)[0])\ntime.sleep(0.1)\n"
        "assert abs(arm.setpoint_jp()[0][0] - 0.09) < 1e-6"
    ),
    "arm.servo_cp(goal)": (
        "goal = arm.setpoint_cp()[0]\ngoal.p[1] += 0.001\narm.servo_cp(goal)\ntime.sleep(0.05)\n"
        "assert PyKDL.Equal(arm.setpoint_cp()[0], goal, 1e-6)"
    ),
    "arm.hold()": "arm.hold()\ntime.sleep(0.05)\nassert arm.is_enabled()",
    "arm.servo_jf(efforts)": (
        "arm.servo_jf(np.array([0.3, 0, 0, 0, 0, 0]))\ntime.sleep(0.02)\n"
        "assert abs(arm.setpoint_jf()[0][0] - 0.3) < 1e-6, arm.setpoint_jf()"
    ),
    "arm.free()": "arm.free()\ntime.sleep(0.05)\narm.hold()\ntime.sleep(0.05)",
    "arm.forward_kinematics(positions)": (
        "frame, good, why = arm.forward_kinematics(home, extra=True)\nassert good\n"
        "assert PyKDL.Equal(arm.forward_kinematics(home), frame)"
    ),
    "arm.inverse_kinematics(seed, goal)": (
        "assert np.allclose(arm.inverse_kinematics(home, frame), home, atol=1e-6)"
    ),
    "arm.local.measured_cp()": "assert isinstance(arm.local.measured_cp()[0], PyKDL.Frame)",
    "arm.local.setpoint_cp()": "assert arm.local.setpoint_cp()[1] > 0.0",
    "arm.local.forward_kinematics(positions)": (
        "assert abs(arm.local.forward_kinematics(home).p.z() + 0.1135) < 1e-3\n"
        "assert arm.local.forward_kinematics(home[:4]) is not None"
    ),
    "arm.body.measured_cf()": read("arm.body.measured_cf()", 6),
    "arm.body.jacobian()": "assert arm.body.jacobian().shape == (6, 6)",
    "arm.body.servo_cf(wrench)": (
        "arm.body.servo_cf(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))\ntime.sleep(0.01)\narm.hold()"
    ),
    "arm.spatial.measured_cf()": read("arm.spatial.measured_cf()", 6),
    "arm.spatial.jacobian()": "assert arm.spatial.jacobian().shape == (6, 6)",
    "arm.spatial.servo_cf(wrench)": "arm.spatial.servo_cf([0.0] * 6)\narm.hold()\ntime.sleep(0.05)",
    "arm.body_set_cf_orientation_absolute(absolute)": "arm.body_set_cf_orientation_absolute(True)",
    "arm.use_gravity_compensation(on)": "arm.use_gravity_compensation(True)",
    "arm.trajectory_j_set_ratio(ratio)": "arm.trajectory_j_set_ratio(0.5)\ntime.sleep(0.1)",
    "arm.trajectory_j_ratio()": "assert arm.trajectory_j_ratio() == 0.5",
    "arm.trajectory_j_get_ratio()": "assert arm.trajectory_j_get_ratio() == 0.5",
}

INSTRUMENT = {
    "psm.insert_jp(depth)": (
        "assert arm.insert_jp(0.15).wait() and abs(arm.setpoint_jp()[0][2] - 0.15) < 1e-9"
    ),
    "psm.set_tool_present(present)": "arm.set_tool_present(True)\ntime.sleep(0.05)",
    "psm.jaw.close()": (
        "assert arm.jaw.close().wait()\n"
        "assert np.allclose(arm.jaw.setpoint_jp()[0], math.radians(-20.0))"
    ),
    "psm.jaw.open(angle)": (
        "assert arm.jaw.open(0.5).wait() and np.allclose(arm.jaw.setpoint_jp()[0], 0.5)"
    ),
    "psm.jaw.move_jp(goal)": "assert arm.jaw.move_jp(np.array([0.3])).wait()",
    "psm.jaw.servo_jp(positions)": (
        "arm.jaw.servo_jp(np.array([0.31]))\ntime.sleep(0.1)\n"
        "assert np.allclose(arm.jaw.setpoint_jp()[0], 0.31)"
    ),
    "psm.jaw.servo_jf(efforts)": "arm.jaw.servo_jf(np.array([0.01]))\ntime.sleep(0.05)",
    "psm.jaw.measured_js()": "assert len(arm.jaw.measured_js()) == 4",
    "psm.jaw.measured_jp()": read("arm.jaw.measured_jp()", 1),
    "psm.jaw.setpoint_js()": "assert len(arm.jaw.setpoint_js()) == 4",
}

MASTER = {
    "mtm.gripper.measured_js()": "assert len(arm.gripper.measured_js()) == 4",
    "mtm.gripper.measured_jp()": read("arm.gripper.measured_jp()", 1),
    "mtm.lock_orientation_as_is()": "arm.lock_orientation_as_is()\ntime.sleep(0.1)",
    "mtm.lock_orientation(rotation)": (
        "arm.lock_orientation(arm.measured_cp()[0].M)\ntime.sleep(0.1)"
    ),
    "mtm.unlock_orientation()": "arm.unlock_orientation()\ntime.sleep(0.1)",
    "mtm.servo_ci(gains)": (
        "from crtk_msgs.msg import CartesianImpedance\ngains = CartesianImpedance()\n"
        "gains.force_orientation.w = gains.torque_orientation.w = 1.0\n"
        "p = arm.measured_cp()[0].p\n"
        "gains.force_position.x, gains.force_position.y, gains.force_position.z = p\n"
        "gains.position_negative.p.z = gains.position_positive.p.z = -100.0\n"
        "arm.servo_ci(gains)\ntime.sleep(0.05)\narm.hold()\nassert not told, told"
    ),
}
WARNED = (
    "from std_msgs.msg import String\ntold = []\n"
    "ral.subscriber('MTMR/warning', String, told.append)\n"
)

SETUP = {
    "suj.PSM1.operating_state()": "assert suj.PSM1.operating_state() == 'ENABLED'",
    "suj.PSM1.measured_js()": "assert suj.PSM1.measured_js()[0].shape == (6,)",
    "suj.PSM1.measured_jp()": read("suj.PSM1.measured_jp()", 6),
    "suj.PSM1.measured_cp()": "assert suj.PSM1.measured_cp()[1] > 0.0",
    "suj.PSM1.local.measured_cp()": "assert suj.PSM1.local.measured_cp()[1] > 0.0",
    "suj.PSM1.move_jp(goal)": (
        "goal = suj.PSM1.measured_jp()[0] + [0.0, 0.02, 0.0, 0.0, 0.0, 0.0]\n"
        "assert suj.PSM1.move_jp(goal).wait()\n"
        "assert np.allclose(suj.PSM1.measured_jp()[0], goal, atol=0.01)"
    ),
    "suj.ral()": "assert suj.ral().namespace() == 'SUJ'",
}

SYSTEM = {
    "system.power_off()": "system.power_off()\nassert arm.wait_for_operating_state('DISABLED', 2)",
    "system.power_on()": "system.power_on()\nassert arm.wait_for_operating_state('ENABLED', 2)",
    "system.home()": "system.home()\ntime.sleep(0.1)\nassert arm.is_homed()",
    "system.set_volume(volume)": (
        "heard = []\nral.subscriber('system/volume', Float64, heard.append)\n"
        "system.set_volume(0.5)\ntime.sleep(0.1)\nassert heard[-1].data == 0.5"
    ),
    "system.beep(duration, frequency, volume)": (
        "said = []\nral.subscriber('system/status', String, said.append)\n"
        "system.beep(0.2, 500.0)\ntime.sleep(0.1)\nassert 'beep' in said[-1].data"
    ),
    "system.string_to_speech(text)": (
        "system.string_to_speech('hello')\ntime.sleep(0.1)\nassert 'hello' in said[-1].data"
    ),
}

TELEOPERATION = {
    "console.teleop_start()": (
        "console.teleop_start()\ntime.sleep(0.2)\nassert told['console/teleop/enabled'] is True"
    ),
    "console.teleop_stop()": (
        "console.teleop_stop()\ntime.sleep(0.2)\nassert told['console/teleop/enabled'] is False"
    ),
    "console.teleop_set_scale(scale)": "console.teleop_set_scale(0.3)\ntime.sleep(0.2)",
    "console.teleop_get_scale()": "assert console.teleop_get_scale() == 0.3",
    "console.teleop_unselect(name)": "console.teleop_unselect('MTMR_PSM1')\ntime.sleep(0.2)",
    "console.teleop_is_selected(name)": "assert not console.teleop_is_selected('MTMR_PSM1')",
    "console.teleop_select(name)": (
        "console.teleop_select('MTMR_PSM1')\ntime.sleep(0.2)\n"
        "assert console.teleop_is_selected('MTMR_PSM1')"
    ),
    "teleop_psm.enable()": (
        "teleop.enable()\ntime.sleep(0.2)\nassert told['MTMR_PSM1/desired_state'] == 'ENABLED'"
    ),
    "teleop_psm.disable()": (
        "teleop.disable()\ntime.sleep(0.2)\nassert told['MTMR_PSM1/current_state'] == 'DISABLED'"
    ),
    "teleop_psm.set_scale(scale)": "teleop.set_scale(0.4)\ntime.sleep(0.2)",
    "teleop_psm.get_scale()": "assert teleop.get_scale() == 0.4",
}
HEARD = """
console, teleop = dvrk.console(ral), dvrk.teleop_psm(ral, 'MTMR_PSM1')
ral.check_connections()
from std_msgs.msg import Bool, String
told = {}
for topic, kind in (('console/teleop/enabled', Bool), ('MTMR_PSM1/desired_state', String),
                    ('MTMR_PSM1/current_state', String)):
    ral.subscriber(topic, kind, lambda m, topic=topic: told.__setitem__(topic, m.data))
"""

ADDED = (
    ("operating_state", "operating_state"), ("measured_js", "measured_jp"),
    ("setpoint_js", "setpoint_jp"), ("measured_cp", "measured_cp"),
    ("setpoint_cp", "setpoint_cp"), ("measured_cv", "measured_cv"), ("hold", "hold"),
    ("free", "free"), ("servo_jp", "servo_jp"), ("servo_jr", "servo_jr"),
    ("servo_jf", "servo_jf"), ("servo_cp", "servo_cp"),
    ("servo_cv", "servo_cv"), ("move_jp", "move_jp"), ("move_jr", "move_jr"),
    ("move_cp", "move_cp"), ("forward_kinematics", "forward_kinematics"),
    ("inverse_kinematics", "inverse_kinematics"),
)  # fmt: skip
UTILS = {
    "crtk.utils(instance, ral, connection_timeout)": "made = crtk.utils(device, own, 2.0)",
    **{
        f"utils.add_{feature}()": f"made.add_{feature}()\nassert callable(device.{method})"
        for feature, method in ADDED
    },
    "utils.add_measured_cf()": (
        "body = crtk.utils(tip, own.create_child('body'), 2.0)\nbody.add_measured_cf()\n"
        "assert tip.measured_cf()[1] > 0.0"
    ),
    "utils.add_servo_cf()": "body.add_servo_cf()\nassert callable(tip.servo_cf)",
    "utils.add_jacobian()": "body.add_jacobian()\nassert tip.jacobian().shape == (6, 6)",
    "crtk.joystick_button(ral, name, index)": (
        "pedal = crtk.joystick_button(ral, 'footpedals/camera')\ntime.sleep(0.05)\n"
        "from sensor_msgs.msg import Joy\npush = ral.publisher('console/emulate_camera', Joy)\n"
        "push.publish(buttons=[1])"
    ),
    "button.wait(timeout, value)": "assert pedal.wait(2.0, value=1) and not pedal.wait(0.1)",
    "button.value()": "assert pedal.value() == 1",
    "button.set_callback(callback)": (
        "seen = []\npedal.set_callback(seen.append)\npush.publish(buttons=[0])\ntime.sleep(0.1)\n"
        "assert seen == [0]"
    ),
    "crtk.measured_cp(ral)": (
        "assert crtk.measured_cp(ral.create_child('PSM1')).measured_cp()[1] > 0.0"
    ),
    "crtk.wait_move_handle(instance, ral)": (
        "since = crtk.wait_move_handle(device, own)\ndevice.move_jp([0.0, 0, 0.12, 0, 0, 0])\n"
        "assert since.wait()"
    ),
}
DEVICE = "class Device: pass\ndevice, tip = Device(), Device()\nown = crtk.ral('device', 'PSM1')\n"

PARTS: dict[str, tuple[str, str, dict[str, str]]] = {
    "ral": ("psm", FIRST, RAL),
    "utils": ("psm", FIRST + DEVICE, UTILS),
    "arm": ("psm", FIRST + PSM, ARM),
    "psm": ("psm", FIRST + PSM, INSTRUMENT),
    "ecm": (
        "ecm",
        FIRST + "arm = dvrk.ecm(ral, 'ECM')\nral.check_connections()\n",
        {"ecm.insert_jp(depth)": "assert arm.insert_jp(0.1).wait()"},
    ),
    "mtm": ("mtm", FIRST + "arm = dvrk.mtm(ral, 'MTMR')\n" + WARNED, MASTER),
    "suj": ("full_cart", FIRST + "suj = dvrk.suj(ral)\nral.check_connections()\n", SETUP),
    "system": (
        "psm",
        FIRST + PSM + "from std_msgs.msg import Float64, String\nsystem = dvrk.system(ral)\n",
        SYSTEM,
    ),
    "console": ("full_cart_mtm", FIRST + HEARD, TELEOPERATION),
}  # fmt: skip

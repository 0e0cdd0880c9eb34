"""rosbag, rosbag2_py, cv_bridge and tf_conversions of scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.scripts.playing import play
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rpy
from trocar.scripts import transformations as turns
from trocar.scripts.image_bridge import CvBridgeError, ImageBridge

RNG = np.random.default_rng(8)


def test_what_a_script_writes_into_a_bag_comes_out_again(tmp_path: Path):
    pytest.importorskip("rosbags", reason="the extra bags is not installed")
    text = f"""
    import rosbag, rospy
    from sensor_msgs.msg import JointState
    from crtk_msgs.msg import OperatingState
    rospy.init_node("bags")
    path, sent = "{tmp_path}/log.bag", []
    with rosbag.Bag(path, "w") as bag:
        for k in range(5):
            message = JointState(name=["yaw"], position=[0.1 * k])
            message.header.stamp = rospy.Time.now()
            bag.write("/PSM1/measured_js", message)
            bag.write("/PSM1/operating_state", OperatingState(state="ENABLED"), rospy.Time(k + 1))
            sent.append(message)
            rospy.sleep(0.1)
    bag = rosbag.Bag(path)
    assert [m for _, m, _ in bag.read_messages(topics=["/PSM1/measured_js"])] == sent
    later = list(bag.read_messages("/PSM1/operating_state", start_time=rospy.Time(3)))
    assert [m.timestamp.secs for m in later] == [3, 4, 5] and later[0].message.state == "ENABLED"
    info = bag.get_type_and_topic_info().topics["/PSM1/measured_js"]
    assert (info.msg_type, info.message_count) == ("sensor_msgs/JointState", 5)
    assert abs(info.frequency - 10.0) < 0.1 and bag.get_message_count() == 10
    assert bag.get_start_time() == 1.0
    """
    assert play(tmp_path, text).status == 0


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_of_ros_2_comes_out_again(tmp_path: Path, storage: str):
    pytest.importorskip("rosbags", reason="the extra bags is not installed")
    text = f"""
    import rclpy.serialization, rosbag2_py
    from rosidl_runtime_py.utilities import get_message
    from crtk_msgs.msg import OperatingState
    where = rosbag2_py.StorageOptions(uri="{tmp_path}/bag", storage_id="{storage}")
    plain = rosbag2_py.ConverterOptions("cdr", "cdr")
    writer = rosbag2_py.SequentialWriter()
    writer.open(where, plain)
    kind = "crtk_msgs/msg/OperatingState"
    writer.create_topic(rosbag2_py.TopicMetadata(name="/state", type=kind))
    sent = [OperatingState(state=str(k), is_busy=bool(k % 2)) for k in range(4)]
    for k, message in enumerate(sent):
        writer.write("/state", rclpy.serialization.serialize_message(message), 10 * k)
    writer.close()
    reader = rosbag2_py.SequentialReader()
    reader.open(where, plain)
    kinds = {{topic.name: topic.type for topic in reader.get_all_topics_and_types()}}
    assert kinds == {{"/state": kind}}
    found = []
    reader.seek(10)
    reader.set_filter(rosbag2_py.StorageFilter(topics=["/state"]))
    while reader.has_next():
        topic, data, when = reader.read_next()
        found.append(rclpy.serialization.deserialize_message(data, get_message(kinds[topic])))
    assert found == sent[1:], found
    """
    assert play(tmp_path, text).status == 0


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "mono16", "rgb16"])
def test_pixels_go_into_a_message_and_back(encoding: str):
    wide = np.uint16 if encoding.endswith("16") else np.uint8
    shape = {"m": (), "r": (3,), "b": (3,)}[encoding[0]] if "a" not in encoding else (4,)
    pixels = RNG.integers(0, np.iinfo(wide).max, (5, 7, *shape)).astype(wide)
    message = ImageBridge().cv2_to_imgmsg(pixels, encoding)
    assert np.array_equal(ImageBridge().imgmsg_to_cv2(message), pixels)
    assert message.step * message.height == len(message.data)


def test_colours_change_places_and_grey_is_their_mean():
    pixels = RNG.integers(0, 255, (4, 6, 3)).astype(np.uint8)
    message = ImageBridge().cv2_to_imgmsg(pixels, "rgb8")
    assert np.array_equal(ImageBridge().imgmsg_to_cv2(message, "bgr8"), pixels[..., ::-1])
    grey = ImageBridge().imgmsg_to_cv2(message, "mono8")
    assert np.allclose(grey, pixels @ [0.299, 0.587, 0.114], atol=0.5)
    assert np.array_equal(
        ImageBridge().imgmsg_to_cv2(message, "rgba8")[..., 3], np.full((4, 6), 255)
    )
    depth = RNG.normal(size=(4, 6)).astype(np.float32)
    message = ImageBridge().cv2_to_imgmsg(depth)
    assert message.encoding == "32FC1"
    assert np.array_equal(ImageBridge().imgmsg_to_cv2(message, "32FC1"), depth)
    with pytest.raises(CvBridgeError, match="'32FC1'"):
        ImageBridge().imgmsg_to_cv2(message, "bgr8")
    with pytest.raises(CvBridgeError, match="got 8UC3 for encoding 'mono8'"):
        ImageBridge().cv2_to_imgmsg(pixels, "mono8")


def test_a_compressed_image_is_nearly_the_same():
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[:8] = (200, 100, 0)
    for kind, tolerance in (("png", 0.0), ("jpg", 3.0)):
        message = ImageBridge().cv2_to_compressed_imgmsg(pixels, kind)
        found = ImageBridge().compressed_imgmsg_to_cv2(message)
        assert np.abs(found.astype(int) - pixels).mean() <= tolerance


def test_angles_quaternions_and_matrices_agree_with_geometry():
    for _ in range(20):
        roll, pitch, yaw = RNG.uniform(-1.5, 1.5, 3)
        R = matrix_from_rpy(roll, pitch, yaw)
        q = turns.quaternion_from_euler(roll, pitch, yaw)
        assert np.allclose(turns.euler_matrix(roll, pitch, yaw)[:3, :3], R)
        assert np.allclose(turns.euler_matrix(yaw, pitch, roll, "rzyx")[:3, :3], R)
        assert np.allclose(matrix_from_quaternion(np.roll(q, 1)), R)
        assert np.allclose(turns.quaternion_matrix(q)[:3, :3], R)
        assert np.allclose(turns.euler_from_quaternion(q), (roll, pitch, yaw))
        assert np.allclose(turns.euler_from_matrix(R, "rzyx"), (yaw, pitch, roll))
        other = turns.quaternion_about_axis(0.7, RNG.normal(size=3))
        product = turns.quaternion_matrix(turns.quaternion_multiply(q, other))
        assert np.allclose(product, turns.quaternion_matrix(q) @ turns.quaternion_matrix(other))
        unit = turns.quaternion_multiply(turns.quaternion_inverse(q), q)
        assert np.allclose(unit, [0.0, 0.0, 0.0, 1.0])
        half = turns.quaternion_slerp(q, other, 0.5)
        again = turns.quaternion_multiply(
            turns.quaternion_multiply(half, turns.quaternion_inverse(q)), half
        )
        assert np.isclose(abs(again @ other), 1.0)
    with pytest.raises(ValueError, match="as sxyz"):
        turns.euler_matrix(0.0, 0.0, 0.0, "xyz")


def test_a_rotation_about_a_point_keeps_the_point():
    point = RNG.normal(size=3)
    T = turns.rotation_matrix(0.9, [1.0, 2.0, 2.0], point)
    assert np.allclose(T @ [*point, 1.0], [*point, 1.0])
    angle, axis, fixed = turns.rotation_from_matrix(T)
    assert np.isclose(angle, 0.9)
    assert np.allclose(axis, [1 / 3, 2 / 3, 2 / 3])
    assert np.allclose(T @ fixed, fixed)


def test_poses_of_messages_tf_and_matrices_are_the_same_frame(tmp_path: Path):
    text = """
    import PyKDL, tf_conversions
    import tf_conversions.posemath as pm
    from tf.transformations import quaternion_from_euler
    frame = PyKDL.Frame(PyKDL.Rotation.RPY(0.1, 0.2, 0.3), PyKDL.Vector(1, 2, 3))
    assert pm.fromMsg(pm.toMsg(frame)) == frame
    assert pm.fromTf(pm.toTf(frame)) == frame
    assert tf_conversions.fromMatrix(pm.toMatrix(frame)) == frame
    assert pm.fromTf(((1, 2, 3), quaternion_from_euler(0.1, 0.2, 0.3))) == frame
    """
    assert play(tmp_path, text).status == 0


@pytest.mark.parametrize("edition", [1, 2])
def test_messages_that_belong_together_come_together(tmp_path: Path, edition: int):
    head = {
        1: """
    import rospy, message_filters
    rospy.init_node("pairs")
    make = lambda name: message_filters.Subscriber(name, JointState)
    wait = lambda: rospy.sleep(1.0)
    """,
        2: """
    import rclpy, message_filters, time
    rclpy.init()
    node = rclpy.create_node("pairs")
    make = lambda name: message_filters.Subscriber(node, JointState, name)
    def wait():
        end = time.time() + 1.0
        while time.time() < end:
            rclpy.spin_once(node, timeout_sec=0.01)
    """,
    }[edition]
    text = f"""
    from sensor_msgs.msg import JointState{head}
    names = ("/PSM1/measured_js", "/PSM1/setpoint_js", "/PSM1/jaw/measured_js")
    exact = message_filters.TimeSynchronizer([make(name) for name in names], 10)
    near = message_filters.ApproximateTimeSynchronizer([make(name) for name in names], 10, 0.005)
    sets, many = [], []
    exact.registerCallback(lambda *messages: sets.append(messages))
    near.registerCallback(lambda *messages: many.append(messages[:-1]), "extra")
    wait()
    assert 90 <= len(sets) <= 102 and 90 <= len(many) <= 102, (len(sets), len(many))
    for measured, setpoint, jaw in sets:
        assert measured.header.stamp == setpoint.header.stamp == jaw.header.stamp
        assert len(measured.position) == 6 and len(jaw.position) == 1
    """
    assert play(tmp_path, text).status == 0

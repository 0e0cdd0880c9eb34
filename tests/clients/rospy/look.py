"""Look through the endoscope with rospy: wait for an image, its camera_info and tf of one stamp.

usage: look.py /endoscope/left
"""

# It runs under the Python that has rospy, which is not the one that checks it.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import sys

import rospy
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

seen = {}


def note(kind, stamp, message):
    seen.setdefault(stamp.to_nsec(), {})[kind] = message


rospy.init_node("look")
camera = sys.argv[1]
rospy.Subscriber(f"{camera}/image_raw", Image, lambda m: note("image", m.header.stamp, m))
rospy.Subscriber(f"{camera}/camera_info", CameraInfo, lambda m: note("info", m.header.stamp, m))
rospy.Subscriber("/tf", TFMessage, lambda m: note("tf", m.transforms[0].header.stamp, m))
end = rospy.get_time() + 40.0
while not rospy.is_shutdown() and rospy.get_time() < end:
    whole = [s for s in list(seen) if len(seen[s]) == 3]
    if len(whole) >= 5:
        image, info = seen[whole[-1]]["image"], seen[whole[-1]]["info"]
        assert len(image.data) == image.height * image.step
        assert (image.width, image.height) == (info.width, info.height)
        size, baseline = f"{image.width}x{image.height}", -1e3 * info.P[3] / info.P[0]
        sys.stdout.write(f"{image.encoding} {size} in {image.header.frame_id}: baseline ")
        sys.stdout.write(f"{baseline:.2f} mm, {len(set(image.data))} shades\n")
        sys.exit(0)
    rospy.sleep(0.05)
sys.exit(f"no five images with what belongs to them: {len(seen)} stamps")

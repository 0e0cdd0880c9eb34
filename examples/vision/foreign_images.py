"""Track a needle in images that trocar did not make: those of MuJoCo's renderer.

They have light of another colour from the side, noise, and the blocks of a JPEG stream. One sees:
the tracker's estimate beside the truth, while the needle moves by a centimetre.
"""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.descriptions.needles import Needle
from trocar.geometry import inverse, matrix_from_rotation_vector, quaternion_from_matrix, transform
from trocar.tasks.vision import NeedleTracker

SIZE, FOCAL, BASELINE = (640, 480), 740.0, 0.005
NEEDLE = Needle(radius=0.01, arc=np.pi, wire=0.001, taper=0.003)


def model() -> mujoco.MjModel:
    """Return a needle of capsules over red ground, and two cameras that look down on it."""
    angles = np.linspace(0.0, NEEDLE.arc, 37)
    points, half = NEEDLE.points(angles), NEEDLE.half_width(0.5 * (angles[1:] + angles[:-1]))
    wire = "".join(
        f'<geom type="capsule" size="{r}" rgba=".75 .77 .8 1" fromto="'
        f'{" ".join(f"{x:.6f}" for x in (*a, *b))}"/>'
        for a, b, r in zip(points[:-1], points[1:], half, strict=True)
    )
    fovy = np.degrees(2.0 * np.arctan(0.5 * SIZE[1] / FOCAL))
    eyes = "".join(
        f'<camera name="{name}" pos="{x} 0 .08" fovy="{fovy}"/>'
        for name, x in (("left", 0.0), ("right", BASELINE))
    )
    return mujoco.MjModel.from_xml_string(
        '<mujoco><visual><map znear=".01" zfar="10"/>'
        f'<global offwidth="{SIZE[0]}" offheight="{SIZE[1]}"/></visual><statistic extent="1"/>'
        '<worldbody><light pos="0 .02 .2" diffuse=".6 .6 .6"/>'
        f'<light pos=".15 -.1 .12" dir="-.8 .5 -.6" diffuse=".35 .3 .2"/>{eyes}'
        '<geom type="box" size=".1 .1 .01" pos="0 0 -.02" rgba=".7 .33 .3 1"/>'
        f'<body name="needle" mocap="true">{wire}</body></worldbody></mujoco>'
    )


def main() -> None:
    """Render, track, print."""
    spec, rng = model(), np.random.default_rng(1)
    data, renderer = mujoco.MjData(spec), mujoco.Renderer(spec, SIZE[1], SIZE[0])
    K = np.array([[FOCAL, 0, SIZE[0] / 2 - 0.5], [0, FOCAL, SIZE[1] / 2 - 0.5], [0, 0, 1.0]])
    eye = Intrinsics(*SIZE, K)
    eyes = StereoCalibration(eye, eye, transform(np.eye(3), [BASELINE, 0.0, 0.0]))
    T_world_left = transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.08])  # y down, z ahead
    tracker = NeedleTracker(eyes, NEEDLE)
    for k in range(11):
        turn = matrix_from_rotation_vector([0.4, 0.2 + 0.02 * k, 0.05 * k])
        T_world_needle = transform(turn, [-0.005 + 0.001 * k, 0.0, 0.0])
        data.mocap_pos[0] = T_world_needle[:3, 3]
        data.mocap_quat[0] = quaternion_from_matrix(turn)
        mujoco.mj_forward(spec, data)
        images = []
        for name in ("left", "right"):
            renderer.update_scene(data, camera=name)
            noisy = renderer.render() + rng.normal(0.0, 7.0, (SIZE[1], SIZE[0], 3))
            sent = np.clip(noisy, 0, 255).astype(np.uint8)[..., ::-1]  # blue, green, red
            _, stream = cv2.imencode(".jpg", sent, [cv2.IMWRITE_JPEG_QUALITY, 70])
            images.append(cv2.imdecode(stream, cv2.IMREAD_COLOR)[..., ::-1])
        found = tracker.update(k / 30.0, *images)
        if found.T_left_needle is None:
            print(f"{k:2d} {found.status}")
            continue
        error = found.T_left_needle[:3, 3] - (inverse(T_world_left) @ T_world_needle)[:3, 3]
        off, sigma = 1e3 * np.linalg.norm(error), 1e3 * found.position_sigma
        print(f"{k:2d} {found.status:10s} {off:.2f} mm off, sigma {sigma:.2f} mm")


if __name__ == "__main__":
    main()

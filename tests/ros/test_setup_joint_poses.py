"""Poses of setup joints are the dVRK's, computed here from the numbers of its files.

Source: jhu-dvrk/sawIntuitiveResearchKit@9e535e6, update_forward_kinematics of
mtsIntuitiveResearchKitSUJ.cpp and mtsIntuitiveResearchKitSUJSi.cpp. local/measured_cp is
world_origin_to_SUJ * DH * SUJ_tip_to_tool_origin in "Cart". measured_cp is the same for the
reference arm; for the others it is relative to the reference arm's tip and in the frame of its
name, or in "Cart" where no arm is connected to the reference. It is also the arm's base frame.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from tests.ros.served import Served
from trocar.descriptions.catalogue import DATA
from trocar.geometry import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.robot.dvrk_config import import_dvrk

ARMS = ("ECM", "PSM1", "PSM2", "PSM3")
#: The numbers of the files and trocar's own are the same; what is left is rounding of up to 2 m.
ROUNDING = 1e-9
#: tf is of the tick before.
A_TICK = 1e-6


@dataclass
class Cart:
    """A served patient cart and the rows of its files."""

    served: Served
    setups: dict[str, Any]
    psm: list[dict[str, Any]]
    ecm: list[dict[str, Any]]

    def positions(self, name: str) -> np.ndarray:
        return self.served.world.arm(name).joints.readings()[0]

    def base(self, name: str) -> np.ndarray:
        """The held arm's base on the cart, by the setup joints' file."""
        return lab.base(self.setups[name], self.positions(f"SUJ_{name}"))

    def tip(self, name: str) -> np.ndarray:
        """The tip of an arm in its base, by the kinematics' file."""
        q = self.positions(name)
        if name == "ECM":
            return lab.chain(self.ecm, q) @ lab.SCOPE_TIP
        return lab.chain(self.psm, q[:6]) @ lab.TOOLTIP

    def move(self, rng: np.random.Generator) -> None:
        for name, arm in self.served.world.arms.items():
            self.served.world.set_state(name, rng.uniform(arm.joints.lower, arm.joints.upper))
        self.served.run()

    def told(self, topic: str) -> tuple[np.ndarray, str]:
        """The last pose of a topic and its frame."""
        message = self.served.last(topic)
        place, turn = message["pose"]["position"], message["pose"]["orientation"]
        R = matrix_from_quaternion(np.array([turn[k] for k in "wxyz"]))
        return transform(R, np.array([place[k] for k in "xyz"])), message["header"]["frame_id"]


def classic() -> dict[str, Any]:
    return {s["name"]: s for s in lab.CLASSIC}


@pytest.fixture(params=["full_cart", "imported Classic", "imported Si"])
def cart(request: pytest.FixtureRequest, tmp_path: Path) -> Cart:
    world = {"collisions": False, "dynamics": "cad"}
    if request.param == "full_cart":
        served = Served("full_cart", world=world, rate_hz=1000.0)
        return Cart(served, classic(), [*lab.PSM, *lab.TOOL["Classic"]], lab.ECM)
    generation = request.param.split()[1]
    import_dvrk(lab.lab(tmp_path / "in", generation), tmp_path / "rig.toml")
    served = Served(str(tmp_path / "rig.toml"), world=world, rate_hz=1000.0)
    if generation == "Classic":
        return Cart(served, classic(), [*lab.PSM, *lab.TOOL["Classic"]], lab.ECM)
    setups = {s["name"]: s for s in lab.SI}
    return Cart(served, setups, [*lab.PSM_SI, *lab.TOOL["Si"]], lab.ECM_SI)


def close(got: np.ndarray, expected: np.ndarray, atol: float = ROUNDING) -> None:
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=atol)


def check_poses(cart: Cart, reference: str) -> None:
    """Compare what is published with what the files say, for one reference arm."""
    from_tip = np.linalg.inv(cart.base(reference) @ cart.tip(reference))
    for name in ARMS:
        held = cart.base(name)
        T, frame = cart.told(f"SUJ/{name}/local/measured_cp")
        close(T, held)
        assert frame == "Cart"
        T, frame = cart.told(f"SUJ/{name}/measured_cp")
        close(T, held if name == reference else from_tip @ held)
        assert frame == ("Cart" if name == reference else reference)
        for key in ("measured_cp", "setpoint_cp"):
            arm, own = cart.told(f"{name}/{key}")
            close(arm, T @ cart.told(f"{name}/local/{key}")[0])
            assert own == frame
        assert cart.told(f"{name}/local/measured_cp")[1] == f"{name}_base"


def test_poses_of_setup_joints_are_those_of_the_dvrks_files(
    cart: Cart, rng: np.random.Generator
) -> None:
    for _ in range(3):
        cart.move(rng)
        check_poses(cart, "ECM")


def test_another_reference_arm_has_the_others_in_its_tip_frame(
    cart: Cart, rng: np.random.Generator
) -> None:
    for reference in ("PSM2", "PSM3", "ECM"):
        assert cart.served.core.receive("SUJ/set_reference_arm", {"data": reference})
        cart.move(rng)
        check_poses(cart, reference)


def test_setup_joints_say_where_tf_and_the_world_have_an_arms_base(
    cart: Cart, rng: np.random.Generator
) -> None:
    world = cart.served.world
    for reference in ("ECM", "PSM1"):
        assert cart.served.core.receive("SUJ/set_reference_arm", {"data": reference})
        cart.move(rng)
        cart.served.run(0.05)
        links = {}
        for topic in ("tf_static", "tf"):
            for each in cart.served.last(topic)["transforms"]:
                at, turn = each["transform"]["translation"], each["transform"]["rotation"]
                R = matrix_from_quaternion(np.array([turn[k] for k in "wxyz"]))
                T = transform(R, np.array([at[k] for k in "xyz"]))
                links[each["child_frame_id"]] = each["header"]["frame_id"], T

        def in_world(frame: str, links: dict[str, Any] = links) -> np.ndarray:
            T = np.eye(4)
            while frame != "world":
                frame, step = links[frame]
                T = step @ T
            return T

        for name in ARMS:
            T, frame = cart.told(f"SUJ/{name}/measured_cp")
            assert links[f"{name}_base"][0] == links[f"SUJ_{name}"][0] == frame
            close(in_world(frame) @ T, world.reference_pose(name), A_TICK)
            close(in_world(f"{name}_base"), world.reference_pose(name), A_TICK)
            close(in_world(f"SUJ_{name}"), world.reference_pose(name), A_TICK)


def test_a_reference_arm_without_setup_joints_is_refused_and_nothing_changes() -> None:
    served = Served("full_cart")
    for name in ("PSM4", "SUJ_PSM1", "MTML", ""):
        assert not served.core.receive("SUJ/set_reference_arm", {"data": name})
    served.run(0.01)
    assert served.last("SUJ/PSM1/measured_cp")["header"]["frame_id"] == "ECM"
    warnings = [warning["data"] for warning in served.messages("system/warning")]
    assert len(warnings) == 4
    assert "set_reference_arm: got 'PSM4'; allowed: PSM1, PSM2, PSM3, ECM" in warnings[0]


def test_a_reset_takes_the_rigs_reference_arm() -> None:
    served = Served("full_cart")
    served.core.receive("SUJ/set_reference_arm", {"data": "PSM1"})
    served.run(0.01)
    assert served.last("SUJ/PSM2/measured_cp")["header"]["frame_id"] == "PSM1"
    served.world.reset()
    served.run(0.01)
    assert served.last("SUJ/PSM2/measured_cp")["header"]["frame_id"] == "ECM"


def without(text: str, *arms: str) -> str:
    """Return a rig's text without some arms, their cameras and their joints in named poses."""
    kept = []
    for table in re.split(r"(?m)^(?=\[\[)", text):
        if not any(re.search(rf'^(name|arm) = "{arm}"$', table, re.M) for arm in arms):
            for arm in arms:
                table = re.sub(rf"(?m)^{arm} = .*\n", "", table)
            kept.append(table)
    return "".join(kept)


def test_without_an_arm_on_the_references_setup_joints_all_poses_are_in_the_cart(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    text = (DATA / "rigs" / "full_cart.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(without(text, "ECM"))
    served = Served(str(tmp_path / "rig.toml"), world={"collisions": False}, rate_hz=1000.0)
    cart = Cart(served, classic(), [*lab.PSM, *lab.TOOL["Classic"]], lab.ECM)
    cart.move(rng)
    for name in ARMS:
        T, frame = cart.told(f"SUJ/{name}/measured_cp")
        close(T, cart.base(name))
        assert frame == "Cart"
    T, frame = cart.told("PSM1/measured_cp")
    close(T, cart.base("PSM1") @ cart.tip("PSM1"))
    assert frame == "Cart"


def test_a_lab_file_with_another_reference_arm_is_imported_with_it(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    files = {"arm/suj.json": {"reference_arm": "PSM3", "arms": lab.SI}}
    found = import_dvrk(lab.lab(tmp_path / "in", "Si", files), tmp_path / "rig.toml")
    gap = found.agreement["setup_joints"]
    assert gap.count == 4
    assert max(gap.metres, gap.radians) < ROUNDING
    served = Served(str(tmp_path / "rig.toml"), world={"collisions": False}, rate_hz=1000.0)
    setups = {s["name"]: s for s in lab.SI}
    cart = Cart(served, setups, [*lab.PSM_SI, *lab.TOOL["Si"]], lab.ECM_SI)
    cart.move(rng)
    check_poses(cart, "PSM3")

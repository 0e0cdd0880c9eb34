"""Views for RViz, and the joint states that the README has published."""

from __future__ import annotations

import re

import pytest

from trocar.apps.exports import find_rig
from trocar.apps.exports.rviz import rviz_config, start_message
from trocar.modeling.links import rig_links
from trocar.modeling.urdf import urdf_tree


@pytest.mark.parametrize("name", ["psm", "mtml", "full_cart"])
def test_the_message_has_each_joint_that_mimics_none_where_the_rig_starts(name) -> None:
    model = rig_links(find_rig(name))
    found = dict(re.findall(r"^(name|position): \[(.*)\]$", start_message(model), re.MULTILINE))
    values = zip(found["name"].split(", "), map(float, found["position"].split(", ")), strict=True)
    own = {j.name for j in urdf_tree(model).joints if j.kind != "fixed" and not j.follows}
    message = dict(values)
    assert set(message) == own
    for joint, value in message.items():
        assert value == pytest.approx(model.start[joint], rel=1e-5)


def test_the_view_looks_at_the_middle_of_the_rig() -> None:
    arm, cart = (rviz_config(rig_links(find_rig(name)), 1) for name in ("psm", "full_cart"))
    assert distance(arm) < 2.0 < distance(cart)
    assert "Fixed Frame: world" in cart


def distance(view: str) -> float:
    (found,) = re.findall(r"Distance: (\S+)", view)
    return float(found)


def test_each_ros_has_the_classes_of_its_own_rviz() -> None:
    model = rig_links(find_rig("ecm"))
    classes = [set(re.findall(r"Class: (\w+)/", rviz_config(model, ros))) for ros in (1, 2)]
    assert classes == [{"rviz"}, {"rviz_common", "rviz_default_plugins"}]

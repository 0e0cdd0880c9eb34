"""`trocar.show`: a world in a notebook."""

from __future__ import annotations

import re
import urllib.error
import urllib.request
from html import unescape

import numpy as np
import pytest

import trocar
from trocar.errors import InputError


def test_a_shown_world_runs_obeys_and_can_be_stepped_again_when_it_is_closed() -> None:
    world = trocar.World("psm")
    shown = trocar.show(world, speed="max")
    try:
        source = re.findall(r'<iframe src="([^"]+)"', shown._repr_html_())
        assert [unescape(each) for each in source] == [shown.address]
        with urllib.request.urlopen(shown.address, timeout=20) as answer:
            assert "</html>" in answer.read().decode()
            assert "frame-ancestors http://localhost:*" in answer.headers["Content-Security-Policy"]
        with pytest.raises(urllib.error.HTTPError):  # another user of this machine
            urllib.request.urlopen(shown.address.partition("?")[0], timeout=20)
        q = np.array([0.1, 0.0, 0.14, 0.0, 0.0, 0.0])
        motion = shown.loop.ask(lambda here: here.arm("PSM1").move_jp(q)).result(20)
        assert motion.wait()
        with pytest.raises(InputError, match="runs already"):
            trocar.show(world)
    finally:
        shown.close()
    then = world.time
    world.step()
    assert world.time > then > 0.0
    assert repr(shown) == "psm: closed" and "iframe" not in shown._repr_html_()
    shown.close()


def test_a_port_that_does_not_exist_is_the_caller_s_error() -> None:
    with pytest.raises(InputError, match="port 70000"):
        trocar.show(trocar.World("psm"), port=70000)

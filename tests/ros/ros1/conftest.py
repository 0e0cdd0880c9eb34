"""One master and one simulator for all tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.ros.ros1.robot_os import Master, Simulator, need


@pytest.fixture(scope="module")
def master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Master]:
    need("rosmaster")
    found = Master(tmp_path_factory.mktemp("ros"))
    found.with_packages(tmp_path_factory.mktemp("packages"))
    yield found
    found.close()


@pytest.fixture(scope="module")
def simulator(master: Master) -> Iterator[Simulator]:
    found = Simulator(master.env, "--rig", "psm")
    yield found
    assert found.stop() == 0, "".join(found.said)

"""Gains come from the parameter server, and only such as a controller can have."""

from __future__ import annotations

from typing import Any

import pytest

from tests.ros.served import Served
from trocar.ros.transports.ros1.parameters import ServerParameters


class Cache:
    """As rospy's cache of parameters."""

    def __init__(self) -> None:
        self.kept: dict[str, Any] = {}

    def set_notifier(self, notifier: Any) -> None:
        self.notifier = notifier

    def set(self, key: str, value: Any) -> None:
        self.kept[key] = value


class Server:
    """As the master's parameter server."""

    def __init__(self, **there: Any) -> None:
        self.kept = {key.replace("__", "/"): value for key, value in there.items()}

    def ask(self, verb: str, *arguments: Any) -> tuple[int, str, Any]:
        if verb == "setParam":
            self.kept[arguments[0]] = arguments[1]
        if verb == "deleteParam":
            del self.kept[arguments[0]]
        return 1, "", self.kept.get(arguments[-1], {}) if verb == "subscribeParam" else 0


def started(served: Any, server: Server) -> tuple[ServerParameters, Cache]:
    cache = Cache()
    parameters = ServerParameters(served.core, server, "http://127.0.0.1:1", cache)  # type: ignore[arg-type]
    parameters.start()
    return parameters, cache


@pytest.fixture
def served() -> Any:
    return Served("psm")


KEY = "/PSM1/yaw_controller"


def test_they_are_written_down_and_deleted_at_the_end(served: Any) -> None:
    server = Server()
    gains, cache = started(served, server)
    p, i, d = served.world.arm("PSM1").joints.gains("yaw")
    assert server.kept[KEY] == cache.kept[KEY] == {"p": p, "i": i, "d": d}
    assert "<robot" in server.kept["/robot_description"]
    gains.forget()
    assert server.kept == {}


def test_those_that_are_there_already_are_taken_over(served: Any) -> None:
    server = Server(__PSM1__yaw_controller={"p": 70.0, "d": 5})
    gains, _ = started(served, server)
    served.run()
    _, i, _ = served.world.arm("PSM1").joints.gains("pitch")
    assert served.world.arm("PSM1").joints.gains("yaw") == (70.0, i, 5.0)
    assert server.kept[KEY] == {"p": 70.0, "i": i, "d": 5.0}
    gains.forget()
    assert KEY not in server.kept


@pytest.mark.parametrize(("key", "value"), [(f"{KEY}/p", 33), (f"{KEY}/", {"p": 33.0, "x": 1})])
def test_one_that_is_set_is_obeyed(served: Any, key: str, value: object) -> None:
    _, cache = started(served, Server())
    cache.notifier(key, value)
    served.run()
    assert served.world.arm("PSM1").joints.gains("yaw")[0] == 33.0


@pytest.mark.parametrize("value", ["abc", -1.0, float("nan"), float("inf"), True, [1.0], {}, None])
def test_what_is_no_gain_is_refused_on_the_arms_topic(served: Any, value: object) -> None:
    _, cache = started(served, Server())
    before = served.world.arm("PSM1").joints.gains("yaw")
    cache.notifier(f"{KEY}/d", value)
    served.run(0.02)
    assert served.world.arm("PSM1").joints.gains("yaw") == before
    assert "yaw_controller/d" in served.transport.last("PSM1/warning")["data"]


@pytest.mark.parametrize("key", ["/PSM1/elbow_controller/p", "/run_id", "/PSM1", "", "/"])
def test_other_parameters_are_nothing_to_it(served: Any, key: str) -> None:
    _, cache = started(served, Server())
    cache.notifier(key, 1.0)
    assert served.world.arm("PSM1").joints.gains("yaw")[0] != 1.0

"""The conformance kit: observe an arm, check it, with `move` in small motions, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trocar.conformance import reading
from trocar.conformance.expectations import CORE, expectation
from trocar.conformance.moving import MotionChecks
from trocar.conformance.observation import ArmObserver
from trocar.conformance.report import CheckResult, ConformanceReport
from trocar.errors import InputError, UnknownNameError
from trocar.ros.client import Graph, RosClient

#: Time to connect subscriptions before rates are measured [s]. Source: our own choice.
CONNECT_S = 1.5


@dataclass(frozen=True)
class ConformanceSettings:
    """Settings of a run.

    Attributes:
        seconds: time for which streams are observed [s]
        rate_hz: lowest rate of streams [Hz]
        move: command small, slow moves
        home: enable and home the arm first, which moves a real one far
        nan: send set-points that are not numbers, which disable an arm of the dVRK

    Raises:
        InputError: a number that is not above 0
    """

    seconds: float = 3.0
    rate_hz: float = 80.0
    move: bool = False
    home: bool = False
    nan: bool = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in (("seconds", self.seconds), ("rate", self.rate_hz)):
            if not 0.0 < value < float("inf"):
                raise InputError(f"{name}: got {value:g}; allowed: above 0")


def arms_of(graph: Graph) -> list[str]:
    """List the names under which an arm is published."""
    found = (topic.removesuffix("/measured_js") for topic in graph.published)
    return sorted(
        arm for arm in found if f"{arm}/operating_state" in graph.published and "SUJ" not in arm
    )


def conform(
    client: RosClient,
    arm: str,
    settings: ConformanceSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,  # noqa: ARG005
) -> ConformanceReport:
    """Check an arm against CRTK, the dVRK's documents and recordings of its software.

    Args:
        client: connected to it
        arm: name, the prefix of its topics
        settings: the defaults when omitted
        progress: called with the step that begins

    Raises:
        UnknownNameError: no such arm; those that are there are listed
        InputError: with `move`, the arm is not enabled and homed, or busy
    """
    how = settings or ConformanceSettings()
    progress("listing topics and services")
    graph = client.graph()
    if not any(f"{arm}/{key}" in {**graph.published, **graph.subscribed} for key in CORE):
        raise UnknownNameError("arm", arm, arms_of(graph))
    expected = expectation(arm)
    watch = ArmObserver(client, arm, expected, graph)
    results: list[CheckResult] = list(reading.offered(graph, arm, expected))
    watch.start()
    try:
        progress(f"observing for {CONNECT_S + how.seconds:g} s")
        client.sleep(CONNECT_S)
        moves = MotionChecks(watch, how.home, how.nan) if how.move else None
        if moves is not None:
            progress("preparing to move")
            results += moves.ready()
        begin = client.now()
        paused = watch.watch(how.seconds)
        results += reading.streams(watch, begin, client.now(), how.rate_hz, paused)
        results += reading.late(watch)
        results += reading.joints(watch)
        results += reading.frames(watch)
        results += reading.kinematics(watch)
        results += reading.states(watch)
        if moves is not None:
            results += moves.run(progress)
    finally:
        watch.close()
    return ConformanceReport(arm, expected.kind, client.name, how.move, tuple(results))

"""Statistics of periods, over windows of a second."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.served import Served
from trocar.live.loop import SERVER_TICK_S
from trocar.messages import message_type
from trocar.ros.period_statistics import PeriodStatistics


def test_the_figures_are_those_of_the_last_whole_window(rng: np.random.Generator) -> None:
    found = PeriodStatistics()
    assert found.message((0, 0))["period_avg"] == 0.0
    periods = 0.01 * rng.uniform(0.9, 1.1, 250)
    ends = np.flatnonzero(np.diff(np.floor(np.cumsum(periods))))
    for period in periods:
        found.add(period, 0.5 * period)
    count = found.message((0, 0))["number_of_samples"]
    assert 90 <= count <= 112 and len(ends) == 2
    window = periods[count : 2 * count]  # about the second window: its mean is near
    message = found.message((1, 2))
    assert message["header"] == {"stamp": (1, 2), "frame_id": ""}
    assert message["period_avg"] == pytest.approx(window.mean(), rel=0.01)
    assert message["compute_time_avg"] == pytest.approx(0.5 * message["period_avg"])
    assert message["period_min"] < message["period_avg"] < message["period_max"]
    assert message["number_of_overruns"] == 0


def test_a_constant_period_has_no_deviation_and_late_ones_are_overruns() -> None:
    found = PeriodStatistics()
    for k in range(25):
        found.add(0.1, 0.2 if k in (15, 16) else 0.05)
    message = found.message((0, 0))
    assert message["period_std_dev"] == pytest.approx(0.0, abs=1e-8)
    assert message["period_min"] == message["period_max"] == 0.1
    assert message["number_of_overruns"] == 2  # of the second window's eleven periods


@pytest.mark.parametrize(
    ("topic", "period_s"),
    [
        ("PSM1/period_statistics", SERVER_TICK_S),
        ("publishers/period_statistics", 1.0 / 220.0),
        ("stats/tf_psm1_arm/period_statistics", 0.02),
    ],
)
def test_periods_of_a_running_rig_are_published_five_times_a_second(topic, period_s) -> None:
    served = Served("psm", wanted=[topic])
    assert served.core.topics[topic].type == "cisst_msgs/IntervalStatistics"
    served.run(3.0)
    messages = served.messages(topic)
    assert 13 <= len(messages) <= 16
    assert set(messages[-1]) == {
        f.name for f in message_type(served.core.topics[topic].type).fields
    }
    assert messages[-1]["period_avg"] == pytest.approx(period_s, rel=0.02)

"""Unlimited names: bounded memory, the first names stay, one warning about names that are not shown."""

import logging
import tracemalloc

import numpy as np
import pytest

from ship_bags.stamps import make_header
from ship_testing.hand_made_bags import FACTORY, innovation
from ship_watch import topics
from ship_watch.alerts.alerts import MAX_ALERTS, AlertList, Condition
from ship_watch.safety.limits import AlertTimes, Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Priority
from ship_watch.topics import MAX_NAME_LENGTH, MAX_NAMES, has_room

NS = 1_000_000_000
START_NS = 1_700_000_000 * NS


def health(topic, stamp_ns, reasons=()):
    return FACTORY.make(
        "ship_msgs/msg/InputHealth", header=make_header(FACTORY, stamp_ns), topic=topic, received=5, accepted=5,
        rejected=0, rate_hz=1.0, latency_s=0.1, age_s=0.1, level=0, reasons=list(reasons),
        reason_counts=np.arange(len(reasons), dtype=np.uint64),
    )  # fmt: skip


def invented_messages(number, stamp_ns):
    """Yield topic and message of each kind that contains names, with new names."""
    header = make_header(FACTORY, stamp_ns)
    yield "input_health", health(f"reference/ship{number}/attitude", stamp_ns, [f"reason {number}"])
    yield (
        "ship/innovation",
        innovation(stamp_ns, f"star.s{number}", [0.0, 0.0], [1.0, 1.0], 1.0, components=("right", "up")),
    )
    yield (
        "ship/innovation",
        innovation(stamp_ns, f"lights.{number}", [], [], 1.0, accepted=False, reason=1, components=()),
    )
    light = FACTORY.make("ship_msgs/msg/BeaconSighting", beacon_id=f"b{number}", x=0.0, z=0.0, sigma=1.0)
    image = {"telescope_id": "", "exposure_s": 0.1, "beacons": [light]}
    yield "theodolite/beacons", FACTORY.make("ship_msgs/msg/BeaconImage", header=header, **image)
    yield "ship/error_budget", FACTORY.make(
        "ship_msgs/msg/ErrorBudget", header=header, quantity="", sources=[f"n{number}-{part}" for part in range(300)],
        covariances=np.zeros(2700), total=np.zeros(9),
    )  # fmt: skip
    yield "ship/alignment", FACTORY.make(
        "ship_msgs/msg/AlignmentState", header=header, names=[f"star.{number}.azimuth"], values=np.ones(1),
        covariance=np.ones(1), units=["rad"],
    )  # fmt: skip


def test_memory_is_bounded_for_unlimited_names(caplog):
    topics._logged_s.clear()
    monitor, sizes = SuiteMonitor(Limits()), []
    known = "star.fore"
    tracemalloc.start()
    for number in range(3 * MAX_NAMES):
        now_ns = number * NS // 100
        monitor.process_message("ship/innovation", innovation(START_NS + now_ns, known, [0.0, 0.0], [1.0, 1.0], 1.0,
                                                 components=("right", "up")), now_ns)  # fmt: skip
        for topic, message in invented_messages(number, START_NS + now_ns):
            monitor.process_message(topic, message, now_ns)
        if number % MAX_NAMES == MAX_NAMES - 1:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    picture, history = monitor.current_state(now_ns), monitor.history
    assert len(picture.sources) <= MAX_NAMES + 3
    assert len(picture.inputs) <= MAX_NAMES
    assert all(
        len(of) <= MAX_NAMES for of in (history.innovations, history.beacons, history.star_exposures, history.budgets)
    )
    # The third set of names needs only the memory for the points of the known source.
    assert sizes[2] - sizes[1] < 0.25 * sizes[0]
    assert len(history.innovations[known]) == 3 * MAX_NAMES
    lines = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert any(line.startswith("source '") and "and others are not shown: limit of 256 names" in line for line in lines)
    assert len(lines) == len({line.partition(" '")[0] for line in lines})


def test_number_of_past_alerts_is_bounded():
    alert_list = AlertList(AlertTimes(raise_after_s=0.0, clear_after_s=0.0, start_s=0.0))
    for number in range(2 * MAX_ALERTS):
        alert_list.update([Condition(f"node{number}.lost", Priority.CAUTION, "", "lost")], number * NS, START_NS)
    assert len(alert_list.serialise()) <= MAX_ALERTS + 2


@pytest.mark.parametrize("name", ["x" * (MAX_NAME_LENGTH + 1), ("node", "x" * MAX_NAME_LENGTH)])
def test_too_long_name_is_not_stored(name):
    assert not has_room({}, name, "name")
    assert has_room({name}, name, "name")

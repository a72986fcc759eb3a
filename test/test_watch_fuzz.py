"""Random values in any field of any monitored message: no exception, no NaN is SAFE, and a reset is complete."""

import importlib
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from ship_bags.mcap.bag_reader import read_bag
from ship_msgs.msg import Alert, AlertArray
from ship_testing.garbage import paths, put_garbage
from ship_testing.monitored_voyages import replay_with_faults
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Safety
from ship_watch.topics import monitored_topic

SECONDS = 20
COPIES = 3


def kind_of(type_name: str) -> Any:
    """Return the class of a message type."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def recorded_messages(*bags: Path) -> list[tuple[int, str, Any]]:
    """Return (log time, topic, rclpy message) of the first seconds of bags; all but innovations at 10 Hz at most."""
    found = []
    for path in bags:
        with read_bag(path) as bag:
            wanted = [topic for topic, type_name in bag.topics.items() if monitored_topic(topic, type_name)]
            kinds, last = {topic: kind_of(bag.topics[topic]) for topic in wanted}, dict.fromkeys(wanted, 0)
            for record in bag.records(wanted):
                if record.log_time_ns > bag.start_ns + SECONDS * 1_000_000_000:
                    break
                if record.log_time_ns - last[record.topic] >= 100_000_000 or "innovation" in record.topic:
                    last[record.topic] = record.log_time_ns
                    message = deserialize_message(record.data, kinds[record.topic])
                    found.append((record.log_time_ns, record.topic, message))
    alert = Alert(id="star.bow.out", instance=1, priority=1, state=1, source="star.bow", text="star.bow out")
    found += [(time_ns, "ship/alerts", AlertArray(alerts=[alert])) for time_ns, _, _ in found[::50]]
    return sorted(found, key=lambda entry: entry[0])


@pytest.mark.slow
@pytest.mark.parametrize("bag", ["demo", "theodolite"])
def test_no_message_raises_or_is_safe_with_nan(bag: str, tmp_path: Path) -> None:
    rng, monitor = np.random.default_rng([12, len(bag)]), SuiteMonitor()
    given, out = replay_with_faults(tmp_path, bag)
    voyage = recorded_messages(out, given) if bag == "theodolite" else recorded_messages(out)
    tried = 0
    for time_ns, topic, message in voyage:
        monitor.process_message(topic, message, time_ns)
        pickled, fields = pickle.dumps(message), paths(message)
        for _ in range(COPIES):
            bad = pickle.loads(pickled)
            put_garbage(bad, fields, rng)
            monitor.process_message(topic, bad, time_ns)
            tried += 1
        if tried % 30 == 0:
            for angle in monitor.current_state(time_ns).angles:
                sound = math.isfinite(angle.value) and angle.accuracy_95 <= 3.0 * angle.limit and not angle.is_old
                assert sound or angle.safety is Safety.UNSAFE
    assert tried > 2000
    monitor.process_message("ship/alerts", AlertArray(), voyage[-1][0])  # alerts outlive a reset
    monitor.reset()
    fresh = SuiteMonitor()
    for time_ns, topic, message in voyage:
        monitor.process_message(topic, message, time_ns)
        fresh.process_message(topic, message, time_ns)
    end_ns = voyage[-1][0]
    assert repr(monitor.current_state(end_ns)) == repr(fresh.current_state(end_ns))  # NaN equals NaN as text
    assert repr(monitor.history) == repr(fresh.history)

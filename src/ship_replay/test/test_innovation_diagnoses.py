"""Innovation diagnoses over the bags of this repository with wrong sigmas. (Without faults: ``test/test_bags.py``.)"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_node.messages.inputs_outputs import Arrival, Batch
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ADAPTERS, match_inputs
from ship_testing.one_message import process_message

BAGS = Path(__file__).parents[3] / "bags"
MINUTE_NS = 60_000_000_000
TICK_NS = 1_000_000_000


def diagnoses(name: str, change: Callable[[str, Any], None]) -> dict[str, list[tuple[int, str]]]:
    """Return level and text of each diagnosis and of the clocks, second by second, in a minute of a changed bag."""
    statuses: dict[str, list[tuple[int, str]]] = {}
    with read_bag(BAGS / name) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory(), None, "")
        topics = match_inputs(bag, chain, "")
        due_ns = bag.start_ns
        for record in bag.records(topics):
            if record.log_time_ns > bag.start_ns + MINUTE_NS:
                break
            while record.log_time_ns >= due_ns:
                for topic, message in chain.process(Batch([Arrival(due_ns, due_ns)])).output_messages():
                    for status in message.status if topic == "/diagnostics" else ():
                        thing = status.name.partition(": ")[2]
                        if thing.startswith("verdict ") or thing == "clocks":
                            statuses.setdefault(thing, []).append((int(status.level), status.message))
                due_ns += TICK_NS
            message = record.decode()
            change(topics[record.topic], message)
            process_message(chain, topics[record.topic], message, record.log_time_ns)
    return statuses


@pytest.mark.slow
def test_an_understated_sigma_is_reported_within_a_minute_for_that_sensor() -> None:
    def understate(topic: str, message: Any) -> None:
        if topic == "star/fore/horizon_attitude":
            for name in ("covariance", "rotation_covariance", "noise_covariance"):
                setattr(message, name, np.asarray(getattr(message, name)) / 4.0)

    statuses = diagnoses("demo.mcap", understate)
    level, text = statuses["verdict star.fore"][-1]
    assert level == 1
    assert text.startswith("sigma optimistic by ")
    assert float(text.split(" by ")[1].split(":")[0]) == pytest.approx(2.0, rel=0.2)
    assert {level for level, _ in statuses["verdict star.starboard"]} == {0}


@pytest.mark.slow
def test_a_sensor_off_by_a_degree_is_biased_although_unused() -> None:
    """An offset of one degree is too large for a mounting shift, and is not adopted as a new mounting."""
    stamps_ns: list[int] = []

    def turn_sensor(topic: str, message: Any) -> None:
        if topic == "star/fore/horizon_attitude":
            stamp_ns = message.header.stamp.sec * TICK_NS + message.header.stamp.nanosec
            stamps_ns.append(stamp_ns)
            if stamp_ns - stamps_ns[0] > MINUTE_NS // 4:
                message.elevation += np.deg2rad(1.0)

    statuses = diagnoses("demo.mcap", turn_sensor)
    level, text = statuses["verdict star.fore"][-1]
    assert level == 1
    assert text.startswith("bias of ")
    assert "arcsec in right" in text
    assert abs(float(text.split()[2])) == pytest.approx(3600.0, rel=0.02)

"""Time for which an INS output waits behind a star message, from the input bytes to the output bytes.

The measurement is in one process, without the middleware. Each message of a voyage is decoded and passed to the node's
adapter, and each output is encoded as bytes, as in the live node.
"""

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message

from bench_rows import WITH_INTEGRITY, Row, alternate
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.message_factory import CdrReader, RosidlFactory, message_class
from ship_bags.stamps import NS_PER_S
from ship_estimation.parameters.schema import build
from ship_node.live.adapter_calls import message_bytes
from ship_node.live.node_clock import TickGrid
from ship_node.messages.inputs_outputs import Batch
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_simulation.suite_file import suite_configuration

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
VOYAGE_S, SETTLED_S = 15.0, 5.0
ROUNDS = 3
LATE_SENSOR_S = 1.9
"""Delay of a late sensor, s; less than the two seconds of ``lag_s``."""

MOST_ON_TIME_MS, MOST_LATE_MS = 1.0 * WITH_INTEGRITY, 2.0 * WITH_INTEGRITY
LATE_WITH_OPTICS = 1.3
"""Factor of the bound for late single stars, because a camera's optics add four states to the repeated steps."""
_INS, _SENSOR = "ins/imu", "fore"


def behind_star_cost() -> list[Row]:
    """Measure the wait behind star sensors' attitudes and behind single stars, both sensors on time or one late."""
    return [*_rows("paper", "an attitude by stars"), *_rows("paper_stars", "eight single stars", LATE_WITH_OPTICS)]


def _rows(name: str, what: str, late_share: float = 1.0) -> list[Row]:
    scenario = dataclasses.replace(load_scenario(SCENARIOS / f"{name}.yaml"), duration_s=VOYAGE_S)
    sensor = dataclasses.replace(scenario.star_sensors[_SENSOR], latency_s=LATE_SENSOR_S)
    late = dataclasses.replace(scenario, star_sensors={**scenario.star_sensors, _SENSOR: sensor})
    on_time_records, late_records = _arrivals(scenario), _arrivals(late)
    on_time_ms, late_ms = alternate(
        ROUNDS, lambda: _waits_ms(scenario, on_time_records), lambda: _waits_ms(late, late_records)
    )
    behind = f"INS output behind {what}"
    return [
        Row(f"{behind}: median", float(np.median(on_time_ms)), "ms", MOST_ON_TIME_MS),
        Row(f"{behind}, {LATE_SENSOR_S} s late: median", float(np.median(late_ms)), "ms", late_share * MOST_LATE_MS),
    ]


def _arrivals(scenario: Scenario) -> list[BagRecord]:
    """Return the messages of a voyage in order of arrival."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "voyage.mcap"
        write_bag(scenario, 1, path, b"")
        with read_bag(path) as bag:
            return list(bag.records())


def _waits_ms(scenario: Scenario, records: list[BagRecord]) -> list[float]:
    """Return the processing time of each message of the sensor together with the next INS sample, ms.

    Messages in the first seconds of the voyage are not measured.
    """
    factory = RosidlFactory()
    adapter = ShipAttitudeAdapter(build(ShipAttitudeConfig, suite_configuration(scenario)), factory)
    types = {one.topic: one.type_name for one in adapter.inputs}
    readers = {topic: CdrReader(type_name, factory.definition) for topic, type_name in types.items()}
    grid = TickGrid()
    settled_ns = records[0].log_time_ns + round(SETTLED_S * NS_PER_S)
    star_s, waits_ms = None, []
    for record in records:
        if record.topic not in types:
            continue
        for tick_ns in grid.ticks_until(record.log_time_ns):
            adapter.tick(tick_ns)
        begin_s = time.perf_counter()
        message = readers[record.topic].message(record.data)
        if message is None:
            message = deserialize_message(record.data, message_class(types[record.topic]))
        for _, output in adapter.process(Batch.of_message(record.topic, message, record.log_time_ns)).output_messages():
            message_bytes(output)
        taken_s = time.perf_counter() - begin_s
        if record.topic.startswith(f"star/{_SENSOR}/"):
            star_s = taken_s
        elif record.topic == _INS and star_s is not None:
            if record.log_time_ns >= settled_ns:
                waits_ms.append((star_s + taken_s) * 1e3)
            star_s = None
    return waits_ms

"""Black boxes created without DDS by the code of a live node; and copies of them with one change."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rclpy.serialization import deserialize_message

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_factory import RosidlFactory, message_class
from ship_estimation.parameters.schema import ParameterError
from ship_node.adapters.adapter import Overload
from ship_node.black_box.black_box import BlackBox
from ship_node.live.adapter_calls import AdapterCalls
from ship_node.live.node_clock import TickGrid
from ship_node.parameters.parameter_file import load_config
from ship_node.saved_files.saved_document import RecordingFiles
from ship_testing.places import ROOT
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

BAGS = ROOT / "bags"
LENGTH_NS = 8_000_000_000
FORMAT = "2"
Record = Schema | Channel | Message | Attachment | Metadata


@dataclass(frozen=True)
class RecordedNode:
    """Node that is recorded in a black box.

    Attributes:
        adapter_class: adapter of the node.
        bag: inputs of the node.
        file_parameter: parameter with the path of its saved file.
        noise_change: a live change of one parameter.
        parameters: parameters of the node, in addition to those of the bag.
    """

    adapter_class: Any
    bag: Path
    file_parameter: str
    noise_change: Mapping[str, float]
    parameters: Mapping[str, Any] = field(default_factory=dict)


SHIP_ATTITUDE = RecordedNode(ShipAttitudeAdapter, BAGS / "demo.mcap", "alignment_file", {"ins.white_sigma_arcsec": 2.0})
OPTICAL_AXIS = RecordedNode(
    OpticalAxisAdapter,
    BAGS / "theodolite.mcap",
    "calibration_file",
    {"telescope.sigma_m": 2e-6},
    {"escort": {"enabled": True, "period_s": 1.0}},
)


class NoSubscriber:
    """Publisher without subscribers."""

    def publish(self, message: Any) -> None:
        """Discard the message."""


def make_black_box(
    path: Path,
    saved_path: Path,
    close: bool = True,
    node: RecordedNode = SHIP_ATTITUDE,
    node_ns: Callable[[int], int] = lambda ns: ns,
    is_lost: Callable[[int], bool] = lambda ns: False,
    autosave_s: float = 0.0,
    is_overloaded: bool = False,
    part_bytes: int = 0,
) -> BlackBox:
    """Record eight seconds of a bag, with all events of a node; the clock goes back at the end.

    Args:
        path: path of the black box.
        saved_path: path of the file that the node saves.
        close: True if the node ends in order.
        node: node to record.
        node_ns: function from the timeout clock (log time) to the node's clock; both ns since the bag's start.
        is_lost: function that is True for times without any arrival, ns since the bag's start.
        autosave_s: period of automatic saving; 0 for never.
        is_overloaded: True if the node is behind its inputs from 6.5 s to 7.8 s.
        part_bytes: size at which the black box continues in a new file; 0 for never.
    """
    name = node.adapter_class.node_name
    with read_bag(node.bag) as bag:
        suite = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT].decode())
        (section,) = (parameters for node_name, parameters in suite.items() if node_name.endswith(name))
        section["ros__parameters"] |= node.parameters
        section["ros__parameters"] |= {node.file_parameter: str(saved_path), "alignment_autosave_s": autosave_s}
        config = load_config(node.adapter_class.config_type, yaml.safe_dump(suite), name)
        files = RecordingFiles()
        adapter = node.adapter_class(config, RosidlFactory(), files)
        kinds = {topic.topic: message_class(topic.type_name) for topic in adapter.inputs}
        start_ns = bag.start_ns
        records = [r for r in bag.records(kinds) if r.log_time_ns < start_ns + LENGTH_NS]
        records = [r for r in records if not is_lost(r.log_time_ns - start_ns)]

    def node_time(waiting_ns: int) -> int:
        return start_ns + node_ns(waiting_ns - start_ns)

    black_box = BlackBox(str(path), adapter, config, adapter.outputs, "/", print, part_bytes)
    calls = AdapterCalls(adapter, {output.topic: NoSubscriber() for output in adapter.outputs}, files, black_box)
    plan = _plan(calls, node)
    if is_overloaded:
        busiest = adapter.inputs[0].topic
        plan.append((6_500_000_000, lambda ns: calls.overload(Overload(3.2, 2, 12.0, {busiest: 320}), ns)))
        plan.append((7_800_000_000, lambda ns: calls.overload(Overload(0.0, 2, 12.0), ns)))
    planned = len(plan)
    grid = TickGrid()
    # With ``part_bytes``, wait for a new file at a third and at two thirds of the records, for at least three files.
    pauses = {len(records) // 3: 2, 2 * len(records) // 3: 3} if part_bytes else {}
    for number, record in enumerate([*records, *records[:300]]):
        if number in pauses:
            _wait_for(path.with_suffix(f".part{pauses[number]}.mcap"))
        waiting_ns = record.log_time_ns
        now_ns = node_time(waiting_ns)
        if record is records[0] and len(plan) < planned:
            grid.restart(waiting_ns)
            calls.clock_jumped_back(now_ns)
        for tick_ns in grid.ticks_until(waiting_ns):
            calls.tick(node_time(tick_ns), tick_ns)
        while plan and waiting_ns >= start_ns + plan[0][0]:
            plan.pop(0)[1](now_ns)
        message = deserialize_message(record.data, kinds[record.topic])
        calls.handle(record.topic, record.data, message, now_ns, waiting_ns)
    if close:
        black_box.close()
    return black_box


def _wait_for(path: Path) -> None:
    """Wait until a file exists."""
    deadline_s = time.monotonic() + 60.0
    while not path.exists():
        assert time.monotonic() < deadline_s, f"{path} does not appear"
        time.sleep(0.02)


def _plan(calls: AdapterCalls, node: RecordedNode) -> list[tuple[int, Callable[[int], Any]]]:
    second = 1_000_000_000

    def set_out_of_range(now_ns: int) -> None:
        try:
            calls.set_parameters({"gate.probability": 0.1}, now_ns)
        except ParameterError:
            return
        raise AssertionError("a parameter out of its range was accepted")

    return [
        (1 * second, lambda ns: calls.set_parameters({"gate.probability": 0.99}, ns)),
        (2 * second, set_out_of_range),
        (2 * second, lambda ns: calls.record_refusal({"gate.probability": 5.0}, "out of its range", ns)),
        (3 * second, lambda ns: calls.set_parameters(node.noise_change, ns)),
        (4 * second, lambda ns: calls.service("save_alignment", ns)),
        (5 * second, lambda ns: calls.service("reset", ns)),
        (6 * second, lambda ns: calls.service("load_alignment", ns)),
    ]


def write_changed_copy(
    black_box: Path,
    path: Path,
    change: Callable[[Record, Mapping[int, str]], Record | list[Record] | None],
    renumber: bool = False,
) -> Path:
    """Copy a black box, with each record replaced by the result of ``change(record, topics by channel)``.

    None leaves the record out; ``renumber`` makes the sequence numbers contiguous again.
    """
    count = 0
    topics: dict[int, str] = {}
    kept: set[tuple[type, int]] = set()
    with black_box.open("rb") as stream, path.open("wb") as out:
        writer = Writer(out)
        writer.start("ros2", "test")
        for record in StreamReader(stream).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            if not isinstance(record, Record):
                continue
            if isinstance(record, Schema | Channel):
                if (type(record), record.id) in kept:
                    continue
                kept.add((type(record), record.id))
            changed = change(record, topics)
            for one in changed if isinstance(changed, list) else [changed]:
                if renumber and isinstance(one, Message):
                    count += 1
                    one = replace(one, sequence=count)
                _write(writer, one)
        writer.finish()
    return path


def _write(writer: Writer, record: Record | None) -> None:
    if isinstance(record, Schema):
        assert writer.register_schema(record.name, record.encoding, record.data) == record.id
    elif isinstance(record, Channel):
        channel_id = writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
        assert channel_id == record.id
    elif isinstance(record, Message):
        writer.add_message(
            record.channel_id, record.log_time, record.data, record.publish_time, sequence=record.sequence
        )
    elif isinstance(record, Attachment):
        writer.add_attachment(0, 0, record.name, record.media_type, record.data)
    elif isinstance(record, Metadata):
        writer.add_metadata(record.name, record.metadata)

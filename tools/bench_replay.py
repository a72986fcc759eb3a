"""One message at a time: the replay of a bag, over what rosbags takes to copy the same bag, each message decoded."""

import dataclasses
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from bench_rows import Row, by_turns, median_ratio, own_cpu_s
from ship_replay.commands.replay import ADAPTERS
from ship_replay.offline.replay import replay
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
ROUNDS = 3
DEMO_S, SUITE_S = 30.0, 15.0
"""Length of the voyages, s: of the demo, and with every device."""

MOST_OF_DEMO, MOST_OF_SUITE = 6.0, 12.0
"""What issue 10 asks of replay, one message at a time, over a copy."""

_COPY = "rosbags copy of the bag, each message decoded and encoded"


def replay_cost() -> list[Row]:
    """Processor time of replay, of rosbags' copy and of rosbags' decoding, by turns: the demo and a full suite."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [
            *_rows("demo", _voyage("demo", DEMO_S, folder), folder, MOST_OF_DEMO),
            *_rows("full suite", _voyage("everything", SUITE_S, folder), folder, MOST_OF_SUITE),
        ]


def _rows(what: str, bag: Path, folder: Path, most: float) -> list[Row]:
    copies = iter(range(ROUNDS))
    out = folder / f"{bag.stem}_out.mcap"
    replayed, copied, decoded = by_turns(
        ROUNDS,
        lambda: own_cpu_s(partial(replay, bag, out, ADAPTERS)),
        lambda: own_cpu_s(partial(_copy, bag, folder / f"{bag.stem}_{next(copies)}")),
        lambda: own_cpu_s(partial(_decode, bag)),
    )
    with AnyReader([bag]) as reader:
        duration_s = reader.duration * 1e-9
    return [
        Row(f"replay of the {what}, processor time: median", float(np.median(replayed)), "s"),
        Row(f"real time / replay of the {what}", duration_s / float(np.median(replayed)), "x"),
        Row(f"ratio: replay of the {what} / rosbags copy", median_ratio(replayed, copied), "x", most, _COPY),
        Row(f"ratio: rosbags decoding of the {what} / rosbags copy", median_ratio(decoded, copied), "x", None, _COPY),
    ]


def _voyage(scenario: str, duration_s: float, folder: Path) -> Path:
    path, bag = SCENARIOS / f"{scenario}.yaml", folder / f"{scenario}.mcap"
    write_bag(simulate(dataclasses.replace(load_scenario(path), duration_s=duration_s), 1), bag, path.read_bytes())
    return bag


def _copy(bag: Path, out: Path) -> None:
    with AnyReader([bag]) as reader, Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        copied = {
            one.id: writer.add_connection(one.topic, one.msgtype, typestore=reader.typestore)
            for one in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            encoded = reader.typestore.serialize_cdr(message, connection.msgtype)
            writer.write(copied[connection.id], time_ns, encoded)


def _decode(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)

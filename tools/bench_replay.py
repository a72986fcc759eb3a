"""Cost of replay, message by message and in blocks, relative to rosbags' copy of the same bag with decoding."""

import dataclasses
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from bench_rows import WITH_INTEGRITY, Row, alternate, median_ratio, own_cpu_s
from ship_replay.commands.replay import ADAPTERS
from ship_replay.offline.replay import replay
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
ROUNDS = 3
DEMO_S, SUITE_S = 30.0, 15.0
"""Lengths of the voyages replayed message by message, s: the demo, and a voyage with every device."""
SHIP_S, LONG_SUITE_S = 3600.0, 900.0
"""Lengths of the voyages replayed in blocks, s: an INS at 100 Hz with two star sensors at 5 Hz; all devices."""
SHORT_SHIP_S, SHORT_SUITE_S = 300.0, 60.0
"""Lengths of the shorter voyages, which are also replayed message by message.

The growth of memory is that from ``SHORT_SHIP_S`` to ``SHIP_S``.
"""

MOST_OF_DEMO, MOST_OF_SUITE = 6.0 * WITH_INTEGRITY, 12.0 * WITH_INTEGRITY
"""Bounds of replay message by message, relative to a copy."""
MOST_IN_BLOCKS, MOST_OF_SUITE_IN_BLOCKS = 0.25 * WITH_INTEGRITY, 0.5 * WITH_INTEGRITY
"""Bounds of replay in blocks, relative to a copy."""
MOST_MB, MOST_GROWTH = 250.0, 1.05

_COPY = "rosbags copy of the bag, each message decoded and encoded"
_REPLAYED = """
import re, sys
from pathlib import Path
from ship_replay.commands.replay import ADAPTERS
from ship_replay.offline.replay import replay
replay(Path(sys.argv[1]), Path(sys.argv[2]), ADAPTERS)
print(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""
"""Program that replays a bag and prints its peak memory (VmHWM, kB); getrusage also counts the parent process."""


def replay_cost() -> list[Row]:
    """Measure the processor time of replay message by message, of rosbags' copy and of its decoding, alternately."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [
            *_rows("demo", _voyage("demo", DEMO_S, folder), folder, MOST_OF_DEMO),
            *_rows("full suite", _voyage("everything", SUITE_S, folder), folder, MOST_OF_SUITE),
        ]


def block_cost() -> list[Row]:
    """Measure time and peak memory of replay in blocks; references: rosbags' copy, and replay message by message."""
    with tempfile.TemporaryDirectory() as name:
        long, short = Path(name) / "long", Path(name) / "short"
        long.mkdir()
        short.mkdir()
        ship, short_ship = _voyage("paper", SHIP_S, long), _voyage("paper", SHORT_SHIP_S, short)
        suite, short_suite = _voyage("everything", LONG_SUITE_S, long), _voyage("everything", SHORT_SUITE_S, short)
        memory_mb, short_memory_mb = _memory_mb(ship, long), _memory_mb(short_ship, short)
        return [
            *_block_rows("ship's attitude", ship, long, MOST_IN_BLOCKS),
            _over_one_by_one("ship's attitude", short_ship, short),
            *_block_rows("full suite", suite, long, MOST_OF_SUITE_IN_BLOCKS),
            _over_one_by_one("full suite", short_suite, short),
            Row(f"resident memory of replay, {SHIP_S:g} s", memory_mb, "MB", MOST_MB),
            Row(f"ratio: the same / {SHORT_SHIP_S:g} s", memory_mb / short_memory_mb, "x", MOST_GROWTH),
        ]


def _rows(what: str, bag: Path, folder: Path, most: float) -> list[Row]:
    copies = iter(range(ROUNDS))
    out = folder / f"{bag.stem}_out.mcap"
    replayed, copied, decoded = alternate(
        ROUNDS,
        lambda: own_cpu_s(partial(replay, bag, out, ADAPTERS, one_by_one=True)),
        lambda: own_cpu_s(partial(_copy, bag, folder / f"{bag.stem}_{next(copies)}")),
        lambda: own_cpu_s(partial(_decode, bag)),
    )
    return [
        Row(f"replay of the {what}, one by one, processor time: median", float(np.median(replayed)), "s"),
        Row(f"real time / replay of the {what}", _duration_s(bag) / float(np.median(replayed)), "x"),
        Row(f"ratio: replay of the {what} / rosbags copy", median_ratio(replayed, copied), "x", most, _COPY),
        Row(f"ratio: rosbags decoding of the {what} / rosbags copy", median_ratio(decoded, copied), "x", None, _COPY),
    ]


def _block_rows(what: str, bag: Path, folder: Path, most: float) -> list[Row]:
    copies = iter(range(ROUNDS))
    out = folder / f"{bag.stem}_out.mcap"
    blocks, copied = alternate(
        ROUNDS,
        lambda: own_cpu_s(partial(replay, bag, out, ADAPTERS)),
        lambda: own_cpu_s(partial(_copy, bag, folder / f"{bag.stem}_{next(copies)}")),
    )
    duration_s = _duration_s(bag)
    name = f"replay of the {what} in blocks"
    return [
        Row(f"{name}, {duration_s:.0f} s, processor time: median", float(np.median(blocks)), "s"),
        Row(f"real time / {name}", duration_s / float(np.median(blocks)), "x"),
        Row(f"ratio: {name} / rosbags copy", median_ratio(blocks, copied), "x", most, _COPY),
    ]


def _over_one_by_one(what: str, bag: Path, folder: Path) -> Row:
    out = folder / f"{bag.stem}_out.mcap"
    blocks, one_by_one = alternate(
        ROUNDS,
        lambda: own_cpu_s(partial(replay, bag, out, ADAPTERS)),
        lambda: own_cpu_s(partial(replay, bag, out, ADAPTERS, one_by_one=True)),
    )
    name = f"ratio: replay of the {what} in blocks / one by one, {_duration_s(bag):.0f} s"
    return Row(name, median_ratio(blocks, one_by_one), "x")


def _memory_mb(bag: Path, folder: Path) -> float:
    """Return the peak memory of a process that replays a bag, MB."""
    command = [sys.executable, "-c", _REPLAYED, str(bag), str(folder / "memory.mcap")]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout) / 1024.0


def _duration_s(bag: Path) -> float:
    with AnyReader([bag]) as reader:
        return float(reader.duration) * 1e-9


def _voyage(scenario: str, duration_s: float, folder: Path) -> Path:
    path, bag = SCENARIOS / f"{scenario}.yaml", folder / f"{scenario}.mcap"
    write_bag(dataclasses.replace(load_scenario(path), duration_s=duration_s), 1, bag, path.read_bytes())
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

"""A golden table of the outputs of replays. The table detects each change of behaviour, and is renewed only on purpose.

Each bag is replayed twice, in blocks and one message at a time. `test/golden_replays.yaml` holds a line for each topic:

- ``messages``: number of messages.
- ``sum``: sum of asinh(x / u) over all finite numbers x in the messages. The sum changes by δ if a number far above u
  changes by the ratio 1 + δ. The constant u is 1e-9 of the number's unit, and 1 for test statistics: near zero, test
  statistics are differences of nearly equal estimates and mainly rounding errors.
- ``finite``: number of finite numbers in the messages.
- ``sha256``: hash of the same numbers (first 16 digits). Texts are not included.

On other processors mathematical libraries round differently: the hashes differ there, and the sums agree.
"""

import argparse
import hashlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.commands.import_nmea import main as import_nmea
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.topic_names import TRUTH_PREFIX
from ship_replay.offline.replay import ADAPTERS, replay
from ship_replay.verification.verification import values
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "test" / "golden_replays.yaml"
SHIP_LOGS = ROOT.parent / "shared" / "data" / "nbp1406"
KEPT = "demo", "theodolite"
"""Names of replayed bags in bags/."""
SIMULATED_S = {"everything": 60.0, "paper_stars": 60.0, "theodolite_night": 60.0}
"""Scenario in bags/scenarios → length of the part that is simulated with seed 1 and replayed, s."""
RECORDED = "nbp1406"
"""Name of the replay of a real ship's logs, if the logs are available."""
NAMES = (*KEPT, *SIMULATED_S, RECORDED)
STATISTICS = "statistic", "nis"
"""Fields that are dimensionless test statistics."""
TOLERANCE = 1e-9
"""Relative change of ``sum`` up to which the numbers of two processors count as equal."""

Row = dict[str, int | float | str]


@dataclass
class _Sum:
    """Numbers of one topic."""

    messages: int = 0
    finite: int = 0
    total: float = 0.0
    digest: "hashlib._Hash" = field(default_factory=hashlib.sha256)

    def add(self, message: Any) -> None:
        """Add the numbers of a message."""
        self.messages += 1
        for name, value in values(message):
            if not isinstance(value, str):
                numbers = np.atleast_1d(value).astype(float)
                self.digest.update(numbers.tobytes())
                finite = numbers[np.isfinite(numbers)]
                self.finite += finite.size
                self.total += float(np.arcsinh(finite / (1.0 if name in STATISTICS else 1e-9)).sum())

    def row(self) -> Row:
        """Return the line of the table."""
        return {
            "messages": self.messages,
            "finite": self.finite,
            "sum": self.total,
            "sha256": self.digest.hexdigest()[:16],
        }


def replayed_rows(name: str, one_by_one: bool, folder: Path) -> dict[str, Row]:
    """Replay a bag of the table; return topic → line.

    Args:
        name: name of the replay, one of NAMES.
        one_by_one: True to replay one message at a time instead of in blocks.
        folder: folder for the bags.
    """
    bag_path = _bag(name, folder)
    out_path = folder / f"{name}_{'one_by_one' if one_by_one else 'blocks'}.mcap"
    config = ROOT / "examples" / f"{name}.yaml" if name == RECORDED else None
    replay(bag_path, out_path, ADAPTERS, config, one_by_one=one_by_one)
    sums: dict[str, _Sum] = {}
    with read_bag(out_path) as bag:
        for record in bag.records():
            if not record.topic.startswith(TRUTH_PREFIX):
                sums.setdefault(record.topic, _Sum()).add(record.decode())
    return {topic: one.row() for topic, one in sorted(sums.items())}


def _bag(name: str, folder: Path) -> Path:
    """Return the path of the bag; bags that are not in bags/ are created."""
    if name in KEPT:
        return ROOT / "bags" / f"{name}.mcap"
    path = folder / f"{name}.mcap"
    if path.exists():
        return path
    if name == RECORDED:
        logs = ["--ins", str(SHIP_LOGS / "NBP1406_seap-2014-08-01")]
        logs += ["--reference", f"s330={SHIP_LOGS / 'NBP1406_s330-2014-08-01'}"]
        import_nmea([*logs, "--resample", "20", "--out", str(path)])
    else:
        file = ROOT / "bags" / "scenarios" / f"{name}.yaml"
        write_bag(replace(load_scenario(file), duration_s=SIMULATED_S[name]), 1, path, file.read_bytes())
    return path


def differences(wanted: dict[str, Row], found: dict[str, Row], tolerance: float) -> Iterator[str]:
    """Yield a line for each topic that differs from the table.

    Args:
        wanted: lines of the table.
        found: lines of a replay.
        tolerance: relative change of ``sum`` up to which numbers count as equal; 0 compares the hashes.
    """
    for topic in sorted(wanted.keys() | found.keys()):
        old, new = wanted.get(topic), found.get(topic)
        if old is None or new is None:
            yield f"{topic}: {'not in the table' if old is None else 'not published'}"
        elif unequal := [key for key in ("messages", "finite") if old[key] != new[key]]:
            yield f"{topic}: {', '.join(f'{key} {new[key]}, {old[key]} in the table' for key in unequal)}"
        elif old["sha256"] != new["sha256"]:
            change = abs(float(new["sum"]) - float(old["sum"])) / max(abs(float(old["sum"])), 1.0)
            if not change <= tolerance or not tolerance:
                yield f"{topic}: numbers differ, their sum by a ratio of {change:.2g}"


def table() -> dict[str, dict[str, Row]]:
    """Return the table: name of a replay → topic → line."""
    rows: dict[str, dict[str, Row]] = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return rows


def main() -> int:
    """Check or renew the table."""
    parser = CommandParser(
        prog="golden",
        description="Replay the bags of the golden table and compare all numbers to the last bit. Exit code: 0 equal; "
        "1 one differs; 2 bad usage.",
    )
    parser.add_argument("--renew", action="store_true", help="write the table instead of comparing")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES, help="some of the replays")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    wanted = table() if TABLE.exists() else {}
    differ = False
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            if name == RECORDED and not SHIP_LOGS.is_dir():
                print(f"{name}: left out, its logs are not here: {SHIP_LOGS}")
                continue
            blocks, single = (replayed_rows(name, one_by_one, Path(folder)) for one_by_one in (False, True))
            lines = [f"one by one: {line}" for line in differences(blocks, single, 0.0)]
            if options.renew:
                wanted[name] = blocks
            else:
                lines += differences(wanted.get(name, {}), blocks, 0.0)
            print(f"{name}: {len(blocks)} topics, {f'{len(lines)} differ' if lines else 'equal'}", *lines, sep="\n  ")
            differ = differ or bool(lines)
    if options.renew:
        TABLE.write_text(_text(wanted), encoding="utf-8")
    return EXIT_BOUND_NOT_MET if differ else EXIT_DONE


def _text(rows: dict[str, dict[str, Row]]) -> str:
    """Return the text of the table, one line for each topic."""
    lines = ["# Numbers that replays publish: explained, checked and renewed by tools/golden.py (make golden)."]
    for name in (name for name in NAMES if name in rows):
        lines.append(f"{name}:")
        for topic, row in rows[name].items():
            numbers = ", ".join(f"{key}: {value!r}" for key, value in row.items())
            lines.append(f"  {topic}: {{{numbers}}}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    raise SystemExit(main())

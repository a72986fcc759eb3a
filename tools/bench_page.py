"""Writes docs/reference/performance.md from the rows that ``make bench`` keeps: python tools/bench_page.py [FILE]."""

import argparse
import json
from pathlib import Path
from typing import Any

from bench_rows import Row
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "performance.md"

HEAD = """# Performance

How fast the suite is, as `make bench` measures it. Seconds and microseconds belong to the machine; ratios, both sides
measured by turns in one run, hold for others. The bounds are those of issue 10; the nodes and the replay always keep
the estimates without each source beside the one by all (integrity), which may cost 1.6 times as much: that factor is in
the bounds of what they do. Why a bound is not met, [profiles](../explanation/where_time_goes.md) tell.

Measured on {date}: {processor}, {cores}, Python {python}, numpy {numpy};
load {load} in the mean of 15 minutes. On a busy machine times that pass are too long, and ratios of them uncertain;
processor times are less so.

This page is written by `python tools/bench_page.py` from `out/bench.json`, where `make bench` keeps its rows.
"""


def main() -> int:
    """Write the page."""
    parser = CommandParser(prog="bench_page", description=__doc__)
    parser.add_argument(
        "file", type=Path, nargs="?", default=ROOT / "out" / "bench.json", help="rows of make bench (out/bench.json)"
    )
    return run_command(parser, _write, None)


def _write(options: argparse.Namespace) -> int:
    PAGE.write_text(page(json.loads(options.file.read_text(encoding="utf-8"))), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
    return EXIT_DONE


def page(measured: dict[str, Any]) -> str:
    """The text of the page, of what a run kept."""
    cores = "1 core" if measured["cores"] == 1 else f"{measured['cores']} cores"
    text = HEAD.format(**measured | {"cores": cores})
    section = ""
    for entry in measured["rows"]:
        fields = dict(entry)
        benchmark = fields.pop("benchmark")
        if benchmark != section:
            text += f"\n## {benchmark.replace('_', ' ')}\n\n| measured | | unit | bound |\n|---|---|---|---|\n"
            section = benchmark
        row = Row(**fields)
        text += f"| {row.name} | {row.value:.3g} | {row.unit} | {row.bound} |\n"
    return text


if __name__ == "__main__":
    raise SystemExit(main())

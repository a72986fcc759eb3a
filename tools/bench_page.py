"""Writes docs/reference/performance.md from the rows that ``make bench`` saves: python tools/bench_page.py [FILE]."""

import argparse
import json
from pathlib import Path
from typing import Any

from bench_rows import Row
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "performance.md"

HEAD = """# Performance, measured

Speed of the suite, measured by `make bench`. [Performance](../explanation/performance.md) explains where the time goes
and why some bounds are not met. Seconds and microseconds depend on the machine. Ratios are comparable between machines:
both sides are measured by turns in one run. Nodes and replay always compute the subfilters for integrity. A filter step
may then take 1.6 times as long; bounds of processing include this factor.

Measured on {date}: {processor}, {cores}, Python {python}, numpy {numpy};
load {load}, mean of 15 minutes. On a busy machine elapsed times are too long, and their ratios uncertain; processor
times are affected less.

This page is written by `python tools/bench_page.py` from `out/bench.json`, the rows of `make bench`.
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
    """Return the text of the page for the rows of a run."""
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

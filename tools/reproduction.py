"""Writes docs/reproduction.md and its figures: results of the three papers, results of the suite, and why they differ.

Exits with 0 when written, 2 on bad usage. All random draws have fixed seeds. It takes a minute.

Example:
    make reproduction
"""

import argparse
import sys
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import write_atomically
from ship_node.pages.figure_files import write_figures
from tools.papers import p15, w18, z14
from tools.papers.figures import figures

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reproduction.md"
PICTURES = "figures/reproduction"
"""Folder of the figures, relative to the page."""

HEAD = """# Results of the papers and of the suite

This page compares every figure, table and number in our copies of the three papers ([sources](sources.md)) with the
suite's results, and explains the differences. Misprints are in the [errata](explanation/errata.md). The papers' own
methods are in `tools/papers` and `test/ship_testing`, for comparison only.

This page is written by `make reproduction`; a test compares it with the computed values.
"""


def page() -> str:
    """Return the page, with all values of the suite computed."""
    parts = [HEAD, z14.section(PICTURES), p15.section(), w18.section(f"{PICTURES}/w18_figure_4.png")]
    return "\n".join(parts)


def main() -> int:
    """Write page and figures."""
    parser = CommandParser(prog="reproduction", description=__doc__.splitlines()[0], epilog=__doc__.splitlines()[2])
    parser.add_argument("--out", type=Path, default=PAGE, help="the page (docs/reproduction.md)")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    pictures = options.out.parent / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, page())
    write_figures(figures(), pictures)
    sys.stdout.write(f"{options.out}, pictures in {pictures}\n")
    return EXIT_DONE


if __name__ == "__main__":
    sys.exit(main())

"""Writes docs/reproduction.md and its pictures: what the three papers print, what comes out here, and why they differ.

Exits with 0 when written, 2 on bad usage. All draws have fixed seeds. It takes a minute.

Example:
    make reproduction
"""

import argparse
import sys
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import write_whole
from ship_node.documents.figure_files import write_figures
from tools.papers import p15, w18, z14
from tools.papers.figures import figures

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reproduction.md"
PICTURES = "figures/reproduction"
"""From the page."""

HEAD = """# What the papers print, and what comes out here

Every figure, table and number of the three papers ([sources](sources.md)) that is left in the texts that we have: as
printed, ours, and why they differ. Misprints are in the [errata](explanation/errata.md). The papers' own methods are
peers: they are in `tools/papers` and `test/ship_testing`, and the suite uses none of them.

This page is written by `make reproduction`; a test compares it with what that computes.
"""


def page() -> str:
    """The page, every value of ours computed."""
    parts = [HEAD, z14.section(PICTURES), p15.section(), w18.section(f"{PICTURES}/w18_figure_4.png")]
    return "\n".join(parts)


def main() -> int:
    """Write page and pictures."""
    parser = CommandParser(prog="reproduction", description=__doc__.splitlines()[0], epilog=__doc__.splitlines()[2])
    parser.add_argument("--out", type=Path, default=PAGE, help="the page (docs/reproduction.md)")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    pictures = options.out.parent / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    write_whole(options.out, page())
    write_figures(figures(), pictures)
    sys.stdout.write(f"{options.out}, pictures in {pictures}\n")
    return EXIT_DONE


if __name__ == "__main__":
    sys.exit(main())

"""Availability of the ship's attitude under clouds, star vectors and the peers of [P15]: tables and figure of the docs.

Writes the tables between the marks of docs/explanation/availability.md, draws docs/figures/availability.png and prints
the tables. A thousand exposures take about five minutes on two cores. With fewer, given by --exposures, nothing is
written unless --page and --figure are given.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_DONE, CommandParser, run_command

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT / "test") not in sys.path:
    sys.path.insert(0, str(ROOT / "test"))

# The peers and the study are in the tests, which are no package.
from ship_testing import availability_study as trials  # noqa: E402

PAGE = ROOT / "docs" / "explanation" / "availability.md"
FIGURE = ROOT / "docs" / "figures" / "availability.png"
EXPOSURES, SMALL_PART = 1000, 20
_PART = 10
"""Number of exposures in each task of a worker process."""

BEGIN, END = "<!-- {name}: python tools/availability.py -->", "<!-- end of {name} -->"

_LINES = {
    trials.WITH_INS: ("#1b4f72", "o", "star vectors with INS"),
    trials.STARS_VALID: ("#2e86c1", "s", "star vectors alone"),
    trials.BORESIGHTS: ("#c0392b", "^", "two boresights [6], also with [5]"),
    trials.BORESIGHTS_OF_TWO: ("#e59866", "v", "two boresights, 2 stars suffice"),
    trials.ONE: ("#7f8c8d", "x", "one sensor [5]"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the study; print and write its results."""
    first, _, *others = __doc__.splitlines()
    parser = CommandParser(
        prog="availability", description=first, epilog=" ".join(others), example="python tools/availability.py"
    )
    parser.add_argument("--exposures", type=int, default=EXPOSURES, help=f"number of exposures ({EXPOSURES})")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--page", type=Path, help="page with the marks (that of the docs, if all exposures are made)")
    parser.add_argument("--figure", type=Path, help="PNG to draw (that of the docs, if all exposures are made)")
    return run_command(parser, _run, arguments)


def _run(options: argparse.Namespace) -> int:
    if options.exposures < 1 or options.processes < 1:
        print("availability: --exposures and --processes: expected 1 or more", file=sys.stderr)
        return EXIT_BAD_INPUT
    whole = options.exposures == EXPOSURES
    page, figure = options.page or (PAGE if whole else None), options.figure or (FIGURE if whole else None)
    if page is not None and not page.is_file():
        print(f"availability: {page}: no such page", file=sys.stderr)
        return EXIT_BAD_INPUT
    results = _study(options.exposures, options.processes)
    small = {key: values[:SMALL_PART] for key, values in results.items()}
    tables = {"stars": star_table(results), "clouds": cloud_table(results), "consistency": consistency_table(results)}
    tables |= {"small part": small_table(small)}
    for name, table in tables.items():
        print(f"\n{name}\n{table}")
    if page is not None:
        text = page.read_text(encoding="utf-8")
        for name, table in tables.items():
            text = insert_table(text, name, table)
        page.write_text(text, encoding="utf-8")
    if figure is not None:
        draw(results, figure)
    return EXIT_DONE


def _study(exposures: int, processes: int) -> trials.Results:
    parts = [range(first, min(first + _PART, exposures)) for first in range(0, exposures, _PART)]
    with ProcessPoolExecutor(processes) as pool:
        found = list(pool.map(trials.study, parts))
    return {key: np.concatenate([part[key] for part in found]) for key in found[0]}


# -- tables -----------------------------------------------------------------------------------------------------


def star_table(results: trials.Results) -> str:
    """Return the table over number of stars in each sensor and method."""
    return _table("stars", [trials.count_case(counts) for counts in sorted(trials.COUNTS)], results)


def cloud_table(results: trials.Results) -> str:
    """Return the table over cloud cover and method."""
    patches = [(cover, patch) for patch in trials.PATCHES_DEG for cover in trials.COVERS if cover]
    return _table("clouds", [trials.cloud_case(*one) for one in patches], results)


def small_table(results: trials.Results) -> str:
    """Return the table of the first exposures only, which a test recomputes."""
    counts = [trials.count_case(one) for one in ((1, 1), (2, 2), (4, 4), (5, 3))]
    cases = [*counts, *(trials.cloud_case(0.5, patch) for patch in trials.PATCHES_DEG)]
    return _table("stars, or clouds", cases, results)


def _table(head: str, cases: list[str], results: trials.Results) -> str:
    lines = [f"| {head} | {' | '.join(trials.METHODS)} |", "|---|" + "---:|" * len(trials.METHODS)]
    for case in cases:
        cells = [_cell(results[case, method]) for method in trials.METHODS]
        lines.append(f"| {case} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(values: np.ndarray) -> str:
    if not trials.solved_share(values):
        return "none"
    return f"{100.0 * trials.availability(values):.1f} of {100.0 * trials.solved_share(values):.1f}"


def consistency_table(results: trials.Results) -> str:
    """Return the table of the numbers of VALID attitudes and of VALID attitudes with errors beyond their covariance."""
    lines = ["| stars | INS | VALID | beyond the covariance | mean NEES |", "|---|---|---:|---:|---:|"]
    for counts in sorted(trials.COUNTS):
        for method, has_ins in ((trials.STARS_VALID, "no"), (trials.WITH_INS, "yes")):
            values = results[trials.count_case(counts), method]
            count = int(np.sum(np.isfinite(values[:, 1])))
            if count:
                mean = float(np.nanmean(values[:, 1]))
                cells = (
                    trials.count_case(counts),
                    has_ins,
                    str(count),
                    str(trials.count_beyond_covariance(values)),
                    f"{mean:.2f}",
                )
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def insert_table(text: str, name: str, table: str) -> str:
    """Return the page with a table between its marks.

    Raises:
        ValueError: the page has no such marks.
    """
    begin, end = BEGIN.format(name=name), END.format(name=name)
    before, found_begin, rest = text.partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found_begin and found_end):
        raise ValueError(f"the page has no marks {begin} and {end}")
    return f"{before}{begin}\n\n{table}\n\n{end}{after}"


# -- figure -----------------------------------------------------------------------------------------------------


def draw(results: trials.Results, path: Path) -> None:
    """Draw availability over stars per sensor and over cloud cover."""
    style = {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False, "savefig.facecolor": "white"}
    with plt.rc_context(style):
        figure, (left, *right) = plt.subplots(1, 3, figsize=(15, 5.2), sharey=True, layout="constrained")
        counts = np.arange(1, trials.CLEAR_STARS + 1)
        _draw_lines(left, counts, [trials.count_case((n, n)) for n in counts.tolist()], results)
        left.set_xlabel("stars in each of two sensors")
        left.set_ylabel(f"all three angles better than {trials.LIMIT_ARCSEC:g}″, %")
        left.set_title("as many stars in each sensor")
        for axes, patch in zip(right, trials.PATCHES_DEG, strict=True):
            cases = [trials.cloud_case(cover, patch) for cover in trials.COVERS]
            _draw_lines(axes, 100.0 * np.array(trials.COVERS), cases, results)
            axes.set_xlabel("cloud cover, %")
        right[0].set_title("eight stars a sensor, hidden one by one")
        right[1].set_title(f"the same, hidden in patches of {trials.PATCHES_DEG[1]:g}°")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles), fontsize=10, frameon=False)
        figure.savefig(path, dpi=110, metadata={"Software": None})
        plt.close(figure)


def _draw_lines(axes: Axes, x: np.ndarray, cases: list[str], results: trials.Results) -> None:
    for method, (colour, marker, label) in _LINES.items():
        values = [100.0 * trials.availability(results[case, method]) for case in cases]
        axes.plot(x, values, color=colour, marker=marker, ms=5, lw=1.5, label=label)
    axes.set_ylim(-2.0, 102.0)
    axes.grid(alpha=0.25)


if __name__ == "__main__":
    sys.exit(main())

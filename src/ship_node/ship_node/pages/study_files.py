"""Files of a study: reading its input, writing tables, figures and page."""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ship_bags.output_files import add_force_option, write_atomically, write_csv
from ship_bags.parameter_yaml import read_nested_parameters
from ship_estimation.parameters.schema import ParameterError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Table = tuple[Sequence[str], Iterable[Iterable[Any]]]
"""Header and rows of a CSV table."""

_Result = TypeVar("_Result")


def add_study_arguments(parser: argparse.ArgumentParser, name: str, words: str) -> None:
    """Add the optional input file of a study, its output folder and ``--force``.

    Args:
        parser: parser to which the arguments are added.
        name: name of the file in the help.
        words: help of the file.
    """
    parser.add_argument("file", type=Path, nargs="?", metavar=name, help=words)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder, created if absent")
    add_force_option(parser)


def study_of_file(
    path: Path | None, defaults: Mapping[str, Any], compute: Callable[[Mapping[str, Any]], _Result]
) -> _Result:
    """Return what is computed from the values of a file, or from the default values without a file.

    Raises:
        BadInput: the file cannot be read, or a value is invalid; the text gives file, line, parameter and what was
            expected.
    """
    if path is None:
        return compute(defaults)
    file = read_nested_parameters(path)
    try:
        return compute(file.values)
    except ParameterError as error:
        raise file.error(error) from error


def write_tables(folder: Path, tables: Mapping[str, Table]) -> None:
    """Write tables, given by file name, into a folder, which is created if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (header, rows) in tables.items():
        write_csv(folder / name, header, rows)


def write_study(
    page: Path,
    tables: Mapping[str, Table],
    figures: Iterable[tuple[str, "Figure"]],
    page_text: Callable[[Mapping[str, Path]], str],
    summary: Iterable[str],
) -> None:
    """Write tables, figures and page of a study into the page's folder; print the summary and the path of the page.

    Args:
        page: the page; its folder is created if it is missing.
        tables: tables by file name.
        figures: names and figures, for ``NAME.png``.
        page_text: function that returns the page, given the files of the figures by name.
        summary: lines to print.
    """
    from ship_node.pages.figure_files import write_figures  # loads slowly

    write_tables(page.parent, tables)
    write_atomically(page, page_text(write_figures(figures, page.parent)))
    sys.stdout.writelines(f"{line}\n" for line in (*summary, f"page: {page}"))

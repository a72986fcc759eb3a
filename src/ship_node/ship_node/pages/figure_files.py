"""Files of figures: size, style, format; the same figure gives the same file.

Import this module late, because loading matplotlib takes longer than most studies.
"""

import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ship_bags.errors import BadInput
from ship_bags.output_files import write_atomically
from ship_geometry.rotations import FloatArray

COMMON_STYLE = {
    "text.parse_math": False,  # names may contain $
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.framealpha": 0.95,
    "savefig.facecolor": "white",
}
"""Style that all figure files share."""

_STUDY_STYLE = {
    **COMMON_STYLE,
    "font.size": 11,
    "axes.titlesize": 11.5,
    "grid.color": "0.88",
    "axes.spines.top": False,
    "axes.spines.right": False,
}

_DATE_METADATA = {".png": "Software", ".pdf": "CreationDate", ".svg": "Date"}
"""Metadata that would make the file depend on the date or on the version of matplotlib, by format."""

MAX_ROWS = 60
"""Maximum number of rows of a figure, one per source or name; tables have all rows."""

_MAX_NAME_LENGTH = 40
"""Maximum length of a name at an axis, characters; longer names leave no room for the drawing."""

_SETTLED_RATIO = 3.0
"""Ratio of sigma to its best value below which the start is over."""


def settled_slice(sigma: FloatArray) -> slice:
    """Return the part of a time series by which a figure is scaled: all but the start with large uncertainty.

    Args:
        sigma: predicted standard deviations in order of time, shape (n,); NaN where unknown.
    """
    known = sigma[np.isfinite(sigma)]
    if not len(known):
        return slice(None)
    # The tenth percentile, because sigma may reach its minimum for a short time only.
    return slice(int(np.argmax(sigma <= _SETTLED_RATIO * np.percentile(known, 10.0))), None)


def short_name(name: str) -> str:
    """Return a name shortened for a figure; tables have the full name."""
    return name if len(name) <= _MAX_NAME_LENGTH else f"{name[: _MAX_NAME_LENGTH - 1]}…"


def legend_below(figure: Figure, axes: Axes, columns: int = 0) -> None:
    """Place the legend of one of the axes below the figure, in one row unless a number of columns is given."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns or len(labels))


def write_figures(figures: Iterable[tuple[str, Figure]], folder: Path) -> dict[str, Path]:
    """Write the figures of a study into an existing folder, one after the other.

    Args:
        figures: names and figures; the iteration draws the figures in the common style.
        folder: folder for ``NAME.png``.

    Returns:
        Paths of the files, by name of the figure.
    """
    files = {}
    with plt.rc_context(_STUDY_STYLE):
        for name, figure in figures:
            files[name] = folder / f"{name}.png"
            save_figure(figure, files[name])
    return files


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure (.png, .pdf or .svg by the name) and close it.

    Raises:
        BadInput: the format is unknown or the file cannot be written.
    """
    metadata = {_DATE_METADATA[path.suffix.lower()]: None} if path.suffix.lower() in _DATE_METADATA else {}
    content = io.BytesIO()
    try:
        with plt.rc_context({"svg.hashsalt": path.stem}):  # else the ids in an SVG file are random
            figure.savefig(content, dpi=110, metadata=metadata, format=path.suffix[1:] or None)
        write_atomically(path, content.getvalue())
    except (ValueError, OSError) as problem:
        raise BadInput(f"the figure cannot be written: {problem}", file=path) from problem
    finally:
        plt.close(figure)

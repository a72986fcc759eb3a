"""The figures of a study as PNG, in one style. Import it late: loading matplotlib takes longer than most studies."""

import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from ship_bags.output_files import write_whole
from ship_geometry.rotations import FloatArray

_STYLE = {
    "text.parse_math": False,  # a name with $ is a name
    "font.size": 11,
    "axes.titlesize": 11.5,
    "axes.grid": True,
    "grid.color": "0.88",
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.framealpha": 0.95,
    "savefig.facecolor": "white",
}


MOST_ROWS = 60
"""Rows of a figure, one for each source or name: tables have all of them."""

_LONGEST_NAME = 40
"""Letters of a name beside an axis: more would leave no room for what is drawn."""

_SETTLED = 3.0
"""A start is over when sigma has come down to this many times what it is at its best."""


def settled(sigma: FloatArray) -> slice:
    """The part of a course that a figure is scaled by: all but the start, when little was known yet.

    Args:
        sigma: predicted, in order of time, shape (n,); NaN where none was given.
    """
    known = sigma[np.isfinite(sigma)]
    if not len(known):
        return slice(None)
    # The least tenth and not the minimum, which sigma may have had for a moment only.
    return slice(int(np.argmax(sigma <= _SETTLED * np.percentile(known, 10.0))), None)


def short_name(name: str) -> str:
    """Return a name as a figure has room for it; tables have all of it."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


def write_figures(figures: Iterable[tuple[str, Figure]], folder: Path) -> dict[str, Path]:
    """Write figures into a folder that exists, each drawn when its turn comes.

    Args:
        figures: names and figures; drawn in the style while iterated over.
        folder: where ``NAME.png`` go.

    Returns:
        The files by the figures' names.
    """
    files = {}
    with plt.rc_context(_STYLE):
        for name, figure in figures:
            files[name] = folder / f"{name}.png"
            # Without the version of matplotlib the same study gives the same file.
            content = io.BytesIO()
            figure.savefig(content, format="png", dpi=110, metadata={"Software": None})
            write_whole(files[name], content.getvalue())
            plt.close(figure)
    return files

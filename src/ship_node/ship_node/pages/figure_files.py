"""Figures of a study as PNG files, in one style.

Import this module late, because loading matplotlib takes longer than most studies.
"""

import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from ship_bags.output_files import write_atomically
from ship_geometry.rotations import FloatArray

_STYLE = {
    "text.parse_math": False,  # names may contain $
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


def write_figures(figures: Iterable[tuple[str, Figure]], folder: Path) -> dict[str, Path]:
    """Write figures into an existing folder, one after the other.

    Args:
        figures: names and figures; the iteration draws the figures in the common style.
        folder: folder for ``NAME.png``.

    Returns:
        Paths of the files, by name of the figure.
    """
    files = {}
    with plt.rc_context(_STYLE):
        for name, figure in figures:
            files[name] = folder / f"{name}.png"
            # The metadata omit the version of matplotlib, so that the same study gives the same file.
            content = io.BytesIO()
            figure.savefig(content, format="png", dpi=110, metadata={"Software": None})
            write_atomically(files[name], content.getvalue())
            plt.close(figure)
    return files

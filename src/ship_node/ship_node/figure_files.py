"""The figures of a study as PNG, in one style. Loading matplotlib takes longer than most studies: import this late."""

import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from ship_node.part_file import write_whole

_STYLE = {
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

"""The parts that a page is put together of: figures, tables, numbers."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from ship_geometry.rotations import FloatArray


def image(path: Path, words: str, style: str = "wide") -> str:
    """A figure, embedded."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img class="{style}" alt="{escape(words)}" src="data:image/png;base64,{data}">'


def table(header: Sequence[str], rows: Iterable[Sequence[str]], last_is_sum: bool = False, style: str = "") -> str:
    """A table; the cells are escaped."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    return f'<table class="{style}"><thead><tr>{head}</tr></thead>{body(rows, last_is_sum)}</table>'


def body(rows: Iterable[Sequence[str]], last_is_sum: bool) -> str:
    """The rows of a table."""
    lines = ["<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    if last_is_sum:
        lines[-1] = lines[-1].replace("<tr>", '<tr class="sum">')
    return f"<tbody>{''.join(lines)}</tbody>"


def arcsec(values: FloatArray, digits: int = 2) -> list[str]:
    """Values as people read them; a dash where there is none."""
    # Adding zero takes the sign from a rounded zero.
    texts = ("–" if np.isnan(value) else f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
    return [text.replace("-", "−") for text in texts]

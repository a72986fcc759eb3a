"""Parts of the self-contained HTML pages of studies: style, tables, embedded figures."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from ship_geometry.rotations import FloatArray

STYLE = """\
body { font: 17px/1.55 system-ui, "DejaVu Sans", sans-serif; color: #1c2733; max-width: 62rem; margin: 2rem auto;
padding: 0 1.2rem; }
h1 { font-size: 1.9rem; margin-bottom: 0.2rem; color: #0b3c6f; }
h2 { font-size: 1.4rem; margin-top: 2.6rem; border-bottom: 2px solid #d5dee8; color: #0b3c6f; }
h3 { font-size: 1.08rem; margin-top: 1.6rem; }
p.lead { color: #51606f; margin-top: 0; }
.box { background: #eef4fa; border-left: 5px solid #0b3c6f; padding: 0.4rem 1.2rem; margin: 1.2rem 0; }
.table { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.88rem; margin: 0.8rem 0; }
th, td { padding: 0.28rem 0.7rem; text-align: right; border-bottom: 1px solid #dde4ec;
font-variant-numeric: tabular-nums; white-space: nowrap; }
th { background: #f4f7fa; white-space: normal; vertical-align: bottom; }
details { margin: 1rem 0; } summary { cursor: pointer; color: #0b3c6f; font-weight: 600; }
th:first-child, td:first-child { text-align: left; }
table.words td:nth-child(2), table.words th:nth-child(2) { text-align: left; }
tr.sum td { font-weight: 600; border-top: 2px solid #9fb2c5; }
img { max-width: 100%; display: block; margin: 1.2rem auto; }
dt { font-weight: 600; }
img.small { max-width: min(100%, 32rem); }
table.groups th { text-align: center; }
table.groups th, table.groups td { padding: 0.28rem 0.4rem; font-size: 0.95em; }
table.groups th:nth-child(3n+2), table.groups td:nth-child(3n+2) { border-left: 1px solid #dde4ec; }
dd { margin: 0 0 0.5rem 1.2rem; }
@media print { body { font-size: 11pt; max-width: none; } img, table { break-inside: avoid; } }
"""
"""Content of the style element."""


def image(path: Path, alt_text: str, style: str = "wide") -> str:
    """Return an img element with an embedded PNG file.

    Args:
        path: the file.
        alt_text: alternative text.
        style: ``wide`` or ``small``.
    """
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img class="{style}" alt="{escape(alt_text)}" src="data:image/png;base64,{data}">'


def collapsible(title: str, content: str, is_open: bool = False) -> str:
    """Return a part of a page that a click on its title opens and closes."""
    return f"<details{' open' if is_open else ''}><summary>{escape(title)}</summary>{content}</details>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], last_is_sum: bool = False, style: str = "") -> str:
    """Return a table of texts.

    Args:
        header: titles of the columns.
        rows: cells of each row.
        last_is_sum: True if the last row is the sum of the others.
        style: ``words`` if the second column has texts, ``groups`` if every three columns belong together.
    """
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    return f'<table class="{style}"><thead><tr>{head}</tr></thead>{table_body(rows, last_is_sum)}</table>'


def table_body(rows: Iterable[Sequence[str]], last_is_sum: bool) -> str:
    """Return the body of a table, for a table whose header :func:`table` cannot make; arguments as in :func:`table`."""
    lines = ["<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    if last_is_sum:
        lines[-1] = lines[-1].replace("<tr>", '<tr class="sum">')
    return f"<tbody>{''.join(lines)}</tbody>"


def arcsec_texts(values: FloatArray, digits: int = 2) -> list[str]:
    """Return numbers as texts for a table, shape (n,); a dash for NaN."""
    # Adding zero removes the sign of a rounded zero.
    texts = ("–" if np.isnan(value) else f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
    return [text.replace("-", "−") for text in texts]

"""HTML pages of studies and reports, each in one file with its figures: templates that extend ``frame.html.j2``."""

import base64
import math
from pathlib import Path
from typing import Any

import jinja2


def render(template: Path, **values: Any) -> str:
    """Return the text of a page; the same values give the same text.

    Args:
        template: the page's template. It extends ``frame.html.j2`` and may import the macros of ``parts.html.j2``.
        values: values for the template: ``title``, and optionally ``sections`` (ids and titles for links at the top).
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )
    environment.filters.update(cell=_cell, decimal=decimal_text, png=_png)
    return environment.get_template(template.name).render(**values)


def decimal_text(value: float, digits: int = 2) -> str:
    """Return a number with a fixed number of decimals; a dash for NaN."""
    # Adding zero removes the sign of a rounded zero.
    return "–" if math.isnan(value) else f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")


def _cell(value: Any) -> Any:
    return decimal_text(value) if isinstance(value, float) else value


def _png(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"

"""The parameters of a dataclass as rows of text, for ``--help``."""

import textwrap

from ship_estimation.parameters.schema import ParameterDescription, describe

_WIDTH = 120
_WIDEST = 24
"""Maximum width of a column between the first and the last; a wider cell does not widen the column."""
_BELOW = " " * 6


def key_rows(kind: type) -> list[str]:
    """Return the keys of a YAML file with nested groups as lines: name, unit, default, range or choices, description.

    Args:
        kind: dataclass into which the file is read.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> key_rows(GateConfig)[1].split()[:4]
        ['conflict_after*', '-', '10', '[1,']
    """
    return wrapped_lines([parameter_row(description) for description in describe(kind)])


def parameter_row(description: ParameterDescription) -> tuple[str, ...]:
    """Return name, unit, default, range or choices, and description of a parameter; a star marks a live parameter.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> parameter_row(next(iter(describe(GateConfig))))[:4]
        ('probability*', '-', '0.9999', '[0.5, 0.999999999]')
    """
    default = "must be given" if description.default is None else f"{description.default!r}"
    allowed = " | ".join(description.choices)
    if description.minimum is not None or description.maximum is not None:
        low = "-inf" if description.minimum is None else f"{description.minimum:.12g}"
        high = "inf" if description.maximum is None else f"{description.maximum:.12g}"
        allowed = f"[{low}, {high}]"
    live = "*" if description.live else ""
    return description.name + live, description.unit or "-", default, allowed, description.doc


def aligned_lines(rows: list[tuple[str, ...]]) -> list[str]:
    """Return rows of cells as lines of text with aligned columns; the last column is not padded.

    Example:
        >>> aligned_lines([("heading", "deg"), ("sigma", "arcsec")])
        ['  heading  deg', '  sigma    arcsec']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)) for row in rows]
    return ["  " + line.rstrip() for line in lines]


def wrapped_lines(rows: list[tuple[str, ...]]) -> list[str]:
    """Return aligned lines of at most 120 characters; a last cell that does not fit is wrapped on the next lines.

    Example:
        >>> for line in wrapped_lines([("heading", "deg", "true"), ("sigma", "arcsec", "of the heading, " * 7)]):
        ...     print(line[:40])
          heading  deg     true
          sigma    arcsec
              of the heading, of the heading, of
    """
    first, *others = [max(map(len, column)) for column in zip(*rows, strict=True)]
    widths = [first, *(min(width, _WIDEST) for width in others[:-1])]
    lines = []
    for *head, last in rows:
        begin = "  " + "  ".join(f"{cell:{width}}" for cell, width in zip(head, widths, strict=True))
        line = f"{begin}  {last}".rstrip()
        lines += [line] if len(line) <= _WIDTH else [*_wrap(begin, ""), *_wrap(last, _BELOW)]
    return lines


def _wrap(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        text, _WIDTH, initial_indent=indent, subsequent_indent=_BELOW, break_long_words=False, break_on_hyphens=False
    )

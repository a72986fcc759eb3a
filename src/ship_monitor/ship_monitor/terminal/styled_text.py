"""Text in the cells of a terminal: styled, cleaned, cut and padded.

A wide character takes two cells, a combining character no cell. Names and texts come from the network: characters that
control the terminal are replaced by "?".
"""

import enum
import unicodedata
from dataclasses import dataclass
from typing import NamedTuple

from rich.cells import cell_len, set_cell_size

_IN_ASCII = {"°": "deg", "″": '"', "±": "+-", "σ": "sigma", "→": "->", "…": "~", "²": "2", "×": "x"}
_IN_ASCII |= dict.fromkeys("−—─·", "-")
_ZERO_WIDTH = ("Mn", "Me", "Cf")


class TextStyle(enum.Enum):
    """Kind of a piece of text; the theme gives its colour. The most important kinds differ without colours too."""

    TEXT = enum.auto()
    SECOND = enum.auto()
    STRONG = enum.auto()
    SAFE = enum.auto()
    CAUTION = enum.auto()
    """Reversed."""
    UNSAFE = enum.auto()
    """Reversed and bold."""
    OLD = enum.auto()
    """Struck through."""
    OUT = enum.auto()
    ALARM = enum.auto()
    WARNING = enum.auto()
    NOTICE = enum.auto()
    """An alert of the priority caution."""
    MARKED = enum.auto()
    """Reversed: selected, or paused."""


class StyledText(NamedTuple):
    """A piece of a line with one style."""

    text: str
    style: TextStyle


Line = tuple[StyledText, ...]
"""One row of the terminal; its pieces fill the width exactly."""


@dataclass(frozen=True)
class LineFormatter:
    """Formatter of lines of one width.

    Attributes:
        width: columns of the terminal.
        is_ascii: True if the terminal shows ASCII only: "deg" for °, '"' for ″, "+-" for ±.
    """

    width: int
    is_ascii: bool = False

    def clean(self, text: str) -> str:
        """Return a text with "?" for control characters, without characters of zero width; ASCII if ``is_ascii``."""
        kept = (char if char.isprintable() else "?" for char in text if unicodedata.category(char) not in _ZERO_WIDTH)
        if not self.is_ascii:
            return "".join(kept)
        return "".join(_IN_ASCII.get(char, char if char.isascii() else "?") for char in kept)

    def fit(self, text: str, width: int, *, to_right: bool = False) -> str:
        """Return a text of ``width`` cells: cut with an ellipsis, or padded right (left with ``to_right``)."""
        text = self.clean(text)
        if cell_len(text) > width:
            return set_cell_size(set_cell_size(text, max(width - 1, 0)).rstrip() + self.clean("…"), width)
        padding = " " * (width - cell_len(text))
        return padding + text if to_right else text + padding

    def cell_count(self, text: str) -> int:
        """Return the number of cells of a text."""
        return cell_len(self.clean(text))

    def styled_line(self, *pieces: StyledText) -> Line:
        """Return a row of pieces, cut or padded to the width."""
        room, made = self.width, []
        for piece in pieces:
            text = self.clean(piece.text)
            if cell_len(text) > room:
                text = self.fit(text, room)
            room -= cell_len(text)
            if text:
                made.append(StyledText(text, piece.style))
        return (*made, StyledText(" " * room, TextStyle.TEXT)) if room else tuple(made)

    def rule(self, *titles: str) -> Line:
        """Return a horizontal line with titles: ── sources ── 7 of 8 in ─────."""
        text = "".join(f"── {title} " for title in titles)
        return self.styled_line(StyledText(text + "─" * max(self.width - self.cell_count(text), 0), TextStyle.SECOND))

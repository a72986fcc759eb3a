"""Tables on the terminal, in one form."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

_WIDTH_WITHOUT_TERMINAL = 130


def table_console() -> Console:
    """Return the console for tables: as wide as the terminal; wide enough for all columns if there is no terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH_WITHOUT_TERMINAL)


def console_table(title: str, columns: Sequence[str], groups: Iterable[Sequence[Sequence[str]]]) -> Table:
    """Return a table.

    Args:
        title: title of the table.
        columns: titles of the columns; a title begins with ``>`` if the column has numbers, which are right-aligned.
        groups: groups of rows with a line between them; missing cells at the end of a row are empty.
    """
    table = Table(title=title)
    for column in columns:
        table.add_column(column.removeprefix(">"), justify="right" if column.startswith(">") else "left")
    for rows in groups:
        for number, row in enumerate(rows, start=1):
            table.add_row(*row, end_section=number == len(rows))
    return table

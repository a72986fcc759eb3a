"""What follows from the samples of a voyage, computed when it is asked for, so that memory does not grow with it."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Generic, TypeVar

Row = TypeVar("Row")

BLOCK_ROWS = 4096
"""Rows computed at a time: as fast as all at once."""

_KEPT_BLOCKS = 2
"""Samples are asked for in the order of their arrival, some of them a little out of the order of their stamps."""


class Rows(Generic[Row]):
    """One row a sample, of which the blocks asked for last are kept.

    Args:
        of: the rows of some of the samples; each row depends on its own sample alone.
    """

    def __init__(self, of: Callable[[slice], Sequence[Row]]) -> None:
        self._of = of
        self._block = lru_cache(_KEPT_BLOCKS)(self._computed)

    def __getitem__(self, row: int) -> Row:
        """The row of a sample."""
        number, place = divmod(row, BLOCK_ROWS)
        return self._block(number)[place]

    def _computed(self, number: int) -> Sequence[Row]:
        return self._of(slice(number * BLOCK_ROWS, (number + 1) * BLOCK_ROWS))

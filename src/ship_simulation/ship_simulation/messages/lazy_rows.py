"""Values derived from samples on demand, so that memory does not grow with the length of the voyage."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Generic, TypeVar

Row = TypeVar("Row")

BLOCK_ROWS = 4096
"""Number of rows computed at a time, large enough for the full speed."""

_KEPT_BLOCKS = 2
"""Number of cached blocks. Samples are used in order of arrival, which differs slightly from the order of stamps."""


class LazyRows(Generic[Row]):
    """One row per sample, with a cache of the last blocks.

    Args:
        compute: function that returns the rows of a slice of samples; each row depends on its sample only.
    """

    def __init__(self, compute: Callable[[slice], Sequence[Row]]) -> None:
        self._of = compute
        self._block = lru_cache(_KEPT_BLOCKS)(self._compute_block)

    def __getitem__(self, row: int) -> Row:
        """Return the row of a sample."""
        number, place = divmod(row, BLOCK_ROWS)
        return self._block(number)[place]

    def _compute_block(self, number: int) -> Sequence[Row]:
        return self._of(slice(number * BLOCK_ROWS, (number + 1) * BLOCK_ROWS))

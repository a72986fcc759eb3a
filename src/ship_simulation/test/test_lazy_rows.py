"""Rows that are computed in blocks equal those computed all at once, for any order of access."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.frames import quaternion_from_rotation
from ship_simulation.messages.ship_messages import BLOCK_ROWS, LazyRows, quaternion_rows

COUNT = 2 * BLOCK_ROWS + 5


class CountedRows:
    """Squares of numbers, with a record of the computed blocks."""

    def __init__(self):
        self.parts = []

    def __call__(self, part):
        self.parts.append(part)
        return (np.arange(COUNT)[part] ** 2).tolist()


def test_rows_equal_those_computed_all_at_once():
    rotation = Rotation.random(COUNT, np.random.default_rng(1)).as_matrix()
    rows = quaternion_rows(rotation)
    assert [rows[row] for row in range(COUNT)] == quaternion_from_rotation(rotation).tolist()


def test_blocks_are_computed_once_in_order_of_time():
    counted = CountedRows()
    rows = LazyRows(counted)
    # Some samples arrive out of the order of their stamps, here across the ends of blocks.
    order = np.argsort(np.arange(COUNT) + np.random.default_rng(1).uniform(0.0, 50.0, COUNT))
    assert [rows[int(row)] for row in order] == (order**2).tolist()
    assert counted.parts == [slice(start, start + BLOCK_ROWS) for start in range(0, COUNT, BLOCK_ROWS)]


def test_a_row_far_back_is_computed_again():
    counted = CountedRows()
    rows = LazyRows(counted)
    assert [rows[0], rows[BLOCK_ROWS], rows[2 * BLOCK_ROWS], rows[3]] == [0, BLOCK_ROWS**2, 4 * BLOCK_ROWS**2, 9]
    assert len(counted.parts) == 4


def test_a_row_beyond_the_last_is_an_error():
    with pytest.raises(IndexError):
        LazyRows(CountedRows())[COUNT]

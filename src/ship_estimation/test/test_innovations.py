"""Innovations in a table: one of each stamp, in order; their statistics are those of numpy over all of them."""

import math

import numpy as np
import pytest

from ship_estimation.innovations.gates import value_above
from ship_estimation.innovations.innovation_statistics import (
    LEAST_COUNT,
    Innovation,
    InnovationTable,
    PartStatistics,
    axis_statistics,
)
from ship_geometry.rotations import FloatArray


def innovation(time_ns: int, squares: list[float], **others: object) -> Innovation:
    usual = {"degrees": 2, "nis": 1.0, "components": 2, "own_share": 1.0, "is_used": True, "axes": {"up": (1.0, 2.0)}}
    return Innovation(time_ns, np.array(squares), **(usual | others))  # type: ignore[arg-type]


def table_of(*innovations: Innovation) -> InnovationTable:
    table = InnovationTable()
    table.add_all(innovations)
    return table


def test_table_is_in_order_of_time_and_keeps_the_last_of_a_stamp() -> None:
    table = table_of(innovation(3, [3.0]), innovation(1, [1.0]), innovation(3, [33.0]))
    table.add_all([innovation(2, [2.0]), innovation(1, [11.0])])
    assert table.times_ns.tolist() == [1, 2, 3]
    assert table.squares.tolist() == [[11.0], [2.0], [33.0]]


def test_a_table_grows_with_parts_and_axes_and_keeps_what_it_has() -> None:
    table = table_of(innovation(1, [1.0]))
    table.add_all([innovation(2, [2.0, 22.0], axes={"right": (5.0, 6.0)}), innovation(3, [np.inf], axes={})])
    assert table.axes == ("up", "right")
    np.testing.assert_array_equal(table.squares, [[1.0, np.nan], [2.0, 22.0], [np.inf, np.nan]])
    assert table.on_axis("up").tolist() == [[1.0, 2.0]]
    assert table.on_axis("right").tolist() == [[5.0, 6.0]]


def test_old_and_surplus_innovations_are_dropped() -> None:
    table = table_of(*[innovation(time_ns, [0.0]) for time_ns in range(10)])
    table.drop_old(until_ns=3, most=100)
    assert table.times_ns.tolist() == [4, 5, 6, 7, 8, 9]
    table.drop_old(until_ns=3, most=2)
    assert table.times_ns.tolist() == [8, 9]


@pytest.mark.parametrize("far", [0, 20, 60])
@pytest.mark.parametrize("count", [29, 101, 150])
def test_factor_is_by_the_median_or_the_lower_quartile(count: int, far: int) -> None:
    """Each innovation has two parts; some parts are rejected, and some innovations are mostly prediction error."""
    rng = np.random.default_rng([count, far])
    squares = 2.0 * rng.chisquare(2, (count, 2))
    squares[:far, 1] = np.inf
    found = PartStatistics(
        table_of(*[innovation(k, row.tolist(), own_share=0.9 if k % 7 else 0.4) for k, row in enumerate(squares)])
    )
    informative = squares[[k for k in range(count) if k % 7]].ravel()
    near = informative[informative <= value_above(1e-3, 2)]
    assert found.outlier_share == pytest.approx(1.0 - len(near) / len(informative), rel=1e-13)
    by_all, by_near = factor(informative), factor(near)
    bulk = by_all if math.isnan(by_near) else by_near
    assert found.factor == pytest.approx(by_all if bulk > 1.25 else bulk, rel=1e-13, nan_ok=True)


def factor(squares: FloatArray) -> float:
    if len(squares) < LEAST_COUNT:
        return math.nan
    share = 0.5 if np.mean(squares > value_above(1e-3, 2)) < 0.25 else 0.25
    found = float(np.quantile(squares, share, method="inverted_cdf"))
    if math.isinf(found):
        return math.nan
    return math.sqrt(max(1.0 + (found / value_above(1.0 - share, 2) - 1.0) / 0.9, 0.0))


@pytest.mark.parametrize("count", [30, 31, 300])
def test_bias_and_correlation_equal_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    values = 0.3 + rng.standard_normal(count) * rng.choice([1.0, 10.0], count)
    table = table_of(
        *[innovation(k, [1.0], axes={"right": (3.0, 3.0), "up": (value, value)}) for k, value in enumerate(values)]
    )
    right, found = axis_statistics(table)
    assert (right.bias_sigma, right.correlation) == (3.0, 0.0)
    assert found.bias_sigma == np.median(values)
    spread = max(1.0, 1.4826 * float(np.median(np.abs(values - np.median(values)))))
    around = np.clip((values - np.median(values)) / spread, -3.0, 3.0)
    expected = np.sum(around[1:] * around[:-1]) / np.sum(around * around)
    assert found.correlation == pytest.approx(expected, rel=1e-12)


def test_axis_with_too_few_innovations_is_omitted() -> None:
    rare = [innovation(k, [1.0], axes={"right": (1.0, 1.0)}) for k in range(LEAST_COUNT - 1)]
    often = [innovation(100 + k, [1.0]) for k in range(LEAST_COUNT)]
    assert [axis.name for axis in axis_statistics(table_of(*rare, *often))] == ["up"]


def test_empty_table_has_no_factor() -> None:
    assert math.isnan(PartStatistics(InnovationTable()).factor)
    assert axis_statistics(InnovationTable()) == []

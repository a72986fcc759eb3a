"""Reduction of lines, gaps, and positions of labels."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from bokeh.document import Document

from ship_monitor.plots.curves import (
    StreamedLine,
    TimeAxis,
    gap_rows,
    label_positions,
    next_step,
    rows_to_draw,
    signed_text,
)
from ship_watch.history.history import points_after

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Sample:
    """A value with its time."""

    utc_ns: int
    value: float


def samples(rate_hz: float, length_s: float, start_s: float = 1000.0) -> list[Sample]:
    rng = np.random.default_rng(5)
    count = int(rate_hz * length_s)
    return [Sample(int((start_s + index / rate_hz) * 1e9), float(rng.normal())) for index in range(count)]


def rows(points):
    return {"value": np.array([point.value for point in points])}


def test_only_newer_points_are_returned() -> None:
    points = samples(2.0, 5.0)
    assert points_after(points, None) == points
    assert points_after(points, points[3].utc_ns) == points[4:]
    assert points_after(points, points[-1].utc_ns) == []


def test_each_second_keeps_its_minimum_and_maximum() -> None:
    points = samples(50.0, 20.0)
    time_ns = np.array([point.utc_ns for point in points])
    value = np.array([point.value for point in points])
    kept = rows_to_draw(time_ns, value)
    for second in range(1000, 1019):  # the last second is not over yet
        inside = value[time_ns // SECOND_NS == second]
        left = value[kept][time_ns[kept] // SECOND_NS == second]
        assert len(left) == 2
        assert {left.min(), left.max()} == {inside.min(), inside.max()}
    assert np.all(np.diff(time_ns[kept]) > 0)
    assert time_ns[kept][-1] // SECOND_NS == 1018


def test_nan_is_ignored_but_stays_a_gap() -> None:
    time_ns = np.arange(12) * SECOND_NS // 4
    value = np.array([np.nan, 1.0, -2.0, 0.5, np.nan, np.nan, np.nan, np.nan, 0.0, 0.0, 0.0, 0.0])
    assert list(rows_to_draw(time_ns, value)) == [1, 2, 4]


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 2.0, 20.0])
@pytest.mark.parametrize("batch_s", [0.5, 1.3, 700.0])
def test_line_does_not_depend_on_the_batches_and_is_bounded(rate_hz: float, batch_s: float) -> None:
    points = samples(rate_hz, 700.0)
    fed, whole = StreamedLine(("value",), by="value"), StreamedLine(("value",), by="value")
    whole.stream_new(points, rows)
    ends = {int(rate_hz * at_s) for at_s in np.arange(batch_s, 700.0, batch_s)} - {0}
    for end in [*sorted(ends), len(points)]:
        fed.stream_new(points[:end], rows)
    assert len(whole.source.data["t"]) <= 1200
    np.testing.assert_array_equal(fed.source.data["t"], whole.source.data["t"])
    np.testing.assert_array_equal(fed.source.data["value"], whole.source.data["value"])


def test_gap_stays_open_and_the_line_continues() -> None:
    points = [point for point in samples(1.0, 60.0) if not 1020 * SECOND_NS < point.utc_ns < 1030 * SECOND_NS]
    for ends in ([len(points)], range(1, len(points) + 1)):
        trail = StreamedLine(("value",), by="value")
        for end in ends:
            trail.stream_new(points[:end], rows)
        times, values = (np.asarray(trail.source.data[name]) for name in ("t", "value"))
        assert list(times[np.isnan(values)]) == [1_020_000.0 + 1.0, 1_030_000.0 - 1.0]
        assert len(times) == len(points) + 1  # all but the newest, and the two ends of the gap
        assert np.all(np.diff(times) > 0.0)


def test_area_is_closed_in_a_gap() -> None:
    points = [point for point in samples(1.0, 60.0) if not 1020 * SECOND_NS < point.utc_ns < 1030 * SECOND_NS]
    trail = StreamedLine(("value", "high"), by="value", filled=("high",))
    trail.stream_new(points, lambda new: {**rows(new), "high": np.full(len(new), 9.0)})
    times, high = (np.asarray(trail.source.data[name]) for name in ("t", "high"))
    assert list(times[high == 0.0]) == [1_020_001.0, 1_029_999.0]
    assert set(high) == {0.0, 9.0}


def test_restarted_data_are_drawn_again() -> None:
    trail = StreamedLine(("value",), by="value")
    trail.stream_new(samples(2.0, 30.0, start_s=5000.0), rows)
    earlier = samples(2.0, 10.0)
    trail.stream_new(earlier, rows)
    assert list(trail.source.data["t"]) == [point.utc_ns * 1e-6 for point in earlier[:-2]]
    trail.stream_new([], rows)
    assert list(trail.source.data["t"]) == []


def test_gap_is_three_periods_and_at_least_two_seconds() -> None:
    time_ns = np.array([0, 1, 4, 5, 15]) * SECOND_NS
    assert list(gap_rows(time_ns, None, 1.0 * SECOND_NS)) == [4]
    assert list(gap_rows(time_ns, None, 0.1 * SECOND_NS)) == [2, 4]
    assert list(gap_rows(time_ns + 9 * SECOND_NS, 0, 5.0 * SECOND_NS)) == []
    assert list(gap_rows(time_ns + 9 * SECOND_NS, 0, 2.0 * SECOND_NS)) == [0, 4]


def test_axes_have_fixed_steps() -> None:
    assert [next_step(size) for size in (0.0, 15.0, 15.1, 49.0, 1e6, float("nan"))] == [15, 15, 30, 60, 3600, 15]


@pytest.mark.parametrize("seed", range(20))
def test_labels_are_ordered_inside_and_do_not_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted = list(rng.uniform(-1.5, 1.5, rng.integers(1, 9)))
    places = label_positions(wanted, 0.25, -1.0, 1.0)
    assert all(-1.0 - 1e-12 <= place <= 1.0 + 1e-12 for place in places)
    ordered = [places[index] for index in np.argsort(wanted)]
    assert all(above - below >= 0.25 - 1e-9 for below, above in pairwise(ordered))


def test_labels_keep_their_positions_if_there_is_room() -> None:
    assert label_positions([0.5, -0.5], 0.3, -1.0, 1.0) == [0.5, -0.5]
    assert label_positions([0.0, 0.0, 0.0], 5.0, -1.0, 1.0) == pytest.approx([-1.0, 0.0, 1.0])
    assert label_positions([], 1.0, 0.0, 1.0) == []


def test_signed_numbers() -> None:
    assert [signed_text(value) for value in (48.93, -1.84, -0.04, float("nan"))] == ["+48.9", "−1.8", "+0.0", "unknown"]


def test_zoomed_time_axis_does_not_move() -> None:
    times = TimeAxis(600.0)
    Document().add_root(times.range)
    times.update(1_000 * SECOND_NS)
    assert (times.range.start, times.range.end) == (400e3, 1000e3)
    times.range.update(start=500e3, end=520e3)  # as a browser does after a drag
    assert times.is_paused
    times.update(1_100 * SECOND_NS)
    assert (times.range.start, times.range.end) == (500e3, 520e3)
    times.go_live()
    assert not times.is_paused
    assert (times.range.start, times.range.end) == (500e3, 1100e3)


def streamed_times_s(trail: StreamedLine, seconds: range) -> list[float]:
    """Return the times of a line in the browsers after streaming points, s."""
    points = [Sample(second * SECOND_NS, 0.0) for second in seconds]
    trail.stream_new(points, lambda some: {"value": np.array([point.value for point in some])})
    data = trail.source.data
    return [time / 1e3 for time, value in zip(data["t"], data["value"], strict=True) if value == 0.0]


def test_earlier_points_received_later_are_drawn() -> None:
    """The page of a bag shows the last minute first; then the ten minutes replace it, also after a change of time."""
    trail = StreamedLine(("value",), by="value")
    assert streamed_times_s(trail, range(540, 601)) == list(range(540, 600))
    assert streamed_times_s(trail, range(1, 601)) == list(range(1, 600))
    assert streamed_times_s(trail, range(841, 902)) == [*range(1, 600), *range(841, 901)]
    assert streamed_times_s(trail, range(301, 902)) == list(range(301, 901))
    assert streamed_times_s(trail, range(302, 903)) == list(range(301, 902))

"""Random processes, stamps and the start of a simulation."""

import numpy as np
import pytest

from ship_geometry.earth.time_scales import SECOND_NS
from ship_simulation.random_draws import (
    CorrelatedError,
    Draws,
    GaussMarkov,
    Stretch,
    arrival_times,
    random_stream,
    split_voyage,
)
from ship_simulation.scenario.scenario import start_time_ns
from ship_testing.consistency import sigma_ratio_band


def assert_sigma(values, sigma):
    """Check that the RMS of independent values matches a sigma, within the chi² band of 99.9 %."""
    low, high = sigma_ratio_band(values.size)
    assert low < np.sqrt(np.mean(values**2)) / sigma < high


def test_gauss_markov_is_stationary_from_the_start_with_its_correlation_time():
    count = 4000
    sigma, time_s = np.full(count, 5.0), np.full(count, 20.0)
    process = GaussMarkov(random_stream(1, "test"), 1.0, sigma, time_s).take(41)
    for index in (0, 1, 20, 40):
        assert_sigma(process[index], 5.0)
    # x(20 s) contains exp(-1) times x(0); the rest is independent of x(0).
    assert_sigma(process[20] - np.exp(-1.0) * process[0], 5.0 * np.sqrt(1.0 - np.exp(-2.0)))
    correlation = np.mean(process[20] * process[0]) / 25.0
    assert correlation == pytest.approx(np.exp(-1.0), abs=3.3 / np.sqrt(count))


def test_streams_follow_seed_and_name():
    draws = [random_stream(seed, name).standard_normal() for seed, name in ((1, "a"), (1, "a"), (1, "b"), (2, "a"))]
    assert draws[0] == draws[1]
    assert len(set(draws)) == 3


def test_arrivals_are_late_by_latency_and_a_uniform_part():
    stamp_ns = np.arange(1000) * SECOND_NS
    delay_s = (arrival_times(stamp_ns, 0.3, 0.2, random_stream(1, "test")) - stamp_ns) / SECOND_NS
    assert 0.3 <= delay_s.min() < 0.31
    assert 0.49 < delay_s.max() < 0.5


def test_stamps_of_a_rate_that_does_not_divide_the_second_do_not_drift():
    time_ns = Stretch(0, 1000.0).stamps(30.0, 0.01)
    assert time_ns[30_000 - 1] == 10_000_000 + round(29_999 * SECOND_NS / 30)
    assert time_ns.size == 30_000


@pytest.mark.parametrize(("rate_hz", "phase_s"), [(30.0, 0.01), (7.0, 0.0), (0.03, 12.0), (1.0, 0.5), (0.001, 0.0)])
def test_stretches_contain_each_stamp_once_and_identify_the_last(rate_hz, phase_s):
    whole = Stretch(5, 101.5).stamps(rate_hz, phase_s)
    parts = list(split_voyage(5, 101.5, 4))
    np.testing.assert_array_equal(np.concatenate([part.stamps(rate_hz, phase_s) for part in parts]), whole)
    assert len(whole) == parts[0].count(rate_hz, phase_s)
    holders = [part for part in parts if part.contains_last(rate_hz, phase_s)]
    assert [part.stamps(rate_hz, phase_s)[-1] for part in holders] == [whole[-1]]


def test_processes_and_streams_go_on_where_they_were_left():
    sigma, time_s = np.array([1.0, 3.0]), np.array([5.0, 50.0])
    whole = GaussMarkov(random_stream(1, "a"), 0.5, sigma, time_s).take(100)
    draws = Draws(1)
    parts = [draws.gauss_markov("a", count, 0.5, sigma, time_s) for count in (0, 1, 60, 0, 39)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    numbers = random_stream(1, "b").standard_normal(9000)
    assert draws.stream("b", after=5000).standard_normal() == numbers[5000]
    assert [draws.stream("b").standard_normal() for _ in range(3)] == numbers[:3].tolist()


def test_a_correlated_error_drops_no_part_that_is_still_requested():
    times_s = np.linspace(0.0, 400.0, 1001)
    whole = CorrelatedError(random_stream(1, "test"), 390.0, np.array([1.0, 2.0]), 6.0)
    dropping = CorrelatedError(random_stream(1, "test"), 390.0, np.array([1.0, 2.0]), 6.0)
    expected = whole.values_at(times_s)
    for first in range(0, 1001, 77):
        part = slice(first, first + 77)
        dropping.drop_before(times_s[first] - 1.0)
        np.testing.assert_array_equal(dropping.values_at(times_s[part]), expected[part])
    with pytest.raises(ValueError, match="dropped"):
        dropping.values_at(np.array([3.0]))


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("2014-07-09T11:50:07.8Z", 1_404_906_607_800_000_000),
        ("2014-07-09T11:50:07.000000001Z", 1_404_906_607_000_000_001),
    ],
)
def test_start_of(text, ns):
    assert start_time_ns(text) == ns


@pytest.mark.parametrize("text", ["2014-07-09T11:50:07.8", "2014-07-09", "11:50:07Z", "yesterday"])
def test_start_of_refuses_texts_that_are_no_utc_time(text):
    with pytest.raises(ValueError, match="expected YYYY-MM-DDThh:mm:ss"):
        start_time_ns(text)


def test_start_of_refuses_a_thirteenth_month():
    with pytest.raises(ValueError, match="month"):
        start_time_ns("2014-13-09T11:50:07Z")

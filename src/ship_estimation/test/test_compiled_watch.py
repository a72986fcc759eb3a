"""The compiled arithmetic of the INS's watch against the same in plain numpy, and one sample against many.

"Equal" is 1e-13 relative; what many samples give together is what each gives alone, to the last bit.
"""

import numpy as np
import pytest

from ship_estimation import compiled_watch
from ship_geometry.time_scales import SECOND_NS

COUNT = 50


def rates(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (ns) and rates (rad/s) of samples at about 100 Hz, the first one of the sample before."""
    times_ns = np.cumsum(rng.integers(5_000_000, 15_000_000, COUNT + 1))
    return times_ns, 0.1 * rng.standard_normal((COUNT + 1, 3))


def test_turns_are_the_means_of_two_rates_and_miss_what_numpy_says() -> None:
    rng = np.random.default_rng(1)
    (times_ns, rate), drift = rates(rng), 1e-5 * rng.standard_normal(3)
    turns, missed = compiled_watch.turns(times_ns[1:], rate[1:], times_ns[0], rate[0], 0.5, 2.0 * drift, SECOND_NS)
    seconds = np.diff(times_ns)[:, None] * 1e-9
    np.testing.assert_allclose(turns, seconds * (0.5 * (rate[1:] + rate[:-1]) - drift), rtol=1e-12)
    # A quarter of the change, and of the turn what the mean of two values misses of a wave of four seconds.
    share = (2.0 * np.pi * seconds / 4.0) ** 2 / 12.0
    change, mean = np.diff(rate, axis=0), 0.5 * (rate[1:] + rate[:-1])
    norms = 0.25 * np.linalg.norm(change, axis=1) + share[:, 0] * np.linalg.norm(mean, axis=1)
    np.testing.assert_allclose(missed, 0.5 + np.cumsum(seconds[:, 0] * norms), rtol=1e-13)


def test_each_turn_is_the_same_alone_and_among_others() -> None:
    rng = np.random.default_rng(2)
    (times_ns, rate), zero = rates(rng), np.zeros(3)
    turns, missed = compiled_watch.turns(times_ns[1:], rate[1:], times_ns[0], rate[0], 0.0, zero, SECOND_NS)
    so_far = 0.0
    for n in range(COUNT):
        one = slice(n + 1, n + 2)
        turn, now = compiled_watch.turns(times_ns[one], rate[one], times_ns[n], rate[n], so_far, zero, SECOND_NS)
        assert turn[0].tobytes() == turns[n].tobytes()
        assert now[0] == missed[n]
        so_far = float(now[0])


@pytest.mark.parametrize("fault", ["gap", "back", "nan"])
def test_from_what_is_not_joined_on_everything_is_missed(fault: str) -> None:
    times_ns, rate = rates(np.random.default_rng(3))
    if fault == "gap":
        times_ns[21:] += SECOND_NS
    elif fault == "back":
        times_ns[21] = times_ns[20]
    else:
        rate[21, 1] = np.nan
    _, missed = compiled_watch.turns(times_ns[1:], rate[1:], times_ns[0], rate[0], 0.0, np.zeros(3), SECOND_NS)
    assert np.isfinite(missed).tolist() == [True] * 20 + [False] * (COUNT - 20)


def test_sizes_of_steps_are_those_of_numpy_and_the_same_alone() -> None:
    rng = np.random.default_rng(4)
    weights, rows = rng.standard_normal((6, 30)), rng.standard_normal((30 + COUNT - 1, 3))
    sizes = compiled_watch.step_sizes(weights, rows, COUNT)
    steps = np.array([weights @ rows[n : n + 30] for n in range(COUNT)])
    np.testing.assert_allclose(sizes, np.sum(steps * steps, axis=2), rtol=1e-12)
    alone = [compiled_watch.step_sizes(weights, rows[n : n + 30], 1)[0] for n in range(COUNT)]
    assert np.array(alone).tobytes() == sizes.tobytes()


def test_arrays_that_do_not_fit_are_refused() -> None:
    times_ns, rate = rates(np.random.default_rng(5))
    with pytest.raises(ValueError, match="rates"):
        compiled_watch.turns(times_ns, rate[1:], 0, rate[0], 0.0, np.zeros(3), SECOND_NS)
    with pytest.raises(ValueError, match="rows"):
        compiled_watch.step_sizes(np.ones((2, 5)), np.ones((5, 3)), 2)
    with pytest.raises(ValueError, match="rates"):
        compiled_watch.missed_by_mean(np.zeros(2), np.zeros(3), 1.0)


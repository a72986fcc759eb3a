"""When a simulated bag tells the truth."""

import numpy as np

from ship_simulation.draws.noise import SECOND_NS

TRUTH_RATE_HZ = 10.0


def truth_index(time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    """The first sample in each tenth of a second, and the last of all, shape (m,)."""
    return _first_in_each(round(SECOND_NS / TRUTH_RATE_HZ), time_ns, start_ns)


def once_a_second(time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    """The first sample in each second, and the last of all, shape (m,)."""
    return _first_in_each(SECOND_NS, time_ns, start_ns)


def _first_in_each(period_ns: int, time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    first = np.flatnonzero(np.diff((time_ns - start_ns) // period_ns, prepend=-1))
    return np.union1d(first, time_ns.size - 1)

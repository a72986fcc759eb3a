# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The arithmetic of watching streams, an INS against its own rates, compiled: for one value, and for many of a block.

This is the one source of it. It is Python with C types for its numbers, compiled by Cython when the package is built.
What the functions compute is told where they are called, in :mod:`ship_estimation.integrated_rates`,
:mod:`ship_estimation.step_watch` and :mod:`ship_estimation.value_guards`; the same in plain numpy stands in the tests.
What a sample gives does not depend on how many others are given with it.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, M_PI, sqrt

_CHANGE_SHARE = cython.declare(cython.double, 0.25)
"""The mean of two rates may miss this share of their change, times the time between them."""
_SHORTEST_PERIOD_S = cython.declare(cython.double, 4.0)
"""Shortest period of a hull's motion, s.

The mean of two rates then misses at most (2 pi h / period)² / 12 of the turn.
"""
_TYPICAL = cython.declare(cython.double, 3.10)
"""What noise of three axes exceeds once in 6e10 times, in eighth roots of its mean eighth power, 945 sigma⁸."""
_MEMORY = cython.declare(cython.longlong, 1500)
"""The mean is one over so many steps."""
_LEARNT_ONE = cython.declare(cython.longlong, 64)
_LEARNT_ALL = cython.declare(cython.longlong, 250)
"""So many are learnt before a sample is judged by the line, and before means are."""
_UNKNOWN_RAD = cython.declare(cython.double, 10.0)
"""No step is as large: what is not known yet is not judged."""
SET_EVERY, FORGET = 8, 0.78
"""Bounds follow what was learnt so many times in between; of what integration feigned at most so much is left then."""


@cython.cfunc
@cython.exceptval(check=False)
def _missed(first: cython.p_double, second: cython.p_double, seconds: cython.double) -> cython.double:
    """What the mean of two rates may miss of the turn between them."""
    change: cython.double = 0.0
    twice_mean: cython.double = 0.0
    phase: cython.double = 2.0 * M_PI * seconds / _SHORTEST_PERIOD_S
    i: cython.int
    for i in range(3):
        change += (second[i] - first[i]) * (second[i] - first[i])
        twice_mean += (second[i] + first[i]) * (second[i] + first[i])
    return seconds * (_CHANGE_SHARE * sqrt(change) + phase * phase / 12.0 * 0.5 * sqrt(twice_mean))


def missed_by_mean(
    first: cython.const[cython.double][:], second: cython.const[cython.double][:], seconds: cython.double
):
    """What the mean of two rates (rad/s, shape (3,)) may miss of the turn between them, rad."""
    check("rates", first.shape[0] == second.shape[0] == 3)
    one = cython.declare(cython.double[3])
    other = cython.declare(cython.double[3])
    i: cython.int
    for i in range(3):
        one[i], other[i] = first[i], second[i]
    return _missed(one, other, seconds)


def turns(
    times_ns: cython.const[cython.longlong][:],
    rates: cython.const[cython.double][:, :],
    last_ns: cython.longlong,
    last_rate: cython.const[cython.double][:],
    missed_rad: cython.double,
    twice_drift: cython.const[cython.double][:],
    longest_ns: cython.longlong,
):
    """How far N rates turn the attitude, each from the sample before: by the mean of both, less the drift.

    Args:
        times_ns: stamps of the samples, shape (N,).
        rates: angular velocities, rad/s, shape (N, 3).
        last_ns: stamp of the sample before them.
        last_rate: its rate, shape (3,).
        missed_rad: what the integration may have missed up to it.
        twice_drift: twice what is taken out of each rate, rad/s, shape (3,).
        longest_ns: rates that are further apart are not joined.

    Returns:
        Rotation vectors about the axes of the deck, rad, shape (N, 3), and what the integration may have missed up to
        each sample, shape (N,). From the first one on that is not joined, or no number, that is infinite.
    """
    count: cython.Py_ssize_t = times_ns.shape[0]
    check("rates", rates.shape[0] == count and rates.shape[1] == last_rate.shape[0] == twice_drift.shape[0] == 3)
    of_turns, of_missed = np.empty((count, 3)), np.empty(count)
    turn: cython.double[:, ::1] = of_turns
    missed: cython.double[::1] = of_missed
    first = cython.declare(cython.double[3])
    second = cython.declare(cython.double[3])
    step_ns: cython.longlong
    n: cython.Py_ssize_t
    i: cython.int
    for i in range(3):
        first[i] = last_rate[i]
    for n in range(count):
        step_ns = times_ns[n] - last_ns
        for i in range(3):
            second[i] = rates[n, i]
            turn[n, i] = 0.5e-9 * step_ns * (first[i] + second[i] - twice_drift[i])
        missed_rad += _missed(first, second, step_ns * 1e-9)
        if not (0 < step_ns <= longest_ns and missed_rad < INFINITY):
            missed_rad = INFINITY
        missed[n], last_ns = missed_rad, times_ns[n]
        for i in range(3):
            first[i] = second[i]
    return of_turns, of_missed


@cython.cfunc
@cython.exceptval(check=False)
def _sizes_of_steps(
    weights: cython.const[cython.double][:, :],
    rows: cython.const[cython.double][:, :],
    first: cython.Py_ssize_t,
    sizes: cython.double[:],
) -> cython.void:
    """Squares of the steps in the window over the rows from a first one on, one for each of k places."""
    x: cython.double
    y: cython.double
    z: cython.double
    p: cython.Py_ssize_t
    m: cython.Py_ssize_t
    for p in range(weights.shape[0]):
        x = y = z = 0.0
        for m in range(weights.shape[1]):
            x += weights[p, m] * rows[first + m, 0]
            y += weights[p, m] * rows[first + m, 1]
            z += weights[p, m] * rows[first + m, 2]
        sizes[p] = x * x + y * y + z * z


def step_sizes(weights: cython.const[cython.double][:, :], rows: cython.const[cython.double][:, :]):
    """Squares of the steps in a window over rows.

    Args:
        weights: of the rows, oldest first, for each of k places of a step, shape (k, length).
        rows: shape (length, 3).

    Returns:
        Shape (k,).
    """
    check("rows", rows.shape[0] == weights.shape[1] and rows.shape[1] == 3)
    of_sizes = np.empty(weights.shape[0])
    sizes: cython.double[:] = of_sizes
    _sizes_of_steps(weights, rows, 0, sizes)
    return of_sizes


@cython.cfunc
@cython.exceptval(check=False)
def _judged(learns: cython.longlong, first_rad: cython.double) -> cython.bint:
    """Whether a sample is judged by its own step."""
    return learns >= _LEARNT_ONE or first_rad < INFINITY


@cython.cfunc
@cython.exceptval(check=False)
def _set(
    weights: cython.const[cython.double][:, :],
    least_rad: cython.const[cython.double][:],
    shares: cython.const[cython.double][:],
    high: cython.const[cython.double][:],
    learns: cython.longlong,
    coarse_rad: cython.double,
    feigned_rad: cython.double,
    first_rad: cython.double,
    bounds: cython.double[:],
    scaled: cython.double[:, :],
) -> cython.void:
    """See :func:`set_bounds`."""
    bound: cython.double
    learnt: cython.double
    p: cython.Py_ssize_t
    m: cython.Py_ssize_t
    for p in range(weights.shape[0]):
        learnt = _TYPICAL * sqrt(sqrt(sqrt(high[p]))) * shares[p]
        bound = least_rad[p]
        # Written so that NaN stays.
        if not learnt <= bound:
            bound = learnt
        bound += coarse_rad + feigned_rad
        # An infinite one stays out: a step over it is zero, and nothing could be learnt from that.
        if p == 0 and learns < _LEARNT_ONE and bound < first_rad < INFINITY:
            bound = first_rad
        if learns < _LEARNT_ALL and not (p == 0 and _judged(learns, first_rad)):
            bound += _UNKNOWN_RAD
        bounds[p] = bound
        for m in range(weights.shape[1]):
            scaled[p, m] = weights[p, m] / bound


def set_bounds(
    weights: cython.const[cython.double][:, :],
    least_rad: cython.const[cython.double][:],
    shares: cython.const[cython.double][:],
    high: cython.const[cython.double][:],
    learns: cython.longlong,
    coarse_rad: cython.double,
    feigned_rad: cython.double,
    first_rad: cython.double,
    bounds: cython.double[:],
    scaled: cython.double[:, :],
):
    """The largest steps that errors of good samples feign.

    Args:
        weights: of the rows of a window, for each of k places of a step, shape (k, length).
        least_rad: the bounds by the noise that is configured, shape (k,).
        shares: of the bounds that the steps learnt make, shape (k,).
        high: means of the fourth powers of the steps' squares, shape (k,) or longer.
        learns: how many steps they are means of.
        coarse_rad: what rounding adds.
        feigned_rad: what integration adds.
        first_rad: how far a sample may be from the line as long as too few steps are learnt; infinite where it is not
            judged then.
        bounds: is set, rad, shape (k,).
        scaled: is set to the weights over the bounds, shape (k, length).

    Returns:
        Whether samples are judged.
    """
    places: cython.Py_ssize_t = weights.shape[0]
    check("bounds", least_rad.shape[0] == shares.shape[0] == bounds.shape[0] == places and high.shape[0] >= places)
    check("scaled", scaled.shape[0] == places and scaled.shape[1] == weights.shape[1])
    _set(weights, least_rad, shares, high, learns, coarse_rad, feigned_rad, first_rad, bounds, scaled)
    return bool(_judged(learns, first_rad))


@cython.cfunc
@cython.exceptval(check=False)
def _learn(
    sizes: cython.const[cython.double][:],
    bounds: cython.const[cython.double][:],
    learns: cython.longlong,
    high: cython.double[:],
) -> cython.void:
    """See :func:`learn`."""
    square: cython.double
    p: cython.Py_ssize_t
    for p in range(sizes.shape[0]):
        square = sizes[p] * bounds[p] * bounds[p]
        square *= square
        high[p] += (square * square - high[p]) / min(learns, _MEMORY)


def learn(
    sizes: cython.const[cython.double][:],
    bounds: cython.const[cython.double][:],
    learns: cython.longlong,
    high: cython.double[:],
):
    """Learn how large the steps are that no sample made.

    Args:
        sizes: squares of steps over their bounds, shape (k,).
        bounds: rad, shape (k,).
        learns: which ones these are, the first are 1.
        high: means of the fourth powers of the steps' squares, are changed, shape (k,).
    """
    check("sizes", sizes.shape[0] == bounds.shape[0] == high.shape[0])
    _learn(sizes, bounds, learns, high)


def followed(
    times_ns: cython.const[cython.longlong][:],
    rows: cython.const[cython.double][:, :],
    missed_rad: cython.const[cython.double][:],
    end: cython.Py_ssize_t,
    last_ns: cython.longlong,
    longest_ns: cython.longlong,
    last_missed_rad: cython.double,
    last_feigned_rad: cython.double,
    feigned_rad: cython.double,
    weights: cython.const[cython.double][:, :],
    least_rad: cython.const[cython.double][:],
    shares: cython.const[cython.double][:],
    coarse_rad: cython.double,
    first_rad: cython.double,
    learn_every: cython.longlong,
    since_learnt: cython.longlong,
    learns: cython.longlong,
    kept: cython.double[:, :],
    high: cython.double[:],
    bounds: cython.double[:],
    scaled: cython.double[:, :],
):
    """Take samples, from the first one on, that lie on the line of those kept, and learn from them.

    Args:
        times_ns: stamps of the samples, shape (N,).
        rows: the samples, shape (N, 3), rad.
        missed_rad: what the integration may have missed up to each, shape (N,).
        end: how many are kept.
        last_ns: stamp of the last of them.
        longest_ns: over more than that the line does not lead.
        last_missed_rad: what the integration may have missed up to it.
        last_feigned_rad: in the last step alone.
        feigned_rad: what the bounds hold of that.
        weights: and the next four, and ``high`` to ``scaled``, as of :func:`set_bounds`.
        least_rad: rad.
        shares: of what is learnt.
        coarse_rad: rad.
        first_rad: rad.
        learn_every: of so many samples one is learnt from.
        since_learnt: how many were kept since.
        learns: how many were learnt from.
        kept: their rows; those taken are written behind them, shape (room, 3).
        high: is changed.
        bounds: is changed.
        scaled: is changed.

    Returns:
        How many are taken; then what is the state after the last of them: the squares of its steps over their bounds,
        shape (k,), ``last_feigned_rad``, ``feigned_rad``, ``since_learnt``, ``learns``.
    """
    places: cython.Py_ssize_t = weights.shape[0]
    length: cython.Py_ssize_t = weights.shape[1]
    samples: cython.Py_ssize_t = min(rows.shape[0], kept.shape[0] - end)
    check("rows", times_ns.shape[0] == missed_rad.shape[0] == rows.shape[0] and rows.shape[1] == kept.shape[1] == 3)
    check("kept", length - 1 <= end <= kept.shape[0] and learn_every > 0)
    check("bounds", least_rad.shape[0] == shares.shape[0] == high.shape[0] == bounds.shape[0] == places)
    check("scaled", scaled.shape[0] == places and scaled.shape[1] == length)
    of_sizes = np.empty((2, places))
    sizes: cython.double[:, :] = of_sizes
    step_rad: cython.double
    on_line: cython.bint
    taken: cython.Py_ssize_t = 0
    p: cython.Py_ssize_t
    i: cython.int
    while taken < samples:
        step_rad = missed_rad[taken] - last_missed_rad
        # Written so that NaN ends it.
        if not times_ns[taken] - last_ns <= longest_ns:
            break
        if not abs(step_rad - last_feigned_rad) <= feigned_rad:
            feigned_rad = 1.5 * abs(step_rad - last_feigned_rad)
            _set(weights, least_rad, shares, high, learns, coarse_rad, feigned_rad, first_rad, bounds, scaled)
        for i in range(3):
            kept[end + taken, i] = rows[taken, i]
        _sizes_of_steps(scaled, kept, end + taken + 1 - length, sizes[taken & 1])
        on_line = True
        for p in range(places):
            on_line = on_line and sizes[taken & 1, p] <= 1.0
        if not on_line:
            break
        last_ns, last_missed_rad, last_feigned_rad = times_ns[taken], missed_rad[taken], step_rad
        since_learnt += 1
        if since_learnt >= learn_every:
            since_learnt, learns = 0, learns + 1
            _learn(sizes[taken & 1], bounds, learns, high)
            if learns % SET_EVERY == 0:
                feigned_rad *= FORGET
                _set(weights, least_rad, shares, high, learns, coarse_rad, feigned_rad, first_rad, bounds, scaled)
        taken += 1
    return taken, of_sizes[(taken - 1) & 1], last_feigned_rad, feigned_rad, since_learnt, learns


def changes(before: cython.const[cython.double][:, :], values: cython.const[cython.double][:, :, :]):
    """How far each of N values is from the one before it: the largest length of a row's change, a list.

    Args:
        before: the value before the first one, shape (k, l).
        values: shape (N, k, l).
    """
    check("values", values.shape[1] == before.shape[0] and values.shape[2] == before.shape[1])
    largest: cython.double
    square: cython.double
    change: cython.double
    n: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    found = []
    for n in range(values.shape[0]):
        largest = 0.0
        for i in range(values.shape[1]):
            square = 0.0
            for j in range(values.shape[2]):
                change = values[n, i, j] - (values[n - 1, i, j] if n else before[i, j])
                square += change * change
            # What is no number stays none.
            if not square <= largest and largest == largest:
                largest = square
        found.append(sqrt(largest))
    return found

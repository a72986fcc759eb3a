# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled checks of single values and of blocks of values of a stream, for example of an INS against its own rates.

The functions are described where they are called, in the modules of :mod:`ship_estimation.plausibility`. The result
for a sample does not depend on the number of samples in a call.
"""

import cython
import numpy as np

from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, M_PI, sqrt

_CHANGE_SHARE = cython.declare(cython.double, 0.25)
"""Bound of the integration error of two rates, as a share of the product of their change and their time difference."""
_SHORTEST_PERIOD_S = cython.declare(cython.double, 4.0)
"""Shortest period of a hull's motion, s.

The integration error of the mean of two rates, h seconds apart, is then at most (2 pi h / period)² / 12 of the
rotation.
"""
_TYPICAL = cython.declare(cython.double, 3.10)
"""Length that the noise of three axes exceeds once in 6e10 times. Its unit is the eighth root of the mean eighth power
of the length, and this mean is 945 sigma⁸."""
_MEMORY = cython.declare(cython.longlong, 1500)
"""Number of steps over which the mean eighth power is taken."""
_SAMPLES_FOR_ONE = cython.declare(cython.longlong, 64)
_SAMPLES_FOR_MEANS = cython.declare(cython.longlong, 250)
"""Least numbers of steps in the statistics: for checks of single samples against the line, and for checks of means."""
_NO_BOUND_RAD = cython.declare(cython.double, 10.0)
"""Bound without statistics, rad, larger than any step."""
SET_EVERY, FORGET = 8, 0.78
"""Number of updates of the statistics between two updates of the bounds, and decay factor of the apparent step at each
update of the bounds."""


@cython.cfunc
@cython.exceptval(check=False)
def _mean_rate_error(first: cython.p_double, second: cython.p_double, seconds: cython.double) -> cython.double:
    """Return the bound of the integration error by the mean of two rates, rad."""
    change: cython.double = 0.0
    twice_mean: cython.double = 0.0
    phase: cython.double = 2.0 * M_PI * seconds / _SHORTEST_PERIOD_S
    for i in range(3):
        change += (second[i] - first[i]) * (second[i] - first[i])
        twice_mean += (second[i] + first[i]) * (second[i] + first[i])
    return seconds * (_CHANGE_SHARE * sqrt(change) + phase * phase / 12.0 * 0.5 * sqrt(twice_mean))


def mean_rate_error(
    first: cython.const[cython.double][:], second: cython.const[cython.double][:], seconds: cython.double
):
    """Return the bound of the integration error by the mean of two rates (rad/s, shape (3,)), rad."""
    check("rates", first.shape[0] == second.shape[0] == 3)
    one = cython.declare(cython.double[3])
    other = cython.declare(cython.double[3])
    for i in range(3):
        one[i], other[i] = first[i], second[i]
    return _mean_rate_error(one, other, seconds)


def rotation_steps(
    times_ns: cython.const[cython.longlong][:],
    rates: cython.const[cython.double][:, :],
    last_ns: cython.longlong,
    last_rate: cython.const[cython.double][:],
    error_rad: cython.double,
    twice_drift: cython.const[cython.double][:],
    longest_ns: cython.longlong,
):
    """Return the rotation from the sample before to each of N samples, by the mean of both rates minus the drift.

    Args:
        times_ns: stamps of the samples, shape (N,).
        rates: angular velocities, rad/s, shape (N, 3).
        last_ns: stamp of the sample before the first sample.
        last_rate: rate of the sample before the first sample, rad/s, shape (3,).
        error_rad: bound of the integration error up to the sample before the first sample.
        twice_drift: twice the drift of the rates, rad/s, shape (3,).
        longest_ns: maximum interval between two rates.

    Returns:
        Rotation vectors about the axes of the deck, rad, shape (N, 3), and bounds of the integration error up to each
        sample, rad, shape (N,). A gap, a stamp that is not later, or a rate that is not finite makes the bound at this
        sample and all later bounds infinite.
    """
    count: cython.Py_ssize_t = times_ns.shape[0]
    check("rates", rates.shape[0] == count and rates.shape[1] == last_rate.shape[0] == twice_drift.shape[0] == 3)
    of_turns, of_missed = np.empty((count, 3)), np.empty(count)
    turn: cython.double[:, ::1] = of_turns
    missed: cython.double[::1] = of_missed
    first = cython.declare(cython.double[3])
    second = cython.declare(cython.double[3])
    step_ns: cython.longlong
    for i in range(3):
        first[i] = last_rate[i]
    for n in range(count):
        step_ns = times_ns[n] - last_ns
        for i in range(3):
            second[i] = rates[n, i]
            turn[n, i] = 0.5e-9 * step_ns * (first[i] + second[i] - twice_drift[i])
        error_rad += _mean_rate_error(first, second, step_ns * 1e-9)
        if not (0 < step_ns <= longest_ns and error_rad < INFINITY):
            error_rad = INFINITY
        missed[n], last_ns = error_rad, times_ns[n]
        for i in range(3):
            first[i] = second[i]
    return of_turns, of_missed


@cython.cfunc
@cython.exceptval(check=False)
def _step_sizes(
    weights: cython.const[cython.double][:, :],
    rows: cython.const[cython.double][:, :],
    first: cython.Py_ssize_t,
    sizes: cython.double[:],
) -> cython.void:
    """Write the squared steps in a window of rows, one for each of k positions."""
    x: cython.double
    y: cython.double
    z: cython.double
    for p in range(weights.shape[0]):
        x = y = z = 0.0
        for m in range(weights.shape[1]):
            x += weights[p, m] * rows[first + m, 0]
            y += weights[p, m] * rows[first + m, 1]
            z += weights[p, m] * rows[first + m, 2]
        sizes[p] = x * x + y * y + z * z


def step_sizes(weights: cython.const[cython.double][:, :], rows: cython.const[cython.double][:, :]):
    """Return the squared steps in a window of rows.

    Args:
        weights: weights of the rows, oldest first, for each of k positions of a step, shape (k, length).
        rows: window of rows, shape (length, 3).

    Returns:
        Squared step at each position, shape (k,).
    """
    check("rows", rows.shape[0] == weights.shape[1] and rows.shape[1] == 3)
    of_sizes = np.empty(weights.shape[0])
    sizes: cython.double[:] = of_sizes
    _step_sizes(weights, rows, 0, sizes)
    return of_sizes


@cython.cfunc
@cython.exceptval(check=False)
def _is_checked(learns: cython.longlong, first_rad: cython.double) -> cython.bint:
    """True if a single sample is checked by the step that it alone shows."""
    return learns >= _SAMPLES_FOR_ONE or first_rad < INFINITY


@cython.ccall
def set_bounds(
    weights: cython.const[cython.double][:, :],
    least_rad: cython.const[cython.double][:],
    shares: cython.const[cython.double][:],
    high: cython.const[cython.double][:],
    learns: cython.longlong,
    coarse_rad: cython.double,
    apparent_step_rad: cython.double,
    first_rad: cython.double,
    bounds: cython.double[:],
    scaled: cython.double[:, :],
) -> cython.bint:
    """Set the bounds of the apparent steps that the errors of good samples cause.

    Args:
        weights: weights of the rows of a window, for each of k positions of a step, shape (k, length).
        least_rad: bounds due to the configured noise, shape (k,).
        shares: factors of the bounds from the statistics, shape (k,).
        high: means of the fourth powers of the squared steps, shape (k,) or longer.
        learns: number of steps in these means.
        coarse_rad: part of the bound due to rounding.
        apparent_step_rad: part of the bound due to integration errors.
        first_rad: bound of a single sample while the statistics are unknown; infinite if single samples are not checked
            during this time.
        bounds: output, bounds of the steps, rad, shape (k,).
        scaled: output, ratio of weights to bounds, shape (k, length).

    Returns:
        True if single samples are checked.
    """
    places: cython.Py_ssize_t = weights.shape[0]
    check("bounds", least_rad.shape[0] == shares.shape[0] == bounds.shape[0] == places and high.shape[0] >= places)
    check("scaled", scaled.shape[0] == places and scaled.shape[1] == weights.shape[1])
    bound: cython.double
    learnt: cython.double
    for p in range(places):
        learnt = _TYPICAL * sqrt(sqrt(sqrt(high[p]))) * shares[p]
        bound = least_rad[p]
        # A bound of NaN stays NaN.
        if not learnt <= bound:
            bound = learnt
        bound += coarse_rad + apparent_step_rad
        # An infinite bound is not used, because the ratio of a step to this bound would be zero in the statistics.
        if p == 0 and learns < _SAMPLES_FOR_ONE and bound < first_rad < INFINITY:
            bound = first_rad
        if learns < _SAMPLES_FOR_MEANS and not (p == 0 and _is_checked(learns, first_rad)):
            bound += _NO_BOUND_RAD
        bounds[p] = bound
        for m in range(weights.shape[1]):
            scaled[p, m] = weights[p, m] / bound
    return _is_checked(learns, first_rad)


@cython.cfunc
@cython.exceptval(check=False)
def _learn(
    sizes: cython.const[cython.double][:],
    bounds: cython.const[cython.double][:],
    learns: cython.longlong,
    high: cython.double[:],
) -> cython.void:
    """Update the statistics; arguments as for :func:`learn`."""
    square: cython.double
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
    """Update the statistics of apparent steps.

    Args:
        sizes: squared ratios of the steps to their bounds, shape (k,).
        bounds: bounds of the steps, rad, shape (k,).
        learns: number of this update, from 1.
        high: means of the fourth powers of the squared steps, changed in place, shape (k,).
    """
    check("sizes", sizes.shape[0] == bounds.shape[0] == high.shape[0])
    _learn(sizes, bounds, learns, high)


def accepted_on_line(
    times_ns: cython.const[cython.longlong][:],
    rows: cython.const[cython.double][:, :],
    error_rad: cython.const[cython.double][:],
    end: cython.Py_ssize_t,
    last_ns: cython.longlong,
    longest_ns: cython.longlong,
    last_error_rad: cython.double,
    last_apparent_step_rad: cython.double,
    apparent_step_rad: cython.double,
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
    """Accept the leading samples that are on the line of the kept samples, and update the statistics.

    Args:
        times_ns: stamps of the samples, shape (N,).
        rows: the samples, shape (N, 3), rad.
        error_rad: bound of the integration error up to each sample, shape (N,).
        end: number of kept samples.
        last_ns: stamp of the last kept sample.
        longest_ns: maximum gap that the line spans.
        last_error_rad: bound of the integration error up to the last kept sample.
        last_apparent_step_rad: growth of the bound of the integration error in the last step.
        apparent_step_rad: part of the step bounds due to a change of this growth.
        weights: as for :func:`set_bounds`.
        least_rad: as for :func:`set_bounds`.
        shares: as for :func:`set_bounds`.
        coarse_rad: as for :func:`set_bounds`.
        first_rad: as for :func:`set_bounds`.
        learn_every: number of samples for one update of the statistics.
        since_learnt: number of samples since the last update.
        learns: number of updates.
        kept: rows of the kept samples; accepted samples are appended, shape (room, 3).
        high: as for :func:`set_bounds`, changed in place.
        bounds: as for :func:`set_bounds`, changed in place.
        scaled: as for :func:`set_bounds`, changed in place.

    Returns:
        Number of accepted samples, and the state after the last of them. The state is the squared ratios of the steps
        to their bounds, shape (k,), ``last_apparent_step_rad``, ``apparent_step_rad``, ``since_learnt`` and ``learns``.
    """
    places: cython.Py_ssize_t = weights.shape[0]
    length: cython.Py_ssize_t = weights.shape[1]
    samples: cython.Py_ssize_t = min(rows.shape[0], kept.shape[0] - end)
    check("rows", times_ns.shape[0] == error_rad.shape[0] == rows.shape[0] and rows.shape[1] == kept.shape[1] == 3)
    check("kept", length - 1 <= end <= kept.shape[0] and learn_every > 0)
    check("bounds", least_rad.shape[0] == shares.shape[0] == high.shape[0] == bounds.shape[0] == places)
    check("scaled", scaled.shape[0] == places and scaled.shape[1] == length)
    of_sizes = np.empty((2, places))
    sizes: cython.double[:, :] = of_sizes
    step_rad: cython.double
    on_line: cython.bint
    taken: cython.Py_ssize_t = 0
    while taken < samples:
        step_rad = error_rad[taken] - last_error_rad
        # NaN ends the loop.
        if not times_ns[taken] - last_ns <= longest_ns:
            break
        if not abs(step_rad - last_apparent_step_rad) <= apparent_step_rad:
            apparent_step_rad = 1.5 * abs(step_rad - last_apparent_step_rad)
            set_bounds(
                weights, least_rad, shares, high, learns, coarse_rad, apparent_step_rad, first_rad, bounds, scaled
            )
        for i in range(3):
            kept[end + taken, i] = rows[taken, i]
        _step_sizes(scaled, kept, end + taken + 1 - length, sizes[taken & 1])
        on_line = True
        for p in range(places):
            on_line = on_line and sizes[taken & 1, p] <= 1.0
        if not on_line:
            break
        last_ns, last_error_rad, last_apparent_step_rad = times_ns[taken], error_rad[taken], step_rad
        since_learnt += 1
        if since_learnt >= learn_every:
            since_learnt, learns = 0, learns + 1
            _learn(sizes[taken & 1], bounds, learns, high)
            if learns % SET_EVERY == 0:
                apparent_step_rad *= FORGET
                set_bounds(
                    weights, least_rad, shares, high, learns, coarse_rad, apparent_step_rad, first_rad, bounds, scaled
                )
        taken += 1
    return taken, of_sizes[(taken - 1) & 1], last_apparent_step_rad, apparent_step_rad, since_learnt, learns


def changes(before: cython.const[cython.double][:, :], values: cython.const[cython.double][:, :, :]):
    """Return the changes of N values, each from the value before: the largest length of the differences of the rows.

    Args:
        before: value before the first value, shape (k, l).
        values: the values, shape (N, k, l).
    """
    check("values", values.shape[1] == before.shape[0] and values.shape[2] == before.shape[1])
    largest: cython.double
    square: cython.double
    change: cython.double
    found = []
    for n in range(values.shape[0]):
        largest = 0.0
        for i in range(values.shape[1]):
            square = 0.0
            for j in range(values.shape[2]):
                change = values[n, i, j] - (values[n - 1, i, j] if n else before[i, j])
                square += change * change
            # A change of NaN stays NaN.
            if not square <= largest and largest == largest:
                largest = square
        found.append(sqrt(largest))
    return found

# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The arithmetic of watching an INS against its own rates, compiled: for one sample, and for the many of a block.

This is the one source of it. It is Python with C types for its numbers, compiled by Cython when the package is built.
What the functions compute is told where they are called, in :mod:`ship_estimation.integrated_rates`; the same in plain
numpy stands in the tests. What a sample gives does not depend on how many others are given with it.
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


def step_sizes(
    weights: cython.const[cython.double][:, :], rows: cython.const[cython.double][:, :], count: cython.Py_ssize_t
):
    """Squares of the steps in N windows over rows that end one after another with the last rows.

    Args:
        weights: of the rows of a window, oldest first, for each of k places of a step, shape (k, length).
        rows: shape (length + N - 1, 3).
        count: N.

    Returns:
        Shape (N, k).
    """
    places: cython.Py_ssize_t = weights.shape[0]
    length: cython.Py_ssize_t = weights.shape[1]
    check("rows", count >= 0 and rows.shape[0] == length + count - 1 and rows.shape[1] == 3)
    of_sizes = np.empty((count, places))
    sizes: cython.double[:, ::1] = of_sizes
    x: cython.double
    y: cython.double
    z: cython.double
    n: cython.Py_ssize_t
    p: cython.Py_ssize_t
    m: cython.Py_ssize_t
    for n in range(count):
        for p in range(places):
            x = y = z = 0.0
            for m in range(length):
                x += weights[p, m] * rows[n + m, 0]
                y += weights[p, m] * rows[n + m, 1]
                z += weights[p, m] * rows[n + m, 2]
            sizes[n, p] = x * x + y * y + z * z
    return of_sizes

# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The arithmetic of integrity, compiled: protection levels of an output, and what those told last cover.

This is the one source of it. It is Python with C types for its numbers, compiled by Cython when the package is built.
What the functions compute is told where they are called, in :mod:`ship_estimation.protection` and
:mod:`ship_estimation.told_levels`; the same in plain numpy stands in the tests. What is no number makes what rests on
it no number.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, fabs, sqrt
from cython.cimports.ship_estimation.compiled_steps import _diagonalise, _larger


@cython.cfunc
@cython.exceptval(check=False)
def _form(
    left: cython.const[cython.double][:],
    matrix: cython.const[cython.double][:, :],
    right: cython.const[cython.double][:],
) -> cython.double:
    """leftᵀ matrix right."""
    total: cython.double = 0.0
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(left.shape[0]):
        for j in range(right.shape[0]):
            total += left[i] * matrix[i, j] * right[j]
    return total


def separation(
    states: cython.const[cython.Py_ssize_t][:],
    to_components: cython.const[cython.double][:, :],
    by_states: cython.const[cython.double][:, :],
    covariance: cython.const[cython.double][:, :],
    mean: cython.const[cython.double][:],
    means: cython.const[cython.double][:, :],
    parts: cython.const[cython.double][:, :, :],
    left_out: cython.const[cython.double][:, :, :],
    rows: cython.const[cython.Py_ssize_t][:],
    right: cython.double,
    false_exclusion: cython.double,
    missed: cython.const[cython.double][:],
    share: cython.double,
    tiny: cython.double,
):
    """The fields of :class:`ship_estimation.protection.Separation`, by the hypotheses in question.

    Args:
        states: that make the components, shape (n,).
        to_components: of the errors of the output, shape (3, 3).
        by_states: of these states, shape (3, n).
        covariance: of the errors of the output, by all sources, shape (3, 3).
        mean: of all states by all sources, shape (m,).
        means: without some, shape (h, m).
        parts: whose sum is the covariance of all states by all sources, shape (p, m, m).
        left_out: that without some, shape (h, m, m).
        rows: in question.
        right: and the next two: numbers of sigmas, as :class:`ship_estimation.protection.Factors` has them.
        false_exclusion: of a separation.
        missed: shape (h,).
        share: of the variance by all sources, that a distance has at least.
        tiny: least variance of a distance.
    """
    n: cython.Py_ssize_t = states.shape[0]
    m: cython.Py_ssize_t = mean.shape[0]
    hypotheses: cython.Py_ssize_t = means.shape[0]
    asked: cython.Py_ssize_t = rows.shape[0]
    check("components", to_components.shape[0] == to_components.shape[1] == by_states.shape[0] == 3)
    check("covariance", covariance.shape[0] == covariance.shape[1] == 3 and by_states.shape[1] == n)
    check("means", means.shape[1] == parts.shape[1] == parts.shape[2] == m and left_out.shape[0] == hypotheses)
    check("left_out", left_out.shape[1] == left_out.shape[2] == m and missed.shape[0] == hypotheses)
    of_statistic, of_level = np.empty(asked), np.empty(3)
    statistic: cython.double[::1] = of_statistic
    level: cython.double[::1] = of_level
    # Of the states by all sources, and what it grows by without some.
    covariances: cython.double[:, :, ::1] = np.zeros((2, n, n))
    variance_0 = cython.declare(cython.double[3])
    dominant: cython.Py_ssize_t = -1
    largest: cython.double = 0.0
    widest: cython.double = 0.0
    of_row: cython.double
    distance: cython.double
    grown: cython.double
    sigma: cython.double
    value: cython.double
    k: cython.Py_ssize_t
    row: cython.Py_ssize_t
    part: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(n):
        check("states", 0 <= states[i] < m)
    for i in range(3):
        variance_0[i] = _form(to_components[i], covariance, to_components[i])
        level[i] = right * sqrt(variance_0[i])
        largest = _larger(largest, level[i])
    for part in range(parts.shape[0]):
        for i in range(n):
            for j in range(n):
                covariances[0, i, j] += parts[part, states[i], states[j]]
    for k in range(asked):
        row = rows[k]
        check("rows", 0 <= row < hypotheses)
        for i in range(n):
            widest = _larger(widest, left_out[row, states[i], states[i]])
            for j in range(n):
                covariances[1, i, j] = left_out[row, states[i], states[j]] - covariances[0, i, j]
        of_row = statistic[k] = 0.0
        for i in range(3):
            distance = 0.0
            for j in range(n):
                distance += by_states[i, j] * (means[row, states[j]] - mean[states[j]])
            # What an output adds to the error of the states is the same in every estimate. Without a source nothing is
            # known better, but for one that was refused with it and is used without.
            grown = _larger(variance_0[i] + _form(by_states[i], covariances[1], by_states[i]), variance_0[i])
            sigma = _separation_sigma(grown, variance_0[i], share, tiny)
            value = false_exclusion * sigma + missed[row] * sqrt(grown)
            level[i], of_row = _larger(level[i], value), _larger(of_row, value)
            statistic[k] = _larger(statistic[k], fabs(distance) / sigma)
        if of_row > largest or (of_row != of_row and largest == largest):
            dominant, largest = k, of_row
    return of_statistic, of_level, dominant, sqrt(widest)


def separation_sigmas(
    variance: cython.const[cython.double][:, :],
    variance_0: cython.const[cython.double][:],
    share: cython.double,
    tiny: cython.double,
):
    """See :func:`ship_estimation.protection.separation_sigma`.

    Args:
        variance: shape (h, n).
        variance_0: shape (n,).
        share: of the variance by all sources, that a distance has at least.
        tiny: least variance of a distance.
    """
    columns: cython.Py_ssize_t = variance.shape[1]
    check("variance", variance_0.shape[0] == columns)
    of_sigma = np.empty((variance.shape[0], columns))
    sigma: cython.double[:, ::1] = of_sigma
    row: cython.Py_ssize_t
    i: cython.Py_ssize_t
    for row in range(variance.shape[0]):
        for i in range(columns):
            sigma[row, i] = _separation_sigma(variance[row, i], variance_0[i], share, tiny)
    return of_sigma


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _separation_sigma(
    variance: cython.double, variance_0: cython.double, share: cython.double, tiny: cython.double
) -> cython.double:
    # Rounding may leave nothing of a small difference; a thousandth of the sigma is nothing to a level.
    return sqrt(_larger(variance - variance_0, _larger(share * variance_0, tiny)))


def coverage(
    level: cython.const[cython.double][:],
    told: cython.const[cython.double][:],
    covariance: cython.const[cython.double][:, :],
    entering: cython.double,
    most_growth: cython.double,
    tiny: cython.double,
):
    """How far levels that were told cover those of an output, and of those after it on the same state.

    Args:
        level: of the output, shape (3,).
        told: shape (3,).
        covariance: of the error of the output, shape (3, 3).
        entering: by how much a level grows, at most, where the directions turn, rad.
        most_growth: so many times the told levels its own may be.
        tiny: least number that something is divided by.

    Returns:
        Whether they cover the output, and the fields ``greatest_variance`` and ``most_turned`` of
        :class:`ship_estimation.told_levels.ToldLevels` where they are the levels told last.
    """
    check("levels", level.shape[0] == told.shape[0] == 3)
    check("covariance", covariance.shape[0] == covariance.shape[1] == 3)
    covers: cython.bint = True
    known: cython.bint = True
    unknown: cython.bint = True
    least: cython.double = INFINITY
    growth: cython.double = INFINITY
    room: cython.double
    trace: cython.double
    i: cython.int
    for i in range(3):
        # Levels that are no numbers are those of the state UNAVAILABLE, which was told.
        unknown = unknown and level[i] != level[i] and told[i] != told[i]
        covers = covers and level[i] <= most_growth * told[i]
        known = known and fabs(level[i]) < INFINITY
        least = min(least, level[i])
    covers = covers or unknown
    if not known:
        return covers, INFINITY, INFINITY
    for i in range(3):
        growth = -_larger(-growth, -most_growth * told[i] / level[i])
    room = 0.5 * (growth - 1.0)
    trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    # What is added to a covariance adds at most its trace to the variance of any angle, and a level grows no faster
    # than the sigma. A turn brings something of the errors that make the angles into the one with the smallest level.
    return (
        covers,
        trace + least_eigenvalue(covariance) * ((1.0 + room) * (1.0 + room) - 1.0),
        room * least / _larger(entering, tiny),
    )


def covered(
    times_ns: cython.const[cython.longlong][:],
    covariances: cython.const[cython.double][:, :, :],
    directions: cython.const[cython.double][:, :, :],
    until_ns: cython.longlong,
    greatest_variance: cython.double,
    told: cython.const[cython.double][:, :],
    most_turned: cython.double,
) -> cython.Py_ssize_t:
    """How many of N outputs, from the first one on, are covered by protection levels that were told before.

    Args:
        times_ns: stamps, shape (N,).
        covariances: shape (N, 3, 3).
        directions: in which the errors are measured, shape (N, k, l).
        until_ns: levels cover what is before.
        greatest_variance: trace of a covariance up to which they do.
        told: the directions that they are of, shape (k, l).
        most_turned: change of each number of the directions up to which they do.
    """
    count: cython.Py_ssize_t = times_ns.shape[0]
    check("covariances", covariances.shape[0] == count and covariances.shape[1] == covariances.shape[2] == 3)
    check("directions", directions.shape[0] == count and directions.shape[1] == told.shape[0])
    check("told", directions.shape[2] == told.shape[1])
    n: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for n in range(count):
        # NaN is within no bound.
        if not times_ns[n] < until_ns:
            return n
        if not covariances[n, 0, 0] + covariances[n, 1, 1] + covariances[n, 2, 2] <= greatest_variance:
            return n
        for i in range(told.shape[0]):
            for j in range(told.shape[1]):
                if not fabs(directions[n, i, j] - told[i, j]) <= most_turned:
                    return n
    return count


@cython.ccall
def least_eigenvalue(matrix: cython.const[cython.double][:, :]) -> cython.double:
    """The least eigenvalue of a symmetric 3 × 3 matrix, by Jacobi's rotations; only the lower triangle is read."""
    check("matrix", matrix.shape[0] == matrix.shape[1] == 3)
    a = cython.declare(cython.double[9])
    vectors = cython.declare(cython.double[9])
    p: cython.int
    q: cython.int
    for p in range(3):
        for q in range(p + 1):
            a[3 * p + q] = a[3 * q + p] = matrix[p, q]
    _diagonalise(a, vectors)
    return -_larger(-a[0], _larger(-a[4], -a[8]))


def square_root(matrix: cython.const[cython.double][:, :]):
    """L with L Lᵀ a covariance of the shape (3, 3), which may be singular; only its lower triangle is read."""
    check("matrix", matrix.shape[0] == matrix.shape[1] == 3)
    a = cython.declare(cython.double[9])
    vectors = cython.declare(cython.double[9])
    result = np.empty((3, 3))
    root: cython.double[:, ::1] = result
    p: cython.int
    q: cython.int
    for p in range(3):
        for q in range(p + 1):
            a[3 * p + q] = a[3 * q + p] = matrix[p, q]
    _diagonalise(a, vectors)
    for p in range(3):
        for q in range(3):
            root[p, q] = vectors[3 * p + q] * sqrt(_larger(a[4 * q], 0.0))
    return result

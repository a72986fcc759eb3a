# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled protection levels of an output, and compiled coverage of outputs by published levels.

This is the only implementation. It is Python with C types, compiled by Cython when the package is built. The functions
are documented where they are called, in :mod:`ship_estimation.protection_levels` and
:mod:`ship_estimation.published_levels`; the tests contain the same functions in plain numpy. NaN propagates to
dependent results.
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
    """Return leftᵀ matrix right."""
    total: cython.double = 0.0
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(left.shape[0]):
        for j in range(right.shape[0]):
            total += left[i] * matrix[i, j] * right[j]
    return total


def solution_separation(
    states: cython.const[cython.Py_ssize_t][:],
    to_components: cython.const[cython.double][:, :],
    by_states: cython.const[cython.double][:, :],
    covariance: cython.const[cython.double][:, :],
    mean: cython.const[cython.double][:],
    means: cython.const[cython.double][:, :],
    parts: cython.const[cython.double][:, :, :],
    subfilter_covariances: cython.const[cython.double][:, :, :],
    tested_subfilters: cython.const[cython.Py_ssize_t][:],
    fault_free: cython.double,
    false_exclusion: cython.double,
    missed_detection: cython.const[cython.double][:],
    share: cython.double,
    tiny: cython.double,
):
    """Return the fields of :class:`ship_estimation.protection_levels.ProtectionLevels` for the tested hypotheses.

    Args:
        states: indices of the states that determine the components, shape (n,).
        to_components: Jacobian of the components with respect to the errors of the output, shape (3, 3).
        by_states: Jacobian of the components with respect to these states, shape (3, n).
        covariance: covariance of the errors of the output in the main filter, shape (3, 3).
        mean: states of the main filter, shape (m,).
        means: states of the subfilters, shape (h, m).
        parts: covariance of the main filter by error source, shape (p, m, m).
        subfilter_covariances: covariances of the subfilters, shape (h, m, m).
        tested_subfilters: indices of the tested subfilters.
        fault_free: K_0; see :class:`ship_estimation.protection_levels.SigmaMultipliers`.
        false_exclusion: K_fa.
        missed_detection: K_md, shape (h,).
        share: least variance of a separation, as a share of the main filter's variance.
        tiny: least variance of a separation.
    """
    n: cython.Py_ssize_t = states.shape[0]
    m: cython.Py_ssize_t = mean.shape[0]
    hypotheses: cython.Py_ssize_t = means.shape[0]
    tested_count: cython.Py_ssize_t = tested_subfilters.shape[0]
    check("components", to_components.shape[0] == to_components.shape[1] == by_states.shape[0] == 3)
    check("covariance", covariance.shape[0] == covariance.shape[1] == 3 and by_states.shape[1] == n)
    check(
        "means",
        means.shape[1] == parts.shape[1] == parts.shape[2] == m and subfilter_covariances.shape[0] == hypotheses,
    )
    check(
        "subfilter_covariances",
        subfilter_covariances.shape[1] == subfilter_covariances.shape[2] == m
        and missed_detection.shape[0] == hypotheses,
    )
    of_statistic, of_level = np.empty(tested_count), np.empty(3)
    statistic: cython.double[::1] = of_statistic
    level: cython.double[::1] = of_level
    # Covariance of the states in the main filter, and growth of the covariance in a subfilter.
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
        level[i] = fault_free * sqrt(variance_0[i])
        largest = _larger(largest, level[i])
    for part in range(parts.shape[0]):
        for i in range(n):
            for j in range(n):
                covariances[0, i, j] += parts[part, states[i], states[j]]
    for k in range(tested_count):
        row = tested_subfilters[k]
        check("rows", 0 <= row < hypotheses)
        for i in range(n):
            widest = _larger(widest, subfilter_covariances[row, states[i], states[i]])
            for j in range(n):
                covariances[1, i, j] = subfilter_covariances[row, states[i], states[j]] - covariances[0, i, j]
        of_row = statistic[k] = 0.0
        for i in range(3):
            distance = 0.0
            for j in range(n):
                distance += by_states[i, j] * (means[row, states[j]] - mean[states[j]])
            # The errors that an output adds are the same in every filter. A subfilter is never more accurate than the
            # main filter, except if it accepts a source that the main filter rejected.
            grown = _larger(variance_0[i] + _form(by_states[i], covariances[1], by_states[i]), variance_0[i])
            sigma = _separation_sigma(grown, variance_0[i], share, tiny)
            value = false_exclusion * sigma + missed_detection[row] * sqrt(grown)
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
    """Return the sigmas of solution separations; see :func:`ship_estimation.protection_levels.separation_sigma`.

    Args:
        variance: variance in each subfilter, shape (h, n).
        variance_0: variance in the main filter, shape (n,).
        share: least variance of a separation, as a share of the main filter's variance.
        tiny: least variance of a separation.
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
    # Rounding may cancel a small difference, so a least variance applies. A thousandth of the sigma is negligible in a
    # protection level.
    return sqrt(_larger(variance - variance_0, _larger(share * variance_0, tiny)))


def coverage(
    level: cython.const[cython.double][:],
    published: cython.const[cython.double][:],
    covariance: cython.const[cython.double][:, :],
    entering: cython.double,
    most_growth: cython.double,
    tiny: cython.double,
):
    """Return the coverage of an output by published levels, and the bounds of later outputs that the levels cover.

    The later outputs are from the same filter state.

    Args:
        level: protection levels of the output, shape (3,).
        published: published levels, shape (3,).
        covariance: covariance of the error of the output, shape (3, 3).
        entering: maximum growth of a level per unit rotation of the directions, rad.
        most_growth: maximum ratio of a level to the published level.
        tiny: least denominator.

    Returns:
        True if the published levels cover the output, and the fields ``max_variance`` and ``max_direction_change`` of
        :class:`ship_estimation.published_levels.PublishedLevels`.
    """
    check("levels", level.shape[0] == published.shape[0] == 3)
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
        # NaN levels belong to the state UNAVAILABLE, which was published.
        unknown = unknown and level[i] != level[i] and published[i] != published[i]
        covers = covers and level[i] <= most_growth * published[i]
        known = known and fabs(level[i]) < INFINITY
        least = min(least, level[i])
    covers = covers or unknown
    if not known:
        return covers, INFINITY, INFINITY
    for i in range(3):
        growth = -_larger(-growth, -most_growth * published[i] / level[i])
    room = 0.5 * (growth - 1.0)
    trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    # A term added to a covariance adds at most the trace of this term to the variance of any angle, and a level grows
    # no faster than the sigma. A rotation mixes errors of all angles into the angle with the smallest level.
    return (
        covers,
        trace + least_eigenvalue(covariance) * ((1.0 + room) * (1.0 + room) - 1.0),
        room * least / _larger(entering, tiny),
    )


def covered_count(
    times_ns: cython.const[cython.longlong][:],
    covariances: cython.const[cython.double][:, :, :],
    directions: cython.const[cython.double][:, :, :],
    until_ns: cython.longlong,
    max_variance: cython.double,
    published_directions: cython.const[cython.double][:, :],
    max_direction_change: cython.double,
) -> cython.Py_ssize_t:
    """Return the number of leading outputs, of N, that are covered by published protection levels.

    Args:
        times_ns: stamps, shape (N,).
        covariances: error covariances of the outputs, shape (N, 3, 3).
        directions: direction cosines in which the errors are measured, shape (N, k, l).
        until_ns: stamp until which the levels are valid.
        max_variance: trace of a covariance up to which the levels cover an output.
        published_directions: direction cosines of the published levels, shape (k, l).
        max_direction_change: change of each direction cosine up to which the levels cover an output.
    """
    count: cython.Py_ssize_t = times_ns.shape[0]
    check("covariances", covariances.shape[0] == count and covariances.shape[1] == covariances.shape[2] == 3)
    check("directions", directions.shape[0] == count and directions.shape[1] == published_directions.shape[0])
    check("published_directions", directions.shape[2] == published_directions.shape[1])
    n: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for n in range(count):
        # NaN is within no bound.
        if not times_ns[n] < until_ns:
            return n
        if not covariances[n, 0, 0] + covariances[n, 1, 1] + covariances[n, 2, 2] <= max_variance:
            return n
        for i in range(published_directions.shape[0]):
            for j in range(published_directions.shape[1]):
                if not fabs(directions[n, i, j] - published_directions[i, j]) <= max_direction_change:
                    return n
    return count


@cython.ccall
def least_eigenvalue(matrix: cython.const[cython.double][:, :]) -> cython.double:
    """Return the least eigenvalue of a symmetric 3 × 3 matrix; only the lower triangle is read."""
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
    """Return the factor L, shape (3, 3), of a covariance L Lᵀ, which may be singular.

    Only the lower triangle of the covariance is read.
    """
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

# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled statistics of a single innovation and of many innovations.

This is the only implementation. It is Python with C types, compiled by Cython when the package is built. The functions
are documented in :mod:`ship_estimation.innovations`; the tests contain the same functions in plain numpy.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, NAN, fabs, sqrt
from cython.cimports.ship_estimation.compiled_steps import _larger


@cython.cfunc
@cython.exceptval(check=False)
def _whiten(matrix: cython.double[:, ::1], size: cython.Py_ssize_t) -> cython.bint:
    """Replace the lower triangle of a covariance by the inverse of its Cholesky factor.

    Returns:
        False if the matrix is not positive definite or contains NaN.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    total: cython.double
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = total / matrix[j, j]
            elif total > 0.0:
                matrix[i, i] = sqrt(total)
            else:
                return False
    for j in range(size):
        matrix[j, j] = 1.0 / matrix[j, j]
        for i in range(j + 1, size):
            total = 0.0
            for k in range(j, i):
                total -= matrix[i, k] * matrix[k, j]
            matrix[i, j] = total / matrix[i, i]
    return True


def innovation_statistics(
    residual: cython.const[cython.double][:],
    covariance: cython.const[cython.double][:, :],
    noise: cython.const[cython.double][:, :],
    part_of: cython.const[cython.Py_ssize_t][:],
    axis_of: cython.const[cython.Py_ssize_t][:],
    parts: cython.Py_ssize_t,
    axes: cython.Py_ssize_t,
):
    """Return the statistics of an innovation.

    Args:
        residual: measured minus predicted, shape (m,).
        covariance: innovation covariance, shape (m, m).
        noise: part of ``covariance`` from the measurement noise, shape (m, m).
        part_of: index of the part of each component, shape (m,).
        axis_of: index of the axis of each component, shape (m,).
        parts: number of parts.
        axes: number of axes.

    Returns:
        Normalised square of each part, own share, and mean along each axis, in sigmas and in rad, as in
        :class:`ship_estimation.innovations.Innovation`. None if residual or covariance is not finite, or if the
        covariance is not positive definite.
    """
    m: cython.Py_ssize_t = residual.shape[0]
    check("covariance", covariance.shape[0] == covariance.shape[1] == m)
    check("components", part_of.shape[0] == axis_of.shape[0] == m)
    of_squares, of_axes = np.empty(parts), np.empty((axes, 2))
    square: cython.double[::1] = of_squares
    along: cython.double[:, ::1] = of_axes
    white: cython.double[:, ::1] = np.empty((m, m))
    chosen: cython.Py_ssize_t[::1] = np.empty(m, dtype=np.intp)
    own: cython.double = 0.0
    total: cython.double
    in_rad: cython.double
    correlation_sum: cython.double
    row: cython.double
    count: cython.Py_ssize_t
    group: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    for i in range(m):
        if not fabs(residual[i]) < INFINITY:
            return None
        for j in range(m):
            if not fabs(covariance[i, j]) < INFINITY:
                return None
            white[i, j] = covariance[i, j]
    if not _whiten(white, m):
        return None
    check("noise", noise.shape[0] == noise.shape[1] == m)
    for k in range(m):
        for i in range(k + 1):
            row = 0.0
            for j in range(k + 1):
                row += noise[i, j] * white[k, j]
            own += white[k, i] * row
    for group in range(axes):
        count = _members(axis_of, group, chosen)
        total = in_rad = correlation_sum = 0.0
        for i in range(count):
            total += residual[chosen[i]] / sqrt(covariance[chosen[i], chosen[i]])
            in_rad += residual[chosen[i]]
            for j in range(count):
                correlation_sum += covariance[chosen[i], chosen[j]] / (
                    sqrt(covariance[chosen[i], chosen[i]]) * sqrt(covariance[chosen[j], chosen[j]])
                )
        along[group, 0], along[group, 1] = total / sqrt(correlation_sum), in_rad / count
    for group in range(parts):
        count = _members(part_of, group, chosen)
        if count < m or parts > 1:
            for i in range(count):
                for j in range(count):
                    white[i, j] = covariance[chosen[i], chosen[j]]
            _whiten(white, count)  # a block of a positive definite matrix is positive definite
        square[group] = 0.0
        for i in range(count):
            row = 0.0
            for j in range(i + 1):
                row += white[i, j] * residual[chosen[j]]
            square[group] += row * row
    return of_squares, own / m, of_axes


@cython.cfunc
@cython.exceptval(check=False)
def _members(
    group_of: cython.const[cython.Py_ssize_t][:], group: cython.Py_ssize_t, chosen: cython.Py_ssize_t[::1]
) -> cython.Py_ssize_t:
    """Write the indices of the components of a group; return their number."""
    count: cython.Py_ssize_t = 0
    i: cython.Py_ssize_t
    for i in range(group_of.shape[0]):
        if group_of[i] == group:
            chosen[count] = i
            count += 1
    return count


def part_sizes(numbers: cython.const[cython.double][:, :], first: cython.Py_ssize_t, least_own_share: cython.double):
    """Return the normalised squares of the parts of many innovations, and sums over the innovations.

    Args:
        numbers: n innovations, shape (n, c), in the columns of
            :class:`ship_estimation.innovations.InnovationTable`.
        first: column of the first square; all following columns are squares.
        least_own_share: least own share of an innovation that is used.

    Returns:
        Five values. The first three describe the used innovations: squares in ascending order, shape (k,), largest
        number of degrees of freedom, and mean own share (NaN without used innovations). The last two are the sums of
        NIS and of components of all innovations.
    """
    check("columns", 5 <= first <= numbers.shape[1])
    of_squares = np.empty(numbers.shape[0] * (numbers.shape[1] - first))
    square: cython.double[::1] = of_squares
    filled: cython.Py_ssize_t = 0
    informative: cython.Py_ssize_t = 0
    degrees: cython.double = 0.0
    own_share: cython.double = 0.0
    nis: cython.double = 0.0
    components: cython.double = 0.0
    n: cython.Py_ssize_t
    part: cython.Py_ssize_t
    for n in range(numbers.shape[0]):
        nis += numbers[n, 1]
        components += numbers[n, 2]
        if not numbers[n, 3] >= least_own_share:
            continue
        informative += 1
        degrees = max(degrees, numbers[n, 0])
        own_share += numbers[n, 3]
        for part in range(first, numbers.shape[1]):
            # Padding is NaN.
            if numbers[n, part] == numbers[n, part]:
                square[filled] = numbers[n, part]
                filled += 1
    kept = of_squares[:filled]
    kept.sort()
    return kept, int(degrees), own_share / informative if informative else NAN, nis, int(components)


@cython.cfunc
@cython.exceptval(check=False)
def _median(ordered: cython.double[:], count: cython.Py_ssize_t) -> cython.double:
    """Return the median of the first ``count`` numbers, which are in ascending order."""
    half: cython.Py_ssize_t = count // 2
    return ordered[half] if count % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def axis_statistics(
    numbers: cython.const[cython.double][:, :],
    axes: cython.Py_ssize_t,
    least: cython.Py_ssize_t,
    sigma_of_spread: cython.double,
    clipped_at: cython.double,
):
    """Return bias, spread and correlation of innovations along each axis.

    Args:
        numbers: as in :func:`part_sizes`, in order of time.
        axes: number of axes.
        least: minimum number of innovations along an axis.
        sigma_of_spread: ratio of the sigma of normal values to their median absolute deviation.
        clipped_at: bound of the distance from the median, as a multiple of the spread.

    Returns:
        Count, bias, spread and correlation of each axis as in :class:`ship_estimation.innovations.AxisStatistics`,
        shape (axes, 4), and the common variance of the prediction error. Too few innovations give NaN for all values
        except the count.
    """
    count: cython.Py_ssize_t = numbers.shape[0]
    check("columns", 5 + 2 * axes <= numbers.shape[1] and least > 0)
    figures = np.full((axes, 4), NAN)
    of_values, of_ordered = np.empty((axes, count)), np.full((axes, count), NAN)
    found: cython.double[:, ::1] = figures
    value: cython.double[:, ::1] = of_values
    ordered: cython.double[:, ::1] = of_ordered
    common_variance: cython.double = -INFINITY
    limit: cython.double
    squares: cython.double
    products: cython.double
    axis: cython.Py_ssize_t
    known: cython.Py_ssize_t
    n: cython.Py_ssize_t
    for n in range(count):
        if numbers[n, 4] == 0.0:
            common_variance = _larger(common_variance, 1.0 - numbers[n, 3])
    for axis in range(axes):
        known = 0
        for n in range(count):
            if numbers[n, 5 + 2 * axis] == numbers[n, 5 + 2 * axis]:
                value[axis, known] = ordered[axis, known] = numbers[n, 5 + 2 * axis]
                known += 1
        found[axis, 0] = known
    of_ordered.sort(axis=1)  # NaN is sorted last
    for axis in range(axes):
        known = int(found[axis, 0])
        if known < least:
            continue
        found[axis, 1] = _median(ordered[axis], known)
        for n in range(known):
            value[axis, n] -= found[axis, 1]
            ordered[axis, n] = fabs(value[axis, n])
    of_ordered.sort(axis=1)
    for axis in range(axes):
        known = int(found[axis, 0])
        if known < least:
            continue
        found[axis, 2] = max(1.0, sigma_of_spread * _median(ordered[axis], known))
        limit = clipped_at * found[axis, 2]
        squares = products = 0.0
        for n in range(known):
            value[axis, n] = min(max(value[axis, n], -limit), limit)
            squares += value[axis, n] * value[axis, n]
            if n:
                products += value[axis, n] * value[axis, n - 1]
        found[axis, 3] = products / squares if squares > 0.0 else 0.0
    return figures, common_variance if common_variance > -INFINITY else 0.0

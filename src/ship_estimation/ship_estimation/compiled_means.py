# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled windowed means of whitened innovations.

This is the only implementation. It is Python with C types, compiled by Cython when the package is built. The functions
are documented in :mod:`ship_estimation.innovation_means`; the tests contain the same functions in plain numpy.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN, fabs, sqrt
from cython.cimports.libc.string import memcpy
from cython.cimports.ship_estimation.compiled_steps import _larger

_COLUMNS = cython.declare(cython.Py_ssize_t, 5)
_CONSTANT_VARIANCE = cython.declare(cython.double, 1e-9)
"""Variance added to a constant error, so that a mean without noise has a regular covariance."""
_LEAST_VARIANCE = cython.declare(cython.double, 1e-24)
"""Least variance of a sum of corrections, rad², because states known exactly get no corrections."""


@cython.cfunc
@cython.exceptval(check=False)
def _average(
    mean: cython.p_double, innovation: cython.p_double, weights: cython.const[cython.double][::1]
) -> cython.void:
    """Update the means, shape (w, 5), in place with one innovation."""
    k: cython.Py_ssize_t
    i: cython.Py_ssize_t
    weight: cython.double
    for k in range(weights.shape[0]):
        weight = weights[k]
        for i in range(3):
            mean[i] = (1.0 - weight) * mean[i] + weight * innovation[i]
        mean[3] = (1.0 - weight) * mean[3] + weight
        mean[4] = (1.0 - weight) * (1.0 - weight) * mean[4] + weight * weight
        mean += _COLUMNS


@cython.cfunc
@cython.exceptval(check=False)
def _chi2(mean: cython.p_double) -> cython.double:
    """Return chi² of a mean of independent innovations."""
    return (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]) / mean[4]


@cython.cfunc
@cython.exceptval(check=False)
def _chi2_with_constant_error(
    mean: cython.p_double, whitened_noise: cython.const[cython.double][:, :]
) -> cython.double:
    """Return chi² of a mean if the error of the filter is constant, so that only the measurement noise averages out.

    The covariance of the mean is decomposed by a Cholesky factor; chi² is NaN if the factor does not exist.
    """
    constant: cython.double = mean[3] * mean[3]
    factor = cython.declare(cython.double[9])
    solved = cython.declare(cython.double[3])
    total: cython.double = 0.0
    left: cython.double
    i: cython.int
    j: cython.int
    k: cython.int
    for i in range(3):
        for j in range(i + 1):
            left = (mean[4] - constant) * whitened_noise[i, j]
            if i == j:
                left += constant + _CONSTANT_VARIANCE
            for k in range(j):
                left -= factor[3 * i + k] * factor[3 * j + k]
            if i != j:
                factor[3 * i + j] = left / factor[4 * j]
                continue
            if not left > 0.0:
                return NAN
            factor[4 * i] = sqrt(left)
        solved[i] = mean[i]
        for k in range(i):
            solved[i] -= factor[3 * i + k] * solved[k]
        solved[i] /= factor[4 * i]
        total += solved[i] * solved[i]
    return total


def updated_means(
    running: cython.const[cython.double][:, :, :, ::1],
    excess: cython.const[cython.double][:, ::1],
    rejection_counts: cython.const[cython.longlong][:, ::1],
    last_measured_ns: cython.const[cython.longlong][::1],
    inconsistent_since_ns: cython.const[cython.longlong][::1],
    sources: tuple,
    innovation: cython.const[cython.double][:, :, :],
    accepted: cython.const[cython.uchar][:, :],
    time_ns: cython.longlong,
    weights: cython.const[cython.double][::1],
    limit: cython.double,
    max_innovation: cython.double,
    consistent_ratio: cython.double,
    never_ns: cython.longlong,
    is_excluded: cython.bint,
    whitened_noise: cython.const[cython.double][:, :],
):
    """Return the fields of ``InnovationMeans``, in their order, after a measurement of each of several sources.

    Args:
        running: as in :class:`ship_estimation.innovation_means.InnovationMeans`, shape (h, s, w, 5).
        excess: as in the same class, shape (h, s).
        rejection_counts: as in the same class, shape (h, s).
        last_measured_ns: as in the same class, shape (s,).
        inconsistent_since_ns: as in the same class, shape (s,).
        sources: indices of the l measuring sources.
        innovation: whitened innovation in every filter, shape (h, l, 3).
        accepted: true for each filter whose gate the measurement passed, shape (h, l).
        time_ns: stamp of the measurement.
        weights: weight of one measurement in each mean, shape (w,).
        limit: limit of chi².
        max_innovation: bound of the length of an innovation.
        consistent_ratio: share of the limit below which a source is consistent.
        never_ns: value of ``inconsistent_since_ns`` for a consistent source.
        is_excluded: true if the main filter excludes the source.
        whitened_noise: if the main filter excludes the source, the part of the measurement noise in the whitened
            covariance, shape (3, 3).

    Returns:
        The fields, or None if an innovation is not finite.
    """
    rows: cython.Py_ssize_t = running.shape[0]
    count: cython.Py_ssize_t = running.shape[1]
    check("running", running.shape[2] == weights.shape[0] and running.shape[3] == _COLUMNS)
    check(
        "excess",
        excess.shape[0] == rejection_counts.shape[0] == rows and excess.shape[1] == rejection_counts.shape[1] == count,
    )
    check("last_measured_ns", last_measured_ns.shape[0] == inconsistent_since_ns.shape[0] == count)
    check("innovation", innovation.shape[0] == accepted.shape[0] == rows and innovation.shape[2] == 3)
    check("sources", innovation.shape[1] == accepted.shape[1] == len(sources))
    check("whitened_noise", whitened_noise.shape[0] == whitened_noise.shape[1] == 3)
    of_running, of_excess = np.empty((rows, count, weights.shape[0], _COLUMNS)), np.empty((rows, count))
    of_refused = np.empty((rows, count), dtype=np.int64)
    of_last_measured, of_contradicts = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    means: cython.double[:, :, :, ::1] = of_running
    excesses: cython.double[:, ::1] = of_excess
    refusals: cython.longlong[:, ::1] = of_refused
    last_measured: cython.longlong[::1] = of_last_measured
    contradicts: cython.longlong[::1] = of_contradicts
    seen = cython.declare(cython.double[3])
    mean: cython.p_double
    size: cython.double
    worst: cython.double
    row: cython.Py_ssize_t
    one: cython.Py_ssize_t
    s: cython.Py_ssize_t
    k: cython.Py_ssize_t
    i: cython.Py_ssize_t
    if rows * count:
        of_numbers: cython.size_t = rows * count * cython.sizeof(cython.double)
        of_stamps: cython.size_t = count * cython.sizeof(cython.longlong)
        of_means: cython.size_t = weights.shape[0] * _COLUMNS * of_numbers
        memcpy(cython.address(means[0, 0, 0, 0]), cython.address(running[0, 0, 0, 0]), of_means)
        memcpy(cython.address(excesses[0, 0]), cython.address(excess[0, 0]), of_numbers)
        memcpy(cython.address(refusals[0, 0]), cython.address(rejection_counts[0, 0]), rows * of_stamps)
        memcpy(cython.address(last_measured[0]), cython.address(last_measured_ns[0]), of_stamps)
        memcpy(cython.address(contradicts[0]), cython.address(inconsistent_since_ns[0]), of_stamps)
    for one in range(innovation.shape[1]):
        s = sources[one]
        check("sources", 0 <= s < count)
        for row in range(rows):
            size = sqrt(innovation[row, one, 0] ** 2 + innovation[row, one, 1] ** 2 + innovation[row, one, 2] ** 2)
            if not size < float("inf"):
                return None
            for i in range(3):
                seen[i] = innovation[row, one, i] * (max_innovation / max(size, max_innovation))
            mean = cython.address(means[row, s, 0, 0])
            _average(mean, seen, weights)
            worst = 0.0
            for k in range(weights.shape[0]):
                if is_excluded and row == 0:
                    worst = _larger(worst, _chi2_with_constant_error(mean + k * _COLUMNS, whitened_noise))
                else:
                    worst = _larger(worst, _chi2(mean + k * _COLUMNS))
            excesses[row, s] = worst / limit
            refusals[row, s] = 0 if accepted[row, one] else refusals[row, s] + 1
        last_measured[s] = max(last_measured[s], time_ns)
        # NaN is inconsistent.
        if excesses[0, s] <= consistent_ratio and refusals[0, s] == 0:
            contradicts[s] = never_ns
        elif contradicts[s] == never_ns:
            contradicts[s] = time_ns
    return of_running, of_excess, of_refused, of_last_measured, of_contradicts


def updated_mean(
    running: cython.const[cython.double][:, ::1],
    innovation: cython.const[cython.double][:],
    weights: cython.const[cython.double][::1],
):
    """Return the means after one more innovation, shape (w, 5), and their largest component in sigmas.

    The largest component is NaN if one component is NaN.
    """
    check(
        "averaged", running.shape[0] == weights.shape[0] and running.shape[1] == _COLUMNS and innovation.shape[0] == 3
    )
    result = np.empty((weights.shape[0], _COLUMNS))
    means: cython.double[:, ::1] = result
    if weights.shape[0]:
        memcpy(
            cython.address(means[0, 0]),
            cython.address(running[0, 0]),
            weights.shape[0] * _COLUMNS * cython.sizeof(cython.double),
        )
    seen = cython.declare(cython.double[3])
    seen[0], seen[1], seen[2] = innovation[0], innovation[1], innovation[2]
    _average(cython.address(means[0, 0]), seen, weights)
    worst: cython.double = 0.0
    k: cython.Py_ssize_t
    i: cython.Py_ssize_t
    for k in range(weights.shape[0]):
        for i in range(3):
            worst = _larger(worst, fabs(means[k, i]) / sqrt(means[k, 4]))
    return result, worst


def updated_correction_sums(
    sums: cython.const[cython.double][:, :, ::1],
    gain: cython.const[cython.double][:, :, ::1],
    residual: cython.const[cython.double][:, ::1],
    covariance: cython.const[cython.double][:, :, ::1],
    jacobian: cython.const[cython.double][:, ::1],
    first: cython.Py_ssize_t,
    block_left: cython.double,
):
    """Return the sums after one more correction of the main filter, shape (b, 3, 3), and the largest sum in sigmas.

    Args:
        sums: sums before the correction, as in :class:`ship_estimation.common_error.CorrectionSums`.
        gain: Kalman gain, shape (h, n, m).
        residual: measured minus predicted, shape (h, m).
        covariance: innovation covariance, shape (h, m, m).
        jacobian: Jacobian of the measurement, shape (m, n).
        first: index of the first of the three states.
        block_left: remaining share of a common error at which a block is full.
    """
    blocks: cython.Py_ssize_t = sums.shape[0]
    m: cython.Py_ssize_t = residual.shape[1]
    check("sums", blocks > 0 and sums.shape[1] == sums.shape[2] == 3)
    check("rows", gain.shape[0] > 0 and residual.shape[0] > 0 and covariance.shape[0] > 0)
    check("measurement", gain.shape[2] == covariance.shape[1] == covariance.shape[2] == jacobian.shape[0] == m)
    check("states", 0 <= first <= gain.shape[1] - 3 and jacobian.shape[1] == gain.shape[1])
    result = np.empty((blocks, 3, 3))
    after: cython.double[:, :, ::1] = result
    memcpy(cython.address(after[0, 0, 0]), cython.address(sums[0, 0, 0]), blocks * 9 * cython.sizeof(cython.double))
    worst: cython.double = 0.0
    correction: cython.double
    variance: cython.double
    response: cython.double
    weighted: cython.double
    axis: cython.Py_ssize_t
    state: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for axis in range(3):
        state = first + axis
        if after[0, 2, axis] <= block_left:
            for i in range(blocks - 1, 0, -1):
                for j in range(3):
                    after[i, j, axis] = after[i - 1, j, axis]
            after[0, 0, axis], after[0, 1, axis], after[0, 2, axis] = 0.0, 0.0, 1.0
        correction = variance = response = 0.0
        for i in range(m):
            weighted = 0.0
            for j in range(m):
                weighted += covariance[0, i, j] * gain[0, state, j]
            correction += gain[0, state, i] * residual[0, i]
            variance += gain[0, state, i] * weighted
            response += gain[0, state, i] * jacobian[i, state]
        after[0, 0, axis] += correction
        after[0, 1, axis] += variance
        after[0, 2, axis] *= 1.0 - _larger(0.0, -_larger(-1.0, -response))
        correction = variance = 0.0
        for i in range(blocks):
            correction += after[i, 0, axis]
            variance += after[i, 1, axis]
        worst = _larger(worst, fabs(correction) / sqrt(_larger(variance, _LEAST_VARIANCE)))
    return result, worst

# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled statistics of innovations, windowed means of whitened innovations, and protection levels.

The functions are described where they are called: :mod:`ship_estimation.innovations.innovation_statistics`,
:mod:`ship_estimation.fault_detection.isolation`, :mod:`ship_estimation.integrity.protection_levels` and
:mod:`ship_estimation.integrity.published_levels`. NaN propagates to dependent results.
"""

import cython
import numpy as np

from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, NAN, fabs, sqrt
from cython.cimports.libc.string import memcpy
from cython.cimports.ship_kernels.compiled_kalman import _diagonalise, _larger


@cython.cfunc
@cython.exceptval(check=False)
def _whiten(matrix: cython.double[:, ::1], size: cython.Py_ssize_t) -> cython.bint:
    """Replace the lower triangle of a covariance by the inverse of its Cholesky factor.

    Returns:
        False if the matrix is not positive definite or contains NaN.
    """
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
        :class:`ship_estimation.innovations.innovation_statistics.Innovation`. None if residual or covariance is not
        finite, or if the covariance is not positive definite.
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
    for i in range(group_of.shape[0]):
        if group_of[i] == group:
            chosen[count] = i
            count += 1
    return count


def part_sizes(numbers: cython.const[cython.double][:, :], first: cython.Py_ssize_t, least_own_share: cython.double):
    """Return the normalised squares of the parts of many innovations, and sums over the innovations.

    Args:
        numbers: n innovations, shape (n, c), in the columns of
            :class:`ship_estimation.innovations.innovation_statistics.InnovationTable`.
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
        Count, bias, spread and correlation of each axis as in
        :class:`ship_estimation.innovations.innovation_statistics.AxisStatistics`, shape (axes, 4), and the common
        variance of the prediction error. Too few innovations give NaN for all values except the count.
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
    known: cython.Py_ssize_t
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
        running: as in :class:`ship_estimation.fault_detection.isolation.InnovationMeans`, shape (h, s, w, 5).
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
    s: cython.Py_ssize_t
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
        sums: sums before the correction, as in :class:`ship_estimation.fault_detection.common_error.CorrectionSums`.
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
    state: cython.Py_ssize_t
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


@cython.cfunc
@cython.exceptval(check=False)
def _form(
    left: cython.const[cython.double][:],
    matrix: cython.const[cython.double][:, :],
    right: cython.const[cython.double][:],
) -> cython.double:
    """Return leftᵀ matrix right."""
    total: cython.double = 0.0
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
    """Return the fields of a ``ProtectionLevels`` for the tested hypotheses.

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
        fault_free: K_0; see :class:`ship_estimation.integrity.protection_levels.SigmaMultipliers`.
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
    row: cython.Py_ssize_t
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
    """Return the sigmas of solution separations; see ``protection_levels.separation_sigma``.

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
        :class:`ship_estimation.integrity.published_levels.PublishedLevels`.
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
    for p in range(3):
        for q in range(p + 1):
            a[3 * p + q] = a[3 * q + p] = matrix[p, q]
    _diagonalise(a, vectors)
    for p in range(3):
        for q in range(3):
            root[p, q] = vectors[3 * p + q] * sqrt(_larger(a[4 * q], 0.0))
    return result

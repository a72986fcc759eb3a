# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled time and measurement update of a Kalman filter with subfilters and with covariances by error source.

The steps work for any number of states, sources, filters and residuals. The functions are documented where they are
called, in :mod:`ship_estimation.kalman.kalman_filter` and :mod:`ship_estimation.fault_detection.subfilters`.

A measurement with Jacobian H, gain K and noise N changes a covariance P to (I - K H) P (I - K H)ᵀ + K N Kᵀ. The matrix
I - K H is never formed. Instead P is multiplied by the two thin factors of K H, which needs a fifth of the operations
for 19 states and 3 residuals.

Matrices are stored row by row. The inner loops add weighted rows to another row (:func:`_add_rows`), which compilers
vectorise.
"""

import cython
import numpy as np

from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import exp, fabs, sqrt
from cython.cimports.libc.string import memcpy, memset

_JACOBI_SWEEPS = cython.declare(cython.int, 12)
"""Maximum number of Jacobi sweeps; the off-diagonal elements of a 3 × 3 matrix vanish to the last bit after five."""


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _add(
    target: cython.p_double, weight: cython.double, row: cython.p_double, count: cython.Py_ssize_t
) -> cython.void:
    """Add a number times a row to another row."""
    for i in range(count):
        target[i] += weight * row[i]


@cython.cfunc
@cython.exceptval(check=False)
def _add_rows(
    target: cython.p_double,
    sign: cython.double,
    weights: cython.p_double,
    step: cython.Py_ssize_t,
    inner: cython.Py_ssize_t,
    rows: cython.p_double,
    stride: cython.Py_ssize_t,
    count: cython.Py_ssize_t,
) -> cython.void:
    """Add several weighted rows to a target row, four at a time, for fewer reads and writes of the target.

    Args:
        target: row of ``count`` numbers.
        sign: factor of all weights.
        weights: weight of each row, with spacing ``step``.
        step: spacing of the weights, 1 if the weights are a row of a matrix, the width of the matrix if they are a
            column.
        inner: number of rows.
        rows: the rows, with spacing ``stride``.
        stride: width of the matrix of the rows.
        count: number of elements of each row.
    """
    k: cython.Py_ssize_t = 0
    row: cython.p_double
    first: cython.double
    second: cython.double
    third: cython.double
    fourth: cython.double
    while k + 4 <= inner:
        row = rows + k * stride
        first, second = sign * weights[k * step], sign * weights[(k + 1) * step]
        third, fourth = sign * weights[(k + 2) * step], sign * weights[(k + 3) * step]
        for j in range(count):
            target[j] += (
                first * row[j] + second * row[stride + j] + third * row[2 * stride + j] + fourth * row[3 * stride + j]
            )
        k += 4
    if k == inner:
        return
    # Up to three rows remain, and exactly three for the three residuals of an attitude.
    row = rows + k * stride
    first = sign * weights[k * step]
    if inner - k == 1:
        _add(target, first, row, count)
        return
    second = sign * weights[(k + 1) * step]
    if inner - k == 2:
        for j in range(count):
            target[j] += first * row[j] + second * row[stride + j]
        return
    third = sign * weights[(k + 2) * step]
    for j in range(count):
        target[j] += first * row[j] + second * row[stride + j] + third * row[2 * stride + j]


@cython.cfunc
@cython.exceptval(check=False)
def _product(
    left: cython.p_double,
    rows: cython.Py_ssize_t,
    inner: cython.Py_ssize_t,
    right: cython.p_double,
    columns: cython.Py_ssize_t,
    out: cython.p_double,
) -> cython.void:
    """Write the product of two matrices."""
    memset(out, 0, rows * columns * cython.sizeof(cython.double))
    for i in range(rows):
        _add_rows(out + i * columns, 1.0, left + i * inner, 1, inner, right, columns, columns)


@cython.cfunc
@cython.exceptval(check=False)
def _sum(
    parts: cython.p_double, count: cython.Py_ssize_t, size: cython.Py_ssize_t, out: cython.p_double
) -> cython.void:
    """Write the sum of contiguous matrices."""
    memcpy(out, parts, size * cython.sizeof(cython.double))
    for s in range(1, count):
        _add(out, 1.0, parts + s * size, size)


@cython.cfunc
@cython.exceptval(check=False)
def _transpose(
    matrix: cython.p_double, rows: cython.Py_ssize_t, columns: cython.Py_ssize_t, out: cython.p_double
) -> cython.void:
    for i in range(rows):
        for j in range(columns):
            out[j * rows + i] = matrix[i * columns + j]


@cython.cfunc
@cython.exceptval(check=False)
def _cholesky(matrix: cython.p_double, size: cython.Py_ssize_t) -> cython.bint:
    """Replace the upper triangle by the Cholesky factor; return False if the factor does not exist, as for NaN."""
    root: cython.double
    row: cython.p_double
    for j in range(size):
        row = matrix + j * size
        if not row[j] > 0.0:
            return False
        root = sqrt(row[j])
        for i in range(j, size):
            row[i] /= root
        for i in range(j + 1, size):
            _add(matrix + i * size + i, -row[i], row + i, size - i)
    return True


@cython.cfunc
@cython.exceptval(check=False)
def _solve(
    factor: cython.p_double, size: cython.Py_ssize_t, right_side: cython.p_double, columns: cython.Py_ssize_t
) -> cython.void:
    """Replace a right-hand side of ``columns`` columns by the solution, from the Cholesky factor of the matrix."""
    k: cython.Py_ssize_t
    row: cython.p_double
    for i in range(size):
        row = right_side + i * columns
        _add_rows(row, -1.0, factor + i, size, i, right_side, columns, columns)
        for j in range(columns):
            row[j] /= factor[i * size + i]
    for i in range(size - 1, -1, -1):
        row = right_side + i * columns
        k = i + 1
        _add_rows(row, -1.0, factor + i * size + k, 1, size - k, right_side + k * columns, columns, columns)
        for j in range(columns):
            row[j] /= factor[i * size + i]


def predicted_covariances(
    stacks: cython.const[cython.double][:, :, :, ::1],
    sources: cython.Py_ssize_t,
    decay: cython.const[cython.double][::1],
    noise: cython.const[cython.double][::1],
    source_of: cython.const[cython.Py_ssize_t][::1],
):
    """Return the predicted covariances of several stacks.

    The process noise of a state is added to the part of its error source and to every subfilter.
    """
    matrices: cython.Py_ssize_t = stacks.shape[1]
    n: cython.Py_ssize_t = stacks.shape[2]
    check("stacks", stacks.shape[3] == n == decay.shape[0] == noise.shape[0] == source_of.shape[0])
    result = np.empty((stacks.shape[0], matrices, n, n))
    out: cython.double[:, :, :, ::1] = result
    for stack in range(stacks.shape[0]):
        _predict_covariances(stacks[stack], sources, decay, noise, source_of, out[stack])
    return result


@cython.cfunc
@cython.exceptval(check=False)
def _predict_covariances(
    stack: cython.const[cython.double][:, :, ::1],
    sources: cython.Py_ssize_t,
    decay: cython.const[cython.double][::1],
    noise: cython.const[cython.double][::1],
    source_of: cython.const[cython.Py_ssize_t][::1],
    out: cython.double[:, :, ::1],
) -> cython.void:
    """Write the predicted covariances of one stack for a diagonal transition."""
    n: cython.Py_ssize_t = stack.shape[1]
    for s in range(stack.shape[0]):
        for i in range(n):
            for j in range(n):
                out[s, i, j] = stack[s, i, j] * (decay[i] * decay[j])
            if s >= sources or source_of[i] == s:
                out[s, i, i] += noise[i]


def transition(
    dt_s: cython.double,
    time_s: cython.const[cython.double][::1],
    steady_variance: cython.const[cython.double][::1],
    walk_variance: cython.const[cython.double][::1],
):
    """Return decay factor and process noise variance of each state over a time, shapes (n,) and (n,)."""
    n: cython.Py_ssize_t = time_s.shape[0]
    check("transition", steady_variance.shape[0] == walk_variance.shape[0] == n)
    of_decay, of_noise = np.empty(n), np.empty(n)
    decay: cython.double[::1] = of_decay
    noise: cython.double[::1] = of_noise
    _transition(dt_s, time_s, steady_variance, walk_variance, decay, noise)
    return of_decay, of_noise


@cython.cfunc
@cython.exceptval(check=False)
def _transition(
    dt_s: cython.double,
    time_s: cython.const[cython.double][::1],
    steady_variance: cython.const[cython.double][::1],
    walk_variance: cython.const[cython.double][::1],
    decay: cython.double[::1],
    noise: cython.double[::1],
) -> cython.void:
    """Write decay factor and process noise variance of each state."""
    for i in range(time_s.shape[0]):
        decay[i] = exp(-dt_s / time_s[i])
        noise[i] = steady_variance[i] * (1.0 - decay[i] * decay[i]) + walk_variance[i] * dt_s


def propagate(
    dt_s: cython.double,
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    time_s: cython.const[cython.double][::1],
    steady_variance: cython.const[cython.double][::1],
    walk_variance: cython.const[cython.double][::1],
    source_of: cython.const[cython.Py_ssize_t][::1],
    first: cython.Py_ssize_t,
    sigma: cython.const[cython.double][::1],
    threshold_sigmas: cython.double,
):
    """Propagate all filters; return decay factors (n,), means (h, n) and stack (n_sources + h - 1, n, n).

    Args:
        dt_s: time step, s.
        means: states before the time step, shape (h, n).
        stack: covariances before the time step, shape (n_sources + h - 1, n, n).
        time_s: correlation time of each state, s, shape (n,).
        steady_variance: steady variance of a Gauss–Markov state, shape (n,).
        walk_variance: variance per second of a random walk, shape (n,).
        source_of: index of the error source of each state's noise, shape (n,).
        first: index of the first of k states whose means do not decay while they exceed the threshold.
        sigma: standard deviation of these states, shape (k,).
        threshold_sigmas: threshold of these states, sigmas.
    """
    rows: cython.Py_ssize_t = means.shape[0]
    n: cython.Py_ssize_t = means.shape[1]
    check("model", time_s.shape[0] == steady_variance.shape[0] == walk_variance.shape[0] == source_of.shape[0] == n)
    check("stack", stack.shape[0] >= rows and stack.shape[1] == stack.shape[2] == n)
    check("slow", 0 <= first <= n - sigma.shape[0])
    of_decay, of_means, of_stack = np.empty(n), np.empty((rows, n)), np.empty((stack.shape[0], n, n))
    decay: cython.double[::1] = of_decay
    propagated: cython.double[:, ::1] = of_means
    out: cython.double[:, :, ::1] = of_stack
    noise: cython.double[::1] = np.empty(n)
    _transition(dt_s, time_s, steady_variance, walk_variance, decay, noise)
    _predict_covariances(stack, stack.shape[0] - rows + 1, decay, noise, source_of, out)
    for row in range(rows):
        for i in range(n):
            propagated[row, i] = decay[i] * means[row, i]
        for i in range(sigma.shape[0]):
            if fabs(means[row, first + i]) > threshold_sigmas * sigma[i]:
                propagated[row, first + i] = means[row, first + i]
    return of_decay, of_means, of_stack


def add_error(
    stack: cython.double[:, :, ::1],
    rows: cython.Py_ssize_t,
    part: cython.Py_ssize_t,
    first: cython.Py_ssize_t,
    covariance: cython.const[cython.double][:, :],
    row: cython.Py_ssize_t,
):
    """Inflate the covariance of some states, in place, in all filters of a stack or in one subfilter.

    Args:
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        rows: number of filters, h.
        part: error source of the added covariance in the main filter.
        first: index of the first of the k states.
        covariance: added covariance, shape (k, k).
        row: index of the subfilter; 0 for all filters.
    """
    sources: cython.Py_ssize_t = stack.shape[0] - rows + 1
    count: cython.Py_ssize_t = covariance.shape[0]
    check("row", 0 <= row < rows and 0 <= part < sources)
    check("states", 0 <= first <= stack.shape[1] - count and stack.shape[1] == stack.shape[2])
    check("covariance", covariance.shape[1] == count)
    for s in range(stack.shape[0]):
        if s == sources + row - 1 if row else s == part or s >= sources:
            for i in range(count):
                for j in range(count):
                    stack[s, first + i, first + j] += covariance[i, j]


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _larger(first: cython.double, second: cython.double) -> cython.double:
    """Return the larger of two numbers; NaN if one of them is NaN."""
    return first if first != first or second <= first else second


def solution_separations(
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    first: cython.Py_ssize_t,
    count: cython.Py_ssize_t,
    least_share: cython.double,
    least_variance: cython.double,
):
    """Return the separations in k states, shape (h, k), and the largest separation of each filter, sigmas, shape (h,).

    Args:
        means: states of the filters, shape (h, n).
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        first: index of the first state.
        count: number of states, k.
        least_share: least variance of a separation, as a share of the main filter's variance.
        least_variance: least variance of a separation.
    """
    rows: cython.Py_ssize_t = means.shape[0]
    of_separation, of_statistic = np.empty((rows, count)), np.zeros(rows)
    separation: cython.double[:, ::1] = of_separation
    statistic: cython.double[::1] = of_statistic
    by_all: cython.double
    _check_separations(means, stack, first, count)
    for i in range(first, first + count):
        by_all = _main_filter_variance(stack, rows, i)
        for row in range(rows):
            separation[row, i - first] = means[row, i] - means[0, i]
            statistic[row] = _larger(
                statistic[row], _separation_sigmas(means, stack, row, i, by_all, least_share, least_variance)
            )
    return of_separation, of_statistic


def exceeds_separation(
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    first: cython.Py_ssize_t,
    count: cython.Py_ssize_t,
    least_share: cython.double,
    least_variance: cython.double,
    threshold_sigmas: cython.double,
) -> cython.bint:
    """True if a solution separation exceeds the threshold; arguments as for :func:`solution_separations`."""
    by_all: cython.double
    _check_separations(means, stack, first, count)
    for i in range(first, first + count):
        by_all = _main_filter_variance(stack, means.shape[0], i)
        for row in range(means.shape[0]):
            # Written so that NaN exceeds the threshold.
            if not _separation_sigmas(means, stack, row, i, by_all, least_share, least_variance) <= threshold_sigmas:
                return True
    return False


@cython.cfunc
def _check_separations(
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    first: cython.Py_ssize_t,
    count: cython.Py_ssize_t,
):
    n: cython.Py_ssize_t = means.shape[1]
    check("separations", stack.shape[0] >= means.shape[0] and stack.shape[1] == stack.shape[2] == n)
    check("states", first >= 0 and 0 <= count <= n - first)


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _main_filter_variance(
    stack: cython.const[cython.double][:, :, ::1], rows: cython.Py_ssize_t, state: cython.Py_ssize_t
) -> cython.double:
    """Return the variance of a state in the main filter."""
    total: cython.double = 0.0
    for s in range(stack.shape[0] - rows + 1):
        total += stack[s, state, state]
    return total


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _separation_sigmas(
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    row: cython.Py_ssize_t,
    state: cython.Py_ssize_t,
    by_all: cython.double,
    least_share: cython.double,
    least_variance: cython.double,
) -> cython.double:
    """Return the solution separation of a filter in a state, sigmas."""
    variance: cython.double = 0.0
    if row:
        variance = stack[stack.shape[0] - means.shape[0] + row, state, state] - by_all
    variance = _larger(variance, _larger(least_share * by_all, least_variance))
    return fabs(means[row, state] - means[0, state]) / sqrt(variance)


def filter_covariances(stack: cython.const[cython.double][:, :, ::1], rows: cython.Py_ssize_t):
    """Return the covariance of each filter; that of the main filter is the sum of its parts by error source."""
    sources: cython.Py_ssize_t = stack.shape[0] - rows + 1
    size: cython.Py_ssize_t = stack.shape[1] * stack.shape[2]
    check("stack", rows >= 1 and sources >= 1)
    result = np.empty((rows, stack.shape[1], stack.shape[2]))
    out: cython.double[:, :, ::1] = result
    start: cython.p_double = cython.cast(cython.p_double, cython.address(stack[0, 0, 0]))
    _sum(start, sources, size, cython.address(out[0, 0, 0]))
    if rows > 1:
        memcpy(cython.address(out[1, 0, 0]), start + sources * size, (rows - 1) * size * cython.sizeof(cython.double))
    return result


def total(stack: cython.const[cython.double][:, :, ::1], sources: cython.Py_ssize_t):
    """Return the covariance of the main filter, the sum of its parts, shape (n, n)."""
    check("total", 1 <= sources <= stack.shape[0])
    result = np.empty((stack.shape[1], stack.shape[2]))
    out: cython.double[:, ::1] = result
    start: cython.p_double = cython.cast(cython.p_double, cython.address(stack[0, 0, 0]))
    _sum(start, sources, stack.shape[1] * stack.shape[2], cython.address(out[0, 0]))
    return result


def variance_along(
    weights: cython.const[cython.double][::1], covariance: cython.const[cython.double][:, :]
) -> cython.double:
    """Return the variance of a weighted sum of states, from weights (n,), mostly zero, and covariance (n, n)."""
    n: cython.Py_ssize_t = weights.shape[0]
    check("variance_along", covariance.shape[0] == covariance.shape[1] == n)
    total: cython.double = 0.0
    for i in range(n):
        if weights[i] != 0.0:
            for j in range(n):
                if weights[j] != 0.0:
                    total += weights[i] * covariance[i, j] * weights[j]
    return total


def projected_variance(
    jacobian: cython.const[cython.double][:, ::1],
    covariance: cython.const[cython.double][:, ::1],
    excluded_states: cython.const[cython.double][::1],
) -> cython.double:
    """Return the trace of J P Jᵀ, the sum of the projected variances, without some states.

    Args:
        jacobian: J, shape (m, n).
        covariance: P, shape (n, n).
        excluded_states: not zero for each state that is excluded, shape (n,).
    """
    n: cython.Py_ssize_t = jacobian.shape[1]
    check("excluded_states", covariance.shape[0] == covariance.shape[1] == excluded_states.shape[0] == n)
    total: cython.double = 0.0
    along: cython.double
    for row in range(jacobian.shape[0]):
        for i in range(n):
            if excluded_states[i] != 0.0 or jacobian[row, i] == 0.0:
                continue
            along = 0.0
            for j in range(n):
                if excluded_states[j] == 0.0:
                    along += covariance[i, j] * jacobian[row, j]
            total += jacobian[row, i] * along
    return total


def innovations(
    means: cython.const[cython.double][:, ::1],
    stack: cython.const[cython.double][:, :, ::1],
    measured: cython.const[cython.double][::1],
    jacobian: cython.const[cython.double][:, ::1],
    noise: cython.const[cython.double][:, ::1],
    at_mean: cython.const[cython.double][::1],
    by_turn: cython.const[cython.double][:, ::1],
):
    """Return the innovations in all filters as fields of ``FilterInnovations``.

    Raises:
        numpy.linalg.LinAlgError: an innovation covariance is not positive definite.
    """
    rows: cython.Py_ssize_t = means.shape[0]
    n: cython.Py_ssize_t = means.shape[1]
    m: cython.Py_ssize_t = jacobian.shape[0]
    wide: cython.Py_ssize_t = n + 4
    sources: cython.Py_ssize_t = stack.shape[0] - rows + 1
    check("means", rows >= 1 and sources >= 1 and at_mean.shape[0] == n)
    check("stack", stack.shape[1] == stack.shape[2] == jacobian.shape[1] == n)
    check("measurement", measured.shape[0] == noise.shape[0] == noise.shape[1] == by_turn.shape[0] == m)
    check("by_turn", by_turn.shape[1] == 3)
    of_residual, of_covariance, of_nis = np.empty((rows, m)), np.empty((rows, m, m)), np.empty(rows)
    of_gain, of_turn, of_root = np.empty((rows, n, m)), np.empty((rows, 3)), np.empty((rows, 3, 3))
    of_noise = np.empty((3, 3))
    residual: cython.double[:, ::1] = of_residual
    innovation: cython.double[:, :, ::1] = of_covariance
    nis: cython.double[::1] = of_nis
    gain: cython.double[:, :, ::1] = of_gain
    whitened_innovation: cython.double[:, ::1] = of_turn
    root: cython.double[:, :, ::1] = of_root
    share: cython.double[:, ::1] = of_noise
    # Contiguous arrays for transposed Jacobian, right-hand side, cross covariance, Cholesky factor, solution, product
    # of solution and rotation Jacobian, information, and covariance of the main filter.
    scratch: cython.double[::1] = np.empty(n * m + wide * m + n * m + m * m + 4 * m + 12 + 9 + n * n)
    transposed: cython.p_double = cython.address(scratch[0])
    right_side: cython.p_double = transposed + n * m
    cross: cython.p_double = right_side + wide * m
    factor: cython.p_double = cross + n * m
    solved: cython.p_double = factor + m * m
    seen: cython.p_double = solved + 4 * m
    information: cython.p_double = seen + 12
    covariance: cython.p_double = information + 9
    parts: cython.p_double = cython.cast(cython.p_double, cython.address(stack[0, 0, 0]))
    h: cython.p_double = cython.cast(cython.p_double, cython.address(jacobian[0, 0]))
    turning: cython.p_double = cython.cast(cython.p_double, cython.address(by_turn[0, 0]))
    total: cython.double
    _transpose(h, m, n, transposed)
    _sum(parts, sources, n * n, covariance)
    for row in range(rows):
        for j in range(m):
            total = measured[j]
            for k in range(n):
                total -= jacobian[j, k] * (means[row, k] - at_mean[k])
            residual[row, j] = total
        if row > 0:
            covariance = parts + (sources + row - 1) * n * n
        _product(h, m, n, covariance, n, cross)
        _product(cross, m, n, transposed, m, factor)
        for i in range(m):
            for j in range(m):
                factor[i * m + j] += noise[i, j]
                innovation[row, i, j] = factor[i * m + j]
        for j in range(m):
            memcpy(right_side + j * wide, cross + j * n, n * cython.sizeof(cython.double))
            right_side[j * wide + n] = residual[row, j]
            for k in range(3):
                right_side[j * wide + n + 1 + k] = by_turn[j, k]
        if not _cholesky(factor, m):
            raise np.linalg.LinAlgError("innovation covariance is not positive definite")
        _solve(factor, m, right_side, wide)
        total = 0.0
        for j in range(m):
            for i in range(n):
                gain[row, i, j] = right_side[j * wide + i]
            for k in range(4):
                solved[k * m + j] = right_side[j * wide + n + k]
            total += residual[row, j] * solved[j]
        nis[row] = total
        _product(solved, 4, m, turning, 3, seen)
        memcpy(information, seen + 3, 9 * cython.sizeof(cython.double))
        _inverse_root(information, cython.address(root[row, 0, 0]))
        _product(seen, 1, 3, cython.address(root[row, 0, 0]), 3, cython.address(whitened_innovation[row, 0]))
        if row == 0:
            _whitened_noise(cython.address(root[0, 0, 0]), solved + m, noise, cython.address(share[0, 0]))
    return of_residual, of_covariance, of_nis, of_gain, of_turn, of_noise, of_root


@cython.cfunc
@cython.exceptval(check=False)
def _whitened_noise(
    root: cython.p_double,
    solved: cython.p_double,
    noise: cython.const[cython.double][:, ::1],
    share: cython.p_double,
) -> cython.void:
    """Write the covariance of the whitened innovation from the measurement noise alone, shape (3, 3)."""
    m: cython.Py_ssize_t = noise.shape[0]
    scratch: cython.double[::1] = np.empty(9 * m)
    weights: cython.p_double = cython.address(scratch[0])
    by_noise: cython.p_double = weights + 3 * m
    transposed: cython.p_double = by_noise + 3 * m
    _product(root, 3, 3, solved, m, weights)
    _product(weights, 3, m, cython.cast(cython.p_double, cython.address(noise[0, 0])), m, by_noise)
    _transpose(weights, 3, m, transposed)
    _product(by_noise, 3, m, transposed, 3, share)


@cython.cfunc
@cython.exceptval(check=False)
def _diagonalise(matrix: cython.p_double, vectors: cython.p_double) -> cython.void:
    """Diagonalise a symmetric 3 × 3 matrix by Jacobi rotations; write eigenvectors as columns of the other matrix."""
    k: cython.int
    off: cython.double
    angle: cython.double
    t: cython.double
    c: cython.double
    s: cython.double
    first: cython.double
    second: cython.double
    for k in range(9):
        vectors[k] = 1.0 if k % 4 == 0 else 0.0
    for _ in range(_JACOBI_SWEEPS):
        if matrix[1] == 0.0 and matrix[2] == 0.0 and matrix[5] == 0.0:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                off = matrix[3 * p + q]
                if off == 0.0:
                    continue
                angle = (matrix[4 * q] - matrix[4 * p]) / (2.0 * off)
                t = 1.0 / (fabs(angle) + sqrt(angle * angle + 1.0))
                t = -t if angle < 0.0 else t
                c = 1.0 / sqrt(t * t + 1.0)
                s = t * c
                matrix[4 * p] -= t * off
                matrix[4 * q] += t * off
                k = 3 - p - q
                first, second = matrix[3 * k + p], matrix[3 * k + q]
                matrix[3 * k + p] = matrix[3 * p + k] = c * first - s * second
                matrix[3 * k + q] = matrix[3 * q + k] = s * first + c * second
                matrix[3 * p + q] = matrix[3 * q + p] = 0.0
                for k in range(3):
                    first, second = vectors[3 * k + p], vectors[3 * k + q]
                    vectors[3 * k + p] = c * first - s * second
                    vectors[3 * k + q] = s * first + c * second


@cython.cfunc
@cython.exceptval(check=False)
def _inverse_root(matrix: cython.p_double, root: cython.p_double) -> cython.void:
    """Write the symmetric square root of the inverse of an information matrix (3 × 3), which is overwritten.

    A direction without information gets zero instead of infinity.
    """
    vectors = cython.declare(cython.double[9])
    scale = cython.declare(cython.double[3])
    largest: cython.double
    _diagonalise(matrix, vectors)
    largest = max(matrix[0], matrix[4], matrix[8])
    for k in range(3):
        scale[k] = 1.0 / sqrt(matrix[4 * k]) if matrix[4 * k] > 1e-9 * largest else 0.0
    memset(root, 0, 9 * cython.sizeof(cython.double))
    for p in range(3):
        for q in range(3):
            for k in range(3):
                root[3 * p + q] += vectors[3 * p + k] * scale[k] * vectors[3 * q + k]


def update(
    stack: cython.const[cython.double][:, :, ::1],
    jacobian: cython.const[cython.double][:, ::1],
    residual: cython.const[cython.double][:, ::1],
    gain: cython.const[cython.double][:, :, ::1],
    updated_states: cython.const[cython.uchar][:, ::1],
    noise_parts: tuple,
    noise: cython.const[cython.double][:, ::1],
):
    """Return the corrections (h, n) and the stack after a measurement update.

    Args:
        stack: covariances before the measurement, shape (n_sources + h - 1, n, n).
        jacobian: Jacobian of the measurement, shape (m, n).
        residual: residual of each filter, shape (h, m).
        gain: Kalman gain, shape (h, n, m).
        updated_states: states that each filter updates, shape (h, n).
        noise_parts: pairs of a source index and the noise covariance of this source, shape (m, m).
        noise: sum of these covariances.
    """
    rows: cython.Py_ssize_t = gain.shape[0]
    n: cython.Py_ssize_t = gain.shape[1]
    m: cython.Py_ssize_t = gain.shape[2]
    sources: cython.Py_ssize_t = stack.shape[0] - rows + 1
    check(
        "stack", sources >= 1 and stack.shape[1] == stack.shape[2] == jacobian.shape[1] == updated_states.shape[1] == n
    )
    check("measurement", jacobian.shape[0] == residual.shape[1] == noise.shape[0] == noise.shape[1] == m)
    check("rows", residual.shape[0] == updated_states.shape[0] == rows)
    result, corrections = np.empty((sources + rows - 1, n, n)), np.empty((rows, n))
    out: cython.double[:, :, ::1] = result
    correction: cython.double[:, ::1] = corrections
    own: cython.double[:, ::1] = np.empty((n, m))
    states: cython.Py_ssize_t[::1] = np.empty(n, dtype=np.intp)
    seen: cython.Py_ssize_t = _observed_states(jacobian, states)
    # If few states are observed, selecting them is cheaper than multiplying by H.
    chosen: cython.Py_ssize_t = seen if seen <= 2 * m else 0
    room: cython.double[::1] = np.empty(3 * n * max(m, chosen) + n * n + 2 * n * m)
    scratch: cython.p_double = cython.address(room[0])
    h: cython.p_double = cython.cast(cython.p_double, cython.address(jacobian[0, 0]))
    part: cython.const[cython.double][:, ::1]
    s: cython.Py_ssize_t
    total: cython.double
    for row in range(rows):
        for i in range(n):
            total = 0.0
            for j in range(m):
                own[i, j] = gain[row, i, j] if updated_states[row, i] else 0.0
                total += own[i, j] * residual[row, j]
            correction[row, i] = total
        _thin_factor(own, h, states, chosen, scratch)
        # The main filter has all parts, each subfilter one covariance.
        for s in range(sources + row - 1 if row else 0, sources + row if row else sources):
            if _is_zero(cython.address(stack[s, 0, 0]), n * n):
                memset(cython.address(out[s, 0, 0]), 0, n * n * cython.sizeof(cython.double))
                continue
            _joseph_update(
                cython.cast(cython.p_double, cython.address(stack[s, 0, 0])),
                n,
                h,
                m,
                states,
                chosen,
                scratch,
                cython.address(out[s, 0, 0]),
            )
        if row > 0:
            _add_noise(own, noise, cython.address(out[sources + row - 1, 0, 0]), room)
            continue
        for s, part in noise_parts:
            check("noise_parts", 0 <= s < sources and part.shape[0] == part.shape[1] == m)
            _add_noise(own, part, cython.address(out[s, 0, 0]), room)
    for s in range(sources + rows - 1):
        for i in range(n):
            for j in range(i):
                out[s, i, j] = out[s, j, i]
    return corrections, result


@cython.cfunc
@cython.exceptval(check=False)
def _is_zero(numbers: cython.pointer(cython.const[cython.double]), count: cython.Py_ssize_t) -> cython.bint:
    """True if all numbers are zero, as for an error source without a part in any state."""
    i: cython.Py_ssize_t = 0
    while i < count and numbers[i] == 0.0:
        i += 1
    return i == count


@cython.cfunc
@cython.exceptval(check=False)
def _observed_states(
    jacobian: cython.const[cython.double][:, ::1], states: cython.Py_ssize_t[::1]
) -> cython.Py_ssize_t:
    """Write the indices of the states with a nonzero column of H; return the number of these states."""
    count: cython.Py_ssize_t = 0
    for j in range(jacobian.shape[1]):
        for i in range(jacobian.shape[0]):
            if jacobian[i, j] != 0.0:
                states[count] = j
                count += 1
                break
    return count


@cython.cfunc
@cython.exceptval(check=False)
def _thin_factor(
    gain: cython.double[:, ::1],
    jacobian: cython.p_double,
    states: cython.Py_ssize_t[::1],
    chosen: cython.Py_ssize_t,
    scratch: cython.p_double,
) -> cython.void:
    """Write the left factor A of K H = A B into the scratch, shape (n, r), and its transpose after it.

    If ``chosen`` is zero, A is K and B is H. Otherwise A consists of the columns of K H for the observed states, and B
    selects these states.
    """
    n: cython.Py_ssize_t = gain.shape[0]
    m: cython.Py_ssize_t = gain.shape[1]
    product: cython.p_double = scratch + 2 * n * chosen
    if not chosen:
        memcpy(scratch, cython.address(gain[0, 0]), n * m * cython.sizeof(cython.double))
        _transpose(scratch, n, m, scratch + n * m)
        return
    _product(cython.address(gain[0, 0]), n, m, jacobian, n, product)
    for i in range(n):
        for k in range(chosen):
            scratch[i * chosen + k] = product[i * n + states[k]]
    _transpose(scratch, n, chosen, scratch + n * chosen)


@cython.cfunc
@cython.exceptval(check=False)
def _times_right_factor(
    jacobian: cython.p_double,
    m: cython.Py_ssize_t,
    states: cython.Py_ssize_t[::1],
    chosen: cython.Py_ssize_t,
    matrix: cython.p_double,
    n: cython.Py_ssize_t,
    out: cython.p_double,
) -> cython.void:
    """Write the right factor of K H times a matrix; this factor is H or selects the observed states."""
    if not chosen:
        _product(jacobian, m, n, matrix, n, out)
    for k in range(chosen):
        memcpy(out + k * n, matrix + states[k] * n, n * cython.sizeof(cython.double))


@cython.cfunc
@cython.exceptval(check=False)
def _joseph_update(
    covariance: cython.p_double,
    n: cython.Py_ssize_t,
    jacobian: cython.p_double,
    m: cython.Py_ssize_t,
    states: cython.Py_ssize_t[::1],
    chosen: cython.Py_ssize_t,
    scratch: cython.p_double,
    out: cython.p_double,
) -> cython.void:
    """Write the upper triangle of (I - A B) P (I - A B)ᵀ, with A from :func:`_thin_factor` in the scratch."""
    r: cython.Py_ssize_t = chosen or m
    transposed: cython.p_double = scratch + n * r
    across: cython.p_double = transposed + n * r
    halfway: cython.p_double = across + n * r
    # P is symmetric, so the transpose of B P is P Bᵀ.
    _times_right_factor(jacobian, m, states, chosen, covariance, n, across)
    memcpy(halfway, covariance, n * n * cython.sizeof(cython.double))
    for i in range(n):
        _add_rows(halfway + i * n, -1.0, across + i, n, r, transposed, n, n)
    _times_right_factor(jacobian, m, states, chosen, halfway, n, across)
    for i in range(n):
        memcpy(out + i * n + i, halfway + i * n + i, (n - i) * cython.sizeof(cython.double))
        _add_rows(out + i * n + i, -1.0, scratch + i * r, 1, r, across + i, n, n - i)


@cython.cfunc
@cython.exceptval(check=False)
def _add_noise(
    gain: cython.double[:, ::1],
    noise: cython.const[cython.double][:, ::1],
    out: cython.p_double,
    scratch: cython.double[::1],
) -> cython.void:
    """Add K N Kᵀ to the upper triangle of a covariance; the end of the scratch is overwritten."""
    n: cython.Py_ssize_t = gain.shape[0]
    m: cython.Py_ssize_t = gain.shape[1]
    transposed: cython.p_double = cython.address(scratch[scratch.shape[0] - 2 * n * m])
    by_noise: cython.p_double = transposed + n * m
    _transpose(cython.address(gain[0, 0]), n, m, transposed)
    _product(cython.cast(cython.p_double, cython.address(noise[0, 0])), m, m, transposed, n, by_noise)
    for i in range(n):
        _add_rows(out + i * n + i, 1.0, cython.address(gain[i, 0]), 1, m, by_noise + i, n, n - i)


@cython.cfunc
@cython.exceptval(check=False)
def _solve_beacon(
    matrix: cython.p_double, size: cython.Py_ssize_t, right_side: cython.p_double, columns: cython.Py_ssize_t
) -> cython.bint:
    """Replace the right-hand side b (size × columns) by A⁻¹ b, with the Cholesky factor of the symmetric matrix A.

    The matrix is overwritten. The result is False if the matrix has NaN or is not positive definite.
    """
    factor: cython.double
    for i in range(size):
        for j in range(i):
            factor = matrix[i * size + j]
            for k in range(j):
                factor -= matrix[i * size + k] * matrix[j * size + k]
            matrix[i * size + j] = factor / matrix[j * size + j]
        factor = matrix[i * size + i]
        for k in range(i):
            factor -= matrix[i * size + k] * matrix[i * size + k]
        if not factor > 0.0:
            return False
        matrix[i * size + i] = sqrt(factor)
    for i in range(size):
        for k in range(i):
            factor = matrix[i * size + k]
            for j in range(columns):
                right_side[i * columns + j] -= factor * right_side[k * columns + j]
        for j in range(columns):
            right_side[i * columns + j] /= matrix[i * size + i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            factor = matrix[k * size + i]
            for j in range(columns):
                right_side[i * columns + j] -= factor * right_side[k * columns + j]
        for j in range(columns):
            right_side[i * columns + j] /= matrix[i * size + i]
    return True


@cython.cfunc
@cython.exceptval(check=False)
def _select_components(
    is_selected: cython.const[cython.uchar][:], covariance: cython.p_double, places: cython.p_int, out: cython.p_double
) -> cython.int:
    """Return the number of selected components; write their indices to ``places`` and their covariance to ``out``."""
    size: cython.int = is_selected.shape[0]
    count: cython.int = 0
    for i in range(size):
        if is_selected[i]:
            places[count] = i
            count += 1
    for i in range(count):
        for j in range(count):
            out[i * count + j] = covariance[places[i] * size + places[j]]
    return count


@cython.cfunc
@cython.exceptval(check=False)
def _whiten_beacon(
    beacon: cython.int,
    conditioning: cython.const[cython.uchar][:],
    residual: cython.p_double,
    covariance: cython.p_double,
    places: cython.p_int,
    scratch: cython.p_double,
    whitened_innovation: cython.p_double,
) -> cython.bint:
    """Whiten a beacon's residual conditioned on ``conditioning``; return False if :func:`_solve_beacon` fails."""
    size: cython.int = conditioning.shape[0]
    count: cython.int = _select_components(conditioning, covariance, places, scratch)
    # Columns for the conditioning components: covariance with the beacon's two components, and residual.
    right_side: cython.p_double = scratch + count * count
    left = cython.declare(cython.double[2])
    own = cython.declare(cython.double[4])
    area: cython.double
    scale: cython.double
    for i in range(count):
        for j in range(2):
            right_side[3 * i + j] = covariance[places[i] * size + 2 * beacon + j]
        right_side[3 * i + 2] = residual[places[i]]
    if not _solve_beacon(scratch, count, right_side, 3):
        return False
    for i in range(2):
        left[i] = residual[2 * beacon + i]
        for j in range(2):
            own[2 * i + j] = covariance[(2 * beacon + i) * size + 2 * beacon + j]
        for k in range(count):
            for j in range(2):
                own[2 * i + j] -= covariance[(2 * beacon + i) * size + places[k]] * right_side[3 * k + j]
            left[i] -= covariance[(2 * beacon + i) * size + places[k]] * right_side[3 * k + 2]
    # The residual is multiplied by the inverse of the symmetric root of the conditional covariance.
    area = sqrt(own[0] * own[3] - own[1] * own[1])
    scale = 1.0 / (area * sqrt(own[0] + own[3] + 2.0 * area))
    whitened_innovation[0] = scale * ((own[3] + area) * left[0] - own[1] * left[1])
    whitened_innovation[1] = scale * ((own[0] + area) * left[1] - own[1] * left[0])
    whitened_innovation[2] = 0.0
    return True


def beacon_innovations(
    separation: cython.const[cython.double][:, ::1],
    parts: cython.const[cython.double][:, :, ::1],
    residual: cython.const[cython.double][::1],
    jacobian: cython.const[cython.double][:, ::1],
    noise: cython.const[cython.double][:, ::1],
    main_covariance: cython.const[cython.double][:, ::1],
    uses: cython.const[cython.uchar][:, ::1],
    conditioning: cython.const[cython.uchar][:, :, ::1],
):
    """Return the innovations of a sighting of l beacons, with m = 2 l components, in h subfilters of n states.

    Args:
        separation: states of each subfilter minus states of the main filter, shape (h, n).
        parts: covariance of each subfilter, symmetric, shape (h, n, n).
        residual: residual of the main filter, shape (m,).
        jacobian: derivative of the prediction with respect to the states, shape (m, n).
        noise: covariance of the sighting's noise, shape (m, m).
        main_covariance: covariance of the main filter's residual, shape (m, m).
        uses: components that each subfilter uses, shape (h, m).
        conditioning: components that condition the innovation of each beacon, in the main filter and in every
            subfilter, shape (l, h + 1, m).

    Returns:
        Residual of each subfilter, zero for unused components, shape (h, m).
        Optimal gain for the used components, shape (h, n, m).
        Normalised innovation squared of the used components, shape (h,).
        Whitened residual of each beacon in the main filter and in every subfilter, with a trailing zero, shape
        (h + 1, l, 3).

    Raises:
        numpy.linalg.LinAlgError: the covariance of the conditioning or of the used components is not positive definite.
    """
    subfilters: cython.Py_ssize_t = separation.shape[0]
    n: cython.Py_ssize_t = separation.shape[1]
    m: cython.Py_ssize_t = residual.shape[0]
    beacons: cython.Py_ssize_t = conditioning.shape[0]
    check("rows", parts.shape[0] == uses.shape[0] == subfilters and conditioning.shape[1] == subfilters + 1)
    check("states", parts.shape[1] == parts.shape[2] == jacobian.shape[1] == n)
    check("components", jacobian.shape[0] == uses.shape[1] == conditioning.shape[2] == 2 * beacons == m)
    check("noise", noise.shape[0] == noise.shape[1] == main_covariance.shape[0] == main_covariance.shape[1] == m)
    of_residuals, of_gains = np.zeros((subfilters, m)), np.zeros((subfilters, n, m))
    of_nis, innovation_array = np.empty(subfilters), np.empty((subfilters + 1, beacons, 3))
    residuals: cython.double[:, ::1] = of_residuals
    gains: cython.double[:, :, ::1] = of_gains
    nis: cython.double[::1] = of_nis
    innovations: cython.double[:, :, ::1] = innovation_array
    places: cython.int[::1] = np.empty(max(m, 1), dtype=np.intc)
    # Arrays of one subfilter: residual, its covariance, covariance with the states, scratch matrix, right-hand side.
    room: cython.double[::1] = np.empty(m + m * m + m * n + m * m + m * max(n + 1, 3) + 1)
    subfilter_residual: cython.p_double = cython.address(room[0])
    covariance: cython.p_double = subfilter_residual + m
    cross: cython.p_double = covariance + m * m
    scratch: cython.p_double = cross + m * n
    right_side: cython.p_double
    total: cython.double
    count: cython.Py_ssize_t
    if m == 0:
        of_nis[:] = 0.0
        return of_residuals, of_gains, of_nis, innovation_array
    for subfilter in range(-1, subfilters):
        for i in range(m):
            subfilter_residual[i] = residual[i]
            for j in range(m):
                covariance[i * m + j] = main_covariance[i, j] if subfilter < 0 else noise[i, j]
            if subfilter < 0:
                continue
            for k in range(n):
                cross[i * n + k] = 0.0
            for j in range(n):
                total = jacobian[i, j]
                if total == 0.0:
                    continue
                subfilter_residual[i] -= total * separation[subfilter, j]
                for k in range(n):
                    cross[i * n + k] += total * parts[subfilter, j, k]
            for j in range(m):
                for k in range(n):
                    covariance[i * m + j] += cross[i * n + k] * jacobian[j, k]
        for beacon in range(beacons):
            if not _whiten_beacon(
                beacon,
                conditioning[beacon, subfilter + 1],
                subfilter_residual,
                covariance,
                cython.address(places[0]),
                scratch,
                cython.address(innovations[subfilter + 1, beacon, 0]),
            ):
                raise np.linalg.LinAlgError("beacon covariance is not positive definite")
        if subfilter < 0:
            continue
        count = _select_components(uses[subfilter], covariance, cython.address(places[0]), scratch)
        right_side = scratch + count * count
        for i in range(count):
            for k in range(n):
                right_side[i * (n + 1) + k] = cross[places[i] * n + k]
            right_side[i * (n + 1) + n] = residuals[subfilter, places[i]] = subfilter_residual[places[i]]
        if not _solve_beacon(scratch, count, right_side, n + 1):
            raise np.linalg.LinAlgError("innovation covariance is not positive definite")
        nis[subfilter] = 0.0
        for i in range(count):
            for k in range(n):
                gains[subfilter, k, places[i]] = right_side[i * (n + 1) + k]
            nis[subfilter] += subfilter_residual[places[i]] * right_side[i * (n + 1) + n]
    return of_residuals, of_gains, of_nis, innovation_array

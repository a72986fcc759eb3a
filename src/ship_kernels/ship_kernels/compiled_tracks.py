# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled interpolation and fit of cubics to a few samples.

The interpolation, with its error from the polynomial through all samples, is described in
:mod:`ship_geometry.tracks.interpolation_error` and :mod:`ship_geometry.tracks.sample_track`. In the least-squares
cubics, which are evaluated at zero or have a step, the powers of the times are made orthonormal one after another, so
that no matrix is inverted.
"""

import cython
import numpy as np

from ship_kernels import FloatArray
from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import INFINITY, rint, sqrt


@cython.cfunc
@cython.exceptval(check=False)
def _polynomial_error(
    nodes: cython.p_double,
    values: cython.p_double,
    count: cython.Py_ssize_t,
    width: cython.Py_ssize_t,
    at: cython.double,
    found: cython.p_double,
    next_term_share: cython.double,
    out: cython.p_double,
) -> cython.void:
    """Write the value of Newton's polynomial minus ``found``, and a share of the polynomial's last term.

    ``values`` is overwritten.
    """
    product: cython.double = 1.0
    term: cython.double = 0.0
    for order in range(1, count):
        for row in range(count - 1, order - 1, -1):
            for i in range(width):
                values[row * width + i] = (values[row * width + i] - values[(row - 1) * width + i]) / (
                    nodes[row] - nodes[row - order]
                )
    for i in range(width):
        out[i] = 0.0
    for row in range(count):
        for i in range(width):
            term = values[row * width + i] * product
            out[i] += term
            out[width + i] = next_term_share * term
        product *= at - nodes[row]
    for i in range(width):
        out[i] -= found[i]


def polynomial_errors(
    nodes: cython.const[cython.double][:],
    values: cython.const[cython.double][:, :],
    at: cython.double,
    found: cython.const[cython.double][:],
    next_term_share: cython.double,
) -> FloatArray:
    """Return ``interpolation_error.polynomial_errors`` for three samples or more, shape (2, k).

    Args:
        nodes: times of the samples, shape (n,), n at most 8.
        values: values of the samples, shape (n, k).
        at: time of the interpolated value.
        found: the interpolated value, shape (k,).
        next_term_share: share of the polynomial's last term that estimates the missing terms.
    """
    count: cython.Py_ssize_t = values.shape[0]
    width: cython.Py_ssize_t = values.shape[1]
    check("samples", nodes.shape[0] == count and 1 < count <= 8)  # size of the arrays below
    check("values", found.shape[0] == width)
    # The samples, followed by the interpolated value.
    room: cython.double[::1] = np.empty((count + 1) * width + 1)
    places = cython.declare(cython.double[8])
    errors = np.empty((2, width))
    out: cython.double[:, ::1] = errors
    if width == 0:
        return errors
    for row in range(count):
        places[row] = nodes[row]
        for i in range(width):
            room[row * width + i] = values[row, i]
    for i in range(width):
        room[count * width + i] = found[i]
    _polynomial_error(
        places,
        cython.address(room[0]),
        count,
        width,
        at,
        cython.address(room[count * width]),
        next_term_share,
        cython.address(out[0, 0]),
    )
    return errors


def interpolate_vector(
    times_ns: cython.const[cython.longlong][:],
    vectors: cython.const[cython.double][:, :],
    left: cython.Py_ssize_t,
    time_ns: cython.longlong,
    period: cython.double,
    value0: cython.double,
    slope0: cython.double,
    value1: cython.double,
    slope1: cython.double,
    next_term_share: cython.double,
    any_direction: cython.double,
):
    """Interpolate a vector between two adjacent samples of a short sequence without a gap.

    Args:
        times_ns: stamps of the samples: both ends of the interval, at most two before and one after it, shape (n,).
        vectors: vectors of the samples, shape (n, k).
        left: index of the sample at which the interval begins.
        time_ns: time of the interpolated vector.
        period: period of all components; infinite for lengths.
        value0: weight of the value at the start, from :func:`ship_geometry.tracks.sample_track.hermite_weights`.
        slope0: weight of the slope at the start.
        value1: weight of the value at the end.
        slope1: weight of the slope at the end.
        next_term_share: share of the polynomial's last term that estimates the missing terms.
        any_direction: :data:`ship_geometry.tracks.interpolation_error.ANY_DIRECTION`.

    Returns:
        The vector, shape (k,).
        The variance of the vector, divided by the variance of the samples' noise.
        The covariance of the interpolation error, shape (k, k).
    """
    count: cython.Py_ssize_t = vectors.shape[0]
    width: cython.Py_ssize_t = vectors.shape[1]
    check("samples", times_ns.shape[0] == count and 0 <= left <= 2 and left + 1 < count <= left + 3)
    interval_ns: cython.longlong = times_ns[left + 1] - times_ns[left]
    fraction: cython.double = cython.cast(cython.double, time_ns - times_ns[left]) / interval_ns
    # Samples to which the change from the start of the interval is computed: both ends of the interval, and, if they
    # exist, the sample before, the sample after and the second sample before.
    around = cython.declare(cython.Py_ssize_t[5])
    nodes = cython.declare(cython.double[5])
    rows: cython.Py_ssize_t = 2
    around[0], around[1] = left, left + 1
    before: cython.Py_ssize_t = left - 1 if left > 0 else left
    after: cython.Py_ssize_t = left + 2 if left + 2 < count else left + 1
    if left > 0:
        around[rows] = left - 1
        rows += 1
    if left + 2 < count:
        around[rows] = left + 2
        rows += 1
    if left > 1:
        around[rows] = left - 2
        rows += 1
    vector, covariance = np.empty(width), np.empty((width, width))
    result: cython.double[::1] = vector
    out: cython.double[:, ::1] = covariance
    room: cython.double[::1] = np.zeros(8 * width + 1)
    changes: cython.p_double = cython.address(room[0])
    change: cython.p_double = changes + rows * width
    errors: cython.p_double = change + width
    slope_before: cython.double
    slope_after: cython.double
    squares: cython.double = 0.0
    for row in range(rows):
        nodes[row] = cython.cast(cython.double, times_ns[around[row]] - times_ns[left]) / interval_ns
        for i in range(width):
            changes[row * width + i] = _change(vectors, left, around[row], i, period)
    for i in range(width):
        slope_before = _change(vectors, before, left + 1, i, period) * _share(times_ns, left, before, left + 1)
        slope_after = _change(vectors, left, after, i, period) * _share(times_ns, left, left, after)
        change[i] = slope0 * slope_before + value1 * changes[width + i] + slope1 * slope_after
        result[i] = vectors[left, i] + change[i]
    if rows == 2:
        # Without other samples: error of a straight line if the rate changes from 0.5 to 1.5 times its mean.
        for i in range(width):
            errors[i] = 0.5 * fraction * (1.0 - fraction) * changes[width + i]
    else:
        _polynomial_error(nodes, changes, rows, width, fraction, change, next_term_share, errors)
    for i in range(2 * width):
        squares += errors[i] * errors[i]
    for i in range(width):
        for j in range(width):
            out[i, j] = errors[i] * errors[j] + errors[width + i] * errors[width + j]
        out[i, i] += any_direction * any_direction * squares
    return vector, _noise_gain(times_ns, left, before, after, value0, slope0, value1, slope1), covariance


@cython.cfunc
@cython.exceptval(check=False)
def _change(
    vectors: cython.const[cython.double][:, :],
    first: cython.Py_ssize_t,
    last: cython.Py_ssize_t,
    component: cython.Py_ssize_t,
    period: cython.double,
) -> cython.double:
    """Return the change of a component from one sample to another.

    Whole periods are removed from each step between neighbouring samples.
    """
    change: cython.double = 0.0
    step: cython.double
    for i in range(min(first, last), max(first, last)):
        step = vectors[i + 1, component] - vectors[i, component]
        change += step if period == INFINITY else step - period * rint(step / period)
    return -change if last < first else change


@cython.cfunc
@cython.exceptval(check=False)
def _share(
    times_ns: cython.const[cython.longlong][:],
    left: cython.Py_ssize_t,
    before: cython.Py_ssize_t,
    after: cython.Py_ssize_t,
) -> cython.double:
    """Return the length of the interval that begins at ``left``, divided by the time between two samples."""
    return cython.cast(cython.double, times_ns[left + 1] - times_ns[left]) / (times_ns[after] - times_ns[before])


@cython.cfunc
@cython.exceptval(check=False)
def _noise_gain(
    times_ns: cython.const[cython.longlong][:],
    left: cython.Py_ssize_t,
    before: cython.Py_ssize_t,
    after: cython.Py_ssize_t,
    value0: cython.double,
    slope0: cython.double,
    value1: cython.double,
    slope1: cython.double,
) -> cython.double:
    """Return the sum of the squared weights of the samples."""
    share0: cython.double = slope0 * _share(times_ns, left, before, left + 1)
    share1: cython.double = slope1 * _share(times_ns, left, left, after)
    weight0: cython.double = value0 - share1
    weight1: cython.double = value1 + share0
    outer0: cython.double = 0.0
    outer1: cython.double = 0.0
    if before == left:
        weight0 -= share0
    else:
        outer0 = -share0
    if after == left + 1:
        weight1 += share1
    else:
        outer1 = share1
    return weight0 * weight0 + weight1 * weight1 + outer0 * outer0 + outer1 * outer1


@cython.cfunc
@cython.exceptval(check=False)
def _orthonormal(
    since: cython.p_double, count: cython.Py_ssize_t, basis: cython.p_double, at_zero: cython.p_double
) -> cython.void:
    """Compute four orthonormal polynomials up to the cubic: values at some times, one polynomial a row, and at zero."""
    product: cython.double
    for j in range(4):
        at_zero[j] = 1.0 if j == 0 else 0.0
        for i in range(count):
            basis[j * count + i] = 1.0 if j == 0 else basis[(j - 1) * count + i] * since[i]
        # Each polynomial starts as the previous one times the time, and is orthogonalised twice, against rounding.
        for _ in range(2):
            for k in range(j):
                product = 0.0
                for i in range(count):
                    product += basis[j * count + i] * basis[k * count + i]
                for i in range(count):
                    basis[j * count + i] -= product * basis[k * count + i]
                at_zero[j] -= product * at_zero[k]
        product = 0.0
        for i in range(count):
            product += basis[j * count + i] * basis[j * count + i]
        product = 1.0 / sqrt(product)
        at_zero[j] *= product
        for i in range(count):
            basis[j * count + i] *= product


def weights_at_zero(since: cython.double[::1]) -> FloatArray:
    """Return the weight of each value in the least-squares cubic at zero, shape (N,).

    Args:
        since: times of the values, at least four different times, of order one, shape (N,).
    """
    count: cython.Py_ssize_t = since.shape[0]
    basis: cython.double[:, ::1] = np.empty((4, count))
    at_zero: cython.double[::1] = np.empty(4)
    found: FloatArray = np.zeros(count)
    weights: cython.double[::1] = found
    check("times", count >= 4)
    _orthonormal(cython.address(since[0]), count, cython.address(basis[0, 0]), cython.address(at_zero[0]))
    for j in range(4):
        for i in range(count):
            weights[i] += at_zero[j] * basis[j, i]
    return found


def clearest_step(
    since: cython.double[::1], values: cython.double[:, ::1], before: cython.Py_ssize_t
) -> tuple[cython.Py_ssize_t, FloatArray, cython.double, cython.double]:
    """Return the step that, in addition to a cubic, most reduces the squared residuals of some vectors.

    Args:
        since: times of the vectors, of order one, in ascending order, shape (N,).
        values: the vectors, shape (N, 3).
        before: minimum number of vectors before a step; fewer than N.

    Returns:
        Index of the first vector after the step; the step, shape (3,); the ratio of a vector's noise variance to the
            step's variance; and the sum of squared residuals with cubic and step.
    """
    count: cython.Py_ssize_t = since.shape[0]
    check("vectors", values.shape[0] == count and values.shape[1] == 3 and 0 < before < count)
    basis: cython.double[:, ::1] = np.empty((4, count))
    left: cython.double[:, ::1] = np.array(values)
    at_zero: cython.double[::1] = np.empty(4)
    step: cython.double[::1] = np.empty(3)
    found: FloatArray = np.zeros(3)
    clearest: cython.double[::1] = found
    place: cython.Py_ssize_t = before
    product: cython.double
    weight: cython.double
    explained: cython.double
    squares: cython.double = 0.0
    most: cython.double = -1.0
    of_most: cython.double = 1.0
    _orthonormal(cython.address(since[0]), count, cython.address(basis[0, 0]), cython.address(at_zero[0]))
    for k in range(3):
        for j in range(4):
            product = 0.0
            for i in range(count):
                product += basis[j, i] * values[i, k]
            for i in range(count):
                left[i, k] -= product * basis[j, i]
        for i in range(count):
            squares += left[i, k] * left[i, k]
    for first in range(before, count):
        # Unit step minus its projection on the polynomials: the square, then the product with the residuals.
        weight = count - first
        for j in range(4):
            product = 0.0
            for i in range(first, count):
                product += basis[j, i]
            weight -= product * product
        explained = 0.0
        for k in range(3):
            product = 0.0
            for i in range(first, count):
                product += left[i, k]
            step[k] = product / weight
            explained += weight * step[k] * step[k]
        if explained > most:
            most, of_most, place = explained, weight, first
            for k in range(3):
                clearest[k] = step[k]
    return place, found, of_most, squares - most

# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled rotations and angles of attitudes, mostly of single ones, because a live node mostly computes these.

Numpy is efficient for arrays only. :mod:`ship_geometry.rotations` has the exponential, its Jacobian and the logarithm
for arrays, with which the tests compare these functions. Angles and quaternions are described in
:mod:`ship_geometry.frames`.
"""

import cython
import numpy as np

from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import M_PI, NAN, atan2, copysign, cos, exp, fabs, hypot, sin, sqrt, tan
from cython.cimports.libc.string import memcpy

_SMALL_ANGLE = cython.declare(cython.double, 1e-4)
"""Angle below which the series are exact to the last bit of a double, rad."""


@cython.cfunc
@cython.exceptval(check=False)
def _polynomial(
    v: cython.p_double, linear: cython.double, quadratic: cython.double, out: cython.p_double
) -> cython.void:
    """Write identity + linear [v x] + quadratic [v x]²."""
    x: cython.double = v[0]
    y: cython.double = v[1]
    z: cython.double = v[2]
    xx: cython.double = quadratic * x * x
    yy: cython.double = quadratic * y * y
    zz: cython.double = quadratic * z * z
    xy: cython.double = quadratic * x * y
    xz: cython.double = quadratic * x * z
    yz: cython.double = quadratic * y * z
    out[0], out[1], out[2] = 1.0 - yy - zz, xy - linear * z, xz + linear * y
    out[3], out[4], out[5] = xy + linear * z, 1.0 - xx - zz, yz - linear * x
    out[6], out[7], out[8] = xz - linear * y, yz + linear * x, 1.0 - xx - yy


@cython.cfunc
@cython.exceptval(check=False)
def _exponential(v: cython.p_double, out: cython.p_double) -> cython.void:
    squared: cython.double = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle: cython.double
    half_sine: cython.double
    if squared < _SMALL_ANGLE * _SMALL_ANGLE:
        _polynomial(v, 1.0 - squared / 6.0, 0.5 - squared / 24.0, out)
        return
    angle = sqrt(squared)
    half_sine = sin(0.5 * angle)
    _polynomial(v, sin(angle) / angle, 2.0 * half_sine * half_sine / squared, out)


@cython.cfunc
@cython.exceptval(check=False)
def _jacobian(v: cython.p_double, out: cython.p_double) -> cython.void:
    squared: cython.double = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle: cython.double
    half_sine: cython.double
    if squared < _SMALL_ANGLE * _SMALL_ANGLE:
        _polynomial(v, 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0, out)
        return
    angle = sqrt(squared)
    half_sine = sin(0.5 * angle)
    _polynomial(v, 2.0 * half_sine * half_sine / squared, (angle - sin(angle)) / (squared * angle), out)


def exponential(vector: cython.const[cython.double][:]):
    """Return :func:`ship_geometry.rotations.exp_rotation` of one vector."""
    check("vector", vector.shape[0] == 3)
    v = cython.declare(cython.double[3])
    v[0], v[1], v[2] = vector[0], vector[1], vector[2]
    rotation = np.empty((3, 3))
    out: cython.double[:, ::1] = rotation
    _exponential(v, cython.address(out[0, 0]))
    return rotation


def jacobian(vector: cython.const[cython.double][:]):
    """Return :func:`ship_geometry.rotations.left_jacobian` of one vector."""
    check("vector", vector.shape[0] == 3)
    v = cython.declare(cython.double[3])
    v[0], v[1], v[2] = vector[0], vector[1], vector[2]
    matrix = np.empty((3, 3))
    out: cython.double[:, ::1] = matrix
    _jacobian(v, cython.address(out[0, 0]))
    return matrix


@cython.cfunc
@cython.exceptval(check=False)
def _logarithm(rotation: cython.p_double, out: cython.p_double) -> cython.void:
    """Write the rotation vector of a rotation matrix R.

    The axis n is computed from the antisymmetric part of R. If the angle t is near half a turn, n is computed from
    R + Rᵀ = 2 cos t I + 2 (1 - cos t) n nᵀ.
    """
    cosine: cython.double = 0.5 * (rotation[0] + rotation[4] + rotation[8] - 1.0)
    x: cython.double = rotation[7] - rotation[5]
    y: cython.double = rotation[2] - rotation[6]
    z: cython.double = rotation[3] - rotation[1]
    sine: cython.double = 0.5 * sqrt(x * x + y * y + z * z)
    angle: cython.double
    scale: cython.double
    k: cython.int = 0
    if not cosine < -0.9:
        scale = 0.5 + sine * sine / 12.0 if sine < _SMALL_ANGLE else 0.5 * atan2(sine, cosine) / sine
        out[0], out[1], out[2] = scale * x, scale * y, scale * z
        return
    angle = atan2(sine, cosine)
    for i in range(1, 3):
        if rotation[4 * i] > rotation[4 * k]:
            k = i
    for i in range(3):
        out[i] = 0.5 * (rotation[3 * i + k] + rotation[3 * k + i])
    out[k] -= cos(angle)
    scale = angle / sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if out[0] * x + out[1] * y + out[2] * z < 0.0:
        scale = -scale
    for i in range(3):
        out[i] *= scale


@cython.cfunc
@cython.exceptval(check=False)
def _copy(matrix: cython.const[cython.double][:, :], out: cython.p_double) -> cython.void:
    """Copy the nine elements of a 3 × 3 matrix of any memory layout, row by row."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = matrix[i, j]


def logarithm(rotation: cython.const[cython.double][:, :]):
    """Return :func:`ship_geometry.rotations.log_rotation` of one matrix."""
    check("rotation", rotation.shape[0] == rotation.shape[1] == 3)
    matrix = cython.declare(cython.double[9])
    vector = np.empty(3)
    out: cython.double[::1] = vector
    _copy(rotation, matrix)
    _logarithm(matrix, cython.address(out[0]))
    return vector


@cython.cfunc
@cython.exceptval(check=False)
def _times(left: cython.p_double, right: cython.p_double, out: cython.p_double) -> cython.void:
    """Write the product of two 3 × 3 matrices."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = left[3 * i] * right[j] + left[3 * i + 1] * right[3 + j] + left[3 * i + 2] * right[6 + j]


def cumulative_rotations(rotation: cython.const[cython.double][:, :], vectors: cython.const[cython.double][:, :]):
    """Return the rotation after each of N successive rotation vectors about the rotated axes, shape (N, 3, 3).

    Args:
        rotation: rotation before the first vector, shape (3, 3).
        vectors: rotation vectors, rad, shape (N, 3).
    """
    count: cython.Py_ssize_t = vectors.shape[0]
    check("rotation", rotation.shape[0] == rotation.shape[1] == 3 and vectors.shape[1] == 3)
    of_rotations = np.empty((count, 3, 3))
    reached: cython.double[:, :, ::1] = of_rotations
    before = cython.declare(cython.double[9])
    vector = cython.declare(cython.double[3])
    turn = cython.declare(cython.double[9])
    _copy(rotation, before)
    for n in range(count):
        for i in range(3):
            vector[i] = vectors[n, i]
        _exponential(vector, turn)
        _times(before, turn, cython.address(reached[n, 0, 0]))
        for i in range(9):
            before[i] = reached[n, i // 3, i % 3]
    return of_rotations


def differences(
    rotations: cython.const[cython.double][:, :, :],
    others: cython.const[cython.double][:, :, :],
    turn: cython.const[cython.double][:, :],
):
    """Return the rotation vectors of R Oᵀ T, for N rotations R and O, in the left frame of R, rad, shape (N, 3).

    The left frame of a rotation is the frame into which the rotation transforms vectors.

    Args:
        rotations: R, shape (N, 3, 3).
        others: O, with another left frame than R, shape (N, 3, 3).
        turn: T, approximate rotation from the left frame of R to the left frame of O, shape (3, 3).
    """
    count: cython.Py_ssize_t = rotations.shape[0]
    check("rotations", rotations.shape[1] == rotations.shape[2] == others.shape[1] == others.shape[2] == 3)
    check("differences", others.shape[0] == count and turn.shape[0] == turn.shape[1] == 3)
    of_vectors = np.empty((count, 3))
    vectors: cython.double[:, ::1] = of_vectors
    across = cython.declare(cython.double[9])
    turned = cython.declare(cython.double[9])
    for n in range(count):
        for i in range(3):
            for j in range(3):
                across[3 * i + j] = (
                    rotations[n, i, 0] * others[n, j, 0]
                    + rotations[n, i, 1] * others[n, j, 1]
                    + rotations[n, i, 2] * others[n, j, 2]
                )
        for i in range(3):
            for j in range(3):
                turned[3 * i + j] = (
                    across[3 * i] * turn[0, j] + across[3 * i + 1] * turn[1, j] + across[3 * i + 2] * turn[2, j]
                )
        _logarithm(turned, cython.address(vectors[n, 0]))
    return of_vectors


@cython.cfunc
@cython.exceptval(check=False)
def _transposed_times(left: cython.p_double, right: cython.p_double, out: cython.p_double) -> cython.void:
    """Write the product of the transpose of a 3 × 3 matrix and another 3 × 3 matrix."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = left[i] * right[j] + left[3 + i] * right[3 + j] + left[6 + i] * right[6 + j]


def composed_attitude(
    mean: cython.const[cython.double][::1],
    links: cython.const[cython.Py_ssize_t][::1],
    after: cython.const[cython.double][:, :, ::1],
    base_link: cython.Py_ssize_t,
    white: cython.Py_ssize_t,
    white_scale: cython.double,
    clocks: cython.const[cython.Py_ssize_t][::1],
    signs: cython.const[cython.double][::1],
    base: cython.const[cython.double][:, :],
    rate: cython.const[cython.double][:],
    base_error: cython.const[cython.double][:, :],
):
    """Return the attitude composed of a rotating base and a sequence of rotations (links), with its derivatives.

    The product is formed from right to left. Each link adds the rotation exp(v) of three states v, and a fixed rotation
    to the left of exp(v). To the left of the fixed rotation of the link ``base_link``, the base is added.

    Args:
        mean: all states, shape (n,).
        links: index of the first of the three states of each link, shape (k,).
        after: fixed rotation of each link, shape (k, 3, 3).
        base_link: index of the link after which the base is added.
        white: index of the link whose states are multiplied by ``white_scale``.
        white_scale: factor of the states of the link ``white``.
        clocks: indices of the states whose sum shifts the time of the base, s, shape (c,).
        signs: sign of each of these states in the sum, shape (c,).
        base: attitude of the base, shape (3, 3).
        rate: angular velocity about the axes of the base, rad/s, shape (3,).
        base_error: covariance of the error of the base about the axes of the base, rad², shape (3, 3).

    Returns:
        The attitude, shape (3, 3).
        Derivative of the attitude, as rotation vector in its right frame, with respect to the states, shape (3, n).
        Covariance of the error of the base in the right frame, rad², shape (3, 3).
    """
    n: cython.Py_ssize_t = mean.shape[0]
    count: cython.Py_ssize_t = links.shape[0]
    check("after", after.shape[0] == count and after.shape[1] == after.shape[2] == 3)
    check("links", 0 <= base_link < count and 0 <= white < count)
    check("clocks", clocks.shape[0] == signs.shape[0])
    check("base", base.shape[0] == base.shape[1] == base_error.shape[0] == base_error.shape[1] == rate.shape[0] == 3)
    of_attitude, of_jacobian, of_error = np.empty((3, 3)), np.zeros((3, n)), np.empty((3, 3))
    jacobian: cython.double[:, ::1] = of_jacobian
    attitude: cython.double[:, ::1] = of_attitude
    error: cython.double[:, ::1] = of_error
    vector = cython.declare(cython.double[3])
    turn = cython.declare(cython.double[9])
    by_vector = cython.declare(cython.double[9])
    turned = cython.declare(cython.double[9])
    product = cython.declare(cython.double[9])
    from_link = cython.declare(cython.double[9])
    on_base = cython.declare(cython.double[9])
    scale: cython.double
    for k in range(count):
        check("links", 0 <= links[k] <= n - 3)
        scale = white_scale if k == white else 1.0
        for i in range(3):
            vector[i] = scale * mean[links[k] + i]
        _exponential(vector, turn)
        _jacobian(vector, by_vector)
        if k == 0:
            memcpy(turned, turn, 9 * cython.sizeof(cython.double))
        else:
            _times(turn, product, turned)
        _transposed_times(turned, by_vector, turn)
        for i in range(3):
            for j in range(3):
                jacobian[i, links[k] + j] = scale * turn[3 * i + j]
        _times(cython.cast(cython.p_double, cython.address(after[k, 0, 0])), turned, product)
        if k == base_link:
            memcpy(from_link, product, 9 * cython.sizeof(cython.double))
            _copy(base, on_base)
            _times(on_base, from_link, product)
    memcpy(cython.address(attitude[0, 0]), product, 9 * cython.sizeof(cython.double))
    for i in range(3):
        scale = from_link[i] * rate[0] + from_link[3 + i] * rate[1] + from_link[6 + i] * rate[2]
        for k in range(clocks.shape[0]):
            check("clocks", 0 <= clocks[k] < n)
            jacobian[i, clocks[k]] = signs[k] * scale
    _copy(base_error, on_base)
    _transposed_times(from_link, on_base, turn)
    _times(turn, from_link, cython.address(error[0, 0]))
    return of_attitude, of_jacobian, of_error


def turn_between(first: cython.const[cython.double][:, :], second: cython.const[cython.double][:, :]):
    """Return the rotation vector from one attitude to another about the axes of the first attitude, rad, shape (3,)."""
    check("attitudes", first.shape[0] == first.shape[1] == second.shape[0] == second.shape[1] == 3)
    before = cython.declare(cython.double[9])
    after = cython.declare(cython.double[9])
    product = cython.declare(cython.double[9])
    vector = np.empty(3)
    out: cython.double[::1] = vector
    _copy(first, before)
    _copy(second, after)
    _transposed_times(before, after, product)
    _logarithm(product, cython.address(out[0]))
    return vector


@cython.cfunc
@cython.exceptval(check=False)
def _inverse_times(matrix: cython.p_double, vector: cython.p_double, out: cython.p_double) -> cython.void:
    """Write the inverse of the transpose of a 3 × 3 matrix, times a vector, by Cramer's rule."""
    minors = cython.declare(cython.double[9])
    determinant: cython.double
    for i in range(3):
        for j in range(3):
            minors[3 * i + j] = (
                matrix[3 * ((i + 1) % 3) + (j + 1) % 3] * matrix[3 * ((i + 2) % 3) + (j + 2) % 3]
                - matrix[3 * ((i + 1) % 3) + (j + 2) % 3] * matrix[3 * ((i + 2) % 3) + (j + 1) % 3]
            )
    determinant = matrix[0] * minors[0] + matrix[1] * minors[1] + matrix[2] * minors[2]
    for i in range(3):
        out[i] = (
            minors[3 * i] * vector[0] + minors[3 * i + 1] * vector[1] + minors[3 * i + 2] * vector[2]
        ) / determinant


@cython.cfunc
@cython.exceptval(check=False)
def _cubic(
    first: cython.p_double,
    turn: cython.p_double,
    end_rate: cython.p_double,
    interval_s: cython.double,
    at: cython.double,
    start: cython.p_double,
    end: cython.p_double,
    vector: cython.p_double,
    rotation: cython.p_double,
    rate: cython.p_double,
) -> cython.void:
    """Evaluate the cubic of :func:`cubic`, whose slope at the start is ``start``.

    The arguments from ``end`` on are output: slope at the end, rotation vector, rotation and rate.
    """
    matrix = cython.declare(cython.double[9])
    slope = cython.declare(cython.double[3])
    _jacobian(turn, matrix)
    for i in range(3):
        slope[i] = end_rate[i] * interval_s
    # d(rotation vector)/dt = J_right^-1 rate, and J_right = J_left^T.
    _inverse_times(matrix, slope, end)
    for i in range(3):
        vector[i] = (
            at * (1.0 - at) * (1.0 - at) * start[i]
            + at * at * (3.0 - 2.0 * at) * turn[i]
            + at * at * (at - 1.0) * end[i]
        )
        slope[i] = (
            (1.0 - at) * (1.0 - 3.0 * at) * start[i] + 6.0 * at * (1.0 - at) * turn[i] + at * (3.0 * at - 2.0) * end[i]
        )
    _jacobian(vector, matrix)
    for i in range(3):
        rate[i] = (matrix[i] * slope[0] + matrix[3 + i] * slope[1] + matrix[6 + i] * slope[2]) / interval_s
    _exponential(vector, matrix)
    _times(first, matrix, rotation)


def cubic(
    first: cython.const[cython.double][:, :],
    turn: cython.const[cython.double][:],
    start_rate: cython.const[cython.double][:],
    end_rate: cython.const[cython.double][:],
    interval_s: cython.double,
    at: cython.double,
):
    """Interpolate between two attitudes by a cubic of the rotation vector with given rates at both ends.

    Args:
        first: the first attitude, shape (3, 3).
        turn: rotation vector from the first to the second attitude, about the axes of the first, rad, shape (3,).
        start_rate: rate at the first attitude, about its axes, rad/s, shape (3,).
        end_rate: rate at the second attitude, about its axes, rad/s, shape (3,).
        interval_s: time between the two attitudes.
        at: requested time as a fraction of the interval.

    Returns:
        Rotation and rate at the requested time, and the rotation vector from the first attitude.
    """
    check("cubic", first.shape[0] == first.shape[1] == turn.shape[0] == start_rate.shape[0] == end_rate.shape[0] == 3)
    of_rotation, of_rate, of_vector = np.empty((3, 3)), np.empty(3), np.empty(3)
    rotation: cython.double[:, ::1] = of_rotation
    rate: cython.double[::1] = of_rate
    vector: cython.double[::1] = of_vector
    matrix = cython.declare(cython.double[9])
    whole = cython.declare(cython.double[3])
    start = cython.declare(cython.double[3])
    end = cython.declare(cython.double[3])
    rate_there = cython.declare(cython.double[3])
    _copy(first, matrix)
    for i in range(3):
        whole[i], start[i], rate_there[i] = turn[i], start_rate[i] * interval_s, end_rate[i]
    _cubic(
        matrix, whole, rate_there, interval_s, at, start, end,
        cython.address(vector[0]), cython.address(rotation[0, 0]), cython.address(rate[0]),
    )  # fmt: skip
    return of_rotation, of_rate, of_vector


def interpolate_attitude(
    first: cython.const[cython.double][:, :],
    second: cython.const[cython.double][:, :],
    other: cython.const[cython.double][:, :],
    first_rate: cython.const[cython.double][:],
    second_rate: cython.const[cython.double][:],
    interval_s: cython.double,
    at: cython.double,
    other_at: cython.double,
    bound_share: cython.double,
    any_direction: cython.double,
    largest: cython.double,
):
    """Interpolate between two attitudes with measured rates by :func:`cubic`, with estimates of the cubic's error.

    At a fraction t of the interval the error of a cubic with the right values and slopes is the fourth derivative / 24
    times t² (1 - t)². The difference between the cubic and another sample gives the fourth derivative. A second
    estimate, which needs no other sample, uses the third derivative of the cubic, as if this derivative grew from zero
    within the interval.

    Args:
        first: the first attitude, shape (3, 3).
        second: the second attitude, shape (3, 3).
        other: attitude of the sample before the first, shape (3, 3).
        first_rate: rate at the first attitude, about its axes, rad/s, shape (3,).
        second_rate: rate at the second attitude, about its axes, rad/s, shape (3,).
        interval_s: time between the two attitudes.
        at: requested time as a fraction of the interval.
        other_at: time of the other sample in units of the interval, negative; 0 if there is no other sample.
        bound_share: twice the factor of the second estimate if there is another sample; otherwise the factor is 1.
        any_direction: share of an error that may have any direction.
        largest: maximum of the sum of the errors' squares, rad²; with a larger sum the covariance is scaled down.

    Returns:
        Rotation at the requested time.
        Rate at the requested time.
        Variance of the attitude, divided by the variance of the samples' noise.
        Estimates of the error, rotation vectors about the axes of the deck, rad, shape (2, 3), or (1, 3) without
        another sample.
        Covariance of the error, rad², shape (3, 3).
    """
    check("attitudes", first.shape[0] == first.shape[1] == second.shape[0] == second.shape[1] == 3)
    check("other", other.shape[0] == other.shape[1] == first_rate.shape[0] == second_rate.shape[0] == 3)
    estimates: cython.int = 1 if other_at == 0.0 else 2
    of_rotation, of_rate = np.empty((3, 3)), np.empty(3)
    of_errors, of_covariance = np.empty((estimates, 3)), np.empty((3, 3))
    rotation: cython.double[:, ::1] = of_rotation
    rate: cython.double[::1] = of_rate
    errors: cython.double[:, ::1] = of_errors
    covariance: cython.double[:, ::1] = of_covariance
    start_nd = cython.declare(cython.double[9])
    other_nd = cython.declare(cython.double[9])
    between_d = cython.declare(cython.double[9])
    turn = cython.declare(cython.double[3])
    to_other = cython.declare(cython.double[3])
    start = cython.declare(cython.double[3])
    end = cython.declare(cython.double[3])
    end_rate = cython.declare(cython.double[3])
    vector = cython.declare(cython.double[3])
    bent: cython.double = at * (1.0 - at)
    share: cython.double = 1.0
    scale: cython.double = 0.0
    squares: cython.double = 0.0
    miss: cython.double
    _copy(first, start_nd)
    _copy(second, other_nd)
    _transposed_times(start_nd, other_nd, between_d)
    _logarithm(between_d, turn)
    for i in range(3):
        start[i], end_rate[i] = first_rate[i] * interval_s, second_rate[i]
    _cubic(
        start_nd, turn, end_rate, interval_s, at, start, end,
        vector, cython.address(rotation[0, 0]), cython.address(rate[0]),
    )  # fmt: skip
    if estimates == 2:
        _copy(other, other_nd)
        _transposed_times(start_nd, other_nd, between_d)
        _logarithm(between_d, to_other)
        share = 0.5 * bound_share
        scale = bent / (other_at * (1.0 - other_at))
        for i in range(3):
            miss = to_other[i] - (
                other_at * (1.0 - other_at) * (1.0 - other_at) * start[i]
                + other_at * other_at * (3.0 - 2.0 * other_at) * turn[i]
                + other_at * other_at * (other_at - 1.0) * end[i]
            )
            errors[0, i] = miss * scale * scale
    for i in range(3):
        errors[estimates - 1, i] = share * (6.0 * (start[i] + end[i]) - 12.0 * turn[i]) * bent * bent / 24.0
    for k in range(estimates):
        for i in range(3):
            squares += errors[k, i] * errors[k, i]
    scale = 1.0 if squares <= largest else largest / squares
    for i in range(3):
        for j in range(3):
            covariance[i, j] = any_direction * any_direction * squares * scale if i == j else 0.0
            for k in range(estimates):
                covariance[i, j] += errors[k, i] * errors[k, j] * scale
    # Weight of the second attitude; measured rates count as noise-free.
    share = at * at * (3.0 - 2.0 * at)
    return of_rotation, of_rate, (1.0 - share) * (1.0 - share) + share * share, of_errors, of_covariance


def propagate_by_rates(
    rotations: cython.const[cython.double][:, :, :],
    rates: cython.const[cython.double][:, :, :],
    steps_s: cython.const[cython.double][:, :],
    ahead_s: cython.const[cython.double][:],
    any_direction: cython.double,
    largest: cython.double,
):
    """Propagate N samples, each by its rate and by the change of the rate since the sample before.

    Args:
        rotations: attitudes of the samples, shape (N, 3, 3).
        rates: rates of each sample and of the samples before it, newest first, rad/s, shape (N, k, 3), k at least 2.
        steps_s: intervals between these samples, s, shape (N, k - 1).
        ahead_s: time after each sample, negative for a time before it, s, shape (N,).
        any_direction: share of an error that may have any direction.
        largest: maximum of the sum of the errors' squares, rad²; with a larger sum the covariance is scaled down.

    Returns:
        The propagated attitudes, shape (N, 3, 3), their rates, rad/s, shape (N, 3), and the covariances of the
        propagation error, rad², shape (N, 3, 3).
    """
    samples: cython.Py_ssize_t = rotations.shape[0]
    count: cython.Py_ssize_t = rates.shape[1]
    check("rates", count >= 2 and rates.shape[2] == 3 and rates.shape[0] == samples)
    check("steps_s", steps_s.shape[0] == ahead_s.shape[0] == samples and steps_s.shape[1] == count - 1)
    check("rotations", rotations.shape[1] == rotations.shape[2] == 3)
    of_rotations, of_rates, of_errors = np.empty((samples, 3, 3)), np.empty((samples, 3)), np.zeros((samples, 3, 3))
    results: cython.double[:, :, ::1] = of_rotations
    rate: cython.double[:, ::1] = of_rates
    errors: cython.double[:, :, ::1] = of_errors
    vector = cython.declare(cython.double[3])
    jerk = cython.declare(cython.double[3])
    turn = cython.declare(cython.double[9])
    start = cython.declare(cython.double[9])
    jerks: cython.Py_ssize_t = max(count - 2, 1)
    lacking: cython.double
    squares: cython.double
    change: cython.double
    ahead: cython.double
    for n in range(samples):
        ahead, squares = ahead_s[n], 0.0
        lacking = ahead * ahead * ahead / 6.0 + ahead * ahead * steps_s[n, 0] / 4.0
        lacking /= sqrt(cython.cast(cython.double, jerks))
        for i in range(3):
            change = (rates[n, 0, i] - rates[n, 1, i]) / steps_s[n, 0]
            vector[i] = ahead * rates[n, 0, i] + 0.5 * ahead * ahead * change
            rate[n, i] = rates[n, 0, i] + ahead * change
            for j in range(3):
                start[3 * i + j] = rotations[n, i, j]
        _exponential(vector, turn)
        _times(start, turn, cython.address(results[n, 0, 0]))
        for back in range(jerks):
            for i in range(3):
                jerk[i] = (rates[n, back, i] - rates[n, back + 1, i]) / steps_s[n, back]
                if count > 2:
                    jerk[i] -= (rates[n, back + 1, i] - rates[n, back + 2, i]) / steps_s[n, back + 1]
                    jerk[i] *= 2.0 / (steps_s[n, back] + steps_s[n, back + 1])
                else:
                    # With two rates only, the jerk is bounded: the acceleration grows from zero within the step.
                    jerk[i] /= steps_s[n, 0]
                jerk[i] *= lacking
                squares += jerk[i] * jerk[i]
            for i in range(3):
                for j in range(3):
                    errors[n, i, j] += jerk[i] * jerk[j]
        for i in range(3):
            errors[n, i, i] += any_direction * any_direction * squares
        if not squares <= largest:
            for i in range(3):
                for j in range(3):
                    errors[n, i, j] *= largest / squares
    return of_rotations, of_rates, of_errors


def corrected_attitudes(
    by: cython.const[cython.Py_ssize_t][::1],
    since_s: cython.const[cython.double][::1],
    rotations: cython.const[cython.double][:, :, ::1],
    rates: cython.const[cython.double][:, ::1],
    noise_gains: cython.const[cython.double][::1],
    own_errors: cython.const[cython.double][:, :, ::1],
    errors: cython.const[cython.double][:, ::1],
    exceeds_model: cython.const[cython.uchar][:, ::1],
    time_s: cython.const[cython.double][::1],
    steady_variance: cython.const[cython.double][::1],
    white_variance: cython.const[cython.double][::1],
    parts: cython.const[cython.double][:, :, :, ::1],
    drift_source: cython.Py_ssize_t,
    white_source: cython.Py_ssize_t,
    own_source: cython.Py_ssize_t,
):
    """Return N attitudes, each corrected by one of e estimates of its correlated error.

    Args:
        by: index of the estimate for each sample, shape (N,).
        since_s: time from the estimate to each sample, s, shape (N,).
        rotations: attitudes of the samples, shape (N, 3, 3).
        rates: angular velocity of each sample about its axes, rad/s, shape (N, 3).
        noise_gains: variance of each attitude, divided by the variance of the samples' white noise, shape (N,).
        own_errors: covariance of a further error of each sample about its axes, rad², shape (N, 3, 3).
        errors: estimates of the correlated error, rad, shape (e, 3).
        exceeds_model: true for each component that does not decay, such as a step beyond the model, shape (e, 3).
        time_s: correlation time of the correlated error, s, shape (3,).
        steady_variance: steady variance of the correlated error, rad², shape (3,).
        white_variance: variance of the samples' white noise, rad², shape (3,).
        parts: covariance of correlated error and clock offset (rad, s) by error source, shape (e, n_sources, 4, 4).
        drift_source: index of the error source of the correlated error.
        white_source: index of the error source of the white noise.
        own_source: index of the error source of the further error.

    Returns:
        Corrected attitudes, shape (N, 3, 3), and covariance of each by error source, rad², shape (N, n_sources, 3, 3).
    """
    count: cython.Py_ssize_t = since_s.shape[0]
    estimates: cython.Py_ssize_t = errors.shape[0]
    sources: cython.Py_ssize_t = parts.shape[1]
    check("samples", by.shape[0] == rotations.shape[0] == rates.shape[0] == noise_gains.shape[0] == count)
    check("rotations", rotations.shape[1] == rotations.shape[2] == rates.shape[1] == 3)
    check("own_errors", own_errors.shape[0] == count and own_errors.shape[1] == own_errors.shape[2] == 3)
    check("errors", errors.shape[1] == exceeds_model.shape[1] == 3 and exceeds_model.shape[0] == estimates)
    check("variances", time_s.shape[0] == steady_variance.shape[0] == white_variance.shape[0] == 3)
    check("parts", parts.shape[0] == estimates and parts.shape[2] == parts.shape[3] == 4)
    check("sources", 0 <= drift_source < sources and 0 <= white_source < sources and 0 <= own_source < sources)
    of_rotations, of_parts = np.empty((count, 3, 3)), np.empty((count, sources, 3, 3))
    attitudes: cython.double[:, :, ::1] = of_rotations
    out: cython.double[:, :, :, ::1] = of_parts
    now = cython.declare(cython.double[3])
    fresh = cython.declare(cython.double[3])
    correction = cython.declare(cython.double[9])
    by_error = cython.declare(cython.double[9])
    by_state = cython.declare(cython.double[12])
    half = cython.declare(cython.double[12])
    own_n = cython.declare(cython.double[9])
    decay: cython.double
    total: cython.double
    at: cython.p_double
    e: cython.Py_ssize_t
    for n in range(count):
        at, e = cython.address(attitudes[n, 0, 0]), by[n]
        check("estimates", 0 <= e < estimates)
        for i in range(3):
            decay = exp(-since_s[n] / time_s[i])
            fresh[i] = steady_variance[i] * (1.0 - decay * decay)
            now[i] = errors[e, i] if exceeds_model[e, i] else decay * errors[e, i]
        _exponential(now, correction)
        _jacobian(now, by_error)
        _times(correction, cython.cast(cython.p_double, cython.address(rotations[n, 0, 0])), at)
        for i in range(3):
            for j in range(3):
                by_state[4 * i + j] = by_error[3 * i + j] * exp(-since_s[n] / time_s[j])
            by_state[4 * i + 3] = -(
                at[3 * i] * rates[n, 0] + at[3 * i + 1] * rates[n, 1] + at[3 * i + 2] * rates[n, 2]
            )
        for s in range(sources):
            for i in range(3):
                for j in range(4):
                    total = 0.0
                    for k in range(4):
                        total += by_state[4 * i + k] * parts[e, s, k, j]
                    half[4 * i + j] = total
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for k in range(4):
                        total += half[4 * i + k] * by_state[4 * j + k]
                    out[n, s, i, j] = total
        _times(at, cython.cast(cython.p_double, cython.address(own_errors[n, 0, 0])), own_n)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    out[n, drift_source, i, j] += by_error[3 * i + k] * fresh[k] * by_error[3 * j + k]
                    out[n, white_source, i, j] += (
                        correction[3 * i + k] * (white_variance[k] * noise_gains[n]) * correction[3 * j + k]
                    )
                    out[n, own_source, i, j] += own_n[3 * i + k] * at[3 * j + k]
    return of_rotations, of_parts


def angles(rotations: cython.const[cython.double][:, :, :]):
    """Return azimuth, elevation and roll (rad), shape (N, 3), of rotations "parent from device", shape (N, 3, 3)."""
    check("rotations", rotations.shape[1] == rotations.shape[2] == 3)
    count: cython.Py_ssize_t = rotations.shape[0]
    of_angles = np.empty((count, 3))
    out: cython.double[:, ::1] = of_angles
    azimuth: cython.double
    ca: cython.double
    sa: cython.double
    for n in range(count):
        azimuth = atan2(rotations[n, 2, 0], rotations[n, 0, 0])
        if azimuth < 0.0:
            azimuth += 2.0 * M_PI
        # The addition rounds a tiny negative angle up to a full turn, which becomes zero. A zero gets no minus sign.
        if azimuth == 2.0 * M_PI or azimuth == 0.0:
            azimuth = 0.0
        ca, sa = cos(azimuth), sin(azimuth)
        out[n, 0] = azimuth
        # atan2 keeps full precision near the zenith, where an arcsine would not.
        out[n, 1] = atan2(rotations[n, 1, 0], hypot(rotations[n, 0, 0], rotations[n, 2, 0]))
        # Roll is computed from the azimuth. The usual atan2(-R23, R22) fails at the zenith, where both elements vanish.
        out[n, 2] = atan2(
            ca * rotations[n, 2, 1] - sa * rotations[n, 0, 1], ca * rotations[n, 2, 2] - sa * rotations[n, 0, 2]
        )
    return of_angles


def rotations(of_angles: cython.const[cython.double][:, :]):
    """Return rotations "parent from device", shape (N, 3, 3), of azimuth, elevation and roll (rad), shape (N, 3)."""
    check("angles", of_angles.shape[1] == 3)
    count: cython.Py_ssize_t = of_angles.shape[0]
    of_rotations = np.empty((count, 3, 3))
    out: cython.double[:, :, ::1] = of_rotations
    ca: cython.double
    sa: cython.double
    ce: cython.double
    se: cython.double
    cr: cython.double
    sr: cython.double
    for n in range(count):
        ca, sa = cos(of_angles[n, 0]), sin(of_angles[n, 0])
        ce, se = cos(of_angles[n, 1]), sin(of_angles[n, 1])
        cr, sr = cos(of_angles[n, 2]), sin(of_angles[n, 2])
        out[n, 0, 0], out[n, 0, 1], out[n, 0, 2] = ca * ce, -ca * se * cr - sa * sr, ca * se * sr - sa * cr
        out[n, 1, 0], out[n, 1, 1], out[n, 1, 2] = se, ce * cr, -ce * sr
        out[n, 2, 0], out[n, 2, 1], out[n, 2, 2] = sa * ce, -sa * se * cr + ca * sr, sa * se * sr + ca * cr
    return of_rotations


@cython.cfunc
@cython.exceptval(check=False)
def _by_rotation_vector(
    azimuth: cython.double, elevation: cython.double, highest: cython.double, out: cython.p_double
) -> cython.void:
    """Write the derivative of the angles with respect to a rotation vector, 3 × 3.

    All elements are NaN if the magnitude of the elevation exceeds ``highest``.
    """
    ca: cython.double = cos(azimuth)
    sa: cython.double = sin(azimuth)
    ce: cython.double = cos(elevation)
    tangent: cython.double = tan(elevation)
    if not fabs(elevation) <= highest:
        for i in range(9):
            out[i] = NAN
        return
    out[0], out[1], out[2] = ca * tangent, -1.0, sa * tangent
    out[3], out[4], out[5] = -sa, 0.0, ca
    out[6], out[7], out[8] = ca / ce, 0.0, sa / ce


def angle_errors(azimuth: cython.double, elevation: cython.double, highest: cython.double):
    """Return the derivative of one attitude's angles with respect to a rotation vector, shape (3, 3).

    The derivative is NaN if the magnitude of the elevation exceeds ``highest``.
    """
    matrix = np.empty((3, 3))
    out: cython.double[:, ::1] = matrix
    _by_rotation_vector(azimuth, elevation, highest, cython.address(out[0, 0]))
    return matrix


def angle_covariances(
    covariances: cython.const[cython.double][:, :, :],
    of_angles: cython.const[cython.double][:, :],
    highest: cython.double,
):
    """Return the covariance of the angles, rad², shape (N, 3, 3).

    Args:
        covariances: covariance of the rotation vectors in the parent frame, rad², shape (N, 3, 3).
        of_angles: azimuth, elevation and roll, rad, shape (N, 3).
        highest: magnitude of the elevation beyond which the covariance is NaN, rad.
    """
    count: cython.Py_ssize_t = covariances.shape[0]
    check("covariances", covariances.shape[1] == covariances.shape[2] == of_angles.shape[1] == 3)
    check("angles", of_angles.shape[0] == count)
    of_result = np.empty((count, 3, 3))
    out: cython.double[:, :, ::1] = of_result
    by_vector = cython.declare(cython.double[9])
    half = cython.declare(cython.double[9])
    for n in range(count):
        _by_rotation_vector(of_angles[n, 0], of_angles[n, 1], highest, by_vector)
        for i in range(3):
            for j in range(3):
                half[3 * i + j] = (
                    by_vector[3 * i] * covariances[n, 0, j]
                    + by_vector[3 * i + 1] * covariances[n, 1, j]
                    + by_vector[3 * i + 2] * covariances[n, 2, j]
                )
        for i in range(3):
            for j in range(3):
                out[n, i, j] = (
                    half[3 * i] * by_vector[3 * j]
                    + half[3 * i + 1] * by_vector[3 * j + 1]
                    + half[3 * i + 2] * by_vector[3 * j + 2]
                )
    return of_result


def quaternions(matrices: cython.const[cython.double][:, :, :]):
    """Return quaternions x, y, z, w (w >= 0), shape (N, 4), of rotation matrices (Shepperd 1978)."""
    check("matrices", matrices.shape[1] == matrices.shape[2] == 3)
    count: cython.Py_ssize_t = matrices.shape[0]
    of_result = np.empty((count, 4))
    out: cython.double[:, ::1] = of_result
    # Four times the products of all pairs of components of the quaternion.
    products = cython.declare(cython.double[16])
    diagonal = cython.declare(cython.double[3])
    norm: cython.double
    largest: cython.int
    j: cython.int
    k: cython.int
    for n in range(count):
        for i in range(3):
            diagonal[i] = matrices[n, i, i]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            products[5 * i] = 1.0 + diagonal[i] - diagonal[j] - diagonal[k]
            products[4 * i + j] = products[4 * j + i] = matrices[n, i, j] + matrices[n, j, i]
            products[4 * i + 3] = products[12 + i] = matrices[n, k, j] - matrices[n, j, k]
        products[15] = 1.0 + diagonal[0] + diagonal[1] + diagonal[2]
        largest = 0
        for i in range(1, 4):
            if products[5 * i] > products[5 * largest]:
                largest = i
        norm = 0.0
        for i in range(4):
            norm += products[4 * largest + i] * products[4 * largest + i]
        norm = copysign(sqrt(norm), products[4 * largest + 3])
        for i in range(4):
            out[n, i] = products[4 * largest + i] / norm
    return of_result


def rotations_of(quaternions: cython.const[cython.double][:, :]):
    """Return rotation matrices, shape (N, 3, 3), of quaternions x, y, z, w of any norm above zero, shape (N, 4)."""
    check("quaternions", quaternions.shape[1] == 4)
    count: cython.Py_ssize_t = quaternions.shape[0]
    of_result = np.empty((count, 3, 3))
    out: cython.double[:, :, ::1] = of_result
    x: cython.double
    y: cython.double
    z: cython.double
    w: cython.double
    scale: cython.double
    for n in range(count):
        x, y, z, w = quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3]
        scale = 2.0 / (x * x + y * y + z * z + w * w)
        out[n, 0, 0] = 1.0 - scale * y * y - scale * z * z
        out[n, 1, 1] = 1.0 - scale * x * x - scale * z * z
        out[n, 2, 2] = 1.0 - scale * x * x - scale * y * y
        out[n, 0, 1], out[n, 1, 0] = scale * (x * y) - scale * (z * w), scale * (x * y) + scale * (z * w)
        out[n, 0, 2], out[n, 2, 0] = scale * (x * z) + scale * (y * w), scale * (x * z) - scale * (y * w)
        out[n, 1, 2], out[n, 2, 1] = scale * (y * z) - scale * (x * w), scale * (y * z) + scale * (x * w)
    return of_result

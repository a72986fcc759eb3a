# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Innovations of a sighting of beacons in every subfilter, compiled because the computation has many small matrices.

This file is the only source: Python with C types, compiled by Cython when the package is built. The caller,
:mod:`theodolite_calib.filter.subfilters`, explains the quantities.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import sqrt


@cython.cfunc
@cython.exceptval(check=False)
def _solve(
    matrix: cython.p_double, size: cython.Py_ssize_t, right_side: cython.p_double, columns: cython.Py_ssize_t
) -> cython.bint:
    """Replace the right-hand side b (size × columns) by A⁻¹ b, with the Cholesky factor of the symmetric matrix A.

    The matrix is overwritten. The result is False if the matrix has NaN or is not positive definite.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
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
    i: cython.int
    j: cython.int
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
    """Whiten a beacon's residual conditioned on the components ``conditioning``; False if :func:`_solve` fails."""
    size: cython.int = conditioning.shape[0]
    count: cython.int = _select_components(conditioning, covariance, places, scratch)
    # Columns for the conditioning components: covariance with the beacon's two components, and residual.
    right_side: cython.p_double = scratch + count * count
    left = cython.declare(cython.double[2])
    own = cython.declare(cython.double[4])
    area: cython.double
    scale: cython.double
    i: cython.int
    j: cython.int
    k: cython.int
    for i in range(count):
        for j in range(2):
            right_side[3 * i + j] = covariance[places[i] * size + 2 * beacon + j]
        right_side[3 * i + 2] = residual[places[i]]
    if not _solve(scratch, count, right_side, 3):
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
    subfilter: cython.Py_ssize_t
    beacon: cython.int
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
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
        if not _solve(scratch, count, right_side, n + 1):
            raise np.linalg.LinAlgError("innovation covariance is not positive definite")
        nis[subfilter] = 0.0
        for i in range(count):
            for k in range(n):
                gains[subfilter, k, places[i]] = right_side[i * (n + 1) + k]
            nis[subfilter] += subfilter_residual[places[i]] * right_side[i * (n + 1) + n]
    return of_residuals, of_gains, of_nis, innovation_array

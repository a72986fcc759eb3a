# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Jacobian and covariances of beacon points, compiled because the computation has many small products.

This file is the only source: Python with C types, compiled by Cython when the package is built. The caller,
:mod:`theodolite_calib.filter.prediction`, gives indices of states instead of names.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")


def jacobian_by_states(
    by_attitude: cython.const[cython.double][:, :, ::1],
    by_direction: cython.const[cython.double][:, :, ::1],
    by_focal_length: cython.const[cython.double][:, ::1],
    lines: cython.const[cython.double][:, :, ::1],
    by_state_n: cython.const[cython.double][:, ::1],
    focal_length: cython.Py_ssize_t,
    couplings: cython.const[cython.Py_ssize_t][:, ::1],
):
    """Return the Jacobian of the points of N beacons with respect to n states.

    Args:
        by_attitude: derivative of the points with respect to the telescope's rotation vector in n, m/rad, (N, 2, 3).
        by_direction: derivative of the points with respect to the beacons' directions in n, m/rad, shape (N, 2, 3).
        by_focal_length: derivative of the points with respect to the focal length, m/m, shape (N, 2).
        lines: derivative of the directions with respect to c errors of the lines of sight, rad per unit, (N, 3, c).
        by_state_n: derivative of the telescope's rotation vector in n with respect to the states, shape (3, n).
        focal_length: index of the focal length's state.
        couplings: indices (beacon, error, state) for each state that is an error of a line of sight; beacon -1 stands
            for all beacons; shape (e, 3).

    Returns:
        Derivative of the points with respect to the states, m per unit, shape (2 N, n); and with respect to the errors
            of the lines of sight, shape (N, 2, c).
    """
    count: cython.Py_ssize_t = by_attitude.shape[0]
    errors: cython.Py_ssize_t = lines.shape[2]
    n: cython.Py_ssize_t = by_state_n.shape[1]
    check("lines", by_direction.shape[0] == by_focal_length.shape[0] == lines.shape[0] == count)
    check("points", by_attitude.shape[1] == by_direction.shape[1] == by_focal_length.shape[1] == 2)
    check("vectors", by_attitude.shape[2] == by_direction.shape[2] == lines.shape[1] == by_state_n.shape[0] == 3)
    check("states", 0 <= focal_length < n and couplings.shape[1] == 3)
    of_states, of_errors = np.empty((2 * count, n)), np.empty((count, 2, errors))
    jacobian: cython.double[:, ::1] = of_states
    by_error: cython.double[:, :, ::1] = of_errors
    total: cython.double
    beacon: cython.Py_ssize_t
    k: cython.Py_ssize_t
    c: cython.Py_ssize_t
    i: cython.Py_ssize_t
    for i in range(couplings.shape[0]):
        check("couplings", -1 <= couplings[i, 0] < count and 0 <= couplings[i, 1] < errors and 0 <= couplings[i, 2] < n)
    for beacon in range(count):
        for k in range(2):
            for c in range(n):
                total = 0.0
                for i in range(3):
                    total += by_attitude[beacon, k, i] * by_state_n[i, c]
                jacobian[2 * beacon + k, c] = total
            jacobian[2 * beacon + k, focal_length] = by_focal_length[beacon, k]
            for c in range(errors):
                total = 0.0
                for i in range(3):
                    total += by_direction[beacon, k, i] * lines[beacon, i, c]
                by_error[beacon, k, c] = total
            for i in range(couplings.shape[0]):
                if couplings[i, 0] == beacon or couplings[i, 0] < 0:
                    jacobian[2 * beacon + k, couplings[i, 2]] += by_error[beacon, k, couplings[i, 1]]
    return of_states, of_errors


def covariances_by_rotation(rows: cython.const[cython.double][:, :], covariances: cython.const[cython.double][:, :, :]):
    """Return the covariances of m numbers due to rotation errors, shape (p, m, m).

    Args:
        rows: derivative of the numbers with respect to a rotation vector, shape (m, 3).
        covariances: covariances of the rotation vector, shape (p, 3, 3).
    """
    m: cython.Py_ssize_t = rows.shape[0]
    check("covariances", rows.shape[1] == covariances.shape[1] == covariances.shape[2] == 3)
    result = np.empty((covariances.shape[0], m, m))
    out: cython.double[:, :, ::1] = result
    half = cython.declare(cython.double[3])
    p: cython.Py_ssize_t
    a: cython.Py_ssize_t
    b: cython.Py_ssize_t
    i: cython.Py_ssize_t
    for p in range(covariances.shape[0]):
        for a in range(m):
            for i in range(3):
                half[i] = rows[a, 0] * covariances[p, 0, i]
                half[i] += rows[a, 1] * covariances[p, 1, i]
                half[i] += rows[a, 2] * covariances[p, 2, i]
            for b in range(m):
                out[p, a, b] = half[0] * rows[b, 0] + half[1] * rows[b, 1] + half[2] * rows[b, 2]
    return result


def covariance_by_own_error(
    by_error: cython.const[cython.double][:, :, :], covariance: cython.const[cython.double][:, :, :]
):
    """Return the covariance of the points of N beacons due to an independent error of each beacon, shape (2 N, 2 N).

    Args:
        by_error: its first three columns are the derivative of the points with respect to the error, shape (N, 2, 3 or
            more).
        covariance: covariance of the errors, shape (N, 3, 3).
    """
    count: cython.Py_ssize_t = covariance.shape[0]
    check("lines", by_error.shape[0] == count and by_error.shape[1] == 2 and by_error.shape[2] >= 3)
    check("errors", covariance.shape[1] == covariance.shape[2] == 3)
    result = np.zeros((2 * count, 2 * count))
    out: cython.double[:, ::1] = result
    beacon: cython.Py_ssize_t
    a: cython.Py_ssize_t
    b: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for beacon in range(count):
        for a in range(2):
            for b in range(2):
                for i in range(3):
                    for j in range(3):
                        out[2 * beacon + a, 2 * beacon + b] += (
                            by_error[beacon, a, i] * covariance[beacon, i, j] * by_error[beacon, b, j]
                        )
    return result

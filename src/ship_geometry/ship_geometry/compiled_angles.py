# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled conversions of N attitudes: angles, covariance of the angles, and quaternions.

The module is Python with C types; Cython compiles it when the package is built. It is used for single attitudes and for
blocks; for one attitude numpy would take ten times as long. The functions are documented in
:mod:`ship_geometry.frames` and :mod:`ship_geometry.ros_axes`; the tests compare their results with the array functions
of these modules.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import M_PI, NAN, atan2, copysign, cos, fabs, hypot, sin, sqrt, tan


def angles(rotations: cython.const[cython.double][:, :, :]):
    """Return azimuth, elevation and roll (rad), shape (N, 3), of rotations "parent from device", shape (N, 3, 3)."""
    check("rotations", rotations.shape[1] == rotations.shape[2] == 3)
    count: cython.Py_ssize_t = rotations.shape[0]
    of_angles = np.empty((count, 3))
    out: cython.double[:, ::1] = of_angles
    azimuth: cython.double
    ca: cython.double
    sa: cython.double
    n: cython.Py_ssize_t
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
    n: cython.Py_ssize_t
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
    i: cython.int
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
    n: cython.Py_ssize_t
    i: cython.int
    j: cython.int
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
    n: cython.Py_ssize_t
    largest: cython.int
    i: cython.int
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
    n: cython.Py_ssize_t
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

# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Least-squares cubics through a few values, compiled: the cubic at zero, and a step in addition to the cubic.

This file is the only source: Python with C types, compiled by Cython when the package is built. The powers of the times
are made orthonormal one after another, so that no matrix is inverted.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check
from ship_geometry.rotations import FloatArray

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import sqrt


@cython.cfunc
@cython.exceptval(check=False)
def _orthonormal(
    since: cython.p_double, count: cython.Py_ssize_t, basis: cython.p_double, at_zero: cython.p_double
) -> cython.void:
    """Compute four orthonormal polynomials up to the cubic: values at some times, one polynomial a row, and at zero."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
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
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
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
    first: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
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

# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Least-squares cubics through a few times, compiled: their values at zero, and steps in addition to them.

This is the only source. It is Python with C types for its numbers, compiled by Cython when the package is built. The
powers of the times are made orthonormal one after another, so that no matrix is inverted.
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
    """Compute four orthonormal cubics: their values at some times, one cubic a row, and at zero."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    product: cython.double
    for j in range(4):
        at_zero[j] = 1.0 if j == 0 else 0.0
        for i in range(count):
            basis[j * count + i] = 1.0 if j == 0 else basis[(j - 1) * count + i] * since[i]
        # Twice, against rounding. A cubic times the time spans the next power as well as the power does.
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
    """Return the weights of values at some times in the value at zero of the cubic through them, shape (N,).

    Args:
        since: the times, at least four different ones, of order one, shape (N,).
    """
    count: cython.Py_ssize_t = since.shape[0]
    basis: cython.double[:, ::1] = np.empty((4, count))
    at_zero: cython.double[::1] = np.empty(4)
    found: FloatArray = np.zeros(count)
    weights: cython.double[::1] = found
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    check("moments", count >= 4)
    _orthonormal(cython.address(since[0]), count, cython.address(basis[0, 0]), cython.address(at_zero[0]))
    for j in range(4):
        for i in range(count):
            weights[i] += at_zero[j] * basis[j, i]
    return found


def clearest_step(
    since: cython.double[::1], values: cython.double[:, ::1], before: cython.Py_ssize_t
) -> tuple[cython.Py_ssize_t, FloatArray, cython.double, cython.double]:
    """Return the step in addition to a cubic that explains most of the residuals of some vectors.

    Args:
        since: their times, of order one, in ascending order, shape (N,).
        values: the vectors, shape (N, 3).
        before: minimum number of vectors before a step; fewer than N.

    Returns:
        Index of the first vector after the step; the step, shape (3,); its least-squares weight in vectors; and the sum
            of squared residuals of cubic and step.
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
        # Unit step minus its projection on the cubics: its square, and its product with the residuals.
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

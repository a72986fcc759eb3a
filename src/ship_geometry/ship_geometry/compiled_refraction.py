# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled refraction of a few stars: refraction angles and apparent directions.

There is no other implementation. The module is Python with C types; Cython compiles it when the package is built. The
functions are documented where they are called, in :mod:`ship_geometry.refraction`; the tests compare their results with
plain numpy.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check
from ship_geometry.rotations import FloatArray

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN, atan2, cos, hypot, sin, tan

_TINY = cython.declare(cython.double, 1e-300)
"""Minimum of the divisors that are the horizontal component of a direction, which is zero at the zenith."""


@cython.cfunc
@cython.exceptval(check=False)
def _refraction(
    elevation: cython.double,
    coefficients: cython.const[cython.double][:, ::1],
    curvature: cython.double,
    lowest: cython.double,
    of_observed: cython.bint,
    sigmas: cython.const[cython.double][::1],
    angles: cython.p_double,
) -> cython.double:
    """Write the refraction angle and its derivatives with respect to pressure and temperature.

    Returns the standard deviation of the model.
    """
    tan_z: cython.double = 1.0 / tan(elevation) if elevation >= lowest else NAN
    tan2_z: cython.double = tan_z * tan_z
    divisor: cython.double
    x: cython.double = tan2_z / (1.0 + curvature * tan2_z)
    i: cython.int
    power: cython.Py_ssize_t
    for i in range(3):
        angles[i] = coefficients[coefficients.shape[0] - 1, i]
        for power in range(coefficients.shape[0] - 2, -1, -1):
            angles[i] = coefficients[power, i] + angles[i] * x
        angles[i] *= tan_z
    if of_observed:
        # The two coefficients A and B belong to the observed zenith distance. One step of Newton's method leads from
        # the true to the observed zenith distance, as in ERFA's atioq. The derivatives neglect the small change of
        # the divisor.
        divisor = 1.0 + (coefficients[0, 0] + 3.0 * coefficients[1, 0] * tan2_z) * (1.0 + tan2_z)
        for i in range(3):
            angles[i] /= divisor
    return sigmas[0] + sigmas[1] * tan2_z * tan2_z * tan_z + sigmas[2] * angles[0]


@cython.cfunc
@cython.exceptval(check=False)
def _raise_direction(direction: cython.p_double, angle: cython.double, out: cython.p_double) -> cython.void:
    """Write a direction (North, Up, East) raised by an angle."""
    horizontal: cython.double = hypot(direction[0], direction[2])
    stretch: cython.double = cos(angle) - sin(angle) * direction[1] / max(horizontal, _TINY)
    out[0], out[2] = direction[0] * stretch, direction[2] * stretch
    out[1] = direction[1] * cos(angle) + horizontal * sin(angle)


def _check_model(coefficients, of_observed, sigmas) -> None:
    """Raise ValueError if coefficients or sigmas have wrong shapes; the loops do not check bounds."""
    terms = coefficients.shape[0]
    check("model", terms == 2 or (terms > 2 and not of_observed))
    check("model", coefficients.shape[1] == sigmas.shape[0] == 3)


def refraction_angles(
    elevation: cython.const[cython.double][::1],
    coefficients: cython.const[cython.double][:, ::1],
    curvature: cython.double,
    lowest: cython.double,
    of_observed: cython.bint,
    sigmas: cython.const[cython.double][::1],
) -> tuple[FloatArray, FloatArray]:
    """Return refraction at k elevations.

    Args:
        elevation: elevations without air, rad, shape (k,).
        coefficients: cᵢ of tan z Σ cᵢ xⁱ with x = tan² z/(1 + c tan² z), each with its derivatives with respect to
            pressure and temperature, shape (t, 3).
        curvature: c; with c = 0 the terms are tan z, tan³ z, tan⁵ z ….
        lowest: lowest elevation of the model, rad; at lower elevations the results are NaN.
        of_observed: True if the coefficients belong to the zenith distance with air; then there are two coefficients.
        sigmas: terms of the standard deviation of the model, shape (3,): a constant, rad; a factor of tan⁵ z, rad; a
            factor of the angle.

    Returns:
        Refraction angles, rad, with their derivatives, shape (k, 3).
        Standard deviations of the model itself, rad, shape (k,).
    """
    _check_model(coefficients, of_observed, sigmas)
    count: cython.Py_ssize_t = elevation.shape[0]
    of_angles, of_sigma = np.empty((count, 3)), np.empty(count)
    angles: cython.double[:, ::1] = of_angles
    sigma: cython.double[::1] = of_sigma
    out: cython.p_double
    k: cython.Py_ssize_t
    for k in range(count):
        out = cython.address(angles[k, 0])
        sigma[k] = _refraction(elevation[k], coefficients, curvature, lowest, of_observed, sigmas, out)
    return of_angles, of_sigma


def raised_directions(
    direction_n: cython.const[cython.double][:, ::1], angle: cython.const[cython.double][::1]
) -> FloatArray:
    """Return directions (North, Up, East), shape (k, 3), raised by angles, rad, shape (k,)."""
    count: cython.Py_ssize_t = angle.shape[0]
    check("directions", direction_n.shape[0] == count and direction_n.shape[1] == 3)
    result = np.empty((count, 3))
    out: cython.double[:, ::1] = result
    star = cython.declare(cython.double[3])
    k: cython.Py_ssize_t
    for k in range(count):
        star[0], star[1], star[2] = direction_n[k, 0], direction_n[k, 1], direction_n[k, 2]
        _raise_direction(star, angle[k], cython.address(out[k, 0]))
    return result


def seen_through_air(
    without_air_n: cython.const[cython.double][:, ::1],
    coefficients: cython.const[cython.double][:, ::1],
    curvature: cython.double,
    lowest: cython.double,
    of_observed: cython.bint,
    sigmas: cython.const[cython.double][::1],
    pressure_sigma: cython.double,
    temperature_sigma: cython.double,
    turns_n: cython.const[cython.double][:, ::1],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the apparent directions of k stars through the air, and their displacement by common errors.

    Args:
        without_air_n: unit vectors (North, Up, East) without air, shape (k, 3).
        coefficients: as in :func:`refraction_angles`.
        curvature: likewise.
        lowest: likewise.
        of_observed: likewise.
        sigmas: likewise.
        pressure_sigma: standard deviation of the air pressure, hPa.
        temperature_sigma: standard deviation of the air temperature, K.
        turns_n: rotation vectors of the whole sky, rad, shape (m, 3).

    Returns:
        Unit vectors with air, shape (k, 3).
        Displacement of each vector by one sigma of refraction and by each rotation, rad, shape (k, 3, 1 + m).
        Elevations without air, rad, shape (k,).
    """
    _check_model(coefficients, of_observed, sigmas)
    count: cython.Py_ssize_t = without_air_n.shape[0]
    turns: cython.Py_ssize_t = turns_n.shape[0]
    check("vectors", without_air_n.shape[1] == turns_n.shape[1] == 3)
    of_direction, of_shared, of_elevation = np.empty((count, 3)), np.empty((count, 3, 1 + turns)), np.empty(count)
    direction: cython.double[:, ::1] = of_direction
    shared: cython.double[:, :, ::1] = of_shared
    elevation: cython.double[::1] = of_elevation
    star = cython.declare(cython.double[3])
    angles = cython.declare(cython.double[3])
    sigma: cython.double
    level: cython.double
    upward: cython.double
    k: cython.Py_ssize_t
    c: cython.Py_ssize_t
    for k in range(count):
        star[0], star[1], star[2] = without_air_n[k, 0], without_air_n[k, 1], without_air_n[k, 2]
        elevation[k] = atan2(star[1], hypot(star[0], star[2]))
        sigma = _refraction(elevation[k], coefficients, curvature, lowest, of_observed, sigmas, angles)
        sigma = hypot(hypot(angles[1] * pressure_sigma, angles[2] * temperature_sigma), sigma)
        _raise_direction(star, angles[0], cython.address(direction[k, 0]))
        star[0], star[1], star[2] = direction[k, 0], direction[k, 1], direction[k, 2]
        # The displacement is upwards, perpendicular to the direction. At the zenith the direction has no azimuth; the
        # horizontal components of the displacement are then small instead of NaN.
        level = hypot(star[0], star[2])
        upward = -star[1] / max(level, _TINY) * sigma
        shared[k, 0, 0], shared[k, 1, 0], shared[k, 2, 0] = star[0] * upward, level * sigma, star[2] * upward
        for c in range(turns):
            shared[k, 0, 1 + c] = turns_n[c, 1] * star[2] - turns_n[c, 2] * star[1]
            shared[k, 1, 1 + c] = turns_n[c, 2] * star[0] - turns_n[c, 0] * star[2]
            shared[k, 2, 1 + c] = turns_n[c, 0] * star[1] - turns_n[c, 1] * star[0]
    return of_direction, of_shared, of_elevation

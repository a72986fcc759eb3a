# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled refraction and attitude fit of the stars of an exposure, which are too few for efficient numpy.

The functions are described in :mod:`ship_geometry.air.refraction`, :mod:`ship_stars.attitude_from_stars.attitude_fit`
and :mod:`ship_stars.attitude_from_stars.residuals`.
"""

import cython
import numpy as np

from ship_kernels import FloatArray
from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN, atan2, cos, hypot, sin, sqrt, tan

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


@cython.cfunc
@cython.exceptval(check=False)
@cython.inline
def _cross_product(
    v: cython.p_double, w: cython.p_double, out: cython.p_double, step: cython.Py_ssize_t
) -> cython.void:
    """Write the elements of v × w into ``out``, ``step`` places apart."""
    out[0] = v[1] * w[2] - v[2] * w[1]
    out[step] = v[2] * w[0] - v[0] * w[2]
    out[2 * step] = v[0] * w[1] - v[1] * w[0]


def linearise_stars(
    measured_b: cython.const[cython.double][:, :],
    reference_n: cython.const[cython.double][:, :],
    sigma: cython.const[cython.double][:],
    shared_n: cython.const[cython.double][:, :, :],
    sensor: cython.const[cython.Py_ssize_t][:],
    mounting_b: cython.const[cython.double][:, :, :],
    time_transfer_b: cython.const[cython.double][:, :, :],
    rotation_nb: cython.const[cython.double][:, :],
):
    """Return ``jacobian``, ``displacement`` and ``residual_n`` of a star fit without smear and field errors.

    Args:
        measured_b: as in :class:`ship_stars.attitude_from_stars.attitude_fit.MatchedStars`, shape (k, 3).
        reference_n: likewise, shape (k, 3).
        sigma: standard deviation of each star, errors of catalogue and pixel included, rad per axis, shape (k,).
        shared_n: as in ``MatchedStars``, shape (k, 3, n_shared).
        sensor: likewise, shape (k,).
        mounting_b: likewise, shape (n_sensors, 3, 3), or (0, 3, 3).
        time_transfer_b: likewise, shape (n_sensors, 3, c), or (0, 3, 0).
        rotation_nb: attitude of the linearisation (horizon from b), shape (3, 3).
    """
    count: cython.Py_ssize_t = measured_b.shape[0]
    mounted: cython.Py_ssize_t = 3 * mounting_b.shape[0]
    turns: cython.Py_ssize_t = time_transfer_b.shape[2]
    shared: cython.Py_ssize_t = shared_n.shape[2]
    check("stars", reference_n.shape[0] == sigma.shape[0] == shared_n.shape[0] == sensor.shape[0] == count)
    check("vectors", measured_b.shape[1] == reference_n.shape[1] == shared_n.shape[1] == 3)
    check("turns", mounting_b.shape[1] == mounting_b.shape[2] == time_transfer_b.shape[1] == 3)
    check("rotation_nb", rotation_nb.shape[0] == rotation_nb.shape[1] == 3)
    of_jacobian = np.zeros((count, 3, 3 + mounted + turns + shared))
    of_displacement, of_residual = np.empty((count, 3)), np.empty((count, 3))
    jacobian: cython.double[:, :, ::1] = of_jacobian
    displacement: cython.double[:, ::1] = of_displacement
    residual: cython.double[:, ::1] = of_residual
    width: cython.Py_ssize_t = jacobian.shape[2]
    star = cython.declare(cython.double[3])
    turn = cython.declare(cython.double[3])
    axis: cython.double
    per_sigma: cython.double
    for k in range(count):
        per_sigma = 1.0 / sigma[k]
        for i in range(3):
            star[i] = reference_n[k, i] * per_sigma
            residual[k, i] = reference_n[k, i]
            for j in range(3):
                residual[k, i] -= rotation_nb[i, j] * measured_b[k, j]
            displacement[k, i] = residual[k, i] * per_sigma
            for c in range(shared):
                jacobian[k, i, width - shared + c] = -shared_n[k, i, c] * per_sigma
        # A rotation δ moves the star by δ × v.
        for c in range(3):
            for i in range(3):
                turn[i] = 1.0 if i == c else 0.0
            _cross_product(turn, star, cython.address(jacobian[k, 0, c]), width)
        if not mounted and not turns:
            continue
        check("sensor", sensor[k] >= 0 and (not mounted or 3 * sensor[k] < mounted))
        check("time_transfer_b", not turns or sensor[k] < time_transfer_b.shape[0])
        for c in range(3 if mounted else 0):
            for i in range(3):
                axis = 0.0
                for j in range(3):
                    axis += rotation_nb[i, j] * mounting_b[sensor[k], j, c]
                turn[i] = axis
            _cross_product(turn, star, cython.address(jacobian[k, 0, 3 + 3 * sensor[k] + c]), width)
        for c in range(turns):
            for i in range(3):
                axis = 0.0
                for j in range(3):
                    axis += rotation_nb[i, j] * time_transfer_b[sensor[k], j, c]
                turn[i] = axis
            _cross_product(turn, star, cython.address(jacobian[k, 0, 3 + mounted + c]), width)
    return of_jacobian, of_displacement, of_residual


@cython.cfunc
@cython.exceptval(check=False)
def _add_normal_equations(
    jacobian: cython.const[cython.double][:, :, :],
    displacement: cython.const[cython.double][:, :],
    members: cython.const[cython.uchar][:],
    information: cython.double[:, ::1],
    right_side: cython.double[::1],
) -> cython.double:
    """Add the normal equations of the members to arrays of zeros; return the sum of their squared displacements."""
    q: cython.Py_ssize_t = jacobian.shape[2]
    squares: cython.double = 0.0
    for k in range(jacobian.shape[0]):
        if not members[k]:
            continue
        for i in range(3):
            squares += displacement[k, i] * displacement[k, i]
            for a in range(q):
                right_side[a] += displacement[k, i] * jacobian[k, i, a]
                for b in range(a, q):
                    information[a, b] += jacobian[k, i, a] * jacobian[k, i, b]
    for a in range(q):
        for b in range(a):
            information[a, b] = information[b, a]
    return squares


def _check_shapes(jacobian, displacement, members) -> None:
    """Raise ValueError if the shapes of the stars' arrays do not match; the loops do not check bounds."""
    check("stars", displacement.shape[0] == members.shape[0] == jacobian.shape[0])
    check("vectors", jacobian.shape[1] == displacement.shape[1] == 3)


def normal_equations(
    jacobian: cython.const[cython.double][:, :, :],
    displacement: cython.const[cython.double][:, :],
    members: cython.const[cython.uchar][:],
):
    """Return the information of the members, shape (q, q), and the right side, shape (q,).

    Args:
        jacobian: as in :class:`ship_stars.attitude_from_stars.attitude_fit.StarFit`, shape (k, 3, q).
        displacement: likewise, shape (k, 3).
        members: True for each star that is used, shape (k,).
    """
    _check_shapes(jacobian, displacement, members)
    information, right_side = np.zeros((jacobian.shape[2], jacobian.shape[2])), np.zeros(jacobian.shape[2])
    _add_normal_equations(jacobian, displacement, members, information, right_side)
    return information, right_side


def solve_normal_equations(
    jacobian: cython.const[cython.double][:, :, :],
    displacement: cython.const[cython.double][:, :],
    members: cython.const[cython.uchar][:],
    free_count: cython.Py_ssize_t,
):
    """Return the most likely unknowns of the members.

    Args:
        jacobian: as in :func:`normal_equations`.
        displacement: as in :func:`normal_equations`.
        members: as in :func:`normal_equations`.
        free_count: number of unknowns without a prior, which come first; the prior information of the others is the
            identity.

    Returns:
        Information from the stars alone, shape (q, q).
        Information from stars and priors, shape (q, q).
        Most likely unknowns, shape (q,).
        Remaining sum of squares, priors included.
        Number of members.

    Raises:
        numpy.linalg.LinAlgError: the stars do not determine the unknowns.
    """
    _check_shapes(jacobian, displacement, members)
    q: cython.Py_ssize_t = jacobian.shape[2]
    of_information, of_right_side, of_solution = np.zeros((q, q)), np.zeros(q), np.empty(q)
    information: cython.double[:, ::1] = of_information
    right_side: cython.double[::1] = of_right_side
    solution: cython.double[::1] = of_solution
    squares: cython.double = _add_normal_equations(jacobian, displacement, members, information, right_side)
    of_constrained = of_information.copy()
    constrained: cython.double[:, ::1] = of_constrained
    lower: cython.double[:, ::1] = np.empty((q, q))
    total: cython.double
    count: cython.Py_ssize_t = 0
    for i in range(members.shape[0]):
        count += 1 if members[i] else 0
    for i in range(free_count, q):
        constrained[i, i] += 1.0
    # The Cholesky factor and the forward substitution are computed row by row.
    for i in range(q):
        for j in range(i + 1):
            total = constrained[i, j]
            for c in range(j):
                total -= lower[i, c] * lower[j, c]
            if j < i:
                lower[i, j] = total / lower[j, j]
            elif total > 0.0:
                lower[i, i] = sqrt(total)
            else:
                raise np.linalg.LinAlgError("the stars do not determine the attitude")
        total = right_side[i]
        for c in range(i):
            total -= lower[i, c] * solution[c]
        solution[i] = total / lower[i, i]
    for i in range(q - 1, -1, -1):
        total = solution[i]
        for c in range(i + 1, q):
            total -= lower[c, i] * solution[c]
        solution[i] = total / lower[i, i]
    for i in range(q):
        squares -= right_side[i] * solution[i]
    return of_information, of_constrained, of_solution, squares, count


def apply_prior(
    jacobian: cython.const[cython.double][:, :, :],
    displacement: cython.const[cython.double][:, :],
    root_n: cython.const[cython.double][:, :],
    expected_n: cython.const[cython.double][:],
):
    """Return Jacobian and displacement for an attitude error relative to its prediction, in standard deviations.

    Args:
        jacobian: as in :class:`ship_stars.attitude_from_stars.attitude_fit.StarFit`, shape (k, 3, q); the first three
            columns belong to the attitude.
        displacement: likewise, shape (k, 3).
        root_n: matrix L with L Lᵀ equal to the covariance of the prediction, rad, shape (3, 3).
        expected_n: predicted rotation vector, rad, shape (3,).
    """
    count: cython.Py_ssize_t = jacobian.shape[0]
    q: cython.Py_ssize_t = jacobian.shape[2]
    check("stars", displacement.shape[0] == count and q >= 3)
    check("vectors", jacobian.shape[1] == displacement.shape[1] == root_n.shape[0] == root_n.shape[1] == 3)
    check("expected_n", expected_n.shape[0] == 3)
    of_jacobian, of_displacement = np.empty((count, 3, q)), np.empty((count, 3))
    counted: cython.double[:, :, ::1] = of_jacobian
    reduced: cython.double[:, ::1] = of_displacement
    for k in range(count):
        for i in range(3):
            reduced[k, i] = displacement[k, i]
            for c in range(3):
                reduced[k, i] -= jacobian[k, i, c] * expected_n[c]
                counted[k, i, c] = 0.0
                for j in range(3):
                    counted[k, i, c] += jacobian[k, i, j] * root_n[j, c]
            for c in range(3, q):
                counted[k, i, c] = jacobian[k, i, c]
    return of_jacobian, of_displacement


def attitude_covariances(
    white_n: cython.const[cython.double][:, :],
    information: cython.const[cython.double][:, :],
    jacobian: cython.const[cython.double][:, :, :],
    share: cython.const[cython.double][:],
    term_of: cython.const[cython.Py_ssize_t][:],
    terms: cython.Py_ssize_t,
):
    """Return the covariance of an attitude by error source, and the part of its noise due to one kind of star errors.

    Args:
        white_n: covariance of the attitude due to independent errors of the stars, rad², shape (3, 3). These errors
            determine the weights of the stars.
        information: information about all unknowns from the stars, shape (q, q); the first three are the attitude.
        jacobian: Jacobian of the stars, shape (k, 3, q).
        share: sigma of this kind of error divided by the white sigma, for each star, shape (k,); 0 for a star that is
            not used.
        term_of: index of the error source of each unknown after the attitude, shape (q - 3,). These unknowns are in
            units of sigma.
        terms: number of error sources.

    Returns:
        Covariance by error source, rad², shape (terms, 3, 3), and covariance due to this kind of error, shape (3, 3).
    """
    q: cython.Py_ssize_t = information.shape[0]
    check("unknowns", information.shape[1] == jacobian.shape[2] == term_of.shape[0] + 3 == q)
    check("vectors", white_n.shape[0] == white_n.shape[1] == jacobian.shape[1] == 3)
    check("stars", share.shape[0] == jacobian.shape[0])
    of_terms, of_shares = np.zeros((terms, 3, 3)), np.empty((3, 3))
    parts: cython.double[:, :, ::1] = of_terms
    shares: cython.double[:, ::1] = of_shares
    turn = cython.declare(cython.double[3])
    information_of_errors = cython.declare(cython.double[9])
    half = cython.declare(cython.double[9])
    for c in range(q - 3):
        check("terms", 0 <= term_of[c] < terms)
        # Rotation of the attitude due to one sigma of the unknown.
        for i in range(3):
            turn[i] = 0.0
            for j in range(3):
                turn[i] += white_n[i, j] * information[j, 3 + c]
        for i in range(3):
            for j in range(3):
                parts[term_of[c], i, j] += turn[i] * turn[j]
    for i in range(9):
        information_of_errors[i] = half[i] = 0.0
    for k in range(share.shape[0]):
        for c in range(3):
            for i in range(3):
                for j in range(3):
                    information_of_errors[3 * i + j] += share[k] * share[k] * jacobian[k, c, i] * jacobian[k, c, j]
    for i in range(3):
        for j in range(3):
            for c in range(3):
                half[3 * i + j] += information_of_errors[3 * i + c] * white_n[c, j]
    for i in range(3):
        for j in range(i + 1):
            shares[i, j] = 0.0
            for c in range(3):
                shares[i, j] += white_n[i, c] * half[3 * c + j]
            shares[j, i] = shares[i, j]
    return of_terms, of_shares


def expected_directions(
    reference_n: cython.const[cython.double][:, :],
    shared_n: cython.const[cython.double][:, :, :],
    estimate: cython.const[cython.double][:],
):
    """Return the directions of stars corrected by the estimated shared errors, unit vectors, shape (k, 3).

    Args:
        reference_n: directions from the sky model, shape (k, 3).
        shared_n: displacement of each direction by one sigma of each shared error, shape (k, 3, n_shared).
        estimate: estimate of each shared error, in sigmas, shape (n_shared,).
    """
    count: cython.Py_ssize_t = reference_n.shape[0]
    check("stars", shared_n.shape[0] == count and reference_n.shape[1] == shared_n.shape[1] == 3)
    check("estimate", estimate.shape[0] == shared_n.shape[2])
    result = np.empty((count, 3))
    out: cython.double[:, ::1] = result
    length: cython.double
    shift: cython.double
    for k in range(count):
        for i in range(3):
            shift = 0.0
            for c in range(shared_n.shape[2]):
                shift += shared_n[k, i, c] * estimate[c]
            out[k, i] = reference_n[k, i] + shift
        length = sqrt(out[k, 0] * out[k, 0] + out[k, 1] * out[k, 1] + out[k, 2] * out[k, 2])
        for i in range(3):
            out[k, i] /= length
    return result


def residuals(
    measured_s: cython.const[cython.double][:, :],
    expected_n: cython.const[cython.double][:, :],
    shared_n: cython.const[cython.double][:, :, :],
    members: cython.const[cython.uchar][:],
    rotation_ns: cython.const[cython.double][:, :],
    to_sensor: cython.const[cython.double][:, :],
    first: cython.Py_ssize_t,
):
    """Return the residuals of stars relative to the predicted attitude of their sensor, two components for each star.

    Args:
        measured_s: measured directions, shape (k, 3).
        expected_n: expected directions in the horizon frame, shape (k, 3).
        shared_n: displacement of each direction by one sigma of each shared error, shape (k, 3, n_shared).
        members: True for the m stars used, shape (k,).
        rotation_ns: predicted attitude "horizon from sensor", shape (3, 3).
        to_sensor: derivative of the attitude, as rotation vector in the sensor frame, with respect to the n states,
            shape (3, n).
        first: index of the first state of the shared errors.

    Returns:
        Residuals: measured minus expected direction, up and right of each star, shape (2 m,).
        Derivative of the expected directions, up and right, with respect to the states, shape (2 m, n).
        Derivative of the expected directions with respect to a rotation of the sensor, shape (2 m, 3).
        Unit vectors up and right of each star, shape (m, 2, 3).
    """
    n: cython.Py_ssize_t = to_sensor.shape[1]
    shared: cython.Py_ssize_t = shared_n.shape[2]
    count: cython.Py_ssize_t = measured_s.shape[0]
    check("stars", expected_n.shape[0] == shared_n.shape[0] == members.shape[0] == count)
    check("vectors", measured_s.shape[1] == expected_n.shape[1] == shared_n.shape[1] == to_sensor.shape[0] == 3)
    check("rotation_ns", rotation_ns.shape[0] == rotation_ns.shape[1] == 3)
    check("states", first >= 0 and first + shared <= n)
    number: cython.Py_ssize_t = 0
    for k in range(count):
        number += 1 if members[k] else 0
    of_residual, of_jacobian = np.empty(2 * number), np.zeros((2 * number, n))
    of_turn, of_basis = np.empty((2 * number, 3)), np.empty((number, 2, 3))
    residual: cython.double[::1] = of_residual
    jacobian: cython.double[:, ::1] = of_jacobian
    by_turn: cython.double[:, ::1] = of_turn
    basis: cython.double[:, :, ::1] = of_basis
    star = cython.declare(cython.double[3])
    across_n = cython.declare(cython.double[3])
    level: cython.double
    total: cython.double
    row: cython.Py_ssize_t = 0
    for k in range(count):
        if not members[k]:
            continue
        for i in range(3):
            star[i] = 0.0
            for j in range(3):
                star[i] += expected_n[k, j] * rotation_ns[j, i]
        level = hypot(star[0], star[2])
        basis[row, 0, 0], basis[row, 0, 1], basis[row, 0, 2] = (
            -star[1] * star[0] / level,
            level,
            -star[1] * star[2] / level,
        )
        basis[row, 1, 0], basis[row, 1, 1], basis[row, 1, 2] = -star[2] / level, 0.0, star[0] / level
        for c in range(2):
            total = 0.0
            for i in range(3):
                total += basis[row, c, i] * (measured_s[k, i] - star[i])
                across_n[i] = 0.0
                for j in range(3):
                    across_n[i] += rotation_ns[i, j] * basis[row, c, j]
            residual[2 * row + c] = total
            # A rotation ε of the sensor moves the star's direction p by p × ε. Along a unit vector b this is (b × p) ε.
            _cross_product(cython.address(basis[row, c, 0]), star, cython.address(by_turn[2 * row + c, 0]), 1)
            for j in range(n):
                for i in range(3):
                    jacobian[2 * row + c, j] += by_turn[2 * row + c, i] * to_sensor[i, j]
            for j in range(shared):
                total = 0.0
                for i in range(3):
                    total += across_n[i] * shared_n[k, i, j]
                jacobian[2 * row + c, first + j] = total
        row += 1
    return of_residual, of_jacobian, of_turn, of_basis

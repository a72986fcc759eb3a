# cython: language_level=3, infer_types=True
# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled axis geometry of a two-axis mount on a ship, for one or many readings of its encoders.

R is the measured attitude of the ship (horizon n from deck d) and ω the ship's angular rate in d. The main frame m of
the mount (optical axis, up, right) is

    R_nm = exp(a) R exp(-τ ω) · exp(e) · T Ry(A - g) Rx(I) Rz(-(E - h + f cos E)) Ry(-c),   T = exp((βy, 0, -βx))

A and E are the encoder readings of azimuth and elevation. The order of the errors is always: a (rotation vector in n),
e (rotation vector in d), g, h, c, I, βx, βy, f, and τ in seconds. The errors g to f of the axes are documented in
:mod:`ship_geometry.mount.axes`.
"""

import cython
import numpy as np

from ship_kernels.compiled_arrays import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN, cos, exp, sin, sqrt
from cython.cimports.ship_kernels.compiled_rotations import _copy, _exponential, _jacobian, _times

_ERRORS = cython.declare(cython.int, 14)
_CORRELATED = cython.declare(cython.int, 6)
"""Number of correlated errors, the components of a and e, which come first; the other errors are constants."""


@cython.cfunc
@cython.exceptval(check=False)
def _axes(
    errors: cython.p_double,
    azimuth: cython.double,
    elevation: cython.double,
    rotation: cython.p_double,
    by_error: cython.p_double,
    by_encoder: cython.p_double,
) -> cython.void:
    """Write the main frame in the base of the mount, with its derivatives.

    The derivatives are rotation vectors in the base, with respect to the errors of the axes g to f (3 × 7) and to the
    encoder angles (3 × 2). ``errors`` begins with g.
    """
    tilt = cython.declare(cython.double[3])
    tilted = cython.declare(cython.double[9])
    by_tilt = cython.declare(cython.double[9])
    turn = cython.declare(cython.double[9])
    turned = cython.declare(cython.double[9])
    cosine: cython.double
    sine: cython.double
    ci: cython.double = cos(errors[3])
    si: cython.double = sin(errors[3])
    cc: cython.double = cos(errors[2])
    sc: cython.double = sin(errors[2])
    flexure: cython.double = errors[6]
    raised: cython.double = elevation - errors[1] + flexure * cos(elevation)
    tilt[0], tilt[1], tilt[2] = errors[5], 0.0, -errors[4]
    _exponential(tilt, tilted)
    _jacobian(tilt, by_tilt)
    # Ry(A - g) Rx(I), multiplied out.
    cosine, sine = cos(azimuth - errors[0]), sin(azimuth - errors[0])
    turn[0], turn[1], turn[2] = cosine, sine * si, -sine * ci
    turn[3], turn[4], turn[5] = 0.0, ci, si
    turn[6], turn[7], turn[8] = sine, -cosine * si, cosine * ci
    _times(tilted, turn, turned)
    # Rz(-(E - h + f cos E)) Ry(-c), multiplied out.
    cosine, sine = cos(raised), sin(raised)
    turn[0], turn[1], turn[2] = cosine * cc, -sine, cosine * sc
    turn[3], turn[4], turn[5] = sine * cc, cosine, sine * sc
    turn[6], turn[7], turn[8] = -sc, 0.0, cc
    _times(turned, turn, rotation)
    cosine, sine = cos(elevation), sin(elevation)
    for i in range(3):
        by_error[7 * i] = tilted[3 * i + 1]
        by_error[7 * i + 1] = -turned[3 * i + 2]
        by_error[7 * i + 2] = rotation[3 * i + 1]
        by_error[7 * i + 3] = -turned[3 * i]
        by_error[7 * i + 4] = -by_tilt[3 * i + 2]
        by_error[7 * i + 5] = by_tilt[3 * i]
        by_error[7 * i + 6] = cosine * turned[3 * i + 2]
        by_encoder[2 * i] = -tilted[3 * i + 1]
        by_encoder[2 * i + 1] = (1.0 - flexure * sine) * turned[3 * i + 2]


@cython.cfunc
@cython.exceptval(check=False)
def _axis_geometry(
    errors: cython.p_double,
    measured: cython.p_double,
    rate: cython.p_double,
    azimuth: cython.double,
    elevation: cython.double,
    rotation_nd: cython.p_double,
    rotation_dm: cython.p_double,
    rotation_nm: cython.p_double,
    by_error: cython.p_double,
    by_encoder: cython.p_double,
) -> cython.void:
    """Write the results of :func:`axis_geometries` for one time."""
    vector = cython.declare(cython.double[3])
    turn = cython.declare(cython.double[9])
    moved = cython.declare(cython.double[9])
    bent = cython.declare(cython.double[9])
    by_bending = cython.declare(cython.double[9])
    rotation_nf = cython.declare(cython.double[9])
    axes = cython.declare(cython.double[9])
    by_axis = cython.declare(cython.double[21])
    by_angle = cython.declare(cython.double[6])
    for i in range(3):
        vector[i] = -errors[13] * rate[i]
    _exponential(vector, turn)
    _times(measured, turn, moved)
    _exponential(errors, turn)
    _times(turn, moved, rotation_nd)
    _exponential(errors + 3, bent)
    _jacobian(errors + 3, turn)
    _times(rotation_nd, turn, by_bending)
    _times(rotation_nd, bent, rotation_nf)
    _axes(errors + 6, azimuth, elevation, axes, by_axis, by_angle)
    _times(bent, axes, rotation_dm)
    _times(rotation_nd, rotation_dm, rotation_nm)
    _jacobian(errors, turn)
    for i in range(3):
        for j in range(3):
            by_error[14 * i + j] = turn[3 * i + j]
            by_error[14 * i + 3 + j] = by_bending[3 * i + j]
        for j in range(7):
            by_error[14 * i + 6 + j] = (
                rotation_nf[3 * i] * by_axis[j]
                + rotation_nf[3 * i + 1] * by_axis[7 + j]
                + rotation_nf[3 * i + 2] * by_axis[14 + j]
            )
        by_error[14 * i + 13] = -(
            rotation_nd[3 * i] * rate[0] + rotation_nd[3 * i + 1] * rate[1] + rotation_nd[3 * i + 2] * rate[2]
        )
        for j in range(2):
            by_encoder[2 * i + j] = (
                rotation_nf[3 * i] * by_angle[j]
                + rotation_nf[3 * i + 1] * by_angle[2 + j]
                + rotation_nf[3 * i + 2] * by_angle[4 + j]
            )


def axis_geometries(
    errors: cython.const[cython.double][:, ::1],
    rotations: cython.const[cython.double][:, :, :],
    rates: cython.const[cython.double][:, :],
    angles: cython.const[cython.double][:, :],
):
    """Return the axis geometry of the mount at N times.

    Args:
        errors: estimated errors at each time, shape (N, 14).
        rotations: measured attitudes of the ship, shape (N, 3, 3).
        rates: angular velocities of the ship in d, rad/s, shape (N, 3).
        angles: encoder readings of azimuth and elevation, rad, shape (N, 2).

    Returns:
        The corrected attitude of the ship (n from d), shape (N, 3, 3).
        The main frame in the deck including the bending e (d from m), shape (N, 3, 3).
        The main frame in the horizon (n from m), shape (N, 3, 3).
        Derivative of the main frame, as rotation vector in n, with respect to the errors, shape (N, 3, 14).
        Derivative of the main frame with respect to the encoder angles, shape (N, 3, 2).
    """
    count: cython.Py_ssize_t = errors.shape[0]
    check("times", rotations.shape[0] == rates.shape[0] == angles.shape[0] == count)
    check("errors", errors.shape[1] == _ERRORS)
    check("rotations", rotations.shape[1] == rotations.shape[2] == rates.shape[1] == 3)
    check("angles", angles.shape[1] == 2)
    of_nd, of_dm, of_nm = np.empty((count, 3, 3)), np.empty((count, 3, 3)), np.empty((count, 3, 3))
    of_errors, of_encoders = np.empty((count, 3, _ERRORS)), np.empty((count, 3, 2))
    rotation_nd: cython.double[:, :, ::1] = of_nd
    rotation_dm: cython.double[:, :, ::1] = of_dm
    rotation_nm: cython.double[:, :, ::1] = of_nm
    by_error: cython.double[:, :, ::1] = of_errors
    by_encoder: cython.double[:, :, ::1] = of_encoders
    measured = cython.declare(cython.double[9])
    rate = cython.declare(cython.double[3])
    for n in range(count):
        for i in range(3):
            rate[i] = rates[n, i]
            for j in range(3):
                measured[3 * i + j] = rotations[n, i, j]
        _axis_geometry(
            cython.cast(cython.p_double, cython.address(errors[n, 0])),
            measured,
            rate,
            angles[n, 0],
            angles[n, 1],
            cython.address(rotation_nd[n, 0, 0]),
            cython.address(rotation_dm[n, 0, 0]),
            cython.address(rotation_nm[n, 0, 0]),
            cython.address(by_error[n, 0, 0]),
            cython.address(by_encoder[n, 0, 0]),
        )
    return of_nd, of_dm, of_nm, of_errors, of_encoders


@cython.cfunc
@cython.exceptval(check=False)
def _add_projected(
    by_vector: cython.p_double, width: cython.Py_ssize_t, covariance: cython.p_double, out: cython.p_double
) -> cython.void:
    """Add J P Jᵀ to a covariance (3 × 3), with P the given covariance (3 × 3).

    J is three columns of a matrix with ``width`` columns.
    """
    half = cython.declare(cython.double[3])
    for i in range(3):
        for k in range(3):
            half[k] = (
                by_vector[width * i] * covariance[k]
                + by_vector[width * i + 1] * covariance[3 + k]
                + by_vector[width * i + 2] * covariance[6 + k]
            )
        for j in range(3):
            out[3 * i + j] += (
                half[0] * by_vector[width * j] + half[1] * by_vector[width * j + 1] + half[2] * by_vector[width * j + 2]
            )


@cython.cfunc
@cython.exceptval(check=False)
def _projected_covariance(
    by_error: cython.p_double, parts: cython.p_double, size: cython.Py_ssize_t, out: cython.p_double
) -> cython.void:
    """Write J P Jᵀ, with J of shape (3, size) and a symmetric P of shape (size, size)."""
    half = cython.declare(cython.double[14])
    total: cython.double
    for i in range(3):
        for j in range(size):
            half[j] = 0.0
        for k in range(size):
            for j in range(size):
                half[j] += by_error[size * i + k] * parts[size * k + j]
        for j in range(i, 3):
            total = 0.0
            for k in range(size):
                total += half[k] * by_error[size * j + k]
            out[3 * i + j] = out[3 * j + i] = total


def pointings(
    since_ns: cython.const[cython.longlong][:],
    rotations: cython.const[cython.double][:, :, :],
    rates: cython.const[cython.double][:, :],
    ship_variances: cython.const[cython.double][:],
    angles: cython.const[cython.double][:, :],
    angle_variances: cython.const[cython.double][:],
    remaining_share: cython.const[cython.double][:, :],
    added_covariance: cython.const[cython.double][:, :, :],
    errors: cython.const[cython.double][::1],
    exceeds_model: cython.const[cython.uchar][::1],
    time_s: cython.const[cython.double][::1],
    steady: cython.const[cython.double][:, :, ::1],
    parts: cython.const[cython.double][:, :, ::1],
    ship: cython.Py_ssize_t,
    bending: cython.Py_ssize_t,
    encoder: cython.Py_ssize_t,
    white: cython.Py_ssize_t,
):
    """Return the main frame at N encoder readings, corrected by one estimate of the errors, with covariance by source.

    The errors a and e are Gauss–Markov processes with steady covariances. If the stated covariance of the ship's
    attitude has changed since the estimate, the error a is multiplied by ``remaining_share``, and ``added_covariance``
    is added to the covariance of a.

    Args:
        since_ns: time from the estimate to each reading, ns, shape (N,); negative times count as 0.
        rotations: measured attitudes of the ship at the readings, shape (N, 3, 3).
        rates: angular velocities of the ship in d, rad/s, shape (N, 3).
        ship_variances: variance of a further error of each attitude, equal about all axes, rad², shape (N,).
        angles: encoder readings of azimuth and elevation, rad, shape (N, 2).
        angle_variances: noise variance of each of the two encoder angles, rad², shape (N,).
        remaining_share: factor of each component of a, shape (N, 3), or (0, 3) if a is not reduced at any reading.
        added_covariance: covariance added to that of a, rad², shape (N, 3, 3), or (0, 3, 3).
        errors: estimated errors, shape (14,).
        exceeds_model: true for each component of a and e whose mean does not decay, shape (6,).
        time_s: correlation times of a and e, s, shape (6,).
        steady: steady covariance of a and of e, rad², shape (2, 3, 3).
        parts: covariance of the first k = 13 or 14 errors by error source, shape (n_sources, k, k).
        ship: index of the error source of a.
        bending: index of the error source of e.
        encoder: index of the error source of the encoder noise.
        white: index of the error source of the further attitude error.

    Returns:
        The main frame in the horizon, shape (N, 3, 3).
        Derivative of the main frame, as rotation vector in n, with respect to the errors, shape (N, 3, k).
        Covariance of the main frame's rotation vector by error source, rad², shape (N, n_sources, 3, 3).
    """
    count: cython.Py_ssize_t = since_ns.shape[0]
    sources: cython.Py_ssize_t = parts.shape[0]
    size: cython.Py_ssize_t = parts.shape[1]
    check("readings", rotations.shape[0] == rates.shape[0] == ship_variances.shape[0] == count)
    check("readings", angles.shape[0] == angle_variances.shape[0] == count)
    check("rotations", rotations.shape[1] == rotations.shape[2] == rates.shape[1] == 3)
    check("angles", angles.shape[1] == 2)
    steps: cython.bint = remaining_share.shape[0] > 0
    check("new", remaining_share.shape[1] == added_covariance.shape[1] == added_covariance.shape[2] == 3)
    check(
        "new",
        added_covariance.shape[0] == remaining_share.shape[0] and (remaining_share.shape[0] == count or not steps),
    )
    check("errors", errors.shape[0] == _ERRORS and exceeds_model.shape[0] == time_s.shape[0] == _CORRELATED)
    check("steady", steady.shape[0] == 2 and steady.shape[1] == steady.shape[2] == 3)
    check("parts", parts.shape[2] == size and (size == _ERRORS - 1 or size == _ERRORS))
    check("sources", min(ship, bending, encoder, white) >= 0 and max(ship, bending, encoder, white) < sources)
    of_rotations, of_errors = np.empty((count, 3, 3)), np.empty((count, 3, size))
    of_parts = np.empty((count, sources, 3, 3))
    rotation_nm: cython.double[:, :, ::1] = of_rotations
    by_error: cython.double[:, :, ::1] = of_errors
    out: cython.double[:, :, :, ::1] = of_parts
    now = cython.declare(cython.double[14])
    decay = cython.declare(cython.double[6])
    measured = cython.declare(cython.double[9])
    rate = cython.declare(cython.double[3])
    rotation_nd = cython.declare(cython.double[9])
    rotation_dm = cython.declare(cython.double[9])
    by_all = cython.declare(cython.double[42])
    by_encoder = cython.declare(cython.double[6])
    propagated = cython.declare(cython.double[42])
    fresh = cython.declare(cython.double[9])
    left = cython.declare(cython.double[3])
    since_s: cython.double
    for n in range(count):
        since_s = 1e-9 * max(since_ns[n], 0)
        for i in range(_ERRORS):
            now[i] = errors[i]
        for i in range(_CORRELATED):
            decay[i] = exp(-since_s / time_s[i])
            if not exceeds_model[i]:
                now[i] *= decay[i]
        for i in range(3):
            left[i] = remaining_share[n, i] if steps else 1.0
            now[i] *= left[i]
            rate[i] = rates[n, i]
            for j in range(3):
                measured[3 * i + j] = rotations[n, i, j]
        _axis_geometry(
            now,
            measured,
            rate,
            angles[n, 0],
            angles[n, 1],
            rotation_nd,
            rotation_dm,
            cython.address(rotation_nm[n, 0, 0]),
            by_all,
            by_encoder,
        )
        for i in range(3):
            for j in range(size):
                by_error[n, i, j] = propagated[size * i + j] = by_all[14 * i + j]
            for j in range(_CORRELATED):
                propagated[size * i + j] *= decay[j]
            for j in range(3):
                propagated[size * i + j] *= left[j]
        for s in range(sources):
            _projected_covariance(
                propagated,
                cython.cast(cython.p_double, cython.address(parts[s, 0, 0])),
                size,
                cython.address(out[n, s, 0, 0]),
            )
        for i in range(3):
            for j in range(3):
                fresh[3 * i + j] = (1.0 - decay[i] * decay[j]) * steady[0, i, j]
                if steps:
                    fresh[3 * i + j] = left[i] * fresh[3 * i + j] * left[j] + added_covariance[n, i, j]
        _add_projected(by_all, 14, fresh, cython.address(out[n, ship, 0, 0]))
        for i in range(3):
            for j in range(3):
                fresh[3 * i + j] = (1.0 - decay[3 + i] * decay[3 + j]) * steady[1, i, j]
        _add_projected(cython.address(by_all[3]), 14, fresh, cython.address(out[n, bending, 0, 0]))
        for i in range(3):
            out[n, white, i, i] += ship_variances[n]
            for j in range(3):
                out[n, encoder, i, j] += angle_variances[n] * (
                    by_encoder[2 * i] * by_encoder[2 * j] + by_encoder[2 * i + 1] * by_encoder[2 * j + 1]
                )
    return of_rotations, of_errors, of_parts


def totals(
    parts: cython.double[:, :, :, ::1],
    by_error: cython.const[cython.double][:, :, ::1],
    further_covariance: cython.const[cython.double][:, ::1],
    added: cython.const[cython.uchar][:],
    source: cython.Py_ssize_t,
):
    """Add the covariance of further errors to one error source, in place.

    Args:
        parts: covariance by error source, shape (N, n_sources, 3, 3).
        by_error: derivative with respect to the errors, shape (N, 3, k).
        further_covariance: symmetric covariance of the further errors, shape (k, k).
        added: true for each reading at which the further covariance is added, shape (N,).
        source: index of the error source.

    Returns:
        Sums over the error sources before and after the addition, shape (N, 3, 3) each.
    """
    count: cython.Py_ssize_t = parts.shape[0]
    sources: cython.Py_ssize_t = parts.shape[1]
    size: cython.Py_ssize_t = by_error.shape[2]
    check("covariances", parts.shape[2] == parts.shape[3] == by_error.shape[1] == 3)
    check("times", by_error.shape[0] == added.shape[0] == count)
    check("further_covariance", further_covariance.shape[0] == further_covariance.shape[1] == size)
    check("errors", 0 < size <= _ERRORS)
    check("source", 0 <= source < sources)
    of_before, of_after = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    before: cython.double[:, :, ::1] = of_before
    after: cython.double[:, :, ::1] = of_after
    further = cython.declare(cython.double[9])
    for n in range(count):
        for i in range(9):
            further[i] = 0.0
        if added[n]:
            _projected_covariance(
                cython.cast(cython.p_double, cython.address(by_error[n, 0, 0])),
                cython.cast(cython.p_double, cython.address(further_covariance[0, 0])),
                size,
                further,
            )
        for i in range(3):
            for j in range(3):
                before[n, i, j] = 0.0
                for s in range(sources):
                    before[n, i, j] += parts[n, s, i, j]
                parts[n, source, i, j] += further[3 * i + j]
                after[n, i, j] = before[n, i, j] + further[3 * i + j]
    return of_before, of_after


_COLUMNS = cython.declare(cython.int, 19)


@cython.cfunc
@cython.exceptval(check=False)
def _by_frame(
    row: cython.p_double, rotation: cython.p_double, sign: cython.double, out: cython.p_double
) -> cython.void:
    """Write sign × row × rotation (3 × 3)."""
    for j in range(3):
        out[j] = sign * (row[0] * rotation[j] + row[1] * rotation[3 + j] + row[2] * rotation[6 + j])


@cython.cfunc
@cython.exceptval(check=False)
def _by_turn(row: cython.p_double, vector: cython.p_double, sign: cython.double, out: cython.p_double) -> cython.void:
    """Write sign × the cross product of the row with the vector."""
    out[0] = sign * (row[1] * vector[2] - row[2] * vector[1])
    out[1] = sign * (row[2] * vector[0] - row[0] * vector[2])
    out[2] = sign * (row[0] * vector[1] - row[1] * vector[0])


def sight_lines(
    baselines: cython.const[cython.double][:, :, :],
    drones: cython.const[cython.double][:, :, :, :],
    beacon_levers: cython.const[cython.double][:, :, :],
    ships: cython.const[cython.double][:, :, :],
    mounts: cython.const[cython.double][:, :, :],
    lever: cython.const[cython.double][:],
    principal_point: cython.const[cython.double][:],
    refraction: cython.const[cython.double][:, :],
    earth_radius_m: cython.double,
):
    """Return the directions of N beacons from a telescope on a ship, in each of E exposures.

    Args:
        baselines: vectors from the ship's antenna to the drones' antennas, in n (North, Up, East), m, shape (E, N, 3).
        drones: attitudes of the drones (n from b), shape (E, N, 3, 3).
        beacon_levers: vectors from each drone's antenna to its light, in b, m, shape (E, N, 3).
        ships: attitudes of the ship (n from d), shape (E, 3, 3).
        mounts: attitudes of the main frame of the mount (d from m), shape (E, 3, 3).
        lever: vector from the ship's antenna to the mount, in d, m, shape (3,).
        principal_point: principal point of the lens relative to the mount, in frame m, metres, shape (3,).
        refraction: refraction coefficient k of each sight line, shape (E, N).
        earth_radius_m: Earth radius R; a light at the distance d seems to be k d²/(2 R) higher, m.

    Returns:
        Unit vectors in n, refraction included, shape (E, N, 3).
        Distances, m, shape (E, N).
        Derivatives of the unit vectors, rad per unit, shape (E, N, 3, 19). Three columns each are the derivatives
        with respect to the baseline (n), the lever (d), the principal point (m), the light's lever (b), and the
        rotation vectors (n) of ship and drone. The last column is the derivative with respect to the refraction
        coefficient.
    """
    epochs: cython.Py_ssize_t = baselines.shape[0]
    count: cython.Py_ssize_t = baselines.shape[1]
    check("baselines", baselines.shape[2] == beacon_levers.shape[2] == 3)
    check("drones", drones.shape[0] == beacon_levers.shape[0] == refraction.shape[0] == epochs)
    check("drones", drones.shape[1] == beacon_levers.shape[1] == refraction.shape[1] == count)
    check("drones", drones.shape[2] == drones.shape[3] == 3)
    check("ships", ships.shape[0] == mounts.shape[0] == epochs)
    check("ships", ships.shape[1] == ships.shape[2] == mounts.shape[1] == mounts.shape[2] == 3)
    check("lever", lever.shape[0] == principal_point.shape[0] == 3)
    of_directions, of_distances = np.empty((epochs, count, 3)), np.empty((epochs, count))
    of_changes = np.empty((epochs, count, 3, _COLUMNS))
    directions: cython.double[:, :, ::1] = of_directions
    distances: cython.double[:, ::1] = of_distances
    changes: cython.double[:, :, :, ::1] = of_changes
    rotation_nd = cython.declare(cython.double[9])
    rotation_dm = cython.declare(cython.double[9])
    rotation_nm = cython.declare(cython.double[9])
    rotation_nb = cython.declare(cython.double[9])
    lens = cython.declare(cython.double[3])
    light = cython.declare(cython.double[3])
    seen = cython.declare(cython.double[3])
    row = cython.declare(cython.double[3])
    raised: cython.double
    length: cython.double
    out: cython.p_double
    for e in range(epochs):
        _copy(ships[e], rotation_nd)
        _copy(mounts[e], rotation_dm)
        _times(rotation_nd, rotation_dm, rotation_nm)
        for i in range(3):
            lens[i] = 0.0
            for j in range(3):
                lens[i] += rotation_nd[3 * i + j] * lever[j] + rotation_nm[3 * i + j] * principal_point[j]
        for n in range(count):
            _copy(drones[e, n], rotation_nb)
            length = 0.0
            for i in range(3):
                light[i] = 0.0
                for j in range(3):
                    light[i] += rotation_nb[3 * i + j] * beacon_levers[e, n, j]
                seen[i] = baselines[e, n, i] + light[i] - lens[i]
                length += seen[i] * seen[i]
            distances[e, n] = sqrt(length)
            # Height by which refraction raises the light if its coefficient is 1, m.
            raised = length / (2.0 * earth_radius_m)
            seen[1] += refraction[e, n] * raised
            length = sqrt(seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2])
            for i in range(3):
                directions[e, n, i] = seen[i] / length
            for i in range(3):
                for j in range(3):
                    row[j] = ((1.0 if i == j else 0.0) - directions[e, n, i] * directions[e, n, j]) / length
                out = cython.address(changes[e, n, i, 0])
                out[0], out[1], out[2] = row[0], row[1], row[2]
                _by_frame(row, rotation_nd, -1.0, out + 3)
                _by_frame(row, rotation_nm, -1.0, out + 6)
                _by_frame(row, rotation_nb, 1.0, out + 9)
                _by_turn(row, lens, 1.0, out + 12)
                _by_turn(row, light, -1.0, out + 15)
                out[18] = row[1] * raised
    return of_directions, of_distances, of_changes


def image_points(
    directions: cython.const[cython.double][:, :, :],
    telescopes: cython.const[cython.double][:, :, :],
    focal_lengths_m: cython.const[cython.double][:],
    principal_points_m: cython.const[cython.double][:, :],
):
    """Return the image points of N beacons on the detector of a telescope, in each of E exposures.

    The image point of a beacon behind the telescope is NaN.

    Args:
        directions: directions of the beacons in n, shape (E, N, 3).
        telescopes: attitudes of the telescope (n from t: forward, up, right), shape (E, 3, 3).
        focal_lengths_m: focal length in each exposure, shape (E,).
        principal_points_m: principal point of the detector in each exposure (x right, z up), shape (E, 2).

    Returns:
        Image points, m, shape (E, N, 2).
        Derivatives of the points with respect to the rotation vector of the telescope in n, m/rad, shape (E, N, 2, 3).
        Derivatives of the points with respect to the directions, m/rad, shape (E, N, 2, 3).
        Derivatives of the points with respect to the focal length, m/m, shape (E, N, 2).
    """
    epochs: cython.Py_ssize_t = directions.shape[0]
    count: cython.Py_ssize_t = directions.shape[1]
    check("directions", directions.shape[2] == telescopes.shape[1] == telescopes.shape[2] == 3)
    check("telescopes", telescopes.shape[0] == focal_lengths_m.shape[0] == principal_points_m.shape[0] == epochs)
    check("principal points", principal_points_m.shape[1] == 2)
    of_points, of_focal_lengths = np.empty((epochs, count, 2)), np.empty((epochs, count, 2))
    of_attitudes, of_directions = np.empty((epochs, count, 2, 3)), np.empty((epochs, count, 2, 3))
    points: cython.double[:, :, ::1] = of_points
    by_focal_length: cython.double[:, :, ::1] = of_focal_lengths
    by_attitude: cython.double[:, :, :, ::1] = of_attitudes
    by_direction: cython.double[:, :, :, ::1] = of_directions
    rotation_nt = cython.declare(cython.double[9])
    seen_n = cython.declare(cython.double[3])
    seen_t = cython.declare(cython.double[3])
    across: cython.double
    scale: cython.double
    for e in range(epochs):
        _copy(telescopes[e], rotation_nt)
        for n in range(count):
            for i in range(3):
                seen_n[i] = directions[e, n, i]
            _by_frame(seen_n, rotation_nt, 1.0, seen_t)
            if not seen_t[0] > 0.0:
                seen_t[0] = NAN
            # The image is inverted. k = 0: x, from the right component; k = 1: z, from the up component.
            for k in range(2):
                across = seen_t[2 - k] / seen_t[0]
                scale = -focal_lengths_m[e] / seen_t[0]
                by_focal_length[e, n, k] = -across
                points[e, n, k] = principal_points_m[e, k] - focal_lengths_m[e] * across
                for i in range(3):
                    by_direction[e, n, k, i] = scale * (rotation_nt[3 * i + 2 - k] - across * rotation_nt[3 * i])
                _by_turn(
                    cython.address(by_direction[e, n, k, 0]), seen_n, 1.0, cython.address(by_attitude[e, n, k, 0])
                )
    return of_points, of_attitudes, of_directions, of_focal_lengths


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
    for beacon in range(count):
        for a in range(2):
            for b in range(2):
                for i in range(3):
                    for j in range(3):
                        out[2 * beacon + a, 2 * beacon + b] += (
                            by_error[beacon, a, i] * covariance[beacon, i, j] * by_error[beacon, b, j]
                        )
    return result

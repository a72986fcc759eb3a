# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled lines of sight to N beacons and their image points, for one or more exposures.

There is no other implementation. The module is Python with C types; Cython compiles it when the package is built. The
models are documented in ``line_of_sight`` and ``image`` of :mod:`theodolite_calib.lights`.
"""

import cython
import numpy as np

from ship_geometry.compiled_shapes import check

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")

from cython.cimports.libc.math import NAN, sqrt
from cython.cimports.ship_geometry.compiled_rotations import _times

_COLUMNS = cython.declare(cython.int, 19)


@cython.cfunc
@cython.exceptval(check=False)
def _copy(matrix: cython.const[cython.double][:, :], out: cython.p_double) -> cython.void:
    """Copy the nine elements of a 3 × 3 matrix of any memory layout, row by row."""
    i: cython.int
    j: cython.int
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = matrix[i, j]


@cython.cfunc
@cython.exceptval(check=False)
def _by_frame(
    row: cython.p_double, rotation: cython.p_double, sign: cython.double, out: cython.p_double
) -> cython.void:
    """Write sign × row × rotation (3 × 3)."""
    j: cython.int
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
    e: cython.Py_ssize_t
    n: cython.Py_ssize_t
    i: cython.int
    j: cython.int
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
    e: cython.Py_ssize_t
    n: cython.Py_ssize_t
    i: cython.int
    k: cython.int
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

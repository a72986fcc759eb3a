"""Which stars a sensor has in its field, and where on the detector, exposure by exposure."""

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ship_attitude_star.sky.catalogue import hipparcos
from ship_attitude_star.stars.camera import StarCamera
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.star_directions import StarPositions
from ship_simulation.scenario.scenario import Detector, StarSensor
from ship_simulation.stars.sky import TrueSky

# Candidates are chosen once for exposures within this time, so that they are few.
_BLOCK_S = 2.0
# What moves a star from its place of J2000.0 to where it is seen: aberration, refraction, two centuries of motion, and
# the Earth's rotation within a block.
_MARGIN = np.deg2rad(0.5)

NEIGHBOURHOOD = 120.0 * ARCSEC
"""How far from the true star a confused one may stand, rad."""

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class FieldStars:
    """Stars as they stand on the detector, without errors of their centroids; exposure after exposure.

    Attributes:
        exposure: number of the exposure, shape (k,).
        row: of the catalogue, shape (k,).
        direction_s: in the sensor frame, with air, shape (k, 3).
        pixel: (u, v), shape (k, 2).
    """

    exposure: np.ndarray
    row: np.ndarray
    direction_s: FloatArray
    pixel: FloatArray


def stars_in_field(sensor: StarSensor, sky: TrueSky, rotation_nv: FloatArray, valid_ns: np.ndarray) -> FieldStars:
    """The brightest stars in the field of each exposure.

    Args:
        sensor: its camera, magnitude limit and number of stars.
        sky: the true one.
        rotation_nv: horizon from sensor at each exposure, shape (n, 3, 3).
        valid_ns: their moments, shape (n,).
    """
    camera = sensor.camera.camera("camera")
    bright = sky.catalogue.brighter_than(sensor.magnitude_limit)
    bright = bright[np.argsort(sky.catalogue.magnitude[bright], kind="stable")]
    places = sky.positions[bright]
    place_c = erfa.s2c(places.right_ascension, places.declination)
    least_cosine = np.cos(_radius(camera, sensor.camera) + _MARGIN)
    parts = []
    block = max(int(_BLOCK_S * sensor.rate_hz), 1)
    for start in range(0, valid_ns.size, block):
        exposures = slice(start, start + block)
        boresight_c = rotation_nv[exposures, :, 0] @ sky.rotation_horizon_from_icrs(valid_ns[start])
        near = np.any(boresight_c @ place_c.T > least_cosine, axis=0)
        candidates = bright[near]
        direction_n = sky.directions(sky.positions[candidates], valid_ns[exposures, None])
        # R^T v of each star, as rows.
        direction_s = direction_n @ rotation_nv[exposures]
        pixel = camera.pixels(direction_s)
        inside = sensor.camera.holds(pixel)
        # Columns run from bright to faint.
        exposure, column = np.nonzero(inside & (np.cumsum(inside, axis=1) <= sensor.most_stars))
        parts.append(
            FieldStars(
                start + exposure, candidates[column], direction_s[exposure, column], pixel[exposure, column]
            )
        )
    if not parts:
        return FieldStars(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 2)))
    return FieldStars(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))


def _radius(camera: StarCamera, detector: Detector) -> float:
    """Angle from the boresight to the farthest corner of the detector, rad."""
    (left, top), (right, bottom) = detector.edges_px
    corners_s = camera.directions(np.array([[left, top], [left, bottom], [right, top], [right, bottom]]))
    return float(np.arccos(corners_s[:, 0].min()))


def swapped_identities(
    rows: Rows, exposure: NDArray[np.int64], probability: float, rng: np.random.Generator
) -> Rows:
    """Identities of which, in some exposures, two are exchanged.

    Args:
        rows: rows of the catalogue, a star each, shape (k,).
        exposure: number of the exposure that a star belongs to, not decreasing, shape (k,).
        probability: of a swap in an exposure with two stars or more.
        rng: source of the draws.

    Returns:
        The rows claimed, shape (k,).
    """
    claimed = rows.copy()
    _, first, count = np.unique(exposure, return_index=True, return_counts=True)
    chosen = (rng.random(first.size) < probability) & (count >= 2)
    # Two different stars of each: the second is counted on from the first.
    one = rng.integers(0, count[chosen])
    other = (one + rng.integers(1, count[chosen])) % count[chosen]
    one, other = first[chosen] + one, first[chosen] + other
    claimed[one], claimed[other] = rows[other], rows[one]
    return claimed


def neighbour_identities(hip: NDArray[np.int64], rng: np.random.Generator) -> tuple[NDArray[np.int64], StarPositions]:
    """Each star taken for another one within 120″.

    Where the catalogue has such stars, one of them; elsewhere the star's own place, moved by up to 120″ and without
    a number.

    Args:
        hip: HIP numbers of true stars, shape (k,).
        rng: source of the draws.

    Returns:
        HIP numbers claimed, 0 where a direction is given instead, and the positions claimed, J2000.0; both (k,).
    """
    catalogue = hipparcos()
    rows = catalogue.rows(hip)
    first, neighbours = _neighbours()
    count = first[rows + 1] - first[rows]
    # Where there is no neighbour any row will do: it is not used.
    choice = np.minimum(first[rows] + rng.integers(0, np.maximum(count, 1)), neighbours.size - 1)
    neighbour = np.where(count > 0, neighbours[choice], rows)
    # Uniform over the disc.
    distance, bearing = NEIGHBOURHOOD * np.sqrt(rng.random(rows.size)), 2.0 * np.pi * rng.random(rows.size)
    moved = np.where(count > 0, 0.0, distance)
    stars = catalogue.at_j2000[neighbour]
    positions = dataclasses.replace(
        stars,
        right_ascension=stars.right_ascension + moved * np.sin(bearing) / np.cos(stars.declination),
        declination=stars.declination + moved * np.cos(bearing),
    )
    return np.where(count > 0, catalogue.hip[neighbour], 0), positions


@lru_cache(maxsize=1)
def _neighbours() -> tuple[Rows, Rows]:
    """Stars within 120″ of each star: those of row i are ``rows[first[i] : first[i + 1]]``."""
    stars = hipparcos().at_j2000
    directions_c = erfa.s2c(stars.right_ascension, stars.declination)
    # The chord of the angle.
    pairs = cKDTree(directions_c).query_pairs(2.0 * np.sin(0.5 * NEIGHBOURHOOD), output_type="ndarray")
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    first = np.searchsorted(both[:, 0], np.arange(len(directions_c) + 1))
    return first, both[:, 1]

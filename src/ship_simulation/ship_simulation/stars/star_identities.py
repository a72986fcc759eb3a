"""Wrong identities of stars, as sensors give them: that of another star in the field, or of a neighbour in the sky."""

import dataclasses
from functools import lru_cache

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ship_attitude_star.sky.catalogue import hipparcos
from ship_geometry.rotations import ARCSEC
from ship_geometry.star_directions import StarPositions

NEIGHBOURHOOD = 120.0 * ARCSEC
"""How far from the true star a confused one may stand, rad."""

Rows = NDArray[np.int64]


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
    directions_i = erfa.s2c(stars.right_ascension, stars.declination)
    # The chord of the angle.
    pairs = cKDTree(directions_i).query_pairs(2.0 * np.sin(0.5 * NEIGHBOURHOOD), output_type="ndarray")
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    first = np.searchsorted(both[:, 0], np.arange(len(directions_i) + 1))
    return first, both[:, 1]

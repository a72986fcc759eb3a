"""Stars in a sensor's field of view, their pixels, and swapped identities."""

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.scenario import Detector, StarImaging
from ship_simulation.stars.sky import TrueSky
from ship_stars.camera.camera import StarCamera

# Candidates are selected once for all exposures of a block of this length, s.
_BLOCK_S = 2
# Margin for the motion of a star from its J2000.0 position to its apparent one: aberration, refraction, two centuries
# of proper motion, and the Earth's rotation within a block.
_MARGIN = np.deg2rad(0.5)

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class FieldStars:
    """True star images on the detector, exposure after exposure.

    Attributes:
        exposure: number of the exposure, shape (k,).
        row: row of the star in the catalogue, shape (k,).
        direction_s: directions in the sensor frame, with refraction, shape (k, 3).
        pixel: (u, v), shape (k, 2).
    """

    exposure: np.ndarray
    row: np.ndarray
    direction_s: FloatArray
    pixel: FloatArray


def stars_in_field(
    sensor: StarImaging, sky: TrueSky, rotation_nv: FloatArray, valid_ns: np.ndarray, since_start_s: FloatArray
) -> FieldStars:
    """Return the brightest unobstructed stars in the field of each exposure.

    Args:
        sensor: camera, masks, magnitude limit and maximum number of stars of the sensor.
        sky: the true sky.
        rotation_nv: horizon from sensor at each exposure, shape (n, 3, 3).
        valid_ns: times of the exposures, shape (n,).
        since_start_s: stamps of the exposures after the start, increasing, shape (n,).
    """
    camera, masks = sensor.camera.camera("camera"), sensor.sight_masks
    bright = sky.catalogue.rows_brighter_than(sensor.magnitude_limit)
    bright = bright[np.argsort(sky.catalogue.magnitude[bright], kind="stable")]
    positions = sky.positions[bright]
    place_c = erfa.s2c(positions.right_ascension, positions.declination)
    least_cosine = np.cos(_radius(camera, sensor.camera) + _MARGIN)
    parts = []
    starts = np.flatnonzero(np.diff(since_start_s // _BLOCK_S, prepend=-1.0))
    for start, end in zip(starts, np.append(starts, valid_ns.size)[1:], strict=True):
        exposures = slice(start, end)
        boresight_c = rotation_nv[exposures, :, 0] @ sky.rotation_horizon_from_icrs(valid_ns[start])
        near = np.any(boresight_c @ place_c.T > least_cosine, axis=0)
        candidates = bright[near]
        direction_n = sky.directions(sky.positions[candidates], valid_ns[exposures, None])
        # R^T v of each star, as rows.
        direction_s = direction_n @ rotation_nv[exposures]
        pixel = camera.pixels(direction_s)
        inside = sensor.camera.contains(pixel)
        if masks is not None:
            inside[inside] = ~masks.is_hidden(direction_s[inside])
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
    """Return the angle from the boresight to the farthest corner of the detector, rad."""
    (left, top), (right, bottom) = detector.edges_px
    corners_s = camera.directions(np.array([[left, top], [left, bottom], [right, top], [right, bottom]]))
    return float(np.arccos(corners_s[:, 0].min()))


def swap_identities(
    rows: Rows, exposure: NDArray[np.int64], probability: float, rng: np.random.Generator
) -> Rows:
    """Return reported star identities: in some exposures, the identities of two stars are swapped.

    Args:
        rows: rows of the catalogue, one per star, shape (k,).
        exposure: number of the exposure of each star, not decreasing, shape (k,).
        probability: probability of a swap in an exposure with two stars or more.
        rng: source of the draws.

    Returns:
        The reported rows, shape (k,).
    """
    claimed: Rows = rows.copy()
    _, first, count = np.unique(exposure, return_index=True, return_counts=True)
    swap, one, other = rng.random((first.size, 3)).T
    chosen = (swap < probability) & (count >= 2)
    first, count = first[chosen], count[chosen]
    # Two different stars of each exposure: the second has a random offset from the first.
    one = (one[chosen] * count).astype(np.int64)
    other = (one + 1 + (other[chosen] * (count - 1)).astype(np.int64)) % count
    one, other = first + one, first + other
    claimed[one], claimed[other] = rows[other], rows[one]
    return claimed

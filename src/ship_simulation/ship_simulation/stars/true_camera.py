"""The true camera of a star sensor: its optics, the errors of its detector, and the stars in its field of view.

The true optics differ from the optics given to the suite by errors of the stated sigmas. The mounting is calibrated
through the camera: a star in the nominal boresight direction is imaged on the nominal principal point. A camera whose
true principal point differs is therefore rotated.

Errors of centroids that depend on the position on the detector are constant over time. The field-spatial error is a
smooth random function of the position: a sum of many waves, minus its mean over the detector. The wave numbers are
drawn from the normal distribution of a Gaussian correlation, whose length is three quarters of a side of the detector.
The pixel-spatial error is an independent number for each pixel and axis. This module shares nothing with the
estimators, which represent the field-spatial error as a polynomial.
"""

from dataclasses import dataclass, replace

import erfa
import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.scenario import Detector, StarImaging
from ship_simulation.stars.sky import TrueSky
from ship_stars.camera.camera import Distortion, StarCamera

_SURVEYED_FOCAL_SIGMA = 2e-4
"""Relative standard deviation of a focal length whose sigma is not given, as documented at the parameter."""

_WAVES, _LENGTH = 200, 1.5
"""Number of waves, and correlation length in half sides of the detector."""

_TILE_PX = 512
"""Period with which the pixel-spatial errors repeat, px; the stars do not reveal the repetition."""

# Candidates are selected once for all exposures of a block of this length, s.
_BLOCK_S = 2
# Margin for the motion of a star from its J2000.0 position to its apparent one: aberration, refraction, two centuries
# of proper motion, and the Earth's rotation within a block.
_MARGIN = np.deg2rad(0.5)


@dataclass(frozen=True)
class TrueOptics:
    """The true optics of a camera.

    Attributes:
        camera: camera with the true parameters.
        rotation_cs: frame of the true optical axis from the frame of the sensor, shape (3, 3).
    """

    camera: StarCamera
    rotation_cs: FloatArray

    def pixels(self, directions_s: FloatArray) -> FloatArray:
        """Return pixels (u, v) of directions in the sensor frame, shape (..., 3) → (..., 2)."""
        return self.camera.pixels(directions_s @ self.rotation_cs.T)


def draw_optics(rng: np.random.Generator, detector: Detector, name: str) -> TrueOptics:
    """Draw the true optics of a camera around the configured optics.

    Args:
        rng: random generator of the optics of this camera.
        detector: configured camera and detector, with the sigmas.
        name: name of the camera, for an error message.
    """
    configured = detector.camera(name)
    focal, principal_u, principal_v, k1 = rng.standard_normal(4)
    focal *= detector.focal_length_sigma_m / configured.focal_length_m or _SURVEYED_FOCAL_SIGMA
    distortion = configured.distortion or Distortion()
    true = StarCamera(
        configured.focal_length_m * (1.0 + focal),
        configured.pixel_pitch_m,
        configured.principal_u_px + detector.principal_sigma_px * principal_u,
        configured.principal_v_px + detector.principal_sigma_px * principal_v,
        replace(distortion, k1=distortion.k1 + detector.distortion_sigma * k1),
    )
    # Forward axis of the sensor in the true camera's frame, and two axes across it.
    forward_c = true.directions(np.array([configured.principal_u_px, configured.principal_v_px]))
    right_c = np.cross(forward_c, [0.0, 1.0, 0.0])
    right_c /= np.linalg.norm(right_c)
    return TrueOptics(true, np.stack([forward_c, np.cross(right_c, forward_c), right_c], axis=-1))


class DetectorErrors:
    """The errors of one detector, drawn once.

    Args:
        rng: source of the draws.
        detector: size of the detector, and sigmas of the errors.
    """

    def __init__(self, rng: np.random.Generator, detector: Detector) -> None:
        least, greatest = detector.edges_px
        self._middle_px, self._half_px = (least + greatest) / 2.0, (greatest - least) / 2.0
        # Wave numbers along the two axes of the detector (last index), of the errors in u and in v (middle index).
        self._number = rng.standard_normal((_WAVES, 2, 2)) / _LENGTH
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (_WAVES, 2))
        # Mean of a wave over the detector, and mean square of the wave without this mean, averaged over phases.
        self._mean = np.prod(np.sinc(self._number / np.pi), axis=-1)
        mean_square = 0.5 * np.mean(1.0 - self._mean**2, axis=0)
        self._amplitude = detector.field_spatial_sigma_px / np.sqrt(_WAVES * mean_square)
        # Drawing a tile is slow, so it is left out for a detector without such errors.
        tile_px = _TILE_PX if detector.pixel_spatial_sigma_px > 0.0 else 1
        self._pixel = detector.pixel_spatial_sigma_px * rng.standard_normal((tile_px, tile_px, 2))

    def errors_at(self, pixels: FloatArray) -> FloatArray:
        """Return errors in (u, v) of centroids at pixels, shape (..., 2); NaN if a pixel is not finite."""
        found = np.full(pixels.shape, np.nan)
        finite = np.all(np.isfinite(pixels), axis=-1)
        places = (pixels[finite] - self._middle_px) / self._half_px
        waves = np.cos(np.einsum("wac,kc->kwa", self._number, places) + self._phase)
        field = self._amplitude * np.sum(waves - self._mean * np.cos(self._phase), axis=1)
        row, column = np.rint(pixels[finite]).astype(np.int64).T % len(self._pixel)
        found[finite] = field + self._pixel[row, column]
        return found

    def drop_before(self, before_s: float) -> None:
        """Do nothing: the errors of a detector do not depend on time."""


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

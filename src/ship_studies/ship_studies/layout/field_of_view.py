"""Field of view of a star sensor: obstructions on deck, the horizon while the ship moves, and the noise from the stars.

The attitude noise is computed from the optics, with the catalogue's stars and with Liebe's formulas.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_stars.sky.catalogue import hipparcos
from ship_stars.sky.deck_masks import DeckMasks, deck_masks, field_directions
from ship_studies.layout.config import LayoutStudyConfig, Optics
from ship_studies.layout.installation_model import rotations

_NO_MASKS = DeckMasks((), ())

MIN_STARS = 2
"""Least number of stars that give an attitude."""

PERCENTILES = (1, 5, 10, 50)
"""Percentiles over the sky of the reported star counts."""

_DIRECTIONS = 1000
_SEED = 20020401
_BATCH_SIZE = 100
_MEAN_DISTANCE = 0.3825


@dataclass(frozen=True)
class Obstructions:
    """The masks and the horizon of a study.

    Attributes:
        masks: obstructions on deck.
        half_fields: for each sensor, tangents of half the field of view along its right and up axes, shape (N, 2).
        up_d: upward direction in the deck frame, for mean and extreme pitch and roll of the ship, shape (9, 3).
        clearance: required elevation of a field above the horizon, rad.
    """

    masks: DeckMasks
    half_fields: FloatArray
    up_d: FloatArray
    clearance: float

    @classmethod
    def from_config(cls, config: LayoutStudyConfig) -> "Obstructions":
        """Return the masks and the horizon of a study's file.

        Raises:
            ParameterError: a mask is not a valid polygon.
        """
        half = np.tan(np.deg2rad(config.field_of_view_deg) / 2.0)
        optics, horizon = config.optics, config.horizon
        half_fields = [optics[name].half_field() if name in optics else np.full(2, half) for name in config.sensors]
        pitch = np.deg2rad(config.ship_pitch_deg + horizon.pitch_deg * np.array([-1.0, 0.0, 1.0]))
        roll = np.deg2rad(config.ship_roll_deg + horizon.roll_deg * np.array([-1.0, 0.0, 1.0]))
        rotations_nd = rotation_from_angles(np.zeros((3, 3)), *np.broadcast_arrays(pitch[:, None], roll))
        return cls(
            masks=deck_masks(config.masks, "masks") or _NO_MASKS,
            half_fields=np.array(half_fields),
            up_d=rotations_nd[..., 1, :].reshape(-1, 3),
            clearance=float(np.deg2rad(horizon.clearance_deg)),
        )

    def masks_in_view(self, number: int, angles: FloatArray) -> list[str]:
        """Return the names of the masks in the field of a sensor mounted at (azimuth, elevation, roll), rad."""
        reaching = self.masks.masks_in_field(rotation_from_angles(*angles)[None], self.half_fields[number])
        return [name for name, reaches in zip(self.masks.names, reaching, strict=True) if reaches[0]]

    def is_clear(self, number: int, angles: FloatArray) -> NDArray[np.bool_]:
        """True if the field of a sensor is clear of all masks, for installation angles (n, 3), rad; shape (n,)."""
        reached: NDArray[np.bool_] = np.any(
            self.masks.masks_in_field(rotations(angles), self.half_fields[number]), axis=0
        )
        return ~reached

    def horizon_margin(self, number: int, angles: FloatArray) -> FloatArray:
        """Return the lowest elevation of a field while the ship moves, minus the clearance, shape (n,), rad.

        Args:
            number: number of the sensor.
            angles: installation angles, shape (n, 3), rad.
        """
        field_d = field_directions(self.half_fields[number]) @ np.swapaxes(rotations(angles), -1, -2)
        lowest: FloatArray = np.arcsin(np.min(field_d @ self.up_d.T, axis=(-2, -1)).clip(-1.0, 1.0))
        return lowest - self.clearance

    def is_unobstructed(self, number: int, angles: FloatArray) -> NDArray[np.bool_]:
        """True if a field is clear of masks and horizon, for installation angles (n, 3), rad; shape (n,)."""
        return self.is_clear(number, angles) & (self.horizon_margin(number, angles) >= 0.0)


@dataclass(frozen=True)
class SkyStatistics:
    """Star counts and attitude noise of optics over the whole sky.

    Attributes:
        field_deg: width and height of the field of view.
        star_sigma_arcsec: noise of the direction of one star, per axis.
        stars: number of stars in the field for each of many uniformly drawn directions and rolls, shape (n,).
        sigmas_arcsec: sigma about (forward, up, right) for each direction, shape (n, 3); infinite with too few stars.
        quantile_arcsec: sigma about (forward, up, right) not exceeded in the required share of the sky, shape (3,).
        liebe_arcsec: sigma about (forward, up, right) by Liebe's formulas with the mean number of stars, shape (3,).
    """

    field_deg: tuple[float, float]
    star_sigma_arcsec: float
    stars: FloatArray
    sigmas_arcsec: FloatArray
    quantile_arcsec: FloatArray
    liebe_arcsec: FloatArray

    def star_count_percentiles(self) -> dict[int, float]:
        """Return percentile over the sky → star count."""
        return {percent: float(np.percentile(self.stars, percent, method="lower")) for percent in PERCENTILES}

    def share_without_attitude(self) -> float:
        """Return the share of the sky with too few stars for an attitude."""
        return float(np.mean(self.stars < MIN_STARS))


def sky_statistics(optics: Optics) -> SkyStatistics:
    """Return the stars in the field and the noise of the attitude over the sky, with the Hipparcos-2 catalogue.

    Directions and rolls are drawn with a fixed seed.
    """
    sigma = optics.star_sigma()
    fields = list(_fields(optics))
    stars = np.array([float(len(seen)) for seen in fields])
    sigmas = np.array([attitude_sigmas(seen, sigma) for seen in fields])
    # Interpolation between infinite values would be NaN: the upper value is taken.
    quantile = np.quantile(sigmas, optics.sky_share, axis=0, method="higher")
    arcsec = np.rad2deg(1.0) * 3600.0
    width, height = np.rad2deg(2.0 * np.arctan(optics.half_field()))
    return SkyStatistics(
        field_deg=(float(width), float(height)),
        star_sigma_arcsec=sigma * arcsec,
        stars=stars,
        sigmas_arcsec=sigmas * arcsec,
        quantile_arcsec=quantile * arcsec,
        liebe_arcsec=liebe_sigmas(optics, float(stars.mean())) * arcsec,
    )


def liebe_sigmas(optics: Optics, stars: float) -> FloatArray:
    """Return sigma about (forward, up, right) by Liebe's formulas, shape (3,), rad.

    Args:
        optics: optics of the sensor. The pixel count of the formula about the boresight is the root of columns times
            rows.
        stars: number of stars in the field.
    """
    with np.errstate(divide="ignore"):
        fewer = np.sqrt(np.float64(1.0) / stars)
    pixels = np.sqrt(float(optics.width_px * optics.height_px))
    about = np.arctan(optics.centroid_sigma_px / (_MEAN_DISTANCE * pixels))
    # A rotation about the up axis moves stars along the rows.
    width, height = 2.0 * np.arctan(optics.half_field())
    about_up = width * optics.centroid_sigma_px / optics.width_px
    about_right = height * optics.centroid_sigma_px / optics.height_px
    sigmas: FloatArray = np.array([about, about_up, about_right]) * fewer
    return sigmas


def attitude_sigmas(stars_s: FloatArray, sigma: float) -> FloatArray:
    """Return sigma about (forward, up, right) of the attitude from stars, (3,), rad; infinite for one star or none.

    The covariance is that of the best attitude, (Σ σ⁻² (I − v vᵀ))⁻¹.

    Args:
        stars_s: unit vectors of the stars in the sensor frame, shape (k, 3).
        sigma: noise of each direction, per axis, rad.
    """
    if len(stars_s) < MIN_STARS:
        return np.full(3, np.inf)
    information = len(stars_s) * np.eye(3) - stars_s.T @ stars_s
    sigmas: FloatArray = sigma * np.sqrt(np.diagonal(np.linalg.inv(information)))
    return sigmas


def _fields(optics: Optics) -> Iterator[FloatArray]:
    """Yield the stars in the field of each drawn direction: unit vectors in the sensor frame, shape (k, 3)."""
    stars = _stars_up_to(optics.magnitude_limit)
    half = optics.half_field()
    rotations_sc = _draw_rotations()
    for first in range(0, _DIRECTIONS, _BATCH_SIZE):
        turned = np.einsum("nij,kj->nki", rotations_sc[first : first + _BATCH_SIZE], stars)
        inside = (turned[..., 0] > 0.0) & (np.abs(turned[..., 2]) <= half[0] * turned[..., 0])
        inside &= np.abs(turned[..., 1]) <= half[1] * turned[..., 0]
        for seen, of_field in zip(turned, inside, strict=True):
            yield seen[of_field]


@lru_cache(maxsize=4)
def _stars_up_to(magnitude: float) -> FloatArray:
    """Return unit vectors of the stars up to a magnitude, shape (k, 3)."""
    catalogue = hipparcos()
    rows = catalogue.rows_brighter_than(magnitude)
    # The motion of the stars since the epoch is negligible compared with a field of view.
    alpha, delta = catalogue.at_epoch.right_ascension[rows], catalogue.at_epoch.declination[rows]
    return np.stack([np.cos(delta) * np.cos(alpha), np.cos(delta) * np.sin(alpha), np.sin(delta)], axis=-1)


def _draw_rotations() -> FloatArray:
    """Return uniformly distributed rotations, shape (n, 3, 3): orthogonal factors of matrices of normal numbers."""
    factors, triangles = np.linalg.qr(np.random.default_rng(_SEED).standard_normal((_DIRECTIONS, 3, 3)))
    # With a positive diagonal of the triangular factors, the orthogonal factors are uniformly distributed (Mezzadri,
    # 2007). Then reflections are changed into rotations.
    factors *= np.sign(np.diagonal(triangles, axis1=-2, axis2=-1))[:, None, :]
    factors[:, :, 0] *= np.linalg.det(factors)[:, None]
    return factors

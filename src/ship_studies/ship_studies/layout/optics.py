"""Attitude noise of a star sensor from its optics, with the catalogue's stars and with Liebe's formulas.

C. C. Liebe, "Accuracy performance of star trackers: a tutorial", IEEE Transactions on Aerospace and Electronic Systems
38(2), 2002, gives for N stars in a square field:

    across the boresight    field · centroid / (pixels · √N)
    about the boresight     atan(centroid / (0.3825 · pixels)) / √N

0.3825 is the *mean* distance of a star from the middle of a square field, in sides. The attitude depends on the root
mean square distance, 1/√6 = 0.4082. So with many stars the sigma of the second formula is 7 % larger than that of the
attitude. With few stars the sigma of the attitude is larger, because it depends on the distances of the stars from
their own mean. The layout study uses the covariance with the catalogue's stars, and shows Liebe's values for
comparison.

The magnitude limit is a parameter and is not derived from aperture and exposure, because it also depends on the
brightness of the sky, the read-out noise and the streaks of a rolling ship.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_stars.sky.catalogue import hipparcos
from ship_studies.layout.config import Optics

MIN_STARS = 2
"""Least number of stars that give an attitude."""

PERCENTILES = (1, 5, 10, 50)
"""Percentiles over the sky of the reported star counts."""

_DIRECTIONS = 1000
_SEED = 20020401
_BATCH_SIZE = 100
_MEAN_DISTANCE = 0.3825


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

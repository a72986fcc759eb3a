"""Errors of a camera: its optics parameters, and errors of a centroid that depend on its position on the detector.

The errors of focal length, principal point and leading radial distortion are constant and common to all exposures of
the camera. Each error displaces the measured directions in a pattern over the field. The centroid of a star at (x, y),
in focal lengths from the principal point, moves as follows:

* A focal length that is longer by the relative error e moves the centroid by e (x, y).
* An error of the principal point moves all centroids by this error.
* An error of k1 moves the centroid by this error times (x² + y²) (x, y).

An error of the principal point is nearly a rotation of the camera. The mounting is calibrated with stars of the same
camera and the same parameters, so it already contains this rotation. Only the remainder is an error: if the principal
point is wrong by ε pixels in u, the remainder displaces a star by -ε (x², x y) pixels. An error in v acts likewise.

ECSS-E-ST-60-20C classifies the errors of a star sensor by their variation. Noise is new in each exposure. A
*field-spatial* error varies smoothly over the field of view, and remains after the calibration of focal length,
distortion and shape of the stars' images. A *pixel-spatial* error changes from pixel to pixel, due to sensitivity, dark
current and interpolation of the centroid. Neither error averages over exposures in which the stars stay in place.

The field-spatial errors in u and in v are random functions of the position with a Gaussian correlation, whose length is
three quarters of the detector's side. Each function, a map, is represented by a polynomial of third degree in both
coordinates, which contains all but 0.1 % of the variance of the map. The mean of a map over the detector is left out,
because it is an error of the mounting. The maps are constant, so their coefficients are observable from stars that
cross the field.

The pixel-spatial errors of different pixels are independent. The correlation over a distance of d pixels is modelled as
exp(-2 d). Strictly, the correlation is the fraction of pixels that two images share, which decreases linearly with d;
both functions have the same integral over d.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from ship_geometry.rotations import FloatArray
from ship_stars.camera.camera import StarCamera, equivalent_sigma

SOURCE_OPTICS = "optics"
"""Name of the error source in budgets."""

OPTICS_MODES = 4
"""Number of optics errors: focal length, principal point in u and in v, k1."""

SURVEYED_FOCAL_SIGMA = 2e-4
"""Relative standard deviation of a surveyed focal length."""

SOURCE_FIELD, SOURCE_PIXEL = "field_spatial", "pixel_spatial"
"""Names of the error sources in budgets."""

_LENGTH = 1.5
"""Correlation length of the map, in half sides of the detector."""

_DEGREE = 3

_TERMS = tuple((i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j)
"""Degrees along u and v of the products of Legendre polynomials; the constant term is left out."""

FIELD_MODES = 2 * len(_TERMS)
"""Number of coefficients of both maps: one half for the error in u, the other half for the error in v."""

_NODES = 20

_DECORRELATION_PER_PIXEL = 2.0
"""Decorrelation rate of a pixel's error along a path on the detector, per pixel."""

_DWELL_END_PX, _DWELL_BREAK_PX = 3.0, 5.0
"""Distances that end a dwell.

A dwell ends if the stars have moved since its start by more than the first distance (root mean square). A dwell also
ends if most stars are farther than the second distance from all stars at its start.
"""

_MIN_INFORMATION_RATIO = 1e-3
"""Minimum information of a further exposure on the same pixels, divided by the information of the first exposure."""


@dataclass(frozen=True)
class OpticsErrors:
    """Errors of one camera's optics parameters.

    Attributes:
        camera: configured geometry of the camera.
        focal_sigma: relative standard deviation of the focal length.
        principal_sigma_px: standard deviation of the principal point, each axis.
        distortion_sigma: standard deviation of k1.
    """

    camera: StarCamera
    focal_sigma: float
    principal_sigma_px: float
    distortion_sigma: float

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of focal length (relative), principal u and v (px), and k1, shape (OPTICS_MODES,)."""
        return np.array([self.focal_sigma, self.principal_sigma_px, self.principal_sigma_px, self.distortion_sigma])

    def modes(self, directions_s: FloatArray) -> FloatArray:
        """Return displacements of measured directions by one sigma of each error, in the sensor frame, rad.

        Args:
            directions_s: measured directions, unit vectors, shape (k, 3).

        Returns:
            Displacements, shape (k, 3, OPTICS_MODES).
        """
        displacement_s: FloatArray = -self.sigmas * self.camera.optics_jacobian(directions_s)
        # Add the rotations about up and right that cancel the displacement at the boresight. u is right, v is down.
        turn = self.principal_sigma_px * self.camera.pixel_pitch_m / self.camera.focal_length_m
        forward, up, right = directions_s.T
        displacement_s[:, 0, 1] += turn * right
        displacement_s[:, 2, 1] -= turn * forward
        displacement_s[:, 0, 2] -= turn * up
        displacement_s[:, 1, 2] += turn * forward
        return displacement_s


@dataclass(frozen=True)
class PixelDwell:
    """A pixel dwell: successive exposures whose stars stay near the same pixels.

    Attributes:
        directions_s: directions of the stars at the start of the dwell, shape (k, 3).
        exposure_count: number of exposures after the first of the dwell.
        excess_ratio: relative increase of the pixel-spatial variance of the last exposure, compared with a single
            exposure.
    """

    directions_s: FloatArray
    exposure_count: int
    excess_ratio: float


@dataclass(frozen=True)
class SpatialErrors:
    """Spatial errors of one camera.

    Attributes:
        camera: geometry of the camera; the principal point is taken as the middle of the detector.
        field_sigma_px: root mean square of the field-spatial error over the detector, each axis.
        pixel_sigma_px: standard deviation of the pixel-spatial error, each axis.
    """

    camera: StarCamera
    field_sigma_px: float
    pixel_sigma_px: float

    def field_modes(self, directions_s: FloatArray) -> FloatArray | None:
        """Return displacements of measured directions by one sigma of each map coefficient; None without such an error.

        Args:
            directions_s: measured directions, unit vectors, shape (k, 3).

        Returns:
            Displacements in the sensor frame, rad, shape (k, 3, FIELD_MODES).
        """
        if self.field_sigma_px <= 0.0:
            return None
        pixels = self.camera.pixels(directions_s)
        half_px = np.array([self.camera.principal_u_px, self.camera.principal_v_px])
        along = self.field_sigma_px * _modes_at(pixels / half_px - 1.0)
        shift_px = np.zeros((len(pixels), FIELD_MODES, 2))
        shift_px[:, : len(_TERMS), 0] = shift_px[:, len(_TERMS) :, 1] = along
        moved_s = self.camera.directions(pixels[:, None] + shift_px) - directions_s[:, None]
        # Where a distortion folds over, pixels on one side have no direction; the other side is used.
        lost = ~np.isfinite(moved_s)
        if lost.any():
            moved_s[lost] = (directions_s[:, None] - self.camera.directions(pixels[:, None] - shift_px))[lost]
        return np.swapaxes(moved_s, -1, -2)

    def pixel_sigma(self, directions_s: FloatArray) -> FloatArray:
        """Return the standard deviation of the pixel-spatial error of measured directions, rad per axis, shape (k,)."""
        pixels = self.camera.pixels(directions_s)
        return equivalent_sigma(self.camera.direction_covariance(pixels, self.pixel_sigma_px))

    def pixel_dwell(self, directions_s: FloatArray, sigma: FloatArray, before: PixelDwell | None) -> PixelDwell:
        """Return the pixel dwell up to an exposure: the previous dwell if it continues, else a new dwell.

        Let ρ = exp(-2 d) be the correlation of the pixel errors of successive exposures. Each further exposure has
        (1 - ρ)/(1 + ρ) of the information of the first. The variance of a further exposure is multiplied by
        (1 + ρ)/(1 - ρ) = coth d.

        All stars move together, by a shift and a rotation about their mean. The distance d is the root mean square of
        the stars' movements since the start of the dwell, divided by the number of exposures since the start. The
        movement between two successive exposures would be mostly noise of the centroids, or sway of the ship on the
        same pixels.

        Args:
            directions_s: directions of the stars, shape (k, 3).
            sigma: noise of each direction, rad, shape (k,).
            before: dwell up to the last exposure used; None for the first exposure.
        """
        here = PixelDwell(directions_s, 0, 0.0)
        if before is None or not (len(directions_s) and len(before.directions_s)):
            return here
        pixels = self.camera.pixels(directions_s)
        displacement_px = pixels[:, None] - self.camera.pixels(before.directions_s)
        length = np.linalg.norm(displacement_px, axis=-1)
        nearest = np.argmin(length, axis=1)
        row = np.arange(len(displacement_px))
        near = length[row, nearest] < _DWELL_BREAK_PX
        if 2 * np.count_nonzero(near) < len(near):
            return here
        square = _mean_square_displacement(pixels[near], displacement_px[row, nearest][near])
        # The two components of the shift and the rotation contain the errors of both exposures.
        own = np.mean((sigma[near] * self._pixels_per_rad) ** 2) + self.pixel_sigma_px**2
        moved_px = np.sqrt(max(square - 6.0 * own / np.count_nonzero(near), 0.0))
        count = before.exposure_count + 1
        excess = 1.0 / max(np.tanh(moved_px / count), _MIN_INFORMATION_RATIO) - 1.0
        if moved_px > _DWELL_END_PX:
            return replace(here, excess_ratio=excess)
        return replace(before, exposure_count=count, excess_ratio=excess)

    def streak_variance_ratio(self, length: FloatArray) -> FloatArray:
        """Return the fraction of the pixel-spatial variance that remains for streaks of given lengths (rad)."""
        way = np.maximum(_DECORRELATION_PER_PIXEL * length * self._pixels_per_rad, 1e-3)
        share: FloatArray = 2.0 * (way + np.expm1(-way)) / way**2
        return share

    @property
    def _pixels_per_rad(self) -> float:
        return self.camera.focal_length_m / self.camera.pixel_pitch_m


def _mean_square_displacement(pixels: FloatArray, displacement: FloatArray) -> float:
    """Return the mean square movement of the stars by their common shift and rotation, px².

    Args:
        pixels: pixels of the stars, shape (k, 2).
        displacement: displacement of each star, px, shape (k, 2).
    """
    shift, arm = displacement.mean(axis=0), pixels - pixels.mean(axis=0)
    arms = float(np.sum(arm**2))
    turn = float(np.sum(arm[:, 0] * displacement[:, 1] - arm[:, 1] * displacement[:, 0])) / arms if arms > 0.0 else 0.0
    return float(shift @ shift) + turn**2 * arms / len(displacement)


def _modes_at(place: FloatArray) -> FloatArray:
    """Return the independent modes of a map at k positions, shape (k, len(_TERMS)).

    Args:
        place: positions relative to the middle, in half sides of the detector, shape (k, 2).
    """
    along_u, along_v = _normed_legendre(place[:, 0]), _normed_legendre(place[:, 1])
    first, second = np.transpose(_TERMS)
    modes: FloatArray = (along_u[:, first] * along_v[:, second]) @ _root()
    return modes


def _normed_legendre(x: FloatArray) -> FloatArray:
    """Return Legendre polynomials with a mean square of 1 over [-1, 1], shape (k, _DEGREE + 1)."""
    values: FloatArray = legvander(x, _DEGREE) * np.sqrt(2.0 * np.arange(_DEGREE + 1) + 1.0)
    return values


@cache
def _root() -> FloatArray:
    """Return a matrix square root of the covariance of the coefficients of a map with mean square 1 and zero mean."""
    nodes, weights = leggauss(_NODES)
    values = 0.5 * weights[:, None] * _normed_legendre(nodes)
    along_one = values.T @ np.exp(-0.5 * ((nodes[:, None] - nodes) / _LENGTH) ** 2) @ values
    first, second = np.transpose(_TERMS)
    covariance = along_one[np.ix_(first, first)] * along_one[np.ix_(second, second)] / (1.0 - along_one[0, 0] ** 2)
    root: FloatArray = np.linalg.cholesky(covariance)
    return root

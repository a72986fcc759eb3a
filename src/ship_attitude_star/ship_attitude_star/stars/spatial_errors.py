"""Errors of a centroid that depend on its position on the detector, and are constant while the star stays there.

ECSS-E-ST-60-20C classifies the errors of a star sensor by how they vary. Noise is new in each exposure. A
*field-spatial* error varies smoothly over the field of view: residuals of the calibration of focal length, distortion
and the shape of the stars' images. A *pixel-spatial* error changes from pixel to pixel: sensitivity, dark current,
interpolation of the centroid. Neither averages over exposures in which the stars keep their positions.

The field-spatial errors in u and in v are random functions of the position with a Gaussian correlation, whose length is
three quarters of the detector's side. Each is represented by a polynomial of third degree in both coordinates, which
contains all but 0.1 % of its variance. Its mean over the detector is an error of the mounting, and belongs there. The
map is constant, so that stars which cross the field make its coefficients observable.

Each pixel has a pixel-spatial error of its own. Its correlation over a distance of d pixels is modelled as exp(-2 d).
Strictly, the fraction of pixels that two images share decreases linearly with d; both have the same integral over d.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from ship_attitude_star.stars.camera import StarCamera, equivalent_sigma
from ship_geometry.rotations import FloatArray

SOURCE_FIELD, SOURCE_PIXEL = "field_spatial", "pixel_spatial"
"""Names of the error sources in budgets."""

_LENGTH = 1.5
"""Correlation length of the map, in half sides of the detector."""

_DEGREE = 3
_TERMS = tuple((i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j)
"""Degrees of the products of Legendre polynomials along u and v; the constant is left out."""

FIELD_MODES = 2 * len(_TERMS)
"""Number of coefficients of a map: half of them for the error in u, half for that in v."""

_NODES = 20
_DECORRELATION_PER_PIXEL = 2.0
"""Decorrelation rate of a pixel's error along a path on the detector, per pixel."""

_DWELL_END_PX, _DWELL_BREAK_PX = 3.0, 5.0
"""Distances that end a dwell.

The first is the mean movement of the stars since its start, the second the distance of most stars from every star then.
"""

_MIN_INFORMATION_RATIO = 1e-3
"""Minimum information of a further exposure on the same pixels, relative to that of the first one."""


@dataclass(frozen=True)
class PixelDwell:
    """A pixel dwell: successive exposures whose stars stay near the same pixels.

    Attributes:
        directions_s: directions of the stars at its start, shape (k, 3).
        exposure_count: number of exposures since.
        excess_ratio: relative increase of the pixel-spatial variance in the last exposure over that of a single
            exposure.
    """

    directions_s: FloatArray
    exposure_count: int
    excess_ratio: float


@dataclass(frozen=True)
class SpatialErrors:
    """The spatial errors of one camera.

    Attributes:
        camera: its geometry; the principal point is taken as the middle of the detector.
        field_sigma_px: root mean square of the field-spatial error over the detector, each axis.
        pixel_sigma_px: standard deviation of the pixel-spatial error, each axis.
    """

    camera: StarCamera
    field_sigma_px: float
    pixel_sigma_px: float

    def field_modes(self, directions_s: FloatArray) -> FloatArray | None:
        """Return displacements of measured directions by the map's coefficients; None without such an error.

        Args:
            directions_s: as measured, unit vectors, shape (k, 3).

        Returns:
            Displacement by one sigma of each coefficient, in the sensor frame, rad, shape (k, 3, FIELD_MODES).
        """
        if self.field_sigma_px <= 0.0:
            return None
        pixels = self.camera.pixels(directions_s)
        half_px = np.array([self.camera.principal_u_px, self.camera.principal_v_px])
        along = self.field_sigma_px * _modes_at(pixels / half_px - 1.0)
        shift_px = np.zeros((len(pixels), FIELD_MODES, 2))
        shift_px[:, : len(_TERMS), 0] = shift_px[:, len(_TERMS) :, 1] = along
        moved_s = self.camera.directions(pixels[:, None] + shift_px) - directions_s[:, None]
        # At the fold of a distortion, one side has no direction: use the other side.
        lost = ~np.isfinite(moved_s)
        if lost.any():
            moved_s[lost] = (directions_s[:, None] - self.camera.directions(pixels[:, None] - shift_px))[lost]
        return np.swapaxes(moved_s, -1, -2)

    def pixel_sigma(self, directions_s: FloatArray) -> FloatArray:
        """Return the pixel-spatial error of measured directions (k, 3) as one sigma per axis, rad, shape (k,)."""
        pixels = self.camera.pixels(directions_s)
        return equivalent_sigma(self.camera.direction_covariance(pixels, self.pixel_sigma_px))

    def pixel_dwell(self, directions_s: FloatArray, sigma: FloatArray, before: PixelDwell | None) -> PixelDwell:
        """Return the pixel dwell of an exposure after the previous one.

        Let ρ be the correlation of the pixel errors of successive exposures. Each exposure then has (1 - ρ)/(1 + ρ) of
        the information of the first one. Its variance is multiplied by (1 + ρ)/(1 - ρ), which is coth d with ρ = exp(-2
        d).

        All stars move together, by a shift and a rotation about their mean. The distance d of one exposure is the root
        mean square of their movements since the start of the dwell, divided by the number of exposures since. The
        movement between two successive exposures would be mostly noise of the centroids, or sway of the ship on the
        same pixels.

        Args:
            directions_s: directions of the stars, shape (k, 3).
            sigma: noise of each direction, rad, shape (k,).
            before: the dwell up to the last exposure used; None if there was none.
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
        # Shift (two components) and rotation each contain the errors of both exposures.
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
    """Return the mean square movement, px², of stars, shape (k, 2) each, by one shift and one rotation of all."""
    shift, arm = displacement.mean(axis=0), pixels - pixels.mean(axis=0)
    arms = float(np.sum(arm**2))
    turn = float(np.sum(arm[:, 0] * displacement[:, 1] - arm[:, 1] * displacement[:, 0])) / arms if arms > 0.0 else 0.0
    return float(shift @ shift) + turn**2 * arms / len(displacement)


def _modes_at(place: FloatArray) -> FloatArray:
    """Return the map's independent modes at positions, half sides from the middle, shape (k, 2) → (k, len(_TERMS))."""
    along_u, along_v = _normed_legendre(place[:, 0]), _normed_legendre(place[:, 1])
    first, second = np.transpose(_TERMS)
    modes: FloatArray = (along_u[:, first] * along_v[:, second]) @ _root()
    return modes


def _normed_legendre(x: FloatArray) -> FloatArray:
    """Return Legendre polynomials whose mean square over [-1, 1] is 1, shape (k, _DEGREE + 1)."""
    values: FloatArray = legvander(x, _DEGREE) * np.sqrt(2.0 * np.arange(_DEGREE + 1) + 1.0)
    return values


@cache
def _root() -> FloatArray:
    """Return a root of the covariance of the coefficients of a map with mean square 1 and zero mean."""
    nodes, weights = leggauss(_NODES)
    values = 0.5 * weights[:, None] * _normed_legendre(nodes)
    along_one = values.T @ np.exp(-0.5 * ((nodes[:, None] - nodes) / _LENGTH) ** 2) @ values
    first, second = np.transpose(_TERMS)
    covariance = along_one[np.ix_(first, first)] * along_one[np.ix_(second, second)] / (1.0 - along_one[0, 0] ** 2)
    root: FloatArray = np.linalg.cholesky(covariance)
    return root

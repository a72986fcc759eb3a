"""Errors of a centroid that belong to its place on the detector, and stay as long as a star keeps its place.

ECSS-E-ST-60-20C parts the errors of a star sensor by how they vary. Noise is new in each exposure. A *field-spatial*
error varies smoothly over the field of view: what calibration has left of focal length, distortion and the shape of the
stars' images. A *pixel-spatial* error changes from pixel to pixel: sensitivity, dark current, interpolation of the
centroid. Neither averages over exposures in which the stars keep their places.

The field-spatial error in u, and that in v, is a random function of the place with a Gaussian correlation, whose length
is three quarters of the detector's side. It is held as a polynomial of third degree in both coordinates, all but a
thousandth of its variance. Its mean over the detector is an error of the mounting, and belongs there. The map lasts, so
its coefficients can be estimated: stars that cross the field tell of it.

Each pixel has a pixel-spatial error of its own. Over a way of d pixels that error is taken to be forgotten as
exp(-2 d). In truth the share that two places have in common falls in a straight line; over a long way both add up to
the same.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from ship_attitude_star.stars.camera import StarCamera, equivalent_sigma
from ship_geometry.rotations import FloatArray

SOURCE_FIELD, SOURCE_PIXEL = "field_spatial", "pixel_spatial"
"""What the errors are booked to."""

_LENGTH = 1.5
"""Correlation length of the map, in half sides of the detector."""

_DEGREE = 3
_TERMS = tuple((i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j)
"""Degrees of the products of Legendre polynomials along u and v; the constant is left out."""

FIELD_MODES = 2 * len(_TERMS)
"""Number of coefficients of a map: so many for the error in u, then as many for that in v."""

_NODES = 20
_PER_PIXEL = 2.0
"""How fast a pixel's error is forgotten along a way over the detector, per pixel."""

_STAY_PX, _NEAR_PX = 3.0, 5.0
"""A stay ends when the stars have gone so far. It is broken off where most stars are farther than the second from every
place at which it began."""

_LEAST_WORTH = 1e-3
"""Of an exposure after another on the same pixels: a share of the first one's information."""


@dataclass(frozen=True)
class PixelStay:
    """A run of exposures whose stars keep near the same pixels.

    Attributes:
        directions_s: of the stars at its beginning, shape (k, 3).
        exposures: that came since.
        excess: by how much the pixel-spatial variance counts more in the last of them than that of an exposure alone.
    """

    directions_s: FloatArray
    exposures: int
    excess: float


@dataclass(frozen=True)
class SpatialErrors:
    """The spatial errors of one camera.

    Attributes:
        camera: its geometry; the principal point is taken for the middle of the detector.
        field_sigma_px: root mean square of the field-spatial error over the detector, each axis.
        pixel_sigma_px: standard deviation of the pixel-spatial error, each axis.
    """

    camera: StarCamera
    field_sigma_px: float
    pixel_sigma_px: float

    def field_modes(self, directions_s: FloatArray) -> FloatArray | None:
        """How the map's coefficients displace measured directions, in the sensor frame; None without such an error.

        Args:
            directions_s: as measured, unit vectors, shape (k, 3).

        Returns:
            Displacement by one sigma of each coefficient, rad, shape (k, 3, FIELD_MODES).
        """
        if self.field_sigma_px <= 0.0:
            return None
        pixels = self.camera.pixels(directions_s)
        half_px = np.array([self.camera.principal_u_px, self.camera.principal_v_px])
        along = self.field_sigma_px * _modes_at(pixels / half_px - 1.0)
        shift_px = np.zeros((len(pixels), FIELD_MODES, 2))
        shift_px[:, : len(_TERMS), 0] = shift_px[:, len(_TERMS) :, 1] = along
        moved_s = self.camera.directions(pixels[:, None] + shift_px) - directions_s[:, None]
        # At the fold of a distortion there is nothing on the one side.
        lost = ~np.isfinite(moved_s)
        if lost.any():
            moved_s[lost] = (directions_s[:, None] - self.camera.directions(pixels[:, None] - shift_px))[lost]
        return np.swapaxes(moved_s, -1, -2)

    def pixel_sigma(self, directions_s: FloatArray) -> FloatArray:
        """Pixel-spatial error of measured directions, shape (k, 3), as one sigma per axis, rad, shape (k,)."""
        pixels = self.camera.pixels(directions_s)
        return equivalent_sigma(self.camera.direction_covariance(pixels, self.pixel_sigma_px))

    def stay(self, directions_s: FloatArray, sigma: FloatArray, before: PixelStay | None) -> PixelStay:
        """How long the stars of an exposure have been near the pixels where they stand, and what that makes of them.

        Of exposures in a row whose pixel errors are correlated by ρ each tells (1 - ρ)/(1 + ρ) of what the first one
        told: its variance counts (1 + ρ)/(1 - ρ) times, which is coth d with ρ = exp(-2 d). All stars move together, by
        a shift and a turn about their middle. The way d of one exposure is the root mean square of their ways since the
        stay began, divided by the number of exposures since. The way from one exposure to the next alone would be
        mostly noise of the centroids, or a ship that sways on the same pixels.

        Args:
            directions_s: of the stars, shape (k, 3).
            sigma: noise of each direction, rad, shape (k,).
            before: the stay up to the exposure before that was used; None where there was none.
        """
        here = PixelStay(directions_s, 0, 0.0)
        if before is None or not (len(directions_s) and len(before.directions_s)):
            return here
        pixels = self.camera.pixels(directions_s)
        way = pixels[:, None] - self.camera.pixels(before.directions_s)
        length = np.linalg.norm(way, axis=-1)
        nearest = np.argmin(length, axis=1)
        row = np.arange(len(way))
        near = length[row, nearest] < _NEAR_PX
        if 2 * np.count_nonzero(near) < len(near):
            return here
        square = _mean_square_way(pixels[near], way[row, nearest][near])
        # Errors of both exposures are in each of the three quantities that tell it.
        own = np.mean((sigma[near] * self._pixels_per_rad) ** 2) + self.pixel_sigma_px**2
        gone = np.sqrt(max(square - 6.0 * own / np.count_nonzero(near), 0.0))
        count = before.exposures + 1
        excess = 1.0 / max(np.tanh(gone / count), _LEAST_WORTH) - 1.0
        if gone > _STAY_PX:
            return replace(here, excess=excess)
        return replace(before, exposures=count, excess=excess)

    def streak_share(self, length: FloatArray) -> FloatArray:
        """Share of the pixel-spatial variance that streaks of some lengths (rad) leave, shape as they have it."""
        way = np.maximum(_PER_PIXEL * length * self._pixels_per_rad, 1e-3)
        share: FloatArray = 2.0 * (way + np.expm1(-way)) / way**2
        return share

    @property
    def _pixels_per_rad(self) -> float:
        return self.camera.focal_length_m / self.camera.pixel_pitch_m


def _mean_square_way(pixels: FloatArray, way: FloatArray) -> float:
    """Mean square of the ways of stars, px², shape (k, 2) each, as far as they are one shift and one turn of all."""
    shift, arm = way.mean(axis=0), pixels - pixels.mean(axis=0)
    arms = float(np.sum(arm**2))
    turn = float(np.sum(arm[:, 0] * way[:, 1] - arm[:, 1] * way[:, 0])) / arms if arms > 0.0 else 0.0
    return float(shift @ shift) + turn**2 * arms / len(way)


def _modes_at(place: FloatArray) -> FloatArray:
    """The map's independent parts at places, half sides from the middle, shape (k, 2) → (k, len(_TERMS))."""
    along_u, along_v = _normed_legendre(place[:, 0]), _normed_legendre(place[:, 1])
    first, second = np.transpose(_TERMS)
    modes: FloatArray = (along_u[:, first] * along_v[:, second]) @ _root()
    return modes


def _normed_legendre(x: FloatArray) -> FloatArray:
    """Legendre polynomials whose mean square over [-1, 1] is 1, shape (k, _DEGREE + 1)."""
    values: FloatArray = legvander(x, _DEGREE) * np.sqrt(2.0 * np.arange(_DEGREE + 1) + 1.0)
    return values


@cache
def _root() -> FloatArray:
    """A root of the covariance of the coefficients of a map whose mean square, without its mean, is 1."""
    nodes, weights = leggauss(_NODES)
    values = 0.5 * weights[:, None] * _normed_legendre(nodes)
    along_one = values.T @ np.exp(-0.5 * ((nodes[:, None] - nodes) / _LENGTH) ** 2) @ values
    first, second = np.transpose(_TERMS)
    covariance = along_one[np.ix_(first, first)] * along_one[np.ix_(second, second)] / (1.0 - along_one[0, 0] ** 2)
    root: FloatArray = np.linalg.cholesky(covariance)
    return root

"""Errors of star centroids that depend on the position on the detector, constant over time.

The field-spatial error is a smooth random function of the position: a sum of many waves, minus its mean over the
detector. The wave numbers are drawn from the normal distribution of a Gaussian correlation, whose length is three
quarters of a side of the detector. The pixel-spatial error is an independent number for each pixel and axis. This
module shares nothing with the estimators, which represent the field-spatial error as a polynomial.
"""

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.scenario import Detector

_WAVES, _LENGTH = 200, 1.5
"""Number of waves, and correlation length in half sides of the detector."""

_TILE_PX = 512
"""Period with which the pixel-spatial errors repeat, px; the stars do not reveal the repetition."""


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

"""A ship turns while a star sensor exposes: where its stars stood at the middle, and how much worse they are known.

The centroid of a streak is the mean of the star's pixels over the exposure. The INS tells how the sensor turned, and so
by how much that mean is off the pixel at the middle: angular acceleration, and the centripetal part with it. Along a
streak of L pixels the light is spread by L²/12 more than the image of a star at rest, s², so that a centroid is worse
by the same factor: σ² (1 + L²/(12 s²)). Across it nothing changes (docs/explanation/stars.md).
"""

from dataclasses import replace

import numpy as np

from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.stars.camera import equivalent_sigma
from ship_geometry.exposure_mean import Turning
from ship_geometry.rotations import FloatArray

_OUT_OF_SIGHT = 1.0
"""Variance of a star that the camera cannot hold over the whole exposure, rad²: it tells nothing."""


def at_middle(exposure: StarExposure, turning: Turning) -> StarExposure:
    """The stars where they stood at the middle of the exposure, with what their streaks add to their errors.

    Args:
        exposure: of a known length.
        turning: of the sensor over it.
    """
    length = exposure.length
    assert length is not None
    camera, seen_s = length.camera, exposure.directions_s
    nodes, passed_s = turning.nodes, seen_s @ np.swapaxes(turning.turns, -1, -2)
    pixels, middle = camera.pixels(passed_s), camera.pixels(seen_s)
    directions_s = camera.directions(middle - (nodes.mean(pixels) - middle))
    blur = equivalent_sigma(camera.direction_covariance(middle, length.psf_sigma_px))
    smear_s: FloatArray = _across(seen_s, nodes.spread(passed_s)) * ((exposure.sigma / blur) ** 2)[:, None, None]
    lost = ~np.all(np.isfinite(directions_s), axis=-1)
    directions_s[lost], smear_s[lost] = seen_s[lost], _across(seen_s[lost], _OUT_OF_SIGHT * np.eye(3))
    return replace(exposure, directions_s=directions_s, smear_s=smear_s)


def _across(directions_s: FloatArray, covariance_s: FloatArray) -> FloatArray:
    """What of covariances lies across the lines of sight, shape (k, 3, 3)."""
    keep = np.eye(3) - directions_s[:, :, None] * directions_s[:, None, :]
    across: FloatArray = keep @ covariance_s @ keep
    return across

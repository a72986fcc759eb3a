"""Simulated sightings of known directions, for the tests of the fit."""

import numpy as np

from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_studies.axis_fit.sightings import Sightings

ERRORS = AxisErrors(*(ARCSEC * np.array([20.0, -30.0, 15.0, -25.0, 10.0, -35.0, 0.0])).tolist())
STRAIGHT = {"flexure": 0.0}


def random_angles(
    rng: np.random.Generator, count: int, elevations_deg: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return random encoder angles: any azimuth, and elevations between two limits."""
    return rng.uniform(0.0, 2.0 * np.pi, count), np.deg2rad(rng.uniform(*elevations_deg, count))


def simulate_sightings(
    rng: np.random.Generator,
    errors: AxisErrors,
    angles: tuple[FloatArray, FloatArray],
    sigma_arcsec: FloatArray | float,
) -> Sightings:
    """Return sightings whose true directions have a normal error per component; one sigma, or one per sighting."""
    axis_d = main_axis_rotation(errors, *angles)[..., 0]
    count = len(axis_d)
    turn = np.reshape(sigma_arcsec, (-1, 1)) * ARCSEC * rng.normal(size=(count, 3))
    labels = tuple(str(number) for number in range(count))
    return Sightings(labels, *angles, direction_d=(exp_rotation(turn) @ axis_d[..., None])[..., 0])

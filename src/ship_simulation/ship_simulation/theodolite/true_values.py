"""What is true of the theodolite and of the drones: drawn once about what the scenario says is known."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.draws.noise import random_stream
from ship_simulation.scenario.theodolite_scenario import Axes, Lever, Telescope, Theodolite
from theodolite_calib.chain.axes import NAMES, AxisErrors


@dataclass(frozen=True)
class TrueTheodolite:
    """The constants of the theodolite.

    Attributes:
        axis_errors: of its axes.
        parallelism: azimuth, elevation and rotation of the main axis in the telescope frame, rad, shape (3,).
        focal_length_m: of the telescope.
        lever_d: from the ship's antenna to the crossing of the axes, m, shape (3,).
        lens_m: N' of the telescope's lens from there, in the main frame, m, shape (3,).
    """

    axis_errors: AxisErrors
    parallelism: FloatArray
    focal_length_m: float
    lever_d: FloatArray
    lens_m: FloatArray


def draw_theodolite(config: Theodolite, seed: int) -> TrueTheodolite:
    """Known values, each with an error of its sigma."""
    telescope = config.telescope
    known, sigma = parallelism_of(telescope)
    focal_error = random_stream(seed, "theodolite.focal_length").standard_normal()
    return TrueTheodolite(
        axis_errors=AxisErrors.from_vector(_draw_axis_errors(config.axes, seed)),
        parallelism=known + sigma * random_stream(seed, "theodolite.parallelism").standard_normal(3),
        focal_length_m=telescope.focal_length_m + telescope.focal_length_sigma_m * focal_error,
        lever_d=draw_lever(config.lever, "theodolite.lever", seed),
        lens_m=draw_lever(telescope.lens, "theodolite.lens", seed),
    )


def axis_errors_of(axes: Axes) -> tuple[FloatArray, FloatArray]:
    """Known axis errors and their sigmas in the order of theodolite_calib.chain.axes.NAMES, rad, shape (7,) each."""
    known = [getattr(axes, f"{name}_arcsec") for name in NAMES]
    sigma = [getattr(axes, f"{name}_sigma_arcsec") for name in NAMES]
    return ARCSEC * np.array(known), ARCSEC * np.array(sigma)


def parallelism_of(telescope: Telescope) -> tuple[FloatArray, FloatArray]:
    """Known angles of the main axis in the telescope and their sigmas, rad, shape (3,) each."""
    known = [telescope.azimuth_arcsec, telescope.elevation_arcsec, telescope.rotation_arcsec]
    sigma = [telescope.azimuth_sigma_arcsec, telescope.elevation_sigma_arcsec, telescope.rotation_sigma_arcsec]
    return ARCSEC * np.array(known), ARCSEC * np.array(sigma)


def surveyed(lever: Lever) -> FloatArray:
    """The surveyed vector, m, shape (3,)."""
    return np.array([lever.forward_m, lever.up_m, lever.right_m])


def draw_lever(lever: Lever, name: str, seed: int) -> FloatArray:
    """The true vector, m, shape (3,)."""
    return surveyed(lever) + lever.sigma_m * random_stream(seed, name).standard_normal(3)


def _draw_axis_errors(axes: Axes, seed: int) -> FloatArray:
    known, sigma = axis_errors_of(axes)
    rng = random_stream(seed, "theodolite.axes")
    if axes.spread == "uniform":
        # Of the same sigma.
        return known + sigma * rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), len(NAMES))
    return known + sigma * rng.standard_normal(len(NAMES))

"""Configuration of a design study: a theodolite and its pointing, and drones with the positions of their beacons.

The keys under ``optical_axis`` are parameters of the node ``optical_axis``, so that a good design can be copied there.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ship_estimation.parameters.fields import arcsec, mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.rotations import FloatArray
from theodolite_calib.config import OpticalAxisConfig

# Names of drones are plain, because these names become headings and cells of tables.
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

_W18_BEACON = {"rtk": {"sigma_m": 0.027, "bias_sigma_m": 0.0}}
_UNKNOWN_AXES = {f"{name}_sigma_arcsec": 3600.0 for name in ("g", "h", "c", "I", "beta_x", "beta_y")}
W18: dict[str, Any] = {
    "elevation_deg": 10.0,
    "optical_axis": {
        "axes": _UNKNOWN_AXES,
        "encoder": {"sigma_arcsec": 0.0},
        "ship": {"white_sigma_arcsec": 0.0},
        "telescope": {"telescope_id": "calibration", "focal_length_m": 0.1},
        "ship_antenna": {"sigma_m": 0.0},
        "air": {"sigma": 0.0, "light_sigma": 0.0618},
        "escort": {"field_deg": 3.61, "range_max_m": 5000.0},
        "beacons": {"a": _W18_BEACON, "b": _W18_BEACON},
    },
    "lights": {
        "a": {"right_deg": 3.0, "up_deg": 2.0, "distance_m": 2000.0},
        "b": {"right_deg": -2.0, "up_deg": -3.0, "distance_m": 2000.0},
    },
}
"""Simulation of [W18]: focal length 100 mm ± 0.1 mm, image error a tenth of a pixel of 6.5 µm, baseline error 2.7 cm
per axis, refraction error 2″ at each beacon at 2 km, and no other information.

This study is computed if no file is given."""


@dataclass(frozen=True, kw_only=True)
class BeaconPosition:
    """Position of a beacon relative to the telescope's axis, with the keys of ``flight.escort`` in a scenario."""

    right_deg: float = parameter(doc="to the right of the axis", unit="deg", minimum=-60.0, maximum=60.0)
    up_deg: float = parameter(doc="above the axis", unit="deg", minimum=-60.0, maximum=60.0)
    distance_m: float = parameter(doc="from the theodolite", unit="m", minimum=1.0, maximum=50_000.0)


@dataclass(frozen=True, kw_only=True)
class DesignStudyConfig:
    """Parameters of a design study."""

    azimuth_deg: float = parameter(
        90.0, doc="azimuth of the pointing, from the bow", unit="deg", minimum=-360.0, maximum=360.0
    )
    elevation_deg: float = parameter(
        30.0, doc="elevation of the pointing, over the horizon of a level ship", unit="deg", minimum=-10.0, maximum=89.0
    )
    ship_heading_sigma_arcsec: float = arcsec(2.0, doc="error of ship/attitude about Up; unused with ins/imu")
    ship_tilt_sigma_arcsec: float = arcsec(
        1.5, doc="error of ship/attitude about North and about East; unused with ins/imu"
    )
    pixel_pitch_m: float = parameter(
        6.5e-6, doc="of the telescope's detector, from pixel to pixel", unit="m", minimum=1e-7, maximum=1e-3
    )
    centroid_sigma_px: float = parameter(
        0.1, doc="error of a light's image, each axis", unit="px", minimum=1e-3, maximum=10.0
    )
    required_arcsec: float = parameter(
        0.0, doc="required error of the pointing on the sky with the given lights; 0: none",
        unit="arcsec", minimum=0.0, maximum=36_000.0,
    )  # fmt: skip
    lights: dict[str, BeaconPosition] = mapping_of("positions of the lights, by the names of optical_axis.beacons")
    optical_axis: OpticalAxisConfig = section(OpticalAxisConfig)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the N beacons."""
        return tuple(self.lights)

    def direction_tangents(self) -> FloatArray:
        """Return the tangents of the beacons' angles to the right of the axis and above it, shape (N, 2)."""
        return np.tan(np.deg2rad([[light.right_deg, light.up_deg] for light in self.lights.values()]))

    def distances_m(self) -> FloatArray:
        """Return the distances of the beacons from the theodolite, m, shape (N,)."""
        return np.array([light.distance_m for light in self.lights.values()])


def study_config(values: Mapping[str, Any]) -> DesignStudyConfig:
    """Return the checked configuration of a study.

    Raises:
        ParameterError: names the parameter and what is allowed.
    """
    try:
        config = build(DesignStudyConfig, values)
    except ParameterError as error:
        raise _in_study(error) from error
    lights, beacons = set(config.lights), set(config.optical_axis.beacons)
    if not beacons:
        raise ParameterError("parameter 'optical_axis.beacons': expected at least one drone", "optical_axis.beacons")
    for name in sorted(beacons):
        if not _NAME.fullmatch(name):
            reason = "the name of a drone is letters, digits and _, a letter first"
            raise ParameterError(f"parameter 'optical_axis.beacons.{name}': {reason}", f"optical_axis.beacons.{name}")
    for name in sorted(lights ^ beacons):
        here, there = ("lights", "optical_axis.beacons") if name in lights else ("optical_axis.beacons", "lights")
        raise ParameterError(f"parameter '{here}.{name}': expected '{name}' under {there} too", f"{here}.{name}")
    field_deg = config.optical_axis.escort.field_deg
    for name, off_deg in zip(
        config.names, np.rad2deg(np.arctan(np.hypot(*config.direction_tangents().T))).tolist(), strict=True
    ):
        if not off_deg <= field_deg:
            raise ParameterError(
                f"parameter 'lights.{name}': it is {off_deg:.2f} deg from the telescope's axis, expected at most "
                f"optical_axis.escort.field_deg = {field_deg:g} deg",
                f"lights.{name}",
            )
    telescope = values.get("optical_axis", {}).get("telescope", {})
    if "sigma_m" in telescope:
        raise ParameterError(
            "parameter 'optical_axis.telescope.sigma_m': remove it; it is pixel_pitch_m times centroid_sigma_px",
            "optical_axis.telescope.sigma_m",
        )
    image_sigma_m = config.pixel_pitch_m * config.centroid_sigma_px
    least_m = 1e-9
    if not image_sigma_m >= least_m:
        raise ParameterError(
            f"parameter 'centroid_sigma_px' = {config.centroid_sigma_px:g}: times pixel_pitch_m it is "
            f"{image_sigma_m:.2g} m, expected {least_m:g} m at least",
            "centroid_sigma_px",
            value=config.centroid_sigma_px,
        )
    return replace(config, optical_axis=with_image_sigma(config.optical_axis, image_sigma_m))


def _in_study(error: ParameterError) -> ParameterError:
    """Return the error; parameters of the node get their names in the study, which begin with ``optical_axis.``."""
    own = {field.name for field in fields(DesignStudyConfig)}
    if any(name.split(".")[0] in own for name in error.parameters):
        return error
    names = [f"optical_axis.{name}" for name in error.parameters]
    return ParameterError(f"under 'optical_axis': {error}", *names, value=error.value)


def with_image_sigma(config: OpticalAxisConfig, sigma_m: float) -> OpticalAxisConfig:
    """Return the node's configuration with a given error of the beacons' images."""
    return replace(config, telescope=replace(config.telescope, sigma_m=sigma_m))

"""Parameters of a layout study: sensors on the deck with their errors, and the operating point of the six figures.

The keys of a sensor are those of ``star_sensors.<id>`` of the node ``ship_attitude``, so that a layout can be copied
there unchanged.
"""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.sky.deck_masks import MaskConfig, deck_masks

MIN_ELEVATION_DEG = 5.0
"""Minimum elevation of a boresight above the deck; at lower elevations in the sky no refraction model is valid."""

DEFAULT_SENSORS = {
    "fore": {"azimuth_deg": 0.0, "elevation_deg": 35.0},
    "starboard": {"azimuth_deg": 90.0, "elevation_deg": 35.0},
}
"""Sensors of a study whose file contains no sensors: two 90° apart in azimuth, with elevation and errors of [Z14]."""

# Names of sensors are used as names of files and headings.
_SENSOR_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_MIN_SIGMA_ARCSEC = 0.001
"""Minimum noise of a sensor, arcseconds: it avoids singular covariances and changes no printed digit."""


def _angle(default: Any = dataclasses.MISSING, *, doc: str, limit_deg: float = 360.0) -> Any:
    return parameter(default, doc=doc, unit="deg", minimum=-limit_deg, maximum=limit_deg)


def _sigma(default: float, *, doc: str, minimum: float = 0.0) -> Any:
    return parameter(default, doc=doc, unit="arcsec", minimum=minimum, maximum=36_000.0)


def _error(default: float, *, doc: str) -> Any:
    """Return the parameter of a signed error, in arcseconds."""
    return parameter(default, doc=doc, unit="arcsec", minimum=-36_000.0, maximum=36_000.0)


@dataclass(frozen=True, kw_only=True)
class SensorPlacement:
    """Mounting angles of a sensor."""

    azimuth_deg: float = _angle(doc="boresight from the bow, clockwise seen from above")
    elevation_deg: float = parameter(
        doc="boresight above the deck", unit="deg", minimum=MIN_ELEVATION_DEG, maximum=90.0
    )
    roll_deg: float = _angle(0.0, doc="roll about the boresight, right side down")

    def angles(self) -> FloatArray:
        """Return azimuth, elevation, roll in the deck, shape (3,), rad."""
        return np.deg2rad([self.azimuth_deg, self.elevation_deg, self.roll_deg])


@dataclass(frozen=True, kw_only=True)
class LayoutSensor(SensorPlacement):
    """One star sensor: mounting angles and errors about its own axes (forward is the boresight)."""

    sigma_forward_arcsec: float = _sigma(100.0, doc="noise about the boresight", minimum=_MIN_SIGMA_ARCSEC)
    sigma_up_arcsec: float = _sigma(3.0, doc="noise about the up axis", minimum=_MIN_SIGMA_ARCSEC)
    sigma_right_arcsec: float = _sigma(3.0, doc="noise about the right axis", minimum=_MIN_SIGMA_ARCSEC)
    installation_sigma_forward_arcsec: float = _sigma(20.0, doc="installation error about the boresight")
    installation_sigma_up_arcsec: float = _sigma(1.0, doc="installation error about the up axis")
    installation_sigma_right_arcsec: float = _sigma(1.0, doc="installation error about the right axis")

    def noise_sigmas(self) -> FloatArray:
        """Return the noise about (forward, up, right), shape (3,), rad."""
        return ARCSEC * np.array([self.sigma_forward_arcsec, self.sigma_up_arcsec, self.sigma_right_arcsec])

    def installation_sigmas(self) -> FloatArray:
        """Return the installation error about (forward, up, right), shape (3,), rad."""
        forward_arcsec, up_arcsec = self.installation_sigma_forward_arcsec, self.installation_sigma_up_arcsec
        return ARCSEC * np.array([forward_arcsec, up_arcsec, self.installation_sigma_right_arcsec])


@dataclass(frozen=True, kw_only=True)
class Optics:
    """The optics of a sensor, which determine the noise about its axes."""

    focal_length_m: float = parameter(doc="focal length", unit="m", minimum=1e-3, maximum=10.0)
    pixel_pitch_m: float = parameter(doc="pixel pitch", unit="m", minimum=1e-7, maximum=1e-3)
    width_px: int = parameter(doc="columns of the detector", unit="px", minimum=16, maximum=100_000)
    height_px: int = parameter(doc="rows of the detector", unit="px", minimum=16, maximum=100_000)
    centroid_sigma_px: float = parameter(
        0.1, doc="noise of a star's centroid on the detector, each axis", unit="px", minimum=1e-4, maximum=10.0
    )
    magnitude_limit: float = parameter(
        doc="faintest star detected in an exposure, Hp; beyond 7.3 the catalogue is not complete",
        minimum=1.0,
        maximum=9.0,
    )
    sky_share: float = parameter(
        0.95, doc="share of the sky in which the noise is not exceeded", minimum=0.5, maximum=0.999
    )

    def half_field(self) -> FloatArray:
        """Return the tangents of half the field of view to the right and up, shape (2,)."""
        return np.array([self.width_px, self.height_px]) * self.pixel_pitch_m / (2.0 * self.focal_length_m)

    def star_sigma(self) -> float:
        """Return the noise of a star's direction near the boresight, per axis, rad."""
        return self.centroid_sigma_px * self.pixel_pitch_m / self.focal_length_m


@dataclass(frozen=True, kw_only=True)
class CommonErrors:
    """Errors that all sensors share; more sensors do not average them."""

    heading_sigma_arcsec: float = _sigma(0.0, doc="about the vertical: Earth rotation angle, clock")
    tilt_sigma_arcsec: float = _sigma(0.0, doc="of the horizon about North and about East: 1 for 31 m of position")
    refraction_sigma_arcsec: float = _sigma(0.0, doc="refraction at 45 deg elevation: 0.2 for 1 K, 0.06 for 1 hPa")


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """Angles and errors of the six figures of [Z14]; each figure varies one of the angles."""

    star_azimuth_deg: float = _angle(235.0, doc="As, azimuth of the sensor in the horizon")
    star_elevation_deg: float = _angle(45.0, doc="Es, elevation of the sensor in the horizon", limit_deg=90.0)
    star_roll_deg: float = _angle(90.0, doc="roll_s, roll of the sensor in the horizon")
    elevation_deg: float = _angle(35.0, doc="E0, installation elevation", limit_deg=90.0)
    roll_deg: float = _angle(0.0, doc="roll_0, installation roll")
    error_star_azimuth_arcsec: float = _error(3.0, doc="dAs, signed")
    error_star_elevation_arcsec: float = _error(3.0, doc="dEs, signed")
    error_star_roll_arcsec: float = _error(100.0, doc="droll_s, signed; the only error in figures 1 to 3")
    error_azimuth_arcsec: float = _error(1.0, doc="dA0, signed")
    error_elevation_arcsec: float = _error(1.0, doc="dE0, signed")
    error_roll_arcsec: float = _error(20.0, doc="droll_0, signed")

    def star_errors_arcsec(self) -> FloatArray:
        """Return the errors of the sensor's horizon attitude: azimuth, elevation, roll, shape (3,)."""
        return np.array([self.error_star_azimuth_arcsec, self.error_star_elevation_arcsec, self.error_star_roll_arcsec])

    def installation_errors_arcsec(self) -> FloatArray:
        """Return the errors of the installation angles: azimuth, elevation, roll, shape (3,)."""
        return np.array([self.error_azimuth_arcsec, self.error_elevation_arcsec, self.error_roll_arcsec])


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """Required accuracy of the attitude; all three zero: no requirement."""

    heading_arcsec: float = _sigma(0.0, doc="maximum error of heading, 1 sigma; 0: no requirement")
    pitch_arcsec: float = _sigma(0.0, doc="maximum error of pitch, 1 sigma; 0: no requirement")
    roll_arcsec: float = _sigma(0.0, doc="maximum error of roll, 1 sigma; 0: no requirement")

    def limits_arcsec(self) -> FloatArray:
        """Return the maximum sigma of heading, pitch, roll, shape (3,); infinite for an angle without requirement."""
        required = np.array([self.heading_arcsec, self.pitch_arcsec, self.roll_arcsec])
        return np.where(required > 0.0, required, np.inf)

    @property
    def is_given(self) -> bool:
        """True if there is a requirement."""
        return bool(np.isfinite(self.limits_arcsec()).any())


@dataclass(frozen=True, kw_only=True)
class HorizonClearance:
    """Required clearance of a sensor's field above the horizon while the ship moves."""

    roll_deg: float = _angle(0.0, doc="roll amplitude of the ship", limit_deg=60.0)
    pitch_deg: float = _angle(0.0, doc="pitch amplitude of the ship", limit_deg=45.0)
    clearance_deg: float = parameter(
        0.0, doc="minimum elevation of the field above the horizon", unit="deg", minimum=0.0, maximum=45.0
    )


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """Another layout of the same sensors."""

    sensors: dict[str, SensorPlacement] = mapping_of("sensors mounted elsewhere, by name; the others stay as given")


@dataclass(frozen=True, kw_only=True)
class LayoutStudyConfig:
    """A layout study."""

    ship_pitch_deg: float = _angle(0.0, doc="pitch of the ship, bow up", limit_deg=45.0)
    ship_roll_deg: float = _angle(0.0, doc="roll of the ship, starboard down", limit_deg=60.0)
    sensors: dict[str, LayoutSensor] = mapping_of("the star sensors of the layout, by name")
    optics: dict[str, Optics] = mapping_of("optics by the name of their sensor, in place of its three noise values")
    masks: dict[str, MaskConfig] = mapping_of("obstructions on deck, by name")
    field_of_view_deg: float = parameter(
        20.0, doc="side of the square field of sensors without optics, clear of masks", unit="deg", minimum=0.0,
        maximum=120.0,
    )  # fmt: skip
    common: CommonErrors = section(CommonErrors)
    requirement: Requirement = section(Requirement)
    alternatives: dict[str, Alternative] = mapping_of("other layouts to evaluate by the requirement, by name")
    horizon: HorizonClearance = section(HorizonClearance)
    figures: OperatingPoint = section(OperatingPoint)


def study_config(values: Mapping[str, Any]) -> LayoutStudyConfig:
    """Return the checked parameters of a study, with :data:`DEFAULT_SENSORS` if the values contain no sensors.

    Raises:
        ParameterError: a parameter is invalid; the text gives the parameter and the allowed values.
    """
    values = {**values, "sensors": values.get("sensors") or DEFAULT_SENSORS}
    config = build(LayoutStudyConfig, values)
    for name in config.sensors:
        if not _SENSOR_NAME.fullmatch(name):
            raise ParameterError(
                f"parameter 'sensors.{name}': a sensor name must start with a letter and contain letters, digits and _",
                f"sensors.{name}",
                value=name,
            )
    _check_optics(config, values)
    deck_masks(config.masks, "masks")
    _check_alternatives(config)
    # The order of the file is kept, because the first sensor keeps its azimuth.
    return dataclasses.replace(config, sensors={name: config.sensors[name] for name in values["sensors"]})


def _check_optics(config: LayoutStudyConfig, values: Mapping[str, Any]) -> None:
    """Check that optics belong to a sensor of the study, and that the noise of this sensor is not given.

    Raises:
        ParameterError: the sensor is unknown, or its noise is given.
    """
    for name in config.optics:
        if name not in config.sensors:
            raise ParameterError(
                f"parameter 'optics.{name}': there is no sensor '{name}': expected one of {', '.join(config.sensors)}",
                f"optics.{name}",
                value=name,
            )
        for key in ("sigma_forward_arcsec", "sigma_up_arcsec", "sigma_right_arcsec"):
            if key in values["sensors"][name]:
                raise ParameterError(
                    f"parameter 'sensors.{name}.{key}': the noise follows from optics.{name}: remove one of the two",
                    f"sensors.{name}.{key}",
                )


def _check_alternatives(config: LayoutStudyConfig) -> None:
    """Check that alternatives contain sensors of the study only, and that there is a requirement.

    Raises:
        ParameterError: an alternative contains another sensor, or there is no requirement.
    """
    for name, alternative in config.alternatives.items():
        key = f"alternatives.{name}"
        if not config.requirement.is_given:
            raise ParameterError(
                f"parameter '{key}': there is no requirement for its evaluation: add a requirement, or remove it", key
            )
        for sensor in alternative.sensors:
            if sensor not in config.sensors:
                raise ParameterError(
                    f"parameter '{key}.sensors.{sensor}': there is no sensor '{sensor}': expected one of "
                    f"{', '.join(config.sensors)}",
                    f"{key}.sensors.{sensor}",
                    value=sensor,
                )

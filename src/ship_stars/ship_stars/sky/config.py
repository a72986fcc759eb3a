"""Parameters of the sky model: refraction, air, age limits of position fixes, and corrections by star trackers."""

from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters.fields import parameter
from ship_geometry.air.refraction import MODELS
from ship_stars.attitude_samples import FieldOfView


@dataclass(frozen=True, kw_only=True)
class SkyConfig:
    """Parameters of air and ship's position: default values, errors and age limits."""

    refraction_model: str = parameter(
        "erfa",
        doc="refraction: ERFA's refco, the almanac's formula of [P15], or ray tracing through a standard atmosphere",
        choices=MODELS,
    )
    wavelength_um: float = parameter(
        0.55, doc="effective wavelength of the sensors' light", unit="um", minimum=0.3, maximum=2.0
    )
    pressure_hpa: float = parameter(
        1013.25, doc="air pressure at the ship without met/pressure", unit="hPa", minimum=800.0, maximum=1100.0
    )
    temperature_c: float = parameter(
        10.0, doc="air temperature without met/temperature", unit="deg C", minimum=-60.0, maximum=60.0
    )
    relative_humidity: float = parameter(0.7, doc="humidity without met/humidity, 0 to 1", minimum=0.0, maximum=1.0)
    pressure_sigma_hpa: float = parameter(
        15.0,
        doc="error of pressure_hpa; the error of a reading grows to this value with age",
        unit="hPa",
        minimum=0.0,
        maximum=200.0,
    )
    temperature_sigma_k: float = parameter(
        10.0,
        doc="error of temperature_c; the error of a reading grows to this value with age",
        unit="K",
        minimum=0.0,
        maximum=60.0,
    )
    measured_pressure_sigma_hpa: float = parameter(
        0.5, doc="error of met/pressure if the message gives no variance", unit="hPa", minimum=0.0, maximum=200.0
    )
    measured_temperature_sigma_k: float = parameter(
        1.0, doc="error of met/temperature if the message gives no variance", unit="K", minimum=0.0, maximum=60.0
    )
    weather_max_age_s: float = parameter(
        3600.0, doc="maximum age of a reading of the air; its variance grows until then", unit="s", minimum=1.0
    )
    refraction_time_s: float = parameter(
        3600.0, doc="correlation time of the error of refraction", unit="s", minimum=1.0, maximum=1e7
    )
    utc_sigma_s: float = parameter(
        0.0,
        doc="error of UTC, common to all stamps: 15″ per second; 0: clocks set by GNSS, whose error is negligible",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    magnitude_limit: float = parameter(
        7.0, doc="faintest star (Hp) considered for a detection without an identity", minimum=-2.0, maximum=15.0
    )
    fix_max_age_s: float = parameter(
        60.0, doc="maximum age of a position fix; without a fix no star is used", unit="s", minimum=0.1, maximum=3600.0
    )
    gnss_delay_s: float = parameter(
        0.5,
        doc="least age of a fix or a reading of the air for its use; one that arrives later needs a recomputation",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    fix_sigma_m: float = parameter(
        5.0, doc="error of a fix, each horizontal axis, if the message gives none", unit="m", minimum=0.0
    )
    max_speed_m_per_s: float = parameter(
        30.0,
        doc="maximum speed between fixes, the sway of the antenna included; a fix beyond it is rejected",
        unit="m/s",
        minimum=1.0,
        maximum=1000.0,
    )
    position_time_s: float = parameter(
        600.0, doc="correlation time of the error of the ship's position", unit="s", minimum=1.0, maximum=1e7
    )


@dataclass(frozen=True, kw_only=True)
class InertialConfig:
    """Corrections and field of view of a star tracker with an attitude in the ICRS (``input: inertial_attitude``)."""

    aberration_removed: bool = parameter(
        True, doc="the tracker corrects annual aberration; false: its attitude includes it"
    )
    field_deg: float = parameter(
        20.0,
        doc="width of the tracker's field, over which refraction varies; 0: as if all its stars were at the boresight",
        unit="deg",
        minimum=0.0,
        maximum=60.0,
    )

    @property
    def field_of_view(self) -> FieldOfView:
        """Field of view described by these parameters."""
        return FieldOfView(0.5 * float(np.deg2rad(self.field_deg)), self.aberration_removed)

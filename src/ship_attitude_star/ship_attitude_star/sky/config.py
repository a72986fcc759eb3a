"""Parameters of the sky: refraction and air, how long fixes hold, and what of the sky a tracker has taken out."""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.measurements.readings import FieldOfView
from ship_estimation.parameter_fields import parameter
from ship_geometry.refraction import MODELS


@dataclass(frozen=True, kw_only=True)
class SkyConfig:
    """From the catalogue to the horizon: the air and the ship's place, how well and for how long they are known."""

    refraction_model: str = parameter(
        "erfa",
        doc="refraction: ERFA's refco, the almanac's formula of [P15], or rays traced through a standard atmosphere",
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
        15.0, doc="error of pressure_hpa, what an old message tends to", unit="hPa", minimum=0.0, maximum=200.0
    )
    temperature_sigma_k: float = parameter(
        10.0, doc="error of temperature_c, what an old message tends to", unit="K", minimum=0.0, maximum=60.0
    )
    measured_pressure_sigma_hpa: float = parameter(
        0.5, doc="error of met/pressure where the message gives no variance", unit="hPa", minimum=0.0, maximum=200.0
    )
    measured_temperature_sigma_k: float = parameter(
        1.0, doc="error of met/temperature where the message gives no variance", unit="K", minimum=0.0, maximum=60.0
    )
    weather_max_age_s: float = parameter(
        3600.0, doc="weather older than this is not used; its variance grows until then", unit="s", minimum=1.0
    )
    refraction_time_s: float = parameter(
        3600.0, doc="correlation time of the error of refraction", unit="s", minimum=1.0, maximum=1e7
    )
    utc_sigma_s: float = parameter(
        0.0,
        doc="error of UTC, by which all stamps are wrong alike: 15″ a second; 0: clocks set by GNSS are far better",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    magnitude_limit: float = parameter(
        7.0, doc="faintest star (Hp) that a detection without an identity may be", minimum=-2.0, maximum=15.0
    )
    fix_max_age_s: float = parameter(
        60.0, doc="without a fix as young as this no star is used", unit="s", minimum=0.1, maximum=3600.0
    )
    gnss_delay_s: float = parameter(
        0.5,
        doc="stars are placed by fixes and readings of the air of so long before: later ones make them compare anew",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    fix_sigma_m: float = parameter(
        5.0, doc="error of a fix, each horizontal axis, where the message gives none", unit="m", minimum=0.0
    )
    max_speed_m_per_s: float = parameter(
        30.0,
        doc="a fix that is further from the last one than the ship sails is refused; what the antenna sways counts too",
        unit="m/s",
        minimum=1.0,
        maximum=1000.0,
    )
    position_time_s: float = parameter(
        600.0, doc="correlation time of the error of the ship's position", unit="s", minimum=1.0, maximum=1e7
    )


@dataclass(frozen=True, kw_only=True)
class InertialConfig:
    """How a star tracker solves its attitude against the ICRS; only for ``input: inertial_attitude``."""

    aberration_removed: bool = parameter(
        True, doc="the tracker takes annual aberration out; false: its attitude is that of the stars as seen"
    )
    field_deg: float = parameter(
        20.0,
        doc="width of the tracker's field: refraction differs over it; 0: as if all its stars were at the boresight",
        unit="deg",
        minimum=0.0,
        maximum=60.0,
    )

    @property
    def field(self) -> FieldOfView:
        """The field of view that these parameters describe."""
        return FieldOfView(0.5 * float(np.deg2rad(self.field_deg)), self.aberration_removed)

"""Parameters of the errors of an INS, which nodes and scenarios share."""

import math
from dataclasses import dataclass

from ship_estimation.parameters.fields import arcsec, parameter, section

GAUSS_MARKOV, SCHULER = "gauss_markov", "schuler"

_SQRT_HOUR = 60.0
_HOUR_S = 3600.0
_RADIUS_M = 6_371_000.0


@dataclass(frozen=True, kw_only=True)
class InsErrors:
    """Errors of the attitude and the clock of an INS."""

    tilt_sigma_arcsec: float = arcsec(10.0, doc="correlated error in tilt, each axis", live=True)
    heading_sigma_arcsec: float = arcsec(72.0, doc="correlated error in heading", live=True)
    white_sigma_arcsec: float = arcsec(1.0, doc="noise of each sample, each axis, quantisation included", live=True)
    time_offset_s: float = parameter(
        0.0, doc="a sample is valid at its stamp plus this offset", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.005, doc="uncertainty of time_offset_s; 0: known exactly", unit="s", minimum=0.0, maximum=1.0
    )


@dataclass(frozen=True, kw_only=True)
class InsRateErrors:
    """Errors of the angular rate of an INS."""

    rate_sigma_arcsec_per_s: float = parameter(
        0.0,
        doc="noise of the angular rate, each axis; nodes estimate a larger noise from the samples",
        unit="arcsec/s",
        minimum=0.0,
        maximum=36_000.0,
        live=True,
    )
    rate_has_earth_rate: bool = parameter(
        False, doc="the angular rate is that of the gyroscopes: it contains the Earth rate, 15 arcsec/s"
    )


@dataclass(frozen=True, kw_only=True)
class InsCorrelationTimes:
    """Correlation times of the errors of an INS."""

    tilt_time_s: float = parameter(1800.0, doc="correlation time of the tilt error", unit="s", minimum=0.1, maximum=1e7)
    heading_time_s: float = parameter(
        10800.0, doc="correlation time of the heading error", unit="s", minimum=0.1, maximum=1e7
    )


@dataclass(frozen=True, kw_only=True)
class SchulerConfig:
    """Parameters of the Schuler error model of the INS; used if ``ins.model`` is ``schuler``."""

    velocity_sigma_m_per_s: float = parameter(
        0.3, doc="error of the INS velocity at the start, each axis", unit="m/s", minimum=0.0, maximum=100.0
    )
    position_sigma_m: float = parameter(
        100.0, doc="error of the INS latitude at the start, if position aiding does not damp it", unit="m",
        minimum=0.0, maximum=1e6,
    )  # fmt: skip
    gyro_drift_sigma_deg_per_h: float = parameter(
        0.002, doc="drift of the gyroscopes, each axis", unit="deg/h", minimum=0.0, maximum=100.0
    )
    gyro_drift_time_s: float = parameter(
        36_000.0, doc="correlation time of the gyroscope drift", unit="s", minimum=1.0, maximum=1e7
    )
    angle_walk_deg_per_sqrt_h: float = parameter(
        0.0003, doc="random walk of the attitude by gyroscope noise", unit="deg/sqrt(h)",
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    accelerometer_bias_sigma_m_per_s2: float = parameter(
        1e-4, doc="bias of the accelerometers, each axis; 1e-4 tilts by 2 arcsec", unit="m/s2", minimum=0.0, maximum=1.0
    )
    accelerometer_bias_time_s: float = parameter(
        36_000.0, doc="correlation time of the accelerometer bias", unit="s", minimum=1.0, maximum=1e7
    )
    velocity_walk_m_per_s_per_sqrt_h: float = parameter(
        0.003, doc="random walk of the velocity by accelerometer noise", unit="m/s/sqrt(h)",
        minimum=0.0, maximum=100.0,
    )  # fmt: skip
    damping_time_s: float = parameter(
        0.0,
        doc="time constant with which position aiding damps the velocity error; 0: no position aiding",
        unit="s",
        minimum=0.0,
        maximum=1e7,
    )

    @property
    def is_free(self) -> bool:
        """True if velocity and latitude of the INS are not damped by position aiding."""
        return self.damping_time_s == 0.0

    @property
    def latitude_sigma(self) -> float:
        """Standard deviation of the INS latitude error at the start, rad; zero with position aiding."""
        return self.position_sigma_m / _RADIUS_M if self.is_free else 0.0

    @property
    def gyro_drift(self) -> float:
        """Standard deviation of the gyroscope drift, rad/s."""
        return math.radians(self.gyro_drift_sigma_deg_per_h) / _HOUR_S

    @property
    def angle_walk(self) -> float:
        """Random walk of the attitude, rad/√s."""
        return math.radians(self.angle_walk_deg_per_sqrt_h) / _SQRT_HOUR

    @property
    def velocity_walk(self) -> float:
        """Random walk of the velocity, m/s/√s."""
        return self.velocity_walk_m_per_s_per_sqrt_h / _SQRT_HOUR


@dataclass(frozen=True, kw_only=True)
class InsErrorModel:
    """Model of the correlated error of an INS."""

    model: str = parameter(
        GAUSS_MARKOV,
        doc="model of the INS error: exponentially correlated (tilt_time_s, heading_time_s), or the Schuler oscillation"
        ", for which nodes need gnss/fix (schuler)",
        choices=(GAUSS_MARKOV, SCHULER),
    )
    schuler: SchulerConfig = section(SchulerConfig)

"""Parameters of the ship's devices, which nodes and scenarios share: INS, star sensors, references, baselines."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ship_estimation.parameters.fields import accept_unset_covariance, arcsec, degrees, parameter, section
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray

GAUSS_MARKOV, SCHULER = "gauss_markov", "schuler"

_SQRT_HOUR = 60.0
_HOUR_S = 3600.0
_RADIUS_M = 6_371_000.0

JUMP_SAMPLES = 5
"""Default number of rejected, mutually consistent values after which a jump is accepted."""


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


@dataclass(frozen=True, kw_only=True)
class InsInputConfig(InsErrors):
    """Parameters required to use the attitudes of an INS: axes, standard deviations, clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    installation_heading_deg: float = degrees(0.0, doc="azimuth of the INS's forward axis in the deck")
    installation_pitch_deg: float = degrees(0.0, doc="elevation of the INS's forward axis in the deck")
    installation_roll_deg: float = degrees(0.0, doc="roll of the INS in the deck, right side down")
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )

    @cached_property
    def rotation_di(self) -> FloatArray:
        """Rotation "deck from INS" by the installation angles, shape (3, 3)."""
        angles_deg = self.installation_heading_deg, self.installation_pitch_deg, self.installation_roll_deg
        return rotation_from_angles(*np.deg2rad(angles_deg))


@dataclass(frozen=True, kw_only=True)
class CheckedInsConfig(InsRateErrors, InsInputConfig):
    """Parameters of an INS whose attitudes are checked for jumps."""

    jump_samples: int = parameter(
        JUMP_SAMPLES,
        doc="rejected, mutually consistent samples after which a jump of the attitude is accepted",
        minimum=1,
        maximum=1000,
        live=True,
    )


@dataclass(frozen=True, kw_only=True)
class StarInsConfig(CheckedInsConfig):
    """Parameters of an INS that measures the ship's rotation during star exposures."""

    untold_acceleration_deg_per_s2: float = parameter(
        2.0,
        doc="angular acceleration of the deck, each axis, assumed for an exposure without INS data",
        unit="deg/s2",
        minimum=0.0,
        maximum=100.0,
        live=True,
    )


def _noise(default: float, axis: str) -> Any:
    doc = f"noise {axis}; nodes use that of a message if it contains one"
    return arcsec(default, doc=doc, live=True)


@dataclass(frozen=True, kw_only=True)
class StarSensorMounting:
    """Mounting angles of a star sensor, with their standard deviations."""

    azimuth_deg: float = degrees(doc="installation azimuth of the boresight in the deck")
    elevation_deg: float = parameter(
        doc="installation elevation of the boresight above the deck", unit="deg", minimum=-90.0, maximum=90.0
    )
    roll_deg: float = degrees(0.0, doc="installation roll about the boresight, right side down")
    installation_sigma_forward_arcsec: float = arcsec(20.0, doc="installation error about the boresight")
    installation_sigma_up_arcsec: float = arcsec(1.0, doc="installation error about the up axis")
    installation_sigma_right_arcsec: float = arcsec(1.0, doc="installation error about the right axis")

    @cached_property
    def rotation_ds(self) -> FloatArray:
        """Rotation "deck from sensor" by the installation angles, shape (3, 3)."""
        return rotation_from_angles(*np.deg2rad([self.azimuth_deg, self.elevation_deg, self.roll_deg]))

    @cached_property
    def installation_sigma_s(self) -> FloatArray:
        """Standard deviation of the installation about the sensor's forward, up and right axes, rad, shape (3,)."""
        return ARCSEC * np.array(
            [
                self.installation_sigma_forward_arcsec,
                self.installation_sigma_up_arcsec,
                self.installation_sigma_right_arcsec,
            ]
        )


@dataclass(frozen=True, kw_only=True)
class StarSensorErrors:
    """Noise of the attitudes of a star sensor, hull flexure up to the sensor, and the sensor's clock."""

    sigma_forward_arcsec: float = _noise(100.0, "about the boresight")
    sigma_up_arcsec: float = _noise(3.0, "about the up axis")
    sigma_right_arcsec: float = _noise(3.0, "about the right axis")
    common_time_s: float = parameter(
        3600.0,
        doc="correlation time of the error common to the stars of a message (covariance minus noise_covariance)",
        unit="s",
        minimum=0.1,
        maximum=1e7,
    )
    flexure_sigma_arcsec: float = arcsec(0.0, doc="hull flexure between INS and sensor, each axis; 0: none")
    flexure_time_s: float = parameter(10.0, doc="correlation time of the flexure", unit="s", minimum=0.1, maximum=1e7)
    time_offset_s: float = parameter(
        0.0, doc="a message is valid at its stamp plus this offset", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.0, doc="uncertainty of time_offset_s; 0: known exactly", unit="s", minimum=0.0, maximum=1.0
    )

    @property
    def noise_sigma_s(self) -> FloatArray:
        """Standard deviation of the noise about the sensor's forward, up and right axes, rad, shape (3,)."""
        return ARCSEC * np.array([self.sigma_forward_arcsec, self.sigma_up_arcsec, self.sigma_right_arcsec])


@dataclass(frozen=True, kw_only=True)
class ReferenceErrors:
    """Mounting, noise and clock of another attitude system relative to the INS."""

    heading_deg: float = degrees(0.0, doc="heading of the reference minus heading of the INS")
    pitch_deg: float = degrees(0.0, doc="pitch of the reference minus pitch of the INS")
    roll_deg: float = degrees(0.0, doc="roll of the reference minus roll of the INS")
    installation_sigma_arcsec: float = arcsec(7200.0, doc="uncertainty of the three angles")
    sigma_roll_arcsec: float = _noise(60.0, "in roll")
    sigma_pitch_arcsec: float = _noise(60.0, "in pitch")
    sigma_heading_arcsec: float = _noise(60.0, "in heading")
    time_offset_s: float = parameter(
        0.0,
        doc="stamp of the reference minus stamp of the INS for the same attitude",
        unit="s",
        minimum=-10.0,
        maximum=10.0,
    )
    time_offset_sigma_s: float = parameter(
        0.2, doc="uncertainty of time_offset_s; 0: known exactly", unit="s", minimum=0.0, maximum=10.0
    )

    @property
    def rotation_dr(self) -> FloatArray:
        """Rotation "deck from reference" by the three angles, shape (3, 3)."""
        return rotation_from_angles(*np.deg2rad([self.heading_deg, self.pitch_deg, self.roll_deg]))

    @property
    def installation_sigma_r(self) -> FloatArray:
        """Standard deviation of the mounting about the reference's axes, rad, shape (3,)."""
        return np.full(3, self.installation_sigma_arcsec * ARCSEC)

    @property
    def noise_sigma_r(self) -> FloatArray:
        """Standard deviation of the noise about the reference's forward, up and right axes, rad, shape (3,)."""
        return ARCSEC * np.array([self.sigma_roll_arcsec, self.sigma_heading_arcsec, self.sigma_pitch_arcsec])


def _metres(doc: str) -> float:
    found: float = parameter(0.0, doc=doc, unit="m", minimum=-1000.0, maximum=1000.0)
    return found


@dataclass(frozen=True, kw_only=True)
class BaselineSurvey:
    """Surveyed vector between two antennas aboard; the three components are 0 without a baseline."""

    forward_m: float = _metres("vector from the base antenna to the rover antenna, component toward the bow")
    up_m: float = _metres("vector between the antennas, upward component")
    right_m: float = _metres("vector between the antennas, component to starboard")
    sigma_m: float = parameter(
        0.005, doc="uncertainty of each of the three components", unit="m", minimum=0.0, maximum=1000.0
    )

    @property
    def vector_d(self) -> FloatArray:
        """Vector from the base antenna to the rover antenna, deck frame (bow, up, starboard), m, shape (3,)."""
        return np.array([self.forward_m, self.up_m, self.right_m])

    @property
    def length_m(self) -> float:
        """Length of the baseline, m; 0 without a baseline."""
        return float(np.linalg.norm(self.vector_d))

    @property
    def is_aboard(self) -> bool:
        """True if the ship has a baseline."""
        return self.length_m > 0.0

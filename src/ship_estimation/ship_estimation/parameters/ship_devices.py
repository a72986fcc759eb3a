"""Parameters of star sensors, references and baselines of a ship, which nodes and scenarios share."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ship_estimation.parameters.fields import arcsec, degrees, parameter
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray


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

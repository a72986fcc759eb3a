"""Parameters of devices that more than one node has: the INS, and where a star sensor is bolted."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_estimation.parameters import parameter
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray


def degrees(default: Any = dataclasses.MISSING, *, doc: str) -> Any:
    """An angle of the geometry; without a default it must be given."""
    return parameter(default, doc=doc, unit="deg", minimum=-360.0, maximum=360.0)


def arcsec(default: float, *, doc: str, live: bool = False) -> Any:
    """A standard deviation."""
    return parameter(default, doc=doc, unit="arcsec", minimum=0.0, maximum=360_000.0, live=live)


@dataclass(frozen=True, kw_only=True)
class InsInputConfig:
    """What must be known of an INS to use its attitudes: axes, size of the errors, clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
    installation_heading_deg: float = degrees(0.0, doc="azimuth of the INS's forward axis in the deck")
    installation_pitch_deg: float = degrees(0.0, doc="elevation of the INS's forward axis in the deck")
    installation_roll_deg: float = degrees(0.0, doc="roll of the INS in the deck, right side down")
    tilt_sigma_arcsec: float = arcsec(10.0, doc="slow error in tilt, each axis", live=True)
    heading_sigma_arcsec: float = arcsec(72.0, doc="slow error in heading", live=True)
    white_sigma_arcsec: float = arcsec(1.0, doc="noise of each sample, each axis, quantisation included", live=True)
    time_offset_s: float = parameter(
        0.0, doc="a sample is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.005, doc="uncertainty of time_offset_s; 0 holds it fixed", unit="s", minimum=0.0, maximum=1.0
    )
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class MountingConfig:
    """Where a star sensor is bolted, and how well that is known."""

    frame_id: str = parameter("", doc="frame_id that its messages must carry; empty accepts any")
    azimuth_deg: float = degrees(doc="installation azimuth of the boresight in the deck")
    elevation_deg: float = parameter(
        doc="installation elevation of the boresight over the deck", unit="deg", minimum=-90.0, maximum=90.0
    )
    roll_deg: float = degrees(0.0, doc="installation roll about the boresight, right side down")
    installation_sigma_forward_arcsec: float = arcsec(20.0, doc="installation error about the boresight")
    installation_sigma_up_arcsec: float = arcsec(1.0, doc="installation error about the up axis")
    installation_sigma_right_arcsec: float = arcsec(1.0, doc="installation error about the right axis")

    @property
    def rotation_ds(self) -> FloatArray:
        """Deck from sensor by the installation angles, shape (3, 3)."""
        return rotation_from_angles(*np.deg2rad([self.azimuth_deg, self.elevation_deg, self.roll_deg]))

    @property
    def installation_sigma_s(self) -> FloatArray:
        """Error of the installation about the sensor's forward, up and right axes, rad, shape (3,)."""
        return ARCSEC * np.array(
            [
                self.installation_sigma_forward_arcsec,
                self.installation_sigma_up_arcsec,
                self.installation_sigma_right_arcsec,
            ]
        )

"""Parameters of a star sensor that more than one node has: where it is bolted."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters import ParameterError, arcsec, degrees, parameter
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray

JOINT = "joint"
"""In the place of a sensor's id: the deck by all sensors."""


def check_sensor_ids(ids: Iterable[str]) -> None:
    """Refuse an id by which the stars of all sensors would count a second time.

    Raises:
        ParameterError: names the parameter.
    """
    if JOINT in ids:
        name = f"star_sensors.{JOINT}"
        raise ParameterError(f"parameter '{name}': '{JOINT}' means all sensors, give it another id", name)


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

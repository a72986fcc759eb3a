"""Readings of star trackers, GNSS receivers, weather stations and gravity models, as plain data classes.

The stars of an exposure are in :class:`ship_stars.solution.exposure.StarExposure`.
"""

from dataclasses import dataclass
from typing import ClassVar

from ship_estimation.plausibility.value_checks import StuckValue, largest_sigma
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class FieldOfView:
    """Field of view of a star tracker.

    Attributes:
        radius: radius of the field, rad; 0 if all stars are assumed at the boresight.
        aberration_removed: True if the attitude of the tracker is already corrected for annual aberration.
    """

    radius: float = 0.0
    aberration_removed: bool = True


AT_BORESIGHT = FieldOfView()
"""Field of view with all stars at the boresight, aberration corrected."""


@dataclass(frozen=True)
class InertialAttitude:
    """Attitude of a star tracker relative to the ICRS.

    Attributes:
        source: name of the tracker, ``star.<id>``.
        time_ns: stamp of the tracker's message, the middle of the exposure.
        rotation_cs: rotation "ICRS from sensor (forward, up, right)", shape (3, 3).
        noise_s: error covariance, rotation vector in the sensor frame, rad², shape (3, 3).
        covariance_known: False if the message has no covariance, so that the configured sigma is used.
        field: field of view of the tracker.
    """

    source: str
    time_ns: int
    rotation_cs: FloatArray
    noise_s: FloatArray
    covariance_known: bool = True
    reach_ns = 0  # no motion data before or after its time are needed
    field: FieldOfView = AT_BORESIGHT

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.rotation_cs.tobytes() + self.noise_s.tobytes()

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant; a ship at rest rotates relative to the stars."""
        return self.rotation_cs, largest_sigma(self.noise_s), "attitude relative to the stars is constant"


@dataclass(frozen=True)
class PositionFix:
    """Ship position from a GNSS receiver.

    Attributes:
        time_ns: stamp of the fix.
        position: position of the antenna.
        covariance_m2: covariance of the position in (North, Up, East), m², shape (3, 3).
    """

    source: ClassVar[str] = "gnss/fix"

    time_ns: int
    position: GeodeticPosition
    covariance_m2: FloatArray


@dataclass(frozen=True)
class AirReading:
    """Reading of one air quantity from a weather station.

    Attributes:
        quantity: ``pressure`` (hPa, at the ship, not reduced to sea level), ``temperature`` (°C, of the outside air)
            or ``humidity`` (relative, 0 to 1).
        time_ns: stamp of the reading.
        value: value in the unit of the quantity.
        sigma: standard deviation of the value; None if the message has no variance.
    """

    quantity: str
    time_ns: int
    value: float
    sigma: float | None = None

    @property
    def source(self) -> str:
        """Name of the source, which is the name of the quantity."""
        return self.quantity


SkyInput = PositionFix | AirReading
"""Input of the sky model."""


@dataclass(frozen=True)
class DeflectionReading:
    """Deflection of the vertical at the ship, from a gravity model.

    Attributes:
        time_ns: stamp of the reading.
        deflection: deflection (xi, eta) of the gravity zenith, northward and eastward, rad, shape (2,).
        covariance: error covariance of the deflection, rad², shape (2, 2); None if the message has no covariance.
    """

    source: ClassVar[str] = "gravity/deflection"

    time_ns: int
    deflection: FloatArray
    covariance: FloatArray | None = None

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.deflection.tobytes() + (b"" if self.covariance is None else self.covariance.tobytes())

"""What star trackers, GNSS receivers and weather stations say, as plain structs.

The stars of an exposure have a struct of their own, :class:`ship_attitude_star.stars.exposure.StarExposure`.
"""

from dataclasses import dataclass
from typing import ClassVar

from ship_geometry.geodetic import GeodeticPosition
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class FieldOfView:
    """How a star tracker sees the sky.

    Attributes:
        radius: of the field, rad; 0 for a tracker whose stars are all taken to stand at the boresight.
        aberration_removed: True where the tracker's attitude is already free of aberration.
    """

    radius: float = 0.0
    aberration_removed: bool = True


AT_BORESIGHT = FieldOfView()
"""All stars stand at the boresight, and aberration is taken out."""


@dataclass(frozen=True)
class InertialAttitude:
    """The attitude that a star tracker has found against the ICRS.

    Attributes:
        source: ``star.<id>``.
        time_ns: middle of the exposure, stamp of the sensor.
        rotation_cs: celestial (ICRS) axes from sensor (forward, up, right), shape (3, 3).
        noise_s: covariance of the error, rotation vector in the sensor frame, rad², shape (3, 3).
        covariance_known: False where the message gave no covariance and the configured sigma stands in.
        field: field in which the tracker saw its stars.
    """

    source: str
    time_ns: int
    rotation_cs: FloatArray
    noise_s: FloatArray
    covariance_known: bool = True
    reach_ns = 0  # an attitude is that of its moment
    field: FieldOfView = AT_BORESIGHT

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.rotation_cs.tobytes() + self.noise_s.tobytes()


@dataclass(frozen=True)
class PositionFix:
    """Where the ship is, by a GNSS receiver.

    Attributes:
        time_ns: stamp.
        position: of the antenna.
        covariance_m2: of the position in (North, Up, East), m², shape (3, 3).
    """

    source: ClassVar[str] = "gnss/fix"

    time_ns: int
    position: GeodeticPosition
    covariance_m2: FloatArray


@dataclass(frozen=True)
class AirReading:
    """One quantity of the air, by a weather station.

    Attributes:
        quantity: ``pressure`` (hPa, at the ship, not reduced to sea level), ``temperature`` (°C, of the outside air)
            or ``humidity`` (relative, 0 to 1).
        time_ns: stamp.
        value: in the unit of the quantity.
        sigma: its standard deviation; None where the message gives none.
    """

    quantity: str
    time_ns: int
    value: float
    sigma: float | None = None

    @property
    def source(self) -> str:
        """What is measured."""
        return self.quantity


SkyInput = PositionFix | AirReading
"""An input on which the sky over the ship depends."""


@dataclass(frozen=True)
class DeflectionReading:
    """The deflection of the vertical at the ship, by somebody who knows the gravity field.

    Attributes:
        time_ns: stamp.
        deflection: (xi, eta), northward and eastward components of gravity's zenith, rad, shape (2,).
        covariance: of its error, rad², shape (2, 2); None where the message gives none.
    """

    source: ClassVar[str] = "gravity/deflection"

    time_ns: int
    deflection: FloatArray
    covariance: FloatArray | None = None

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.deflection.tobytes() + (b"" if self.covariance is None else self.covariance.tobytes())

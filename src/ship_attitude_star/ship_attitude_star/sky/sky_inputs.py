"""What the sky over the ship depends on: position fixes and readings of the air, each as one input of a core."""

from dataclasses import dataclass

from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.refusals import Refusal
from ship_geometry.geodetic import GeodeticPosition
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class PositionFix:
    """Where the ship is.

    Attributes:
        time_ns: stamp.
        position: of the antenna.
        covariance_m2: in (North, Up, East), shape (3, 3).
        sigma_known: False where the message gave none and the configured sigma stands in.
    """

    time_ns: int
    position: GeodeticPosition
    covariance_m2: FloatArray
    sigma_known: bool = True

    def refusal(self, watch: SkyWatch) -> Refusal | None:
        """DUPLICATE or CONFLICT where there is a fix of that stamp; to be asked before :meth:`insert`."""
        return watch.place.refusal(self.time_ns, self.position, self.covariance_m2)

    def insert(self, watch: SkyWatch) -> int | None:
        """Put it into the sky; returns the moment after which places may have changed, None where none has."""
        return watch.place.insert(self.time_ns, self.position, self.covariance_m2)


@dataclass(frozen=True)
class AirReading:
    """One quantity of the air.

    Attributes:
        quantity: ``pressure`` (hPa), ``temperature`` (°C) or ``humidity`` (0 to 1).
        time_ns: stamp.
        value: in the unit of the quantity.
        sigma: its standard deviation; None where the message gives none.
    """

    quantity: str
    time_ns: int
    value: float
    sigma: float | None

    @property
    def sigma_known(self) -> bool:
        """Whether the message says how good it is; of humidity nobody asks."""
        return self.sigma is not None or self.quantity == "humidity"

    def refusal(self, watch: SkyWatch) -> Refusal | None:
        """DUPLICATE or CONFLICT where there is a reading of that stamp; to be asked before :meth:`insert`."""
        return watch.weather.refusal(self.quantity, self.time_ns, self.value, self.sigma)

    def insert(self, watch: SkyWatch) -> int | None:
        """Put it into the sky; returns the moment after which the air has changed, None where it has not."""
        match self.quantity:
            case "pressure":
                return watch.weather.insert_pressure(self.time_ns, self.value, self.sigma)
            case "temperature":
                return watch.weather.insert_temperature(self.time_ns, self.value, self.sigma)
            case _:
                return watch.weather.insert_humidity(self.time_ns, self.value)


SkyInput = PositionFix | AirReading

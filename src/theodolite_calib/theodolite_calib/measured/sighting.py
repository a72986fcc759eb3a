"""Everything that one exposure is compared with, brought to the middle of the exposure."""

from dataclasses import dataclass

from ship_geometry.rotations import FloatArray
from theodolite_calib.lights.light_points import Image
from theodolite_calib.lights.light_streaks import LightStreaks
from theodolite_calib.lights.line_of_sight import Lights


@dataclass(frozen=True)
class ShipAt:
    """The ship's attitude at the moment.

    Attributes:
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        slow_covariance_n: as in :class:`theodolite_calib.measured.samples.ShipSample`.
        noise: variance of each component of what is new with each sample, and of interpolation, rad².
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    slow_covariance_n: FloatArray | None
    noise: float


@dataclass(frozen=True)
class EncoderAt:
    """The encoders at the moment.

    Attributes:
        azimuth: rad.
        elevation: rad.
        noise: variance of each, that of interpolation included, rad².
    """

    azimuth: float
    elevation: float
    noise: float


@dataclass(frozen=True)
class Sighting:
    """An exposure with all that belongs to it.

    Attributes:
        time_ns: middle of the exposure.
        names: of the N lights.
        image: where they are on the detector.
        lights: where they are said to be; the covariance of the drones' attitudes is not used.
        ship: its attitude.
        encoder: its angles.
        streaks: the lights as found, where ``image`` has them at the middle of an exposure of known length; else None.
    """

    time_ns: int
    names: tuple[str, ...]
    image: Image
    lights: Lights
    ship: ShipAt
    encoder: EncoderAt
    streaks: LightStreaks | None = None

    def in_deck(self, rotation_nt: FloatArray) -> FloatArray:
        """Deck from telescope, by the ship's attitude, shape (3, 3)."""
        rotation_dt: FloatArray = self.ship.rotation_nd.T @ rotation_nt
        return rotation_dt

    def chosen(self, rows: list[int], seen_rows: list[int] | None = None) -> "Sighting":
        """The same with some lights only, or with names exchanged: light ``rows[i]`` is seen as ``seen_rows[i]``."""
        lights = Lights(
            self.lights.baseline_n[rows],
            self.lights.baseline_covariance_n[rows],
            self.lights.rotation_nb[rows],
            self.lights.attitude_covariance_n[rows],
        )
        seen = rows if seen_rows is None else seen_rows
        streaks = None if self.streaks is None else self.streaks.chosen(rows, seen)
        return Sighting(
            self.time_ns,
            tuple(self.names[row] for row in rows),
            self.image.chosen(seen) if streaks is None else streaks.at_middle(),
            lights,
            self.ship,
            self.encoder,
            streaks,
        )

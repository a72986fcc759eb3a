"""The sky over the ship as the inputs tell it: catalogue and Earth orientation, and place and air at any moment."""

import erfa

from ship_attitude_star.sky.apparent_sky import ApparentStars, Sky
from ship_attitude_star.sky.catalogue import StarCatalogue, hipparcos
from ship_attitude_star.sky.place_track import PlaceTrack
from ship_attitude_star.sky.surroundings import Air, Place
from ship_attitude_star.sky.weather_track import WeatherTrack
from ship_attitude_star.stars.star_config import SkyConfig
from ship_estimation.refusals import Refusal
from ship_geometry.earth_orientation import EarthOrientationTable, earth_orientation_table
from ship_geometry.rotations import FloatArray
from ship_geometry.star_directions import StarPositions

_JULIAN_YEAR_NS = 31_557_600_000_000_000


class SkyWatch:
    """What is above the ship, moment by moment.

    Args:
        config: refraction, and how long a fix and the weather hold.
        table: Earth orientation.
        catalogue: the stars.

    Attributes:
        bright_rows: of the catalogue, stars bright enough to be meant by a detection, shape (m,).
        bright_directions: of these, ICRS unit vectors, shape (m, 3).
    """

    def __init__(self, config: SkyConfig, table: EarthOrientationTable, catalogue: StarCatalogue) -> None:
        self._config = config
        self.sky = Sky(config, table)
        self.catalogue = catalogue
        self.bright_rows = catalogue.brighter_than(config.magnitude_limit)
        self.bright_directions = _unit_vectors(catalogue.at_j2000[self.bright_rows])
        self.reset()

    def reset(self) -> None:
        """Forget fixes and weather."""
        self.place = PlaceTrack(self._config)
        self.weather = WeatherTrack(self._config)

    def reason_against(self, time_ns: int) -> Refusal | None:
        """Why no star can be placed at a moment; None where it can."""
        return self.sky.reason_against(time_ns) or self.place.reason_against(time_ns)

    def surroundings(self, time_ns: int) -> tuple[Place, Air]:
        """Place and air at a moment that :meth:`reason_against` has nothing against."""
        place = self.place.at(time_ns)
        assert place is not None
        return place, self.weather.at(time_ns)

    def apparent(self, stars: StarPositions, time_ns: int) -> ApparentStars:
        """Directions of stars at a moment that :meth:`reason_against` has nothing against."""
        return self.sky.apparent(stars, time_ns, *self.surroundings(time_ns))

    @staticmethod
    def year(time_ns: int) -> float:
        """Julian year of a moment, for what a catalogue's errors have grown to."""
        return 1970.0 + time_ns / _JULIAN_YEAR_NS

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        self.place.drop_before(time_ns)
        self.weather.drop_before(time_ns)


def _unit_vectors(stars: StarPositions) -> FloatArray:
    """ICRS directions, shape (k, 3)."""
    vectors: FloatArray = erfa.s2c(stars.right_ascension, stars.declination)
    return vectors


def installed_sky(config: SkyConfig) -> SkyWatch:
    """The sky by the installed catalogue and Earth orientation; reading them takes a second or two, once."""
    return SkyWatch(config, earth_orientation_table(), hipparcos())

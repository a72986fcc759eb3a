"""Messages of the satellite receiver and of the weather station; see :mod:`device_messages` for what a maker is."""

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.ros_axes import enu_covariance
from ship_simulation.messages.device_messages import Maker
from ship_simulation.scenario.scenario import Weather
from ship_simulation.ship.ship_track import FixSamples

_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2
"""NavSatStatus.STATUS_FIX, NavSatStatus.SERVICE_GPS, NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN."""


def fix_maker(fixes: FixSamples, factory: MessageFactory) -> Maker:
    """Maker of gnss/fix."""
    covariance = enu_covariance(fixes.covariance_m2).ravel()

    def make(stamp: int, value: int) -> object:
        return factory.make(
            "sensor_msgs/msg/NavSatFix",
            header=make_header(factory, int(fixes.time_ns[stamp]), "gnss"),
            status=factory.make("sensor_msgs/msg/NavSatStatus", status=_FIX, service=_GPS),
            latitude=float(fixes.latitude_deg[value]),
            longitude=float(fixes.longitude_deg[value]),
            altitude=float(fixes.height_m[value]),
            position_covariance=covariance,
            position_covariance_type=_DIAGONAL_KNOWN,
        )

    return make


def weather_makers(time_ns: np.ndarray, weather: Weather, factory: MessageFactory) -> dict[str, Maker]:
    """Makers of met/pressure (Pa), met/temperature (°C) and met/humidity (0 to 1) by topic."""
    values = {
        "met/pressure": ("sensor_msgs/msg/FluidPressure", "fluid_pressure", 100.0 * weather.pressure_hpa),
        "met/temperature": ("sensor_msgs/msg/Temperature", "temperature", weather.temperature_c),
        "met/humidity": ("sensor_msgs/msg/RelativeHumidity", "relative_humidity", 0.01 * weather.humidity_percent),
    }
    return {topic: _constant_maker(time_ns, *content, factory) for topic, content in values.items()}


def _constant_maker(time_ns: np.ndarray, type_name: str, field: str, constant: float, factory: MessageFactory) -> Maker:
    def make(stamp: int, value: int) -> object:
        header = make_header(factory, int(time_ns[stamp]), "met")
        # A variance of zero says unknown.
        return factory.make(type_name, header=header, variance=0.0, **{field: constant})

    return make

"""Messages of the ship from a run: INS, other attitudes, satellite position, weather, deflection, true attitude.

Each function ``…_maker`` returns a maker of single messages. A maker takes two indices: of the sample that gives the
stamp of a message, and of the sample that gives its values. A run uses equal indices. Faults change messages later.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.messages.lazy_rows import BLOCK_ROWS, LazyRows
from ship_simulation.scenario.names import DECK_FRAME, DEFLECTION, IMU, INS_FRAME, SHIP_ATTITUDE
from ship_simulation.scenario.scenario import Ins, WeatherStation
from ship_simulation.ship.attitude_device import DeviceSamples, FusedSamples, InsSamples
from ship_simulation.ship.ship_track import FixSamples

Maker = Callable[[int, int], Any]

NOT_GIVEN = np.array([-1.0, *[0.0] * 8])
"""Covariance that means "not given" in a message."""

_EXACT = np.zeros(9)
"""Covariance of the truth."""

_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2
"""NavSatStatus.STATUS_FIX, NavSatStatus.SERVICE_GPS, NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN."""


def ins_maker(samples: InsSamples, config: Ins, factory: MessageFactory) -> Maker:
    """Return the maker of ins/imu. The covariance of the orientation describes the total error of the INS."""
    sigma_enu = np.array([config.tilt_sigma_arcsec, config.tilt_sigma_arcsec, config.heading_sigma_arcsec])
    variance = ARCSEC**2 * (sigma_enu**2 + config.white_sigma_arcsec**2)
    covariance = np.diag(variance).ravel()
    # All zero, which means unknown, if the scenario has no noise of the rate.
    rate_covariance = np.diag(np.full(3, (config.rate_sigma_arcsec_per_s * ARCSEC) ** 2)).ravel()
    quaternions = quaternion_rows(samples.rotation_nd)
    rates = rate_rows(samples.rate_d)

    def make(stamp: int, value: int) -> Any:
        header = make_header(factory, int(samples.time_ns[stamp]), INS_FRAME)
        return make_imu(factory, header, quaternions[value], covariance, rates[value], rate_covariance)

    return make


def reference_maker(name: str, samples: DeviceSamples, factory: MessageFactory) -> Maker:
    """Return the maker of reference/<name>/imu, with the covariance of the white noise only, and without a rate."""
    quaternions = quaternion_rows(samples.rotation_nv)
    covariances = LazyRows(lambda part: list(enu_covariance(white_covariance_in_horizon(samples, part)).reshape(-1, 9)))

    def make(stamp: int, value: int) -> Any:
        header = make_header(factory, int(samples.time_ns[stamp]), name)
        return make_imu(factory, header, quaternions[value], covariances[value], [0.0, 0.0, 0.0], NOT_GIVEN)

    return make


def white_covariance_in_horizon(samples: DeviceSamples, part: slice) -> FloatArray:
    """Return the covariance of the white noise of samples about the horizon's axes, rad², shape (n, 3, 3)."""
    rotation_nv = samples.rotation_nv[part]
    return rotation_nv @ samples.noise_v @ np.swapaxes(rotation_nv, -1, -2)


def quaternion_rows(rotation: FloatArray) -> LazyRows[list[float]]:
    """Return quaternions x, y, z, w, ENU <- FLU, of rotations "horizon from device", shape (n, 3, 3)."""
    return LazyRows(lambda part: quaternion_from_rotation(rotation[part]).tolist())


def angle_rows(rotation: FloatArray) -> LazyRows[list[float]]:
    """Return the three angles, rad, of each of n rotations, shape (n, 3, 3)."""
    return LazyRows(lambda part: angles_from_rotation(rotation[part]).tolist())


def rate_rows(rate: FloatArray) -> LazyRows[list[float]]:
    """Return angular velocities in FLU from angular velocities in the axes of the device, rad/s, shape (n, 3)."""
    return LazyRows(lambda part: flu_from_device_vector(rate[part]).tolist())


def make_imu(
    factory: MessageFactory,
    header: Any,
    quaternion: list[float],
    covariance: np.ndarray,
    rate: list[float],
    rate_covariance: np.ndarray,
) -> Any:
    """Make a sensor_msgs/Imu without acceleration."""
    return factory.make(
        IMU,
        header=header,
        orientation=make_quaternion(factory, quaternion),
        orientation_covariance=covariance,
        angular_velocity=make_vector(factory, rate),
        angular_velocity_covariance=rate_covariance,
        linear_acceleration=make_vector(factory, [0.0, 0.0, 0.0]),
        linear_acceleration_covariance=NOT_GIVEN,
    )


def make_quaternion(factory: MessageFactory, xyzw: list[float]) -> Any:
    """Make a geometry_msgs/Quaternion."""
    x, y, z, w = xyzw
    return factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def make_vector(factory: MessageFactory, xyz: list[float]) -> Any:
    """Make a geometry_msgs/Vector3."""
    x, y, z = xyz
    return factory.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def fused_maker(samples: FusedSamples, factory: MessageFactory) -> Maker:
    """Return the maker of ship/attitude."""

    def covariances(part: slice) -> list[FloatArray]:
        headings, pitches, _ = angles_from_rotation(samples.rotation_nd[part]).T
        return list(angle_covariance(samples.covariance_n, headings, pitches).reshape(-1, 9))

    total = enu_covariance(samples.covariance_n).ravel()
    constant_fields = {"rotation_covariance": total, "sources": ["ins", "star"], "star_age_s": 0.0}
    return _ship_attitude_maker(
        samples.time_ns, samples.rotation_nd, samples.rate_d, LazyRows(covariances), constant_fields, factory
    )


def true_attitude_maker(
    time_ns: np.ndarray, rotation_nd: FloatArray, rate_d: FloatArray, factory: MessageFactory
) -> Maker:
    """Return the maker of truth/attitude."""
    constant_fields = {"rotation_covariance": np.zeros(9), "sources": ["truth"], "star_age_s": float("nan")}
    return _ship_attitude_maker(
        time_ns, rotation_nd, rate_d, LazyRows(lambda part: [_EXACT] * BLOCK_ROWS), constant_fields, factory
    )


def _ship_attitude_maker(
    time_ns: np.ndarray,
    rotation_nd: FloatArray,
    rate_d: FloatArray,
    covariances: LazyRows[FloatArray],
    constant_fields: dict[str, Any],
    factory: MessageFactory,
) -> Maker:
    """Return the maker of ShipAttitude; ``constant_fields`` are equal in all messages."""
    angles = angle_rows(rotation_nd)
    quaternions = quaternion_rows(rotation_nd)
    rates = rate_rows(rate_d)

    def make(stamp: int, value: int) -> Any:
        heading, pitch, roll = angles[value]
        return factory.make(
            SHIP_ATTITUDE,
            header=make_header(factory, int(time_ns[stamp]), DECK_FRAME),
            heading=heading,
            pitch=pitch,
            roll=roll,
            covariance=covariances[value],
            orientation=make_quaternion(factory, quaternions[value]),
            angular_velocity=make_vector(factory, rates[value]),
            status=0,
            horizon=0,
            **constant_fields,
        )

    return make


def fix_maker(fixes: FixSamples, factory: MessageFactory) -> Maker:
    """Return the maker of gnss/fix."""
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


def deflection_maker(
    time_ns: np.ndarray, deflection: FloatArray, covariance: FloatArray, factory: MessageFactory
) -> Maker:
    """Return the maker of Deflection from deflections at n stamps, shape (n, 2), and their covariance, shape (2, 2)."""

    def make(stamp: int, value: int) -> object:
        header = make_header(factory, int(time_ns[stamp]), "gravity")
        xi, eta = deflection[value].tolist()
        return factory.make(DEFLECTION, header=header, xi=xi, eta=eta, covariance=covariance.ravel())

    return make


def weather_makers(time_ns: np.ndarray, weather: WeatherStation, factory: MessageFactory) -> dict[str, Maker]:
    """Return the makers of met/pressure (Pa), met/temperature (°C) and met/humidity (0 to 1) by topic."""
    values = {
        "met/pressure": ("sensor_msgs/msg/FluidPressure", "fluid_pressure", 100.0 * weather.pressure_hpa),
        "met/temperature": ("sensor_msgs/msg/Temperature", "temperature", weather.temperature_c),
        "met/humidity": ("sensor_msgs/msg/RelativeHumidity", "relative_humidity", 0.01 * weather.humidity_percent),
    }
    return {topic: _constant_maker(time_ns, *content, factory) for topic, content in values.items()}


def _constant_maker(time_ns: np.ndarray, type_name: str, field: str, constant: float, factory: MessageFactory) -> Maker:
    def make(stamp: int, value: int) -> object:
        header = make_header(factory, int(time_ns[stamp]), "met")
        # A variance of zero means unknown.
        return factory.make(type_name, header=header, variance=0.0, **{field: constant})

    return make

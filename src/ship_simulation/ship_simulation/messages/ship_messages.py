"""Messages of the devices on the ship: INS, attitudes, satellite position, weather, deflection, star sensors; truth.

Each function ``…_maker`` returns a maker of single messages. A maker takes two indices: of the sample that gives the
stamp of a message, and of the sample that gives its values. A run uses equal indices. Faults change messages later.
Values are derived from samples on demand, so that memory does not grow with the length of the voyage.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import (
    FLU_FROM_DEVICE,
    SINGULAR_ELEVATION,
    angle_covariance,
    angles_from_rotation,
    enu_covariance,
    flu_from_device_vector,
    quaternion_from_rotation,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.scenario.names import (
    DECK_FRAME,
    DEFLECTION,
    IMU,
    INERTIAL,
    INS_FRAME,
    OBSERVATIONS,
    SHIP_ATTITUDE,
    STAR,
    star_frame,
)
from ship_simulation.scenario.scenario import Ins, StarSensor, WeatherStation
from ship_simulation.ship.attitude_device import DeviceSamples, FusedSamples, InsSamples
from ship_simulation.ship.ship_track import FixSamples
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings

Row = TypeVar("Row")

BLOCK_ROWS = 4096
"""Number of rows computed at a time, large enough for the full speed."""

_KEPT_BLOCKS = 2
"""Number of cached blocks. Samples are used in order of arrival, which differs slightly from the order of stamps."""

NOT_GIVEN = np.array([-1.0, *[0.0] * 8])
"""Covariance that means "not given" in a message."""

_EXACT = np.zeros(9)
"""Covariance of the truth."""

_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2
"""NavSatStatus.STATUS_FIX, NavSatStatus.SERVICE_GPS, NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN."""

_STATUS_VALID, _STATUS_ANGLES_SINGULAR = 0, 2
"""StarHorizonAttitude.VALID, StarHorizonAttitude.ANGLES_SINGULAR."""


class LazyRows(Generic[Row]):
    """One row per sample, with a cache of the last blocks.

    Args:
        compute: function that returns the rows of a slice of samples; each row depends on its sample only.
    """

    def __init__(self, compute: Callable[[slice], Sequence[Row]]) -> None:
        self._of = compute
        self._block = lru_cache(_KEPT_BLOCKS)(self._compute_block)

    def __getitem__(self, row: int) -> Row:
        """Return the row of a sample."""
        number, place = divmod(row, BLOCK_ROWS)
        return self._block(number)[place]

    def _compute_block(self, number: int) -> Sequence[Row]:
        return self._of(slice(number * BLOCK_ROWS, (number + 1) * BLOCK_ROWS))


Maker = Callable[[int, int], Any]


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


def star_maker(sensor_id: str, samples: DeviceSamples, config: StarSensor, factory: MessageFactory) -> Maker:
    """Return the maker of star/<id>/horizon_attitude."""
    angles = angle_rows(samples.rotation_nv)

    def covariances(part: slice) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        noise_n = white_covariance_in_horizon(samples, part)
        total_n = noise_n + samples.common_n
        azimuths, elevations, _ = angles_from_rotation(samples.rotation_nv[part]).T
        of_angles = angle_covariance(total_n, azimuths, elevations)
        blocks = (each.reshape(-1, 9) for each in (of_angles, enu_covariance(total_n), enu_covariance(noise_n)))
        return list(zip(*blocks, strict=True))

    rows = LazyRows(covariances)
    # The error of a solution across the boresight is the error of one star divided by the root of the number of stars.
    residual_rms = ARCSEC * np.hypot(config.sigma_up_arcsec, config.sigma_right_arcsec) * np.sqrt(config.star_count)

    def make(stamp: int, value: int) -> Any:
        azimuth, elevation, roll = angles[value]
        covariance, rotation_covariance, noise_covariance = rows[value]
        singular = abs(elevation) > SINGULAR_ELEVATION
        return factory.make(
            STAR,
            header=make_header(factory, int(samples.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            azimuth=azimuth,
            elevation=elevation,
            roll=roll,
            covariance=covariance,
            rotation_covariance=rotation_covariance,
            noise_covariance=noise_covariance,
            star_count=config.star_count,
            rejected_count=0,
            residual_rms=float(residual_rms),
            status=_STATUS_ANGLES_SINGULAR if singular else _STATUS_VALID,
        )

    return make


def observations_maker(
    sensor_id: str, frame_id: str, sightings: StarSightings, exposure_s: float, factory: MessageFactory
) -> Maker:
    """Return the maker of star/<id>/observations, and of theodolite/<id>/stars."""
    stars = sightings.stars

    def make_star(row: int) -> Any:
        # The position of a star with a number comes from the catalogue.
        numbered = stars.hip[row] != 0
        u, v = sightings.pixel[row].tolist()
        return factory.make(
            "ship_msgs/msg/StarObservation",
            catalogue_id=int(stars.hip[row]),
            right_ascension=math.nan if numbered else float(stars.positions.right_ascension[row]),
            declination=math.nan if numbered else float(stars.positions.declination[row]),
            u=u,
            v=v,
            sigma_px=sightings.sigma_px,
            magnitude=float(stars.magnitude[row]),
        )

    def make(stamp: int, value: int) -> Any:
        rows = sightings.rows(value)
        return factory.make(
            OBSERVATIONS,
            header=make_header(factory, int(sightings.time_ns[stamp]), frame_id),
            sensor_id=sensor_id,
            exposure_s=exposure_s,
            stars=[make_star(row) for row in range(rows.start, rows.stop)],
        )

    return make


def inertial_maker(sensor_id: str, samples: InertialSamples, factory: MessageFactory) -> Maker:
    """Return the maker of star/<id>/inertial_attitude."""
    # The quaternions rotate from (forward, left, up) to the ICRS.

    def quaternions_of(part: slice) -> list[list[float]]:
        rotations = Rotation.from_matrix(samples.rotation_cv[part] @ FLU_FROM_DEVICE.T)
        xyzw: list[list[float]] = rotations.as_quat(canonical=True).tolist()
        return xyzw

    quaternions = LazyRows(quaternions_of)
    covariance = (FLU_FROM_DEVICE @ samples.noise_v @ FLU_FROM_DEVICE.T).ravel()

    def make(stamp: int, value: int) -> Any:
        return factory.make(
            INERTIAL,
            header=make_header(factory, int(samples.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            orientation=make_quaternion(factory, quaternions[value]),
            covariance=covariance,
        )

    return make

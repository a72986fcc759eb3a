"""Inputs of ``ship_attitude`` from the sensors that are compared with the INS, and the reader of deflections.

A reader checks a message and converts it to the data class of the core. The readers of single messages use only
attributes, so any message class can be used. For a message that cannot be used they raise
:class:`ship_node.messages.field_checks.MessageRejected`. The reader of a block converts all regular messages at once,
with bit-identical results; its result is None for each message that must be read alone.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ship_attitude_star.ship_attitude.config import (
    ReferenceConfig,
    ShipAttitudeConfig,
    ShipBaselineConfig,
    StarSensorConfig,
)
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.measurements.devices import BASELINE, BaselineMeasurement
from ship_bags.cdr_template import CdrRows
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.frames import (
    FLU_FROM_DEVICE,
    celestial_rotation_from_quaternion,
    horizon_covariance,
    rotation_from_angles,
    rotation_vector_covariance,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_rotations
from ship_node.adapters.adapter import Feed
from ship_node.health.duplicate_publishers import INNOVATION
from ship_node.messages.field_checks import (
    MessageRejected,
    ReadMessage,
    ReadRows,
    angular_covariance,
    angular_covariances,
    check_device_id,
    check_finite,
    check_frame,
    imu_rotation,
    read_valid,
    stamp_ns,
    stamps,
    unit_quaternion,
)
from ship_node.messages.inputs_outputs import InputTopic
from ship_node.messages.sensor_readers import baseline_stamp_ns, baseline_vector, fix_rejection
from ship_stars.attitude_samples import (
    SHARED_BY_MESSAGES,
    SHARED_BY_SKY,
    AttitudeMeasurement,
    DeflectionReading,
    InertialAttitude,
    SolvedAttitude,
)
from ship_stars.messages.star_messages import ExposingSensor, star_exposure
from ship_stars.sky.sky_model import SkyModel

STAR_INVALID = 3
MAX_ELEVATION, MAX_ANGLE = 0.5 * np.pi + 1e-9, 6.0 * np.pi
"""Maximum elevation of a star sensor, and maximum azimuth and roll, rad; azimuth and roll are used modulo 2π."""

_COVARIANCE_TOLERANCE, _MAX_DEFLECTION = 1e-6, 300.0 * ARCSEC

_STAR_TYPES = {
    "horizon_attitude": "ship_msgs/msg/StarHorizonAttitude",
    "solution": "ship_msgs/msg/StarHorizonAttitude",
    "observations": "ship_msgs/msg/StarObservationArray",
    "inertial_attitude": "ship_msgs/msg/StarInertialAttitude",
}


def sensor_feeds(config: ShipAttitudeConfig, core: ShipAttitudeCore, sky_model: SkyModel | None) -> Iterator[Feed]:
    """Yield the inputs of all sensors; each star sensor has one topic only.

    Raises:
        ParameterError: the camera of a sensor that gives single stars is incomplete.
    """

    def feed(source: str, topic: str, type_name: str, read: Callable[..., ReadMessage[Any]], **options: Any) -> Feed:
        given = InputTopic(topic, type_name, False, depth=1000, is_configured=True)
        return Feed(given, source, read, core.add_measurement, has_decision=True, **options)

    for id_, star in config.star_sensors.items():
        topic, type_name = f"star/{id_}/{star.input}", _STAR_TYPES[star.input]
        read, read_rows = _star_readers(id_, star, sky_model)
        yield feed(f"star.{id_}", topic, type_name, read, read_rows=read_rows, stream_quantity=INNOVATION)
    for name, reference in config.references.items():
        topic, read = f"reference/{name}/imu", functools.partial(reference_measurement, name=name, config=reference)
        yield feed(f"reference.{name}", topic, "sensor_msgs/msg/Imu", read, stream_quantity=INNOVATION)
    if config.ship_baseline.is_aboard:
        read = functools.partial(baseline, config=config.ship_baseline)
        yield feed(BASELINE, "ship/baseline", "ship_msgs/msg/RtkBaseline", read)


def _star_readers(
    id_: str, star: StarSensorConfig, sky_model: SkyModel | None
) -> tuple[Callable[..., ReadMessage[Any]], Callable[..., ReadRows] | None]:
    """Return the readers of a star sensor's messages: of single messages, and of blocks (None for some inputs)."""
    if star.input == "observations":
        assert sky_model is not None
        camera = star.camera.camera(f"star_sensors.{id_}.camera")
        sensor = ExposingSensor(id_, star.frame_id, camera, star.camera, star.sensor_masks)
        return functools.partial(star_exposure, sensor=sensor, catalogue=sky_model.catalogue), None
    if star.input == "inertial_attitude":
        return functools.partial(inertial_attitude, sensor_id=id_, config=star), None
    read = functools.partial(star_measurement, sensor_id=id_, config=star)
    return read, functools.partial(star_attitudes, sensor_id=id_, config=star)


def star_measurement(
    message: Any, sensor_id: str, config: StarSensorConfig, receive_ns: int
) -> ReadMessage[AttitudeMeasurement]:
    """Read ``star/<sensor>/horizon_attitude`` or ``.../solution``: attitude of the sensor relative to the horizon.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.frame_id)
    if message.status == STAR_INVALID:
        raise MessageRejected(Reason.TOO_FEW_STARS, "the sensor reports status INVALID")
    check_finite("azimuth, elevation, roll", message.azimuth, message.elevation, message.roll)
    azimuth, elevation, roll = message.azimuth, message.elevation, message.roll
    # Angles in degrees are detected if they exceed the range in radians.
    if abs(elevation) > MAX_ELEVATION or max(abs(azimuth), abs(roll)) > MAX_ANGLE:
        angles = f"azimuth {azimuth:.6g}, elevation {elevation:.6g}, roll {roll:.6g}"
        raise MessageRejected(Reason.UNITS, f"{angles} cannot be radians: degrees?")
    total_enu = angular_covariance(message.rotation_covariance, "rotation_covariance")
    total_angles = angular_covariance(message.covariance, "covariance") if total_enu is None else None
    total_known = total_enu is not None or total_angles is not None
    noise_enu = angular_covariance(message.noise_covariance, "noise_covariance") if total_known else None
    rotation_ns = rotation_from_angles(azimuth, elevation, roll)
    if total_enu is not None:
        total_n = horizon_covariance(total_enu)
    elif total_angles is not None:
        total_n = rotation_vector_covariance(total_angles, azimuth, elevation)
    else:
        noise_s = np.diag(config.noise_sigma_s**2)
        attitude = AttitudeMeasurement(f"star.{sensor_id}", time_ns, rotation_ns, noise_s, covariance_known=False)
        return ReadMessage(_with_shared_error(attitude, config.shared_error, has_noise_covariance=True), False)
    noise_n = total_n if noise_enu is None else horizon_covariance(noise_enu)
    source, has_noise = f"star.{sensor_id}", noise_enu is not None
    return attitude_from_numbers(source, time_ns, rotation_ns, total_n, noise_n, config.shared_error, has_noise)


def attitude_from_numbers(
    source: str,
    time_ns: int,
    rotation_ns: FloatArray,
    total_n: FloatArray,
    noise_n: FloatArray,
    sharing: str,
    has_noise_covariance: bool = True,
) -> ReadMessage[AttitudeMeasurement]:
    """Return the attitude of a star sensor from the numbers of its message.

    Args:
        source: name of the source.
        time_ns: stamp of the message.
        rotation_ns: rotation horizon from sensor, shape (3, 3).
        total_n: covariance of the total error, rotation vector in the horizon frame, rad², shape (3, 3).
        noise_n: covariance of the error that is independent between epochs, in the same frame.
        sharing: configured shared error of the sensor.
        has_noise_covariance: True if the message contains a separate noise covariance.

    Raises:
        MessageRejected: the noise covariance is larger than the total covariance.
    """
    noise_s = rotation_ns.T @ noise_n @ rotation_ns
    attitude = AttitudeMeasurement(source, time_ns, rotation_ns, noise_s, _common_covariance(total_n, noise_n))
    return ReadMessage(_with_shared_error(attitude, sharing, has_noise_covariance), True)


def _with_shared_error(attitude: AttitudeMeasurement, sharing: str, has_noise_covariance: bool) -> AttitudeMeasurement:
    """Return the attitude in the form for its kind of shared error."""
    if sharing == SHARED_BY_SKY:
        return SolvedAttitude(**vars(attitude) | {"has_noise_covariance": has_noise_covariance})
    if sharing == SHARED_BY_MESSAGES and attitude.common_n.any():
        # The filter has one error vector of unit covariance for all messages (``sky.common``). The symmetric root of
        # each common covariance scales it, so that simultaneous errors are fully correlated.
        values, vectors = np.linalg.eigh(attitude.common_n)
        root_n = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return replace(attitude, common_n=np.zeros((3, 3)), shared_n=root_n, shared_by=SHARED_BY_MESSAGES)
    return attitude


def inertial_attitude(
    message: Any, sensor_id: str, config: StarSensorConfig, receive_ns: int
) -> ReadMessage[InertialAttitude]:
    """Read ``star/<sensor>/inertial_attitude``: attitude of the sensor relative to the ICRS.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_device_id("sensor_id", message.sensor_id, sensor_id)
    check_frame(message.header.frame_id, config.frame_id)
    rotation_cs = celestial_rotation_from_quaternion(unit_quaternion(message.orientation, "orientation"))
    covariance_flu = angular_covariance(message.covariance, "covariance")
    if covariance_flu is None:
        noise_s = np.diag(config.noise_sigma_s**2)
    else:
        noise_s = FLU_FROM_DEVICE.T @ covariance_flu @ FLU_FROM_DEVICE
    source, known, field = f"star.{sensor_id}", covariance_flu is not None, config.inertial.field_of_view
    return ReadMessage(InertialAttitude(source, time_ns, rotation_cs, noise_s, known, field), known)


def reference_measurement(
    message: Any, name: str, config: ReferenceConfig, receive_ns: int
) -> ReadMessage[AttitudeMeasurement]:
    """Read ``reference/<name>/imu``: attitude of another system; the covariance in the message describes white noise.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.frame_id)
    rotation_nr = imu_rotation(message, config.convention, config.accept_unset_covariance)
    covariance_enu = angular_covariance(message.orientation_covariance, "orientation_covariance")
    if covariance_enu is None:
        noise_r = np.diag(config.noise_sigma_r**2)
    else:
        noise_r = rotation_nr.T @ horizon_covariance(covariance_enu) @ rotation_nr
    source, known = f"reference.{name}", covariance_enu is not None
    return ReadMessage(AttitudeMeasurement(source, time_ns, rotation_nr, noise_r, covariance_known=known), known)


def deflection(message: Any, receive_ns: int) -> ReadMessage[DeflectionReading]:
    """Read ``gravity/deflection``: deflection of the vertical at the ship.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_finite("xi, eta", message.xi, message.eta)
    largest = max(abs(message.xi), abs(message.eta))
    if not largest <= _MAX_DEFLECTION:
        text = f"xi {message.xi:.4g}, eta {message.eta:.4g}: expected radians, 0.0015 (300 arcsec) at most"
        raise MessageRejected(Reason.UNITS, text)
    covariance = np.asarray(message.covariance, dtype=float).reshape(2, 2)
    if not covariance.any():
        return ReadMessage(DeflectionReading(time_ns, np.array([message.xi, message.eta])), False)
    # NaN fails these comparisons.
    is_symmetric = bool(np.all(np.abs(covariance - covariance.T) <= 1e-6 * np.abs(np.trace(covariance))))
    if not (is_symmetric and np.linalg.eigvalsh(covariance)[0] > 0.0):
        text = "covariance of (xi, eta): expected a symmetric, positive definite, finite matrix"
        raise MessageRejected(Reason.BAD_COVARIANCE, text)
    return ReadMessage(DeflectionReading(time_ns, np.array([message.xi, message.eta]), covariance), True)


def baseline(message: Any, receive_ns: int, config: ShipBaselineConfig) -> ReadMessage[BaselineMeasurement]:
    """Read ``ship/baseline``: vector between two antennas aboard.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = baseline_stamp_ns(message, config, receive_ns)
    rejection = fix_rejection(message, config.least_fix)
    if rejection is not None:
        raise MessageRejected(rejection.reason, rejection.text)
    vector_n, noise_n = baseline_vector(message)
    known = noise_n is not None
    if noise_n is None:
        noise_n = config.noise_sigma_m**2 * np.eye(3)
    if not np.linalg.norm(vector_n) > 0.0:
        raise MessageRejected(Reason.UNITS, "baseline of length 0: expected metres between two antennas")
    return ReadMessage(BaselineMeasurement(time_ns, vector_n, noise_n, known), known)


def _common_covariance(total_n: FloatArray, noise_n: FloatArray) -> FloatArray:
    """Return the covariance of the error common to successive solutions.

    This is total minus noise, with eigenvalues that are negative or within rounding set to 0.

    Raises:
        MessageRejected: the noise covariance is larger than the total covariance.
    """
    difference_n = total_n - noise_n
    if not difference_n.any():
        return np.zeros((3, 3))
    values, vectors = np.linalg.eigh(difference_n)
    limit = _COVARIANCE_TOLERANCE * float(np.trace(total_n))
    if values[0] < -limit:
        raise MessageRejected(Reason.BAD_COVARIANCE, "noise_covariance is larger than the total covariance")
    kept = np.where(values > limit, values, 0.0)
    common: FloatArray = (vectors * kept) @ vectors.T
    return common


def star_attitudes(messages: CdrRows, receive_ns: StampArray, sensor_id: str, config: StarSensorConfig) -> ReadRows:
    """Read a block of messages with both covariances of the rotation vector; see :func:`star_measurement`."""
    numbers = messages.numbers
    times_ns, timely = stamps(numbers, receive_ns)
    angles = np.stack([numbers["azimuth"], numbers["elevation"], numbers["roll"]], axis=1)
    totals_enu, total_known = angular_covariances(numbers["rotation_covariance"])
    noises_enu, noise_known = angular_covariances(numbers["noise_covariance"])
    good = timely & total_known & noise_known & (numbers["status"] != STAR_INVALID)
    good &= (np.abs(angles) <= [MAX_ANGLE, MAX_ELEVATION, MAX_ANGLE]).all(axis=1)

    def attitude(
        time_ns: int, rotation_ns: FloatArray, total_n: FloatArray, noise_n: FloatArray
    ) -> ReadMessage[Any] | None:
        source, sharing = f"star.{sensor_id}", config.shared_error
        try:
            return attitude_from_numbers(source, time_ns, rotation_ns, total_n, noise_n, sharing)
        except MessageRejected:
            return None

    def attitudes() -> Iterator[ReadMessage[Any] | None]:
        rotations_ns = compiled_rotations.rotations(angles[good])
        covariances_n = horizon_covariance(totals_enu[good]), horizon_covariance(noises_enu[good])
        return map(attitude, times_ns[good].tolist(), rotations_ns, *covariances_n)

    return read_valid(messages, config.frame_id, good, attitudes)

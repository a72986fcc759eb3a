"""Conversion of input messages to the cores' structs, with checks: one message, or all regular ones of a batch.

A reader of one message (:func:`encoder`) accepts any class with the fields of the message. A reader of a batch
(:func:`encoders`) gives results that equal those of the reader of one message to the last bit. A result None stands for
a message that must be read singly. :func:`direction` is for the node ``triangulation`` and for bags.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_estimation.parameters.fields import FRAME_NAMES
from ship_estimation.rejection_rules import Reason, Rejection, shorten
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.frames import (
    ENU_FROM_HORIZON,
    angles_from_rotation,
    device_vector_from_ros,
    horizon_covariance,
    rotation_from_quaternion,
    rotation_vector_covariance,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S
from ship_node.messages.field_checks import (
    MAX_VARIANCE,
    MessageRejected,
    ReadMessage,
    ReadRows,
    angular_covariance,
    angular_covariances,
    check_device_id,
    check_finite,
    check_frame,
    covariance_3x3,
    exposure_length_s,
    finite_vector,
    imu_quaternions,
    imu_rotation,
    optional_sigma,
    quoted_id,
    read_valid,
    ship_rate,
    ship_rates,
    stamp_ns,
    stamps,
    unit_quaternion,
    unit_quaternions,
)
from ship_node.messages.sensor_readers import baseline_stamp_ns, baseline_vector, fix_rejection, ins_sample
from theodolite_calib.config import BeaconConfig, OpticalAxisConfig
from theodolite_calib.samples.samples import (
    BaselineSample,
    DetectedBeacon,
    EncoderSample,
    Exposure,
    ShipSample,
    TargetSample,
)
from theodolite_calib.triangulation.triangulation_core import DirectionSample

MAX_BEACONS = 100
"""Maximum number of beacons of one image; further beacons are ignored, so that no message can delay the node."""

ENCODER_INVALID = 1
_LARGEST_DETECTOR_M = 0.5
"""Largest coordinate on a detector, m; larger values are millimetres or pixels."""
LONGEST_TARGET_ID = 100
"""Maximum number of characters of a target's name; longer names are cut."""
_LONGEST_RANGE_M = 1e6
"""Largest range of a target, m. Targets outside the air, such as satellites, must have no range."""
_NORM_TOLERANCE = 1e-3
_LEAST_SHARE = 1e-9
"""Ratio of the smaller to the larger variance across a direction up to which the covariance counts as singular."""


def encoder(message: Any, config: OpticalAxisConfig, receive_ns: int) -> ReadMessage[EncoderSample]:
    """Read ``theodolite/encoder``: both angles; their range is checked by the core.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.encoder.frame_id)
    if message.status == ENCODER_INVALID:
        raise MessageRejected(Reason.GAP, "the encoder itself reports a fault")
    check_finite("azimuth, elevation", message.azimuth, message.elevation)
    sigma = optional_sigma(message.sigma, 2.0 * np.pi)
    angles = np.array([message.azimuth, message.elevation])
    known = sigma is not None
    return ReadMessage(EncoderSample(time_ns, angles, sigma or config.encoder.sigma_arcsec * ARCSEC), known)


def ship_attitude(message: Any, config: OpticalAxisConfig, receive_ns: int) -> ReadMessage[ShipSample]:
    """Read ``ship/attitude``: attitude with the covariance of its correlated error.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.ship.frame_id)
    if message.status == Status.INVALID:
        raise MessageRejected(Reason.GAP, "the source reports INVALID")
    if message.status not in list(Status):
        raise MessageRejected(Reason.UNITS, f"status {message.status} is unknown: expected VALID, COASTING or DEGRADED")
    rotation_nd = rotation_from_quaternion(unit_quaternion(message.orientation))
    rotation_enu = angular_covariance(message.rotation_covariance, "rotation_covariance")
    total_n = _covariance_of_angles(message, rotation_nd) if rotation_enu is None else horizon_covariance(rotation_enu)
    rate = message.angular_velocity
    # Rates of NaN state that the source has no rate.
    rate_known = not (math.isnan(rate.x) and math.isnan(rate.y) and math.isnan(rate.z))
    rate_d = device_vector_from_ros(ship_rate(rate)) if rate_known else None
    if total_n is None:
        tilt, heading = config.ins.tilt_sigma_arcsec * ARCSEC, config.ins.heading_sigma_arcsec * ARCSEC
        slow_n = np.diag([tilt**2, heading**2, tilt**2])
    else:
        (slow_n,) = without_white(total_n[None], config.ship.white_sigma_arcsec)
    status = Status(message.status)
    sample = ShipSample(time_ns, rotation_nd, rate_d, slow_n, status)
    return ReadMessage(sample, total_n is not None, is_degraded=status is Status.DEGRADED)


def ins_attitude(message: Any, config: OpticalAxisConfig, receive_ns: int) -> ReadMessage[ShipSample]:
    """Read ``ins/imu``: attitude and rate, with errors from the configuration.

    Raises:
        MessageRejected: the message cannot be used.
    """
    reading = ins_sample(message, config.ins, receive_ns)
    sample = reading.value
    return ReadMessage(ShipSample(sample.time_ns, sample.rotation_nd, sample.rate_d), reading.covariance_known)


def baseline(message: Any, beacon: BeaconConfig, least_fix: str, receive_ns: int) -> ReadMessage[BaselineSample]:
    """Read ``beacon/<id>/baseline``: vector and covariance of its white error, or only a rejection below ``least_fix``.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = baseline_stamp_ns(message, beacon.rtk, receive_ns)
    rejection = fix_rejection(message, least_fix)
    if rejection is not None:
        return ReadMessage(BaselineSample(time_ns, np.zeros(3), np.zeros((3, 3)), rejection))
    vector_n, covariance_n = baseline_vector(message)
    if covariance_n is None:
        return ReadMessage(BaselineSample(time_ns, vector_n, beacon.rtk.sigma_m**2 * np.eye(3)), False)
    return ReadMessage(BaselineSample(time_ns, vector_n, covariance_n))


def drone_attitude(message: Any, beacon: BeaconConfig, receive_ns: int) -> ReadMessage[AttitudeSample]:
    """Read ``beacon/<id>/imu``: attitude of the drone, with errors from the configuration.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, beacon.imu.frame_id)
    rotation_nb = imu_rotation(message, beacon.imu.convention, beacon.imu.accept_unset_covariance)
    return ReadMessage(AttitudeSample(time_ns, rotation_nb))


def exposure(message: Any, config: OpticalAxisConfig, receive_ns: int) -> ReadMessage[Exposure]:
    """Read ``theodolite/beacons``: beacons on the detector; an unreadable beacon is rejected by name.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.telescope.frame_id)
    check_device_id("telescope_id", message.telescope_id, config.telescope.telescope_id)
    exposure_s = exposure_length_s(message.exposure_s, LONGEST_EXPOSURE_S)
    sightings = message.beacons[:MAX_BEACONS]
    names = [sighting.beacon_id for sighting in sightings]
    lights: dict[str, DetectedBeacon] = {}
    rejected: list[tuple[str, Rejection]] = []
    known = True
    for sighting in sightings:
        light = _beacon_or_refusal(sighting, names, config)
        if isinstance(light, Rejection):
            rejected.append((sighting.beacon_id, light))
        else:
            lights[sighting.beacon_id], sigma_known = light
            known &= sigma_known
    if len(message.beacons) > MAX_BEACONS:
        text = f"{len(message.beacons)} lights in one image: only the first {MAX_BEACONS} are used"
        rejected.append((message.beacons[MAX_BEACONS].beacon_id, Rejection(Reason.OVERFLOW, text)))
    ordered = tuple(lights[name] for name in sorted(lights))
    return ReadMessage(Exposure(time_ns, ordered, exposure_s), known, tuple(rejected), is_empty=not lights)


def target(message: Any, config: OpticalAxisConfig, receive_ns: int) -> ReadMessage[TargetSample]:
    """Read ``theodolite/target``: image of a target on the main detector.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns, detector = stamp_ns(message.header, receive_ns), config.main_detector
    if detector.focal_length_m == 0.0:
        text = f"main detector {quoted_id(message.header.frame_id)} is unknown: main_detector.focal_length_m is not set"
        raise MessageRejected(Reason.UNKNOWN_SENSOR, text)
    check_frame(message.header.frame_id, detector.frame_id)
    exposure_s = exposure_length_s(message.exposure_s, LONGEST_EXPOSURE_S)
    check_finite("x, z, detector_rotation", message.x, message.z, message.detector_rotation)
    point_m = _detector_point_m(message)
    if abs(message.detector_rotation) > 2.0 * np.pi:
        raise MessageRejected(Reason.UNITS, f"detector_rotation {message.detector_rotation:.6g}: expected radians")
    sigma = optional_sigma(message.sigma, _LARGEST_DETECTOR_M)
    sample = TargetSample(
        time_ns=time_ns,
        target_id=shorten(message.target_id, LONGEST_TARGET_ID),
        point_m=point_m,
        sigma_m=sigma or detector.sigma_m,
        exposure_s=exposure_s,
        detector_rotation=float(message.detector_rotation),
        range_m=_length(message.range, "range"),
        range_sigma_m=_length(message.range_sigma, "range_sigma"),
    )
    return ReadMessage(sample, sigma is not None)


def _length(value: float, what: str) -> float:
    """Return a length above zero, m; NaN, which means not given, stays NaN."""
    if math.isnan(value):
        return math.nan
    check_finite(what, value)
    if not 0.0 < value <= _LONGEST_RANGE_M:
        raise MessageRejected(
            Reason.UNITS, f"{what} is {value:.6g}: expected metres above 0, {_LONGEST_RANGE_M:g} at most"
        )
    return float(value)


def _beacon_or_refusal(
    sighting: Any, names: list[str], config: OpticalAxisConfig
) -> tuple[DetectedBeacon, bool] | Rejection:
    try:
        return _detected_beacon(sighting, names, config)
    except MessageRejected as error:
        return error.rejection


def _detected_beacon(sighting: Any, names: list[str], config: OpticalAxisConfig) -> tuple[DetectedBeacon, bool]:
    """Return a beacon, and True if the message states its sigma."""
    name = sighting.beacon_id
    if name not in config.beacons:
        expected = ", ".join(sorted(config.beacons)) or "none: beacons.<id> is empty"
        raise MessageRejected(Reason.UNKNOWN_SENSOR, f"beacon_id {quoted_id(name)} is unknown: expected {expected}")
    if names.count(name) > 1:
        raise MessageRejected(Reason.CONFLICT, f"{quoted_id(name)} is in one image {names.count(name)} times")
    check_finite("x, z", sighting.x, sighting.z)
    point_m, sigma = _detector_point_m(sighting), optional_sigma(sighting.sigma, _LARGEST_DETECTOR_M)
    return DetectedBeacon(name, point_m, sigma or config.telescope.sigma_m), sigma is not None


def _detector_point_m(message: Any) -> FloatArray:
    """Return the point of a beacon or target on the detector (x, z), m, shape (2,)."""
    if max(abs(message.x), abs(message.z)) > _LARGEST_DETECTOR_M:
        raise MessageRejected(Reason.UNITS, f"x {message.x:.6g}, z {message.z:.6g}: expected metres on the detector")
    return np.array([message.x, message.z])


def _covariance_of_angles(message: Any, rotation_nd: FloatArray) -> FloatArray | None:
    """Return the covariance of the angles as that of the rotation vector in n, rad²; None if it is not given."""
    angles = covariance_3x3(message.covariance)
    if angles is None:
        return None
    heading, pitch, _ = angles_from_rotation(rotation_nd)
    total_n = rotation_vector_covariance(angles, heading, pitch)
    largest = float(np.max(np.diagonal(total_n)))
    if not largest <= MAX_VARIANCE:
        raise MessageRejected(
            Reason.BAD_COVARIANCE, f"covariance: a variance of {largest:.3g} rad² is a sigma of more than a full turn"
        )
    return total_n


def without_white(total_n: FloatArray, white_sigma_arcsec: float) -> FloatArray:
    """Return covariances minus the white noise of each sample, with negative variances set to zero, (N, 3, 3)."""
    values, vectors = np.linalg.eigh(total_n)
    left = np.maximum(values - (white_sigma_arcsec * ARCSEC) ** 2, 0.0)
    slow_n: FloatArray = (vectors * left[:, None, :]) @ vectors.swapaxes(1, 2)
    return slow_n


def encoders(messages: CdrRows, receive_ns: StampArray, config: OpticalAxisConfig) -> ReadRows:
    """Read ``theodolite/encoder``; see :func:`encoder`."""
    numbers = messages.numbers
    times_ns, good = stamps(numbers, receive_ns)
    angles = np.stack([numbers["azimuth"], numbers["elevation"]], axis=1)
    sigma = numbers["sigma"].astype(np.float64)
    unknown = np.isnan(sigma) | (sigma == 0.0)
    good &= (numbers["status"] != ENCODER_INVALID) & np.isfinite(angles).all(axis=1)
    good &= unknown | ((sigma > 0.0) & (sigma <= 2.0 * np.pi))
    sigma[unknown] = config.encoder.sigma_arcsec * ARCSEC

    def samples() -> Iterator[ReadMessage[Any]]:
        read = map(EncoderSample, times_ns[good].tolist(), angles[good], sigma[good].tolist())
        return map(ReadMessage, read, (~unknown[good]).tolist())

    return read_valid(messages, config.encoder.frame_id, good, samples)


def ship_attitudes(messages: CdrRows, receive_ns: StampArray, config: OpticalAxisConfig) -> ReadRows:
    """Read ``ship/attitude`` with rates and covariances; see :func:`ship_attitude`."""
    numbers = messages.numbers
    times_ns, timely = stamps(numbers, receive_ns)
    quaternions, of_norm_1 = unit_quaternions(numbers)
    rates_ros, of_ship = ship_rates(numbers)
    covariances_enu, positive = angular_covariances(numbers["rotation_covariance"])
    good = timely & of_norm_1 & of_ship & positive & (numbers["status"] < int(Status.INVALID))

    def samples() -> Iterator[ReadMessage[Any]]:
        rotations_nd = rotation_from_quaternion(quaternions[good])
        rates_d = device_vector_from_ros(rates_ros[good])
        slow_n = without_white(horizon_covariance(covariances_enu[good]), config.ship.white_sigma_arcsec)
        status = map(Status, numbers["status"][good].tolist())
        read = map(ShipSample, times_ns[good].tolist(), rotations_nd, rates_d, slow_n, status)
        return (ReadMessage(sample, is_degraded=sample.status is Status.DEGRADED) for sample in read)

    return read_valid(messages, config.ship.frame_id, good, samples)


def drone_attitudes(messages: CdrRows, receive_ns: StampArray, beacon: BeaconConfig) -> ReadRows:
    """Read ``beacon/<id>/imu``; see :func:`drone_attitude`."""
    times_ns, timely = stamps(messages.numbers, receive_ns)
    quaternions, given = imu_quaternions(messages.numbers, beacon.imu.accept_unset_covariance)
    good = timely & given

    def samples() -> Iterator[ReadMessage[Any]]:
        rotations_nb = rotation_from_quaternion(quaternions[good], beacon.imu.convention)
        return map(ReadMessage, map(AttitudeSample, times_ns[good].tolist(), rotations_nb))

    return read_valid(messages, beacon.imu.frame_id, good, samples)


def direction(
    message: Any, station: str, receive_ns: int, horizon: str = FRAME_NAMES.horizon
) -> ReadMessage[DirectionSample]:
    """Read a direction, or an INVALID report of the theodolite.

    Args:
        message: TargetDirection.
        station: name of the theodolite.
        receive_ns: arrival time of the message.
        horizon: required frame_id.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    # A position from several theodolites is rejected here, because its frame is not the horizon.
    check_frame(message.header.frame_id, horizon)
    if message.status not in list(Status):
        expected = ", ".join(status.name for status in Status)
        raise MessageRejected(Reason.UNITS, f"status {message.status} is unknown: expected one of {expected}")
    status, vector, covariance_n = Status(message.status), np.full(3, np.nan), np.full((3, 3), np.nan)
    if status is not Status.INVALID:
        direction_enu = finite_vector(message.direction, "direction")
        norm = math.hypot(*direction_enu.tolist())
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise MessageRejected(Reason.UNITS, f"norm of direction is {norm:.6g}: expected 1")
        covariance_enu = angular_covariance(message.direction_covariance, "direction_covariance")
        if covariance_enu is None:
            raise MessageRejected(Reason.BAD_COVARIANCE, "direction_covariance is not given: required for the position")
        vector, covariance_n = ENU_FROM_HORIZON.T @ direction_enu / norm, horizon_covariance(covariance_enu)
        across = np.linalg.svd(vector[None])[2][1:]
        least, greatest = np.linalg.eigvalsh(across @ covariance_n @ across.T).tolist()
        if not least > _LEAST_SHARE * greatest:
            raise MessageRejected(Reason.BAD_COVARIANCE, "direction_covariance is singular across the direction")
    return ReadMessage(
        DirectionSample(
            time_ns=time_ns,
            vector=vector,
            source=f"station.{station}",
            target_id=shorten(message.target_id, LONGEST_TARGET_ID),
            covariance_n=covariance_n,
            status=status,
        )
    )

"""Messages of attitudes: ship_msgs/ShipAttitude, ship_msgs/AttitudeDeg in degrees, sensor_msgs/Imu, /tf, slow topics.

One function (``_messages``) fills the fields: with numbers for the single attitude of a live node, with columns of
numbers for the attitudes of a block, which are serialised together.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.alignment import Alignment
from ship_attitude_star.ship_attitude.config import StarSensorConfig
from ship_bags.message_factory import MessageFactory
from ship_estimation.integrity.protection_levels import NORMAL_95
from ship_estimation.parameters.fields import FRAME_NAMES, FrameNames
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.frames import (
    ENU_FROM_HORIZON,
    FLU_FROM_DEVICE,
    SINGULAR_ELEVATION,
    angle_covariance,
    angles_from_rotation,
    enu_covariance,
    flu_from_device_vector,
    mounting_quaternion,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels.compiled_rotations import angle_covariances, angles, quaternions
from ship_node.messages.common_messages import (
    TF_TOPIC,
    TF_TYPE,
    ZERO_VECTOR,
    Fields,
    MessageFields,
    error_budget_message,
    join_fields,
    rows_by_kind,
    select_values,
)
from ship_node.messages.field_checks import NOT_GIVEN
from ship_node.messages.inputs_outputs import OutputMessage, OutputRows
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeSeries, DeflectionReading

ATTITUDE_TOPIC, ATTITUDE_TYPE = "ship/attitude", "ship_msgs/msg/ShipAttitude"
IMU_TOPIC, IMU_TYPE = "ship/imu", "sensor_msgs/msg/Imu"
SMOOTHED_TOPIC = "ship/attitude_smoothed"
DEFLECTION_TOPIC, DEFLECTION_TYPE = "ship/deflection", "ship_msgs/msg/Deflection"
DEGREES_TOPIC, DEGREES_TYPE = "ship/attitude_deg", "ship_msgs/msg/AttitudeDeg"

_NOT_GIVEN = (NOT_GIVEN, *(0.0,) * 8)
"""Covariance in sensor_msgs/Imu for a quantity that is not measured."""


class AttitudeNumbers(NamedTuple):
    """Published quantities of N attitudes; see :class:`AttitudeSeries`."""

    time_ns: StampArray
    rotation_nd: FloatArray
    covariance_n: FloatArray
    rate_d: FloatArray
    status: list[Status]
    horizon: NDArray[np.int64]
    sources: list[tuple[str, ...]]
    star_age_s: FloatArray

    @classmethod
    def from_runs(cls, series: Sequence[AttitudeSeries]) -> "AttitudeNumbers":
        """Return the quantities of several series, one after another."""
        return cls(*join_fields(series, cls._fields))

    @classmethod
    def from_estimate(cls, estimate: AttitudeEstimate) -> "AttitudeNumbers":
        """Return the quantities of one attitude."""
        return cls(
            time_ns=np.array([estimate.time_ns]),
            rotation_nd=estimate.rotation_nd[None],
            covariance_n=estimate.covariance_n[None],
            rate_d=estimate.rate_d[None],
            status=[estimate.status],
            horizon=np.array([estimate.horizon]),
            sources=[estimate.sources],
            star_age_s=np.array([estimate.star_age_s]),
        )

    def subset(self, indices: NDArray[np.int64]) -> "AttitudeNumbers":
        """Return the attitudes with the given indices."""
        if len(indices) == len(self.time_ns):
            return self
        return AttitudeNumbers(*(select_values(each, indices) for each in self))


def attitude_messages(
    factory: MessageFactory,
    estimate: AttitudeEstimate,
    rate_sigma: float,
    frames: FrameNames = FRAME_NAMES,
    publish_tf: bool = True,
) -> list[OutputMessage]:
    """Return the messages of one attitude.

    For an INVALID attitude the two ship_msgs messages contain NaN, and the messages for standard tools are omitted.

    Args:
        factory: creates messages.
        estimate: the attitude.
        rate_sigma: noise of the angular rate of the INS, each axis, rad/s; 0 if not known.
        frames: frame names.
        publish_tf: False to omit the message on /tf.
    """
    messages = _messages(
        AttitudeNumbers.from_estimate(estimate), rate_sigma, frames, is_single=True, publish_tf=publish_tf
    )
    return [(topic, factory.encode(type_name, **fields)) for topic, type_name, fields in messages]


def smoothed_message(factory: MessageFactory, estimate: AttitudeEstimate, frames: FrameNames) -> OutputMessage:
    """Return the ship_msgs/ShipAttitude message of a smoothed attitude."""
    attitude = AttitudeNumbers.from_estimate(estimate)
    (_, type_name, fields), *_ = _messages(attitude, 0.0, frames, is_single=True, publish_tf=False)
    return SMOOTHED_TOPIC, factory.encode(type_name, **fields)


def attitude_rows(
    factory: MessageFactory,
    attitudes: AttitudeNumbers,
    rate_sigma: float,
    frames: FrameNames = FRAME_NAMES,
    publish_tf: bool = True,
) -> Iterator[OutputRows]:
    """Yield the messages of N attitudes, for each attitude in the order of :func:`attitude_messages`."""
    known: list[bool] = np.all(np.isfinite(attitudes.rate_d), axis=1).tolist()
    claimed = [status is not Status.INVALID for status in attitudes.status]
    kinds = zip(claimed, known, attitudes.sources, strict=True)

    def messages_of(_: Any, places: NDArray[np.int64]) -> MessageFields:
        return _messages(attitudes.subset(places), rate_sigma, frames, is_single=False, publish_tf=publish_tf)

    return rows_by_kind(factory, kinds, messages_of)


def _messages(
    attitudes: AttitudeNumbers, rate_sigma: float, frames: FrameNames, *, is_single: bool, publish_tf: bool
) -> MessageFields:
    """Return topic, type and fields of each message, for attitudes of equal validity and sources.

    The attitudes either all have a rate or all have none. The fields are the numbers of the only attitude if
    ``is_single``, otherwise columns with one value for each attitude.
    """
    of_angles = angles(attitudes.rotation_nd)
    covariances = angle_covariances(attitudes.covariance_n, of_angles, SINGULAR_ELEVATION)
    arrays = (
        attitudes.time_ns,
        np.array(attitudes.status),
        attitudes.horizon,
        attitudes.star_age_s,
        of_angles,
        np.rad2deg(of_angles),
        quaternions(ENU_FROM_HORIZON @ attitudes.rotation_nd @ FLU_FROM_DEVICE.T),
        flu_from_device_vector(attitudes.rate_d),
        covariances.reshape(-1, 9),
        enu_covariance(attitudes.covariance_n).reshape(-1, 9),
        NORMAL_95 / ARCSEC * np.sqrt(covariances.diagonal(axis1=1, axis2=2)),
    )
    values: list[Any] = [each[0].tolist() if is_single else each.T for each in arrays]
    time_ns, status, horizon, star_age_s, (heading, pitch, roll), degrees = values[:6]
    quaternion, rates, covariance, rotation_covariance, arcsec_95 = values[6:]
    header = {"stamp": time_ns, "frame_id": frames.deck}
    orientation, rate = dict(zip("xyzw", quaternion, strict=True)), dict(zip("xyz", rates, strict=True))
    attitude = {
        "header": header,
        "heading": heading,
        "pitch": pitch,
        "roll": roll,
        "covariance": covariance,
        "orientation": orientation,
        "rotation_covariance": rotation_covariance,
        "angular_velocity": rate,
        "status": status,
        "horizon": horizon,
        "sources": attitudes.sources[0],
        "star_age_s": star_age_s,
    }
    in_degrees = {
        "header": header,
        **dict(zip(("heading_deg", "pitch_deg", "roll_deg"), degrees, strict=True)),
        **dict(zip(("heading_95_arcsec", "pitch_95_arcsec", "roll_95_arcsec"), arcsec_95, strict=True)),
        "status": status,
    }
    is_claimed = attitudes.status[0] is not Status.INVALID
    messages: MessageFields = [(ATTITUDE_TOPIC, ATTITUDE_TYPE, attitude)]
    if is_claimed:
        given_rate = rate if np.isfinite(attitudes.rate_d[0]).all() else None
        imu = _as_imu(header, orientation, rotation_covariance, given_rate, rate_sigma)
        messages.append((IMU_TOPIC, IMU_TYPE, imu))
    messages.append((DEGREES_TOPIC, DEGREES_TYPE, in_degrees))
    if is_claimed and publish_tf:
        deck = {
            "header": {"stamp": time_ns, "frame_id": frames.horizon},
            "child_frame_id": frames.deck,
            "transform": {"translation": ZERO_VECTOR, "rotation": orientation},
        }
        messages.append((TF_TOPIC, TF_TYPE, {"transforms": [deck]}))
    return messages


def _as_imu(
    header: Fields, orientation: Fields, rotation_covariance: Any, rate: Fields | None, rate_sigma: float
) -> Fields:
    """Return sensor_msgs/Imu without acceleration, with the rate if it is known.

    The covariance of the rate is equal for all axes; zeros, for a ``rate_sigma`` of 0, mean unknown.
    """
    variance = rate_sigma**2
    rate_covariance = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance)
    return {
        "header": header,
        "orientation": orientation,
        "orientation_covariance": rotation_covariance,
        "angular_velocity": ZERO_VECTOR if rate is None else rate,
        "angular_velocity_covariance": _NOT_GIVEN if rate is None else rate_covariance,
        "linear_acceleration": ZERO_VECTOR,
        "linear_acceleration_covariance": _NOT_GIVEN,
    }


def attitude_budget(factory: MessageFactory, estimate: AttitudeEstimate, sources: Sequence[str], deck: str) -> Any:
    """Return ship_msgs/ErrorBudget of a published attitude; ``sources`` are the names of its error sources."""
    parts_n, covariance_n = estimate.covariance_by_source_n, estimate.covariance_n
    return error_budget_message(factory, "ship_attitude", estimate.time_ns, deck, sources, parts_n, covariance_n)


def deflection_message(factory: MessageFactory, known: DeflectionReading, horizon: str) -> Any:
    """Return ship_msgs/Deflection of the estimated deflection."""
    assert known.covariance is not None
    return factory.make(
        DEFLECTION_TYPE,
        header={"stamp": known.time_ns, "frame_id": horizon},
        xi=float(known.deflection[0]),
        eta=float(known.deflection[1]),
        covariance=known.covariance.ravel(),
    )


def error_arcsec(factory: MessageFactory, estimate: AttitudeEstimate, deck: str) -> Any:
    """Return ship_msgs/AttitudeErrorArcsec with predicted sigmas; errors are NaN, because the truth is not known."""
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    sigma = np.sqrt(np.diagonal(angle_covariance(estimate.covariance_n, heading, pitch))) / ARCSEC
    sigmas = zip(("sigma_heading", "sigma_pitch", "sigma_roll"), sigma.tolist(), strict=True)
    errors = dict.fromkeys(("error_heading", "error_pitch", "error_roll"), float("nan"))
    header = {"stamp": estimate.time_ns, "frame_id": deck}
    return factory.make("ship_msgs/msg/AttitudeErrorArcsec", header=header, **dict(sigmas), **errors)


def alignment_state(factory: MessageFactory, alignment: Alignment, now_ns: int, deck: str) -> Any:
    """Return ship_msgs/AlignmentState of an alignment."""
    return factory.encode(
        "ship_msgs/msg/AlignmentState",
        header={"stamp": now_ns, "frame_id": deck},
        names=list(alignment.names),
        values=alignment.values,
        covariance=alignment.covariance.ravel(),
        units=list(alignment.units),
    )


def star_frames(star_sensors: Mapping[str, StarSensorConfig], taken: Set[str]) -> dict[str, str]:
    """Return the frame of each star sensor by id: its frame_id if no other frame has this name, else star_<id>."""
    count = Counter(star.frame_id for star in star_sensors.values())
    frames = {}
    for id_, star in star_sensors.items():
        others = {*taken, *(f"star_{other}" for other in star_sensors if other != id_)}
        is_its_own = star.frame_id and count[star.frame_id] == 1 and star.frame_id not in others
        frames[id_] = star.frame_id if is_its_own else f"star_{id_}"
    return frames


def installed_frames(factory: MessageFactory, rotations_dv: Mapping[str, np.ndarray], now_ns: int, deck: str) -> Any:
    """Return tf2_msgs/TFMessage of devices on the deck, without translation.

    Args:
        factory: creates messages.
        rotations_dv: frame of a device → rotation deck from device, shape (3, 3).
        now_ns: stamp of the message.
        deck: name of the deck frame.
    """
    transforms = []
    for frame, rotation_dv in rotations_dv.items():
        rotation = dict(zip("xyzw", mounting_quaternion(rotation_dv).tolist(), strict=True))
        transforms.append(
            {
                "header": {"stamp": now_ns, "frame_id": deck},
                "child_frame_id": frame,
                "transform": {"translation": ZERO_VECTOR, "rotation": rotation},
            }
        )
    return factory.encode(TF_TYPE, transforms=transforms)

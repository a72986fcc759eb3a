"""Output messages: pointings, the main frame on /tf, slow topics of a pointing, directions of targets, advice.

One function fills the fields of pointings: with numbers for a single pointing in a live node, and with columns of
numbers for the pointings of a batch, whose messages are encoded together.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_bags.message_factory import MessageFactory
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
from ship_node.messages.inputs_outputs import OutputMessage, OutputRows
from theodolite_calib.samples.samples import PointingEstimate, TargetEstimate

if TYPE_CHECKING:
    from theodolite_calib.escort.advice import EscortAdvice
    from theodolite_calib.optical_axis.output import PointingSeries

MAIN_FRAME = "theodolite_main"
POINTING_TOPIC, POINTING_TYPE = "theodolite/pointing", "ship_msgs/msg/OpticalAxisPointing"
SMOOTHED_POINTING_TOPIC = "theodolite/pointing_smoothed"
TARGET_TOPIC, TARGET_TYPE = "theodolite/target_direction", "ship_msgs/msg/TargetDirection"
ESCORT_TOPIC, ESCORT_TYPE = "theodolite/escort", "ship_msgs/msg/EscortAdvice"
_TELESCOPE_ANGLES = "telescope_azimuth", "telescope_elevation", "telescope_rotation"


class PointingNumbers(NamedTuple):
    """Published numbers of N pointings, which may have different filter states; see :class:`PointingSeries`."""

    time_ns: StampArray
    rotation_nm: FloatArray
    covariance_n: FloatArray
    rotation_nt: FloatArray
    mode: NDArray[np.int64]
    status: list[Status]
    light_count: NDArray[np.int64]
    rotation_dm: FloatArray

    @classmethod
    def from_series(cls, series: Sequence["PointingSeries"]) -> "PointingNumbers":
        """Return the numbers of several series in sequence."""
        return cls(*join_fields(series, cls._fields))

    @classmethod
    def from_estimate(cls, estimate: PointingEstimate) -> "PointingNumbers":
        """Return the numbers of one pointing."""
        return cls(
            time_ns=np.array([estimate.time_ns]),
            rotation_nm=estimate.rotation_nm[None],
            covariance_n=estimate.covariance_n[None],
            rotation_nt=estimate.rotation_nt[None],
            mode=np.array([estimate.mode]),
            status=[estimate.status],
            light_count=np.array([estimate.light_count]),
            rotation_dm=estimate.rotation_dm[None],
        )

    def subset(self, indices: NDArray[np.int64]) -> "PointingNumbers":
        """Return the numbers of the pointings with given indices."""
        if len(indices) == len(self.time_ns):
            return self
        return PointingNumbers(*(select_values(each, indices) for each in self))


def pointing_messages(
    factory: MessageFactory,
    lever: Mapping[str, float],
    estimate: PointingEstimate,
    frames: FrameNames = FRAME_NAMES,
    publish_tf: bool = True,
) -> list[OutputMessage]:
    """Return the messages of one pointing.

    If the pointing is INVALID, its numbers are NaN and there is no message on /tf.

    Args:
        factory: creates the messages.
        lever: position of the theodolite in the deck, x forward, y left, z up, m.
        estimate: the pointing.
        frames: names of the frames of deck and horizon.
        publish_tf: False to omit the message on /tf.
    """
    pointing, in_deck = PointingNumbers.from_estimate(estimate), math.isfinite(estimate.rotation_dm[0, 0])
    messages = _messages(pointing, lever, in_deck, frames, is_single=True, publish_tf=publish_tf)
    return [(topic, factory.encode(type_name, **fields)) for topic, type_name, fields in messages]


def smoothed_pointing(factory: MessageFactory, estimate: PointingEstimate) -> OutputMessage:
    """Return the message of a smoothed pointing: the first message of :func:`pointing_messages`, on another topic."""
    pointing = PointingNumbers.from_estimate(estimate)
    (_, type_name, fields), *_ = _messages(
        pointing, ZERO_VECTOR, False, FRAME_NAMES, is_single=True, publish_tf=False
    )
    return SMOOTHED_POINTING_TOPIC, factory.encode(type_name, **fields)


def pointing_rows(
    factory: MessageFactory,
    lever: Mapping[str, float],
    pointings: PointingNumbers,
    frames: FrameNames = FRAME_NAMES,
    publish_tf: bool = True,
) -> Iterator[OutputRows]:
    """Yield the messages of N pointings; messages of one pointing are in the order of :func:`pointing_messages`."""
    in_deck: list[bool] = np.isfinite(pointings.rotation_dm[:, 0, 0]).tolist()
    claimed = [status is not Status.INVALID for status in pointings.status]
    kinds = zip(claimed, in_deck, strict=True)

    def messages_of(kind: Any, places: NDArray[np.int64]) -> MessageFields:
        return _messages(pointings.subset(places), lever, kind[1], frames, is_single=False, publish_tf=publish_tf)

    return rows_by_kind(factory, kinds, messages_of)


def _messages(
    pointings: PointingNumbers,
    lever: Fields,
    in_deck: bool,
    frames: FrameNames,
    *,
    is_single: bool,
    publish_tf: bool,
) -> MessageFields:
    """Return topic, type and fields of the messages of pointings that are all INVALID, or all not INVALID.

    The transform on /tf is relative to the deck if ``in_deck``, otherwise to the horizon. The fields are the numbers of
    the only pointing if ``is_single``, otherwise columns with one value for each pointing.
    """
    of_main = angles(pointings.rotation_nm)
    covariances = angle_covariances(pointings.covariance_n, of_main, SINGULAR_ELEVATION)
    if in_deck:
        rotations = FLU_FROM_DEVICE @ pointings.rotation_dm @ FLU_FROM_DEVICE.T
    else:
        rotations = ENU_FROM_HORIZON @ pointings.rotation_nm @ FLU_FROM_DEVICE.T
    arrays = (
        pointings.time_ns,
        pointings.mode,
        np.array(pointings.status),
        pointings.light_count,
        of_main,
        angles(pointings.rotation_nt),
        covariances.reshape(-1, 9),
        enu_covariance(pointings.covariance_n).reshape(-1, 9),
        quaternions(rotations),
    )
    values: list[Any] = [each[0].tolist() if is_single else each.T for each in arrays]
    time_ns, mode, status, light_count, main, telescope, covariance, rotation_covariance, quaternion = values
    pointing = {
        "header": {"stamp": time_ns, "frame_id": MAIN_FRAME},
        **dict(zip(("azimuth", "elevation", "image_rotation"), main, strict=True)),
        "covariance": covariance,
        "rotation_covariance": rotation_covariance,
        **dict(zip(_TELESCOPE_ANGLES, telescope, strict=True)),
        "mode": mode,
        "status": status,
        "light_count": light_count,
    }
    messages: MessageFields = [(POINTING_TOPIC, POINTING_TYPE, pointing)]
    if publish_tf and pointings.status[0] is not Status.INVALID:
        # With the INS alone the frame of the deck is not published, because its attitude comes from ship/attitude.
        frame = {
            "header": {"stamp": time_ns, "frame_id": frames.deck if in_deck else frames.horizon},
            "child_frame_id": MAIN_FRAME,
            "transform": {
                "translation": lever if in_deck else ZERO_VECTOR,
                "rotation": dict(zip("xyzw", quaternion, strict=True)),
            },
        }
        messages.append((TF_TOPIC, TF_TYPE, {"transforms": [frame]}))
    return messages


def pointing_budget(factory: MessageFactory, estimate: PointingEstimate, sources: Sequence[str]) -> Any:
    """Return ship_msgs/ErrorBudget of a published pointing; ``sources`` are the names of its covariance's parts."""
    parts_n, covariance_n = estimate.covariance_by_source_n, estimate.covariance_n
    return error_budget_message(factory, "optical_axis", estimate.time_ns, MAIN_FRAME, sources, parts_n, covariance_n)


def error_arcsec(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """Return ship_msgs/PointingErrorArcsec with predicted sigmas; the errors are NaN, because no truth is available."""
    azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
    sigma = np.sqrt(np.diagonal(angle_covariance(estimate.covariance_n, azimuth, elevation))) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/PointingErrorArcsec",
        header={"stamp": estimate.time_ns, "frame_id": MAIN_FRAME},
        sigma_azimuth_cos_elevation=float(sigma[0] * np.cos(elevation)),
        sigma_elevation=float(sigma[1]),
        sigma_image_rotation=float(sigma[2]),
        error_azimuth_cos_elevation=unknown,
        error_elevation=unknown,
        error_image_rotation=unknown,
    )


def target_message(factory: MessageFactory, estimate: TargetEstimate, frame_id: str) -> Any:
    """Return ship_msgs/TargetDirection of one image; all numbers are NaN if INVALID."""
    (azimuth, elevation), covariance = direction_angles(estimate.direction_n, estimate.covariance_n)
    make: Callable[..., Any] = factory.make
    return make(
        TARGET_TYPE,
        header={"stamp": estimate.time_ns, "frame_id": frame_id},
        target_id=estimate.target_id,
        azimuth=float(azimuth),
        elevation=float(elevation),
        covariance=covariance.ravel(),
        direction=_enu(estimate.direction_n),
        direction_covariance=enu_covariance(estimate.covariance_n).ravel(),
        position=_enu(estimate.position_n),
        position_covariance=enu_covariance(estimate.position_covariance_n).ravel(),
        status=int(estimate.status),
    )


def direction_angles(direction_n: FloatArray, covariance_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in [0, 2 pi) and elevation, shape (2,), of a unit vector, and their covariance, rad², (2, 2).

    The covariance is NaN within 0.1° of the zenith and the nadir.
    """
    north, up, east = direction_n.tolist()
    horizontal = np.hypot(north, east)
    angles = np.array([np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, horizontal)])
    if not abs(angles[1]) <= SINGULAR_ELEVATION:
        return angles, np.full((2, 2), np.nan)
    by_direction = np.array([
        [-east / horizontal**2, 0.0, north / horizontal**2],
        [-up * north / horizontal, horizontal, -up * east / horizontal],
    ])  # fmt: skip
    return angles, by_direction @ covariance_n @ by_direction.T


def _enu(vector_n: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", (ENU_FROM_HORIZON @ vector_n).tolist(), strict=True))


def escort_message(
    factory: MessageFactory, advice: "EscortAdvice", time_ns: int, horizon: str = FRAME_NAMES.horizon
) -> Any:
    """Return ship_msgs/EscortAdvice for the pointing at a time; positions are NaN if no position meets the limits."""
    return factory.make(
        ESCORT_TYPE,
        header={"stamp": time_ns, "frame_id": horizon},
        beacon_ids=list(advice.names),
        places=[_enu(place_n) for place_n in advice.places_n],
        sigma_now=advice.sigma_now,
        sigma_advised=advice.sigma_advised,
        limits_reached=list(advice.limits_reached),
    )

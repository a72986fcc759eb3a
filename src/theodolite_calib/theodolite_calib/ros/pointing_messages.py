"""What pointings become: ship_msgs/OpticalAxisPointing, and the main frame on /tf; what is told of one now and then.

One function says what stands in which field. Its values are numbers for the one pointing that a live node has at a
time, and columns of numbers for the many of a block, which become rows of bytes together.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_bags.message_factory import MessageFactory
from ship_estimation.outcome import Status
from ship_geometry.compiled_angles import angle_covariances, angles, quaternions
from ship_geometry.frames import SINGULAR_ELEVATION, angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import ENU_FROM_HORIZON, FLU_FROM_DEVICE, enu_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.edge.messages_out import DECK_FRAME, HORIZON_FRAME, TF_TOPIC, TF_TYPE, ZERO_VECTOR, error_budget
from ship_node.edge.topics import Published
from theodolite_calib.measured.samples import PointingEstimate, PointingRun, StampArray

MAIN_FRAME = "theodolite_main"
POINTING_TOPIC, POINTING_TYPE = "theodolite/pointing", "ship_msgs/msg/OpticalAxisPointing"

Fields = Mapping[str, Any]


class PublishedRows(NamedTuple):
    """The messages of one topic that some of N pointings become.

    Attributes:
        topic: the topic.
        messages: in order.
        places: which of the pointings each message is of.
    """

    topic: str
    messages: CdrRows
    places: NDArray[np.int64]


class PointingNumbers(NamedTuple):
    """What is published of N pointings, whatever states they rest on; see :class:`PointingRun`."""

    time_ns: StampArray
    rotation_nm: FloatArray
    covariance_n: FloatArray
    rotation_nt: FloatArray
    mode: NDArray[np.int64]
    status: list[Status]
    light_count: NDArray[np.int64]
    rotation_dm: FloatArray

    @classmethod
    def of(cls, runs: list[PointingRun]) -> "PointingNumbers":
        """The numbers of several runs, one after another."""

        def joined(name: str) -> Any:
            values = [getattr(run, name) for run in runs]
            if len(values) == 1:
                return values[0]
            return list(chain.from_iterable(values)) if isinstance(values[0], list) else np.concatenate(values)

        return cls(*map(joined, cls._fields))

    @classmethod
    def of_one(cls, estimate: PointingEstimate) -> "PointingNumbers":
        """The numbers of one pointing."""
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

    def some(self, places: NDArray[np.int64]) -> "PointingNumbers":
        """Some of them."""
        if len(places) == len(self.time_ns):
            return self

        def some(values: Any) -> Any:
            return [values[place] for place in places] if isinstance(values, list) else values[places]

        return PointingNumbers(*map(some, self))


def pointing_messages(
    factory: MessageFactory, lever: Mapping[str, float], estimate: PointingEstimate
) -> list[Published]:
    """What one pointing becomes, as messages on their way out.

    Where no pointing is claimed the first is all NaN, and the second is not made.

    Args:
        factory: makes the messages.
        lever: place of the theodolite in the deck, x forward, y left, z up, m.
        estimate: the pointing.
    """
    pointing, in_deck = PointingNumbers.of_one(estimate), math.isfinite(estimate.rotation_dm[0, 0])
    return [
        (topic, factory.encoded(type_name, **fields))
        for topic, type_name, fields in _messages(pointing, lever, in_deck, _numbers)
    ]


def pointing_rows(
    factory: MessageFactory, lever: Mapping[str, float], pointings: PointingNumbers
) -> Iterator[PublishedRows]:
    """What N pointings become; the messages of one are in the same order as by :func:`pointing_messages`."""
    in_deck: list[bool] = np.isfinite(pointings.rotation_dm[:, 0, 0]).tolist()
    claimed = [status is not Status.INVALID for status in pointings.status]
    # Alike are those whose messages have the same texts, and nothing left out.
    kinds = list(zip(claimed, in_deck, strict=True))
    for kind in dict.fromkeys(kinds):
        places = np.array([place for place, other in enumerate(kinds) if other == kind])
        for topic, type_name, fields in _messages(pointings.some(places), lever, kind[1], _columns):
            yield PublishedRows(topic, factory.encoded_rows(type_name, len(places), **fields), places)


def _numbers(values: Any) -> Any:
    """The numbers of the only pointing, of an array whose first axis counts pointings."""
    return values[0].tolist()


def _columns(values: Any) -> Any:
    """The numbers of all pointings, by columns."""
    return values.T


def _messages(
    pointings: PointingNumbers, lever: Fields, in_deck: bool, values_of: Callable[[Any], Any]
) -> Iterator[tuple[str, str, Fields]]:
    """Topic, type and fields of each message of pointings that are alike; ``in_deck`` where they know of the deck."""
    of_main = angles(pointings.rotation_nm)
    azimuth, elevation, image_rotation = values_of(of_main)
    telescope_azimuth, telescope_elevation, telescope_rotation = values_of(angles(pointings.rotation_nt))
    covariances = angle_covariances(pointings.covariance_n, of_main, SINGULAR_ELEVATION)
    time_ns, mode, status, light_count = (
        values_of(whole[:, None])[0]
        for whole in (pointings.time_ns, pointings.mode, np.array(pointings.status), pointings.light_count)
    )
    yield (
        POINTING_TOPIC,
        POINTING_TYPE,
        {
            "header": {"stamp": time_ns, "frame_id": MAIN_FRAME},
            "azimuth": azimuth,
            "elevation": elevation,
            "image_rotation": image_rotation,
            "covariance": values_of(covariances.reshape(-1, 9)),
            "rotation_covariance": values_of(enu_covariance(pointings.covariance_n).reshape(-1, 9)),
            "telescope_azimuth": telescope_azimuth,
            "telescope_elevation": telescope_elevation,
            "telescope_rotation": telescope_rotation,
            "mode": mode,
            "status": status,
            "light_count": light_count,
        },
    )
    if pointings.status[0] is Status.INVALID:
        return
    if in_deck:
        parent, translation = DECK_FRAME, lever
        rotations = quaternions(FLU_FROM_DEVICE @ pointings.rotation_dm @ FLU_FROM_DEVICE.T)
    else:
        # The INS alone: its attitude is not that of the frame "deck", and nobody may publish that one at all.
        parent, translation = HORIZON_FRAME, ZERO_VECTOR
        rotations = quaternions(ENU_FROM_HORIZON @ pointings.rotation_nm @ FLU_FROM_DEVICE.T)
    main = {
        "header": {"stamp": time_ns, "frame_id": parent},
        "child_frame_id": MAIN_FRAME,
        "transform": {"translation": translation, "rotation": dict(zip("xyzw", values_of(rotations), strict=True))},
    }
    yield TF_TOPIC, TF_TYPE, {"transforms": [main]}


def pointing_budget(factory: MessageFactory, estimate: PointingEstimate, sources: Sequence[str]) -> Any:
    """ship_msgs/ErrorBudget of a published pointing; ``sources`` name the parts of its covariance."""
    parts_n, covariance_n = estimate.parts_n, estimate.covariance_n
    return error_budget(factory, "optical_axis", estimate.time_ns, MAIN_FRAME, sources, parts_n, covariance_n)


def error_arcsec(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """ship_msgs/PointingErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
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

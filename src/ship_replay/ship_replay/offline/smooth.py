"""Smoothed attitudes of the ship and pointings of the theodolite, each from all measurements of a bag.

The nodes process the bag as in a replay, message by message; ``ship_attitude`` stores the history of its filter. At the
end the smoother runs backwards over this history. Then ``optical_axis`` processes the bag again with the smoothed
attitudes in place of ``ship/attitude``, and its pointings are smoothed. The same bag and configuration give the same
bytes.
"""

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.messages.attitude_messages import (
    ATTITUDE_TOPIC,
    ATTITUDE_TYPE,
    SMOOTHED_TOPIC,
    smoothed_message,
)
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.smoothing import SmoothingCore
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, ProgressWrapper, read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_bags.stamps import ns_from_stamp
from ship_estimation.parameters.fields import FrameNames
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.messages.inputs_outputs import OutputMessage, OutputTopic
from ship_node.saved_files.saved_document import DISK, READ_ONLY, Files
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain, suite_text
from ship_replay.offline.message_times import sort_by_stamp
from ship_replay.offline.outputs import DecodingSink
from ship_replay.offline.replay import match_inputs, median_delay_ns, truth_topic_names, write_head
from ship_replay.offline.replay_run import process_records
from ship_stars.attitude_samples import AttitudeEstimate
from ship_stars.sky.sky_model import SkyModel
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.messages.output_messages import (
    POINTING_TOPIC,
    POINTING_TYPE,
    SMOOTHED_POINTING_TOPIC,
    smoothed_pointing,
)
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.smoothing import SmoothingAxisCore

Three = tuple[float, float, float]


@dataclass
class SmoothedOutput:
    """Smoothed messages of one output.

    Attributes:
        topic: topic of the messages.
        type_name: type of the messages.
        angles: names of the three angles.
        count: number of messages written.
        variances: variances of the angles, rad², in real time and smoothed, of outputs that were VALID or COASTING in
            real time.
    """

    topic: str
    type_name: str
    angles: tuple[str, str, str]
    count: int = 0
    variances: list[tuple[Three, Three]] = field(default_factory=list)

    @property
    def median_sigmas_arcsec(self) -> FloatArray | None:
        """Median sigmas of the angles in real time and smoothed, shape (2, 3); None if all were DEGRADED or INVALID."""
        return np.sqrt(np.nanmedian(self.variances, axis=0)) / ARCSEC if self.variances else None

    def record(self, real_time: "_RealTimeOutput", message: Any, covariance: FloatArray) -> BagRecord:
        """Return a smoothed message with the log time of the real-time message, and count it.

        Args:
            real_time: real-time output at the same stamp.
            message: smoothed message.
            covariance: covariance of the smoothed angles, rad², shape (3, 3).
        """
        self.count += 1
        if real_time.status < Status.DEGRADED:
            first, second, third = covariance.diagonal().tolist()
            self.variances.append((real_time.variances, (first, second, third)))
        data = serialize(message)
        return BagRecord(self.topic, self.type_name, real_time.log_time_ns, data, message_store())


@dataclass
class SmoothSummary:
    """Result of smoothing.

    Attributes:
        problems: problems of the bag and nodes that are not replayed, one line each.
        outputs: smoothed outputs of each node that takes part.
    """

    problems: list[str]
    outputs: list[SmoothedOutput] = field(default_factory=list)


class _SmoothingShipAdapter(ShipAttitudeAdapter):
    """Adapter whose core returns all smoothed attitudes at the end.

    Attributes:
        finished_estimates: smoothed attitudes of estimators that were replaced.
    """

    def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
        super().__init__(config, factory, files)
        self.finished_estimates: list[AttitudeEstimate] = []

    def before_adoption(self) -> list[OutputMessage]:
        """See :class:`RecoveringAdapter`; the attitudes are written at the end."""
        self.finished_estimates += self.core.smooth_remaining()
        return []

    def make_core(self, config: ShipAttitudeConfig, sky_model: SkyModel | None) -> ShipAttitudeCore:
        """See :meth:`ShipAttitudeAdapter.make_core`."""
        return SmoothingCore(config, sky_model, None)


class _SmoothingAxisAdapter(OpticalAxisAdapter):
    """Adapter whose core returns all smoothed pointings at the end."""

    def make_core(self, config: OpticalAxisConfig, sky_model: SkyModel | None) -> OpticalAxisCore:
        """See :meth:`OpticalAxisAdapter.make_core`."""
        return SmoothingAxisCore(config, sky_model)


class _RealTimeOutput(NamedTuple):
    """A real-time output: log time, status and variances of its angles, rad²."""

    log_time_ns: int
    status: Status
    variances: Three


class _RealTimeOutputs(DecodingSink):
    """Sink that stores the real-time attitudes and pointings by their stamps."""

    topics = ATTITUDE_TOPIC, POINTING_TOPIC

    def __init__(self) -> None:
        self.attitudes: dict[int, _RealTimeOutput] = {}
        self.pointings: dict[int, _RealTimeOutput] = {}

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Store an attitude or pointing."""
        first, second, third = message.covariance[::4].tolist()
        if topic == POINTING_TOPIC:
            first *= math.cos(message.elevation) ** 2
        target = self.attitudes if topic == ATTITUDE_TOPIC else self.pointings
        output = _RealTimeOutput(log_time_ns, Status(message.status), (first, second, third))
        target[ns_from_stamp(message.header.stamp)] = output


def smooth(
    bag_path: Path,
    out_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
    by_stamps: bool = False,
) -> SmoothSummary:
    """Write ``ship/attitude_smoothed``, ``theodolite/pointing_smoothed`` and the unchanged truth.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        out_path: .mcap file to write; it appears only when complete.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag.
        progress: function that wraps each iteration over the bag in a progress bar.
        by_stamps: if true, messages arrive at their stamps instead of their log times.

    Raises:
        BadInput: the bag, its topics or the configuration cannot be used; nothing is written.
    """
    with read_bag(bag_path) as bag:
        if out_path.resolve() == bag_path.resolve():
            raise BadInput("the output would overwrite the input", file=out_path)
        config_text, factory, real_time = suite_text(bag, config_path), RosbagsFactory(), _RealTimeOutputs()
        kinds = (_SmoothingShipAdapter, StarAttitudeAdapter, OpticalAxisAdapter)
        chain, left_out = suite_chain(bag, kinds, factory, config_path, namespace)
        ship = next((one for one in chain.adapters if isinstance(one, _SmoothingShipAdapter)), None)
        axis = next((one for one in chain.adapters if isinstance(one, OpticalAxisAdapter)), None)
        if ship is None and axis is None:
            text = "the configuration has no section of ship_attitude or optical_axis: there is nothing to smooth"
            raise BadInput(text, file=bag_path if config_path is None else config_path)
        names = match_inputs(bag, chain, namespace)

        def records_of(some_names: Mapping[str, str]) -> Iterator[BagRecord]:
            records = progress(bag.records(some_names), bag)
            return sort_by_stamp(records, median_delay_ns(bag_path, names)) if by_stamps else records

        process_records(chain, records_of(names), names, real_time, batch_size=1)
        summary = SmoothSummary([*left_out, *bag.problems])
        attitudes: Iterable[BagRecord] = []
        pointings: Iterable[BagRecord] = []
        if ship is not None:
            summary.outputs.append(SmoothedOutput(SMOOTHED_TOPIC, ATTITUDE_TYPE, ("heading", "pitch", "roll")))
            estimates = itertools.chain(ship.finished_estimates, ship.core.smooth_remaining())
            attitudes = _smoothed_attitudes(
                estimates, real_time.attitudes, factory, ship.config.frames, summary.outputs[-1]
            )
        if axis is not None:
            # The attitudes are used twice, as an input of the theodolite and as an output.
            attitudes = list(attitudes)
            again = _SmoothingAxisAdapter(chain.configs[axis.node_name], factory, READ_ONLY)
            session = AdapterChain([again])
            of_session = {name: relative for name, relative in names.items() if relative in session.input_topics[0]}
            records = heapq.merge(records_of(of_session), attitudes, key=attrgetter("log_time_ns"))
            input_names = of_session | {SMOOTHED_TOPIC: ATTITUDE_TOPIC}
            process_records(session, records, input_names, _RealTimeOutputs(), batch_size=1)
            angles = ("azimuth cos elevation", "elevation", "image rotation")
            summary.outputs.append(SmoothedOutput(SMOOTHED_POINTING_TOPIC, POINTING_TYPE, angles))
            pointings = _smoothed_pointings(again.core, real_time.pointings, factory, summary.outputs[-1])
        with BagWriter(out_path) as writer:
            write_head(writer, bag, [OutputTopic(one.topic, one.type_name) for one in summary.outputs], config_text)
            for record in heapq.merge(_truth(bag, namespace), attitudes, pointings, key=attrgetter("log_time_ns")):
                writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
            if not any(one.count for one in summary.outputs):
                raise BadInput("no attitude and no pointing was published: there is nothing to smooth", file=bag_path)
        return summary


def _truth(bag: Bag, namespace: str) -> Iterator[BagRecord]:
    names = truth_topic_names(bag, namespace)
    for record in bag.records(names) if names else ():
        yield replace(record, topic=names[record.topic])


def _smoothed_attitudes(
    estimates: Iterable[AttitudeEstimate],
    real_time: Mapping[int, _RealTimeOutput],
    factory: RosbagsFactory,
    frames: FrameNames,
    smoothed: SmoothedOutput,
) -> Iterator[BagRecord]:
    """Yield the smoothed attitudes of the ship and fill their summary."""
    for estimate in estimates:
        _, message = smoothed_message(factory, estimate, frames)
        heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
        covariance = angle_covariance(estimate.covariance_n, heading, pitch)
        yield smoothed.record(real_time[estimate.time_ns], message, covariance)


def _smoothed_pointings(
    core: SmoothingAxisCore, real_time: Mapping[int, _RealTimeOutput], factory: RosbagsFactory, smoothed: SmoothedOutput
) -> Iterator[BagRecord]:
    """Yield the smoothed pointings at the stamps of real-time pointings and fill their summary.

    The status is the worse of the real-time and the smoothed status.
    """
    for estimate in core.smooth_remaining():
        output = real_time.get(estimate.time_ns)
        if output is not None:
            _, message = smoothed_pointing(factory, replace(estimate, status=max(output.status, estimate.status)))
            azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
            covariance = angle_covariance(estimate.covariance_n, azimuth, elevation)
            covariance[0] *= math.cos(elevation) ** 2
            yield smoothed.record(output, message, covariance)

"""A bag's attitudes of the ship with hindsight: each by all that was measured before and after it.

The nodes ``star_attitude`` and ``ship_attitude`` take the bag as in a replay, message by message; ``ship_attitude``
keeps how its filter went on. At the end the smoother goes back over the whole run. The same bag and configuration give
the same bytes.
"""

import heapq
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeEstimate
from ship_attitude_star.ros.attitude_messages import ATTITUDE_TOPIC, ATTITUDE_TYPE, SMOOTHED_TOPIC, smoothed_message
from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.smoothing.core import SmoothingCore
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory, serialize
from ship_bags.stamps import ns_from_stamp
from ship_estimation.outcome import Status
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.edge.topics import OutputTopic
from ship_replay.offline.adapter_chain import suite_chain, suite_text
from ship_replay.offline.message_times import in_order_of_stamps
from ship_replay.offline.replay import Watcher, announce, match_inputs, truth_names, usual_delay_ns
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary

_OUTPUT = OutputTopic(SMOOTHED_TOPIC, ATTITUDE_TYPE)

Angles = tuple[float, float, float]

_Written = tuple[int, str, str, bytes]
"""Log time, topic, type, bytes."""


@dataclass
class SmoothSummary:
    """What was smoothed.

    Attributes:
        problems: what is wrong with the bag, and the nodes left out, one line each.
        count: attitudes written.
        variances: of heading, pitch and roll, rad², as told at once and smoothed, of those that are not DEGRADED.
    """

    problems: list[str]
    count: int = 0
    variances: list[tuple[Angles, Angles]] = field(default_factory=list)

    @property
    def median_sigmas_arcsec(self) -> FloatArray | None:
        """Of heading, pitch and roll as told at once and smoothed, shape (2, 3); None where all are DEGRADED."""
        return np.sqrt(np.median(self.variances, axis=0)) / ARCSEC if self.variances else None


class _WholeRun(ShipAttitudeAdapter):
    """The node whose core tells all attitudes again at the end."""

    def make_core(self, config: ShipAttitudeConfig, watch: SkyWatch | None) -> ShipAttitudeCore:
        """See :meth:`ShipAttitudeAdapter.make_core`."""
        return SmoothingCore(config, watch, None)


class _ToldAtOnce:
    """Takes what the replay gives, and keeps when and how surely each attitude was told."""

    def __init__(self) -> None:
        self.log_times_ns: dict[int, int] = {}
        self.variances: dict[int, Angles] = {}

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take a message."""
        if topic == ATTITUDE_TOPIC:
            stamp_ns = ns_from_stamp(message.header.stamp)
            self.log_times_ns[stamp_ns] = log_time_ns
            self.variances[stamp_ns] = tuple(message.covariance[::4].tolist())

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take a message of the truth, of which none is asked for."""


def smooth(
    bag_path: Path,
    out_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
    by_stamps: bool = False,
) -> SmoothSummary:
    """Write ``ship/attitude_smoothed``, and the truth as it is.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        out_path: .mcap file to write; it appears only when all is done.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.
        by_stamps: messages arrive at their stamps, whenever they were logged.

    Raises:
        BadInput: the bag, its topics or the configuration do not serve; nothing is written.
    """
    with read_bag(bag_path) as bag:
        if out_path.resolve() == bag_path.resolve():
            raise BadInput("the output would overwrite the input", file=out_path)
        config_text = suite_text(bag, config_path)
        factory = RosbagsFactory()
        chain, left_out = suite_chain(bag, (_WholeRun, StarAttitudeAdapter), factory, config_path, namespace)
        core = next((one.core for one in chain.adapters if isinstance(one, _WholeRun)), None)
        if core is None:
            text = "the configuration has no section of ship_attitude: there is nothing to smooth"
            raise BadInput(text, file=bag_path if config_path is None else config_path)
        relative_names = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
        told = _ToldAtOnce()
        run = ReplayRun(chain, told, ReplaySummary(), truth_topics=())
        records = watch(bag.records(relative_names), bag)
        if by_stamps:
            records = in_order_of_stamps(records, usual_delay_ns(bag_path, relative_names))
        for record in records:
            run.take(relative_names[record.topic], record)
        estimates = core.smoothed_to_the_end()
        first = next(estimates, None)
        if first is None:
            raise BadInput("no attitude was put out by the INS: there is nothing to smooth", file=bag_path)
        summary = SmoothSummary(problems=[*left_out, *bag.problems])
        smoothed = _smoothed_messages(itertools.chain([first], estimates), told, factory, summary)
        with BagWriter(out_path) as writer:
            announce(writer, bag, [_OUTPUT], config_text)
            for log_time_ns, topic, type_name, data in heapq.merge(_truth(bag, namespace), smoothed, key=itemgetter(0)):
                writer.write_raw(topic, type_name, data, log_time_ns)
        return summary


def _truth(bag: Bag, namespace: str) -> Iterator[_Written]:
    names = {name: relative for relative, name in truth_names(bag, namespace).items()}
    for record in bag.records(names) if names else ():
        yield record.log_time_ns, names[record.topic], record.type_name, record.data


def _smoothed_messages(
    estimates: Iterable[AttitudeEstimate], told: _ToldAtOnce, factory: RosbagsFactory, summary: SmoothSummary
) -> Iterator[_Written]:
    """The messages, each logged when the attitude was told at once; the summary is filled."""
    for estimate in estimates:
        topic, message = smoothed_message(factory, estimate)
        summary.count += 1
        if estimate.status < Status.DEGRADED:
            summary.variances.append((told.variances[estimate.time_ns], _variances(estimate)))
        yield told.log_times_ns[estimate.time_ns], topic, ATTITUDE_TYPE, serialize(message)


def _variances(estimate: AttitudeEstimate) -> Angles:
    """Of heading, pitch and roll, rad²."""
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    of_heading, of_pitch, of_roll = angle_covariance(estimate.covariance_n, heading, pitch).diagonal().tolist()
    return of_heading, of_pitch, of_roll

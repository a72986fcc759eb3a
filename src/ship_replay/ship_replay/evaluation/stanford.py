"""Errors against protection levels, epoch by epoch: where an output was safe, where it misled, where it said nothing.

An epoch is one published attitude or pointing whose truth is known, with the protection level that held at its stamp.
Each of its three angles falls into one of the regions of a Stanford diagram (:class:`Region`).
"""

import bisect
import enum
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag
from ship_bags.stamps import ns_from_stamp
from ship_bags.topic_names import relative_topics
from ship_estimation.outcome import Status
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_replay.evaluation.sources import Truth
from ship_watch.orientations import ORIENTATIONS, Orientation

Watcher = Callable[[Iterator[BagRecord], Bag], Iterator[BagRecord]]


class Region(enum.IntEnum):
    """Where an epoch lies, by error, protection level and alert limit."""

    NOMINAL = 0
    """The error is within the level, the level within the alert limit."""
    MISLEADING = 1
    """The error is above the level."""
    HAZARDOUS = 2
    """The error is above the level and the alert limit, the level within the limit."""
    UNAVAILABLE = 3
    """Nothing is promised: no level, a level above the alert limit, or an output that is DEGRADED or INVALID."""

    @property
    def words(self) -> str:
        """The name that people read."""
        return "hazardously misleading" if self is Region.HAZARDOUS else self.name.lower()


@dataclass(frozen=True)
class Epochs:
    """Errors and levels of one orientation.

    Attributes:
        orientation: what was published.
        error_arcsec: size of the error of each angle, shape (n, 3); NaN where nothing was claimed.
        level_arcsec: protection level of each, shape (n, 3); NaN where there was none.
        limit_arcsec: alert limit of each, shape (n, 3); infinite where there was none.
        offered: whether the output could be used, VALID or COASTING, shape (n,).
    """

    orientation: Orientation
    error_arcsec: FloatArray
    level_arcsec: FloatArray
    limit_arcsec: FloatArray
    offered: NDArray[np.bool_]

    def regions(self) -> NDArray[np.intp]:
        """The :class:`Region` of each angle of each epoch, shape (n, 3)."""
        error, level, limit = self.error_arcsec, self.level_arcsec, self.limit_arcsec
        # Written so that NaN promises nothing, and an error that is NaN misleads.
        promised = self.offered[:, None] & (level <= limit)
        regions = np.where(error <= level, Region.NOMINAL, Region.MISLEADING)
        regions = np.where((regions == Region.MISLEADING) & ~(error <= limit), Region.HAZARDOUS, regions)
        return np.where(promised, regions, Region.UNAVAILABLE)

    def counts(self) -> dict[str, dict[Region, int]]:
        """By channel, the number of epochs in each region."""
        regions = self.regions()
        return {
            channel: {region: int(np.sum(regions[:, axis] == region)) for region in Region}
            for axis, channel in enumerate(self.orientation.channels)
        }

    def statistics(self) -> dict[str, float]:
        """Quantity → value: epochs and, by channel, those of each region, availability and the largest error/level."""
        values = {"epochs": float(len(self.offered))}
        regions = self.regions()
        for axis, (channel, counts) in enumerate(self.counts().items()):
            for region, count in counts.items():
                values[f"{channel}.{region.words.replace(' ', '_')}"] = float(count)
            promised = regions[:, axis] != Region.UNAVAILABLE
            values[f"{channel}.availability"] = float(np.mean(promised))
            ratio = self.error_arcsec[promised, axis] / self.level_arcsec[promised, axis]
            values[f"{channel}.worst_error_over_level"] = float(np.max(ratio)) if len(ratio) else math.nan
            levels = self.level_arcsec[promised, axis]
            values[f"{channel}.median_level_arcsec"] = float(np.median(levels)) if len(levels) else math.nan
        return values


def epochs_of(
    bags: Sequence[Path],
    namespace: str = "",
    limits_arcsec: Mapping[str, Sequence[float]] | None = None,
    watch: Watcher = lambda records, bag: records,
) -> list[Epochs]:
    """The epochs of several bags together, one entry for each orientation that has truth and levels.

    Args:
        bags: with outputs, levels and truth.
        namespace: of the ship's topics in the bags.
        limits_arcsec: label of an orientation → alert limits of its angles, in place of those in the bags.
        watch: wraps the iteration over a bag, for a progress bar.

    Raises:
        BadInput: a bag cannot be read, or none has an epoch.
    """
    found: dict[str, list[Epochs]] = {}
    for path in bags:
        with read_bag(path) as bag:
            for orientation in ORIENTATIONS:
                part = _epochs_of_bag(bag, orientation, namespace, watch)
                if part is not None:
                    found.setdefault(orientation.label, []).append(part)
    if not found:
        needed = "; ".join(", ".join(_topics(orientation)) for orientation in ORIENTATIONS)
        raise BadInput(f"no epoch to draw: expected {needed} in one of the bags", file=bags[0])
    joined = [_joined(parts) for parts in found.values()]
    given = limits_arcsec or {}
    return [
        replace(part, limit_arcsec=np.broadcast_to(np.asarray(given[label], dtype=float), part.error_arcsec.shape))
        if (label := part.orientation.label) in given
        else part
        for part in joined
    ]


def _topics(orientation: Orientation) -> tuple[str, str, str]:
    """Where outputs, their levels and their truth are."""
    return orientation.topic, f"{orientation.topic.partition('/')[0]}/integrity", orientation.truth_topic


def _epochs_of_bag(bag: Bag, orientation: Orientation, namespace: str, watch: Watcher) -> Epochs | None:
    """The epochs of one orientation in a bag; None where the bag lacks one of the topics or no epoch has a truth."""
    names = [relative_topics(bag.topics, namespace).get(topic) for topic in _topics(orientation)]
    output_name, level_name, truth_name = names
    if output_name is None or level_name is None or truth_name is None:
        return None
    truth = Truth(orientation)
    for record in bag.records({truth_name}):
        truth.add(record.decode())
    levels = _HeldLevels(orientation.channels)
    outputs: list[tuple[int, int, FloatArray]] = []
    for record in watch(bag.records({output_name, level_name}), bag):
        message = record.decode()
        if record.topic == level_name:
            levels.add(message)
        else:
            outputs.append((ns_from_stamp(message.header.stamp), int(message.status), orientation.angles_of(message)))
    rows = [
        (status, _error_arcsec(orientation, angles, truth_nd), *levels.at(time_ns))
        for time_ns, status, angles in outputs
        if (truth_nd := truth.known_at(time_ns)) is not None
    ]
    if not rows:
        return None
    status, errors, held, limits = (np.array(part) for part in zip(*rows, strict=True))
    return Epochs(orientation, errors, held, limits, np.isin(status, (Status.VALID, Status.COASTING)))


def _error_arcsec(orientation: Orientation, angles: FloatArray, truth_nd: FloatArray) -> FloatArray:
    """Size of the error of each angle, shape (3,); NaN where nothing is claimed."""
    return np.abs(orientation.errors_arcsec(angles, truth_nd))


class _HeldLevels:
    """Levels and limits as they are told, once a second and at changes: each holds until the next.

    Args:
        channels: the angles, in the order in which they are asked for.
    """

    def __init__(self, channels: tuple[str, str, str]) -> None:
        self._channels = channels
        self._told: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._times_ns: list[int] = []

    def add(self, message: Any) -> None:
        """A message ship_msgs/Integrity."""
        available = message.state != message.UNAVAILABLE
        level = dict(zip(message.quantities, message.protection_level, strict=True)) if available else {}
        limit = dict(zip(message.quantities, message.alert_limit, strict=True))
        levels = np.array([level.get(channel, math.nan) for channel in self._channels]) / ARCSEC
        limits = np.array([limit.get(channel, math.nan) for channel in self._channels]) / ARCSEC
        time_ns = ns_from_stamp(message.header.stamp)
        self._told[time_ns] = levels, np.where(np.isnan(limits), math.inf, limits)

    def at(self, time_ns: int) -> tuple[FloatArray, FloatArray]:
        """Levels and limits at a stamp, arcsec, shapes (3,), (3,); NaN and infinity before the first."""
        if len(self._times_ns) != len(self._told):
            self._times_ns = sorted(self._told)
        index = bisect.bisect_right(self._times_ns, time_ns) - 1
        return self._told[self._times_ns[index]] if index >= 0 else (np.full(3, math.nan), np.full(3, math.inf))


def _joined(parts: Sequence[Epochs]) -> Epochs:
    """The epochs of several bags."""
    return Epochs(
        parts[0].orientation,
        np.concatenate([part.error_arcsec for part in parts]),
        np.concatenate([part.level_arcsec for part in parts]),
        np.concatenate([part.limit_arcsec for part in parts]),
        np.concatenate([part.offered for part in parts]),
    )

"""Comparison of errors with protection levels: nominal, misleading, hazardously misleading or unavailable.

An epoch is one published attitude or pointing whose truth is known, with the protection level valid at its stamp. Each
of the three angles of an epoch falls into one region of a Stanford diagram (:class:`Region`).
"""

import bisect
import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, ProgressWrapper, read_bag
from ship_bags.stamps import ns_from_stamp
from ship_bags.topic_names import relative_topics
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_replay.evaluation.sources import Truth
from ship_watch.orientations import ORIENTATIONS, Orientation


class Region(enum.IntEnum):
    """Region of an angle of an epoch, by error, protection level and alert limit."""

    NOMINAL = 0
    """Error within the level, level within the alert limit."""
    MISLEADING = 1
    """Error above the level but within the alert limit, level within the limit."""
    HAZARDOUS = 2
    """Error above the level and the alert limit, level within the limit."""
    UNAVAILABLE = 3
    """No level, a level above the alert limit, or an output that is DEGRADED or INVALID."""

    @property
    def label(self) -> str:
        """Name of the region for people."""
        return "hazardously misleading" if self is Region.HAZARDOUS else self.name.lower()


@dataclass(frozen=True)
class Epochs:
    """Errors and levels of one orientation.

    Attributes:
        orientation: ship's attitude or pointing.
        error_arcsec: absolute error of each angle, shape (n, 3); NaN for INVALID outputs.
        level_arcsec: protection level of each angle, shape (n, 3); NaN if no level was published.
        limit_arcsec: alert limit of each angle, shape (n, 3); infinite if no limit was published.
        is_usable: True if the output was VALID or COASTING, shape (n,).
    """

    orientation: Orientation
    error_arcsec: FloatArray
    level_arcsec: FloatArray
    limit_arcsec: FloatArray
    is_usable: NDArray[np.bool_]

    def regions(self) -> NDArray[np.intp]:
        """Return the :class:`Region` of each angle of each epoch, shape (n, 3)."""
        error, level, limit = self.error_arcsec, self.level_arcsec, self.limit_arcsec
        # A level of NaN counts as unavailable, an error of NaN as above level and limit.
        available = self.is_usable[:, None] & (level <= limit)
        regions = np.where(error <= level, Region.NOMINAL, Region.MISLEADING)
        regions = np.where((regions == Region.MISLEADING) & ~(error <= limit), Region.HAZARDOUS, regions)
        return np.where(available, regions, Region.UNAVAILABLE)

    def counts(self) -> dict[str, dict[Region, int]]:
        """Return the number of epochs in each region, by channel."""
        regions = self.regions()
        return {
            channel: {region: int(np.sum(regions[:, axis] == region)) for region in Region}
            for axis, channel in enumerate(self.orientation.channels)
        }

    def statistics(self) -> dict[str, float]:
        """Return quantity → value: number of epochs; by channel, counts of regions and availability.

        Largest error/level and median level are those of the available epochs.
        """
        values = {"epochs": float(len(self.is_usable))}
        regions = self.regions()
        for axis, (channel, counts) in enumerate(self.counts().items()):
            for region, count in counts.items():
                values[f"{channel}.{region.label.replace(' ', '_')}"] = float(count)
            available = regions[:, axis] != Region.UNAVAILABLE
            values[f"{channel}.availability"] = float(np.mean(available))
            ratio = self.error_arcsec[available, axis] / self.level_arcsec[available, axis]
            values[f"{channel}.worst_error_over_level"] = float(np.max(ratio)) if len(ratio) else math.nan
            levels = self.level_arcsec[available, axis]
            values[f"{channel}.median_level_arcsec"] = float(np.median(levels)) if len(levels) else math.nan
        return values


def read_epochs(
    bags: Sequence[Path],
    namespace: str = "",
    limits_arcsec: Mapping[str, Sequence[float]] | None = None,
    progress: ProgressWrapper = lambda records, bag: records,
) -> list[Epochs]:
    """Read the epochs of several bags; return one entry for each orientation that has truth and levels.

    Args:
        bags: bags with outputs, levels and truth.
        namespace: namespace of the ship's topics in the bags.
        limits_arcsec: label of an orientation → alert limits of its angles, used instead of the limits in the bags.
        progress: function that wraps the iteration over a bag in a progress bar.

    Raises:
        BadInput: a bag cannot be read, or no bag contains an epoch.
    """
    found: dict[str, list[Epochs]] = {}
    for path in bags:
        with read_bag(path) as bag:
            for orientation in ORIENTATIONS:
                part = _epochs_of_bag(bag, orientation, namespace, progress)
                if part is not None:
                    found.setdefault(orientation.label, []).append(part)
    if not found:
        needed = "; ".join(", ".join(_topics(orientation)) for orientation in ORIENTATIONS)
        raise BadInput(f"no epoch to draw: expected {needed} in one of the bags", file=bags[0])
    joined = [_concatenate(parts) for parts in found.values()]
    limits = limits_arcsec or {}
    return [
        replace(part, limit_arcsec=np.broadcast_to(np.asarray(limits[label], dtype=float), part.error_arcsec.shape))
        if (label := part.orientation.label) in limits
        else part
        for part in joined
    ]


def _topics(orientation: Orientation) -> tuple[str, str, str]:
    """Return the topics of outputs, levels and truth."""
    return orientation.topic, f"{orientation.topic.partition('/')[0]}/integrity", orientation.truth_topic


def _epochs_of_bag(bag: Bag, orientation: Orientation, namespace: str, progress: ProgressWrapper) -> Epochs | None:
    """Return the epochs of one orientation in a bag; None if a topic is missing or no epoch has a truth."""
    names = [relative_topics(bag.topics, namespace).get(topic) for topic in _topics(orientation)]
    output_name, level_name, truth_name = names
    if output_name is None or level_name is None or truth_name is None:
        return None
    truth = Truth(orientation)
    for record in bag.records({truth_name}):
        truth.add(record.decode())
    levels = _PublishedLevels(orientation.channels)
    outputs: list[tuple[int, int, FloatArray]] = []
    for record in progress(bag.records({output_name, level_name}), bag):
        message = record.decode()
        if record.topic == level_name:
            levels.add(message)
        else:
            outputs.append((ns_from_stamp(message.header.stamp), int(message.status), orientation.angles_of(message)))
    rows = [
        (status, np.abs(orientation.errors_arcsec(angles, truth_nd)), *levels.at(time_ns))
        for time_ns, status, angles in outputs
        if (truth_nd := truth.rotation_at(time_ns)) is not None
    ]
    if not rows:
        return None
    status, errors, level, limits = (np.array(part) for part in zip(*rows, strict=True))
    return Epochs(orientation, errors, level, limits, np.isin(status, (Status.VALID, Status.COASTING)))


class _PublishedLevels:
    """Published protection levels and alert limits; the values of a message are valid until the next message.

    Args:
        channels: names of the angles, in the order of the results.
    """

    def __init__(self, channels: tuple[str, str, str]) -> None:
        self._channels = channels
        self._by_time: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._times_ns: list[int] = []

    def add(self, message: Any) -> None:
        """Add a ship_msgs/Integrity."""
        available = message.state != message.UNAVAILABLE
        level = dict(zip(message.quantities, message.protection_level, strict=True)) if available else {}
        limit = dict(zip(message.quantities, message.alert_limit, strict=True))
        levels = np.array([level.get(channel, math.nan) for channel in self._channels]) / ARCSEC
        limits = np.array([limit.get(channel, math.nan) for channel in self._channels]) / ARCSEC
        time_ns = ns_from_stamp(message.header.stamp)
        self._by_time[time_ns] = levels, np.where(np.isnan(limits), math.inf, limits)

    def at(self, time_ns: int) -> tuple[FloatArray, FloatArray]:
        """Return levels and limits at a stamp, arcsec, shapes (3,), (3,); NaN and infinity before the first message."""
        if len(self._times_ns) != len(self._by_time):
            self._times_ns = sorted(self._by_time)
        index = bisect.bisect_right(self._times_ns, time_ns) - 1
        return self._by_time[self._times_ns[index]] if index >= 0 else (np.full(3, math.nan), np.full(3, math.inf))


def _concatenate(parts: Sequence[Epochs]) -> Epochs:
    names = ("error_arcsec", "level_arcsec", "limit_arcsec", "is_usable")
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **columns)

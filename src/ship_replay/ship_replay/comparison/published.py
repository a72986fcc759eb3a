"""Outputs of two runs at equal stamps: bitwise equality, and differences in arcsec."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import TRUTH_PREFIX, relative_topics
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_watch.orientations import ORIENTATIONS, Orientation

_INS = "ins/imu"
_HEALTH = "input_health"
_DIGEST_BYTES = 8


@dataclass(frozen=True)
class OutputSeries:
    """Outputs of one orientation in one bag, without messages that are INVALID or have an angle that is not finite.

    Attributes:
        time_ns: stamps in ascending order, shape (n,). If several messages have the same stamp, the last one counts.
        angles: angles as named in :attr:`Orientation.angles`, rad, shape (n, 3).
        sigma: predicted standard deviations of the angles, rad, shape (n, 3); NaN if not given.
        digests: hashes of the serialised messages, shape (n,).
    """

    time_ns: np.ndarray
    angles: FloatArray
    sigma: FloatArray
    digests: np.ndarray


@dataclass
class PublishedOutputs:
    """Outputs and inputs of one bag.

    Attributes:
        series: label of an orientation → outputs of this orientation.
        received_counts: input topic → largest number of messages that a node has received since its start.
        input_digests: topic that no node publishes (truth, ``ins/imu``) → hash of all its messages.
    """

    series: dict[str, OutputSeries] = field(default_factory=dict)
    received_counts: dict[str, int] = field(default_factory=dict)
    input_digests: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputDifference:
    """Outputs of B minus outputs of A at equal stamps.

    Attributes:
        orientation: ship's attitude or pointing.
        time_ns: equal stamps, shape (n,).
        difference_arcsec: differences of the channels, shape (n, 3); azimuth is multiplied by the cosine of the
            elevation.
        sigma_arcsec: predicted standard deviations of A's and of B's channels, shape (2, n, 3).
        channels_equal: for each channel, True if all values are equal to the last bit.
        messages_equal: number of stamps at which the whole messages are equal to the last bit.
        unpaired_counts: numbers of outputs in A only and in B only.
    """

    orientation: Orientation
    time_ns: np.ndarray
    difference_arcsec: FloatArray
    sigma_arcsec: FloatArray
    channels_equal: tuple[bool, bool, bool]
    messages_equal: int
    unpaired_counts: tuple[int, int]

    @property
    def all_equal(self) -> bool:
        """True if A and B have the same outputs, equal to the last bit; INVALID outputs are not compared."""
        return self.messages_equal == len(self.time_ns) and self.unpaired_counts == (0, 0)

    def largest(self, channel: int) -> tuple[float, int]:
        """Return the largest difference of a channel, arcsec, with its sign, and the stamp of this difference."""
        row = int(np.argmax(np.abs(self.difference_arcsec[:, channel])))
        return float(self.difference_arcsec[row, channel]), int(self.time_ns[row])

    def rms_arcsec(self, channel: int) -> float:
        """Return the root mean square of a channel's difference."""
        return float(np.sqrt(np.mean(self.difference_arcsec[:, channel] ** 2)))

    def sigmas_arcsec(self, channel: int) -> tuple[float, float]:
        """Return the root mean squares of the sigmas of A and B for a channel; NaN if a sigma of the run is missing."""
        first, second = np.sqrt(np.mean(self.sigma_arcsec[:, :, channel] ** 2, axis=1)).tolist()
        return first, second


def read_published(path: Path, namespace: str = "") -> PublishedOutputs:
    """Read the outputs of a bag.

    Raises:
        BadInput: the bag cannot be read.
    """
    published = PublishedOutputs()
    with read_bag(path) as bag:
        names = {name: topic for topic, name in relative_topics(bag.topics, namespace).items()}
        orientations = {known.topic: known for known in ORIENTATIONS}
        messages: dict[str, dict[int, tuple[bytes, FloatArray, FloatArray]]] = {}
        digests: dict[str, Any] = {}
        wanted = {
            name for name, topic in names.items()
            if topic in orientations or topic in (_INS, _HEALTH) or topic.startswith(TRUTH_PREFIX)
        }
        for record in bag.records(wanted):
            topic = names[record.topic]
            if topic in orientations:
                _add_output(messages.setdefault(orientations[topic].label, {}), orientations[topic], record)
            elif topic == _HEALTH:
                message = record.decode()
                before = published.received_counts.get(str(message.topic), 0)
                published.received_counts[str(message.topic)] = max(before, int(message.received))
            else:
                digests.setdefault(topic, hashlib.sha256()).update(record.data)
    published.series = {label: _output_series(rows) for label, rows in messages.items() if rows}
    published.input_digests = {topic: digest.hexdigest() for topic, digest in digests.items()}
    return published


def differences(first: PublishedOutputs, second: PublishedOutputs) -> list[OutputDifference]:
    """Return B minus A for each orientation that both runs published with equal stamps."""
    return [
        found
        for orientation in ORIENTATIONS
        if orientation.label in first.series and orientation.label in second.series
        if (found := _difference(orientation, first.series[orientation.label], second.series[orientation.label]))
    ]


def _difference(orientation: Orientation, a: OutputSeries, b: OutputSeries) -> OutputDifference | None:
    time_ns, in_a, in_b = np.intersect1d(a.time_ns, b.time_ns, assume_unique=True, return_indices=True)
    if not len(time_ns):
        return None
    angles_a, angles_b = a.angles[in_a], b.angles[in_b]
    scale, difference = orientation.scale(angles_a), angles_b - angles_a
    # Only differences beyond pi are wrapped, because wrapping rounds a small angle to the last bit of pi.
    difference = np.where(np.abs(difference) > np.pi, wrap_pi(difference), difference)
    equal = np.all(angles_a.view(np.int64) == angles_b.view(np.int64), axis=0).tolist()
    return OutputDifference(
        orientation,
        time_ns,
        scale * difference / ARCSEC,
        np.stack([scale * a.sigma[in_a], orientation.scale(angles_b) * b.sigma[in_b]]) / ARCSEC,
        (equal[0], equal[1], equal[2]),
        int(np.sum(a.digests[in_a] == b.digests[in_b])),
        (len(a.time_ns) - len(time_ns), len(b.time_ns) - len(time_ns)),
    )


def _add_output(
    rows: dict[int, tuple[bytes, FloatArray, FloatArray]], orientation: Orientation, record: BagRecord
) -> None:
    message = record.decode()
    angles = orientation.angles_of(message)
    if message.status != message.INVALID and np.all(np.isfinite(angles)):
        variances = np.asarray(message.covariance, dtype=float)[::4]
        digest = hashlib.blake2b(record.data, digest_size=_DIGEST_BYTES).digest()
        rows[ns_from_stamp(message.header.stamp)] = digest, angles, variances


def _output_series(rows: dict[int, tuple[bytes, FloatArray, FloatArray]]) -> OutputSeries:
    ordered = sorted(rows)
    variances = np.array([rows[stamp][2] for stamp in ordered])
    return OutputSeries(
        np.array(ordered, dtype=np.int64),
        np.array([rows[stamp][1] for stamp in ordered]),
        np.sqrt(np.where(variances > 0.0, variances, np.nan)),
        np.array([int.from_bytes(rows[stamp][0], "big") for stamp in ordered], dtype=np.uint64),
    )


def span(published: PublishedOutputs) -> tuple[int, int] | None:
    """Return first and last stamp of all outputs, UTC in ns; None if there are no outputs."""
    claims = published.series.values()
    if not claims:
        return None
    return min(int(one.time_ns[0]) for one in claims), max(int(one.time_ns[-1]) for one in claims)


def overlap_s(a: tuple[int, int], b: tuple[int, int]) -> float:
    """Return the length of the intersection of two spans, s; negative if they do not overlap."""
    return (min(a[1], b[1]) - max(a[0], b[0])) / NS_PER_S

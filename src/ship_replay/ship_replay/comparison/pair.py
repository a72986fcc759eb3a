"""Two recordings side by side: their data, their outputs at equal stamps, and the comparison of their inputs.

Outputs at equal stamps are compared to the last bit, and their differences are given in arcsec.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import TRUTH_PREFIX, relative_topics
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.report.recording import (
    RecordedHistory,
    ReportData,
    check_truth,
    is_short,
    process_pool,
    read_recording,
    read_report_data,
)
from ship_replay.report.tables import duration, utc
from ship_watch.orientations import ORIENTATIONS, Orientation
from ship_watch.safety.limits import Limits

_INS = "ins/imu"
_HEALTH = "input_health"
_DIGEST_BYTES = 8

_SIMULATION, _INJECTION = "simulation", "injection"
"""Names of the metadata records with the seed of a simulated voyage and of injected faults."""


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


@dataclass(frozen=True)
class Pair:
    """Two recordings, A and B.

    Attributes:
        a: data of A.
        b: data of B.
        published: published outputs of A and B.
        differences: outputs at equal stamps, B minus A, by orientation.
    """

    a: ReportData
    b: ReportData
    published: tuple[PublishedOutputs, PublishedOutputs]
    differences: list[OutputDifference]

    @property
    def is_same(self) -> bool:
        """True if both are the same file, byte for byte."""
        return self.a.recording.sha256 == self.b.recording.sha256

    @property
    def recordings(self) -> tuple[RecordedHistory, RecordedHistory]:
        """Recordings A and B."""
        return self.a.recording, self.b.recording

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of both recordings, UTC in ns."""
        spans = [recording.span_ns for recording in self.recordings]
        return min(start for start, _ in spans), max(end for _, end in spans)


def read_pair(
    a: Path, b: Path, truth: Path | None = None, limits: Limits | None = None, namespace: str = ""
) -> Pair:
    """Read two bags with outputs.

    Raises:
        BadInput: a bag cannot be read or lacks a required topic, or the two bags have no time in common.
    """
    if is_short(a) and is_short(b):
        first, second = (read_report_data(path, truth, limits, namespace) for path in (a, b))
        published = read_published(a, namespace), read_published(b, namespace)
    else:
        first, second, published = _read_in_parallel(a, b, truth, limits, namespace)
    pair = Pair(first, second, published, differences(*published))
    _check_overlap(pair)
    return pair


def _read_in_parallel(
    a: Path, b: Path, truth: Path | None, limits: Limits | None, namespace: str
) -> tuple[ReportData, ReportData, tuple[PublishedOutputs, PublishedOutputs]]:
    """Read both bags in parallel, with additional processes."""
    check_truth(truth, namespace)
    with process_pool(5) as pool:
        evaluated = [pool.submit(evaluate, path, against=truth, namespace=namespace) for path in (a, b)]
        recording_b = pool.submit(read_recording, b, limits, namespace)
        published = [pool.submit(read_published, path, namespace) for path in (a, b)]
        recording_a = read_recording(a, limits, namespace)
        return (
            ReportData(recording_a, evaluated[0].result()),
            ReportData(recording_b.result(), evaluated[1].result()),
            (published[0].result(), published[1].result()),
        )


def input_sentences(pair: Pair) -> list[str]:
    """Return sentences about the inputs of both recordings (equal or not) and about the recordings' times."""
    if pair.is_same:
        return ["A and B are the same recording (same SHA-256)."]
    sentences = [_same_inputs_sentence(pair)]
    counts_a, counts_b = (one.received_counts for one in pair.published)
    counted = [
        f"{topic} {counts_a.get(topic, 0)} in A, {counts_b.get(topic, 0)} in B"
        for topic in sorted(counts_a.keys() | counts_b.keys())
        if counts_a.get(topic, 0) != counts_b.get(topic, 0)
    ]
    if counted:
        sentences.append(f"The nodes received different numbers of messages: {'; '.join(counted)}.")
    spans = [recording.span_ns for recording in pair.recordings]
    if max(abs(spans[0][0] - spans[1][0]), abs(spans[0][1] - spans[1][1])) > 2 * 10**9:
        texts = [f"{utc(start)} to {utc(end)}" for start, end in spans]
        common = duration(overlap_s(*spans))
        sentences.append(
            f"The times differ: A from {texts[0]}, B from {texts[1]} UTC; {common} in common. "
            "Shares and means refer to each whole recording."
        )
    return sentences


def _same_inputs_sentence(pair: Pair) -> str:
    """Return the sentence about the inputs, from the strongest evidence in the bags."""
    given_a, given_b = (one.input_digests for one in pair.published)
    shared = sorted(given_a.keys() & given_b.keys())
    unequal = [topic for topic in shared if given_a[topic] != given_b[topic]]
    if unequal:
        return f"The inputs are not the same: {', '.join(unequal)} differ{'s' * (len(unequal) == 1)}."
    injected = [recording.metadata.get(_INJECTION) for recording in pair.recordings]
    if injected[0] != injected[1]:
        texts = [f"{_entries(record)} in {letter}" for letter, record in zip("AB", injected, strict=True) if record]
        only = " only" if len(texts) == 1 else ""
        return f"The inputs are not the same: faults were injected ({', '.join(texts)}{only})."
    scenarios = [night.attachments.get(SCENARIO_ATTACHMENT) for night in pair.recordings]
    seeds = [night.metadata.get(_SIMULATION) for night in pair.recordings]
    if scenarios[0] is not None and scenarios[1] is not None:
        if scenarios[0] != scenarios[1]:
            return f"The inputs are not the same: the scenarios differ ({SCENARIO_ATTACHMENT} below)."
        if seeds[0] != seeds[1]:
            texts = [_entries(record) or "no seed" for record in seeds]
            return f"The inputs are not the same: {texts[0]} in A, {texts[1]} in B."
        faults = "" if injected[0] is None else " The injected faults have the same seed, but are not recorded."
        return f"The inputs are the same simulated voyage (same scenario and seed).{faults}"
    if shared:
        return f"The inputs are the same as far as recorded: {', '.join(shared)}."
    return "Whether the inputs are the same is unknown: the bags have no truth, ins/imu or scenario in common."


def _entries(record: Mapping[str, str] | None) -> str:
    return ", ".join(f"{key} {value}" for key, value in sorted((record or {}).items()))


def _check_overlap(pair: Pair) -> None:
    spans = [span(one) or run.recording.span_ns for one, run in zip(pair.published, (pair.a, pair.b), strict=True)]
    if overlap_s(*spans) < 0.0:
        form = "%Y-%m-%d %H:%M:%S"
        texts = [f"{utc(start, form)} to {utc(end, form)}" for start, end in spans]
        raise BadInput(
            f"no time in common with {pair.a.recording.path}: "
            f"outputs from {texts[1]} UTC, expected some from {texts[0]}",
            file=pair.b.recording.path,
        )

"""Two recordings side by side: their data, their outputs at equal stamps, and the comparison of their inputs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT
from ship_replay.comparison.published import (
    OutputDifference,
    PublishedOutputs,
    differences,
    overlap_s,
    read_published,
    span,
)
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.report.recording import RecordedHistory, read_recording
from ship_replay.report.report_data import ReportData, check_truth, is_short, process_pool, read_report_data
from ship_replay.report.wording import duration, utc
from ship_watch.safety.limits import Limits

_SIMULATION, _INJECTION = "simulation", "injection"
"""Names of the metadata records with the seed of a simulated voyage and of injected faults."""


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

"""Outputs of a voyage with faults: statuses, errors against the truth, and named sources.

Sources are named in the innovations, in the exclusions of ``ship/integrity`` and ``theodolite/integrity``, and in
``input_health``. The latter contains the number of rejections of a topic by reason, and reports missing messages.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ship_bags.stamps import ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_replay.evaluation.sources import Truth
from ship_replay.offline.outputs import DecodingSink
from ship_replay.offline.replay_summary import INTEGRITY_TOPICS
from ship_watch.orientations import ORIENTATIONS, Orientation

EXCLUSION = "excluded from the estimate"
NO_DATA = "silent"

_IN_COMPARISON = frozenset(
    reason.word
    for reason in (
        Reason.GATE,
        Reason.ATTITUDE_CONFLICT,
        Reason.LIGHT_CONFLICT,
        Reason.MISIDENTIFIED,
        Reason.UNIDENTIFIED,
        Reason.GAP,
        Reason.NO_FIX,
    )
)
"""Reasons that may reject a correct measurement, because the values it is compared with are wrong or missing."""

_COMPARED_PREFIXES = ("star", "reference", "light", "telescope", "beacon", "baseline", "drone", "theodolite/beacons")
"""Prefixes of the names of sources that are compared with an estimate.

INS, encoders, fix and weather are not compared: their rejections refer to their own sequence of values.
"""

_CONSEQUENCES = (EXCLUSION, Reason.EXCLUDED.word, Reason.REVISED.word)

_INNOVATIONS = ("ship/innovation", "theodolite/innovation")
_HEALTH = "input_health"
_WARN = 1
_VALID = 0


class FaultIndication(NamedTuple):
    """Report that a source is rejected, excluded, or without data.

    Attributes:
        source: name of the source as published; in ``input_health`` this is the topic.
        log_ns: time of the report.
        stamp_ns: stamp of the measurement, or of the report.
        reason: a word of :class:`ship_estimation.rejection_rules.Reason`, EXCLUSION or NO_DATA.
    """

    source: str
    log_ns: int
    stamp_ns: int
    reason: str

    @property
    def is_own_fault(self) -> bool:
        """True if the reason concerns the source alone: form, stamps, sequence of values, no data."""
        if self.reason in _CONSEQUENCES:
            return False
        return self.reason not in _IN_COMPARISON or not self.source.startswith(_COMPARED_PREFIXES)


class ValidOutput(NamedTuple):
    """A VALID output at a stamp of the truth.

    Attributes:
        topic: topic of the output.
        stamp_ns: stamp of the output.
        log_ns: log time of the output.
        sigmas: largest error of an angle, in sigmas.
        level_ratio: largest ratio of an error to its protection level; NaN unless all three levels are known.
    """

    topic: str
    stamp_ns: int
    log_ns: int
    sigmas: float
    level_ratio: float


@dataclass
class VoyageOutputs:
    """Outputs of a voyage.

    Attributes:
        valid_outputs: VALID outputs at stamps of the truth.
        not_valid: (topic, stamp, log time, status) of the outputs that are not VALID.
        indications: innovations rejected for a reason other than REVISED, beginnings of exclusions, and entries of
            ``input_health``: no data, or new rejections for the source's own fault.
        failure_count: number of rejections because of a software failure.
        output_count: number of attitudes and pointings with any status.
    """

    valid_outputs: list[ValidOutput] = field(default_factory=list)
    not_valid: list[tuple[str, int, int, int]] = field(default_factory=list)
    indications: list[FaultIndication] = field(default_factory=list)
    failure_count: int = 0
    output_count: int = 0


class VoyageSink(DecodingSink):
    """Sink that collects the outputs needed for the evaluation.

    Args:
        truths: topic of an output → truth of its orientation.
    """

    def __init__(self, truths: Mapping[str, Truth]) -> None:
        self.outputs = VoyageOutputs()
        self._truths = truths
        self._orientations = {known.topic: known for known in ORIENTATIONS}
        self.topics = {*_INNOVATIONS, *INTEGRITY_TOPICS.values(), _HEALTH, *self._orientations}
        self._levels: dict[str, np.ndarray] = {}
        self._excluded: dict[str, set[str]] = {}
        self._health = HealthHistory()

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add an output."""
        if topic in _INNOVATIONS:
            self._add_innovation(message, log_time_ns)
        elif topic in INTEGRITY_TOPICS.values():
            self._add_integrity(topic, message, log_time_ns)
        elif topic == _HEALTH:
            self.outputs.indications += self._health.new_indications(message, log_time_ns)
        elif topic in self._orientations:
            self._add_output(self._orientations[topic], message, log_time_ns)

    def _add_innovation(self, message: Any, log_time_ns: int) -> None:
        reason = Reason(message.reason)
        if reason is Reason.FAILED:
            self.outputs.failure_count += 1
        if not message.accepted and reason not in (Reason.NONE, Reason.REVISED):
            stamp_ns = ns_from_stamp(message.header.stamp)
            self.outputs.indications.append(FaultIndication(message.source, log_time_ns, stamp_ns, reason.word))

    def _add_integrity(self, topic: str, message: Any, log_time_ns: int) -> None:
        self._levels[topic] = np.array(message.protection_level, dtype=float)
        now = set(message.excluded)
        for source in sorted(now - self._excluded.get(topic, set())):
            self.outputs.indications.append(
                FaultIndication(source, log_time_ns, ns_from_stamp(message.header.stamp), EXCLUSION)
            )
        self._excluded[topic] = now

    def _add_output(self, orientation: Orientation, message: Any, log_time_ns: int) -> None:
        stamp_ns, status = ns_from_stamp(message.header.stamp), int(message.status)
        self.outputs.output_count += 1
        if status != _VALID:
            self.outputs.not_valid.append((orientation.topic, stamp_ns, log_time_ns, status))
            return
        truth = self._truths.get(orientation.topic)
        truth_nd = None if truth is None else truth.rotation_at_stamp(stamp_ns)
        if truth_nd is None:
            return
        angles = orientation.angles_of(message)
        error = np.abs(orientation.errors_arcsec(angles, truth_nd)) * np.pi / 648_000.0
        sigma = orientation.scale(angles) * np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(3, 3)))
        level = self._levels.get(INTEGRITY_TOPICS[orientation.topic], np.full(3, np.nan))
        over_level = error / level if np.all(np.isfinite(level)) else np.full(3, np.nan)
        # A NaN error counts as wrong.
        sigmas = float(np.max(np.nan_to_num(error / sigma, nan=np.inf)))
        self.outputs.valid_outputs.append(
            ValidOutput(orientation.topic, stamp_ns, log_time_ns, sigmas, float(np.max(over_level)))
        )


class HealthHistory:
    """Detector of new entries in reports on inputs, by comparison with the previous report of the same node and topic.

    A report does not contain the name of its node. Nodes report at the same times in the same order, so the position of
    a report among the reports with its topic and stamp identifies the node.
    """

    def __init__(self) -> None:
        self._place: dict[str, tuple[int, int]] = {}
        self._before: dict[tuple[str, int], tuple[int, Counter[str]]] = {}

    def new_indications(self, report: Any, log_time_ns: int) -> list[FaultIndication]:
        """Return the indications in a report: no data on its topic, or rejections for the source's own fault.

        Rejections by a comparison with other sources are left out here; the innovations contain them.
        """
        topic, stamp_ns = report.topic, ns_from_stamp(report.header.stamp)
        last_ns, place = self._place.get(topic, (stamp_ns, -1))
        place = place + 1 if last_ns == stamp_ns else 0
        self._place[topic] = stamp_ns, place
        received = int(report.received)
        counts = Counter(dict(zip(report.reasons, map(int, report.reason_counts), strict=True)))
        had_received, before = self._before.get((topic, place), (-1, Counter[str]()))
        self._before[topic, place] = received, counts
        new = sorted(counts - before)
        if received == had_received and report.level >= _WARN:
            new.append(NO_DATA)
        signs = [FaultIndication(topic, log_time_ns, stamp_ns, reason) for reason in new]
        return [sign for sign in signs if sign.is_own_fault]

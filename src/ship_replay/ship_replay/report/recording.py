"""A recording as a watch officer would have seen it, second by second, and its evaluation: all data of a report.

The history contains states, events, alerts, rejections and budgets. The bag is processed message by message by
:class:`ship_watch.suite_monitor.SuiteMonitor`. The monitor's buffers hold ten minutes, so new entries are collected
periodically.
"""

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from ship_bags.command_line import start_worker_process
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag, with_bag_progress
from ship_bags.provenance import content_sha256
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import TRUTH_PREFIX, current_names, namespace_of_outputs, relative_topics
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.sources import JOINT_SOLUTION
from ship_replay.evaluation.statistics import reason_name
from ship_replay.offline.replay_summary import STATUS_NAMES
from ship_watch.alerts.alert_conditions import conditions
from ship_watch.alerts.alerts import AlertList, AlertState
from ship_watch.history.history import BudgetPoint, ParameterEstimate, points_after
from ship_watch.history.history_recorder import HistoryRecorder
from ship_watch.orientations import ORIENTATIONS
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import ANGLES, AlertEntry, Event, Safety, SuiteState
from ship_watch.topics import monitored_topic

OUTPUTS = ("ship/attitude", "theodolite/pointing", JOINT_SOLUTION)
ALERTS = "ship/alerts"

OUTPUT_OF_ANGLE = {
    name: "ship/attitude" if name in ("heading", "pitch", "roll") else "theodolite/pointing" for name in ANGLES
}
"""Angle → topic of the output that publishes it."""

_MAX_STATUS_AGE_S = 1.0
"""Maximum time for which the last status of an output counts, s."""

_SAMPLE_PERIOD_NS = NS_PER_S // 2
"""Sampling period of the displayed state, and time resolution of alerts computed here, ns."""

_MIN_READ_PERIOD_NS = NS_PER_S // 5
"""Reading period of topics of which only the newest message matters, ns."""

SHORT_BYTES = 8_000_000
"""Size up to which a bag is read in less time than another process needs to start, bytes."""

_TRUTH_TOPICS = [orientation.truth_topic for orientation in ORIENTATIONS]


@dataclass(frozen=True)
class RecordedAlert:
    """A change of an alert's state; ``what`` names the change, for example raised, acknowledged or over."""

    utc_ns: int
    what: str
    alert: AlertEntry


@dataclass(frozen=True)
class RejectedMeasurement:
    """A measurement that was not used, with source, reason and the place of its rejection: node or filter.

    If ``is_note`` is true, the measurement was used, with a note.
    """

    utc_ns: int
    source: str
    reason: str
    by: str
    count: int = 1
    is_note: bool = False


@dataclass
class RecordedHistory:
    """States, events, alerts, rejections and budgets of one recording.

    Attributes:
        path: path of the bag.
        sha256: hash of the bag from :func:`content_sha256`.
        start_ns: log time of the first message.
        end_ns: log time of the last message.
        limits: limits of the ship from which the states follow.
        topics: relative topic → message type.
        attachments: attachments of the bag.
        metadata: metadata records of the bag.
        safety_states: angle → (second in UTC, worst state) for each second in which the angle was published.
        accuracy: angle → (UTC in ns, 1.96 sigma in rad), twice a second; no value while the
            output is INVALID or old.
        status_s: topic of an output → status → total time with this status, s.
        events: events in the order in which they were reported.
        alerts: changes of alerts, in order of time.
        alerts_are_recorded: True if an alert node published the alerts, False if the alerts were computed here.
        rejections: rejections and notes, in order of time.
        budgets: topic → points of the error budget.
        first_estimates: topic → first published estimates.
        last_estimates: topic → last published estimates.
        last: displayed state at the end.
        problems: problems of the bag, one line each.
    """

    path: Path
    sha256: str
    start_ns: int
    end_ns: int
    limits: Limits
    topics: Mapping[str, str]
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
    safety_states: dict[str, list[tuple[int, Safety]]] = field(default_factory=dict)
    accuracy: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    status_s: dict[str, dict[str, float]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    alerts: list[RecordedAlert] = field(default_factory=list)
    alerts_are_recorded: bool = False
    rejections: list[RejectedMeasurement] = field(default_factory=list)
    budgets: dict[str, list[BudgetPoint]] = field(default_factory=dict)
    first_estimates: dict[str, tuple[ParameterEstimate, ...]] = field(default_factory=dict)
    last_estimates: dict[str, tuple[ParameterEstimate, ...]] = field(default_factory=dict)
    last: SuiteState | None = None
    problems: list[str] = field(default_factory=list)

    @property
    def start_utc_ns(self) -> int:
        """UTC of the first safety state of an angle, or else the log time of the first message, in whole seconds."""
        first_s = min(
            (words[0][0] for words in self.safety_states.values() if words), default=self.start_ns // NS_PER_S
        )
        return first_s * NS_PER_S

    @property
    def span_ns(self) -> tuple[int, int]:
        """UTC at which the outputs begin, and this time plus the difference of last and first log time, ns."""
        return self.start_utc_ns, self.start_utc_ns + self.end_ns - self.start_ns

    @property
    def attached_texts(self) -> dict[str, str]:
        """Name → text of the configurations attached to the bag."""
        return {
            name: data.decode(errors="replace")
            for name, data in sorted(self.attachments.items())
            if name.endswith((".yaml", ".yml"))
        }

    def seconds(self, angle: str) -> Counter[Safety]:
        """Return state → number of seconds in which this state was the worst state of an angle."""
        return Counter(word for _, word in self.safety_states.get(angle, ()))


def read_recording(path: Path, limits: Limits | None = None, namespace: str = "") -> RecordedHistory:
    """Read a bag with outputs of the suite.

    Raises:
        BadInput: the bag cannot be read or contains no output.
    """
    limits = limits or Limits()
    with read_bag(path) as bag:
        topics = relative_topics(bag.topics, namespace_of_outputs(bag.topics, namespace, OUTPUTS))
        if not any(topic in topics for topic in OUTPUTS):
            found = ", ".join(sorted(bag.topics)) or "none"
            raise BadInput(
                f"no outputs of the suite: expected topic {' or '.join(OUTPUTS)}, as replay writes them; found {found}",
                file=path,
            )
        recording = RecordedHistory(
            path, content_sha256(path), bag.start_ns, bag.end_ns, limits,
            {topic: bag.topics[name] for topic, name in topics.items()}, dict(bag.attachments), dict(bag.metadata),
        )
        _RecordingReader(recording, ALERTS in topics).read(bag, {name: topic for topic, name in topics.items()})
        recording.problems = bag.problems
    return recording


class _ReportHistoryKeeper(HistoryRecorder):
    """History of states, budgets and parameters only; errors and innovations are taken from the evaluation."""

    def record_error(self, topic: str, message: Any) -> None:
        """Ignore an error message."""

    def record_innovation(self, source: str, message: Any, now_ns: int) -> None:
        """Ignore an innovation."""

    def record_input(self, topic: str, message: Any, now_ns: int) -> None:
        """Ignore an input with stars or lights."""


class _RecordingReader:
    """Reader of one bag, in one pass."""

    def __init__(self, recording: RecordedHistory, alerts_are_recorded: bool) -> None:
        self._recording, self._watch = recording, SuiteMonitor(recording.limits, _ReportHistoryKeeper)
        recording.alerts_are_recorded = alerts_are_recorded
        self._alert_states = AlertList(recording.limits.alerts, (), recording.start_ns)
        self._last_alerts: dict[tuple[str, int], AlertEntry] = {}
        self._history = self._watch.history
        self._last_event: Event | None = None
        self._last_point_ns: dict[str, int] = {}
        self._rejected: dict[str, int] = {}
        self._reason_counts: dict[tuple[str, str], int] = {}
        self._last_status: dict[str, tuple[int, str]] = {}

    def read(self, bag: Bag, topics: Mapping[str, str]) -> None:
        # Topics of the truth are not read: errors are taken from the evaluation.
        rows = {
            name: row
            for name, topic in topics.items()
            if not topic.startswith(TRUTH_PREFIX) and (row := monitored_topic(topic, bag.topics[name]))
        }
        newest: dict[str, int] = {}
        next_ns = self._recording.start_ns + _SAMPLE_PERIOD_NS
        for record in with_bag_progress(bag.records(set(rows)), bag, "reading"):
            now_ns = record.log_time_ns
            while next_ns <= now_ns:
                self._sample_state(next_ns)
                next_ns += _SAMPLE_PERIOD_NS
            if rows[record.topic].keeps_every_message or now_ns - newest.get(record.topic, 0) >= _MIN_READ_PERIOD_NS:
                newest[record.topic] = now_ns
                self._process_message(topics[record.topic], record)
        self._sample_state(self._recording.end_ns)

    def _process_message(self, topic: str, record: BagRecord) -> None:
        message = record.decode()
        if topic.endswith("/innovation"):
            self._record_rejection(message)
        elif topic == "input_health":
            self._record_health(message)
        elif topic in OUTPUT_OF_ANGLE.values():
            self._count_status(topic, message, record.log_time_ns)
        self._watch.process_message(topic, message, record.log_time_ns)
        if topic == ALERTS:
            self._record_alerts(self._watch.current_state(record.log_time_ns))
        if self._watch.history is not self._history:
            self._collect_history()
            self._history = self._watch.history

    def _sample_state(self, now_ns: int) -> None:
        state = self._watch.current_state(now_ns)
        recording = self._recording
        for angle in state.angles:
            is_invalid = self._last_status.get(OUTPUT_OF_ANGLE[angle.name], (0, ""))[1] == "INVALID"
            if state.utc_ns and not angle.is_old and not is_invalid and math.isfinite(angle.accuracy_95):
                recording.accuracy.setdefault(angle.name, []).append((state.utc_ns, angle.accuracy_95))
        fresh: list[Event] = []
        for event in state.events:
            if event is self._last_event:
                break
            fresh.append(event)
        if fresh:
            self._last_event = fresh[0]
            recording.events += reversed(fresh)
        if not recording.alerts_are_recorded and state.utc_ns:
            changes = self._alert_states.update(conditions(state, recording.limits), now_ns, state.utc_ns)
            # Alerts computed here are never acknowledged and would be repeated.
            recording.alerts += [
                RecordedAlert(state.utc_ns, change.description, change.alert)
                for change in changes
                if not change.description.startswith("repeated")
            ]
        recording.last = state
        self._collect_history()

    def _collect_history(self) -> None:
        """Append the new entries of the buffers to the recording."""
        recording = self._recording
        for point in self._new_points("", self._history.safety):
            for name in ANGLES:
                if (word := point.safety.get(name)) is not None:
                    recording.safety_states.setdefault(name, []).append((point.utc_ns // NS_PER_S, word))
        for topic, points in self._history.budgets.items():
            recording.budgets.setdefault(topic, []).extend(self._new_points(topic, points))
        for topic, shown in (
            ("ship/alignment", self._history.alignment), ("theodolite/calibration", self._history.calibration)
        ):
            if shown:
                recording.first_estimates.setdefault(topic, shown)
                recording.last_estimates[topic] = shown

    def _new_points(self, name: str, points: Sequence[Any]) -> list[Any]:
        found = points_after(points, self._last_point_ns.get(name))
        if found:
            self._last_point_ns[name] = found[-1].utc_ns
        return found

    def _count_status(self, topic: str, message: Any, now_ns: int) -> None:
        """Add the duration of the previous status, at most one second; the last status of a bag is not counted."""
        since_ns, word = self._last_status.get(topic, (now_ns, ""))
        if word:
            stood_s = min((now_ns - since_ns) / NS_PER_S, _MAX_STATUS_AGE_S)
            of_topic = self._recording.status_s.setdefault(topic, {})
            of_topic[word] = of_topic.get(word, 0.0) + stood_s
        word = STATUS_NAMES[message.status] if message.status < len(STATUS_NAMES) else "unknown"
        self._last_status[topic] = now_ns, word

    def _record_rejection(self, message: Any) -> None:
        if not message.accepted:
            stamp_ns = ns_from_stamp(message.header.stamp)
            rejected = RejectedMeasurement(stamp_ns, str(message.source), reason_name(message), "filter")
            self._recording.rejections.append(rejected)

    def _record_health(self, message: Any) -> None:
        """Record rejections and notes from input_health.

        A count below the previous one means that the node restarted.
        """
        stamp_ns, topic = ns_from_stamp(message.header.stamp), str(message.topic)
        rejected = int(message.rejected)
        is_note = rejected == self._rejected.get(topic, 0)
        self._rejected[topic] = rejected
        for reason, count in zip(message.reasons, message.reason_counts, strict=False):
            before = self._reason_counts.get((topic, str(reason)), 0)
            self._reason_counts[topic, str(reason)] = int(count)
            more = int(count) - (before if count >= before else 0)
            if more:
                by_node = RejectedMeasurement(stamp_ns, topic, str(reason), "node", more, is_note)
                self._recording.rejections.append(by_node)

    def _record_alerts(self, state: SuiteState) -> None:
        alerts = {(alert.id, alert.instance): alert for alert in state.alerts or ()}
        for key, alert in alerts.items():
            if key not in self._last_alerts or self._last_alerts[key].state != alert.state:
                what = AlertState(alert.state).name.lower().replace("_", " ")
                self._recording.alerts.append(RecordedAlert(alert.changed_ns, what, alert))
        self._recording.alerts += [
            RecordedAlert(state.utc_ns, "over", alert) for key, alert in self._last_alerts.items() if key not in alerts
        ]
        self._last_alerts = alerts


@dataclass(frozen=True)
class ReportData:
    """A recording and its evaluation: all data of a report page."""

    recording: RecordedHistory
    evaluation: Evaluation


def read_report_data(
    path: Path, truth: Path | None = None, limits: Limits | None = None, namespace: str = ""
) -> ReportData:
    """Read and evaluate a bag with outputs.

    Raises:
        BadInput: a bag cannot be read or lacks a required topic.
    """
    check_truth(truth, namespace)
    if is_short(path):
        return ReportData(read_recording(path, limits, namespace), evaluate(path, against=truth, namespace=namespace))
    # Reading and evaluation take equally long and are independent.
    with process_pool(1) as others:
        evaluated = others.submit(evaluate, path, against=truth, namespace=namespace)
        return ReportData(read_recording(path, limits, namespace), evaluated.result())


@contextlib.contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Start a pool of processes that are terminated if this process fails or is interrupted.

    The processes are spawned: a fork would copy locks held by threads. The processes of the pool must not start other
    processes, which would not be terminated.
    """
    known = {process.pid for process in active_children()}
    context, begin = get_context("spawn"), partial(start_worker_process, current_names())
    with ProcessPoolExecutor(count, mp_context=context, initializer=begin) as executor:
        try:
            yield executor
        except BaseException:
            for process in active_children():
                if process.pid not in known:
                    process.terminate()
            raise


def is_short(path: Path) -> bool:
    """True if a bag is so short that a second process would not save time."""
    return path.is_file() and path.stat().st_size <= SHORT_BYTES


def check_truth(path: Path | None, namespace: str) -> None:
    """Raise an error if a bag given for its truth has no truth topic.

    Raises:
        BadInput: the bag has no truth topic, or cannot be read.
    """
    if path is not None and not has_truth(path, namespace):
        raise BadInput(f"no truth: expected topic {' or '.join(_TRUTH_TOPICS)}", file=path)


def has_truth(path: Path, namespace: str) -> bool:
    """True if a bag contains a truth topic of an orientation.

    Raises:
        BadInput: the bag cannot be read.
    """
    with read_bag(path) as bag:
        topics = relative_topics(bag.topics, namespace)
        return any(topic in topics for topic in _TRUTH_TOPICS)

"""Common adapter of all nodes, with a core that returns given outcomes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_estimation.parameters.fields import autosave_period, parameter, sources_off
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import MeasurementDecision, Outcome, Status
from ship_node.adapters.adapter import Feed, Overload, ignore_time
from ship_node.adapters.node_adapter import NodeAdapter
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_node.messages.inputs_outputs import InputTopic, OutputMessage
from ship_node.saved_files.saved_document import DISK, SavedFormat, section, stamp_ns
from ship_node.saved_files.saved_start import SavedStart
from ship_testing.one_message import process_message

FACTORY = RosidlFactory()
NOW_NS = 1_400_000_000_000_000_000
S = 1_000_000_000
FAST, CHECKED = "fast", "checked"


@dataclass(frozen=True)
class TinyConfig:
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = parameter(10.0, doc="age", unit="s", minimum=0.1, maximum=100.0)
    alignment_autosave_s: float = autosave_period()
    slow_topics_period_s: float = parameter(1.0, doc="period", unit="s", minimum=0.1, maximum=10.0, live=True)


@dataclass(frozen=True)
class Value:
    time_ns: int
    source: str = "camera"
    covariance_known: bool = True


@dataclass
class TinyCore:
    """Core that returns ``next``, or raises ``next`` if that is an exception."""

    next: Any = field(default_factory=Outcome)
    calls: list[Any] = field(default_factory=list)

    def add(self, value: Value, waiting_ns: int) -> Any:
        self.calls.append((value, waiting_ns))
        if isinstance(self.next, Exception):
            raise self.next
        return self.next

    def tick(self, now_ns: int, waiting_ns: int) -> Any:
        return Outcome()

    def reset(self, clock_jumped: bool) -> None:
        self.calls.append(("reset", clock_jumped))

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        self.calls.append(("set_duplicate_publishers", source, text))

    def reconfigure(self, config: TinyConfig) -> None:
        self.calls.append(config)


def read(message: Any, receive_ns: int, scale: int = 1) -> ReadMessage[Value]:
    if message.bad is not None:
        raise MessageRejected(message.bad, "as in the message")
    left_out = tuple((name, Rejection(Reason.UNITS, "degrees?")) for name in message.left_out)
    return ReadMessage(Value(message.stamp_ns), message.known, left_out, message.empty)


class TinyAdapter(NodeAdapter):
    node_name, config_type, services = "tiny", TinyConfig, ("reset", "save_alignment", "load_alignment")
    main_topic, innovation_topic = "tiny/value", "tiny/innovation"
    required_sources = ("fast",)
    slow_fails = False

    def table(self, config: TinyConfig, core: Any) -> Iterator[Feed]:
        yield Feed(InputTopic(FAST, "t", True, 10), "fast", read, ignore_time(partial(core.add, waiting_ns=0)))
        yield Feed(InputTopic(CHECKED, "t", False, 10), "device", read, core.add, True, "camera")

    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        if self.slow_fails:
            raise RuntimeError("a defect")
        return [("tiny/slow", now_ns)]

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        return [DiagnosticStatus("own", Level.OK, "well"), *self.conflict_statuses()]


@pytest.fixture
def adapter() -> TinyAdapter:
    return TinyAdapter(TinyConfig(), TinyCore(), FACTORY, lambda estimate: [("tiny/value", estimate)])


def message(**changes: Any) -> Any:
    stamp = SimpleNamespace(sec=NOW_NS // S, nanosec=5)
    given = {"stamp_ns": NOW_NS, "bad": None, "left_out": (), "known": True, "empty": False}
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), **(given | changes))


def statuses_of(adapter: TinyAdapter, now_ns: int) -> list[DiagnosticStatus]:
    return adapter.health.messages_and_statuses(FACTORY, now_ns, now_ns)[1]


def health(adapter: TinyAdapter, topic: str) -> Any:
    (of_topic,) = [m for m in adapter.health.messages(FACTORY, NOW_NS) if m.topic == topic]
    reasons = dict(zip(of_topic.reasons, of_topic.reason_counts, strict=True))
    return of_topic.received, of_topic.accepted, of_topic.rejected, reasons


def test_a_message_without_rejection_is_used_and_its_estimate_published(adapter: TinyAdapter) -> None:
    estimate = SimpleNamespace(status=Status.VALID)
    adapter.core.next = Outcome(estimates=[estimate])
    assert process_message(adapter, FAST, message(), NOW_NS) == [("tiny/value", estimate)]
    assert (adapter.latest, adapter.pending_budget) == (estimate, estimate)
    assert health(adapter, FAST) == (1, 1, 0, {})


def test_an_invalid_estimate_has_no_budget(adapter: TinyAdapter) -> None:
    adapter.core.next = Outcome(estimates=[SimpleNamespace(status=Status.INVALID)])
    process_message(adapter, FAST, message(), NOW_NS)
    assert adapter.pending_budget is None


@pytest.mark.parametrize(("reason", "stamp_ns"), [(Reason.FRAME, NOW_NS + 5), (Reason.BAD_STAMP, NOW_NS + 7)])
def test_an_unreadable_message_is_reported_at_its_stamp_if_valid(
    adapter: TinyAdapter, reason: Reason, stamp_ns: int
) -> None:
    ((topic, report),) = process_message(adapter, CHECKED, message(bad=reason), NOW_NS + 7)
    assert (topic, report.source, report.reason, report.accepted) == ("tiny/innovation", "device", reason, False)
    assert report.header.stamp.sec * S + report.header.stamp.nanosec == stamp_ns
    assert health(adapter, CHECKED) == (1, 0, 1, {reason.word: 1})
    assert adapter.core.calls == []


def test_rejections_by_the_core_and_rejected_parts_are_reported_and_counted(adapter: TinyAdapter) -> None:
    adapter.core.next = Outcome(Rejection(Reason.LATE, "too late"))
    published = process_message(adapter, CHECKED, message(left_out=("a", "b"), known=False), NOW_NS)
    assert [report.reason_text for _, report in published] == ["a: degrees?", "b: degrees?", "too late"]
    assert health(adapter, CHECKED) == (1, 0, 1, {"covariance_unknown": 1, "units": 2, "late": 1})


def test_an_empty_message_counts_and_the_core_is_not_called(adapter: TinyAdapter) -> None:
    assert process_message(adapter, CHECKED, message(empty=True), NOW_NS) == []
    assert health(adapter, CHECKED) == (1, 1, 0, {})
    assert adapter.core.calls == []


def test_an_exception_of_the_core_is_raised_and_the_arrival_counted(adapter: TinyAdapter) -> None:
    adapter.core.next = RuntimeError("a defect")
    with pytest.raises(RuntimeError):
        process_message(adapter, FAST, message(), NOW_NS)
    assert health(adapter, FAST) == (1, 0, 0, {})


def test_decisions_are_counted_by_topic_and_reported_by_source(adapter: TinyAdapter) -> None:
    used, rejected = (
        MeasurementDecision(Value(NOW_NS), reason, used, ("up",), np.array([1e-5]), np.array([1e-5]), 1.0, 6.6, text)
        for reason, used, text in ((Reason.NONE, True, ""), (Reason.GATE, False, "too far"))
    )
    adapter.core.next = Outcome(decisions=[used, rejected])
    sent = [m for _, m in process_message(adapter, CHECKED, message(), NOW_NS)]
    assert list(adapter.innovation_report.pending) == [("device", used), ("device", rejected)]
    assert [(m.source, m.accepted, m.reason_text) for m in sent] == [("device", True, ""), ("device", False, "too far")]
    assert health(adapter, CHECKED) == (1, 1, 1, {"gate": 1})


def test_a_conflict_is_in_the_diagnostics_until_the_source_is_used_again(adapter: TinyAdapter) -> None:
    adapter.core.next = Outcome(
        decisions=[MeasurementDecision(Value(NOW_NS), Reason.ATTITUDE_CONFLICT, text="they disagree")]
    )
    process_message(adapter, CHECKED, message(), NOW_NS)
    assert adapter.conflict_statuses() == [DiagnosticStatus("conflict device", Level.ERROR, "they disagree")]
    adapter.core.next = Outcome(decisions=[MeasurementDecision(Value(NOW_NS), Reason.NONE, accepted=True)])
    process_message(adapter, CHECKED, message(), NOW_NS)
    assert adapter.conflict_statuses() == []


def test_a_failed_output_is_reported(adapter: TinyAdapter) -> None:
    adapter.core.next = Outcome(failures=[(NOW_NS, Rejection(Reason.FAILED, "a defect"))])
    ((_, report),) = process_message(adapter, FAST, message(), NOW_NS)
    assert (report.source, report.reason) == ("tiny/value", Reason.FAILED)
    assert adapter.health.take_failures() == ["tiny/value: a defect"]


def test_slow_topics_are_published_once_a_period_and_their_failure_is_reported(adapter: TinyAdapter) -> None:
    topics = [topic for topic, _ in adapter.tick(NOW_NS)]
    assert topics == ["tiny/slow", "input_health", "input_health", "/diagnostics"]
    assert adapter.tick(NOW_NS + S // 2) == []
    adapter.slow_fails = True
    ((_, report),) = adapter.tick(NOW_NS + S)
    assert (report.source, report.reason) == ("slow topics", Reason.FAILED)
    adapter.set_parameters({"slow_topics_period_s": 5.0})
    adapter.slow_fails = False
    assert adapter.tick(NOW_NS + 2 * S) != []
    assert adapter.tick(NOW_NS + 6 * S) == []
    assert adapter.core.calls[-1].slow_topics_period_s == 5.0


def test_a_reset_and_a_clock_jump_reset_the_outputs(adapter: TinyAdapter) -> None:
    adapter.core.next = Outcome(estimates=[SimpleNamespace(status=Status.VALID)])
    process_message(adapter, FAST, message(), NOW_NS)
    assert adapter.clock_jumped_back(NOW_NS - S) == []
    assert (adapter.latest, adapter.pending_budget, adapter.clock_jumps) == (None, None, 1)
    assert adapter.service("reset", NOW_NS) == (True, "the filter was reset")
    assert adapter.core.calls[-2:] == [("reset", True), ("reset", False)]


def test_the_core_starts_from_the_saved_document_at_the_first_time(tmp_path: Path) -> None:
    kind = SavedFormat(
        "tiny",
        1,
        "alignment",
        document=lambda value: {"time_ns": value.time_ns},
        content=lambda document: Value(section(document, "time_ns", stamp_ns)),
    )
    path, given, kept = tmp_path / "saved.yaml", [], [None, Value(NOW_NS)]

    def start_from(value: Value, now_ns: int) -> list[str]:
        given.append((value.time_ns, now_ns))
        return ["of another voyage"]

    def new(path_text: str) -> TinyAdapter:
        saved = SavedStart(kind, path_text, DISK, start_from, lambda: kept[0], "there is nothing to save")
        return TinyAdapter(TinyConfig(), TinyCore(), FACTORY, saved=saved)

    adapter = new(str(path))
    assert adapter.notices == [f"no alignment at {path} yet: the filter starts as configured"]
    assert adapter.service("save_alignment", NOW_NS) == (False, "there is nothing to save")
    assert "parameter 'alignment_file' is empty" in new("").service("save_alignment", NOW_NS).message
    kept.reverse()
    assert adapter.service("save_alignment", NOW_NS) == (True, f"alignment saved to {path}")
    later = new(str(path))
    assert (given, later.notices) == ([], [])
    later.tick(NOW_NS + 600 * S)
    later.tick(NOW_NS + 601 * S)
    assert given == [(NOW_NS, NOW_NS + 600 * S)]
    assert later.notices == [f"alignment {path}, 10 min old; of another voyage"]
    answer = later.service("load_alignment", NOW_NS)
    assert answer == (True, f"alignment loaded from {path}; of another voyage")
    for with_or_without in (later, TinyAdapter(TinyConfig(), TinyCore(), FACTORY)):
        assert with_or_without.service("explode", NOW_NS) == (False, "tiny has no service 'explode'")


def off_text(adapter: TinyAdapter) -> list[tuple[int, str]]:
    """Return the diagnostics about sources that are off."""
    adapter.next_slow_ns = None
    (array,) = [m for topic, m in adapter.tick(NOW_NS) if topic == "/diagnostics"]
    return [(status.level, status.message) for status in array.status if "sources off" in status.name]


def test_a_source_that_is_off_is_counted_and_not_passed_to_the_core(adapter: TinyAdapter) -> None:
    adapter.set_parameters({"sources_off": ["device", "device"]})
    (config,) = adapter.core.calls
    assert config is adapter.config
    assert config.sources_off == ("device", "device")
    for number in range(30):
        ((topic, one),) = process_message(adapter, CHECKED, message(left_out=("polaris",)), NOW_NS + number * S // 10)
        assert (topic, one.source, one.reason, one.accepted) == ("tiny/innovation", "device", Reason.OFF, False)
    ((_, unread),) = process_message(adapter, CHECKED, message(bad=Reason.UNITS), NOW_NS + 3 * S)
    assert unread.reason == Reason.UNITS
    assert adapter.core.calls == [config]
    assert health(adapter, CHECKED) == (31, 0, 31, {"units": 31, "off": 30})
    assert off_text(adapter) == [(1, "switched off by sources_off: device")]


def test_a_source_that_is_off_has_no_consecutive_rejections(adapter: TinyAdapter) -> None:
    adapter.set_parameters({"sources_off": ["device"]})
    for number in range(30):
        process_message(adapter, CHECKED, message(), NOW_NS + number * S // 10)
    (status,) = [s for s in statuses_of(adapter, NOW_NS + 3 * S) if s.name == f"input {CHECKED}"]
    assert (status.level, status.message) == (Level.WARN, "rejected, off: switched off by sources_off")


def test_a_source_switched_on_is_used_from_its_next_message(adapter: TinyAdapter) -> None:
    adapter.set_parameters({"sources_off": ["device"]})
    process_message(adapter, CHECKED, message(), NOW_NS)
    adapter.set_parameters({"sources_off": []})
    adapter.core.calls.clear()
    assert process_message(adapter, CHECKED, message(), NOW_NS + S) == []
    assert adapter.core.calls == [(Value(NOW_NS), NOW_NS + S)]
    assert off_text(adapter) == []


@pytest.mark.parametrize(
    ("source", "expected"), [("camera", "expected some of device"), ("fast", "'fast' cannot be switched off")]
)
def test_a_source_that_cannot_be_switched_off_is_refused(
    adapter: TinyAdapter, source: str, expected: str
) -> None:
    adapter.set_parameters({"sources_off": ["device"]})
    before, calls = adapter.config, list(adapter.core.calls)
    with pytest.raises(ParameterError, match=expected):
        adapter.set_parameters({"sources_off": [source]})
    assert (adapter.config, adapter.core.calls, CHECKED in adapter.off_topics) == (before, calls, True)
    with pytest.raises(ParameterError, match=expected):
        TinyAdapter(TinyConfig(sources_off=(source,)), TinyCore(), FACTORY)


def test_an_overloaded_node_publishes_invalid_with_the_reason(adapter: TinyAdapter) -> None:
    adapter.no_output = lambda now_ns, text: SimpleNamespace(status=Status.INVALID, text=text)  # type: ignore[method-assign]
    why = "tiny is 3.2 s behind: the computer is too slow (2 cores, load 12)"
    published = adapter.overload(Overload(3.2, 2, 12.0, {FAST: 320, CHECKED: 5}), NOW_NS)
    output = [(m.source, m.reason, m.reason_text) for topic, m in published if topic == "tiny/innovation"]
    assert output == [
        ("fast", Reason.BEHIND, f"320 messages dropped: {why}"),
        ("device", Reason.BEHIND, f"5 messages dropped: {why}"),
        ("tiny", Reason.BEHIND, why),
    ]
    ((_, invalid),) = [message for message in published if message[0] == "tiny/value"]
    assert (invalid.status, invalid.text) == (Status.INVALID, why)
    assert health(adapter, FAST) == (320, 0, 320, {"behind": 320})
    statuses = {status.name: status for status in statuses_of(adapter, NOW_NS)}
    assert statuses[f"input {FAST}"].level is Level.WARN
    assert "rejected, behind: 320 messages dropped" in statuses[f"input {FAST}"].message

    adapter.core.next = Outcome(estimates=[SimpleNamespace(status=Status.VALID)])
    assert process_message(adapter, FAST, message(), NOW_NS + 1) == []
    assert adapter.latest is invalid
    ticks = [adapter.tick(NOW_NS + tenth * S // 10) for tenth in range(1, 21)]
    assert [tenth for tenth, output in enumerate(ticks, 1) if "tiny/value" in dict(output)] == [10, 20]
    *_, array = [message for output in ticks for topic, message in output if topic == "/diagnostics"]
    (status,) = [status for status in array.status if status.name == "tiny: overload"]
    assert (status.level, status.message) == (Level.ERROR, why)

    assert adapter.overload(Overload(0.0, 2, 12.0), NOW_NS + 3 * S) == []
    assert process_message(adapter, FAST, message(), NOW_NS + 3 * S) == [("tiny/value", adapter.core.next.estimates[0])]
    assert adapter.latest.status is Status.VALID


def test_cut_messages_cause_no_timeout(adapter: TinyAdapter) -> None:
    for tenth in range(10):
        process_message(adapter, FAST, message(), NOW_NS + tenth * S // 10)
    adapter.overload(Overload(3.2, 2, 12.0, {FAST: 30}), NOW_NS + 4 * S)
    (status,) = [s for s in statuses_of(adapter, NOW_NS + 4 * S) if s.name == f"input {FAST}"]
    assert "no data for" not in status.message


def test_duplicate_publishers_reach_core_and_health_unless_the_source_is_off(adapter: TinyAdapter) -> None:
    adapter.set_duplicate_publishers(CHECKED, "two publishers send")
    assert adapter.core.calls == [("set_duplicate_publishers", "camera", "two publishers send")]
    (status,) = [status for status in statuses_of(adapter, NOW_NS) if status.name == f"input {CHECKED}"]
    assert (status.level, status.message) == (Level.ERROR, "two publishers send")
    adapter.set_parameters({"sources_off": ["device"]})
    assert adapter.core.calls[-1] == ("set_duplicate_publishers", "camera", "")
    adapter.set_parameters({"sources_off": []})
    assert adapter.core.calls[-1] == ("set_duplicate_publishers", "camera", "two publishers send")
    adapter.set_duplicate_publishers(CHECKED, "")
    assert adapter.core.calls[-1] == ("set_duplicate_publishers", "camera", "")
    (status,) = [status for status in statuses_of(adapter, NOW_NS) if status.name == f"input {CHECKED}"]
    assert status.level is Level.OK

"""One source of sentences: its lines are converted to messages, and the outcome of each line is counted.

A source uses the datagrams of one sender. Datagrams of two instruments, or of an instrument and of a foreign host,
would be mixed on one topic. If the clock of one sender is ahead, the attitudes of the other sender would be too late.
The first sender with usable data is therefore selected until it times out.
"""

import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from ship_bags.message_factory import MessageFactory
from ship_bags.nmea.instrument import WEATHER, Instrument, InstrumentRole
from ship_bags.nmea.instrument_lines import InstrumentLine, LineReport, ParsedText, TalkerComparison, clock_problem
from ship_bags.nmea.nmea_attitude import NOT_LATER
from ship_bags.nmea.sentences import NotOfInterest, Unusable, number
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_nmea.instruments.config import ARRIVAL_TIME, NmeaSourceConfig
from ship_node.messages.common_messages import DiagnosticStatus, Level

SENDER_TIMEOUT_NS = 10 * NS_PER_S
"""Time without a text of the selected sender after which another sender may be selected, ns."""

NOT_LISTED = "sender that is not in 'from'"
NOT_SELECTED = "sender other than the first (name the instrument's address in 'from')"

NO_TIME = "no time: no /clock yet"

WARNING_NS = 10 * NS_PER_S
"""Time for which a past problem remains in the status, ns."""

_BACKWARD_JUMP_NS = NS_PER_S
"""Backward jump of the node's time beyond which the conversion (:class:`Instrument`) is reset, ns."""

_CLOCK_CORRECTED_NS = 3 * NS_PER_S
"""Time without a message on a required topic, ns, after which a rejection as NOT_LATER may reset the conversion.

The conversion is reset if the last stamp on a required topic is later than the arrival of the text."""

_MAX_CHARACTERS = 60
_MAX_NAMES, _MAX_LISTED, _MAX_NAME_LENGTH, _OTHERS = 50, 10, 12, "others"


class SenderFilter:
    """Selects the sender whose datagrams are used.

    Args:
        addresses: allowed addresses, each with any port; if empty, one port of any address is selected.

    Attributes:
        selected: the selected sender; empty if no sender is selected.
    """

    def __init__(self, addresses: tuple[str, ...]) -> None:
        self._addresses = addresses
        self.selected = ""
        self._last_ns = 0

    def rejection_reason(self, sender: str, now_ns: int) -> str:
        """Return why a text of a sender is rejected; empty if the text is used.

        A text of the selected sender restarts the timeout of the selection.

        Args:
            sender: address and port, for example ``10.0.0.7:4001``; empty for a stream, which has one sender.
            now_ns: steady time.
        """
        identity = self._identity(sender)
        if self._addresses and sender and identity not in self._addresses:
            return NOT_LISTED
        if self.selected and now_ns - self._last_ns > SENDER_TIMEOUT_NS:
            self.selected = ""
        if self.selected and identity != self.selected:
            return NOT_SELECTED
        if self.selected:
            self._last_ns = now_ns
        return ""

    def select(self, sender: str, now_ns: int) -> None:
        """Select a sender whose data are usable."""
        self.selected, self._last_ns = self._identity(sender), now_ns

    def _identity(self, sender: str) -> str:
        return sender.rpartition(":")[0] if self._addresses else sender


@dataclass
class LiveReport(LineReport):
    """Outcome of a live source's lines; its size is bounded.

    Attributes:
        talkers: talker that the configuration does not accept → number of its sentences.
        senders: sender that is not used → number of its texts.
        last_rejected: reason → the line last rejected for this reason, shortened.
        rejected_ns: reason → steady time of the last rejection.
        now_ns: steady time of the line being processed.
    """

    talkers: Counter[str] = field(default_factory=Counter)
    senders: Counter[str] = field(default_factory=Counter)
    last_rejected: dict[str, str] = field(default_factory=dict)
    rejected_ns: dict[str, int] = field(default_factory=dict)
    now_ns: int = 0

    def reject(self, reason: str, line: int, text: str) -> None:
        """See :meth:`LineReport.reject`."""
        self.rejected[reason] += 1
        self.rejected_ns[reason] = self.now_ns
        self.last_rejected[reason] = quoted_text(text)

    def count_unused(self, name: str) -> None:
        """Count a sentence that is not of interest."""
        _count(self.unused, name[:_MAX_NAME_LENGTH])

    def reject_sender(self, reason: str, sender: str, text: str) -> None:
        """Count a text of a sender that is not used."""
        self.reject(reason, self.lines, f"{sender} {text}")
        _count(self.senders, sender)

    def count_other_talker(self, talker: str) -> None:
        """Count a sentence of a talker that the configuration does not accept."""
        _count(self.talkers, talker)


class Source:
    """Converts received sentences to messages in one thread, and reports its status in another.

    Args:
        id_: id of the source.
        config: configuration of the source.
        role: kind of messages made from the lines.
        factory: makes the messages.
        now_ns: steady time.
    """

    def __init__(
        self, id_: str, config: NmeaSourceConfig, role: InstrumentRole, factory: MessageFactory, now_ns: int
    ) -> None:
        self.id, self.config = id_, config
        self.topics = role.topics(id_)
        self._role, self._factory = role, factory
        self._report = LiveReport(id_)
        self._instrument = Instrument(factory, role, id_, self._report)
        self._sender = SenderFilter(config.from_)
        self._lock = threading.Lock()
        self._arrival_ns = self._stamp_ns = 0
        self._received_ns = self._published_ns = self._reported_ns = now_ns
        self._published: Counter[str] = Counter()
        self._heave_m: float | None = None
        self._published_before = 0
        # The times of the last problems are initialised so far in the past that no warning results.
        self._dropped, self._dropped_ns = 0, now_ns - 2 * WARNING_NS
        self._clock_problem, self._clock_problem_ns = "", now_ns - 2 * WARNING_NS
        self._talkers = TalkerComparison()
        # A weather station must provide any of its quantities. Another source must provide its first topic, for example
        # an INS its attitudes.
        self._required_topics = tuple(self.topics) if role.becomes == WEATHER else tuple(self.topics)[:1]

    def convert(self, received: ParsedText, arrival_ns: int, now_ns: int, sender: str = "") -> list[tuple[str, Any]]:
        """Return topic and message of each message of the next text; the messages are counted as published.

        Args:
            received: the text and its parsed content.
            arrival_ns: arrival by the node's time; 0 if the node has no time yet.
            now_ns: steady time.
            sender: address and port of a datagram; empty for a stream.
        """
        with self._lock:
            self._report.lines += 1
            self._report.now_ns = self._received_ns = now_ns
            if rejection := self._sender.rejection_reason(sender, now_ns):
                self._report.reject_sender(rejection, sender, received.text)
                return []
            messages = self._convert(received, arrival_ns, now_ns)
            if any(topic in self._required_topics for topic, _ in messages):
                self._sender.select(sender, now_ns)
            return messages

    def _convert(self, received: ParsedText, arrival_ns: int, now_ns: int) -> list[tuple[str, Any]]:
        report = self._report
        if arrival_ns < self._arrival_ns - _BACKWARD_JUMP_NS:
            self._instrument = Instrument(self._factory, self._role, self.id, report)
        self._arrival_ns = arrival_ns
        line = self._usable_line(received, arrival_ns)
        not_later = report.rejected[NOT_LATER]
        messages = [] if line is None else [(topic, message) for _, topic, message in self._instrument.take(line)]
        was_ahead = self._stamp_ns > arrival_ns and now_ns - self._published_ns > _CLOCK_CORRECTED_NS
        if was_ahead and report.rejected[NOT_LATER] > not_later:
            # The instrument's clock was corrected: its new stamps are right, and the earlier stamps were wrong.
            self._instrument = Instrument(self._factory, self._role, self.id, report)
        for topic, message in messages:
            self._published[topic] += 1
            stamp_ns = ns_from_stamp(message.header.stamp)
            if topic in self._required_topics:
                self._published_ns, self._stamp_ns = now_ns, stamp_ns
            if problem := clock_problem(arrival_ns - stamp_ns, "this computer's"):
                self._clock_problem, self._clock_problem_ns = problem, now_ns
        return messages

    def _usable_line(self, received: ParsedText, arrival_ns: int) -> InstrumentLine | None:
        parsed, report = received.result, self._report
        if self.config.talkers and received.talker and received.talker not in self.config.talkers:
            report.count_other_talker(received.talker)
        elif isinstance(parsed, NotOfInterest):
            report.count_unused(parsed.name)
        elif isinstance(parsed, Unusable):
            report.reject(parsed.detail or parsed.reason, report.lines, received.text)
        elif arrival_ns == 0:
            report.reject(NO_TIME, report.lines, received.text)
        else:
            report.used[parsed.kind] += 1
            heave_m = number(getattr(parsed.content, "heave", None))
            self._heave_m = self._heave_m if heave_m is None else heave_m
            line = InstrumentLine(report.lines, arrival_ns, parsed.kind, parsed.content, received.talker)
            self._talkers.add(line)
            return line
        return None

    def status(self, problem: str, dropped: int, now_ns: int) -> DiagnosticStatus:
        """Return the status of the source, with the rate of its messages since the last call.

        Args:
            problem: problem of the source's link; empty if the link is open.
            dropped: number of lines of the link that were dropped.
            now_ns: steady time.
        """
        with self._lock:
            return self._status(problem, dropped, now_ns)

    def _status(self, problem: str, dropped: int, now_ns: int) -> DiagnosticStatus:
        if dropped > self._dropped:
            self._dropped, self._dropped_ns = dropped, now_ns
        level, text = self._evaluate(problem, now_ns)
        published = sum(self._published[topic] for topic in self._required_topics)
        span_s = max(now_ns - self._reported_ns, 1) / NS_PER_S
        values = {
            "place": self.config.place,
            "sender": self._sender.selected,
            **({} if self._heave_m is None else {"heave_m": f"{self._heave_m:g}"}),
            "lines": str(self._report.lines),
            "messages_hz": f"{(published - self._published_before) / span_s:.1f}",
            **{topic: str(self._published[topic]) for topic in self.topics},
            **_count_values("used", self._report.used),
            **_count_values("rejected", self._report.rejected),
            **{f"example of {reason}": text for reason, text in sorted(self._report.last_rejected.items())},
            **_count_values("corrected", self._report.corrected),
            **_count_values("not of interest", self._report.unused),
            **_count_values("other talker", self._report.talkers),
            **_count_values("other sender", self._report.senders),
            "dropped": str(dropped),
        }
        self._published_before, self._reported_ns = published, now_ns
        return DiagnosticStatus(f"source {self.id}", level, text, values)

    def _evaluate(self, problem: str, now_ns: int) -> tuple[Level, str]:
        report, limit_ns = self._report, self.config.silent_after_s * NS_PER_S
        topics = " or ".join(self._required_topics)
        recent = [reason for reason, at_ns in report.rejected_ns.items() if now_ns - at_ns <= WARNING_NS]
        wrong = "; ".join(
            f"{reason} {report.rejected[reason]}, as {report.last_rejected[reason]}" for reason in sorted(recent)
        )
        if problem:
            return Level.ERROR, f"{self.config.place}: {problem}; retried"
        if not now_ns - self._received_ns <= limit_ns:
            return Level.ERROR, f"{self.config.place}: no line for {(now_ns - self._received_ns) / NS_PER_S:.0f} s"
        if not now_ns - self._published_ns <= limit_ns:
            others = f", of other talkers {_names(report.talkers)}" if report.talkers else ""
            why = wrong or f"received: {_names(report.unused, report.used) or 'no usable sentences'}{others}"
            silent_s = (now_ns - self._published_ns) / NS_PER_S
            return Level.ERROR, f"lines arrive, but no {topics} for {silent_s:.0f} s: {why}"
        if now_ns - self._dropped_ns <= WARNING_NS:
            return Level.ERROR, f"overflow: input faster than processing; {self._dropped} lines were dropped"
        if now_ns - self._clock_problem_ns <= WARNING_NS:
            advice = f"set the clocks by NTP or PTP, or stamp by time: {ARRIVAL_TIME}"
            return Level.WARN, f"{self._clock_problem}: {advice}"
        if wrong:
            return Level.WARN, wrong
        if several := self._talkers.texts(self._arrival_ns - WARNING_NS):
            return Level.WARN, f"{'; '.join(several)}: choose one with talkers"
        if not any(self._published[topic] for topic in self._required_topics):
            return Level.OK, f"{self.config.place}: waiting for the first {topics}"
        return Level.OK, f"publishes {topics}"


def quoted_text(text: str) -> str:
    """Return a text in quotes, shortened."""
    return repr(text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]}…")


def _count(counts: Counter[str], name: str) -> None:
    """Count a name; names beyond a maximum are counted together."""
    counts[name if name in counts or len(counts) < _MAX_NAMES else _OTHERS] += 1


def _count_values(label: str, counts: Counter[str]) -> dict[str, str]:
    return {f"{label}: {name}": str(count) for name, count in sorted(counts.items())}


def _names(*counts: Iterable[str]) -> str:
    return ", ".join(sorted({name for names in counts for name in names})[:_MAX_LISTED])

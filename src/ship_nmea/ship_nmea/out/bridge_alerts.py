"""Send alerts to the bridge: each change at once, list and heartbeat periodically. Execute commands of the bridge.

Each alert has a number and a revision, by which a command refers to it. Acknowledgements of the bridge are passed to
the alert node. Commands that cannot be executed are answered with ARC, except commands from addresses that are not
allowed.
"""

import dataclasses
import string
import time
import zlib
from collections import Counter, deque
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_msgs.srv import AcknowledgeAlert
from ship_nmea.nmea_node import PLAYBACK_TEXT, NmeaNode, is_played, utc_ns
from ship_nmea.out.config import ALC, ALERT_SENTENCES, ALF, HBT, NmeaOutConfig
from ship_nmea.out.sink import Sink
from ship_nmea.sentences.alerts import (
    ACKNOWLEDGE,
    FIRST_IDENTIFIER,
    LAST_IDENTIFIER,
    MAX_ALERTS,
    MAX_INSTANCE,
    REPEAT,
    TITLE_LENGTH,
    AlertCommand,
    SentenceAlert,
    alc,
    alf,
    arc,
    hbt,
    parse_command,
)
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import InputTopic

NORMAL = "N"

_PRIORITIES = "CWA"
_STATES = "NVSAU"
"""Letter of each priority and of each state of ship_msgs/Alert, in the order of its constants."""
_LAST_REVISION = 99
_LAST_ESCALATION = 9

ALERTS = InputTopic("ship/alerts", "ship_msgs/msg/AlertArray", required=False, depth=1)
ACKNOWLEDGE_SERVICE = "alerts/acknowledge"

_COMMANDS_PERIOD_S = 0.05
_MAX_RECEIVED = 100
_MAX_PENDING = 50
_RESPONSE_TIMEOUT_NS = 3 * NS_PER_S


@dataclass(frozen=True)
class _Entry:
    """An alert as received and as sent."""

    key: tuple[Any, ...]
    id: str
    instance: int
    sent: SentenceAlert


class SentAlerts:
    """All alerts of the suite as sent to the bridge.

    The number of an alert follows from its id, so that the number is the same after a restart and on other ships. Only
    ids whose checksums give the same or adjacent numbers may exchange numbers. After a restart, revisions start at 1
    again.

    Attributes:
        omitted_count: number of alerts of the last message that are not sent, because there are more than MAX_ALERTS.
    """

    def __init__(self) -> None:
        self._entries: dict[int, _Entry] = {}
        self.omitted_count = 0

    @property
    def all(self) -> list[SentenceAlert]:
        """Return all alerts, the most urgent first."""
        return [entry.sent for entry in self._entries.values()]

    def update(self, alerts: Sequence[Any], now_ns: int) -> list[SentenceAlert]:
        """Return new and changed alerts, and alerts that no longer exist (with the state normal).

        An instance that is replaced by another instance is first returned as normal: the bridge identifies an alert by
        number and instance, and would keep both instances.

        Args:
            alerts: the ship_msgs/Alert of an AlertArray.
            now_ns: time at which the alerts that no longer exist became normal.
        """
        self.omitted_count = max(0, len(alerts) - MAX_ALERTS)
        before, now = self._entries, dict[int, _Entry]()
        changed = []
        for alert in alerts[:MAX_ALERTS]:
            number = _identifier(alert.id, now)
            former = before.get(number)
            entry = now[number] = _make_entry(number, alert, former)
            if former is not None and former.sent.instance != entry.sent.instance:
                changed.append(_normal_alert(former.sent, now_ns))
            if former is None or entry.key != former.key:
                changed.append(entry.sent)
        # Assigned at the end, so that a list that cannot be read changes nothing.
        self._entries = now
        return changed + [_normal_alert(entry.sent, now_ns) for number, entry in before.items() if number not in now]

    def find(self, command: AlertCommand) -> tuple[str, int, SentenceAlert] | None:
        """Return id, instance and sentence values of the alert of a command; None if there is no such alert.

        A command without an instance refers to the present instance. The alert node checks an instance that is given.
        """
        entry = self._entries.get(command.identifier)
        if entry is None:
            return None
        return entry.id, entry.instance if command.instance is None else command.instance, entry.sent


def _identifier(id_: str, used: Container[int]) -> int:
    """Return the number of an alert from its id; if another alert of the list has this number, the next free number."""
    count = LAST_IDENTIFIER - FIRST_IDENTIFIER + 1
    number = zlib.crc32(id_.encode()) % count
    while (FIRST_IDENTIFIER + number) in used:
        number = (number + 1) % count
    return FIRST_IDENTIFIER + number


def _normal_alert(alert: SentenceAlert, now_ns: int) -> SentenceAlert:
    return dataclasses.replace(alert, state=NORMAL, changed_ns=now_ns, revision=alert.revision % _LAST_REVISION + 1)


def _make_entry(number: int, alert: Any, before: _Entry | None) -> _Entry:
    changed_ns = ns_from_stamp(alert.changed)
    key = alert.id, alert.instance, alert.priority, alert.state, alert.text, changed_ns
    if before is not None and before.key == key:
        return before
    priority = _PRIORITIES[alert.priority]
    revision, escalation = 1, 0
    if before is not None:
        revision = before.sent.revision % _LAST_REVISION + 1
        is_escalated = _PRIORITIES.index(priority) > _PRIORITIES.index(before.sent.priority)
        # A more urgent alert is another instance (docs/explanation/alerts.md). Another instance that is not more urgent
        # has escalation 0.
        if is_escalated or before.instance == alert.instance:
            escalation = min(before.sent.escalation + is_escalated, _LAST_ESCALATION)
    instance = (alert.instance - 1) % MAX_INSTANCE + 1
    sent = SentenceAlert(
        number, instance, revision, escalation, priority, _STATES[alert.state], changed_ns, _title(alert.id),
        alert.text,
    )  # fmt: skip
    return _Entry(key, alert.id, alert.instance, sent)


def _title(id_: str) -> str:
    """Return all words of an id; if too long, the longest word is shortened by its last letter until the title fits.

    For example, "attitude.degraded" is ATTITUD DEGRADED and "star.starboard2.out" is STAR STARBO2 OUT. A number at the
    end of a word is kept, because it distinguishes two devices.
    """
    words = id_.upper().replace("_", " ").replace(".", " ").split()
    while len(" ".join(words)) > TITLE_LENGTH and (longest := max(map(_length_without_number, words), default=0)) > 1:
        at = next(at for at, word in enumerate(words) if _length_without_number(word) == longest)
        words[at] = words[at][: longest - 1] + words[at][longest:]
    return " ".join(words)


def _length_without_number(word: str) -> int:
    return len(word.rstrip(string.digits))


@dataclass(frozen=True)
class _PendingAcknowledgement:
    """A command passed to the alert node: its pending response, the deadline, and the sink that received it."""

    future: Future
    deadline_ns: int
    command: AlertCommand
    sink: Sink


class BridgeAlerts:
    """Sends alerts to the sinks configured for them, and executes the bridge's commands.

    Args:
        runtime: runtime of the node.
    """

    def __init__(self, runtime: NmeaNode) -> None:
        self._runtime = runtime
        self._config: NmeaOutConfig = runtime.config
        self._sinks: Mapping[str, Sink] = {}
        self._received: deque[tuple[str, str, str]] = deque(maxlen=_MAX_RECEIVED)
        self._pending: deque[_PendingAcknowledgement] = deque()
        self._counts: Counter[str] = Counter()
        self._sent_alerts = SentAlerts()
        self._sequences: Counter[str] = Counter()

    def start(self, sinks: Mapping[str, Sink]) -> None:
        """Start sending; ``sinks`` are the sinks of the node by name."""
        self._sinks = sinks
        if self.are_sent:
            self._acknowledger = self._runtime.node.create_client(AcknowledgeAlert, ACKNOWLEDGE_SERVICE)
            self._runtime.subscribe(ALERTS, self._send_changes, latched=True)
            self._runtime.add_timer(self._config.alerts_period_s, "alert list", self._send_list)
            self._runtime.add_timer(_COMMANDS_PERIOD_S, "commands", self._process_commands)

    @property
    def are_sent(self) -> bool:
        """True if alerts are sent to any sink."""
        return any(self._sinks_with(name) for name in ALERT_SENTENCES)

    def receive_line(self, name: str, text: str, address: str) -> None:
        """Queue a line received by the named sink; called in the thread of that sink."""
        if len(self._received) == _MAX_RECEIVED:
            self._counts["dropped"] += 1
        self._received.append((name, text, address))

    def status(self) -> DiagnosticStatus:
        """Return the diagnostic status, with the counts of sent alerts and of commands."""
        values = {name: str(count) for name, count in sorted(self._counts.items())}
        if is_played(self._runtime):
            text = f"no alert is sent, heartbeat status V: {PLAYBACK_TEXT}"
            return DiagnosticStatus("alerts", Level.WARN, text, values)
        if not self._has_publisher():
            text = f"no publisher of {ALERTS.topic}: no list is sent, heartbeat status V"
            return DiagnosticStatus("alerts", Level.WARN, text, values)
        text = f"{len(self._sent_alerts.all)} alerts"
        if self._sent_alerts.omitted_count:
            text = f"{text} sent, {self._sent_alerts.omitted_count} more omitted"
            return DiagnosticStatus("alerts", Level.WARN, text, values)
        return DiagnosticStatus("alerts", Level.OK, text, values)

    def _send_changes(self, message: Any) -> None:
        if is_played(self._runtime):
            return
        for alert in self._sent_alerts.update(message.alerts, utc_ns(self._runtime)):
            self._send_alert(alert, self._sinks_with(ALF))

    def _send_alert(self, alert: SentenceAlert, sinks: Iterable[Sink]) -> None:
        for sentence in alf(alert, self._config.talker, self._config.manufacturer, self._next_sequence(ALF)):
            _send(sentence, sinks)
        self._counts["alerts sent"] += 1

    def _send_list(self) -> None:
        """Send the heartbeat, and the list if live alerts are published: an empty list would mean "no alert"."""
        has_publisher = self._has_publisher() and not is_played(self._runtime)
        sentences = alc(self._sent_alerts.all, self._config.talker, self._config.manufacturer, self._next_sequence(ALC))
        for sentence in sentences if has_publisher else ():
            _send(sentence, self._sinks_with(ALC))
        beat = hbt(has_publisher, self._config.talker, self._config.alerts_period_s, self._next_sequence(HBT))
        _send(beat, self._sinks_with(HBT))

    def _process_commands(self) -> None:
        for _ in range(len(self._received)):
            name, text, address = self._received.popleft()
            self._process_line(self._sinks[name], text, address)
        now_ns = time.monotonic_ns()
        for _ in range(len(self._pending)):
            pending = self._pending.popleft()
            if pending.future.done():
                self._process_response(pending)
            elif now_ns > pending.deadline_ns:
                self._acknowledger.remove_pending_request(pending.future)
                self._refuse(pending.sink, pending.command, f"{ACKNOWLEDGE_SERVICE} did not respond")
            else:
                self._pending.append(pending)

    def _process_line(self, sink: Sink, text: str, address: str) -> None:
        try:
            command = parse_command(text, self._config.manufacturer)
        except ValueError as problem:
            self._counts["unreadable"] += 1
            self._runtime.node.get_logger().warning(
                f"{sink.name}: {text[:100]!r}: {problem}", throttle_duration_sec=1.0
            )
            return
        if command is None:
            self._counts["for others"] += 1
        elif not sink.config.accepts_commands_from(address):
            # No ARC is sent, because the bridge would also receive the ARC, without having given such a command.
            self._counts["not allowed"] += 1
            self._runtime.node.get_logger().warning(
                f"{sink.name}: command {command.command} about alert {command.identifier} of {address} not executed: "
                f"add this address to sinks.{sink.name}.from, if it is the bridge's",
                throttle_duration_sec=1.0,
            )
        else:
            self._execute(sink, command)

    def _execute(self, sink: Sink, command: AlertCommand) -> None:
        found = self._sent_alerts.find(command)
        if not {ALF, ALC} & set(sink.config.sentences):
            self._refuse(sink, command, "this sink sends no alerts")
        elif found is None:
            self._refuse(sink, command, "no such alert")
        elif command.command == REPEAT:
            self._send_alert(found[2], [sink])
        elif command.command != ACKNOWLEDGE:
            self._refuse(sink, command, "unknown command")
        elif len(self._pending) >= _MAX_PENDING or not self._acknowledger.service_is_ready():
            self._refuse(sink, command, f"{ACKNOWLEDGE_SERVICE} is not available, or overloaded")
        else:
            future = self._acknowledger.call_async(AcknowledgeAlert.Request(id=found[0], instance=found[1]))
            self._pending.append(
                _PendingAcknowledgement(future, time.monotonic_ns() + _RESPONSE_TIMEOUT_NS, command, sink)
            )

    def _process_response(self, pending: _PendingAcknowledgement) -> None:
        response = pending.future.result()
        if response is None or not response.success:
            reason = "failed" if response is None else response.message
            self._refuse(pending.sink, pending.command, reason)
            return
        self._counts["acknowledged"] += 1
        self._runtime.node.get_logger().info(f"{pending.sink.name}: acknowledged: {response.message}")

    def _refuse(self, sink: Sink, command: AlertCommand, reason: str) -> None:
        self._counts["refused"] += 1
        sink.queue(arc(command, self._config.talker, self._config.manufacturer, utc_ns(self._runtime)).render())
        self._runtime.node.get_logger().warning(
            f"{sink.name}: command {command.command} about alert {command.identifier} refused: {reason}",
            throttle_duration_sec=1.0,
        )

    def _has_publisher(self) -> bool:
        return bool(self._runtime.node.count_publishers(ALERTS.topic) > 0)

    def _sinks_with(self, name: str) -> list[Sink]:
        return [sink for sink in self._sinks.values() if name in sink.config.sentences]

    def _next_sequence(self, name: str) -> int:
        """Return the number of the next message of a kind: the bridge detects a lost message from a gap."""
        self._sequences[name] += 1
        return self._sequences[name]


def _send(sentence: Any, sinks: Iterable[Sink]) -> None:
    for sink in sinks:
        sink.queue(sentence.render())

"""Send alerts to the bridge: each change at once, list and heartbeat periodically. Execute commands of the bridge.

Acknowledgements of the bridge are passed to the alert node. Commands that cannot be executed are answered with ARC,
except commands from addresses that are not allowed.
"""

import time
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future

from ship_bags.stamps import NS_PER_S
from ship_msgs.srv import AcknowledgeAlert
from ship_nmea.nmea_node import NmeaNode
from ship_nmea.out.config import ALC, ALERT_SENTENCES, ALF, HBT, NmeaOutConfig
from ship_nmea.out.playback import PLAYBACK_TEXT, is_played, utc_ns
from ship_nmea.out.sent_alerts import SentAlerts
from ship_nmea.out.sink import Sink
from ship_nmea.sentences.alerts import (
    ACKNOWLEDGE,
    REPEAT,
    AlertCommand,
    SentenceAlert,
    alc,
    alf,
    arc,
    hbt,
    parse_command,
)
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.topics import InputTopic

ALERTS = InputTopic("ship/alerts", "ship_msgs/msg/AlertArray", required=False, depth=1)
ACKNOWLEDGE_SERVICE = "alerts/acknowledge"

_COMMANDS_PERIOD_S = 0.05
_MAX_RECEIVED = 100
_MAX_PENDING = 50
_RESPONSE_TIMEOUT_NS = 3 * NS_PER_S


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
            return DiagnosticStatus(
                "alerts", Level.WARN, f"no alert is sent, heartbeat status V: {PLAYBACK_TEXT}", values
            )
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
        key, alert = self._sent_alerts.alert_key(command), self._sent_alerts.alert_of(command)
        if not {ALF, ALC} & set(sink.config.sentences):
            self._refuse(sink, command, "this sink sends no alerts")
        elif key is None or alert is None:
            self._refuse(sink, command, "no such alert")
        elif command.command == REPEAT:
            self._send_alert(alert, [sink])
        elif command.command != ACKNOWLEDGE:
            self._refuse(sink, command, "unknown command")
        elif len(self._pending) >= _MAX_PENDING or not self._acknowledger.service_is_ready():
            self._refuse(sink, command, f"{ACKNOWLEDGE_SERVICE} is not available, or overloaded")
        else:
            future = self._acknowledger.call_async(AcknowledgeAlert.Request(id=key[0], instance=key[1]))
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

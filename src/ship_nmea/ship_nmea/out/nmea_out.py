"""What ``nmea_out`` does: the attitude at each sink's rate, alerts when they change, the bridge's commands answered.

An attitude goes out when it comes, so that it is as young as can be. Where none comes, or none that is claimed, a timer
sends void sentences instead: silence of this node would look like a broken cable.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future

from ship_bags.stamps import NS_PER_S, duration_text, ns_from_stamp
from ship_msgs.msg import ShipAttitude
from ship_msgs.srv import AcknowledgeAlert
from ship_nmea.node_shell import NmeaNode
from ship_nmea.out.alert_ledger import AlertLedger
from ship_nmea.out.config import ALC, ALERT_SENTENCES, ALF, HBT, NmeaOutConfig, SinkConfig
from ship_nmea.out.sink import Sink
from ship_nmea.sentences.alerts import ACKNOWLEDGE, REPEAT, AlertCommand, AlertToTell, alc, alert_command, alf, arc, hbt
from ship_nmea.sentences.attitude import (
    ATTITUDE_SENTENCES,
    SAY_SIMULATED,
    AttitudeToTell,
    Worth,
    as_played,
    heading_rate,
)
from ship_node.edge.messages_out import DiagnosticStatus, Level
from ship_node.edge.topics import InputTopic

ATTITUDE = InputTopic("ship/attitude", "ship_msgs/msg/ShipAttitude", required=True, depth=200)
ALERTS = InputTopic("ship/alerts", "ship_msgs/msg/AlertArray", required=False, depth=1)
ACKNOWLEDGE_SERVICE = "alerts/acknowledge"

_VOID_PERIOD_S = 0.1
_COMMANDS_PERIOD_S = 0.05
_MOST_HEARD = 100
_MOST_ASKED = 50
_ANSWERED_WITHIN_NS = 3 * NS_PER_S
_PLAYED = "this node follows /clock, and tell_simulated is false"
_WORTHS = {
    ShipAttitude.VALID: Worth.NORMAL, ShipAttitude.COASTING: Worth.ESTIMATED, ShipAttitude.DEGRADED: Worth.ESTIMATED
}  # fmt: skip


class Pace:
    """Which of the attitudes that come are a sink's: one for each period, up to half of one early or late.

    Args:
        rate_hz: how many a second; of attitudes that come as often, jitter leaves none out.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NS_PER_S / rate_hz)
        self._next_ns: int | None = None

    def is_due(self, now_ns: int) -> bool:
        """Whether the attitude of now is one of them."""
        late_ns = 0 if self._next_ns is None else now_ns - self._next_ns
        if late_ns < -self._period_ns // 2:
            return False
        # After a silence the periods begin anew: nothing is made up for.
        is_steady = self._next_ns is not None and late_ns < self._period_ns // 2
        self._next_ns = self._period_ns + (now_ns - late_ns if is_steady else now_ns)
        return True


@dataclass(frozen=True)
class _Asked:
    """A command that was passed on: the answer to come, until when, and which sink it came from."""

    answer: Future
    until_ns: int
    command: AlertCommand
    sink: Sink


class NmeaOut:
    """The work of the node; see :class:`ship_nmea.node_shell.Work`.

    Args:
        shell: of the node.

    Raises:
        BadInput: no sink can be opened, and trying again would not help.
    """

    def __init__(self, shell: NmeaNode) -> None:
        self._shell = shell
        self._config: NmeaOutConfig = shell.config
        self._longest_ns = round(self._config.longest_age_s * NS_PER_S)
        self._attitude: Any = None
        self._came_ns = 0
        self._heard: deque[tuple[Sink, str]] = deque(maxlen=_MOST_HEARD)
        self._asked: deque[_Asked] = deque()
        self._counts: Counter[str] = Counter()
        self._ledger = AlertLedger()
        self._sequences: Counter[str] = Counter()
        self._sinks = [self._opened(name, config) for name, config in self._config.sinks.items()]
        try:
            shell.begin_without([sink.refusal for sink in self._sinks if sink.refusal], len(self._sinks))
        except ValueError:
            self.close()
            raise
        self._paces = [(sink, Pace(sink.config.rate_hz)) for sink in self._sinks]
        shell.subscribe(ATTITUDE, self._take_attitude)
        shell.every(_VOID_PERIOD_S, "void sentences", self._tell_void)
        self._tells_alerts = any(name in ALERT_SENTENCES for sink in self._sinks for name in sink.config.sentences)
        if self._tells_alerts:
            self._acknowledger = shell.node.create_client(AcknowledgeAlert, ACKNOWLEDGE_SERVICE)
            shell.subscribe(ALERTS, self._take_alerts, latched=True)
            shell.every(self._config.alerts_period_s, "alert list", self._tell_list)
            shell.every(_COMMANDS_PERIOD_S, "commands", self._answer_commands)
        for sink in self._sinks:
            sink.start()
        told = [f"{sink.name}: {', '.join(sink.config.sentences)} to {sink.place}" for sink in self._sinks]
        shell.node.get_logger().info("; ".join(told))

    def statuses(self) -> Iterable[DiagnosticStatus]:
        """See :class:`ship_nmea.node_shell.Work`."""
        yield from (sink.status() for sink in self._sinks)
        reason = self._why_void(*self._shell.clock.times())
        text = f"void: {reason}" if reason else ""
        if not text and self._is_played():
            text = f"void but for {', '.join(SAY_SIMULATED)}: {_PLAYED}"
        yield DiagnosticStatus("attitude", Level.WARN if text else Level.OK, text or "told")
        if self._tells_alerts:
            yield self._alerts_status()

    def close(self) -> None:
        """See :class:`ship_nmea.node_shell.Work`."""
        for sink in self._sinks:
            sink.close()

    def _opened(self, name: str, config: SinkConfig) -> Sink:
        def hear(text: str) -> None:
            if len(self._heard) == _MOST_HEARD:
                self._counts["dropped"] += 1
            self._heard.append((sink, text))

        sink = Sink(name, config, hear)  # which `hear` names, too
        return sink

    # -- attitude -------------------------------------------------------------------------------------------

    def _take_attitude(self, message: Any) -> None:
        now_ns, waiting_ns = self._shell.clock.times()
        self._attitude, self._came_ns = message, waiting_ns
        self._tell_attitude(self._why_void(now_ns, waiting_ns))

    def _tell_void(self) -> None:
        if reason := self._why_void(*self._shell.clock.times()):
            self._tell_attitude(reason)

    def _tell_attitude(self, why_void: str) -> None:
        steady_ns = time.monotonic_ns()
        due = [sink for sink, pace in self._paces if pace.is_due(steady_ns)]
        if not due:
            return
        attitude = AttitudeToTell(self._utc_ns()) if why_void else self._told(self._attitude)
        is_played = self._is_played()
        for sink in due:
            for name in sink.config.sentences:
                if make := ATTITUDE_SENTENCES.get(name):
                    told = as_played(name, attitude) if is_played else attitude
                    sentence = make(told, self._config.talker, sink.config.decimals)
                    sink.put(sentence.render(), self._longest_ns)

    def _why_void(self, now_ns: int, waiting_ns: int) -> str:
        """Why there is no attitude to tell; empty where there is one."""
        message = self._attitude
        if message is None:
            return f"{ATTITUDE.topic} never heard"
        if message.status not in _WORTHS:
            return f"{ATTITUDE.topic} is INVALID"
        if not all(map(math.isfinite, (message.heading, message.pitch, message.roll))):
            return f"{ATTITUDE.topic} has an angle that is no number"
        if not waiting_ns - self._came_ns <= self._longest_ns:
            return f"{ATTITUDE.topic} silent for {duration_text(waiting_ns - self._came_ns)}"
        age_ns = now_ns - ns_from_stamp(message.header.stamp)
        if not abs(age_ns) <= self._longest_ns:
            side = "before" if age_ns > 0 else "after"
            return f"the stamp of {ATTITUDE.topic} is {duration_text(age_ns)} {side} this node's clock"
        return ""

    def _is_played(self) -> bool:
        """Whether what comes is of another time and must not reach the bridge as if it were live."""
        return self._shell.clock.is_simulated() and not self._config.tell_simulated

    def _told(self, message: Any) -> AttitudeToTell:
        worth = Worth.SIMULATED if self._shell.clock.is_simulated() else _WORTHS[message.status]
        variances = [float(message.covariance[index]) for index in (0, 4, 8)]
        sigma_heading, sigma_pitch, sigma_roll = (math.sqrt(v) if v >= 0.0 else math.nan for v in variances)
        rate = message.angular_velocity
        return AttitudeToTell(
            ns_from_stamp(message.header.stamp),
            worth,
            (message.heading, message.pitch, message.roll),
            (sigma_heading, sigma_pitch, sigma_roll),
            heading_rate(message.pitch, message.roll, (rate.x, rate.y, rate.z)),
        )

    # -- alerts ---------------------------------------------------------------------------------------------

    def _take_alerts(self, message: Any) -> None:
        if self._is_played():
            return
        for alert in self._ledger.take(message.alerts, self._utc_ns()):
            self._tell_alert(alert, self._with(ALF))

    def _tell_alert(self, alert: AlertToTell, sinks: Iterable[Sink]) -> None:
        for sentence in alf(alert, self._config.talker, self._config.manufacturer, self._next(ALF)):
            _put(sentence, sinks)
        self._counts["told"] += 1

    def _tell_list(self) -> None:
        """The list, unless nobody keeps the alerts or they are played: an empty list would say that all is well."""
        is_kept = self._is_kept() and not self._is_played()
        sentences = alc(self._ledger.told, self._config.talker, self._config.manufacturer, self._next(ALC))
        for sentence in sentences if is_kept else ():
            _put(sentence, self._with(ALC))
        beat = hbt(is_kept, self._config.talker, self._config.alerts_period_s, self._next(HBT))
        _put(beat, self._with(HBT))

    def _answer_commands(self) -> None:
        for _ in range(len(self._heard)):
            sink, text = self._heard.popleft()
            self._take_line(sink, text)
        now_ns = time.monotonic_ns()
        for _ in range(len(self._asked)):
            asked = self._asked.popleft()
            if asked.answer.done():
                self._take_answer(asked)
            elif now_ns > asked.until_ns:
                self._acknowledger.remove_pending_request(asked.answer)
                self._refuse(asked.sink, asked.command, f"{ACKNOWLEDGE_SERVICE} does not answer")
            else:
                self._asked.append(asked)

    def _take_line(self, sink: Sink, text: str) -> None:
        try:
            command = alert_command(text, self._config.manufacturer)
        except ValueError as problem:
            self._counts["unreadable"] += 1
            self._shell.node.get_logger().warning(
                f"{sink.name}: {text[:100]!r}: {problem}", throttle_duration_sec=1.0
            )
            return
        if command is None:
            self._counts["for others"] += 1
        else:
            self._do(sink, command)

    def _do(self, sink: Sink, command: AlertCommand) -> None:
        meant, alert = self._ledger.meant(command), self._ledger.told_of(command)
        if not {ALF, ALC} & set(sink.config.sentences):
            self._refuse(sink, command, "no alerts are told here")
        elif meant is None or alert is None:
            self._refuse(sink, command, "there is no such alert")
        elif command.command == REPEAT:
            self._tell_alert(alert, [sink])
        elif command.command != ACKNOWLEDGE:
            self._refuse(sink, command, "this command is not known here")
        elif len(self._asked) >= _MOST_ASKED or not self._acknowledger.service_is_ready():
            self._refuse(sink, command, f"{ACKNOWLEDGE_SERVICE} is not there, or behind")
        else:
            answer = self._acknowledger.call_async(AcknowledgeAlert.Request(id=meant[0], instance=meant[1]))
            self._asked.append(_Asked(answer, time.monotonic_ns() + _ANSWERED_WITHIN_NS, command, sink))

    def _take_answer(self, asked: _Asked) -> None:
        response = asked.answer.result()
        if response is None or not response.success:
            why = "failed" if response is None else response.message
            self._refuse(asked.sink, asked.command, why)
            return
        self._counts["acknowledged"] += 1
        self._shell.node.get_logger().info(f"{asked.sink.name}: acknowledged: {response.message}")

    def _refuse(self, sink: Sink, command: AlertCommand, why: str) -> None:
        self._counts["refused"] += 1
        sink.put(arc(command, self._config.talker, self._config.manufacturer, self._utc_ns()).render())
        self._shell.node.get_logger().warning(
            f"{sink.name}: command {command.command} about alert {command.identifier} refused: {why}",
            throttle_duration_sec=1.0,
        )

    def _alerts_status(self) -> DiagnosticStatus:
        values = {name: str(count) for name, count in sorted(self._counts.items())}
        if self._is_played():
            return DiagnosticStatus("alerts", Level.WARN, f"none goes out, the heartbeat says V: {_PLAYED}", values)
        if not self._is_kept():
            text = f"nobody publishes {ALERTS.topic}: no list goes out, and the heartbeat says V"
            return DiagnosticStatus("alerts", Level.WARN, text, values)
        text = f"{len(self._ledger.told)} alerts"
        if self._ledger.left_out:
            text = f"{text} told, {self._ledger.left_out} more left out"
            return DiagnosticStatus("alerts", Level.WARN, text, values)
        return DiagnosticStatus("alerts", Level.OK, text, values)

    def _is_kept(self) -> bool:
        return bool(self._shell.node.count_publishers(ALERTS.topic) > 0)

    def _with(self, name: str) -> list[Sink]:
        return [sink for sink in self._sinks if name in sink.config.sentences]

    def _next(self, name: str) -> int:
        """The number of the next message of a kind: by a gap the bridge learns that one is lost."""
        self._sequences[name] += 1
        return self._sequences[name]

    def _utc_ns(self) -> int:
        """The node's time; the machine's before the first /clock."""
        return self._shell.clock.now_ns() or time.time_ns()


def _put(sentence: Any, sinks: Iterable[Sink]) -> None:
    for sink in sinks:
        sink.put(sentence.render())

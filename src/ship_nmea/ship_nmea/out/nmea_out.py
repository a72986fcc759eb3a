"""``nmea_out``: send the ship's attitude, at the rate of each sink, and alerts as NMEA sentences.

An attitude is sent on arrival, so that it is as recent as possible. Without a valid attitude a timer sends void
sentences: without any sentence the bridge could not distinguish a missing attitude from a broken cable.
"""

import math
import time
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from ship_bags.stamps import NS_PER_S, duration_text, ns_from_stamp
from ship_msgs.msg import ShipAttitude
from ship_nmea.nmea_node import PLAYBACK_TEXT, NmeaNode, is_played, run_nmea_node, utc_ns
from ship_nmea.out.bridge_alerts import BridgeAlerts
from ship_nmea.out.config import NmeaOutConfig
from ship_nmea.out.sink import Sink
from ship_nmea.sentences.attitude import (
    ATTITUDE_SENTENCES,
    SIMULATION_SENTENCES,
    AttitudeQuality,
    SentenceAttitude,
    heading_rate,
    simulated_attitude,
)
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import InputTopic

NAME = "nmea_out"

_DESCRIPTION = """\
Sends ship/attitude as HDT, THS, ROT, PASHR and PSXN, and ship/alerts as ALF, ALC and HBT, to any number of sinks: UDP
(one host, broadcast, a group), TCP server, serial line, file. An attitude that is INVALID, missing or older than
longest_age_s is sent void, with status V, never as an old value. The bridge's alert management acknowledges with ACN
over the same sink (udp: listen_port); a refused command is answered with ARC.

A receiver that does not read, a lost line or a full disk delays nothing: dropped sentences are counted in /diagnostics,
and the sink is opened again every 2 s.
"""

ATTITUDE = InputTopic("ship/attitude", "ship_msgs/msg/ShipAttitude", required=True, depth=200)

_VOID_PERIOD_S = 0.1
_QUALITIES = {
    ShipAttitude.VALID: AttitudeQuality.NORMAL,
    ShipAttitude.COASTING: AttitudeQuality.ESTIMATED,
    ShipAttitude.DEGRADED: AttitudeQuality.ESTIMATED,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``nmea_out``; return the exit code."""
    return run_nmea_node(NAME, _DESCRIPTION, NmeaOutConfig, NmeaOut, arguments)


class Throttle:
    """Selects the attitudes that are sent to a sink: one per period, up to half a period early or late.

    Args:
        rate_hz: attitudes per second; attitudes that arrive at this rate are not skipped due to jitter.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NS_PER_S / rate_hz)
        self._next_ns: int | None = None

    def is_due(self, now_ns: int) -> bool:
        """True if an attitude that arrives at this time is to be sent; the next period then begins."""
        late_ns = 0 if self._next_ns is None else now_ns - self._next_ns
        if late_ns < -self._period_ns // 2:
            return False
        # After a gap the periods restart; skipped attitudes are not sent later.
        is_steady = self._next_ns is not None and late_ns < self._period_ns // 2
        self._next_ns = self._period_ns + (now_ns - late_ns if is_steady else now_ns)
        return True


class NmeaOut:
    """Work of the node; see :class:`ship_nmea.nmea_node.Work`.

    Args:
        runtime: runtime of the node.

    Raises:
        BadInput: no sink can be opened, and retries cannot succeed.
    """

    def __init__(self, runtime: NmeaNode) -> None:
        self._runtime = runtime
        self._config: NmeaOutConfig = runtime.config
        self._max_age_ns = round(self._config.longest_age_s * NS_PER_S)
        self._attitude: Any = None
        self._received_ns = 0
        self._alerts = BridgeAlerts(runtime)
        self._sinks = [
            Sink(name, config, partial(self._alerts.receive_line, name)) for name, config in self._config.sinks.items()
        ]
        try:
            runtime.require_one_open(
                [sink.opening_error for sink in self._sinks if sink.opening_error], len(self._sinks)
            )
        except ValueError:
            self.close()
            raise
        self._throttles = [(sink, Throttle(sink.config.rate_hz)) for sink in self._sinks]
        runtime.subscribe(ATTITUDE, self._receive_attitude)
        runtime.add_timer(_VOID_PERIOD_S, "void sentences", self._send_void)
        self._alerts.start({sink.name: sink for sink in self._sinks})
        for sink in self._sinks:
            sink.start()
        descriptions = [f"{sink.name}: {', '.join(sink.config.sentences)} to {sink.place}" for sink in self._sinks]
        runtime.node.get_logger().info("; ".join(descriptions))

    def statuses(self) -> Iterable[DiagnosticStatus]:
        """See :class:`ship_nmea.nmea_node.Work`."""
        yield from (sink.status() for sink in self._sinks)
        reason = self._void_reason(*self._runtime.clock.times())
        text = f"sentences void: {reason}" if reason else ""
        if not text and is_played(self._runtime):
            text = f"sentences void except {', '.join(SIMULATION_SENTENCES)}: {PLAYBACK_TEXT}"
        yield DiagnosticStatus("attitude", Level.WARN if text else Level.OK, text or "sent")
        if self._alerts.are_sent:
            yield self._alerts.status()

    def close(self) -> None:
        """See :class:`ship_nmea.nmea_node.Work`."""
        for sink in self._sinks:
            sink.close()

    def _receive_attitude(self, message: Any) -> None:
        now_ns, waiting_ns = self._runtime.clock.times()
        self._attitude, self._received_ns = message, waiting_ns
        self._send_attitude(self._void_reason(now_ns, waiting_ns))

    def _send_void(self) -> None:
        if reason := self._void_reason(*self._runtime.clock.times()):
            self._send_attitude(reason)

    def _send_attitude(self, void_reason: str) -> None:
        steady_ns = time.monotonic_ns()
        due = [sink for sink, pace in self._throttles if pace.is_due(steady_ns)]
        if not due:
            return
        attitude = SentenceAttitude(utc_ns(self._runtime)) if void_reason else self._sentence_attitude(self._attitude)
        is_live = not is_played(self._runtime)
        for sink in due:
            for name in sink.config.sentences:
                if make_sentence := ATTITUDE_SENTENCES.get(name):
                    output = attitude if is_live else simulated_attitude(name, attitude)
                    sentence = make_sentence(output, self._config.talker, sink.config.decimals)
                    sink.queue(sentence.render(), self._max_age_ns)

    def _void_reason(self, now_ns: int, waiting_ns: int) -> str:
        """Return why there is no valid attitude to send; empty for a valid attitude."""
        message = self._attitude
        if message is None:
            return f"{ATTITUDE.topic}: no message received yet"
        if message.status not in _QUALITIES:
            return f"{ATTITUDE.topic} is INVALID"
        if not all(map(math.isfinite, (message.heading, message.pitch, message.roll))):
            return f"{ATTITUDE.topic} has an angle that is not a number"
        if not waiting_ns - self._received_ns <= self._max_age_ns:
            return f"{ATTITUDE.topic}: no message for {duration_text(waiting_ns - self._received_ns)}"
        age_ns = now_ns - ns_from_stamp(message.header.stamp)
        if not abs(age_ns) <= self._max_age_ns:
            side = "before" if age_ns > 0 else "after"
            return f"the stamp of {ATTITUDE.topic} is {duration_text(age_ns)} {side} this node's clock"
        return ""

    def _sentence_attitude(self, message: Any) -> SentenceAttitude:
        quality = AttitudeQuality.SIMULATED if self._runtime.clock.is_simulated() else _QUALITIES[message.status]
        variances = [float(message.covariance[index]) for index in (0, 4, 8)]
        sigma_heading, sigma_pitch, sigma_roll = (math.sqrt(v) if v >= 0.0 else math.nan for v in variances)
        rate = message.angular_velocity
        return SentenceAttitude(
            ns_from_stamp(message.header.stamp),
            quality,
            (message.heading, message.pitch, message.roll),
            (sigma_heading, sigma_pitch, sigma_roll),
            heading_rate(message.pitch, message.roll, (rate.x, rate.y, rate.z)),
        )


if __name__ == "__main__":
    raise SystemExit(main())

"""Played data must not reach the bridge as if it were live."""

import time

from ship_nmea.nmea_node import NmeaNode

PLAYBACK_TEXT = "this node follows /clock, and tell_simulated is false"


def is_played(runtime: NmeaNode) -> bool:
    """True if the data is played or simulated, and ``tell_simulated`` is not set."""
    return runtime.clock.is_simulated() and not runtime.config.tell_simulated


def utc_ns(runtime: NmeaNode) -> int:
    """Return the node's time, POSIX UTC; the machine's before the first /clock."""
    return runtime.clock.now_ns() or time.time_ns()

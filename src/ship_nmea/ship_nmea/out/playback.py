"""Detection of played data, which must not reach the bridge like live data."""

import time

from ship_nmea.nmea_node import NmeaNode

PLAYBACK_TEXT = "this node follows /clock, and tell_simulated is false"


def is_played(runtime: NmeaNode) -> bool:
    """True if the data is played or simulated, and ``tell_simulated`` is not set."""
    return runtime.clock.is_simulated() and not runtime.config.tell_simulated


def utc_ns(runtime: NmeaNode) -> int:
    """Return the node's time, POSIX UTC, ns; before the first /clock, the machine's time."""
    return runtime.clock.now_ns() or time.time_ns()

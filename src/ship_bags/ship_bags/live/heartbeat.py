"""Heartbeat of a program that a suite supervises.

The supervisor of a suite gives its programs one end of a datagram socket. Each program sends its process id there once
a second, from its main loop. A stopped program, or a program whose callback does not return, sends nothing. ROS and DDS
are not involved.
"""

import contextlib
import functools
import os
import socket

HEARTBEAT_SOCKET = "SHIP_SUITE_HEARTBEAT"
"""Environment variable with the file descriptor of the socket."""

HEARTBEAT_PERIOD_NS = 1_000_000_000
"""Heartbeat period, ns."""


class Heartbeat:
    """Heartbeat of this process; outside a suite nothing is sent.

    Args:
        descriptor: file descriptor of the socket, as text; empty outside a suite.
    """

    def __init__(self, descriptor: str) -> None:
        self._socket: socket.socket | None = None
        self._last_ns = 0
        with contextlib.suppress(OSError, ValueError):
            if descriptor:
                self._socket = socket.socket(fileno=int(descriptor))
                self._socket.set_inheritable(False)

    def beat(self, steady_ns: int) -> None:
        """Send a heartbeat if the last heartbeat is a period old.

        Args:
            steady_ns: steady time, ns.
        """
        if self._socket is None or steady_ns - self._last_ns < HEARTBEAT_PERIOD_NS:
            return
        self._last_ns = steady_ns
        # A stopped supervisor reads nothing, and its queue may be full.
        with contextlib.suppress(OSError):
            self._socket.send(b"%d" % os.getpid(), socket.MSG_DONTWAIT)


@functools.cache
def heartbeat() -> Heartbeat:
    """Return the heartbeat of this process; child processes do not inherit it."""
    return Heartbeat(os.environ.pop(HEARTBEAT_SOCKET, ""))

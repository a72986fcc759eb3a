"""The sign of life of a program that a suite keeps running.

The keeper of a suite gives its programs one end of a datagram socket. Each program sends its process id there once a
second, from the loop in which it does its work. A program that was stopped, or whose callback does not return, sends
nothing. Neither ROS nor DDS takes part.
"""

import contextlib
import functools
import os
import socket

HEARTBEAT_SOCKET = "SHIP_SUITE_HEARTBEAT"
"""Variable of the environment with the file descriptor of the socket."""

HEARTBEAT_PERIOD_NS = 1_000_000_000
"""Time between two signs of life, ns."""


class Heartbeat:
    """The signs of life of this process; outside a suite nothing is sent.

    Args:
        descriptor: file descriptor of the socket, as text; empty for none.
    """

    def __init__(self, descriptor: str) -> None:
        self._socket: socket.socket | None = None
        self._last_ns = 0
        with contextlib.suppress(OSError, ValueError):
            if descriptor:
                self._socket = socket.socket(fileno=int(descriptor))
                self._socket.set_inheritable(False)

    def beat(self, steady_ns: int) -> None:
        """Send a sign of life if the last one is a period old.

        Args:
            steady_ns: time of a clock that never jumps, ns.
        """
        if self._socket is None or steady_ns - self._last_ns < HEARTBEAT_PERIOD_NS:
            return
        self._last_ns = steady_ns
        # A keeper that was stopped itself reads nothing until its queue is full.
        with contextlib.suppress(OSError):
            self._socket.send(b"%d" % os.getpid(), socket.MSG_DONTWAIT)


@functools.cache
def heartbeat() -> Heartbeat:
    """Return the signs of life of this process; programs that it starts do not inherit them."""
    return Heartbeat(os.environ.pop(HEARTBEAT_SOCKET, ""))

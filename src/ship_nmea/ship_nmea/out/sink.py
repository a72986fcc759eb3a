"""A sink: a queue of sentences and the thread that sends them, so that no outlet can delay the node."""

import contextlib
import os
import selectors
import threading
import time
from collections import Counter, deque
from typing import NamedTuple

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_estimation.rejection_rules import shorten
from ship_nmea.connections import error_text, permanent_error
from ship_nmea.out.config import FILE, SERIAL, TCP_SERVER, UDP, SinkConfig
from ship_nmea.out.outlets import FileOutlet, LineReceiver, Outlet, SerialOutlet, TcpOutlet, UdpOutlet
from ship_node.messages.common_messages import DiagnosticStatus, Level

MAX_QUEUED = 200
"""Maximum number of queued sentences; sentences at the end of a longer queue would be old when they are sent."""
RETRY_S = 2.0
"""Time after which a failed outlet is opened again, s."""

_SEND_RETRY_S = 0.02
_SELECT_TIMEOUT_S = 0.5
_JOIN_TIMEOUT_S = 2.0
_WARNING_NS = 10 * NS_PER_S
"""Time for which dropped sentences or disconnected clients remain a warning, ns."""

_OUTLETS: dict[str, type[Outlet]] = {UDP: UdpOutlet, TCP_SERVER: TcpOutlet, SERIAL: SerialOutlet, FILE: FileOutlet}
_PARAMETER_NAMES = {
    UDP: ("listen_port", "interface"),
    TCP_SERVER: ("port", "address"),
    SERIAL: ("device", "baud"),
    FILE: ("path", "path"),
}
"""Parameters named in a permanent error (:func:`ship_nmea.connections.permanent_error`).

For UDP, only binding the port and the interface can cause a permanent error.
"""


class _QueuedSentence(NamedTuple):
    """A sentence with its line end, and the steady time at which the sentence expires; 0 if it never expires."""

    data: bytes
    expiry_ns: int


class Sink:
    """Queue of sentences for a destination, and the thread that sends them.

    Args:
        name: name of the sink.
        config: configuration of the sink.
        receive: called with each received line and its sender's address, in the thread of the sink.

    Attributes:
        place: kind and address of the destination, as text.
        opening_error: error of the first opening if retries cannot succeed without the user; otherwise None.
    """

    def __init__(self, name: str, config: SinkConfig, receive: LineReceiver) -> None:
        self.name, self.config = name, config
        self.opening_error: BadInput | None = None
        self._outlet: Outlet = _OUTLETS[config.kind](config, receive)
        self.place = self._outlet.place
        self._queue: deque[_QueuedSentence] = deque()
        self._lock = threading.Lock()
        self._dropped: Counter[str] = Counter()
        self._dropped_ns = -_WARNING_NS
        self._sent = self._failures = 0
        self._failure = ""
        self._is_open = self._is_stopped = False
        self._selector = selectors.DefaultSelector()
        self._wake_reader, self._wake_writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._selector.register(self._wake_reader, selectors.EVENT_READ, self._drain)
        try:
            self._open()
        except OSError as problem:
            self._fail(problem)
            self.opening_error = permanent_error(problem, f"sinks.{name}", config, _PARAMETER_NAMES)
        self._thread = threading.Thread(target=self._run, name=f"sink {name}", daemon=True)

    def start(self) -> None:
        """Start sending."""
        self._thread.start()

    def queue(self, sentence: str, max_wait_ns: int = 0) -> None:
        """Queue a sentence, or drop it if the outlet is not open; if the queue is full, the oldest sentence is dropped.

        Args:
            sentence: the sentence without its line end.
            max_wait_ns: maximum time in the queue, ns; 0 for no limit.
        """
        until_ns = time.monotonic_ns() + max_wait_ns if max_wait_ns else 0
        with self._lock:
            if not self._is_open:
                self._drop("while it was not open")
                return
            if len(self._queue) >= MAX_QUEUED:
                self._queue.popleft()
                self._drop(f"the oldest of more than {MAX_QUEUED} queued")
            self._queue.append(_QueuedSentence(f"{sentence}\r\n".encode("ascii", errors="replace"), until_ns))
        self._wake()

    def status(self) -> DiagnosticStatus:
        """Return the status of the sink."""
        with self._lock:
            dropped, failure = dict(self._dropped), self._failure
            waiting, last_ns = len(self._queue), max(self._dropped_ns, self._outlet.client_lost_ns or self._dropped_ns)
        values = {"sent": str(self._sent), "waiting": str(waiting), "failures": str(self._failures)}
        values |= {f"dropped: {why}": str(count) for why, count in dropped.items()}
        text = f"{self.place}: {self._sent} sent"
        if note := self._outlet.status_note():
            text += f"; {note}"
        if dropped:
            text += f"; {sum(dropped.values())} dropped"
        if not self._is_open:
            text = f"{self.place}: {failure}; retried every {RETRY_S:g} s"
            return DiagnosticStatus(f"sink {self.name}", Level.ERROR, text, values)
        is_recent = time.monotonic_ns() - last_ns <= _WARNING_NS
        return DiagnosticStatus(f"sink {self.name}", Level.WARN if is_recent else Level.OK, text, values)

    def close(self) -> None:
        """Send the queued sentences that can be sent at once, and end the thread."""
        self._is_stopped = True
        self._wake()
        if not self._thread.ident:
            self._close_all()
        elif self._thread.is_alive():
            # If a disk hangs, the thread ends only with the process, so the wait is limited.
            self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while not self._is_stopped:
            try:
                if not self._is_open:
                    self._open()
                self._work()
            except Exception as problem:  # noqa: PERF203 - then the thread waits
                # An outlet may raise anything; the failure is reported in the status, and opening is retried.
                self._fail(problem)
                self._wait(RETRY_S)
        if self._is_open:
            with contextlib.suppress(OSError):
                self._send_queued()
        self._close_all()

    def _work(self) -> None:
        timeout_s = _SELECT_TIMEOUT_S
        while not self._is_stopped:
            for key, _ in self._selector.select(timeout_s):
                key.data()
            timeout_s = _SELECT_TIMEOUT_S if self._send_queued() else _SEND_RETRY_S

    def _send_queued(self) -> bool:
        """Send queued sentences, drop expired sentences; return True if no sentence is left."""
        while True:
            with self._lock:
                if not self._queue:
                    return True
                queued = self._queue[0]
                is_expired = 0 < queued.expiry_ns < time.monotonic_ns()
                if is_expired:
                    self._queue.popleft()
                    self._drop("expired in the queue: the line is too slow for rate_hz")
                    continue
            if not self._outlet.send(queued.data):
                return False
            self._sent += 1
            with self._lock:
                # The node may have dropped this sentence meanwhile to make room.
                if self._queue and self._queue[0] is queued:
                    self._queue.popleft()

    def _open(self) -> None:
        self._outlet.open(self._selector)
        with self._lock:
            self._is_open, self._failure = True, ""

    def _fail(self, problem: Exception) -> None:
        """Close the outlet until the next attempt, and discard the queued sentences."""
        with self._lock:
            self._is_open = False
            self._failures += 1
            self._failure = shorten(error_text(problem))
            self._queue.clear()
        with contextlib.suppress(OSError):
            self._outlet.close()
        for fd in list(self._selector.get_map()):
            if fd != self._wake_reader:
                self._selector.unregister(fd)

    def _close_all(self) -> None:
        with contextlib.suppress(OSError):
            self._outlet.close()
        self._selector.close()
        os.close(self._wake_reader)
        self._wake_reader = -1
        waker, self._wake_writer = self._wake_writer, -1
        os.close(waker)

    def _wait(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while not self._is_stopped and time.monotonic() < end_s:
            for key, _ in self._selector.select(min(_SELECT_TIMEOUT_S, max(0.0, end_s - time.monotonic()))):
                key.data()

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._wake_writer, b"w")

    def _drain(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_reader, 4096)

    def _drop(self, reason: str) -> None:
        self._dropped[reason] += 1
        self._dropped_ns = time.monotonic_ns()

"""State of a running suite: a reader receives the topics, and a monitor computes the state from their messages.

Topics are read in a separate thread. Without this thread, a display that is busy for a second would look like a gap in
the data. The thread also forwards topics to a receiver outside ROS, if a receiver is given.
"""

import itertools
import logging
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from ship_monitor.live.acknowledge import acknowledge
from ship_monitor.live.topic_reader import MAX_QUEUE_DEPTH, ReceivedBatch, TopicReader, steady_ns
from ship_monitor.live.topic_relay import TopicReceiver, TopicRelay
from ship_watch.history.history import History
from ship_watch.published_state import STATE_TOPIC, STATE_TYPE
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import SuiteState
from ship_watch.topics import monitored_topic

READ_PERIOD_S = 0.2
"""Period at which topics are read, s."""

_RELAYS_PER_READ = 4
"""Number of forwarding steps for each reading of topics: twenty steps a second."""

_STATE_PERIOD_NS = 200_000_000
_CLOSE_TIMEOUT_S = 5.0


class LiveSuite:
    """A suite on the network: one reader and one monitor for all displays.

    Args:
        node_name: name of the node on the network.
        namespace: namespace of the suite, with or without slashes; empty for no namespace.
        limits: limits of the ship, for the state of a suite without an alert node.
        receiver: receiver of the suite's topics as bytes; None for no receiver.

    Raises:
        BadInput: as in :class:`ship_monitor.live.topic_reader.TopicReader`.
    """

    def __init__(self, node_name: str, namespace: str, limits: Limits, receiver: TopicReceiver | None = None) -> None:
        self._reader = TopicReader(node_name, namespace, queue_depth)
        self._relay = None if receiver is None else TopicRelay(self._reader, receiver)
        self._monitor = SuiteMonitor(limits)
        self._suite_state: SuiteState | None = None
        self._has_rejected_state = False
        self._suite_state_ns = 0
        self._pending: SimpleQueue[ReceivedBatch] = SimpleQueue()
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name="topics", daemon=True)
        self._thread.start()

    def tick(self) -> None:
        """Process the messages read so far; the method is called some times a second, also without a display."""
        while True:
            try:
                batch = self._pending.get_nowait()
            except Empty:
                return
            if batch.time_went_back:
                self._monitor.reset()
            if batch.alerts_ended:
                self._monitor.clear_alerts()
            for received in batch.messages:
                if received.topic == STATE_TOPIC:
                    self._process_suite_state(received.message, received.arrival_ns)
                else:
                    self._monitor.process_message(received.topic, received.message, received.arrival_ns)

    def _process_suite_state(self, message: Any, arrival_ns: int) -> None:
        """Process a SuiteState message; an invalid message is dropped, and a warning is logged for the first."""
        try:
            self._monitor.process_suite_state(message, arrival_ns)
        except ValueError as problem:
            if not self._has_rejected_state:
                text = "%s is not shown: %s; do the alert node and this viewer have the same version?"
                logging.getLogger(__name__).warning(text, STATE_TOPIC, problem)
            self._has_rejected_state = True

    def current_state(self) -> SuiteState:
        """Return the current state; calls within 0.2 s return the same state."""
        now_ns = steady_ns()
        if self._suite_state is None or now_ns - self._suite_state_ns > _STATE_PERIOD_NS:
            # Messages read already are processed before the state is evaluated.
            self.tick()
            now_ns = steady_ns()
            self._suite_state, self._suite_state_ns = self._monitor.current_state(now_ns), now_ns
        return self._suite_state

    def _read(self) -> None:
        """Read and forward topics until closed."""
        rounds = 1 if self._relay is None else _RELAYS_PER_READ
        for number in itertools.count():
            if self._is_closed.wait(READ_PERIOD_S / rounds):
                return
            # An error is logged; data that are not read become old.
            try:
                if number % rounds == 0:
                    self._read_batch()
                if self._relay is not None:
                    self._relay.forward_messages()
            except Exception:
                logging.getLogger(__name__).exception("topics are not read")

    def _read_batch(self) -> None:
        batch = self._reader.fetch()
        if batch.time_went_back or batch.messages or batch.alerts_ended:
            self._pending.put(batch)

    @property
    def history(self) -> History:
        """Data of the plots."""
        return self._monitor.history

    @property
    def label(self) -> str:
        """LIVE, or "BAG · played" if a bag is played; with truth on the network "SIMULATED" or "SIMULATED · bag"."""
        if self._reader.is_simulated:
            return "SIMULATED · bag" if self._reader.is_played else "SIMULATED"
        return "BAG · played" if self._reader.is_played else "LIVE"

    @property
    def name(self) -> str:
        """Namespace without its slash; "ship" if there is no namespace."""
        return self._reader.namespace.strip("/") or "ship"

    @property
    def location(self) -> str:
        """Namespace and domain of the reader, as text."""
        return self._reader.location

    def acknowledge(self, alert_id: str, instance: int) -> str:
        """Acknowledge one instance of an alert; return the result in words. The call may take seconds."""
        return acknowledge(self._reader.context, self._reader.namespace, alert_id, instance)

    def controls(self, _on_move: Callable[[], None]) -> None:
        """Return None: a live suite has no controls."""

    def close(self) -> None:
        """Leave the network."""
        self._is_closed.set()
        self._thread.join(_CLOSE_TIMEOUT_S)
        self._reader.close()


def queue_depth(topic: str, type_name: str) -> int:
    """Return the queue depth of a topic (:class:`ship_monitor.live.topic_reader.TopicReader`)."""
    if topic == STATE_TOPIC:
        return int(type_name == STATE_TYPE)
    row = monitored_topic(topic, type_name)
    return 0 if row is None else MAX_QUEUE_DEPTH if row.keeps_every_message else 1

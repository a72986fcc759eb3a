"""A running suite, watched: what the reader of topics takes goes to a watch, which gives the picture.

Topics are read in a thread of their own, at its own pace. Whoever draws may be busy for a second; without the thread,
the newest message after such a second would look like the end of a silence. In the same thread topics are passed on as
they come to somebody outside ROS, where there is one.
"""

import itertools
import logging
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from ship_monitor.live.acknowledge import acknowledge
from ship_monitor.live.reader import KEPT, Taken, TopicReader, steady_ns
from ship_monitor.live.relayed_topics import RelayedTopics, TopicReceiver
from ship_watch.history import History
from ship_watch.limits import Limits
from ship_watch.picture import Picture
from ship_watch.published_state import STATE_TOPIC, STATE_TYPE
from ship_watch.topics import watched_topic
from ship_watch.watch import Watch

TAKE_PERIOD_S = 0.2
"""How often topics are read, s."""

_RELAYED_BETWEEN = 4
"""How often topics are passed on for each time that they are read: twenty times a second."""

_PICTURE_NS = 200_000_000
_END_S = 5.0


class LiveWatch:
    """A suite on the network: one reader and one watch for all who look at it.

    Args:
        node_name: name of the node on the network.
        namespace: of the suite, with or without slashes; empty for none.
        limits: of the ship, for the state of a suite that has no alert node.
        receiver: gets the suite's topics as bytes.

    Raises:
        BadInput: as of :class:`ship_monitor.live.reader.TopicReader`.
    """

    def __init__(self, node_name: str, namespace: str, limits: Limits, receiver: TopicReceiver | None = None) -> None:
        self._reader = TopicReader(node_name, namespace, messages_wanted)
        self._relayed = None if receiver is None else RelayedTopics(self._reader, receiver)
        self._watch = Watch(limits)
        self._picture: Picture | None = None
        self._has_rejected_state = False
        self._picture_ns = 0
        self._waiting: SimpleQueue[Taken] = SimpleQueue()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._read, name="topics", daemon=True)
        self._thread.start()

    def tick(self) -> None:
        """Watch what has come. Called some times a second, whether anybody looks or not."""
        while True:
            try:
                taken = self._waiting.get_nowait()
            except Empty:
                return
            if taken.is_anew:
                self._watch.start_anew()
            if taken.alerts_ended:
                self._watch.forget_alerts()
            for arrived in taken.messages:
                if arrived.topic == STATE_TOPIC:
                    self._take_state(arrived.message, arrived.arrival_ns)
                else:
                    self._watch.take(arrived.topic, arrived.message, arrived.arrival_ns)

    def _take_state(self, message: Any, arrival_ns: int) -> None:
        """Take a SuiteState. One that cannot be used is dropped with a line: the messages after it are taken."""
        try:
            self._watch.take_state(message, arrival_ns)
        except ValueError as problem:
            if not self._has_rejected_state:
                text = "%s is not shown: %s; do the alert node and this viewer have the same version?"
                logging.getLogger(__name__).warning(text, STATE_TOPIC, problem)
            self._has_rejected_state = True

    def look(self) -> Picture:
        """The picture of this moment; those who look at nearly the same time share one."""
        now_ns = steady_ns()
        if self._picture is None or now_ns - self._picture_ns > _PICTURE_NS:
            # What has come already comes before what is judged by now.
            self.tick()
            now_ns = steady_ns()
            self._picture, self._picture_ns = self._watch.look(now_ns), now_ns
        return self._picture

    def _read(self) -> None:
        """Read and pass on until the end."""
        rounds = 1 if self._relayed is None else _RELAYED_BETWEEN
        for number in itertools.count():
            if self._is_over.wait(TAKE_PERIOD_S / rounds):
                return
            # What goes wrong is said; what is not read becomes old by itself.
            try:
                if number % rounds == 0:
                    self._take()
                if self._relayed is not None:
                    self._relayed.pass_on()
            except Exception:
                logging.getLogger(__name__).exception("topics are not read")

    def _take(self) -> None:
        taken = self._reader.take()
        if taken.is_anew or taken.messages or taken.alerts_ended:
            self._waiting.put(taken)

    @property
    def history(self) -> History:
        """What plots draw."""
        return self._watch.history

    @property
    def label(self) -> str:
        """LIVE; SIMULATED where the truth is on the network, too; BAG where one is played."""
        if self._reader.is_simulated:
            return "SIMULATED · bag" if self._reader.is_played else "SIMULATED"
        return "BAG · played" if self._reader.is_played else "LIVE"

    @property
    def name(self) -> str:
        """The namespace without its slash; "ship" where there is none."""
        return self._reader.namespace.strip("/") or "ship"

    @property
    def place(self) -> str:
        """Where it listens, in words."""
        return self._reader.place

    def acknowledge(self, alert_id: str, instance: int) -> str:
        """Acknowledge one instance of an alert, and say in words what came of it. It may wait for seconds."""
        return acknowledge(self._reader.context, self._reader.namespace, alert_id, instance)

    def controls(self, _moved: Callable[[], None]) -> None:
        """There are none: time goes as it goes."""

    def close(self) -> None:
        """Leave the network."""
        self._is_over.set()
        self._thread.join(_END_S)
        self._reader.close()


def messages_wanted(topic: str, type_name: str) -> int:
    """How many messages of a topic may wait between two ticks (:class:`ship_monitor.live.reader.TopicReader`)."""
    if topic == STATE_TOPIC:
        return int(type_name == STATE_TYPE)
    row = watched_topic(topic, type_name)
    return 0 if row is None else KEPT if row.every else 1

"""The server that Foxglove and Lichtblick open as "Foxglove WebSocket". It gives out messages, and takes nothing.

Messages go on as the bytes that came, with the definition of their type; whoever opens the connection decodes them. A
client that is slow loses its oldest messages; it makes nobody wait and no memory grow.
"""

import errno
import logging
import threading
from dataclasses import dataclass
from queue import SimpleQueue

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener

from ship_bags.errors import BadInput

_WAITING_MESSAGES = 1024
"""Messages that may wait for one client: a second of a whole suite. Beyond, its oldest are dropped."""

_END_S = 1.0
"""How long the server may take to say goodbye, s. It waits without end for a client that has ceased to read."""


@dataclass(frozen=True)
class _Offered:
    type_name: str
    channel: foxglove.Channel


class _Newcomers(ServerListener):
    """Notes the topics that clients ask for. Threads of the server call it."""

    def __init__(self) -> None:
        self.topics: SimpleQueue[str] = SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """A client has asked for a topic."""
        self.topics.put(channel.topic)


class FoxgloveServer:
    """Serves topics to any number of clients. Clients cannot publish, call services or set parameters.

    All methods but :meth:`close` are of one thread; the server itself runs in threads of its own.

    Attributes:
        address: as a client takes it.

    Args:
        name: of the suite, which clients show.
        host: address to listen on; loopback serves this machine alone.
        port: TCP port; 0 takes any.

    Raises:
        BadInput: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        # A client that has gone or talks nonsense is no news here; it is told itself.
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)
        self._context = foxglove.Context()
        self._newcomers = _Newcomers()
        self._offered: dict[str, _Offered] = {}
        try:
            server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                context=self._context,
                server_listener=self._newcomers,
                message_backlog_size=_WAITING_MESSAGES,
            )
        except RuntimeError as problem:
            if f"os error {errno.EADDRINUSE}" in str(problem):
                raise BadInput(f"port {port} of {host} is in use: give another one with --foxglove N") from problem
            raise BadInput(f"cannot serve Foxglove on {host}, port {port}: {problem}") from problem
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{server.port}"
        self._goodbye = threading.Thread(target=server.stop, name="goodbye", daemon=True)

    def offer(self, topic: str, type_name: str, definition: str) -> None:
        """Let clients see a topic. One whose type has changed is another one to them.

        Args:
            topic: its full name.
            type_name: of its messages, as ``sensor_msgs/msg/Imu``.
            definition: of the type with all that it refers to, as rosbag2 embeds it.
        """
        former = self._offered.get(topic)
        if former is not None:
            if former.type_name == type_name:
                return
            former.channel.close()
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition.encode("utf-8"))
        channel = foxglove.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)
        self._offered[topic] = _Offered(type_name, channel)

    def wanted(self) -> frozenset[str]:
        """Topics that a client is subscribed to at this moment."""
        return frozenset(topic for topic, offered in self._offered.items() if offered.channel.has_sinks())

    def newcomers(self) -> frozenset[str]:
        """Topics that a client has subscribed to since the last call."""
        waiting, topics = self._newcomers.topics, set()
        while not waiting.empty():
            topics.add(waiting.get_nowait())
        return frozenset(topics)

    def pass_on(self, topic: str, data: bytes, arrival_utc_ns: int) -> None:
        """Give a message to those who are subscribed to its topic, which has been offered. It never waits.

        Args:
            topic: its full name.
            data: its CDR bytes.
            arrival_utc_ns: when it came; stamps of its own are inside.
        """
        self._offered[topic].channel.log(data, log_time=arrival_utc_ns)

    def close(self) -> None:
        """Take leave of all clients, once."""
        if self._goodbye.ident is None:
            self._goodbye.start()
        self._goodbye.join(_END_S)

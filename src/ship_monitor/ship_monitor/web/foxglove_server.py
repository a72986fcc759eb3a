"""Read-only server of topics for Foxglove and Lichtblick ("Foxglove WebSocket").

Messages are forwarded as bytes, with the definition of their type; the viewer decodes them. The oldest messages for a
slow client are dropped, so that a slow client delays no other client and needs no more memory.

The server uses the protocol of foxglove-sdk (``foxglove.sdk.v1``). The server of foxglove-sdk answers every web page.
This server answers only known viewers, programs that state no origin, and pages of its own hosts.
"""

import asyncio
import itertools
import json
import struct
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

from tornado.httputil import HTTPServerRequest
from tornado.web import Application, ErrorHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from ship_monitor.web.bounded_server import (
    MAX_MESSAGE_BYTES,
    BoundedServer,
    OwnHosts,
    address_in_url,
    host_of,
    listening_sockets,
)

PROTOCOL = "foxglove.sdk.v1"

MAX_PENDING_MESSAGES = 1024
"""Maximum number of pending messages of one viewer: about one second of all topics. Older messages are dropped."""

_MAX_NOTIFICATIONS = 100_000
"""Maximum number of pending notifications of one viewer. If there are more, the connection is closed."""

_BATCH_SIZE = 32
"""Number of messages written before waiting for the connection to send them."""

_MESSAGE = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_WARNING = 1


VIEWERS = frozenset({"https://app.foxglove.dev", "https://embed.foxglove.dev", "https://studio.foxglove.dev"})
"""Origins of the viewers that are web pages of other sites."""

_DESKTOP_ORIGIN, _DESKTOP_AGENT = "file://", "Electron/"
"""Origin and user agent of desktop viewers. A page saved to a file has the same origin, but another user agent."""

MAX_CLIENTS = 32
"""Maximum number of viewers."""

_PING_S = 30.0
"""Timeout of a client's answer to a ping, s."""

_CLOSE_TIMEOUT_S = 1.0
"""Timeout of the closing handshakes at the end, s."""


@dataclass(frozen=True)
class Channel:
    """A topic that is offered to viewers.

    Attributes:
        id: number of the channel.
        topic: full name of the topic.
        type_name: type of the messages.
        definition: definition of the type.
    """

    id: int
    topic: str
    type_name: str
    definition: str

    def advertisement(self) -> dict[str, Any]:
        """Return the channel in the form of the protocol."""
        return {
            "id": self.id, "topic": self.topic, "encoding": "cdr", "schemaName": self.type_name,
            "schemaEncoding": "ros2msg", "schema": self.definition,
        }  # fmt: skip


class Client(WebSocketHandler):
    """Connection of one viewer. All methods except :meth:`enqueue` are called in the thread of the server.

    Attributes:
        subscriptions: number of the channel → number of the viewer's subscription.
    """

    def initialize(self, viewers: "Viewers") -> None:
        """Initialise the connection; called by tornado with the arguments of the route."""
        self._viewers = viewers
        self.subscriptions: dict[int, int] = {}
        self._notifications: deque[dict[str, Any]] = deque()
        self._messages: deque[tuple[int, int, bytes]] = deque(maxlen=MAX_PENDING_MESSAGES)
        self._has_pending = asyncio.Event()
        self._is_wake_pending = self._is_closed = False
        self._write_task: asyncio.Task[None] | None = None

    def select_subprotocol(self, subprotocols: list[str]) -> str | None:
        """Return the name of the protocol if the viewer supports it, else None."""
        return PROTOCOL if PROTOCOL in subprotocols else None

    def check_origin(self, origin: str) -> bool:
        """Return True: origins are checked earlier, together with hosts."""
        return True

    async def open(self, *_: Any) -> None:
        """Add the viewer, which then receives the channels; close the connection if the viewer lacks the protocol."""
        if self.selected_subprotocol is None:
            self.close(1002, f"expected the protocol {PROTOCOL}")
            return
        self._write_task = asyncio.create_task(self._write())
        self._viewers.add(self)

    async def on_message(self, message: str | bytes) -> None:
        """Process a request; the next request is read after the answer has been written."""
        error = self._handle_request(message)
        if error:
            try:
                await self.write_message({"op": "status", "level": _WARNING, "message": error})
            except WebSocketClosedError:
                return

    def on_close(self) -> None:
        """Remove the viewer."""
        self._is_closed = True
        self._has_pending.set()
        self._viewers.remove(self)

    def abort(self) -> None:
        """Close the connection without a closing handshake, because the viewer no longer reads."""
        stream = None if self.ws_connection is None else self.ws_connection.stream
        if stream is not None:
            stream.close()

    def notify(self, notification: dict[str, Any]) -> None:
        """Queue a notification; notifications are never dropped and keep their order."""
        self._notifications.append(notification)
        self._has_pending.set()
        if len(self._notifications) > _MAX_NOTIFICATIONS:
            self.close()

    def enqueue(self, channel: Channel, data: bytes, log_time_ns: int) -> bool:
        """Queue a message; return True if :meth:`wake` must be called. Called from another thread.

        Args:
            channel: channel of the message.
            data: CDR bytes of the message.
            log_time_ns: arrival time of the message, UTC, ns.
        """
        self._messages.append((channel.id, log_time_ns, data))
        was_woken, self._is_wake_pending = self._is_wake_pending, True
        return not was_woken

    def wake(self) -> None:
        """Start writing the pending messages."""
        self._is_wake_pending = False
        self._has_pending.set()

    def _handle_request(self, message: str | bytes) -> str:
        """Execute a request; return the error text, empty on success."""
        if isinstance(message, bytes):
            return "this server is read-only: binary messages are refused"
        try:
            request = json.loads(message)
            operation = str(request["op"])
            if operation == "subscribe":
                return self._subscribe([(int(each["id"]), int(each["channelId"])) for each in request["subscriptions"]])
            if operation == "unsubscribe":
                return self._unsubscribe({int(each) for each in request["subscriptionIds"]})
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return "not a request of the protocol"
        return f"this server is read-only: '{operation[:40]}' is refused"

    def _subscribe(self, wanted: Iterable[tuple[int, int]]) -> str:
        error, channels, used = "", self._viewers.channels, set(self.subscriptions.values())
        added = []
        for subscription, channel in wanted:
            if not 0 <= subscription < 2**32 or subscription in used:
                error = f"subscription {subscription} refused: the number is in use, or has more than 32 bits"
            elif channel in self.subscriptions or channel not in channels:
                error = f"subscription {subscription} refused: channel {channel} is unknown, or already subscribed"
            else:
                self.subscriptions[channel] = subscription
                used.add(subscription)
                added.append(channel)
        self._viewers.add_subscriptions(added)
        return error

    def _unsubscribe(self, ended: set[int]) -> str:
        self.subscriptions = {
            channel: subscription
            for channel, subscription in self.subscriptions.items()
            if subscription not in ended
        }
        self._viewers.update_receivers()
        return ""

    async def _write(self) -> None:
        """Write notifications first, then messages, until the connection is closed."""
        try:
            while not self._is_closed:
                await self._has_pending.wait()
                self._has_pending.clear()
                while self._notifications or self._messages:
                    while self._notifications:
                        await self.write_message(self._notifications.popleft())
                    await self._write_some()
        except WebSocketClosedError:
            return

    async def _write_some(self) -> None:
        written = None
        for _ in range(min(_BATCH_SIZE, len(self._messages))):
            channel, log_time_ns, data = self._messages.popleft()
            subscription = self.subscriptions.get(channel)
            if subscription is not None:
                head = _MESSAGE.pack(_MESSAGE_DATA, subscription, log_time_ns)
                written = self.write_message(head + data, binary=True)
        if written is not None:
            await written


class Viewers:
    """All connected viewers and all offered channels.

    Other threads may only read the attributes, and take entries from ``new_subscriptions``.

    Attributes:
        channels: number of a channel → offered channel.
        receivers: number of a channel → connections that are subscribed to the channel.
        subscribed_topics: topics to which any viewer is subscribed.
        new_subscriptions: topics to which viewers have subscribed, in order.
        clients: all connections.
    """

    def __init__(self, name: str) -> None:
        self.channels: dict[int, Channel] = {}
        self._numbers: dict[str, int] = {}
        self.receivers: dict[int, tuple[Client, ...]] = {}
        self.subscribed_topics: frozenset[str] = frozenset()
        self.new_subscriptions: SimpleQueue[str] = SimpleQueue()
        self.clients: set[Client] = set()
        self._info = {"op": "serverInfo", "name": name, "capabilities": [], "sessionId": str(time.time_ns())}

    def add(self, client: Client) -> None:
        """Add a viewer, and send all channels to the viewer."""
        self.clients.add(client)
        client.notify(self._info)
        for channel in self.channels.values():
            client.notify({"op": "advertise", "channels": [channel.advertisement()]})

    def remove(self, client: Client) -> None:
        """Remove a viewer."""
        self.clients.discard(client)
        self.update_receivers()

    def offer(self, channel: Channel) -> None:
        """Offer a channel to all viewers, and end the former channel of its topic."""
        former = self._numbers.get(channel.topic)
        if former is not None:
            del self.channels[former]
            for client in self.clients:
                client.subscriptions.pop(former, None)
                client.notify({"op": "unadvertise", "channelIds": [former]})
            self.update_receivers()
        self.channels[channel.id], self._numbers[channel.topic] = channel, channel.id
        for client in self.clients:
            client.notify({"op": "advertise", "channels": [channel.advertisement()]})

    def add_subscriptions(self, numbers: Sequence[int]) -> None:
        """Update the receivers, and note the topics of channels to which a viewer has subscribed."""
        self.update_receivers()
        for number in numbers:
            self.new_subscriptions.put(self.channels[number].topic)

    def update_receivers(self) -> None:
        """Update the receivers of all channels."""
        receivers: dict[int, tuple[Client, ...]] = {}
        for client in self.clients:
            for number in client.subscriptions:
                receivers[number] = (*receivers.get(number, ()), client)
        self.receivers = receivers
        self.subscribed_topics = frozenset(self.channels[number].topic for number in receivers)


class _Application(Application):
    """Web application that answers viewers only."""

    def __init__(self, viewers: Viewers, hosts: OwnHosts) -> None:
        self._viewers, self._hosts = viewers, hosts
        super().__init__(
            [(r"/.*", Client, {"viewers": viewers})],
            websocket_max_message_size=MAX_MESSAGE_BYTES,
            websocket_ping_interval=_PING_S,
            websocket_ping_timeout=_PING_S,
        )

    def find_handler(self, request: HTTPServerRequest, **arguments: Any) -> Any:
        """Return the handler of a request; status 403 for other sites, 503 for too many viewers."""
        if not (self._hosts.is_own_host(request) and self._is_viewer(request)):
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})
        if len(self._viewers.clients) >= MAX_CLIENTS:
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 503})
        return super().find_handler(request, **arguments)

    def _is_viewer(self, request: HTTPServerRequest) -> bool:
        """True if the request comes from a viewer, or from a program that states no origin."""
        origin = request.headers.get("Origin", "")
        if origin == _DESKTOP_ORIGIN:
            return _DESKTOP_AGENT in request.headers.get("User-Agent", "")
        return (
            not origin or origin in VIEWERS or (host_of(origin) and self._hosts.is_own_origin(origin, request)) is True
        )


class FoxgloveServer:
    """Serves topics to viewers, which cannot publish, call services or set parameters.

    All methods except :meth:`close` must be called from one thread; the server runs in a separate thread.

    Attributes:
        address: address for clients.

    Args:
        name: name of the suite, which clients display.
        host: address to listen on; loopback serves this machine only.
        port: TCP port; 0 for a free port.
        allowed_hosts: further host names accepted in the Host of a request and in the Origin of a web page.

    Raises:
        BadInput: the port is in use, or the address does not belong to this machine.
    """

    def __init__(self, name: str, host: str, port: int, allowed_hosts: Sequence[str] = ()) -> None:
        sockets = listening_sockets(host, port, "--foxglove N")
        self.address = f"ws://{address_in_url(host)}:{sockets[0].getsockname()[1]}"
        self._numbers = itertools.count(1)
        self._types: dict[str, Channel] = {}
        self._viewers = Viewers(name)
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._thread = threading.Thread(
            target=self._run, args=(sockets, OwnHosts(host, allowed_hosts)), name="foxglove", daemon=True
        )
        self._thread.start()

    def offer(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic to clients; a topic with another type becomes a new channel.

        Args:
            topic: full name of the topic.
            type_name: type of the messages, as ``sensor_msgs/msg/Imu``.
            definition: definition of the type and of all types in it, in the form of rosbag2.
        """
        former = self._types.get(topic)
        if former is not None and former.type_name == type_name:
            return
        channel = self._types[topic] = Channel(next(self._numbers), topic, type_name, definition)
        self._loop.call_soon_threadsafe(self._viewers.offer, channel)

    def subscribed_topics(self) -> frozenset[str]:
        """Return the topics to which a client is subscribed."""
        return self._viewers.subscribed_topics

    def new_subscriptions(self) -> frozenset[str]:
        """Return the topics to which a client has subscribed since the last call."""
        waiting, topics = self._viewers.new_subscriptions, set()
        while not waiting.empty():
            topics.add(waiting.get_nowait())
        return frozenset(topics)

    def forward(self, topic: str, data: bytes, arrival_utc_ns: int) -> None:
        """Forward a message to the subscribers of its topic, without waiting. The topic must have been offered.

        Args:
            topic: full name of the topic.
            data: CDR bytes of the message.
            arrival_utc_ns: arrival of the message, UTC, ns.
        """
        channel = self._types[topic]
        for client in self._viewers.receivers.get(channel.id, ()):
            if client.enqueue(channel, data, arrival_utc_ns):
                self._loop.call_soon_threadsafe(client.wake)

    def close(self) -> None:
        """Close all connections; further calls do nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(2.0 * _CLOSE_TIMEOUT_S)

    def _run(self, sockets: list[Any], hosts: OwnHosts) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve(sockets, hosts))
        finally:
            self._loop.close()

    async def _serve(self, sockets: list[Any], hosts: OwnHosts) -> None:
        server = BoundedServer(_Application(self._viewers, hosts))
        server.add_sockets(sockets)
        await self._end.wait()
        server.stop()
        for client in list(self._viewers.clients):
            client.close(1001, "monitor has ended")
        deadline_s = time.monotonic() + _CLOSE_TIMEOUT_S
        while self._viewers.clients and time.monotonic() < deadline_s:
            await asyncio.sleep(0.01)
        for client in list(self._viewers.clients):
            client.abort()
        await server.close_all_connections()
        if left := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(left, timeout=_CLOSE_TIMEOUT_S)

"""Read-only server of topics for Foxglove and Lichtblick ("Foxglove WebSocket").

Messages are forwarded as bytes, with the definition of their type; the viewer decodes them. The oldest messages for a
slow client are dropped, so that a slow client delays no other client and needs no more memory.

The server uses the protocol of foxglove-sdk (``foxglove.sdk.v1``). The server of foxglove-sdk answers every web page.
This server answers only known viewers, programs that state no origin, and pages of its own hosts.
"""

import asyncio
import itertools
import threading
import time
from collections.abc import Sequence
from queue import SimpleQueue
from typing import Any

from tornado.httputil import HTTPServerRequest
from tornado.web import Application, ErrorHandler

from ship_monitor.foxglove.client import Channel, Client
from ship_monitor.web.bounded_server import MAX_MESSAGE_BYTES, BoundedServer, address_in_url, listening_sockets
from ship_monitor.web.own_hosts import OwnHosts, host_of

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

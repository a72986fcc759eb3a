"""The server that Foxglove and Lichtblick open as "Foxglove WebSocket". It gives out messages, and takes nothing.

Messages go on as the bytes that came, with the definition of their type; whoever opens the connection decodes them. A
client that is slow loses its oldest messages; it makes nobody wait and no memory grow.

The protocol is that of foxglove-sdk (``foxglove.sdk.v1``), whose own server answers every web page: here only those of
the viewers and of this machine are answered.
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
from ship_monitor.web.bounded_server import MOST_MESSAGE_BYTES, BoundedServer, address_in_url, listening_sockets
from ship_monitor.web.own_hosts import OwnHosts, host_of

VIEWERS = frozenset({"https://app.foxglove.dev", "https://embed.foxglove.dev", "https://studio.foxglove.dev"})
"""Origins of viewers that are pages of other sites."""

_DESKTOP_ORIGIN, _DESKTOP_AGENT = "file://", "Electron/"
"""Viewers on the desktop. A page that was saved to a file has the same origin; a browser names no Electron."""

MOST_CLIENTS = 32
_PING_S = 30.0
"""A client that does not answer a ping for so long is gone, s."""

_END_S = 1.0
"""How long the server may take to say goodbye, s."""


class Viewers:
    """All connected viewers and all offered channels. All but reading the attributes is of the server's thread.

    Attributes:
        channels: the offered ones, by their numbers.
        receivers: connections by number of the channel that they are subscribed to.
        wanted: topics that any viewer is subscribed to.
        newcomers: topics that viewers have subscribed to, in order.
    """

    def __init__(self, name: str) -> None:
        self.channels: dict[int, Channel] = {}
        self._numbers: dict[str, int] = {}
        self.receivers: dict[int, tuple[Client, ...]] = {}
        self.wanted: frozenset[str] = frozenset()
        self.newcomers: SimpleQueue[str] = SimpleQueue()
        self.clients: set[Client] = set()
        self._info = {"op": "serverInfo", "name": name, "capabilities": [], "sessionId": str(time.time_ns())}

    def add(self, client: Client) -> None:
        """Take a viewer that has come, and notify it of all channels."""
        self.clients.add(client)
        client.notify(self._info)
        for channel in self.channels.values():
            client.notify({"op": "advertise", "channels": [channel.advertised()]})

    def remove(self, client: Client) -> None:
        """Forget a viewer that has left."""
        self.clients.discard(client)
        self.update_wanted()

    def offer(self, channel: Channel) -> None:
        """Notify all viewers of a channel, and of the end of the topic's former one."""
        former = self._numbers.get(channel.topic)
        if former is not None:
            del self.channels[former]
            for client in self.clients:
                client.subscriptions.pop(former, None)
                client.notify({"op": "unadvertise", "channelIds": [former]})
            self.update_wanted()
        self.channels[channel.id], self._numbers[channel.topic] = channel, channel.id
        for client in self.clients:
            client.notify({"op": "advertise", "channels": [channel.advertised()]})

    def note_subscriptions(self, numbers: Sequence[int]) -> None:
        """Take note that a viewer has subscribed to some channels."""
        self.update_wanted()
        for number in numbers:
            self.newcomers.put(self.channels[number].topic)

    def update_wanted(self) -> None:
        """Compute again who receives what."""
        receivers: dict[int, tuple[Client, ...]] = {}
        for client in self.clients:
            for number in client.subscriptions:
                receivers[number] = (*receivers.get(number, ()), client)
        self.receivers = receivers
        self.wanted = frozenset(self.channels[number].topic for number in receivers)


class _Application(Application):
    """Answers viewers alone."""

    def __init__(self, viewers: Viewers, hosts: OwnHosts) -> None:
        self._viewers, self._hosts = viewers, hosts
        super().__init__(
            [(r"/.*", Client, {"viewers": viewers})],
            websocket_max_message_size=MOST_MESSAGE_BYTES,
            websocket_ping_interval=_PING_S,
            websocket_ping_timeout=_PING_S,
        )

    def find_handler(self, request: HTTPServerRequest, **arguments: Any) -> Any:
        """Return the handler of a request; one that refuses, of another site's and of one viewer too many."""
        if not (self._hosts.is_asked(request) and self._is_viewer(request)):
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})
        if len(self._viewers.clients) >= MOST_CLIENTS:
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 503})
        return super().find_handler(request, **arguments)

    def _is_viewer(self, request: HTTPServerRequest) -> bool:
        """True if a viewer asks, or a program that is no browser and has no origin."""
        origin = request.headers.get("Origin", "")
        if origin == _DESKTOP_ORIGIN:
            return _DESKTOP_AGENT in request.headers.get("User-Agent", "")
        return not origin or origin in VIEWERS or (host_of(origin) and self._hosts.is_origin(origin, request)) is True


class FoxgloveServer:
    """Serves topics to some viewers. Viewers cannot publish, call services or set parameters.

    All methods but :meth:`close` are of one thread; the server itself runs in a thread of its own.

    Attributes:
        address: as a client takes it.

    Args:
        name: of the suite, which clients show.
        host: address to listen on; loopback serves this machine alone.
        port: TCP port; 0 takes any.
        allowed_hosts: names under which viewers may ask, and whose pages are viewers, beyond this machine's.

    Raises:
        BadInput: the port is in use, or the address is not one of this machine.
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
        """Let clients see a topic. One whose type has changed is another one to them.

        Args:
            topic: its full name.
            type_name: of its messages, as ``sensor_msgs/msg/Imu``.
            definition: of the type with all that it refers to, as rosbag2 embeds it.
        """
        former = self._types.get(topic)
        if former is not None and former.type_name == type_name:
            return
        channel = self._types[topic] = Channel(next(self._numbers), topic, type_name, definition)
        self._loop.call_soon_threadsafe(self._viewers.offer, channel)

    def wanted(self) -> frozenset[str]:
        """Topics that a client is subscribed to at this moment."""
        return self._viewers.wanted

    def newcomers(self) -> frozenset[str]:
        """Topics that a client has subscribed to since the last call."""
        waiting, topics = self._viewers.newcomers, set()
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
        channel = self._types[topic]
        for client in self._viewers.receivers.get(channel.id, ()):
            if client.enqueue(channel, data, arrival_utc_ns):
                self._loop.call_soon_threadsafe(client.wake)

    def close(self) -> None:
        """Take leave of all clients, once."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(2.0 * _END_S)

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
            client.close(1001, "the monitor ends")
        deadline_s = time.monotonic() + _END_S
        while self._viewers.clients and time.monotonic() < deadline_s:
            await asyncio.sleep(0.01)
        for client in list(self._viewers.clients):
            client.abort()
        await server.close_all_connections()
        if left := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(left, timeout=_END_S)

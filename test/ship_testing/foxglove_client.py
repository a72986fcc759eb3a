"""Client of a Foxglove server with the part of its websocket protocol that the tests need.

Written from the protocol's description (foxglove/ws-protocol on GitHub), not from the server's code.
"""

import asyncio
import json
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

PROTOCOL = "foxglove.sdk.v1"

_MESSAGE_DATA = struct.Struct("<BIQ")
_MESSAGE_DATA_CODE = 1


@dataclass(frozen=True)
class Received:
    """One message: its topic, its log time (UTC, ns), and its bytes."""

    topic: str
    log_time_ns: int
    data: bytes


class FoxgloveClient:
    """One connection.

    Attributes:
        server_messages: messages of the server as received: ``serverInfo``, ``status`` and so on.
        channels: advertised channels by topic, as in ``advertise``.
        received: messages of the subscribed channels, in order of arrival.
    """

    def __init__(self, address: str, origin: str = "https://app.foxglove.dev") -> None:
        self.server_messages: list[dict[str, Any]] = []
        self.channels: dict[str, dict[str, Any]] = {}
        self.received: list[Received] = []
        self.is_over = False
        self._topics: dict[int, str] = {}
        self._count = 0
        self._reading: asyncio.Future[Any] | None = None
        self._loop = asyncio.new_event_loop()
        self._socket = self._run(self._connect(address, origin))
        assert self._socket.selected_subprotocol == PROTOCOL

    def subscribe(self, *topics: str) -> None:
        """Subscribe to advertised channels."""
        subscriptions = []
        for topic in topics:
            self._count += 1
            self._topics[self._count] = topic
            subscriptions.append({"id": self._count, "channelId": self.channels[topic]["id"]})
        self.send_request({"op": "subscribe", "subscriptions": subscriptions})

    def unsubscribe(self, topic: str) -> None:
        """Unsubscribe from the channels of a topic."""
        numbers = [number for number, name in self._topics.items() if name == topic]
        for number in numbers:
            del self._topics[number]
        self.send_request({"op": "unsubscribe", "subscriptionIds": numbers})

    def send_request(self, request: dict[str, Any] | bytes) -> None:
        """Send a request, as JSON or as bytes."""
        is_binary = isinstance(request, bytes)
        self._run(self._write(request if is_binary else json.dumps(request), is_binary))

    def wait_until(self, condition: Callable[[], Any], limit_s: float = 20.0) -> Any:
        """Return the result of a function once it is true; process messages of the server until then."""
        deadline_s = time.monotonic() + limit_s
        while not (found := condition()):
            assert time.monotonic() < deadline_s, (self.server_messages, self.channels.keys(), len(self.received))
            self.receive(0.05)
        return found

    def receive(self, duration_s: float) -> None:
        """Process the messages received within a time."""
        deadline_s = time.monotonic() + duration_s
        while not self.is_over and (left_s := deadline_s - time.monotonic()) > 0.0:
            self._run(self._take(left_s))

    def close(self) -> None:
        """Close the connection; a second call does nothing."""
        if self._loop.is_closed():
            return
        self._run(self._leave())
        # The server answers the closing.
        deadline_s = time.monotonic() + 5.0
        while not self.is_over and time.monotonic() < deadline_s:
            self.receive(0.05)
        self._loop.close()

    async def _leave(self) -> None:
        # Close in the loop of this client, because another test may have closed the loop of the thread.
        self._socket.close()

    async def _take(self, limit_s: float) -> None:
        # A cancelled read would lose its message, so the pending read is kept for the next call.
        if self._reading is None:
            self._reading = asyncio.ensure_future(self._socket.read_message())
        done, _ = await asyncio.wait([self._reading], timeout=limit_s)
        if done:
            content, self._reading = self._reading.result(), None
            self._process(content)

    def _process(self, content: str | bytes | None) -> None:
        if content is None:
            self.is_over = True
        elif isinstance(content, bytes):
            code, number, time_ns = _MESSAGE_DATA.unpack_from(content)
            assert code == _MESSAGE_DATA_CODE, code
            if number in self._topics:
                self.received.append(Received(self._topics[number], time_ns, content[_MESSAGE_DATA.size :]))
        else:
            message = json.loads(content)
            self.server_messages.append(message)
            if message["op"] == "advertise":
                self.channels |= {each["topic"]: each for each in message["channels"]}
            elif message["op"] == "unadvertise":
                gone = set(message["channelIds"])
                self.channels = {name: each for name, each in self.channels.items() if each["id"] not in gone}

    async def _write(self, content: str | bytes, is_binary: bool) -> None:
        await self._socket.write_message(content, binary=is_binary)

    async def _connect(self, address: str, origin: str) -> Any:
        request = HTTPRequest(address, headers={"Origin": origin}, connect_timeout=20.0)
        return await websocket_connect(request, subprotocols=[PROTOCOL], max_message_size=100_000_000)

    def _run(self, work: Any) -> Any:
        return self._loop.run_until_complete(work)


def client_that_never_reads(address: str, channel_id: int) -> socket.socket:
    """Return the socket of a client that has subscribed to a channel and never reads."""
    client = socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2])))
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.sendall(
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    )
    assert client.recv(12) == b"HTTP/1.1 101"
    text = json.dumps({"op": "subscribe", "subscriptions": [{"id": 0, "channelId": channel_id}]}).encode()
    # RFC 6455: one text frame, masked with zeros.
    client.sendall(bytes([0x81, 0x80 | len(text)]) + bytes(4) + text)
    return client

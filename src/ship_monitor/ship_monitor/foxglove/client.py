"""One viewer of the Foxglove server: its websocket, its subscriptions, and its pending messages."""

import asyncio
import json
import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tornado.websocket import WebSocketClosedError, WebSocketHandler

if TYPE_CHECKING:
    from ship_monitor.foxglove.server import Viewers

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

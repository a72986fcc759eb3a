"""Calls of an adapter by a live node: results are published; a black box records the calls and the results."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from ship_bags.cdr_template import CdrMessage
from ship_estimation.parameters.schema import ParameterError
from ship_node.adapters.adapter import Adapter, Overload, ServiceResult
from ship_node.black_box.black_box_format import (
    ChangeRefused,
    ClockJumpedBack,
    ClockStepped,
    DuplicatePublishersChanged,
    Event,
    ParametersChanged,
    ServiceCalled,
    Tick,
)
from ship_node.live.node_report import StatusLog
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import Batch, OutputMessage
from ship_node.saved_files.saved_document import RecordingFiles

if TYPE_CHECKING:
    from ship_node.black_box.black_box import BlackBox


class AdapterCalls:
    """Calls of an adapter; an exception of the adapter is raised after the call was recorded.

    ``now_ns`` is the node time, ``waiting_ns`` the timeout-clock time (:class:`ship_node.adapters.adapter.Adapter`).

    Args:
        adapter: the adapter.
        publishers: topic → publisher, for all outputs of the adapter.
        files: files that the adapter reads and writes.
        black_box: black box for calls and results; None if there is no black box.
        status_log: logs the adapter's diagnostics; None for no log.
    """

    def __init__(
        self,
        adapter: Adapter,
        publishers: Mapping[str, Publisher],
        files: RecordingFiles,
        black_box: "BlackBox | None",
        status_log: StatusLog | None = None,
    ) -> None:
        self._adapter = adapter
        self._publishers = publishers
        self._files = files
        self._black_box = black_box
        self._status_log = status_log
        self._record_files(0)

    def handle(self, topic: str, data: bytes, message: Any, now_ns: int, waiting_ns: int | None = None) -> None:
        """Give the adapter a message; ``data`` are its bytes."""
        try:
            published = self._adapter.process(Batch.of_message(topic, message, now_ns, waiting_ns)).output_messages()
        finally:
            if self._black_box is not None:
                self._record_files(now_ns)
                self._black_box.add(topic, data, now_ns, waiting_ns)
        self.publish(published, now_ns)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> None:
        """Tick the adapter."""
        published = self._call(Tick(), partial(self._adapter.tick, now_ns, waiting_ns), now_ns, waiting_ns)
        if self._status_log is not None:
            for topic, message in published:
                if topic == DIAGNOSTICS_TOPIC:
                    self._status_log.update(_logged_statuses(message))

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> None:
        """Report to the adapter that the node is behind, or keeps up again."""
        self._call(change, partial(self._adapter.overload, change, now_ns, waiting_ns), now_ns, waiting_ns)

    def set_duplicate_publishers(self, topic: str, text: str, now_ns: int, waiting_ns: int) -> None:
        """Report to the adapter that two publishers send on a topic or, with an empty text, that this has ended."""
        try:
            self._adapter.set_duplicate_publishers(topic, text)
        finally:
            self._record_event(DuplicatePublishersChanged(topic, text), now_ns, waiting_ns)

    def clock_jumped_back(self, now_ns: int) -> None:
        """Report to the adapter that the node's clock went back."""
        self._call(ClockJumpedBack(), partial(self._adapter.clock_jumped_back, now_ns), now_ns)

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> None:
        """Report to the adapter that the computer's clock stepped."""
        call = partial(self._adapter.clock_stepped, step_ns, now_ns, waiting_ns)
        self._call(ClockStepped(step_ns), call, now_ns, waiting_ns)

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Call a service of the adapter."""
        answer: ServiceResult | tuple[None, None] = (None, None)
        try:
            answer = result = self._adapter.service(name, now_ns)
        finally:
            self._record_event(ServiceCalled(name, *answer), now_ns)
        return result

    def set_parameters(self, changes: Mapping[str, Any], now_ns: int) -> None:
        """Pass live parameters to the adapter."""
        refused: str | None = "it raised"
        try:
            self._adapter.set_parameters(changes)
            refused = None
        except ParameterError as error:
            refused = str(error)
            raise
        finally:
            self._record_event(ParametersChanged(dict(changes), refused), now_ns)

    def record_refusal(self, changes: Mapping[str, Any], reason: str, now_ns: int) -> None:
        """Record live parameters that are refused without calling the adapter."""
        self._record_event(ChangeRefused(dict(changes), reason), now_ns)

    def publish(self, published: list[OutputMessage], now_ns: int) -> None:
        """Publish messages; each is serialised once, for the subscribers and for the black box."""
        outputs = [(topic, message_bytes(message)) for topic, message in published]
        if self._black_box is not None:
            for topic, data in outputs:
                self._black_box.add(topic, data, now_ns)
        for topic, data in outputs:
            self._publishers[topic].publish(data)

    def _call(
        self, event: Event, call: Callable[[], list[OutputMessage]], now_ns: int, waiting_ns: int | None = None
    ) -> list[OutputMessage]:
        """Call the adapter, record the event, then publish the results."""
        try:
            published = call()
        finally:
            self._record_event(event, now_ns, waiting_ns)
        self.publish(published, now_ns)
        return published

    def _record_event(self, event: Event, now_ns: int, waiting_ns: int | None = None) -> None:
        if self._black_box is not None:
            self._record_files(now_ns)
            self._black_box.add_event(event, now_ns, waiting_ns)

    def _record_files(self, now_ns: int) -> None:
        """Record the files that the last call, or the construction of the adapter, has used."""
        for use in self._files.uses:
            if self._black_box is not None:
                self._black_box.add_file(use, now_ns)
        self._files.uses.clear()


def message_bytes(message: Any) -> bytes:
    """Return the bytes of an adapter's message."""
    return message.__cdr__ if isinstance(message, CdrMessage) else serialize_message(message)


def _logged_statuses(message: Any) -> Iterator[DiagnosticStatus]:
    """Yield the statuses of a DiagnosticArray for the log, without the statuses of inputs, which change often."""
    for status in message.status:
        name = status.name.partition(": ")[2]
        if not name.startswith("input "):
            yield DiagnosticStatus(name, Level(status.level), status.message)

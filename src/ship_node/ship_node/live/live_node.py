"""Live rclpy node around an adapter: inputs, ticks, services and parameters.

A callback only adds its message to a bounded inbox. After each round of events, the adapter gets the oldest message
(:mod:`ship_node.live.node_events`) through :class:`ship_node.live.adapter_calls.AdapterCalls`, which publishes
the results. Before the message the adapter gets all ticks up to the message's receive time, on a grid of the timeout
clock (:mod:`ship_node.live.node_clock`). An exception of the adapter does not end the node
(:mod:`ship_node.live.node_report`).
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from std_srvs.srv import Trigger

from ship_bags.message_factory import RosidlFactory
from ship_estimation.rejection_rules import Reason
from ship_geometry.input_error import InputError
from ship_node.adapters.adapter import TICK_PERIOD_NS, Adapter, ServiceResult
from ship_node.live.adapter_calls import AdapterCalls
from ship_node.live.node_clock import NodeClock, TickGrid
from ship_node.live.node_events import Backlog, Inbox, NodeEvents, OverloadChange, WaitingMessage, current_overload
from ship_node.live.node_report import ExceptionGuard, NodeLog, StatusLog, name_status, stamps_status, start_line
from ship_node.live.node_topics import InputSubscriptions, create_publisher
from ship_node.live.ros_parameters import NodeParameters, ParameterNode
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, diagnostic_array
from ship_node.messages.inputs_outputs import OutputTopic
from ship_node.parameters.parameter_file import error_with_location, section_warnings
from ship_node.saved_files.saved_document import RecordingFiles

if TYPE_CHECKING:
    from ship_node.black_box.black_box import BlackBox

SPIN_TIMEOUT_S = 0.1
WATCH_PERIOD_S = 1.0
MIN_JUMP_BACK = Duration(nanoseconds=-100_000_000)
"""Smallest jump back of the clock that restarts the adapter; /clock may go back by less if two computers publish it."""

MAX_CATCH_UP_NS = 10_000_000_000
"""Longest jump forward for which missed ticks are made up, ns; after a longer jump the tick grid restarts."""


class LiveNode:
    """Live node around an adapter.

    Attributes:
        node: the rclpy node.
        adapter: the adapter.

    Args:
        adapter_class: adapter to run.
        context: an initialised rclpy context.
        parameter_files: parameter files of the command line, to check their sections and to locate a bad parameter.

    Raises:
        BadInput: a parameter is unknown, of the wrong type, out of its range or missing; or a file has a section for a
            node of (nearly) this name, but no section that matches this node.
    """

    def __init__(self, adapter_class: type[Adapter], context: Context, parameter_files: tuple[Path, ...] = ()) -> None:
        self.node: Node = ParameterNode(adapter_class.node_name, context=context)
        self._full_name = self.node.get_fully_qualified_name()
        self._log = NodeLog(self.node)
        self._guard = ExceptionGuard(self._log, time.monotonic_ns)
        self._events = NodeEvents(context, self._guard, time.monotonic_ns)
        self._clock = NodeClock(self.node, time.monotonic_ns, self._events.note_event)
        self._context = context
        factory = RosidlFactory()
        try:
            for warning in section_warnings(parameter_files, self._full_name):
                self._log.warning(warning)
            self._parameters = NodeParameters(self.node, adapter_class.config_type)
            files = RecordingFiles()
            self.adapter = adapter_class(self._parameters.config, factory, files)
            self._publishers = {o.topic: create_publisher(self.node, o) for o in _outputs(self.adapter)}
            self._inputs = InputSubscriptions(
                self.node,
                self.adapter,
                self._parameters,
                factory,
                self._guard,
                self._log,
                self._on_message,
                self._events.note_event,
            )
            self._black_box = self._open_black_box()
        except InputError as error:
            self.node.destroy_node()
            raise error_with_location(error, parameter_files, self._full_name) from error
        self._calls = AdapterCalls(self.adapter, self._publishers, files, self._black_box, StatusLog(self._log))
        self._parameters.connect_adapter(self._calls, self._clock.now_ns, self._handle_all)
        self._grid = TickGrid()
        self._last_node_ns = self._last_ns = self._stepped_ns = 0
        self._status_log = StatusLog(self._log)
        valid_until_next = {i.topic for i in self.adapter.inputs if i.is_valid_until_next}
        self._inbox = Inbox(self._inputs.depths, valid_until_next)
        self._backlog = Backlog(time.monotonic_ns)
        # Time by the running clock when no event was left; a message received later has arrived after this time.
        self._queue_empty_ns = 0
        for name in adapter_class.services:
            self.node.create_service(Trigger, f"~/{name}", partial(self._serve, name))
        clock = self.node.resolve_topic_name("/clock") if self._clock.is_simulated() else ""
        box = self._parameters.black_box  # the path in use is logged already, with a number if the file existed
        self._log.info(start_line(self.adapter, self._parameters.config, clock, box))
        for warning in self.adapter.start_warnings:
            self._log.warning(warning)
        self._warn_of_unused_overrides()
        self._create_clocks()
        self._events.start(self.node)

    def spin(self, stop: Callable[[], bool]) -> None:
        """Run until ``stop()`` returns True or the context ends."""
        self._queue_empty_ns = self._clock.running_ns()
        while not stop() and self._context.ok():
            if self._events.process_events(0.0 if self._inbox and self._last_ns else SPIN_TIMEOUT_S):
                self._queue_empty_ns = self._clock.running_ns()
            self._guard.call("backlog", self._check_backlog, self._clock.running_ns(), self._clock.times)
            self._guard.call("work", self._work)
            if self._clock.is_timed_out() and not self._status_log.has_open_error("clock"):
                self._guard.call("watch", self._watch)

    def close(self) -> None:
        """Finish the black box and release all resources of the middleware."""
        if self._black_box is not None:
            self._black_box.close()
        self._jump_handle.unregister()
        self._events.close()
        self.node.destroy_node()

    def _open_black_box(self) -> "BlackBox | None":
        path, config = self._parameters.black_box, self._parameters.config
        if not path:
            return None
        # Imported only for a black box, because importing the bag writer takes a tenth of a node's start time.
        from ship_node.black_box.black_box import BlackBox

        outputs, part_bytes = _outputs(self.adapter), self._parameters.black_box_part_bytes
        namespace = self.node.get_namespace()
        box = BlackBox(path, self.adapter, config, outputs, namespace, self._log.error, part_bytes)
        self._log.info(f"black box: {box.path}")
        return box

    def _create_clocks(self) -> None:
        """Create the tick timer, the timer for periodic checks on a steady clock, and the callback for a jump back."""
        clock = self.node.get_clock()
        self.node.create_timer(TICK_PERIOD_NS * 1e-9, self._events.note_event)
        self.node.create_timer(
            WATCH_PERIOD_S,
            partial(self._guard.call, "watch", self._watch),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self._jump_handle = clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=MIN_JUMP_BACK, on_clock_change=False),
            post_callback=partial(self._guard.call, "clock jump", self._on_jump_back),
        )

    def _warn_of_unused_overrides(self) -> None:
        for name in self.node._parameter_overrides:
            if name.startswith("qos_overrides.") and not self.node.has_parameter(name):
                self._log.warning(f"parameter '{name}' names no topic and policy of this node")

    def _on_message(self, topic: str, message: tuple[bytes, Mapping[str, Any]]) -> None:
        self._events.note_event()
        data, information = message
        now_ns, waiting_ns = self._clock.times()
        # The EventsExecutor of rclpy 7.1.6 cannot pass on the time of reception, so queue_empty_ns stands for it.
        self._inbox.add(WaitingMessage(topic, data, now_ns, waiting_ns, self._queue_empty_ns, self._clock.stepped_ns))
        if self._inputs.add_message(topic, information["publication_sequence_number"]):
            self._check_publishers(topic)

    def _check_backlog(self, running_ns: int, times: Callable[[], tuple[int, int]]) -> None:
        """Drop the waiting messages if the node is behind; report each change to the adapter.

        Args:
            running_ns: time by the running clock.
            times: returns node time and timeout-clock time of a change.
        """
        since_ns = max(self._inbox.oldest_queued_ns, self._clock.started_ns)
        waited_ns = running_ns - since_ns if self._inbox else 0
        change = self._backlog.evaluate(waited_ns, running_ns)
        if change is OverloadChange.NONE:
            return
        now_ns, waiting_ns = times()
        if change is OverloadChange.BEHIND:
            self._inbox.cut_all(now_ns, waiting_ns, running_ns)
        else:
            self._inbox.resume()
            waited_ns = 0
        self._calls.overload(current_overload(waited_ns, self._inbox.take_overload_cuts()), now_ns, waiting_ns)

    def _check_publishers(self, topic: str) -> None:
        now_ns, waiting_ns = self._clock.times()
        text = self._inputs.check_publishers(topic, bool(now_ns))
        if text is not None:
            self._calls.set_duplicate_publishers(topic, text, now_ns, waiting_ns)

    def _work(self) -> None:
        """Tick the adapter, then give it the next message; if no message waits, only tick up to the current time."""
        if not self._inbox:
            times_ns = self._clock.times()
            self._report_clock_step(self._clock.stepped_ns, *times_ns)
            self._advance(*times_ns)
        elif self._last_ns or self._clock.now_ns():
            message = self._inbox.take()
            now_ns, waiting_ns = (message.now_ns, message.waiting_ns) if message.now_ns else self._clock.times()
            self._report_clock_step(message.stepped_ns, now_ns, waiting_ns)
            self._advance(now_ns, waiting_ns)
            self._guard.call(message.topic, self._handle, message.topic, message.data, now_ns, waiting_ns)
        for notice in self.adapter.notices:
            self._log.info(notice)
        self.adapter.notices.clear()

    def _report_clock_step(self, stepped_ns: int, now_ns: int, waiting_ns: int) -> None:
        """Report a step of the system's clock to the adapter, in order with the messages."""
        step_ns, self._stepped_ns = stepped_ns - self._stepped_ns, stepped_ns
        if step_ns:
            self._guard.call("clock step", self._calls.clock_stepped, step_ns, now_ns, waiting_ns)

    def _handle_all(self) -> None:
        """Give the adapter all waiting messages before another call."""
        while self._inbox and self._clock.now_ns():
            self._work()

    def _handle(self, topic: str, data: bytes, now_ns: int, waiting_ns: int) -> None:
        self._calls.handle(topic, data, self._inputs.message(topic, data), now_ns, waiting_ns)

    def _advance(self, now_ns: int, waiting_ns: int) -> None:
        """Tick up to the current time, then report failures and dropped messages.

        Both times are 0 while the node waits for its first /clock; then nothing is done.
        """
        if now_ns == 0:
            return
        if self._last_ns and waiting_ns - self._last_ns > MAX_CATCH_UP_NS:
            self._grid.restart(waiting_ns)
        for tick_ns in self._grid.ticks_until(waiting_ns):
            # Even if the clock is frozen, no tick is before the last node time, unless the clock itself was set back.
            node_ns = max(now_ns - (waiting_ns - tick_ns), min(now_ns, self._last_node_ns))
            self._guard.call("tick", self._calls.tick, node_ns, tick_ns)
        self._last_node_ns, self._last_ns = now_ns, waiting_ns
        for text in self.adapter.health.take_failures():
            self._guard.record(text)
        for (topic, why), count in self._inbox.take_cuts().items():
            self.adapter.health.record_dropped(topic, count, Reason.OVERFLOW, why, waiting_ns)

    def _on_jump_back(self, jump: TimeJump) -> None:
        # A node that is behind drops its messages; processing them all could take minutes without another check.
        before_ns = self._clock.running_ns() - jump.delta.nanoseconds
        last = (self._last_node_ns, self._last_ns) if self._last_ns else self._clock.times()
        self._guard.call("backlog", self._check_backlog, before_ns, lambda: last)
        self._handle_all()
        self._clock.reset()
        self._backlog.restart()
        self._inbox.resume()
        self._queue_empty_ns = self._clock.running_ns()
        now_ns, waiting_ns = self._clock.times()
        self._log.warning(f"clock went back by {-jump.delta.nanoseconds * 1e-9:.3f} s: restarting")
        self._grid.restart(waiting_ns)
        self._last_node_ns, self._last_ns = now_ns, waiting_ns
        self._calls.clock_jumped_back(now_ns)

    def _serve(self, name: str, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._handle_all()
        now_ns = self._clock.now_ns()
        result: ServiceResult | None = ServiceResult(False, "the clock has not started: no /clock received yet")
        if now_ns:
            result = self._guard.call(f"~/{name}", self._calls.service, name, now_ns)
        response.success, response.message = result or (False, "failed with an exception: see the node's log")
        self._log.info(f"~/{name}: {'done' if response.success else 'failed'}: {response.message}")
        return response

    def _watch(self) -> None:
        """Run the periodic checks that need no message, and publish the diagnostics of the node runtime."""
        self._events.note_event()
        for each in self.adapter.inputs:
            self._check_publishers(each.topic)
        self.adapter.health.set_clock_unused(
            not self._clock.is_simulated() and self.node.count_publishers("/clock") > 0
        )
        statuses = [self._clock.status(), name_status(self.node), self._events.status()]
        self._status_log.update([*statuses, stamps_status(self.adapter.health)])
        statuses += [self._guard.status(), self._parameters.status()]
        if self._black_box is not None:
            statuses.append(self._black_box.status())
        now_ns = self._clock.now_ns()
        message = diagnostic_array(now_ns, self.node.get_name(), statuses, self._full_name)
        self._calls.publish([(DIAGNOSTICS_TOPIC, message)], now_ns)


def _outputs(adapter: Adapter) -> tuple[OutputTopic, ...]:
    """Return the adapter's outputs and the diagnostics, which every node has."""
    diagnostics = OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE)
    others = tuple(output for output in adapter.outputs if output.topic != DIAGNOSTICS_TOPIC)
    return (*others, diagnostics)

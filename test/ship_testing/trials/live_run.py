"""Live run of a node with one bag: node, recorder and player are processes that communicate over DDS."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from rcl_interfaces.srv import GetParameters

from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import Bag, read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.topic_names import TRUTH_PREFIX, relative_topics
from ship_node.adapters.adapter import Adapter
from ship_node.parameters.parameter_file import load_config
from ship_replay.offline.adapter_chain import suite_text
from ship_replay.offline.replay import match_inputs
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

_START_S = 30.0
# Time for a node that fell behind to process its queue.
_ANSWER_S = 120.0
_POLL_S = 0.1
_LOG_LINES = 15
# The recording is complete if it grows in this time by no more than a node's periodic output: after the last /clock a
# node continues to publish INVALID and its status once a second.
_QUIET_PERIOD_S = 1.0
_IDLE_GROWTH_BYTES = 20_000


class LiveFailure(Exception):
    """A process of a live run ended or does not respond; the text contains the end of its log."""


class LiveRun:
    """Processes of one run; use it in a ``with`` statement.

    The constructor starts node and recorder, and returns when they are connected; :meth:`play` starts the player.

    Args:
        bag_path: bag with the attached suite configuration, and with inputs on topics without namespace.
        adapter_class: adapter of the node to run.
        package: package of the node's executable, which has the name of the node.
        folder: folder for configuration, logs and the recorded bag; files of an earlier run are overwritten.
        parameters: parameters that override those of the bag's configuration.

    Attributes:
        recorded_path: path of the recorded bag.
        played_topics: names that the node's input topics and the truth topics have in the bag.
        node: process of the node.
        environment: environment of the processes, with a ROS domain that only this run uses.
        observer: another node in this domain, for services and waiting.

    Raises:
        BadInput: bag or configuration cannot be used, or an executable is not installed.
        LiveFailure: node or recorder ended or does not respond.
    """

    def __init__(
        self,
        bag_path: Path,
        adapter_class: type[Adapter],
        package: str,
        folder: Path,
        parameters: Mapping[str, str] | None = None,
    ) -> None:
        self.recorded_path = folder / "recorded.mcap"
        self._bag_path = bag_path
        self._node_name = adapter_class.node_name
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        with read_bag(bag_path) as bag:
            self._plan(bag, adapter_class)
        domain_id = free_domain_id()
        self.environment = live_environment(domain_id, folder / "ros")
        with contextlib.ExitStack() as stack:
            self.observer = stack.enter_context(GraphObserver(domain_id))
            own = [item for name, value in (parameters or {}).items() for item in ("-p", f"{name}:={value}")]
            # Reliable transport, so that runs on a busy machine can be compared.
            for topic in self._inputs:
                own += ["-p", f"qos_overrides./{topic.lstrip('/')}.subscription.reliability:=reliable"]
            arguments = ["--ros-args", "--params-file", str(self._suite_path), "-p", "use_sim_time:=true", *own]
            node_command = [*executable(package, adapter_class.node_name), *arguments]
            self.node = stack.enter_context(self._start(node_command, adapter_class.node_name))
            self._recorder = self._start_recorder(stack)
            self._close = stack.pop_all().close

    def play(self, rate: float, report_elapsed: Callable[[float], None] = lambda elapsed_s: None) -> None:
        """Play the bag to its end and wait until node and recorder have finished.

        Args:
            rate: seconds of the bag per second.
            report_elapsed: function that is called periodically with the steady time since the start, s.

        Raises:
            LiveFailure: a process failed.
        """
        matches = [f"{topic}=2" for topic in self._inputs] + [f"{topic}=1" for topic in self._truth]
        command = [*executable("ship_bags", "play"), str(self._bag_path), "--rate", str(rate)]
        begin_s = time.monotonic()
        command += ["--topics", *self.played_topics, "--wait-for-subscribers", *matches]
        with self._start(command, "play") as player:
            while player.exit_code is None:
                self._check_alive()
                report_elapsed(time.monotonic() - begin_s)
                time.sleep(_POLL_S)
            if player.exit_code != 0:
                raise LiveFailure(_failure_text(player, "play"))
        self._wait_for_node()
        self._wait_for_recorder()

    def _wait_for_node(self) -> None:
        """Wait until the node has processed all inputs: it answers a request only after all inputs received before."""
        name = f"/{self._node_name}/get_parameters"
        client = self.observer.node.create_client(GetParameters, name)
        request = GetParameters.Request(names=["use_sim_time"])
        if self.observer.spin_until(client.service_is_ready, _START_S):
            answer = client.call_async(request)
            if self.observer.spin_until(lambda: answer.done() or self.node.exit_code is not None, _ANSWER_S):
                self._check_alive()
                return
        raise LiveFailure(_failure_text(self.node, "the node"))

    def _wait_for_recorder(self) -> None:
        """Wait until the recording stops growing, then end the recorder."""
        size, still_since_s = 0, time.monotonic()
        while time.monotonic() - still_since_s < _QUIET_PERIOD_S:
            self._check_alive()
            time.sleep(_POLL_S)
            if self.recorded_path.stat().st_size > size + _IDLE_GROWTH_BYTES:
                size, still_since_s = self.recorded_path.stat().st_size, time.monotonic()
        if self._recorder.end() != 0:
            raise LiveFailure(_failure_text(self._recorder, "record"))

    def __enter__(self) -> "LiveRun":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._close()

    def _plan(self, bag: Bag, adapter_class: type[Adapter]) -> None:
        """Determine the input and output topics, and write the node's configuration."""
        text = suite_text(bag, None)
        self._suite_path = self._folder / "suite.yaml"
        self._suite_path.write_text(text, encoding="utf-8")
        config: Any = load_config(adapter_class.config_type, self._suite_path, adapter_class.node_name)
        adapter = adapter_class(config, RosbagsFactory())
        self._inputs = list(match_inputs(bag, adapter, namespace=""))
        names = relative_topics(bag.topics)
        self._truth = [name for relative, name in names.items() if relative.startswith(TRUTH_PREFIX)]
        self.played_topics = [*self._inputs, *self._truth]
        # Diagnostics are published by wall time without end: their recording would never be complete.
        self._outputs = [output.topic for output in adapter.outputs if not output.topic.startswith("/")]

    def _start(self, command: Sequence[str], name: str) -> LiveProcess:
        return LiveProcess(command, self._folder / f"{name}.log", self.environment)

    def _start_recorder(self, stack: contextlib.ExitStack) -> LiveProcess:
        """Start the recorder once the node is running; node and recorder are connected on return."""
        there = {f"/{topic}": 1 for topic in self._outputs}
        if not self.observer.wait_for(there, timeout_s=_START_S, unless=lambda: self.node.exit_code is not None):
            raise LiveFailure(_failure_text(self.node, "the node"))
        self.recorded_path.unlink(missing_ok=True)
        topics = [*self.played_topics, *self._outputs]
        command = [*executable("ship_bags", "record"), "--out", str(self.recorded_path), "--use-sim-time"]
        recorder = self._start([*command, "--topics", *topics], "record")
        stack.enter_context(recorder)
        if not self.observer.wait_for(
            subscribers=there, timeout_s=_START_S, unless=lambda: recorder.exit_code is not None
        ):
            raise LiveFailure(_failure_text(recorder, "record"))
        return recorder

    def _check_alive(self) -> None:
        for process, name in ((self.node, "the node"), (self._recorder, "record")):
            if process.exit_code is not None:
                raise LiveFailure(_failure_text(process, name))


def _failure_text(process: LiveProcess, name: str) -> str:
    code = process.exit_code
    what = f"{name} does not respond" if code is None else f"{name} ended with exit code {code}"
    tail = "\n".join(process.log_text().splitlines()[-_LOG_LINES:])
    return f"{what}; its log {process.log_path} ends:\n{tail or '(empty)'}"

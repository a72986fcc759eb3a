"""Peer of ``nmea_in``: subscribes to its outputs and sends sentences to it."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from ship_bags.message_factory import message_class
from ship_bags.parameter_yaml import sections_text
from ship_bags.stamps import stamp_fields
from ship_estimation.parameters.schema import build
from ship_nmea.instruments.config import NmeaInConfig
from ship_nmea.instruments.nmea_in import NAME, NmeaIn
from ship_nmea.nmea_node import NmeaNode

TIMEOUT_S = 20.0
_DEPTH = 5000


START = "import sys; from ship_nmea.instruments.nmea_in import main; sys.exit(main())"


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """Return an unused port."""
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


class NmeaInPeer:
    """The node under test and its peer.

    Args:
        path: path of the node's parameter file.
        sources: id → parameters of a source.
        namespace: namespace of the node.
        use_sim_time: True to use /clock.
        as_process: True to run the node as a process, whose log is next to the parameter file; False for a thread.

    Attributes:
        received: topic → the messages received.
        process: process of the node; None if the node runs in a thread.
        log: log file of the node, if the node is a process.
    """

    def __init__(
        self,
        path: Path,
        sources: dict[str, dict[str, Any]],
        namespace: str = "",
        use_sim_time: bool = False,
        as_process: bool = False,
    ) -> None:
        path.write_text(sections_text({f"/**/{NAME}": {"use_sim_time": use_sim_time, "sources": sources}}))
        arguments = ["--ros-args", "--params-file", str(path), "-r", f"__ns:=/{namespace}"]
        self.config = build(NmeaInConfig, {"sources": sources})
        self.log = path.with_suffix(".log")
        self.context = Context()
        self.process = self.live = None
        if as_process:
            rclpy.init(args=[], context=self.context)
            with self.log.open("w") as log:
                self.process = subprocess.Popen([sys.executable, "-c", START, *arguments], stderr=log)
        else:
            rclpy.init(args=[NAME, *arguments], context=self.context)
            self.live = NmeaNode(NAME, NmeaInConfig, NmeaIn, self.context, (path,))
            self._stop = threading.Event()
            self._thread = threading.Thread(target=self.live.spin, args=(self._stop.is_set,))
            self._thread.start()
        self.peer = rclpy.create_node("peer", context=self.context, namespace=namespace, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.peer)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._diagnostics: dict[str, Any] = {}
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._record_diagnostics, 100)
        topics = {
            topic: type_name for id_ in sources for topic, type_name in self.config.role(id_).topics(id_).items()
        }
        self.received = {topic: [] for topic in topics}
        for topic, type_name in topics.items():
            take = self.received[topic].append
            self.peer.create_subscription(message_class(type_name), topic, take, QoSProfile(depth=_DEPTH))
        # The node is connected when its first report has arrived, because its publisher of reports is the first.
        self.wait_until(lambda: self._diagnostics)
        self.wait_until(lambda: all(self.peer.count_publishers(topic) == 1 for topic in topics))

    def close(self) -> None:
        self._socket.close()
        if self.process is not None:
            self.process.kill()
            self.process.wait()
        if self.live is not None:
            self._stop.set()
            self._thread.join()
            self.live.close()
        self._executor.shutdown()
        self.peer.destroy_node()
        self.context.try_shutdown()

    def send(self, id_: str, data: bytes) -> None:
        """Send one datagram to a source."""
        self._socket.sendto(data, ("127.0.0.1", self.config.sources[id_].port))

    def set_time(self, time_ns: int) -> None:
        """Set the node's time by /clock, and wait until the node has this time; for a node in a thread."""
        assert self.live is not None
        live = self.live
        publisher = self.peer.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        self.wait_until(lambda: publisher.get_subscription_count() == 1)
        message = Clock()
        message.clock.sec, message.clock.nanosec = stamp_fields(time_ns)
        publisher.publish(message)
        self.wait_until(lambda: live.clock.now_ns() == time_ns)
        self.peer.destroy_publisher(publisher)

    def source_status(self, id_: str) -> tuple[int, str, dict[str, str]]:
        """Return level, text and values of a source in the last report; level -1 before the first report."""
        status = self._diagnostics.get(f"{NAME}: source {id_}")
        if status is None:
            return -1, "", {}
        return status.level[0], status.message, {pair.key: pair.value for pair in status.values}

    def exception_text(self) -> str:
        """Return the exceptions that the node reports."""
        return str(self._diagnostics[f"{NAME}: callbacks"].message)

    def spin(self) -> None:
        """Process waiting messages."""
        self._executor.spin_once(timeout_sec=0.01)

    def wait_until(self, condition: Callable[[], Any]) -> Any:
        """Process messages until the condition is true; return its result."""
        deadline_s = time.monotonic() + TIMEOUT_S
        while not (found := condition()):
            assert time.monotonic() < deadline_s, {name: status.message for name, status in self._diagnostics.items()}
            self.spin()
        return found

    def _record_diagnostics(self, message: DiagnosticArray) -> None:
        self._diagnostics |= {status.name: status for status in message.status}

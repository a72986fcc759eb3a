"""Relay node that spins in a thread of this process, and a peer that communicates with it over DDS."""

import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from ship_bags.stamps import stamp_fields
from ship_msgs.msg import ShipAttitude
from ship_node.live.live_node import LiveNode
from ship_testing.relay_adapter import RelayAdapter

RELIABLE_INPUT = ("-p", "qos_overrides./ins/imu.subscription.reliability:=reliable")
SIM_TIME = ("-p", "use_sim_time:=true")
TIMEOUT_S = 15.0


class LiveRelay:
    """The node under test and its peer.

    Args:
        ros_arguments: arguments after ``--ros-args``.
    """

    def __init__(self, *ros_arguments: str) -> None:
        self.context = Context()
        rclpy.init(args=["relay", "--ros-args", *ros_arguments], context=self.context)
        self.live = LiveNode(RelayAdapter, self.context)
        self.adapter: Any = self.live.adapter
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.live.spin, args=(self._stop.is_set,))
        self._thread.start()
        self.peer = rclpy.create_node("peer", context=self.context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.peer)
        self.attitudes: list[ShipAttitude] = []
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        self.peer.create_subscription(ShipAttitude, "ship/attitude", self.attitudes.append, 2000)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._record_diagnostics, 100)
        self.wait_until(lambda: self.peer.count_publishers("ship/attitude") == 1)
        self.wait_until(lambda: self.live.node.count_subscribers("/ship/attitude") == 1)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.live.close()
        self._executor.shutdown()
        self.peer.destroy_node()
        self.context.try_shutdown()

    def imu_publisher(self, reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE, *, match: bool = True) -> Any:
        publisher = self.peer.create_publisher(Imu, "ins/imu", QoSProfile(depth=2000, reliability=reliability))
        if match:
            self.wait_until(lambda: publisher.get_subscription_count() == 1)
        return publisher

    def clock_publisher(self) -> Callable[[float], None]:
        """Return a function that sets the time of the node, s."""
        publisher = self.peer.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        self.wait_until(lambda: publisher.get_subscription_count() == 1)

        def set_time(time_s: float) -> None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = stamp_fields(round(time_s * 1e9))
            publisher.publish(message)
            self.wait_until(lambda: self.now_ns() == round(time_s * 1e9))

        return set_time

    def now_ns(self) -> int:
        """Return the time of the node."""
        return int(self.live.node.get_clock().now().nanoseconds)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Return the response of a service of the node."""
        client = self.peer.create_client(kind, f"/relay/{name}")
        self.wait_until(client.service_is_ready)
        future = client.call_async(request)
        self.wait_until(future.done)
        return future.result()

    def has_level(self, name: str, level: bytes) -> bool:
        """True if the last diagnostics of that name have that level."""
        return name in self.diagnostics and self.diagnostics[name].level == level

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.005)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Spin the peer until the condition is true."""
        end_s = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < end_s, f"waited {TIMEOUT_S} s in vain; diagnostics: {self.diagnostics}"
            self.spin()

    def _record_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics |= {status.name: status for status in message.status}


def imu_message(time_ns: int, frame_id: str = "ins") -> Imu:
    """Return a valid sample: deck aligned with East, North, Up."""
    message = Imu()
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time_ns)
    message.header.frame_id = frame_id
    return message

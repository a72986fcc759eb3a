"""A look at the live ROS graph from outside: waiting until nodes are there and connected."""

import time
from collections.abc import Callable, Mapping
from types import TracebackType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

_POLL_S = 0.02


class GraphObserver:
    """A node of its own in a domain, for waiting; use it in a ``with`` statement.

    The process's environment must already keep discovery on this machine, as :func:`live_environment` says.
    """

    def __init__(self, domain_id: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node: Node = rclpy.create_node("observer", context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)

    def wait_for(
        self,
        publishers: Mapping[str, int] | None = None,
        subscribers: Mapping[str, int] | None = None,
        timeout_s: float = 15.0,
        unless: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Wait until topics have so many publishers and subscribers at least.

        Args:
            publishers: topic → number.
            subscribers: topic → number.
            timeout_s: steady time to wait at most.
            unless: gives the wait up when true, e.g. when the process waited for is gone.
        """
        deadline_s = time.monotonic() + timeout_s
        while not unless() and time.monotonic() < deadline_s:
            found = all(self.node.count_publishers(topic) >= n for topic, n in (publishers or {}).items())
            if found and all(
                self.node.count_subscribers(topic) >= n for topic, n in (subscribers or {}).items()
            ):
                return True
            self.executor.spin_once(timeout_sec=_POLL_S)
        return False

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = 15.0) -> bool:
        """Serve the node's callbacks until a condition holds; False when it does not in time."""
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= deadline_s:
                return False
            self.executor.spin_once(timeout_sec=_POLL_S)
        return True

    def __enter__(self) -> "GraphObserver":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.executor.shutdown()
        # The node holds the DDS participant, and two participants of one process can lock each other up for good
        # while they take note that a third has died.
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

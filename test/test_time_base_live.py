"""A live ``ship_attitude`` while the clocks of the computer and of all devices are set back; and its black box."""

import threading
import time
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

import ship_node.live.node_clock as node_clock
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.message_factory import message_class
from ship_estimation.time_order.outcome import Status
from ship_msgs.msg import ShipAttitude
from ship_node.live.live_node import LiveNode
from ship_replay.commands.replay import main as replay
from ship_testing.adapter_runs import SECOND_NS, START_NS, changed_copy, stamp_of
from ship_testing.small_voyage import voyage

STEP_S = -300
LASTS_S, AT_S = 10.0, 5.0

SUITE = """
/**/ship_attitude:
  ros__parameters:
    ins: {frame_id: ins}
    star_sensors:
      fore: {azimuth_deg: 0.0, elevation_deg: 45.0, frame_id: star_fore, serial: F1}
      starboard: {azimuth_deg: 90.0, elevation_deg: 45.0, frame_id: star_starboard, serial: S1}
"""

pytestmark = pytest.mark.live


class Ship:
    """Live parts: the node under test, in a thread, and devices that publish to it by the same clock."""

    def __init__(self, folder) -> None:
        parameters = folder / "suite.yaml"
        parameters.write_text(SUITE)
        self.context = Context()
        black_box = f"black_box:={folder}/box.mcap"
        rclpy.init(args=["node", "--ros-args", "--params-file", str(parameters), "-p", black_box], context=self.context)
        self.live = LiveNode(ShipAttitudeAdapter, self.context)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.live.spin, args=(self._stop.is_set,))
        self._thread.start()
        self.peer = rclpy.create_node("devices", context=self.context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.peer)
        self.attitudes: list[tuple[float, ShipAttitude]] = []
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        self.peer.create_subscription(ShipAttitude, "ship/attitude", self._take, qos)
        self.publishers = {
            i.topic: self.peer.create_publisher(message_class(i.type_name), i.topic, qos)
            for i in self.live.adapter.inputs
        }
        deadline_s = time.monotonic() + 15.0
        while any(p.get_subscription_count() == 0 for p in self.publishers.values()):
            assert time.monotonic() < deadline_s
            self.spin_until(time.monotonic() + 0.05)

    def _take(self, message: ShipAttitude) -> None:
        self.attitudes.append((time.monotonic(), message))

    def spin_until(self, monotonic_s: float) -> None:
        while (left_s := monotonic_s - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left_s)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.live.close()
        self._executor.shutdown()
        self.peer.destroy_node()
        self.context.try_shutdown()


def test_all_clocks_are_set_back_by_300_s(monkeypatch, tmp_path, capfd):
    """The system clock of this computer is not changed: only the clock that the node reads is replaced."""
    off_ns = [0]
    monkeypatch.setattr(node_clock, "time", SimpleNamespace(time_ns=lambda: time.time_ns() + off_ns[0]))
    ship = Ship(tmp_path)
    try:
        begin_s, begin_ns = time.monotonic(), time.time_ns()
        stepped_at_s = begin_s + AT_S
        for arrival in voyage(LASTS_S):
            since_ns = arrival.receive_ns - START_NS
            ship.spin_until(begin_s + since_ns / SECOND_NS)
            if since_ns >= AT_S * SECOND_NS:
                off_ns[0] = STEP_S * SECOND_NS
            is_stepped = arrival.stamp_ns - START_NS >= AT_S * SECOND_NS
            stamp_ns = begin_ns + arrival.stamp_ns - START_NS + (STEP_S * SECOND_NS if is_stepped else 0)

            def restamp(message, stamp_ns=stamp_ns):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND_NS)

            ship.publishers[arrival.topic].publish(changed_copy(arrival, restamp).message)
        ship.spin_until(time.monotonic() + 0.5)
        clocks = ship.live.adapter.time_base
        assert (clocks.steps, clocks.last_step_ns) == (1, pytest.approx(STEP_S * SECOND_NS, abs=0.01 * SECOND_NS))
    finally:
        ship.close()
    after = [(came_s, m) for came_s, m in ship.attitudes if came_s >= stepped_at_s + 2.0]
    assert len(after) > 25
    assert {m.status for _, m in after} == {Status.VALID}
    assert all(stamp_of(m) < begin_ns + STEP_S * SECOND_NS + 12 * SECOND_NS for _, m in after)
    last_bad_s = max((came_s for came_s, m in ship.attitudes if came_s >= stepped_at_s and m.status), default=0.0)
    print(f"VALID again after {max(last_bad_s - stepped_at_s, 0.0):.2f} s")
    assert replay([str(tmp_path / "box.mcap"), "--verify"]) == 0
    out, _ = capfd.readouterr()
    assert "clock step 1" in out
    assert "outputs are equal to the last bit" in out

"""Overload detection with given waiting times."""

import pytest

from ship_node.live.node_events import Backlog, OverloadChange, current_overload

MS = 1_000_000
STEP_NS = 10 * MS


class Node:
    """Node that processes a message every 10 ms of steady time; ``rate`` is the rate of /clock."""

    def __init__(self, rate: float = 1.0) -> None:
        self.steady_ns, self.running_ns = 10**12, 10**15
        self._rate = rate
        self.backlog = Backlog(lambda: self.steady_ns)
        self.evaluate(0)

    def evaluate(self, waited_ms: float, step_ns: int = STEP_NS) -> OverloadChange:
        self.steady_ns += step_ns
        self.running_ns += round(self._rate * step_ns)
        return self.backlog.evaluate(round(waited_ms * MS), self.running_ns)

    def evaluate_for(self, seconds: float, waited_ms: float) -> list[OverloadChange]:
        changes = [self.evaluate(waited_ms) for _ in range(round(seconds * 1e9 / STEP_NS))]
        return [change for change in changes if change is not OverloadChange.NONE]


def test_persistent_long_waiting_times_are_an_overload_after_one_second() -> None:
    node = Node()
    assert node.evaluate_for(10.0, 900.0) == []
    assert node.evaluate_for(0.9, 1100.0) == []
    assert node.evaluate_for(0.2, 1100.0) == [OverloadChange.BEHIND]
    assert node.backlog.is_behind


def test_a_standstill_is_no_overload() -> None:
    node = Node()
    assert node.evaluate(2900.0, step_ns=2900 * MS) is OverloadChange.NONE
    # The node then processes messages faster than they arrive.
    assert [node.evaluate(waited_ms) for waited_ms in range(2900, 0, -40)] == [OverloadChange.NONE] * 73
    assert not node.backlog.is_behind


def test_messages_waiting_over_three_seconds_are_cut_immediately() -> None:
    assert Node().evaluate(3100.0) is OverloadChange.BEHIND


@pytest.mark.parametrize("rate", [1.0, 20.0])
def test_waiting_time_is_measured_by_sim_time_if_used(rate: float) -> None:
    node = Node(rate)
    assert node.evaluate_for(0.9 / rate, 1100.0) == []
    assert node.evaluate_for(0.4 / rate, 1100.0) == [OverloadChange.BEHIND]


def test_overload_ends_after_one_second_of_short_waits_with_a_frozen_clock() -> None:
    node = Node()
    node.evaluate(3100.0)
    assert node.evaluate_for(0.5, 250.0) == []
    assert node.evaluate_for(0.9, 150.0) == []
    assert node.evaluate(250.0) is OverloadChange.NONE
    running_ns = node.running_ns
    for _ in range(99):
        node.steady_ns += STEP_NS
        assert node.backlog.evaluate(0, running_ns) is OverloadChange.NONE
    node.steady_ns += STEP_NS
    assert node.backlog.evaluate(0, running_ns) is OverloadChange.KEEPS_UP
    assert not node.backlog.is_behind


def evaluate_stalls(node: Node, seconds: float, stall_ms: int, rate: float) -> list[OverloadChange]:
    """Return the changes while the node stops for ``stall_ms`` each 0.9 s and then processes the queue."""
    changes = []
    for _ in range(round(seconds / 0.9)):
        changes += node.evaluate_for(0.9, 0.0)
        changes.append(node.evaluate(stall_ms * rate, step_ns=stall_ms * MS))
        changes.append(node.evaluate(stall_ms * rate / 2))
    return [change for change in changes if change is not OverloadChange.NONE]


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0, 20.0])
@pytest.mark.parametrize("stall_ms", [25, 50, 140])
def test_short_standstills_with_a_fast_clock_end_the_overload(rate: float, stall_ms: int) -> None:
    node = Node(rate)
    node.evaluate(3100.0)
    assert evaluate_stalls(node, 3.0, stall_ms, rate) == [OverloadChange.KEEPS_UP]
    assert evaluate_stalls(node, 10.0, stall_ms, rate) == []


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0])
def test_long_standstills_with_a_fast_clock_keep_the_overload(rate: float) -> None:
    node = Node(rate)
    node.evaluate(3100.0)
    assert evaluate_stalls(node, 10.0, 250, rate) == []
    assert node.backlog.is_behind


def test_a_clock_jump_back_resets_the_working_time() -> None:
    node = Node()
    node.evaluate_for(0.9, 1100.0)
    node.running_ns -= 10**12
    node.backlog.restart()
    assert node.evaluate_for(0.9, 1100.0) == []
    assert node.evaluate_for(0.2, 1100.0) == [OverloadChange.BEHIND]


def test_working_time_before_a_clock_jump_back_delays_no_detection() -> None:
    node = Node()
    node.evaluate_for(100.0, 0.0)
    node.running_ns -= 10**12
    node.backlog.restart()
    assert node.evaluate_for(0.9, 1500.0) == []
    assert node.evaluate_for(0.2, 1500.0) == [OverloadChange.BEHIND]


def test_overload_text() -> None:
    overload = current_overload(3_240 * MS, {"ins/imu": 320})
    assert (overload.behind_s, overload.cut) == (3.24, {"ins/imu": 320})
    assert overload.cores >= 1
    assert overload.text("relay").startswith("relay is 3.2 s behind: the computer is too slow (")

"""ROS domains for live trials: real participants, limited to this machine."""

import pytest
from rclpy.context import Context
from rclpy.node import Node

from ship_testing.trials.live_process import free_domain_id

pytestmark = pytest.mark.live


def test_a_domain_is_free_only_after_all_participants_have_left(monkeypatch):
    """This holds even if the first participant, whose port is the lowest, leaves first."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = free_domain_id()
    participants = []
    for name in ("first", "second"):
        context = Context()
        context.init(args=[], domain_id=domain)
        participants.append((context, Node(name, context=context, use_global_arguments=False)))
    for context, node in participants:
        assert free_domain_id() != domain
        node.destroy_node()
        context.try_shutdown()
    assert free_domain_id() == domain

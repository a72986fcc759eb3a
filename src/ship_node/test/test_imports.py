"""Adapters and the offline replay use most of this package without ROS."""

import subprocess
import sys

import pytest

WITHOUT_ROS = [
    "ship_node.adapters.adapter",
    "ship_bags.output_files",
    "ship_node.messages.common_messages",
    "ship_bags.errors",
    "ship_node.pages.figure_files",
    "ship_node.health.input_health",
    "ship_node.messages.field_checks",
    "ship_bags.message_factory",
    "ship_node.parameters.parameter_file",
    "ship_bags.stamps",
    "ship_node.live.node_clock",
    "ship_node.messages.inputs_outputs",
]


@pytest.mark.parametrize("module", WITHOUT_ROS)
def test_module_imports_by_itself_and_without_ros(module):
    check = (
        f"import sys, {module}; sys.exit(any(m.split('.')[0] in ('rclpy', 'ship_msgs') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", check], check=False, timeout=60).returncode == 0

"""Adapters and the offline replay use most of this package without ROS."""

import subprocess
import sys

import pytest

WITHOUT_ROS = [
    "ship_node.edge.adapter",
    "ship_bags.output_files",
    "ship_node.edge.messages_out",
    "ship_bags.errors",
    "ship_node.documents.figure_files",
    "ship_node.live.node_report",
    "ship_node.edge.input_health",
    "ship_node.edge.messages_in",
    "ship_bags.message_factory",
    "ship_node.parameters.parameter_file",
    "ship_bags.stamps",
    "ship_node.live.node_clock",
    "ship_node.edge.topics",
    "ship_node.parameters.usage",
]


@pytest.mark.parametrize("module", WITHOUT_ROS)
def test_module_imports_by_itself_and_without_ros(module):
    check = (
        f"import sys, {module}; sys.exit(any(m.split('.')[0] in ('rclpy', 'ship_msgs') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", check], check=False, timeout=60).returncode == 0

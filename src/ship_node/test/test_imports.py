"""Adapters and the offline replay use most of this package where no ROS is."""

import subprocess
import sys

import pytest

WITHOUT_ROS = [
    "adapter",
    "csv_table",
    "diagnostics",
    "errors",
    "figure_files",
    "guard",
    "input_health",
    "message_checks",
    "message_factory",
    "parameter_file",
    "stamps",
    "tick_grid",
    "topics",
    "usage",
]


@pytest.mark.parametrize("module", WITHOUT_ROS)
def test_module_imports_alone_and_without_ros(module):
    check = (
        f"import sys, ship_node.{module}; sys.exit(any(m.split('.')[0] in ('rclpy', 'ship_msgs') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", check], check=False, timeout=60).returncode == 0

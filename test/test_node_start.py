"""Modules that a live node imports before it runs: none that only other programs or settings need."""

import json
import subprocess
import sys

import pytest

ADAPTERS = [
    "ship_attitude_star.adapters.ship_attitude_adapter",
    "ship_attitude_star.adapters.star_attitude_adapter",
    "theodolite_calib.adapters.optical_axis_adapter",
    "theodolite_calib.adapters.triangulation_adapter",
]

NEEDLESS = {
    # ship_estimation.innovations.gates, ship_geometry.frames and ship_geometry.late_libraries replace the few functions
    # needed; the import of each of these modules of scipy takes longer than that of rclpy.
    "scipy.linalg", "scipy.special", "scipy.stats", "scipy.spatial", "scipy.optimize", "scipy.sparse", "scipy.signal",
    # Figures and pages are made by commands.
    "matplotlib", "jinja2", "rich",
    # Bags are read by commands, and written by a node that keeps a black box.
    "rosbags", "mcap", "zstandard", "lz4", "ship_bags.mcap.bag_writer", "ship_node.black_box.black_box",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_node_imports_no_unneeded_module(adapter: str) -> None:
    script = f"import json, sys, ship_node.live.node_runtime, {adapter}; print(json.dumps(list(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, timeout=120)
    read = set(json.loads(done.stdout))
    assert {"rclpy", "ship_node.live.live_node", adapter} <= read  # what it does need is there
    assert read & NEEDLESS == set()

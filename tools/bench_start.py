"""Start time of a live node: time of importing its modules, and time from exec to the discovery of its subscription.

The references are the minimum of any node: ``import rclpy``, and a node of rclpy with one subscription. Another process
discovers the subscription. Python's byte code exists: the first round, which creates it, is not counted.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from bench_rows import Row, alternate, median_ratio, process_cpu_s
from ship_bags.live.ros_process import executable
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import LiveFailure

SUITE = Path(__file__).resolve().parents[1] / "examples" / "theodolite.yaml"
"""Parameters of the nodes on a ship."""

IMPORT_ROUNDS = 4
START_ROUNDS = 3
MOST_IMPORT_RATIO = 2.0
MOST_START_S = 0.6
_START_S = 60.0
_LOOK_S = 0.002

_NODES = {
    "ship_attitude": ("ship_attitude_star", "ship_attitude_star.adapters.ship_attitude_adapter", "ins/imu"),
    "star_attitude": ("ship_attitude_star", "ship_attitude_star.adapters.star_attitude_adapter", "gnss/fix"),
    "optical_axis": ("theodolite_calib", "theodolite_calib.adapters.optical_axis_adapter", "theodolite/encoder"),
}
"""Node → its package, its adapter, one of its inputs."""

_BARE_NODE = """
import rclpy
from sensor_msgs.msg import Imu
rclpy.init()
node = rclpy.create_node("bare")
subscription = node.create_subscription(Imu, "bare/imu", print, 10)
rclpy.spin(node)
"""


def import_cost() -> list[Row]:
    """Measure the processor time of importing each node's modules, and of ``import rclpy``."""
    modules = {name: f"ship_node.live.node_runtime, {adapter}" for name, (_, adapter, _) in _NODES.items()}
    statements = {"rclpy": "rclpy", "rclpy.node": "rclpy.node", **modules}
    figures = alternate(IMPORT_ROUNDS + 1, *(lambda s=s: _import_cpu_s(s) for s in statements.values()))
    cpu_s = {name: counted[1:] for name, counted in zip(statements, figures, strict=True)}
    rows = [Row("import rclpy, processor time: median", float(np.median(cpu_s["rclpy"])), "s")]
    for name in _NODES:
        what = f"ratio: import of {name} / import rclpy"
        rows.append(Row(what, median_ratio(cpu_s[name], cpu_s["rclpy"]), "x", MOST_IMPORT_RATIO, "import rclpy"))
    what = "ratio: import rclpy.node, as each node must / import rclpy"
    return [*rows, Row(what, median_ratio(cpu_s["rclpy.node"], cpu_s["rclpy"]), "x", None, "import rclpy")]


def start_cost() -> list[Row]:
    """Measure the time from exec to the discovery of the subscription, for each node and for a bare node."""
    commands = {"a bare node": ([sys.executable, "-c", _BARE_NODE], "bare/imu")}
    arguments = ["--ros-args", "--params-file", str(SUITE)]
    for name, (package, _, topic) in _NODES.items():
        commands[name] = [*executable(package, name), *arguments], topic
    domain_id = free_domain_id()
    with tempfile.TemporaryDirectory() as folder, GraphObserver(domain_id) as observer:
        environment = live_environment(domain_id, Path(folder))
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        log = Path(folder) / "node.log"
        starts = [
            partial(_start_times_s, command, topic, log, environment, observer) for command, topic in commands.values()
        ]
        counted = [figures[1:] for figures in alternate(START_ROUNDS + 1, *starts)]
    started = dict(zip(commands, counted, strict=True))
    yardstick = "a node of rclpy with one subscription"
    rows = []
    for name, figures in started.items():
        most_s = MOST_START_S if name in _NODES else None
        median_s = float(np.median(figures, axis=0)[0])
        rows.append(Row(f"exec of {name} to its subscription: median", median_s, "s", most_s))
    for name in _NODES:
        ratio = median_ratio([cpu_s for _, cpu_s in started[name]], [cpu_s for _, cpu_s in started["a bare node"]])
        rows.append(Row(f"ratio: the same in processor time, {name} / a bare node", ratio, "x", None, yardstick))
    return rows


def _import_cpu_s(modules: str) -> float:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen([sys.executable, "-c", f"import {modules}"], env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise LiveFailure(f"'import {modules}' failed")
    return usage.ru_utime + usage.ru_stime


def _start_times_s(
    command: Sequence[str], topic: str, log: Path, environment: dict[str, str], observer: GraphObserver
) -> tuple[float, float]:
    """Return elapsed and processor time of a node until its subscription is discovered, s."""
    begin_s = time.monotonic()
    with LiveProcess(command, log, environment) as process:
        while not observer.node.count_subscribers(topic):
            if process.exit_code is not None or time.monotonic() > begin_s + _START_S:
                raise LiveFailure(f"{command[1]} did not start; its log:\n{process.log_text()}")
            time.sleep(_LOOK_S)
        taken_s = time.monotonic() - begin_s, process_cpu_s(process.pid)
    while observer.node.count_subscribers(topic):
        time.sleep(_LOOK_S)
    return taken_s

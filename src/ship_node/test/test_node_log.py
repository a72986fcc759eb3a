"""Log lines of a node on /rosout."""

import time

import pytest
import rclpy
from rcl_interfaces.msg import Log
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level

from ship_node.live.node_report import NodeLog


@pytest.mark.live
def test_a_log_line_has_its_level_and_code_location(own_domain, capfd):
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("log_test", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    lines = []
    node.create_subscription(Log, "/rosout", lines.append, 10)
    log = NodeLog(node)
    deadline_s = time.monotonic() + 15.0
    while not lines and time.monotonic() < deadline_s:
        log.info("both are connected")
        executor.spin_once(timeout_sec=0.02)
    for write, text in ((log.info, "all is well"), (log.warning, "not quite"), (log.error, "not at all")):
        write(text)
    set_logger_level("log_test", LoggingSeverity.ERROR)
    log.warning("below the level")
    log.error("the last")
    while not (lines and lines[-1].msg == "the last") and time.monotonic() < deadline_s:
        executor.spin_once(timeout_sec=0.02)
    set_logger_level("log_test", LoggingSeverity.UNSET)
    assert [(line.level, line.msg) for line in lines if line.msg != "both are connected"] == [
        (Log.INFO, "all is well"),
        (Log.WARN, "not quite"),
        (Log.ERROR, "not at all"),
        (Log.ERROR, "the last"),
    ]
    assert {(line.name, line.file) for line in lines} == {("log_test", __file__)}
    assert lines[-1].function == "test_a_log_line_has_its_level_and_code_location"
    output = capfd.readouterr().err
    assert "[ERROR]" in output
    assert "below the level" not in output
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)

"""The attitude out as sentences and in again: ``nmea_out``, a UDP port, ``nmea_in``, ``ins/imu``."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from ship_bags.stamps import ns_from_stamp, stamp_fields
from ship_geometry.frames import rotation_from_angles
from ship_geometry.ros_axes import rotation_from_quaternion
from ship_geometry.rotations import log_rotation
from ship_msgs.msg import ShipAttitude
from ship_testing.listening_node import free_port

pytestmark = pytest.mark.live

NODE = [sys.executable, "-m", "ship_nmea.commands.nmea_out", "--ros-args", "-r", "__ns:=/aurora"]
ANGLES_DEG = [
    *((heading, 1.23456789, -4.56789012) for heading in np.arange(0.0, 360.0, 45.0)),
    (179.999991, 0.0, 0.0), (180.000009, 0.0, 0.0), (359.999991, -5.0, 5.0), (0.000009, 5.0, -5.0),
    (90.0, 0.0, 179.999991), (270.0, 0.0, -179.999991), (33.3333333, 89.0, 12.3456789), (330.0, -89.0, -170.0),
]  # fmt: skip
"""Heading, pitch (bow up), roll (starboard down)."""


@pytest.mark.parametrize("decimals", [2, 4])
def test_what_goes_out_comes_in_to_print_resolution_at_its_own_stamp(listening, tmp_path, decimals):
    port = free_port()
    node = listening({"own": {"kind": "udp", "port": port, "becomes": "ins"}}, namespace="aurora")
    parameters = {
        "sinks.loop.kind": "udp", "sinks.loop.address": "127.0.0.1", "sinks.loop.port": port,
        "sinks.loop.rate_hz": 1000.0, "sinks.loop.sentences": "[PSXN20, PASHR]", "sinks.loop.decimals": decimals,
        "longest_age_s": 60.0,
    }  # fmt: skip
    command = [*NODE, *(part for name, value in parameters.items() for part in ("-p", f"{name}:={value}"))]
    with (tmp_path / "log.txt").open("w") as log:
        out = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"ROS_LOG_DIR": str(tmp_path)})
    try:
        attitudes = node.peer.create_publisher(ShipAttitude, "ship/attitude", 10)
        heard = node.heard["ins/imu"]
        for angles_deg in ANGLES_DEG:
            angles = np.radians(angles_deg)
            stamp_ns = time.time_ns() // 1_000_000 * 1_000_000
            message = ShipAttitude(heading=angles[0], pitch=angles[1], roll=angles[2])
            message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(stamp_ns)

            def came_back(message=message, stamp_ns=stamp_ns):
                # Again and again: an input is best effort. A stamp that was there is not taken twice.
                attitudes.publish(message)
                return heard and ns_from_stamp(heard[-1].header.stamp) == stamp_ns

            node.wait_until(came_back)
            orientation = heard[-1].orientation
            read_nd = rotation_from_quaternion([orientation.x, orientation.y, orientation.z, orientation.w])
            error_deg = np.degrees(np.abs(log_rotation(read_nd @ rotation_from_angles(*angles).T)))
            # Three angles, each wrong by half of its last digit at most.
            assert np.linalg.norm(error_deg) <= 0.5 * 10.0**-decimals * 3.0**0.5 * 1.01, angles_deg
        assert len(heard) == len(ANGLES_DEG)
        # INVALID is void, and nothing of it comes in.
        message.status = ShipAttitude.INVALID
        for _ in range(5):
            message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time.time_ns())
            attitudes.publish(message)
            node.spin()
        node.wait_until(lambda: "no values in it" in node.told("own")[1])
        assert len(heard) == len(ANGLES_DEG)
    finally:
        out.send_signal(signal.SIGINT)
        assert out.wait(20.0) == 0

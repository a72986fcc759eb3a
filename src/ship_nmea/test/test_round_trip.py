"""ship/attitude → nmea_out → UDP → nmea_in → ins/imu: the same attitude, to the printed decimals."""

import threading
import time

import numpy as np
import pytest
import rclpy
from rclpy.context import Context

from ship_bags.parameter_yaml import sections_text
from ship_bags.stamps import ns_from_stamp, stamp_fields
from ship_geometry.frames import rotation_from_angles, rotation_from_quaternion
from ship_geometry.rotations import log_rotation
from ship_msgs.msg import ShipAttitude
from ship_nmea.nmea_node import NmeaNode
from ship_nmea.out.config import NmeaOutConfig
from ship_nmea.out.nmea_out import NAME, NmeaOut
from ship_testing.nmea_in_peer import free_port

pytestmark = pytest.mark.live

DECIMALS = 4
ANGLES_DEG = [
    *((heading, -1.23456, 4.56789) for heading in np.arange(0.0, 360.0, 45.0)),
    (179.99996, 0.0, 0.0), (180.00004, 0.0, 0.0), (359.99996, -5.0, 5.0), (0.00004, 5.0, -5.0),
    (90.0, 0.0, 179.99996), (270.0, 0.0, -179.99996), (30.0, 89.0, 10.0), (330.0, -89.0, -170.0),
]  # fmt: skip
"""Heading, pitch (bow up), roll (starboard down)."""


@pytest.fixture
def make_publisher(tmp_path):
    """Start nmea_out with a sink; return a publisher of attitudes."""
    context, stop = Context(), threading.Event()
    closing = []

    def start(port):
        path = tmp_path / "nmea_out.yaml"
        sink = {
            "kind": "udp", "address": "127.0.0.1", "port": port, "sentences": ["PASHR"], "decimals": DECIMALS,
            "rate_hz": 1000.0,
        }  # fmt: skip
        path.write_text(sections_text({f"/**/{NAME}": {"sinks": {"link": sink}}}))
        rclpy.init(args=[NAME, "--ros-args", "--params-file", str(path)], context=context)
        node = NmeaNode(NAME, NmeaOutConfig, NmeaOut, context, (path,))
        thread = threading.Thread(target=node.spin, args=(stop.is_set,))
        thread.start()
        ship = rclpy.create_node("ship", context=context, use_global_arguments=False)
        publisher = ship.create_publisher(ShipAttitude, "ship/attitude", 100)
        closing.extend([stop.set, thread.join, node.close, ship.destroy_node])
        return publisher

    yield start
    for close in closing:
        close()
    context.try_shutdown()


@pytest.mark.smoke
def test_attitude_round_trip(listening, make_publisher):
    port = free_port()
    node = listening({"link": {"kind": "udp", "address": "127.0.0.1", "port": port, "becomes": "ins"}})
    publisher = make_publisher(port)
    for angles in ANGLES_DEG:
        heading, pitch, roll = np.deg2rad(angles)
        sent = ShipAttitude(status=ShipAttitude.VALID, heading=heading, pitch=pitch, roll=roll)
        sent.covariance = np.diag([1e-12, 1e-12, 1e-12]).ravel()
        times_ns = set()

        def received_messages(sent=sent, times_ns=times_ns):
            """Publish the attitude again, as a busy machine may lose it; return the messages with one of its stamps."""
            times_ns.add(time.time_ns() // 1_000_000 * 1_000_000)  # PASHR has milliseconds
            sent.header.stamp.sec, sent.header.stamp.nanosec = stamp_fields(max(times_ns))
            publisher.publish(sent)
            time.sleep(0.02)
            return [one for one in node.received["ins/imu"] if ns_from_stamp(one.header.stamp) in times_ns]

        q = node.wait_until(received_messages)[0].orientation
        rotation = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
        error_deg = np.rad2deg(log_rotation(rotation_from_angles(heading, pitch, roll).T @ rotation))
        # Each of three angles is rounded by half of its last digit at most.
        assert np.linalg.norm(error_deg) <= 3 * 0.5 * 10.0**-DECIMALS

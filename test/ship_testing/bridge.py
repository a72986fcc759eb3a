"""Peers of nmea_out for tests: a ship that publishes its attitude over DDS, and a display at a TCP sink."""

import math
import socket
import time

import pynmea2
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from ship_bags.stamps import stamp_fields
from ship_geometry.rotations import ARCSEC
from ship_msgs.msg import AlertArray, ShipAttitude
from ship_nmea.sentences import alerts  # noqa: F401 - registers its sentences with the parser

TIMEOUT_S = 40.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class AttitudePublisher:
    """Suite in the namespace demo that publishes its attitude, and subscribes to diagnostics and alerts."""

    def __init__(self):
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("ship_attitude", context=self.context, namespace="demo")
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.attitudes = self.node.create_publisher(ShipAttitude, "ship/attitude", 10)
        self.statuses = {}
        self.alerts = None
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._receive_statuses, 100)
        self.node.create_subscription(AlertArray, "ship/alerts", self._receive_alerts, LATCHED)

    def _receive_statuses(self, message):
        self.statuses |= {status.name: status for status in message.status}

    def _receive_alerts(self, message):
        self.alerts = {alert.id: alert for alert in message.alerts}

    def publish(self, heading_deg=10.0, pitch_deg=2.0, roll_deg=-3.0, status=ShipAttitude.VALID, age_s=0.0):
        message = ShipAttitude(status=status, star_age_s=0.1)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time.time_ns() - round(age_s * 1e9))
        message.heading, message.pitch, message.roll = (math.radians(a) for a in (heading_deg, pitch_deg, roll_deg))
        message.covariance = [(sigma * ARCSEC) ** 2 for sigma in (3.0, 0, 0, 0, 2.0, 0, 0, 0, 1.0)]
        message.angular_velocity.z = math.radians(-0.5)
        self.attitudes.publish(message)
        return message

    def spin(self, seconds=0.02):
        self.executor.spin_once(timeout_sec=seconds)

    def stop(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


class Display:
    """Display at a TCP sink: reads the sentences with an independent parser."""

    def __init__(self, port):
        self.port, self.connection, self._rest = port, None, b""
        self.texts, self.sentences = [], []

    def connect(self):
        try:
            self.connection = socket.create_connection(("127.0.0.1", self.port), timeout=1.0)
        except OSError:
            return False
        self.connection.setblocking(False)
        return True

    def read(self):
        try:
            received = self.connection.recv(65536)
        except BlockingIOError:
            return
        if not received:
            raise ConnectionError(f"the sink at port {self.port} closed the connection")
        *lines, self._rest = (self._rest + received).split(b"\r\n")
        self.texts += [line.decode("ascii") for line in lines]
        self.sentences += [pynmea2.parse(line.decode("ascii"), check=True) for line in lines]

    def send(self, body):
        self.connection.sendall(f"${body}*{pynmea2.NMEASentence.checksum(body):02X}\r\n".encode())

    def last(self, name):
        return next((one for one in reversed(self.sentences) if type(one).__name__ == name), None)

    def clear(self):
        self.read()
        self.texts.clear()
        self.sentences.clear()

    def close(self):
        if self.connection is not None:
            self.connection.close()


def wait_until(ship, condition, publish=lambda: None):
    """Return the result of ``condition`` once it is true, and call ``publish`` until then; fail after TIMEOUT_S."""
    end_s = time.monotonic() + TIMEOUT_S
    while not (result := condition()) and time.monotonic() < end_s:
        publish()
        ship.spin()
    assert result
    return result

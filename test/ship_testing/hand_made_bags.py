"""Hand-made messages and bags for the tests of reading, replaying and evaluating."""

import numpy as np

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angles_from_rotation, quaternion_from_rotation, rotation_from_angles

START_NS = 1_700_000_000_050_000_000
"""First stamp, ns: half a tick after a whole second."""

PERIOD_NS = 10_000_000
FACTORY = RosbagsFactory()
UNKNOWN = np.zeros(9)
COMPONENTS = ("roll", "pitch", "heading")


def vector(x=0.0, y=0.0, z=0.0):
    return FACTORY.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def quaternion(heading=0.0, pitch=0.0, roll=0.0):
    x, y, z, w = (float(part) for part in quaternion_from_rotation(rotation_from_angles(heading, pitch, roll)))
    return FACTORY.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def imu(stamp_ns, frame_id="ins", heading=0.0, pitch=0.0, roll=0.0, covariance=UNKNOWN):
    return FACTORY.make(
        "sensor_msgs/msg/Imu",
        header=make_header(FACTORY, stamp_ns, frame_id),
        orientation=quaternion(heading, pitch, roll),
        orientation_covariance=covariance,
        angular_velocity=vector(),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(),
        linear_acceleration_covariance=np.zeros(9),
    )


def ship_attitude(stamp_ns, heading=0.0, pitch=0.0, roll=0.0, covariance_enu=UNKNOWN, status=0, factory=FACTORY):
    return factory.make(
        "ship_msgs/msg/ShipAttitude",
        header=make_header(factory, stamp_ns, "deck"),
        heading=heading,
        pitch=pitch,
        roll=roll,
        covariance=np.zeros(9),
        orientation=quaternion(heading, pitch, roll),
        rotation_covariance=np.asarray(covariance_enu, dtype=float).ravel(),
        angular_velocity=vector(),
        status=status,
        horizon=0,
        sources=["ins"],
        star_age_s=0.0,
    )


def innovation(stamp_ns, source, residual, sigma, nis, accepted=True, reason=0, components=COMPONENTS):
    return FACTORY.make(
        "ship_msgs/msg/Innovation",
        header=make_header(FACTORY, stamp_ns, "horizon"),
        source=source,
        components=list(components),
        residual=np.asarray(residual, dtype=float),
        sigma=np.asarray(sigma, dtype=float),
        nis=nis,
        gate=20.0,
        accepted=accepted,
        reason=reason,
        reason_text="",
    )


def star_message(stamp_ns, rotation_nv, covariance_enu, sensor_id="fore"):
    azimuth, elevation, roll = (float(angle) for angle in angles_from_rotation(rotation_nv))
    return FACTORY.make(
        "ship_msgs/msg/StarHorizonAttitude",
        header=make_header(FACTORY, stamp_ns, f"star_{sensor_id}"),
        sensor_id=sensor_id,
        azimuth=azimuth,
        elevation=elevation,
        roll=roll,
        covariance=np.zeros(9),
        rotation_covariance=covariance_enu.ravel(),
        noise_covariance=np.zeros(9),
        star_count=8,
        rejected_count=0,
        residual_rms=0.0,
        status=0,
    )


def write_imu_bag(path, count=100, topic="ins/imu", attachments=(), start_ns=START_NS):
    """Write ``count`` Imu at 100 Hz, log time = stamp."""
    with BagWriter(path) as bag:
        for name, text in attachments:
            bag.add_attachment(name, text)
        for number in range(count):
            stamp_ns = start_ns + number * PERIOD_NS
            bag.write(topic, imu(stamp_ns, heading=1e-3 * number), stamp_ns)
    return path

"""What the devices of a scenario send: topics and their types (the truth aside)."""

from ship_simulation.scenario.scenario import Scenario

IMU = "sensor_msgs/msg/Imu"
STAR = "ship_msgs/msg/StarHorizonAttitude"
OBSERVATIONS = "ship_msgs/msg/StarObservationArray"
INERTIAL = "ship_msgs/msg/StarInertialAttitude"
SHIP_ATTITUDE = "ship_msgs/msg/ShipAttitude"
ENCODER = "ship_msgs/msg/TheodoliteEncoder"
IMAGE = "ship_msgs/msg/BeaconImage"
BASELINE = "ship_msgs/msg/RtkBaseline"

FUSED_TOPIC = "ship/attitude"
ENCODER_TOPIC, IMAGE_TOPIC = "theodolite/encoder", "theodolite/beacons"

_STAR_TYPES = {"horizon_attitude": STAR, "observations": OBSERVATIONS, "inertial_attitude": INERTIAL}


def simulated_topics(scenario: Scenario) -> dict[str, str]:
    """Topic → type of all that a scenario's devices send."""
    topics = {
        "ins/imu": IMU,
        **{f"star/{key}/{star.output}": _STAR_TYPES[star.output] for key, star in scenario.star_sensors.items()},
        **{f"reference/{key}/imu": IMU for key in scenario.references},
        "gnss/fix": "sensor_msgs/msg/NavSatFix",
        "met/pressure": "sensor_msgs/msg/FluidPressure",
        "met/temperature": "sensor_msgs/msg/Temperature",
        "met/humidity": "sensor_msgs/msg/RelativeHumidity",
    }
    if scenario.fused_attitude.written:
        topics[FUSED_TOPIC] = SHIP_ATTITUDE
    if scenario.theodolite.aboard:
        topics |= {ENCODER_TOPIC: ENCODER, IMAGE_TOPIC: IMAGE}
        topics |= {baseline_topic(key): BASELINE for key in scenario.beacons}
        topics |= {drone_topic(key): IMU for key in scenario.beacons}
    return topics


def baseline_topic(beacon_id: str) -> str:
    """Topic of a drone's baselines."""
    return f"beacon/{beacon_id}/baseline"


def drone_topic(beacon_id: str) -> str:
    """Topic of a drone's attitude."""
    return f"beacon/{beacon_id}/imu"

"""Names of a scenario's devices: topics and types (without the truth), frames, ids, and applicable faults.

The messages contain these names, and the suite file passes them to the nodes.
"""

from ship_simulation.scenario.scenario import Scenario

IMU = "sensor_msgs/msg/Imu"
STAR = "ship_msgs/msg/StarHorizonAttitude"
OBSERVATIONS = "ship_msgs/msg/StarObservationArray"
INERTIAL = "ship_msgs/msg/StarInertialAttitude"
SHIP_ATTITUDE = "ship_msgs/msg/ShipAttitude"
ENCODER = "ship_msgs/msg/TheodoliteEncoder"
IMAGE = "ship_msgs/msg/BeaconImage"
BASELINE = "ship_msgs/msg/RtkBaseline"
TARGET = "ship_msgs/msg/TargetImage"

DEFLECTION = "ship_msgs/msg/Deflection"

FIX = "sensor_msgs/msg/NavSatFix"
PRESSURE, TEMPERATURE = "sensor_msgs/msg/FluidPressure", "sensor_msgs/msg/Temperature"
HUMIDITY = "sensor_msgs/msg/RelativeHumidity"

FUSED_TOPIC = "ship/attitude"
DEFLECTION_TOPIC = "gravity/deflection"
SHIP_BASELINE_TOPIC = "ship/baseline"
ENCODER_TOPIC, IMAGE_TOPIC, TARGET_TOPIC = "theodolite/encoder", "theodolite/beacons", "theodolite/target"

INS_FRAME, DECK_FRAME = "ins", "deck"
MOUNT_FRAME, TELESCOPE_FRAME, ANTENNA_FRAME = "theodolite", "telescope", "ship_antenna"
MAIN_DETECTOR_FRAME = "main_detector"
TELESCOPE_ID, SHIP_ANTENNA_ID, SECOND_ANTENNA_ID = "calibration", "ship", "ship_second"

COVARIANCES = {
    IMU: ("orientation_covariance",),
    STAR: ("covariance", "rotation_covariance", "noise_covariance"),
    INERTIAL: ("covariance",),
    SHIP_ATTITUDE: ("covariance", "rotation_covariance"),
    BASELINE: ("covariance",),
    FIX: ("position_covariance",),
    DEFLECTION: ("covariance",),
}
"""Message type → its fields with covariances of the quantities that the nodes use, square matrices row by row."""

FIRST_VALUE = {
    IMU: "orientation.x",
    INERTIAL: "orientation.x",
    STAR: "azimuth",
    OBSERVATIONS: "stars[0].u",
    SHIP_ATTITUDE: "heading",
    ENCODER: "azimuth",
    IMAGE: "beacons[0].x",
    BASELINE: "enu.x",
    TARGET: "x",
    FIX: "latitude",
    PRESSURE: "fluid_pressure",
    TEMPERATURE: "temperature",
    HUMIDITY: "relative_humidity",
    DEFLECTION: "xi",
}
"""Message type → the field in which a fault puts NaN or infinity if it names no field."""

_STAR_TYPES = {"horizon_attitude": STAR, "observations": OBSERVATIONS, "inertial_attitude": INERTIAL}

_ATTITUDES = (IMU, SHIP_ATTITUDE, STAR)
_TYPES_OF_KIND = {
    "covariance_unknown": tuple(COVARIANCES),
    "covariance_negative": tuple(COVARIANCES),
    "rate_in_degrees": (IMU,),
    "angles_in_degrees": (ENCODER, STAR, SHIP_ATTITUDE),
    "units": (*_ATTITUDES, ENCODER, BASELINE, IMAGE, TARGET, FIX, PRESSURE, TEMPERATURE, HUMIDITY),
    "axes": (IMU, SHIP_ATTITUDE, INERTIAL, BASELINE),
    "bias": _ATTITUDES,
    "position_off": (FIX,),
    "knock": (*_ATTITUDES, INERTIAL, OBSERVATIONS, IMAGE),
    "drift": (*_ATTITUDES, INERTIAL, OBSERVATIONS, IMAGE, ENCODER),
    "slip": (ENCODER,),
    "wrong_fix": (BASELINE,),
    "false_stars": (OBSERVATIONS,),
    "false_lights": (IMAGE,),
    "hide": (IMAGE,),
    "swap": (IMAGE, OBSERVATIONS),
    "wrong_id": (IMAGE, BASELINE),
}


def simulated_topics(scenario: Scenario) -> dict[str, str]:
    """Return topic → type of all messages of a scenario's devices."""
    topics = {
        "ins/imu": IMU,
        **{f"star/{key}/{star.output}": _STAR_TYPES[star.output] for key, star in scenario.star_sensors.items()},
        **{f"reference/{key}/imu": IMU for key in scenario.references},
        "gnss/fix": FIX,
        "met/pressure": PRESSURE,
        "met/temperature": TEMPERATURE,
        "met/humidity": HUMIDITY,
    }
    if scenario.fused_attitude.written:
        topics[FUSED_TOPIC] = SHIP_ATTITUDE
    if scenario.gravity.told == "topic":
        topics[DEFLECTION_TOPIC] = DEFLECTION
    if scenario.ship_baseline.is_aboard:
        topics[SHIP_BASELINE_TOPIC] = BASELINE
    if scenario.theodolite.aboard:
        topics |= {ENCODER_TOPIC: ENCODER, IMAGE_TOPIC: IMAGE}
        topics |= {baseline_topic(key): BASELINE for key in scenario.beacons}
        topics |= {drone_topic(key): IMU for key in scenario.beacons}
        topics |= {mount_stars_topic(key): OBSERVATIONS for key in scenario.telescopes}
        if scenario.targets:
            topics[TARGET_TOPIC] = TARGET
    return topics


def is_applicable(kind: str, type_name: str) -> bool:
    """True if a kind of fault applies to a message type."""
    return kind not in _TYPES_OF_KIND or type_name in _TYPES_OF_KIND[kind]


def baseline_topic(beacon_id: str) -> str:
    """Return the topic of a drone's baselines."""
    return f"beacon/{beacon_id}/baseline"


def drone_topic(beacon_id: str) -> str:
    """Return the topic of a drone's attitude."""
    return f"beacon/{beacon_id}/imu"


def mount_stars_topic(camera_id: str) -> str:
    """Return the topic of the stars in a camera on the theodolite."""
    return f"theodolite/{camera_id}/stars"


def mount_camera_frame(camera_id: str) -> str:
    """Return the frame_id of a camera on the theodolite."""
    return f"theodolite_{camera_id}"


def star_frame(sensor_id: str) -> str:
    """Return the frame_id of a star sensor."""
    return f"star_{sensor_id}"


def beacon_frame(beacon_id: str) -> str:
    """Return the frame_id of a drone."""
    return f"beacon_{beacon_id}"

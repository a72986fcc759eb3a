"""Mountings and cameras of devices, measured at some times of a bag.

Attitudes of devices on the deck are compared with the INS. A camera on the theodolite has no fixed attitude relative to
the deck. Its stars are compared with one another. Its attitude, predicted from the ship's attitude and the encoders, is
only used to identify these stars and the axes of a mirrored image.
"""

import functools
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_attitude_star.messages.input_messages import inertial_attitude, reference_measurement, star_measurement
from ship_attitude_star.ship_attitude.config import ReferenceConfig, ShipAttitudeConfig, StarSensorConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord
from ship_bags.stamps import NS_PER_S, stamp_of_bytes
from ship_estimation.rejection_rules import Rejection
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_geometry.tracks.sample_track import VectorTrack
from ship_node.messages.field_checks import MessageRejected
from ship_node.messages.sensor_readers import ins_sample
from ship_replay.preflight.check_config import INS_TOPIC
from ship_replay.preflight.measured_camera import CameraRecord, MeasuredCamera, measure_camera
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.camera.config import MountingConfig
from ship_stars.messages.surroundings_messages import SURROUNDINGS, surroundings_reader
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_stars.sky.tracker_attitude import to_horizon_attitude
from theodolite_calib.config import OpticalAxisConfig, StarCameraConfig
from theodolite_calib.messages import input_messages as mount_messages_in
from theodolite_calib.samples.samples import EncoderSample

ENCODER_TOPIC = "theodolite/encoder"
_FULL_TURN = 2.0 * np.pi

_EPOCHS = 30
"""Number of times of the bag at which a device is compared with the INS."""



class AttitudeTracks:
    """Samples of a bag that predict the attitude of a camera.

    Args:
        config: configuration of the node.
        ship_topic: topic of the ship's attitude.

    Attributes:
        topics: topics of the samples.
        ship: attitudes of the ship.
        encoder: readings of the theodolite's encoders.
    """

    def __init__(self, config: Any, ship_topic: str) -> None:
        on_mount = isinstance(config, OpticalAxisConfig)
        self.config, self.ship_topic = config, ship_topic
        self.topics = (ship_topic, ENCODER_TOPIC) if on_mount else (ship_topic,)
        self.ship = AttitudeTrack(round(config.ins.max_gap_s * NS_PER_S))
        encoder_gap_ns = round(config.encoder.max_gap_s * NS_PER_S) if on_mount else 1
        self.encoder: VectorTrack[EncoderSample] = VectorTrack(encoder_gap_ns, _FULL_TURN)

    def predicted_attitude(self, device: Any, time_ns: int) -> StarPrior | None:
        """Return the attitude of a camera (horizon from sensor) with its error covariance; None if unknown."""
        ship, ins = self.ship.at(time_ns + offset_ns(device)), self.config.ins
        if ship is None:
            return None
        sigma_arcsec = np.array([ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.tilt_sigma_arcsec])
        covariance_n = np.diag((sigma_arcsec * ARCSEC) ** 2)
        if not isinstance(device, StarCameraConfig):
            rotation_ns = ship.rotation_nd @ device.rotation_ds
            mounting_n = rotation_ns * device.installation_sigma_s
            return StarPrior(rotation_ns, covariance_n + mounting_n @ mounting_n.T)
        angles = self.encoder.at(time_ns)
        if angles is None:
            return None
        axes = AxisErrors.from_vector(self.config.axes.values)
        rotation_dm = main_axis_rotation(axes, float(angles.vector[0]), float(angles.vector[1]))
        rotation_sm = rotation_from_angles(*device.parallelism)
        deformation = self.config.deformation.sigma_arcsec * ARCSEC
        own = np.array([*self.config.axes.sigma, *device.parallelism_sigma, deformation])
        # An upper bound: each of these errors rotates the camera by at most its own size.
        covariance_n += own @ own * np.eye(3)
        return StarPrior(ship.rotation_nd @ rotation_dm @ rotation_sm.T, covariance_n)


def offset_ns(device: Any) -> int:
    """Return the time offset of a device, ns: data are valid at their stamp plus this offset."""
    return round(getattr(device, "time_offset_s", 0.0) * NS_PER_S)


Device = StarSensorConfig | MountingConfig | ReferenceConfig | StarCameraConfig
Config = ShipAttitudeConfig | StarAttitudeConfig | OpticalAxisConfig


@dataclass(frozen=True)
class MeasuredMounting:
    """Mounting of one device measured from a bag, and its camera.

    Attributes:
        section: dotted name of the device's parameters.
        topic: topic of the device's messages.
        device: configuration of the device.
        rotations_dv: rotation deck from device at each compared time, shape (n, 3, 3); n = 0 without attitudes, and for
            a camera on the theodolite.
        rates_d: rate of the deck at each compared time, rad/s, shape (n, 3).
        camera: camera parameters from its stars; None if the device gives no single stars.
    """

    section: str
    topic: str
    device: Any
    rotations_dv: FloatArray
    rates_d: FloatArray
    camera: MeasuredCamera | None = None


def measured_mountings(config: Config, bag: Bag, found: dict[str, str]) -> Iterator[MeasuredMounting]:
    """Yield the mounting of each configured device with messages in the bag.

    Args:
        config: configuration of a node with star sensors, references or cameras on the theodolite.
        bag: the bag.
        found: relative topic → name in the bag.
    """
    devices = {topic: entry for topic, entry in _devices(config).items() if topic in found}
    if not devices:
        return
    epochs = _sample_stamps(bag, {found[topic]: topic for topic in devices})
    observing = [topic for topic in devices if topic.endswith(("/observations", "/inertial_attitude", "/stars"))]
    sky_model = load_sky_model(config.sky) if observing else None
    tracks = AttitudeTracks(config, _ship_topic(config, found))
    messages = _collect_messages(tracks, bag, found, epochs, sky_model)
    for topic, (section, device) in devices.items():
        camera = None
        if topic.endswith(("/observations", "/stars")) and sky_model is not None:
            prior_at = functools.partial(tracks.predicted_attitude, device)
            camera = measure_camera(CameraRecord(topic, device.camera, messages[topic], prior_at), sky_model)
            attitudes = [] if isinstance(device, StarCameraConfig) else camera.attitudes
        else:
            attitudes = list(_attitudes(topic, device, messages[topic], sky_model))
        decks = [
            (deck, rotation_nv)
            for time_ns, rotation_nv in attitudes
            if (deck := tracks.ship.at(time_ns + offset_ns(device))) is not None
        ]
        rotations_dv = np.array([deck.rotation_nd.T @ rotation_nv for deck, rotation_nv in decks]).reshape(-1, 3, 3)
        rates_d = np.array([deck.rate_d for deck, _ in decks]).reshape(-1, 3)
        yield MeasuredMounting(section, topic, device, rotations_dv, rates_d, camera)


def _ship_topic(config: Config, found: dict[str, str]) -> str:
    """Return the topic of the ship's attitude: the theodolite's source if the bag contains it, else the INS."""
    source = config.ship.source if isinstance(config, OpticalAxisConfig) else INS_TOPIC
    return source if source in found else INS_TOPIC


def _devices(config: Config) -> dict[str, tuple[str, Any]]:
    """Return relative topic → section and configuration."""
    devices: dict[str, tuple[str, Any]] = {}
    for id_, star in getattr(config, "star_sensors", {}).items():
        devices[f"star/{id_}/{getattr(star, 'input', 'observations')}"] = f"star_sensors.{id_}", star
    for name, reference in getattr(config, "references", {}).items():
        devices[f"reference/{name}/imu"] = f"references.{name}", reference
    if isinstance(config, OpticalAxisConfig):
        for id_, telescope in config.telescopes.items():
            as_uncertain = replace(telescope, camera=config.star_camera(id_))
            devices[f"theodolite/{id_}/stars"] = f"telescopes.{id_}", as_uncertain
    return devices


def _sample_stamps(bag: Bag, topics: dict[str, str]) -> dict[str, list[int]]:
    """Return relative topic → stamps of messages spread over the bag."""
    stamps: dict[str, list[int]] = {relative: [] for relative in topics.values()}
    spacing_ns = (bag.end_ns - bag.start_ns) // _EPOCHS
    for record in bag.records(topics):
        stamp_ns, own = stamp_of_bytes(record.data), stamps[topics[record.topic]]
        if stamp_ns is not None and (not own or stamp_ns - own[-1] >= spacing_ns):
            own.append(stamp_ns)
    return stamps


def _collect_messages(
    tracks: AttitudeTracks, bag: Bag, found: dict[str, str], epochs: dict[str, list[int]], sky_model: SkyModel | None
) -> dict[str, list[tuple[Any, int]]]:
    """Return the messages at the stamps, with arrival times; add samples around these times to tracks and sky."""
    wanted = {topic: set(stamps) for topic, stamps in epochs.items()}
    all_epochs = sorted(stamp for stamps in epochs.values() for stamp in stamps)
    # Clocks may differ by a second (range of time_offset_s), and interpolation needs samples on both sides.
    reach_ns = round((tracks.config.ins.max_gap_s + 1.0) * NS_PER_S)
    messages: dict[str, list[tuple[Any, int]]] = {topic: [] for topic in epochs}
    sky_topics = set(SURROUNDINGS) if sky_model is not None else set()
    relative = {found[topic]: topic for topic in (*epochs, *sky_topics, *tracks.topics) if topic in found}
    for record in bag.records(relative):
        topic, stamp_ns = relative[record.topic], stamp_of_bytes(record.data)
        if stamp_ns is None:
            continue
        if topic in wanted:
            if stamp_ns in wanted[topic] and (message := _decode(record)) is not None:
                messages[topic].append((message, max(record.log_time_ns, stamp_ns)))
        elif topic in sky_topics or _is_near(all_epochs, stamp_ns, reach_ns):
            _add_sample(topic, record, stamp_ns, tracks, sky_model)
    return messages


def _add_sample(
    topic: str, record: BagRecord, stamp_ns: int, tracks: AttitudeTracks, sky_model: SkyModel | None
) -> None:
    """Add a message to its track or to the sky, unless a node would reject it."""
    receive_ns, config = max(record.log_time_ns, stamp_ns), tracks.config
    try:
        message = record.decode()
        if topic == ENCODER_TOPIC:
            tracks.encoder.insert(mount_messages_in.encoder(message, config, receive_ns).value)
        elif topic == INS_TOPIC:
            # Rates may have wrong units: use the attitudes only.
            tracks.ship.insert(replace(ins_sample(message, config.ins, receive_ns).value, rate_d=None))
        elif topic == tracks.ship_topic:
            tracks.ship.insert(replace(mount_messages_in.ship_attitude(message, config, receive_ns).value, rate_d=None))
        elif sky_model is not None:
            sky_model.surroundings.insert(surroundings_reader(topic, config.sky)(message, receive_ns=receive_ns).value)
    except (MessageRejected, BadInput):
        return


def _is_near(epochs: list[int], stamp_ns: int, reach_ns: int) -> bool:
    index = bisect_left(epochs, stamp_ns - reach_ns)
    return index < len(epochs) and epochs[index] <= stamp_ns + reach_ns


def _decode(record: BagRecord) -> Any:
    try:
        return record.decode()
    except BadInput:
        return None


def _attitudes(
    topic: str, device: Any, messages: list[tuple[Any, int]], sky_model: SkyModel | None
) -> Iterator[tuple[int, FloatArray]]:
    """Yield stamps and attitudes (horizon from device) of a device that outputs attitudes."""
    _, id_, kind = topic.split("/")
    for message, receive_ns in messages:
        try:
            if kind == "imu":
                measurement: Any = reference_measurement(message, id_, device, receive_ns).value
            elif kind == "inertial_attitude":
                inertial = inertial_attitude(message, id_, device, receive_ns).value
                if sky_model is None:
                    continue
                measurement = to_horizon_attitude(inertial, sky_model)
            else:
                measurement = star_measurement(message, id_, device, receive_ns).value
        except MessageRejected:
            continue
        if not isinstance(measurement, Rejection):
            yield measurement.time_ns, measurement.rotation_nv

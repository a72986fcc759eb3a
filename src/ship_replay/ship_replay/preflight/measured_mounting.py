"""How the devices of a bag are mounted by its data: their attitudes against the INS's, at some moments of the bag."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_attitude_star.ros.messages_in import inertial_attitude, reference_measurement, star_measurement
from ship_attitude_star.ros.star_messages_in import star_exposure
from ship_attitude_star.ros.surroundings_in import SURROUNDINGS, surroundings_reader
from ship_attitude_star.ship_attitude.config import ReferenceConfig, ShipAttitudeConfig, StarSensorConfig
from ship_attitude_star.sky.sky_watch import SkyWatch, installed_sky
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import solve_exposure
from ship_attitude_star.stars.config import CameraConfig, MountingConfig
from ship_attitude_star.stars.exposure import StarExposure
from ship_attitude_star.stars.solution import SolutionStatus
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord
from ship_bags.stamps import NS_PER_S, stamp_of_bytes
from ship_estimation.refusals import Refusal
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.rotations import FloatArray, angle_between
from ship_node.edge.ins_messages import ins_sample
from ship_node.edge.messages_in import Refused

_EPOCHS = 30
"""Moments of the bag at which a device is compared with the INS: all that a check needs."""

_FEWEST_PAIRS = 5
_LEAST_PAIR_ANGLE = np.deg2rad(0.2)
_FIRST_FACTORS = 1.0, 0.1, 10.0
_SEARCH_STEPS = 8
_INS_TOPIC = "ins/imu"

Device = StarSensorConfig | MountingConfig | ReferenceConfig


@dataclass(frozen=True)
class MeasuredMounting:
    """How one device is mounted by the data of a bag.

    Attributes:
        section: dotted name of its parameters.
        topic: where its messages came.
        device: its configuration.
        rotations_dv: deck from device at the moments compared, shape (n, 3, 3); n = 0 where there were none.
        focal_length_m: of its camera, by the angles between stars; None where it has none or too few stars.
    """

    section: str
    topic: str
    device: Any
    rotations_dv: FloatArray
    focal_length_m: float | None = None


def measured_mountings(
    config: ShipAttitudeConfig | StarAttitudeConfig, bag: Bag, found: dict[str, str]
) -> Iterator[MeasuredMounting]:
    """Each device of a configuration that the bag has messages of.

    Args:
        config: of a node that takes ``ins/imu`` and star sensors.
        bag: the bag.
        found: relative topic → name in the bag.
    """
    devices = {topic: entry for topic, entry in _devices(config).items() if topic in found}
    if not devices or _INS_TOPIC not in found:
        return
    epochs = _epochs(bag, {found[topic]: topic for topic in devices})
    observing = [topic for topic in devices if topic.endswith(("/observations", "/inertial_attitude"))]
    watch = installed_sky(config.sky) if observing else None
    track, messages = _collected(config, bag, found, epochs, watch)
    for topic, (section, device) in devices.items():
        if topic.endswith("/observations") and watch is not None:
            camera, exposures = _fitted_camera(device.camera, messages[topic], topic, watch)
            attitudes = _solved(exposures, watch)
            focal_length_m = camera.focal_length_m if camera is not None else None
        else:
            attitudes, focal_length_m = list(_attitudes(topic, device, messages[topic], watch)), None
        offset_ns = round(getattr(device, "time_offset_s", 0.0) * NS_PER_S)
        turns = [
            deck.rotation_nd.T @ rotation_nv
            for time_ns, rotation_nv in attitudes
            if (deck := track.at(time_ns + offset_ns)) is not None
        ]
        yield MeasuredMounting(section, topic, device, np.array(turns).reshape(-1, 3, 3), focal_length_m)


def _devices(config: ShipAttitudeConfig | StarAttitudeConfig) -> dict[str, tuple[str, Any]]:
    """Relative topic → section and configuration."""
    devices: dict[str, tuple[str, Any]] = {}
    for id_, star in config.star_sensors.items():
        devices[f"star/{id_}/{getattr(star, 'input', 'observations')}"] = f"star_sensors.{id_}", star
    for name, reference in getattr(config, "references", {}).items():
        devices[f"reference/{name}/imu"] = f"references.{name}", reference
    return devices


def _epochs(bag: Bag, topics: dict[str, str]) -> dict[str, list[int]]:
    """Relative topic → stamps of messages spread over the bag."""
    stamps: dict[str, list[int]] = {relative: [] for relative in topics.values()}
    spacing_ns = ((bag.end_ns or 0) - (bag.start_ns or 0)) // _EPOCHS
    for record in bag.records(topics):
        stamp_ns, own = stamp_of_bytes(record.data), stamps[topics[record.topic]]
        if stamp_ns is not None and (not own or stamp_ns - own[-1] >= spacing_ns):
            own.append(stamp_ns)
    return stamps


def _collected(
    config: Any, bag: Bag, found: dict[str, str], epochs: dict[str, list[int]], watch: SkyWatch | None
) -> tuple[AttitudeTrack, dict[str, list[tuple[Any, int]]]]:
    """The INS's attitudes around the epochs, and the messages (with their arrival) at them.

    On the way the watch of the sky is told of place and air.
    """
    wanted = {topic: set(stamps) for topic, stamps in epochs.items()}
    all_epochs = sorted(stamp for stamps in epochs.values() for stamp in stamps)
    # Clocks may differ by a second (the range of time_offset_s), and an interpolation needs samples on both sides.
    reach_ns = round((config.ins.max_gap_s + 1.0) * NS_PER_S)
    track = AttitudeTrack(round(config.ins.max_gap_s * NS_PER_S))
    messages: dict[str, list[tuple[Any, int]]] = {topic: [] for topic in epochs}
    sky_topics = set(SURROUNDINGS) if watch is not None else set()
    relative = {found[topic]: topic for topic in (*epochs, *sky_topics, _INS_TOPIC) if topic in found}
    for record in bag.records(relative):
        topic, stamp_ns = relative[record.topic], stamp_of_bytes(record.data)
        if stamp_ns is None:
            continue
        if topic in wanted:
            if stamp_ns in wanted[topic] and (message := _decoded(record)) is not None:
                messages[topic].append((message, max(record.log_time_ns, stamp_ns)))
        elif topic in sky_topics or _near(all_epochs, stamp_ns, reach_ns):
            _tell(topic, record, stamp_ns, config, track, watch)
    return track, messages


def _tell(
    topic: str, record: BagRecord, stamp_ns: int, config: Any, track: AttitudeTrack, watch: SkyWatch | None
) -> None:
    """Give a message of the INS to the track, and one of place or air to the watch, unless a node would refuse it."""
    receive_ns = max(record.log_time_ns, stamp_ns)
    try:
        message = record.decode()
        if topic == _INS_TOPIC:
            # Its rates may be wrong in their units: attitudes alone decide here.
            track.insert(replace(ins_sample(message, config.ins, receive_ns).value, rate_d=None))
        elif watch is not None:
            watch.surroundings.insert(surroundings_reader(topic, config.sky)(message, receive_ns=receive_ns).value)
    except (Refused, BadInput):
        return


def _near(epochs: list[int], stamp_ns: int, reach_ns: int) -> bool:
    index = bisect_left(epochs, stamp_ns - reach_ns)
    return index < len(epochs) and epochs[index] <= stamp_ns + reach_ns


def _decoded(record: BagRecord) -> Any:
    try:
        return record.decode()
    except BadInput:
        return None


def _attitudes(
    topic: str, device: Any, messages: list[tuple[Any, int]], watch: SkyWatch | None
) -> Iterator[tuple[int, FloatArray]]:
    """Stamps and attitudes (horizon from device) of a device that solves its own."""
    _, id_, kind = topic.split("/")
    for message, receive_ns in messages:
        try:
            if kind == "imu":
                measurement: Any = reference_measurement(message, id_, device, receive_ns).value
            elif kind == "inertial_attitude":
                inertial = inertial_attitude(message, id_, device, receive_ns).value
                if watch is None:
                    continue
                measurement = in_horizon(inertial, watch)
            else:
                measurement = star_measurement(message, id_, device, receive_ns).value
        except Refused:
            continue
        if not isinstance(measurement, Refusal):
            yield measurement.time_ns, measurement.rotation_nv


# -- single stars -----------------------------------------------------------------------------------------------


def _solved(exposures: list[StarExposure], watch: SkyWatch) -> list[tuple[int, FloatArray]]:
    solutions = [(exposure.time_ns, solve_exposure(exposure, (), None, watch)[1].solution) for exposure in exposures]
    return [(time_ns, s.rotation_nb) for time_ns, s in solutions if s.status is not SolutionStatus.INVALID]


def _exposures(
    camera: CameraConfig, messages: list[tuple[Any, int]], topic: str, watch: SkyWatch
) -> list[StarExposure]:
    """The exposures of those messages whose moment and place are known well enough for a sky."""
    sensor_id, exposures = topic.split("/")[1], []
    for message, receive_ns in messages:
        try:
            exposure = star_exposure(
                message, sensor_id, "", camera.camera("camera"), camera, watch.catalogue, receive_ns
            ).value
        except Refused:
            continue
        if not isinstance(watch.at(exposure.time_ns), Refusal):
            exposures.append(exposure)
    return exposures


def _fitted_camera(
    camera: CameraConfig, messages: list[tuple[Any, int]], topic: str, watch: SkyWatch
) -> tuple[CameraConfig | None, list[StarExposure]]:
    """The camera whose focal length makes the angles between stars those of the sky, and the exposures by it.

    Returns:
        None for the camera where too few stars have names: the exposures are then by the camera as configured.
    """
    for factor in _FIRST_FACTORS:
        fitted = _with_focal_length(camera, factor * camera.focal_length_m)
        for _ in range(_SEARCH_STEPS):
            exposures = _exposures(fitted, messages, topic, watch)
            scale = _scale(exposures, watch)
            if scale is None:
                break
            if abs(scale - 1.0) < 1e-5:
                return fitted, exposures
            fitted = _with_focal_length(fitted, scale * fitted.focal_length_m)
    return None, _exposures(camera, messages, topic, watch)


def _with_focal_length(camera: CameraConfig, focal_length_m: float) -> CameraConfig:
    return replace(camera, focal_length_m=float(np.clip(focal_length_m, 0.001, 10.0)))


def _scale(exposures: list[StarExposure], watch: SkyWatch) -> float | None:
    """Median ratio of measured to true angles between stars; None where there are too few pairs."""
    ratios: list[float] = []
    for exposure in exposures:
        named = exposure[exposure.identified]
        if len(named) < 2:
            continue
        moment = watch.at(named.time_ns)
        assert not isinstance(moment, Refusal)
        places_n = moment.apparent(named.positions).direction_n
        first, second = np.triu_indices(len(named), 1)
        true = angle_between(places_n[first], places_n[second])
        measured = angle_between(named.directions_s[first], named.directions_s[second])
        # Where a place is not known (too low) the angle is NaN, and not used.
        ratios += (measured[true > _LEAST_PAIR_ANGLE] / true[true > _LEAST_PAIR_ANGLE]).tolist()
    return float(np.median(ratios)) if len(ratios) >= _FEWEST_PAIRS else None

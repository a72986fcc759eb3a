"""Messages of a simulated run in order of arrival, with the faults of the scenario."""

import heapq
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angles_from_rotation
from ship_geometry.mount.image import Camera
from ship_geometry.rotations import wrap_pi
from ship_simulation.faults.device_geometry import SuiteOptics
from ship_simulation.faults.faults import WATERMARK, Delivery, apply_faults
from ship_simulation.messages.ship_messages import (
    Maker,
    deflection_maker,
    fix_maker,
    fused_maker,
    inertial_maker,
    ins_maker,
    observations_maker,
    reference_maker,
    star_maker,
    true_attitude_maker,
    weather_makers,
)
from ship_simulation.messages.theodolite_messages import (
    baseline_maker,
    theodolite_sources,
    true_calibrations,
    true_directions,
    true_pointings,
)
from ship_simulation.random_draws import first_in_each_second
from ship_simulation.run import SimulatedRun
from ship_simulation.scenario.names import (
    DECK_FRAME,
    DEFLECTION,
    DEFLECTION_TOPIC,
    FUSED_TOPIC,
    SECOND_ANTENNA_ID,
    SHIP_ATTITUDE,
    SHIP_BASELINE_TOPIC,
    mount_stars_topic,
    simulated_topics,
    star_frame,
)
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings

TRUTH_ATTITUDE, TRUTH_ALIGNMENT = "truth/attitude", "truth/alignment"
TRUTH_DEFLECTION = "truth/deflection"
TRUTH_POINTING, TRUTH_CALIBRATION = "truth/pointing", "truth/calibration"
TRUTH_DIRECTION = "truth/target_direction"

TRUTH_TYPES = {
    TRUTH_ALIGNMENT: "ship_msgs/msg/AlignmentState",
    TRUTH_ATTITUDE: SHIP_ATTITUDE,
    TRUTH_CALIBRATION: "ship_msgs/msg/TheodoliteCalibration",
    TRUTH_DEFLECTION: DEFLECTION,
    TRUTH_DIRECTION: "ship_msgs/msg/TargetDirection",
    TRUTH_POINTING: "ship_msgs/msg/OpticalAxisPointing",
}
"""Topic of the truth → type. No node receives these topics. The scenario determines which of them a bag contains."""

LogEntry = tuple[str, Any, int]
"""(topic, message, log time in ns)."""


def generate_messages(runs: Iterable[SimulatedRun], factory: MessageFactory) -> Iterator[LogEntry]:
    """Yield all messages of a voyage's stretches in order of log time; the truth is logged at its stamps."""
    topics: dict[str, _Topic] = {}
    pending: dict[str, list[LogEntry]] = {}
    for run in runs:
        streams = {topic: _log_at_stamp(topic, stamped) for topic, stamped in _truths(run, factory)}
        for topic, (time_ns, log_time_ns, maker) in _sources(run, factory).items():
            if topic not in topics:
                topics[topic] = _Topic(run, topic)
            streams[topic] = topics[topic].deliver(run, time_ns, log_time_ns, maker)
        streams = {topic: chain(pending.get(topic, ()), stream) for topic, stream in streams.items()}
        if run.stretch.is_last:
            yield from _merge_by_log_time(streams)
            return
        pending = {topic: list(stream) for topic, stream in streams.items()}
        until_ns = min(run.stretch.end_ns - 1, *(topic.watermark_ns for topic in topics.values()))
        yield from _merge_by_log_time(
            {topic: [e for e in entries if e[2] <= until_ns] for topic, entries in pending.items()}
        )
        pending = {topic: [entry for entry in entries if entry[2] > until_ns] for topic, entries in pending.items()}


def _merge_by_log_time(streams: Mapping[str, Iterable[LogEntry]]) -> Iterator[LogEntry]:
    """Merge messages by log time; messages of equal time are in the order of the topics."""
    return heapq.merge(*streams.values(), key=lambda entry: entry[2])


def _truths(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[str, Iterator[tuple[int, Any]]]]:
    """Yield each topic of the truth with stamps and messages."""
    yield TRUTH_ALIGNMENT, truth_alignments(run, factory)
    yield TRUTH_ATTITUDE, truth_attitudes(run, factory)
    if not run.scenario.gravity.is_level:
        yield TRUTH_DEFLECTION, truth_deflections(run, factory)
    if run.theodolite is not None:
        encoder = run.scenario.theodolite.encoder
        ends = run.stretch.contains_last(encoder.rate_hz, encoder.phase_s)
        yield TRUTH_CALIBRATION, true_calibrations(run.theodolite, run.start_ns, ends, factory)
        if run.scenario.targets:
            yield TRUTH_DIRECTION, true_directions(run.theodolite.targets, factory)
        yield TRUTH_POINTING, true_pointings(run.theodolite, factory)


def _sources(run: SimulatedRun, factory: MessageFactory) -> dict[str, tuple[np.ndarray, np.ndarray, Maker]]:
    """Return topic → stamps, log times and maker of messages."""
    scenario = run.scenario
    sources = {"ins/imu": (run.ins.time_ns, run.ins.log_time_ns, ins_maker(run.ins, scenario.ins, factory))}
    for key, stars in run.stars.items():
        config = scenario.star_sensors[key]
        if isinstance(stars, StarSightings):
            maker = observations_maker(key, star_frame(key), stars, config.exposure_s, factory)
        elif isinstance(stars, InertialSamples):
            maker = inertial_maker(key, stars, factory)
        else:
            maker = star_maker(key, stars, config, factory)
        sources[f"star/{key}/{config.output}"] = stars.time_ns, stars.log_time_ns, maker
    for key, samples in run.references.items():
        maker = reference_maker(key, samples, factory)
        sources[f"reference/{key}/imu"] = samples.time_ns, samples.log_time_ns, maker
    sources["gnss/fix"] = run.fixes.time_ns, run.fixes.log_time_ns, fix_maker(run.fixes, factory)
    for topic, maker in weather_makers(run.weather_ns, scenario.weather, factory).items():
        sources[topic] = run.weather_ns, run.weather_ns, maker
    if run.deflections is not None:
        deflections = run.deflections
        maker = deflection_maker(deflections.time_ns, deflections.deflection, deflections.covariance, factory)
        sources[DEFLECTION_TOPIC] = deflections.time_ns, deflections.time_ns, maker
    if run.ship_baseline is not None:
        baselines = run.ship_baseline
        maker = baseline_maker(SECOND_ANTENNA_ID, baselines, factory)
        sources[SHIP_BASELINE_TOPIC] = baselines.time_ns, baselines.log_time_ns, maker
    if run.fused is not None:
        sources[FUSED_TOPIC] = run.fused.time_ns, run.fused.log_time_ns, fused_maker(run.fused, factory)
    if run.theodolite is not None:
        sources |= theodolite_sources(run.theodolite, scenario, factory)
    return sources


def _log_at_stamp(topic: str, stamped: Iterator[tuple[int, Any]]) -> Iterator[LogEntry]:
    for time_ns, message in stamped:
        yield topic, message, time_ns


class _Topic:
    """The messages of a topic; a message that arrives after its stretch is delivered in a later stretch.

    Args:
        run: first stretch of the voyage.
        topic: name of the topic.

    Attributes:
        watermark_ns: time after which all undelivered messages arrive.
    """

    def __init__(self, run: SimulatedRun, topic: str) -> None:
        self.watermark_ns = run.start_ns
        self._topic = topic
        self._pending: list[Delivery] = []
        self._stretch_deliveries: Iterator[Delivery] = iter(())
        faults = {name: fault for name, fault in run.scenario.faults.items() if fault.topic == topic}
        type_name = simulated_topics(run.scenario)[topic]
        self._faulty_deliveries = apply_faults(
            self._all_deliveries(), type_name, faults, run.start_ns, run.seed, _optics_of_scenario(run.scenario)
        )

    def deliver(
        self, run: SimulatedRun, time_ns: np.ndarray, log_time_ns: np.ndarray, maker: Maker
    ) -> Iterator[LogEntry]:
        """Yield the messages that arrive in a stretch, in order of arrival."""
        self._stretch_deliveries = self._deliveries_of_stretch(run, time_ns, log_time_ns, maker)
        for delivery in self._faulty_deliveries:
            if delivery.message is WATERMARK:
                self.watermark_ns = delivery.log_time_ns
                return
            yield self._topic, delivery.message, delivery.log_time_ns

    def _all_deliveries(self) -> Iterator[Delivery]:
        """Yield the deliveries of all stretches; a delivery of WATERMARK follows each stretch except the last."""
        is_watermark = True
        while is_watermark:
            is_watermark = False
            for delivery in self._stretch_deliveries:
                is_watermark = delivery.message is WATERMARK
                yield delivery

    def _deliveries_of_stretch(
        self, run: SimulatedRun, time_ns: np.ndarray, log_time_ns: np.ndarray, maker: Maker
    ) -> Iterator[Delivery]:
        order = np.argsort(log_time_ns, kind="stable").tolist()
        made = (Delivery(maker(i, i), int(log_time_ns[i]), int(time_ns[i]), i) for i in order)
        pending, self._pending = self._pending, []
        # If arrival times are equal, the delivery with the earlier stamp comes first.
        for delivery in heapq.merge(pending, made, key=lambda delivery: delivery.log_time_ns):
            if delivery.log_time_ns < run.stretch.end_ns:
                yield delivery
            else:
                self._pending.append(delivery)
        if not run.stretch.is_last:
            yield Delivery(WATERMARK, int(run.stretch.end_ns) - 1, None, 0)


def _optics_of_scenario(scenario: Scenario) -> SuiteOptics:
    stars = {
        f"star/{key}/observations": sensor.camera.camera(key)
        for key, sensor in scenario.star_sensors.items()
        if sensor.output == "observations"
    }
    stars |= {mount_stars_topic(key): one.camera.camera(key) for key, one in scenario.telescopes.items()}
    telescope = scenario.theodolite.telescope
    camera = Camera(telescope.focal_length_m, 0.0, telescope.principal_point_m)
    return SuiteOptics(stars, camera if scenario.theodolite.aboard else None)


def truth_attitudes(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, ShipAttitude) at the stamps of the truth."""
    time_ns = run.ins.time_ns[run.truth.ins_index]
    make = true_attitude_maker(time_ns, run.truth.rotation_nd, run.truth.rate_d, factory)
    for row, stamp_ns in enumerate(map(int, time_ns)):
        yield stamp_ns, make(row, row)


def truth_deflections(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, Deflection) once per second at stamps of the truth, and at the last stamp of the voyage."""
    time_ns = run.ins.time_ns[run.truth.ins_index]
    make = deflection_maker(time_ns, run.truth.deflection, np.zeros((2, 2)), factory)
    ends = run.stretch.contains_last(run.scenario.ins.rate_hz, 0.0)
    for row in first_in_each_second(time_ns, run.start_ns, ends).tolist():
        yield int(time_ns[row]), make(row, row)


def truth_alignments(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, AlignmentState) once per second at stamps of the truth, and at the last stamp of the voyage."""
    index = run.truth.ins_index
    ends = run.stretch.contains_last(run.scenario.ins.rate_hz, 0.0)
    chosen = index[first_in_each_second(run.ins.time_ns[index], run.start_ns, ends)]
    constant = _constant_values(run)
    names = ["ins.north", "ins.up", "ins.east", *constant]
    units = ["s" if name.endswith("time_offset") else "rad" for name in names]
    for sample in chosen.tolist():
        time_ns = int(run.ins.time_ns[sample])
        message = factory.make(
            "ship_msgs/msg/AlignmentState",
            header=make_header(factory, time_ns, DECK_FRAME),
            names=names,
            values=np.array([*run.truth.ins.attitude_error_n[sample], *constant.values()]),
            covariance=np.zeros(len(names) ** 2),
            units=units,
        )
        yield time_ns, message


def _constant_values(run: SimulatedRun) -> dict[str, float]:
    """Return name → true value of each quantity that is constant during the run."""
    values = {"ins.time_offset": run.truth.ins.time_offset_s}
    for key, device in run.truth.stars.items():
        azimuth, elevation, roll = angles_from_rotation(device.rotation_dv).tolist()
        values |= {f"star.{key}.azimuth": azimuth, f"star.{key}.elevation": elevation, f"star.{key}.roll": roll}
        values[f"star.{key}.time_offset"] = device.time_offset_s
    for key, device in run.truth.references.items():
        heading, pitch, roll = angles_from_rotation(device.rotation_dv).tolist()
        values |= {f"reference.{key}.roll": roll, f"reference.{key}.pitch": pitch}
        values |= {f"reference.{key}.heading": float(wrap_pi(heading))}
        values[f"reference.{key}.time_offset"] = device.time_offset_s
    return values

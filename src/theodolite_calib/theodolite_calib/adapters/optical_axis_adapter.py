"""Adapter of the node ``optical_axis``: input topics with the core's methods, output messages, diagnostics."""

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_estimation.recovery.displacement import TOGETHER
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import flu_from_device_vector
from ship_geometry.rotations import ARCSEC
from ship_node.adapters.adapter import DeferringPart, Feed, ignore_time
from ship_node.adapters.adapter_report import clock_status
from ship_node.adapters.input_processing import PRESENCE_REASONS
from ship_node.adapters.node_adapter import OWN_OUTPUTS
from ship_node.adapters.recovering_adapter import RecoveringAdapter, recovery_status
from ship_node.health.duplicate_publishers import ATTITUDE, BASELINE, ENCODERS
from ship_node.messages.common_messages import (
    BUDGET_TYPE,
    INNOVATION_TYPE,
    INTEGRITY_TYPE,
    TF_TOPIC,
    TF_TYPE,
    DiagnosticStatus,
    Level,
)
from ship_node.messages.inputs_outputs import InputTopic, OutputMessage, OutputRows, OutputTopic
from ship_node.saved_files.saved_document import DISK, Files
from ship_node.saved_files.saved_start import SavedStart
from ship_stars.messages.star_messages import ExposingSensor, star_exposure
from ship_stars.messages.surroundings_messages import surroundings_feeds
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.subfilters import BEACON_PREFIX, ENCODER, SHIP
from theodolite_calib.messages import input_messages
from theodolite_calib.messages.output_messages import (
    ESCORT_TOPIC,
    ESCORT_TYPE,
    MAIN_FRAME,
    POINTING_TOPIC,
    POINTING_TYPE,
    TARGET_TOPIC,
    TARGET_TYPE,
    PointingNumbers,
    error_arcsec,
    escort_message,
    pointing_budget,
    pointing_messages,
    pointing_rows,
    target_message,
)
from theodolite_calib.optical_axis.calibration import Calibration, CalibrationPrior, calibration_from_state
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.optical_axis.output import QUANTITIES, PointingSeries, invalid_pointing
from theodolite_calib.samples.samples import (
    Exposure,
    ExposureDecision,
    Mode,
    PointingEstimate,
    PointingOutcome,
)

BASE_FRAME = "theodolite_base"
INTEGRITY_TOPIC = "theodolite/integrity"
TARGET_IMAGE_TOPIC = "theodolite/target"

_STREAM_TIMEOUT_S = 3.0
"""Maximum age of the last encoder reading or ship's attitude for its stream to count as present, s."""
_MIN_BEACONS = 2

_IMU_TYPE = "sensor_msgs/msg/Imu"
_SHIP = {
    "ship/attitude": ("ship_msgs/msg/ShipAttitude", input_messages.ship_attitude),
    "ins/imu": (_IMU_TYPE, input_messages.ins_attitude),
}
"""Topics of the ship's attitude, with message type and reader."""

_LEVELS = {
    Status.VALID: Level.OK,
    Status.COASTING: Level.WARN,
    Status.DEGRADED: Level.WARN,
    Status.INVALID: Level.ERROR,
}
_MODE_TEXTS = {
    Mode.TWO_LIGHTS: "two or more lights",
    Mode.ONE_LIGHT: "one light",
    Mode.ENCODER: "encoders",
    Mode.STARS: "stars",
    Mode.STARS_AND_LIGHTS: "stars and lights",
}


class OpticalAxisAdapter(RecoveringAdapter):
    """Optical axis of the theodolite with its error budget, from encoders, ship's attitude, stars, lights of drones.

    Args:
        config: the node's parameters.
        factory: creates the messages.
        files: reads and writes the saved calibration.

    Raises:
        BadInput: the calibration file cannot be opened (:class:`SavedStart`).
        ParameterError: the parameters of a star camera are incomplete.
    """

    node_name: ClassVar[str] = "optical_axis"
    config_type: ClassVar[type] = OpticalAxisConfig
    services: ClassVar[tuple[str, ...]] = ("reset", "save_alignment", "load_alignment")
    main_topic: ClassVar[str] = POINTING_TOPIC
    innovation_topic: ClassVar[str] = "theodolite/innovation"
    integrity_topic: ClassVar[str] = INTEGRITY_TOPIC
    integrity_frame: str = MAIN_FRAME
    quantities: ClassVar[tuple[str, ...]] = QUANTITIES
    required_sources: ClassVar[tuple[str, ...]] = ("encoder", "ship")
    redundancy_key: ClassVar["attrgetter[tuple[Any, ...]]"] = attrgetter("status", "mode")
    directions: ClassVar["attrgetter[np.ndarray]"] = attrgetter("by_error_n")
    outputs: tuple[OutputTopic, ...] = (
        OutputTopic(POINTING_TOPIC, POINTING_TYPE),
        OutputTopic("theodolite/calibration", "ship_msgs/msg/TheodoliteCalibration", latched=True),
        OutputTopic("theodolite/error_budget", BUDGET_TYPE),
        OutputTopic(innovation_topic, INNOVATION_TYPE),
        OutputTopic(INTEGRITY_TOPIC, INTEGRITY_TYPE),
        OutputTopic("theodolite/error_arcsec", "ship_msgs/msg/PointingErrorArcsec"),
        OutputTopic(TARGET_TOPIC, TARGET_TYPE),
        OutputTopic(ESCORT_TOPIC, ESCORT_TYPE),
        OutputTopic(TF_TOPIC, TF_TYPE),
        *OWN_OUTPUTS,
    )

    def __init__(self, config: OpticalAxisConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self._cameras = {
            id_: camera.camera.camera(f"telescopes.{id_}.camera") for id_, camera in config.telescopes.items()
        }
        self._sky = load_sky_model(config.sky) if config.telescopes else None
        core = self.make_core(config, self._sky)
        saved = SavedStart(
            CALIBRATION_FILE,
            config.calibration_file,
            files,
            start_from=self.start_from,
            content_to_save=self._calibration_to_save,
            nothing_text="no light or star was used yet: there is no calibration to save",
        )
        self._lever = dict(zip("xyz", flu_from_device_vector(config.lever.vector_m).tolist(), strict=True))
        super().__init__(config, core, factory, self._pointing_messages, saved)
        self.outputs = tuple(output for output in self.outputs if output.type_name != TF_TYPE or config.publish_tf)

    def _pointing_messages(self, estimate: PointingEstimate) -> list[OutputMessage]:
        config = self.config
        return pointing_messages(self.factory, self._lever, estimate, config.frames, config.publish_tf)

    def _calibration(self) -> Calibration:
        """Return the calibration of the present estimator."""
        return calibration_from_state(self.core.filter, self.config, self.core.state)

    def _calibration_to_save(self) -> CalibrationPrior | None:
        """Return the calibration of the present estimator."""
        core: OpticalAxisCore = self.core
        return core.calibration_to_save()

    @property
    def deferring_part(self) -> DeferringPart:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`."""
        pointings: DeferringPart = self.core.pointings
        return pointings

    def make_core(self, config: OpticalAxisConfig, sky_model: SkyModel | None) -> OpticalAxisCore:
        """Return the estimator; a subclass returns an estimator that smooths the pointings."""
        return OpticalAxisCore(config, sky_model)

    def table(self, config: OpticalAxisConfig, core: OpticalAxisCore) -> Iterator[Feed]:
        """Yield the inputs with the core's methods that process them."""
        encoder = InputTopic("theodolite/encoder", "ship_msgs/msg/TheodoliteEncoder", required=True, depth=1000)
        read_encoder = functools.partial(input_messages.encoder, config=config)
        read_encoders = functools.partial(input_messages.encoders, config=config)
        yield Feed(
            encoder,
            "encoder",
            read_encoder,
            core.pointings.add_encoder,
            read_rows=read_encoders,
            shows_present=ENCODER,
            stream_quantity=ENCODERS,
        )
        type_name, read_ship = _SHIP[config.ship.source]
        ship = InputTopic(config.ship.source, type_name, required=True, depth=1000)
        by_ins = config.ship.source == "ins/imu"
        read_ships = None if by_ins else functools.partial(input_messages.ship_attitudes, config=config)
        read_ship = functools.partial(read_ship, config=config)
        add_ship = core.pointings.add_ship
        yield Feed(
            ship, "ship", read_ship, add_ship, read_rows=read_ships, shows_present=SHIP, stream_quantity=ATTITUDE
        )
        image = InputTopic("theodolite/beacons", "ship_msgs/msg/BeaconImage", required=False, depth=1000)
        read_image = functools.partial(input_messages.exposure, config=config)
        process = ignore_time(core.add_exposure)
        yield Feed(image, "lights", read_image, process, has_decision=True, measurement_source=Exposure.source)
        target = InputTopic(
            TARGET_IMAGE_TOPIC, "ship_msgs/msg/TargetImage", required=False, depth=1000, is_occasional=True
        )
        read_target = functools.partial(input_messages.target, config=config)
        yield Feed(target, "target", read_target, core.pointings.add_target, has_decision=True)
        if self._sky is not None:
            yield from self._star_feeds(config, core)
        for id_, beacon in config.beacons.items():
            topic = InputTopic(f"beacon/{id_}/baseline", "ship_msgs/msg/RtkBaseline", required=False, depth=1000)
            read_baseline = functools.partial(input_messages.baseline, beacon=beacon, least_fix=config.least_fix)
            process = ignore_time(functools.partial(core.streams.add_baseline, id_))
            yield Feed(topic, f"baseline.{id_}", read_baseline, process, stream_quantity=BASELINE)
        for id_, beacon in config.beacons.items():
            topic = InputTopic(f"beacon/{id_}/imu", _IMU_TYPE, required=False, depth=1000)
            read_imu = functools.partial(input_messages.drone_attitude, beacon=beacon)
            read_imus = functools.partial(input_messages.drone_attitudes, beacon=beacon)
            process = ignore_time(functools.partial(core.streams.add_drone_attitude, id_))
            yield Feed(topic, f"drone.{id_}", read_imu, process, read_rows=read_imus, stream_quantity=ATTITUDE)

    def _star_feeds(self, config: OpticalAxisConfig, core: OpticalAxisCore) -> Iterator[Feed]:
        """Yield the inputs of star cameras on the theodolite, and of position and air for the sky model."""
        assert self._sky is not None
        for id_, camera in config.telescopes.items():
            topic = InputTopic(
                f"theodolite/{id_}/stars", "ship_msgs/msg/StarObservationArray", False, depth=100, is_occasional=True
            )
            sensor = ExposingSensor(id_, camera.frame_id, self._cameras[id_], config.star_camera(id_))
            read = functools.partial(star_exposure, sensor=sensor, catalogue=self._sky.catalogue)
            yield Feed(topic, f"star.{id_}", read, core.add_exposure, has_decision=True)
        yield from surroundings_feeds(config.sky, ignore_time(core.add_surroundings), position_required=False)

    def report_outcome(self, outcome: PointingOutcome, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`; the directions of targets come first.

        A direction of a target has no innovation, because the image of the target is not compared with a prediction.
        A node that is behind publishes no directions.
        """
        published: list[OutputMessage] = []
        for target in outcome.targets if self.overload_report.behind is None else ():
            if target.status is not Status.INVALID:
                self.health.record_accepted(TARGET_IMAGE_TOPIC, target.time_ns, now_ns)
            published.append((TARGET_TOPIC, target_message(self.factory, target, self.config.frames.horizon)))
        return published + super().report_outcome(outcome, now_ns, waiting_ns)

    def batch_messages(self, series: Sequence[PointingSeries]) -> Iterator[OutputRows]:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`."""
        pointings, config = PointingNumbers.from_series(series), self.config
        return pointing_rows(self.factory, self._lever, pointings, config.frames, config.publish_tf)

    def rejected_part_message(self, source: str, time_ns: int, name: str, rejection: Rejection) -> OutputMessage:
        """Return the message about a beacon or star rejected within its exposure.

        For a beacon the source of the innovation is ``light.<id>``.
        """
        if source != "lights":
            return super().rejected_part_message(source, time_ns, name, rejection)
        return self.rejection_message(f"light.{name}", time_ns, rejection)

    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        """Return budget and errors of the latest pointing, advice for the drones, and the calibration."""
        factory, estimate, published = self.factory, self.pending_budget, []
        if estimate is not None:
            sources = self.core.filter.model.sources
            published += [
                ("theodolite/error_budget", pointing_budget(factory, estimate, sources)),
                ("theodolite/error_arcsec", error_arcsec(factory, estimate)),
            ]
            horizon, advisor = self.config.frames.horizon, self.core.escort
            advice = None if advisor is None else advisor.advice(estimate)
            if advice is not None:
                published.append((ESCORT_TOPIC, escort_message(factory, advice, estimate.time_ns, horizon)))
        calibration = calibration_message(factory, self._calibration(), now_ns)
        return [*published, ("theodolite/calibration", calibration)]

    def no_output(self, now_ns: int, text: str) -> PointingEstimate:
        """See :class:`ship_node.adapters.node_adapter.NodeAdapter`."""
        return invalid_pointing(self.core.filter, self.core.state, now_ns, text)

    @property
    def source_timeouts_s(self) -> Mapping[str, float]:
        """See :class:`RecoveringAdapter`; beacons count as present for as long as they determine the mode."""
        return {ENCODER: _STREAM_TIMEOUT_S, SHIP: _STREAM_TIMEOUT_S, BEACON_PREFIX: self.config.lights_recent_s}

    def sources_of_decision(self, decision: ExposureDecision) -> Iterable[str]:
        """See :class:`RecoveringAdapter`; beacons whose data are incomplete do not count."""
        exposure = decision.measurement
        if not isinstance(exposure, Exposure):
            return ()
        lacking = {name for name, rejection in decision.rejected_parts if rejection.reason not in PRESENCE_REASONS}
        return [BEACON_PREFIX + light.beacon_id for light in exposure.beacons if light.beacon_id not in lacking]

    def can_be_valid(self, present_sources: Set[str]) -> bool:
        """See :class:`RecoveringAdapter`; a new estimator needs encoders, ship's attitude and two beacons."""
        lights = sum(source.startswith(BEACON_PREFIX) for source in present_sources)
        return {ENCODER, SHIP} <= present_sources and lights >= _MIN_BEACONS

    def remedy(self, displaced: Mapping[str, float]) -> str:
        """See :class:`RecoveringAdapter`."""
        if TOGETHER in displaced:
            return (
                "if the ship's antenna, the telescope or an encoder was remounted, set its new lever, telescope or "
                "axes and call ~/reset; otherwise check the encoders' cables, the RTK base and ship/attitude"
            )
        drones = ", ".join(f"beacons.{source.removeprefix(BEACON_PREFIX)}.light" for source in sorted(displaced))
        return f"if an antenna or light was remounted, set {drones} and call ~/reset; otherwise check the RTK receiver"

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return the status of pointing, calibration, integrity, conflicts, innovations, recovery and clocks."""
        return [
            pointing_status(self.latest, self.clock_jumps),
            calibration_status(self._calibration(), self.saved_document_remarks()),
            *self.integrity_statuses(),
            *self.conflict_statuses(),
            *self.innovation_report.statuses(),
            recovery_status(self.recovery, self.core.excluded_sources, self.remedy, waiting_ns),
            clock_status(self.core.filter.model, self.core.state.mean, {"ship": "ins"}),
        ]


def calibration_message(factory: MessageFactory, values: Calibration, now_ns: int) -> Any:
    """Return ship_msgs/TheodoliteCalibration with the stamp of the last sighting, or ``now_ns`` without sightings."""
    return factory.encode(
        "ship_msgs/msg/TheodoliteCalibration",
        header={"stamp": values.time_ns or now_ns, "frame_id": BASE_FRAME},
        names=list(values.names),
        values=values.values,
        covariance=values.covariance.ravel(),
        units=list(values.units),
        unobservable=list(values.unobservable),
        sighting_count=values.sighting_count,
        residual_rms=values.residual_rms,
    )


def pointing_status(estimate: PointingEstimate | None, clock_jumps: int) -> DiagnosticStatus:
    """Return the status of the latest pointing."""
    values = {"clock jumps back": str(clock_jumps)}
    if estimate is None:
        return DiagnosticStatus("pointing", Level.WARN, "no reading of the encoders yet", values)
    text = f"{estimate.status.name}: {estimate.text or f'by {_MODE_TEXTS[estimate.mode]}'}"
    if estimate.status is not Status.INVALID:
        axis_n = estimate.rotation_nm[:, 0]
        across = np.trace(estimate.covariance_n) - axis_n @ estimate.covariance_n @ axis_n
        values |= {
            "mode": estimate.mode.name,
            "lights": str(estimate.light_count),
            "sigma of the axis (arcsec)": f"{np.sqrt(across) / ARCSEC:.2f}",
        }
    return DiagnosticStatus("pointing", _LEVELS[estimate.status], text, values)


def calibration_status(calibration: Calibration, messages: list[str]) -> DiagnosticStatus:
    """Return the status of the calibration, with remarks about a saved calibration and unobservable combinations."""
    values = {"sightings": str(calibration.sighting_count)}
    if calibration.sighting_count:
        values["residual RMS (arcsec)"] = f"{calibration.residual_rms / ARCSEC:.2f}"
        values["unobservable combinations"] = "; ".join(calibration.unobservable) or "nothing"
    level = Level.WARN if messages else Level.OK
    return DiagnosticStatus("calibration", level, "; ".join(messages) or "as configured, loaded or estimated", values)

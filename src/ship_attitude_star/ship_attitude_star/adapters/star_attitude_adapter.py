"""Adapter of the node ``star_attitude``: input topics, output messages and diagnostics."""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.core import StarCore
from ship_attitude_star.star_attitude.exposure_solver import AttitudeSolution, RejectedStar, StarOutcome
from ship_bags.message_factory import MessageFactory
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.frames import angle_covariance, angles_from_rotation, enu_covariance
from ship_geometry.rotations import ARCSEC
from ship_node.adapters.adapter import BlockFeed, Feed, ignore_time
from ship_node.adapters.node_adapter import OWN_OUTPUTS, NodeAdapter
from ship_node.health.duplicate_publishers import ATTITUDE
from ship_node.messages.common_messages import (
    BUDGET_TYPE,
    INNOVATION_TYPE,
    DiagnosticStatus,
    Level,
    error_budget_message,
    rejection_message,
)
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.inputs_outputs import InputTopic, OutputMessage, OutputTopic
from ship_node.messages.sensor_readers import ins_block, ins_sample
from ship_node.saved_files.saved_document import DISK, Files
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.solution import SOLUTION_TERMS, SolutionStatus
from ship_stars.camera.config import JOINT
from ship_stars.messages.star_messages import ExposingSensor, star_exposure
from ship_stars.messages.surroundings_messages import surroundings_feeds
from ship_stars.sky.catalogue import StarCatalogue
from ship_stars.sky.sky_model import load_sky_model

_STARS_TYPE = "ship_msgs/msg/StarObservationArray"
_SOLUTION_TYPE = "ship_msgs/msg/StarHorizonAttitude"
_WHOLE_EXPOSURE_REASONS = (Reason.NO_FIX, Reason.NO_EARTH_ORIENTATION, Reason.FAILED, Reason.CONFLICT)
"""Reasons for which an exposure counts as rejected in the input health; for other reasons it counts as used."""

_STATUS_TEXTS = {
    SolutionStatus.VALID: (Level.OK, "VALID"),
    SolutionStatus.UNVERIFIED: (Level.WARN, "UNVERIFIED: too few stars to detect a misidentified one"),
    SolutionStatus.ANGLES_SINGULAR: (Level.OK, "ANGLES_SINGULAR: azimuth and roll are undefined near the zenith"),
    SolutionStatus.INVALID: (Level.WARN, "INVALID"),
}


SOLUTION_TIMEOUT_NS = 10_000_000_000
"""Timeout of a solution in the diagnostics, ns."""


@dataclass(frozen=True)
class ReadExposure:
    """Result of reading an observation message.

    Attributes:
        time_ns: stamp of the exposure.
        exposure: the usable stars.
        rejected_stars: the rejected stars of the message.
    """

    time_ns: int
    exposure: StarExposure
    rejected_stars: tuple[RejectedStar, ...]


class StarAttitudeAdapter(NodeAdapter):
    """Adapter of the estimator of attitudes from stars alone.

    Args:
        config: parameters of the node.
        factory: creates messages.
        files: not used.

    Raises:
        ParameterError: the camera of a sensor is incomplete.
    """

    node_name: ClassVar[str] = "star_attitude"
    config_type: ClassVar[type] = StarAttitudeConfig
    services: ClassVar[tuple[str, ...]] = ("reset",)
    main_topic: ClassVar[str] = f"star/{JOINT}/solution"
    innovation_topic: ClassVar[str] = "star/innovation"
    reset_text: ClassVar[str] = "all inputs are discarded"
    has_idle_ticks: ClassVar[bool] = False

    def __init__(self, config: StarAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self._sky_model = load_sky_model(config.sky)
        self._cameras = {
            id_: sensor.camera.camera(f"star_sensors.{id_}.camera") for id_, sensor in config.star_sensors.items()
        }
        self.outputs = (
            *(OutputTopic(f"star/{id_}/solution", _SOLUTION_TYPE) for id_ in (*config.star_sensors, JOINT)),
            OutputTopic(f"star/{JOINT}/error_budget", BUDGET_TYPE),
            OutputTopic(self.innovation_topic, INNOVATION_TYPE),
            *OWN_OUTPUTS,
        )
        if not config.star_sensors:
            self.start_warnings = ("no star_sensors are configured: no attitude will be published",)
        self._last_solutions: dict[str, tuple[AttitudeSolution, int]] = {}
        super().__init__(config, StarCore(config, self._sky_model), factory)

    def table(self, config: StarAttitudeConfig, core: StarCore) -> Iterator[Feed]:
        """Yield the inputs and the methods of a core that process them."""

        def process_stars(read: ReadExposure, waiting_ns: int) -> StarOutcome:
            return core.add_exposure(read.exposure, read.rejected_stars, waiting_ns)

        for id_, sensor in config.star_sensors.items():
            topic = InputTopic(f"star/{id_}/observations", _STARS_TYPE, False, depth=100, is_configured=True)
            exposing = ExposingSensor(id_, sensor.frame_id, self._cameras[id_], sensor.camera, sensor.sensor_masks)
            read_stars = functools.partial(read_exposure, sensor=exposing, catalogue=self._sky_model.catalogue)
            yield Feed(topic, f"star.{id_}", read_stars, process_stars, has_decision=True)
        yield from surroundings_feeds(
            config.sky, ignore_time(lambda reading: StarOutcome(core.add_surroundings(reading)))
        )
        if config.use_ins:
            ins = InputTopic("ins/imu", "sensor_msgs/msg/Imu", False, depth=1000)
            read_ins = functools.partial(ins_sample, config=config.ins)
            block = BlockFeed(functools.partial(ins_block, config=config.ins), core)
            yield Feed(ins, "ins", read_ins, ignore_time(core.add_ins), block=block, stream_quantity=ATTITUDE)

    # -- results of the core --------------------------------------------------------------------------------

    def report_outcome(self, outcome: StarOutcome, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Return the messages of solutions, of rejected stars, and of exposures too late for a joint solution."""
        published: list[OutputMessage] = []
        for solved in outcome.solved:
            self._last_solutions[solved.sensor_id] = solved, waiting_ns
            published += (
                self._joint_messages(solved) if solved.sensor_id == JOINT else self._single_messages(solved, now_ns)
            )
        for source, time_ns in outcome.not_joined:
            text = "too late for the joint solution of this time; the solution of this sensor alone is published"
            self.health.record_note(_topic(source), Reason.LATE)
            published.append(self.rejection_message(source, time_ns, Rejection(Reason.LATE, text)))
        return published

    def _single_messages(self, solved: AttitudeSolution, now_ns: int) -> list[OutputMessage]:
        """Return the messages of a sensor's solution; count the exposure as used or rejected in the input health."""
        id_, rejection = solved.sensor_id, solved.solution.rejection
        source, topic = f"star.{id_}", _topic(f"star.{id_}")
        if rejection is not None and rejection.reason in _WHOLE_EXPOSURE_REASONS:
            self.health.record_rejected(topic, rejection, now_ns, solved.time_ns)
        else:
            self.health.record_accepted(topic, solved.time_ns, now_ns)
            for star in solved.rejected_stars:
                self.health.record_note(topic, star.rejection.reason)
            if rejection is not None:
                self.health.record_note(topic, rejection.reason)
        published = self._solution_messages(solved, self.config.star_sensors[id_].frame_id or f"star_{id_}")
        if rejection is not None:
            published.append(self.rejection_message(source, solved.time_ns, rejection))
        return published

    def _joint_messages(self, solved: AttitudeSolution) -> list[OutputMessage]:
        self.pending_budget = solved if solved.is_valid else None
        for star in solved.rejected_stars:
            self.health.record_note(_topic(star.source), star.rejection.reason)
        published, rejection = self._solution_messages(solved, self.config.frames.deck), solved.solution.rejection
        if rejection is not None and rejection.reason is Reason.FAILED:
            self.health.record_failure(f"{self.main_topic}: {rejection.text}")
        if rejection is not None and rejection.reason not in (Reason.NO_FIX, Reason.NO_EARTH_ORIENTATION):
            published.append(self.rejection_message(f"star.{JOINT}", solved.time_ns, rejection))
        return published

    def _solution_messages(self, solved: AttitudeSolution, frame_id: str) -> list[OutputMessage]:
        message = star_horizon_attitude(self.factory, solved, frame_id)
        rejected = map(functools.partial(rejected_star_message, self.factory), solved.rejected_stars)
        return [(f"star/{solved.sensor_id}/solution", message), *((self.innovation_topic, star) for star in rejected)]

    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        """Return the error budget of the latest joint solution, once."""
        if self.pending_budget is None:
            return []
        return [
            (f"star/{JOINT}/error_budget", solution_budget(self.factory, self.pending_budget, self.config.frames.deck))
        ]

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return diagnostics of the solutions and of the sky model."""
        return [
            *solution_statuses(self.config, self._last_solutions, self.core.joined_by_ins, waiting_ns),
            sky_status(self.core.unmeasured_quantities(), self.clock_jumps),
        ]

    def restart(self, clock_jumped: bool) -> None:
        """See :class:`NodeAdapter`."""
        super().restart(clock_jumped)
        self._last_solutions.clear()


def read_exposure(
    message: Any, receive_ns: int, sensor: ExposingSensor, catalogue: StarCatalogue
) -> ReadMessage[ReadExposure]:
    """Read an observation message; its rejected stars are published with the solution.

    Args:
        message: StarObservationArray.
        receive_ns: arrival time.
        sensor: sensor of the topic.
        catalogue: star catalogue for the numbers.

    Raises:
        MessageRejected: the whole message cannot be used.
    """
    read = star_exposure(message, receive_ns, sensor, catalogue, named_by_number=True)
    source, time_ns, rejected_stars = read.value.source, read.value.time_ns, []
    for name, rejection in read.rejected_parts:
        rejected_stars.append(RejectedStar(source, time_ns, name, rejection))
    return ReadMessage(ReadExposure(time_ns, read.value, tuple(rejected_stars)), read.covariance_known)


def _topic(source: str) -> str:
    return f"star/{source.partition('.')[2]}/observations"


def star_horizon_attitude(factory: MessageFactory, solved: AttitudeSolution, frame_id: str) -> Any:
    """Return ship_msgs/StarHorizonAttitude of a solution; angles and covariances are NaN without an attitude."""
    solution, covariance_n = solved.solution, solved.solution.covariance_n
    azimuth, elevation, roll = angles_from_rotation(solution.rotation_nb).tolist()
    return factory.make(
        "ship_msgs/msg/StarHorizonAttitude",
        header={"stamp": solved.time_ns, "frame_id": frame_id},
        sensor_id=solved.sensor_id,
        azimuth=azimuth,
        elevation=elevation,
        roll=roll,
        covariance=angle_covariance(covariance_n, azimuth, elevation).ravel(),
        rotation_covariance=enu_covariance(covariance_n).ravel(),
        noise_covariance=enu_covariance(solution.noise_n).ravel(),
        star_count=solution.star_count,
        rejected_count=len(solved.rejected_stars),
        residual_rms=solution.residual_rms,
        status=int(solution.status),
    )


def solution_budget(factory: MessageFactory, solved: AttitudeSolution, deck: str) -> Any:
    """Return ship_msgs/ErrorBudget of a joint solution."""
    parts_n, covariance_n = solved.solution.covariance_by_source_n, solved.solution.covariance_n
    terms = SOLUTION_TERMS[: len(parts_n)]
    return error_budget_message(factory, f"star_{JOINT}", solved.time_ns, deck, terms, parts_n, covariance_n)


def rejected_star_message(factory: MessageFactory, star: RejectedStar) -> Any:
    """Return ship_msgs/Innovation of a rejected star, with its residual if it was compared."""
    rejection = Rejection(star.rejection.reason, f"{star.name}: {star.rejection.text}")
    if not star.residual:
        return rejection_message(factory, star.source, star.time_ns, rejection)
    residual = np.array(star.residual)
    nis = float(residual @ residual / star.sigma**2)
    sigma = np.full(len(residual), star.sigma)
    return rejection_message(factory, star.source, star.time_ns, rejection, ("up", "right"), residual, sigma, nis)


def solution_statuses(
    config: StarAttitudeConfig, latest: Mapping[str, tuple[AttitudeSolution, int]], joined_by_ins: bool, waiting_ns: int
) -> list[DiagnosticStatus]:
    """Return diagnostics of the last solution of each sensor, and of the last joint solution.

    Args:
        config: parameters of the node.
        latest: last solution by id, each with its publication time by the timeout clock.
        joined_by_ins: True if ``ins/imu`` was available for the last joint solution.
        waiting_ns: current time by the timeout clock.
    """
    how = ""
    if len(config.star_sensors) > 1 and not joined_by_ins:
        how = f"; without ins/imu only exposures within {1e3 * config.joint.simultaneous_s:g} ms are joined"
    ids = (*config.star_sensors, JOINT)
    return [_solution_status(id_, latest.get(id_), how if id_ == JOINT else "", waiting_ns) for id_ in ids]


def sky_status(not_measured: Sequence[str], clock_jumps: int) -> DiagnosticStatus:
    """Return the diagnostic of the sky model.

    Args:
        not_measured: air quantities taken from parameters.
        clock_jumps: number of backward jumps of the clock.
    """
    text = "refraction with measured weather"
    if not_measured:
        text = f"no weather: {', '.join(not_measured)} from parameters, with larger sigma"
    return DiagnosticStatus("sky", Level.OK, text, {"clock jumps back": str(clock_jumps)})


def _solution_status(
    id_: str, last: tuple[AttitudeSolution, int] | None, how: str, waiting_ns: int
) -> DiagnosticStatus:
    name = f"solution {id_}"
    if last is None:
        return DiagnosticStatus(name, Level.OK, f"no solution yet{how}")
    solved, published_ns = last
    if waiting_ns - published_ns > SOLUTION_TIMEOUT_NS:
        age_s = (waiting_ns - published_ns) * 1e-9
        text = f"no solution for {age_s:.0f} s, last status {solved.solution.status.name}{how}"
        return DiagnosticStatus(name, Level.WARN, text)
    level, text = _STATUS_TEXTS[solved.solution.status]
    if solved.solution.rejection is not None:
        text += f": {solved.solution.rejection.text}"
    if solved.text:
        level, text = Level.WARN, f"{text}; {solved.text}"
    values = {
        "stars used": str(solved.solution.star_count),
        "stars rejected": str(len(solved.rejected_stars)),
        "sensors": ", ".join(solved.sources),
        'residual rms (")': f"{solved.solution.residual_rms / ARCSEC:.2f}",
    }
    return DiagnosticStatus(name, level, text + how, values)

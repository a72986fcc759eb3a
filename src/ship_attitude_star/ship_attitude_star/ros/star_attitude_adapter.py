"""Which topic feeds which method of the star-attitude core, and which result goes to which topic."""

from collections.abc import Mapping
from typing import Any, ClassVar

from ship_attitude_star.ros import messages_in, messages_out, star_messages_in
from ship_attitude_star.ros.star_diagnosis import sky_status, solution_statuses
from ship_attitude_star.sky.sky_watch import installed_sky
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.core import StarCore
from ship_attitude_star.star_attitude.exposure_solver import RefusedStar, Solved, StarOutcome
from ship_attitude_star.stars.config import JOINT
from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.parameters import changed
from ship_estimation.refusals import Reason, Refusal
from ship_node.documents.saved_document import DISK, Files
from ship_node.edge.adapter import ServiceResult
from ship_node.edge.input_health import InputHealthBook
from ship_node.edge.messages_in import Refused, ins_sample
from ship_node.edge.messages_out import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, diagnostic_array, refusal_message
from ship_node.edge.topics import InputTopic, OutputTopic, Published

_INS_TOPIC = "ins/imu"
_STARS_TYPE = "ship_msgs/msg/StarObservationArray"
_SOLUTION = "ship_msgs/msg/StarHorizonAttitude"
_NOT_LOOKED_AT = (Reason.NO_FIX, Reason.NO_EARTH_ORIENTATION, Reason.FAILED)
"""Why an exposure is refused as a whole."""
_SECOND_NS = 1_000_000_000


class StarAttitudeAdapter:
    """Attitudes from the stars that star sensors see: of each sensor, and of the deck by all of them.

    Args:
        config: the node's parameters.
        factory: makes the messages.
        files: none is used.
    """

    node_name: ClassVar[str] = "star_attitude"
    config_type: ClassVar[type] = StarAttitudeConfig
    services: ClassVar[tuple[str, ...]] = ("reset",)

    def __init__(self, config: StarAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self._config = config
        self._factory = factory
        self._watch = installed_sky(config.sky)
        self.core = StarCore(config, self._watch)
        self._cameras = {
            id_: sensor.camera.camera(f"star_sensors.{id_}.camera") for id_, sensor in config.star_sensors.items()
        }
        self._sensors = {f"star/{id_}/observations": id_ for id_ in config.star_sensors}
        self.inputs: tuple[InputTopic, ...] = (
            *(InputTopic(topic, _STARS_TYPE, False, depth=100, named=True) for topic in self._sensors),
            *messages_in.TOPICS,
            *([InputTopic(_INS_TOPIC, "sensor_msgs/msg/Imu", False, depth=1000)] if config.use_ins else []),
        )
        self.outputs: tuple[OutputTopic, ...] = (
            *(OutputTopic(f"star/{id_}/solution", _SOLUTION) for id_ in (*config.star_sensors, JOINT)),
            OutputTopic(f"star/{JOINT}/error_budget", "ship_msgs/msg/ErrorBudget"),
            OutputTopic("star/innovation", "ship_msgs/msg/Innovation"),
            OutputTopic("input_health", "ship_msgs/msg/InputHealth"),
            OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
        )
        self.health = InputHealthBook(self.inputs, config.max_age_s)
        self.start_warnings: tuple[str, ...] = ()
        self.notices: list[str] = []
        if not config.star_sensors:
            self.start_warnings = ("no star_sensors are configured: there is nothing to solve",)
        self._latest: dict[str, tuple[Solved, int]] = {}
        self._waiting_ns = 0
        self._budget_due: Solved | None = None
        self._slow_due_ns: int | None = None
        self._clock_jumps = 0

    def handle(self, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Take one message of an input topic."""
        self._waiting_ns = waiting_ns = receive_ns if waiting_ns is None else waiting_ns
        self.health.arrived(topic, waiting_ns)
        try:
            if topic in self._sensors:
                return self._exposure(topic, message, receive_ns, waiting_ns)
            if topic == _INS_TOPIC:
                return self._ins(message, receive_ns)
            return self._surroundings(topic, message, receive_ns)
        except Refused as refused:
            reason = refused.refusal.reason
            time_ns = receive_ns if reason is Reason.BAD_STAMP else ns_from_stamp(message.header.stamp)
            return self._refusal(topic, time_ns, reason, refused.refusal.text, receive_ns)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Solve what has waited long enough; once a period, the slow topics."""
        self._waiting_ns = waiting_ns = now_ns if waiting_ns is None else waiting_ns
        published = self._published(self.core.tick(waiting_ns), now_ns)
        if self._slow_due_ns is None or waiting_ns >= self._slow_due_ns:
            self._slow_due_ns = waiting_ns + round(self._config.slow_topics_period_s * _SECOND_NS)
            published += self._slow_topics(now_ns, waiting_ns)
        return published

    def clock_jumped_back(self, now_ns: int) -> list[Published]:
        """Start anew at the earlier time."""
        self._clock_jumps += 1
        self._restart()
        return []

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Reset: all inputs are forgotten."""
        self._restart()
        return ServiceResult(True, "all inputs are forgotten")

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Take live parameters, dotted name → value.

        Raises:
            ParameterError: nothing was changed; the text says why.
        """
        self._config = changed(self._config, changes)
        self.core.reconfigure(self._config)

    # -- inputs ---------------------------------------------------------------------------------------------

    def _exposure(self, topic: str, message: Any, receive_ns: int, waiting_ns: int) -> list[Published]:
        id_ = self._sensors[topic]
        sensor = self._config.star_sensors[id_]
        exposure, refused = star_messages_in.star_exposure(
            message, id_, sensor.frame_id, self._cameras[id_], sensor.camera, self._watch.catalogue, receive_ns
        )
        if not star_messages_in.sigmas_given(message):
            self.health.noted(topic, Reason.COVARIANCE_UNKNOWN)
        stars = tuple(
            RefusedStar(exposure.source, exposure.time_ns, _name(message.stars[row], row), refusal)
            for row, refusal in refused
        )
        return self._taken(topic, exposure.time_ns, self.core.add_exposure(exposure, stars, waiting_ns), receive_ns)

    def _ins(self, message: Any, receive_ns: int) -> list[Published]:
        sample = ins_sample(message, self._config.ins, receive_ns).value
        outcome = self.core.add_ins(sample)
        if outcome.refusal is None:
            self.health.accepted(_INS_TOPIC, sample.time_ns, receive_ns)
        return self._taken(_INS_TOPIC, sample.time_ns, outcome, receive_ns)

    def _surroundings(self, topic: str, message: Any, receive_ns: int) -> list[Published]:
        given = messages_in.sky_input(topic, message, self._config.sky, receive_ns)
        if not given.sigma_known:
            self.health.noted(topic, Reason.COVARIANCE_UNKNOWN)
        refusal = self.core.add_surroundings(given)
        if refusal is None:
            self.health.accepted(topic, given.time_ns, receive_ns)
        return self._taken(topic, given.time_ns, StarOutcome(refusal), receive_ns)

    def _taken(self, topic: str, time_ns: int, outcome: StarOutcome, receive_ns: int) -> list[Published]:
        published = []
        if outcome.refusal is not None:
            published = self._refusal(topic, time_ns, outcome.refusal.reason, outcome.refusal.text, receive_ns)
        return published + self._published(outcome, receive_ns)

    def _restart(self) -> None:
        self.core.reset()
        self.health.restart()
        self._latest.clear()
        self._budget_due, self._slow_due_ns = None, None

    # -- outputs --------------------------------------------------------------------------------------------

    def _refusal(self, topic: str, time_ns: int, reason: Reason, text: str, now_ns: int) -> list[Published]:
        self.health.rejected(topic, Refusal(reason, text), now_ns, time_ns)
        sources = {_INS_TOPIC: "ins", **{name: f"star.{id_}" for name, id_ in self._sensors.items()}}
        return [self._told(sources.get(topic, topic), time_ns, reason, text)]

    def _told(self, source: str, time_ns: int, reason: Reason, text: str) -> Published:
        return "star/innovation", refusal_message(self._factory, source, time_ns, reason, text)

    def _published(self, outcome: StarOutcome, now_ns: int) -> list[Published]:
        published: list[Published] = []
        for solved in outcome.solved:
            self._latest[solved.sensor_id] = solved, self._waiting_ns
            published += self._joint(solved) if solved.sensor_id == JOINT else self._single(solved, now_ns)
        for source, time_ns in outcome.not_joined:
            text = "too late for the joint solution of its time; that of its sensor is published"
            self.health.noted(_topic(source), Reason.LATE)
            published.append(self._told(source, time_ns, Reason.LATE, text))
        return published

    def _single(self, solved: Solved, now_ns: int) -> list[Published]:
        id_, refusal = solved.sensor_id, solved.solution.refusal
        topic, frame_id = f"star/{id_}/observations", self._config.star_sensors[id_].frame_id or f"star_{id_}"
        published = self._solution(solved, frame_id)
        if refusal is not None and refusal.reason in _NOT_LOOKED_AT:
            return published + self._refusal(topic, solved.time_ns, refusal.reason, refusal.text, now_ns)
        self.health.accepted(topic, solved.time_ns, now_ns)
        for reason in [star.refusal.reason for star in solved.refused] + ([] if refusal is None else [refusal.reason]):
            self.health.noted(topic, reason)
        return published

    def _joint(self, solved: Solved) -> list[Published]:
        self._budget_due = solved if solved.valid else None
        for star in solved.refused:
            self.health.noted(_topic(star.source), star.refusal.reason)
        published, refusal = self._solution(solved, messages_out.DECK_FRAME), solved.solution.refusal
        if refusal is not None and refusal.reason is Reason.FAILED:
            self.health.failed(f"star/{JOINT}/solution: {refusal.text}")
            published.append(self._told(f"star.{JOINT}", solved.time_ns, refusal.reason, refusal.text))
        return published

    def _solution(self, solved: Solved, frame_id: str) -> list[Published]:
        message = messages_out.star_horizon_attitude(self._factory, solved, frame_id)
        published: list[Published] = [(f"star/{solved.sensor_id}/solution", message)]
        published += [
            ("star/innovation", messages_out.refused_star(self._factory, star)) for star in solved.refused
        ]
        refusal = solved.solution.refusal
        if refusal is not None and refusal.reason not in _NOT_LOOKED_AT:
            published.append(self._told(f"star.{solved.sensor_id}", solved.time_ns, refusal.reason, refusal.text))
        return published

    def _slow_topics(self, now_ns: int, waiting_ns: int) -> list[Published]:
        factory = self._factory
        published: list[Published] = []
        if self._budget_due is not None:
            published.append((f"star/{JOINT}/error_budget", messages_out.star_error_budget(factory, self._budget_due)))
            self._budget_due = None
        published += [("input_health", message) for message in self.health.messages(factory, now_ns, waiting_ns)]
        statuses = [
            *self.health.statuses(now_ns, waiting_ns),
            *solution_statuses(self._config, self._latest, self.core.joined_by_ins, waiting_ns),
            sky_status(self.core.not_measured(), self._clock_jumps),
        ]
        published.append((DIAGNOSTICS_TOPIC, diagnostic_array(factory, now_ns, self.node_name, statuses)))
        return published


def _topic(source: str) -> str:
    return f"star/{source.partition('.')[2]}/observations"


def _name(star: Any, row: int) -> str:
    """A star of a message for people."""
    return f"HIP {star.catalogue_id}" if star.catalogue_id else f"star {row + 1} of the message"

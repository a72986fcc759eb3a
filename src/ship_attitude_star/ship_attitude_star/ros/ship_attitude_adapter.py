"""Which topic feeds which method of the ship-attitude core, and which result goes to which topic."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeEstimate, AttitudeOutcome
from ship_attitude_star.ros import alignment_file, messages_out
from ship_attitude_star.ros.ship_diagnosis import attitude_status, conflict_statuses, rates_status, start_warnings
from ship_attitude_star.ros.ship_inputs import ShipInputs
from ship_attitude_star.ship_attitude.alignment import AlignmentPrior
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.sky.sky_watch import installed_sky
from ship_bags.errors import BadInput
from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.outcome import Status
from ship_estimation.parameters import changed
from ship_estimation.refusals import Reason, Refusal, failure
from ship_node.documents.saved_document import DISK, Files, age_words
from ship_node.edge.adapter import ServiceResult
from ship_node.edge.input_health import InputHealthBook
from ship_node.edge.messages_in import Refused
from ship_node.edge.messages_out import (
    DIAGNOSTICS_TOPIC,
    DIAGNOSTICS_TYPE,
    DiagnosticStatus,
    Level,
    diagnostic_array,
    refusal_message,
)
from ship_node.edge.topics import InputTopic, OutputTopic, Published

_ATTITUDE, _SLOW_TOPICS = "ship/attitude", "slow topics"
_OUTPUTS = (
    OutputTopic(_ATTITUDE, "ship_msgs/msg/ShipAttitude"),
    OutputTopic("ship/imu", "sensor_msgs/msg/Imu"),
    OutputTopic("ship/alignment", "ship_msgs/msg/AlignmentState"),
    OutputTopic("ship/error_budget", "ship_msgs/msg/ErrorBudget"),
    OutputTopic("ship/innovation", "ship_msgs/msg/Innovation"),
    OutputTopic("ship/error_arcsec", "ship_msgs/msg/AttitudeErrorArcsec"),
    OutputTopic("input_health", "ship_msgs/msg/InputHealth"),
    OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
)
_SECOND_NS = 1_000_000_000


class ShipAttitudeAdapter:
    """The ship's attitude from the INS and star sensors, with its covariance and error budget.

    Args:
        config: the node's parameters.
        factory: makes the messages.
        files: where the saved alignment is read and written.

    Raises:
        BadInput: the alignment file cannot be read.
    """

    node_name: ClassVar[str] = "ship_attitude"
    config_type: ClassVar[type] = ShipAttitudeConfig
    services: ClassVar[tuple[str, ...]] = ("reset", "save_alignment", "load_alignment")
    outputs: tuple[OutputTopic, ...] = _OUTPUTS

    def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self._config = config
        self._files = files
        self._factory = factory
        looks_at_sky = any(star.looks_at_sky for star in config.star_sensors.values())
        watch = installed_sky(config.sky) if looks_at_sky else None
        self.core = ShipAttitudeCore(config, watch)
        self._inputs = ShipInputs(config, self.core, watch)
        self._topics = {source: topic for topic, source in self._inputs.sources.items()}
        self.inputs: tuple[InputTopic, ...] = self._inputs.topics
        self.health = InputHealthBook(self.inputs, config.max_age_s)
        self.start_warnings = start_warnings(config)
        self.notices: list[str] = []
        self._saved = self._read_alignment_at_start()
        if self._saved is None and config.alignment_file:
            self.notices.append(f"no alignment at {config.alignment_file} yet: the filter starts as configured")
        self._alignment_messages: list[str] = []
        self._latest: AttitudeEstimate | None = None
        self._budget_due: AttitudeEstimate | None = None
        self._conflicts: dict[str, AttitudeDecision] = {}
        self._slow_due_ns: int | None = None
        self._clock_jumps = 0

    def handle(self, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Take one message of an input topic."""
        waiting_ns = receive_ns if waiting_ns is None else waiting_ns
        self._start(receive_ns)
        self.health.arrived(topic, waiting_ns)
        try:
            taken = self._inputs.take(topic, message, receive_ns, waiting_ns)
        except Refused as refused:
            reason = refused.refusal.reason
            time_ns = receive_ns if reason is Reason.BAD_STAMP else ns_from_stamp(message.header.stamp)
            return self._refusal(topic, time_ns, reason, refused.refusal.text, receive_ns)
        if not taken.covariance_known:
            self.health.noted(topic, Reason.COVARIANCE_UNKNOWN)
        published = self._stars_refused(topic, taken.time_ns, taken.stars_refused)
        if taken.outcome.refusal is not None:
            refusal = taken.outcome.refusal
            published += self._refusal(topic, taken.time_ns, refusal.reason, refusal.text, receive_ns)
        elif not taken.judged:
            self.health.accepted(topic, taken.time_ns, receive_ns)
        return published + self._published(taken.outcome, receive_ns)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Say INVALID where no attitude was put out; once a period, the slow topics."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        self._start(now_ns)
        published = self._published(self.core.tick(now_ns, waiting_ns), now_ns)
        if self._slow_due_ns is None or waiting_ns >= self._slow_due_ns:
            period_ns = round(self._config.slow_topics_period_s * _SECOND_NS)
            self._slow_due_ns = waiting_ns + period_ns
            try:
                published += self._slow_topics(now_ns, waiting_ns)
            except Exception as error:
                # An INVALID of this very tick must go out nevertheless.
                published += self._failed(_SLOW_TOPICS, now_ns, failure(error))
        return published

    def clock_jumped_back(self, now_ns: int) -> list[Published]:
        """Start anew at the earlier time."""
        self._clock_jumps += 1
        self._restart(now_ns, clock_jumped=True)
        return []

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Reset, save or load the alignment."""
        actions: dict[str, Callable[[int], str]] = {
            "reset": self._reset,
            "save_alignment": self._save_alignment,
            "load_alignment": self._load_alignment,
        }
        try:
            return ServiceResult(True, actions[name](now_ns))
        except BadInput as error:
            return ServiceResult(False, str(error))

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Take live parameters, dotted name → value.

        Raises:
            ParameterError: nothing was changed; the text says why.
        """
        self._config = changed(self._config, changes)
        self.core.reconfigure(self._config)
        self._inputs.config = self._config

    # -- inputs ---------------------------------------------------------------------------------------------

    def _start(self, now_ns: int) -> None:
        """Take the alignment read at the start, as soon as there is a time to judge its age by."""
        if self._saved is not None:
            saved, self._saved = self._saved, None
            self._alignment_messages = self.core.start_from(saved, now_ns)
            self._note_start_from(saved, now_ns)

    def _note_start_from(self, saved: AlignmentPrior, now_ns: int) -> None:
        """Tell which alignment the filter starts from, and how old it is."""
        told = f"alignment {self._config.alignment_file}, {age_words(saved.time_ns, now_ns)}"
        self.notices.append("; ".join([told, *self._alignment_messages]))

    def _read_alignment_at_start(self) -> Any:
        if not self._config.alignment_file:
            return None
        return alignment_file.load_if_there(Path(self._config.alignment_file), self._files)

    # -- outputs --------------------------------------------------------------------------------------------

    def _refusal(self, topic: str, time_ns: int, reason: Reason, text: str, receive_ns: int) -> list[Published]:
        self.health.rejected(topic, Refusal(reason, text), receive_ns, time_ns)
        message = refusal_message(self._factory, self._source(topic), time_ns, reason, text)
        return [("ship/innovation", message)]

    def _stars_refused(
        self, topic: str, time_ns: int, stars_refused: tuple[tuple[str, Refusal], ...]
    ) -> list[Published]:
        """Stars that had no part in their exposure, each said and counted; the exposure may be used all the same."""
        published: list[Published] = []
        for name, refusal in stars_refused:
            self.health.noted(topic, refusal.reason)
            text = f"{name}: {refusal.text}"
            message = refusal_message(self._factory, self._source(topic), time_ns, refusal.reason, text)
            published.append(("ship/innovation", message))
        return published

    def _source(self, topic: str) -> str:
        return self._inputs.sources[topic]

    def _published(self, outcome: AttitudeOutcome, now_ns: int) -> list[Published]:
        published: list[Published] = []
        for decision in outcome.decisions:
            self._count(decision, now_ns)
            measurement = decision.measurement
            topic = self._topics[measurement.source]
            published += self._stars_refused(topic, measurement.time_ns, decision.left_out)
            published.append(("ship/innovation", messages_out.innovation(self._factory, decision)))
        for time_ns, refusal in outcome.failures:
            published += self._failed(_ATTITUDE, time_ns, refusal)
        for estimate in outcome.estimates:
            claimed = estimate.status is not Status.INVALID
            self._latest, self._budget_due = estimate, estimate if claimed else None
            published.append((_ATTITUDE, messages_out.ship_attitude(self._factory, estimate)))
            if claimed:
                published.append(("ship/imu", messages_out.ship_imu(self._factory, estimate)))
        return published

    def _failed(self, what: str, time_ns: int, refusal: Refusal) -> list[Published]:
        """An output that could not be made: told, and nothing else is touched by it."""
        self.health.failed(f"{what}: {refusal.text}")
        return [("ship/innovation", refusal_message(self._factory, what, time_ns, refusal.reason, refusal.text))]

    def _count(self, decision: AttitudeDecision, now_ns: int) -> None:
        source = decision.measurement.source
        topic, time_ns = self._topics[source], decision.measurement.time_ns
        if decision.revised:
            self.health.noted(topic, Reason.REVISED)
        elif decision.accepted:
            self.health.accepted(topic, time_ns, now_ns)
        else:
            self.health.rejected(topic, Refusal(decision.reason, decision.text), now_ns, time_ns)
        if decision.reason is Reason.ATTITUDE_CONFLICT:
            self._conflicts[source] = decision
        elif decision.accepted:
            self._conflicts.pop(source, None)

    def _slow_topics(self, now_ns: int, waiting_ns: int) -> list[Published]:
        factory, published = self._factory, []
        if self._budget_due is not None:
            sources = self.core.filter.model.sources
            published += [
                ("ship/error_budget", messages_out.error_budget(factory, self._budget_due, sources)),
                ("ship/error_arcsec", messages_out.error_arcsec(factory, self._budget_due)),
            ]
            self._budget_due = None  # no attitude has its budget told twice
        published.append(("ship/alignment", messages_out.alignment_state(factory, self.core.alignment(), now_ns)))
        published += [("input_health", message) for message in self.health.messages(factory, now_ns, waiting_ns)]
        statuses = [*self.health.statuses(now_ns, waiting_ns), *self._own_statuses()]
        published.append((DIAGNOSTICS_TOPIC, diagnostic_array(factory, now_ns, self.node_name, statuses)))
        return published

    def _own_statuses(self) -> list[DiagnosticStatus]:
        level = Level.WARN if self._alignment_messages else Level.OK
        text = "; ".join(self._alignment_messages) or "as configured or saved"
        return [
            attitude_status(self._latest, self._clock_jumps, self.start_warnings),
            DiagnosticStatus("alignment", level, text),
            rates_status(self.core.rates),
            *conflict_statuses(self._conflicts),
        ]

    # -- services -------------------------------------------------------------------------------------------

    def _restart(self, now_ns: int, clock_jumped: bool) -> None:
        self.core.reset(clock_jumped)
        self.health.restart()
        self._latest, self._budget_due, self._slow_due_ns = None, None, None
        self._conflicts.clear()

    def _reset(self, now_ns: int) -> str:
        self._restart(now_ns, clock_jumped=False)
        return "the filter starts anew"

    def _save_alignment(self, now_ns: int) -> str:
        path = self._alignment_path()
        prior = self.core.alignment_to_save()
        if prior is None:
            raise BadInput("no star attitude was used yet: there is no alignment to save")
        alignment_file.save(path, prior, self._files)
        return f"alignment saved to {path}"

    def _load_alignment(self, now_ns: int) -> str:
        path = self._alignment_path()
        saved = alignment_file.load(path, self._files)
        self._alignment_messages = self.core.start_from(saved, now_ns)
        self._note_start_from(saved, now_ns)
        self.health.restart()
        self._conflicts.clear()
        return "; ".join([f"alignment loaded from {path}", *self._alignment_messages])

    def _alignment_path(self) -> Path:
        if not self._config.alignment_file:
            raise BadInput("parameter 'alignment_file' is empty: set it to the path of the file to use")
        return Path(self._config.alignment_file)

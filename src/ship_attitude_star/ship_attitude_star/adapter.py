"""Which topic feeds which method of the ship-attitude core, and which result goes to which topic."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from ship_attitude_star import alignment_file, messages_in, messages_out
from ship_attitude_star.config import ShipAttitudeConfig
from ship_attitude_star.diagnosis import attitude_status, conflict_statuses
from ship_attitude_star.samples import AttitudeEstimate, Decision, Outcome, Reason, Status
from ship_attitude_star.ship_core import ShipAttitudeCore
from ship_estimation.parameters import changed
from ship_node.adapter import ServiceResult
from ship_node.diagnostics import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, Level, diagnostic_array
from ship_node.diagnostics import Status as DiagnosticStatus
from ship_node.errors import BadInput
from ship_node.files import DISK, Files
from ship_node.input_health import InputHealthBook
from ship_node.message_checks import Refused
from ship_node.message_factory import MessageFactory
from ship_node.stamps import ns_from_stamp
from ship_node.topics import InputTopic, OutputTopic, Published

_INS_TOPIC = "ins/imu"
_IMU = "sensor_msgs/msg/Imu"
_STAR = "ship_msgs/msg/StarHorizonAttitude"
_OUTPUTS = (
    OutputTopic("ship/attitude", "ship_msgs/msg/ShipAttitude"),
    OutputTopic("ship/imu", _IMU),
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
        self.core = ShipAttitudeCore(config)
        self._sources = _sources_by_topic(config)
        self._topics = {source: topic for topic, source in self._sources.items()}
        self.inputs: tuple[InputTopic, ...] = tuple(
            InputTopic(topic, _STAR if topic.startswith("star/") else _IMU, topic == _INS_TOPIC, depth=1000)
            for topic in self._sources
        )
        self.health = InputHealthBook(self.inputs)
        self._saved = self._read_alignment_at_start()
        self._alignment_messages: list[str] = []
        self._latest: AttitudeEstimate | None = None
        self._conflicts: dict[str, Decision] = {}
        self._slow_due_ns: int | None = None
        self._clock_jumps = 0

    def handle(self, topic: str, message: Any, receive_ns: int) -> list[Published]:
        """Take one message of an input topic."""
        self._start(receive_ns)
        self.health.arrived(topic, receive_ns)
        try:
            converted = self._convert(topic, message, receive_ns)
        except Refused as refused:
            reason = Reason[refused.reason.upper()]
            time_ns = receive_ns if reason is Reason.BAD_STAMP else ns_from_stamp(message.header.stamp)
            return self._refusal(topic, time_ns, reason, refused.text, receive_ns)
        if not converted.covariance_known:
            self.health.noted(topic, Reason.COVARIANCE_UNKNOWN.name.lower())
        is_ins = topic == _INS_TOPIC
        outcome = (self.core.add_ins if is_ins else self.core.add_measurement)(converted.value)
        published: list[Published] = []
        if outcome.refusal is not None:
            refusal = outcome.refusal
            published += self._refusal(topic, converted.value.time_ns, refusal.reason, refusal.text, receive_ns)
        elif is_ins:
            self.health.accepted(topic, converted.value.time_ns, receive_ns)
        return published + self._published(outcome, receive_ns)

    def tick(self, now_ns: int) -> list[Published]:
        """Say INVALID where nothing carries an attitude; once a period, the slow topics."""
        self._start(now_ns)
        published = self._published(self.core.tick(now_ns), now_ns)
        if self._slow_due_ns is None or now_ns >= self._slow_due_ns:
            period_ns = round(self._config.slow_topics_period_s * _SECOND_NS)
            self._slow_due_ns = now_ns + period_ns
            published += self._slow_topics(now_ns)
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

    # -- inputs ---------------------------------------------------------------------------------------------

    def _convert(self, topic: str, message: Any, receive_ns: int) -> messages_in.Converted:
        kind, _, id_ = self._sources[topic].partition(".")
        if kind == "star":
            return messages_in.star_measurement(message, id_, self._config.star_sensors[id_], receive_ns)
        if kind == "reference":
            return messages_in.reference_measurement(message, id_, self._config.references[id_], receive_ns)
        return messages_in.ins_sample(message, self._config.ins, receive_ns)

    def _start(self, now_ns: int) -> None:
        """Take the alignment read at the start, as soon as there is a time to judge its age by."""
        if self._saved is not None:
            saved, self._saved = self._saved, None
            self._alignment_messages = self.core.start_from(saved, now_ns)

    def _read_alignment_at_start(self) -> Any:
        if not self._config.alignment_file:
            return None
        return alignment_file.load_if_there(Path(self._config.alignment_file), self._files)

    # -- outputs --------------------------------------------------------------------------------------------

    def _refusal(self, topic: str, time_ns: int, reason: Reason, text: str, receive_ns: int) -> list[Published]:
        self.health.rejected(topic, reason.name.lower(), text, receive_ns, time_ns)
        return [
            ("ship/innovation", messages_out.refusal(self._factory, self._sources[topic], time_ns, reason, text))
        ]

    def _published(self, outcome: Outcome, now_ns: int) -> list[Published]:
        published: list[Published] = []
        for decision in outcome.decisions:
            self._count(decision, now_ns)
            published.append(("ship/innovation", messages_out.innovation(self._factory, decision)))
        for estimate in outcome.estimates:
            self._latest = estimate
            published.append(("ship/attitude", messages_out.ship_attitude(self._factory, estimate)))
            if estimate.status is not Status.INVALID:
                published.append(("ship/imu", messages_out.ship_imu(self._factory, estimate)))
        return published

    def _count(self, decision: Decision, now_ns: int) -> None:
        source = decision.measurement.source
        topic, time_ns = self._topics[source], decision.measurement.time_ns
        if decision.revised:
            self.health.noted(topic, Reason.REVISED.name.lower())
        elif decision.accepted:
            self.health.accepted(topic, time_ns, now_ns)
        else:
            self.health.rejected(topic, decision.reason.name.lower(), decision.text, now_ns, time_ns)
        if decision.reason is Reason.ATTITUDE_CONFLICT:
            self._conflicts[source] = decision
        elif decision.accepted:
            self._conflicts.pop(source, None)

    def _slow_topics(self, now_ns: int) -> list[Published]:
        factory, published = self._factory, []
        if self._latest is not None and self._latest.status is not Status.INVALID:
            sources = self.core.filter.model.sources
            published += [
                ("ship/error_budget", messages_out.error_budget(factory, self._latest, sources)),
                ("ship/error_arcsec", messages_out.error_arcsec(factory, self._latest)),
            ]
        published.append(("ship/alignment", messages_out.alignment_state(factory, self.core.alignment(), now_ns)))
        published += [("input_health", message) for message in self.health.messages(factory, now_ns)]
        statuses = [*self.health.statuses(now_ns), *self._own_statuses()]
        published.append((DIAGNOSTICS_TOPIC, diagnostic_array(factory, now_ns, self.node_name, statuses)))
        return published

    def _own_statuses(self) -> list[DiagnosticStatus]:
        level = Level.WARN if self._alignment_messages else Level.OK
        text = "; ".join(self._alignment_messages) or "as configured or saved"
        return [
            attitude_status(self._latest, self._clock_jumps),
            DiagnosticStatus("alignment", level, text),
            *conflict_statuses(self._conflicts),
        ]

    # -- services -------------------------------------------------------------------------------------------

    def _restart(self, now_ns: int, clock_jumped: bool) -> None:
        self.core.reset(clock_jumped)
        self.health.restart(now_ns)
        self._latest, self._slow_due_ns = None, None
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
        self._alignment_messages = self.core.start_from(alignment_file.load(path, self._files), now_ns)
        self.health.restart(now_ns)
        self._conflicts.clear()
        return "; ".join([f"alignment loaded from {path}", *self._alignment_messages])

    def _alignment_path(self) -> Path:
        if not self._config.alignment_file:
            raise BadInput("parameter 'alignment_file' is empty: set it to the path of the file to use")
        return Path(self._config.alignment_file)


def _sources_by_topic(config: ShipAttitudeConfig) -> dict[str, str]:
    """Input topic → source name; each star sensor feeds the filter by exactly one topic."""
    stars = {f"star/{id_}/{star.input}": f"star.{id_}" for id_, star in config.star_sensors.items()}
    references = {f"reference/{name}/imu": f"reference.{name}" for name in config.references}
    return {_INS_TOPIC: "ins", **stars, **references}

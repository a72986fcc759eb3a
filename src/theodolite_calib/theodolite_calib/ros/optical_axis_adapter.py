"""Which topic feeds which method of the optical-axis core, and which result goes to which topic."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

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
from ship_node.edge.messages_out import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, diagnostic_array, refusal_message
from ship_node.edge.topics import InputTopic, OutputTopic, Published
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.measured.samples import ExposureDecision, PointingEstimate, PointingOutcome
from theodolite_calib.optical_axis.calibration import CalibrationPrior
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.ros import calibration_file, messages_out
from theodolite_calib.ros.axis_inputs import BEACONS_TOPIC, AxisInputs
from theodolite_calib.ros.diagnosis import calibration_status, conflict_statuses, pointing_status

_INNOVATION = "theodolite/innovation"
_POINTING, _SLOW_TOPICS = "theodolite/pointing", "slow topics"
_OUTPUTS = (
    OutputTopic(_POINTING, "ship_msgs/msg/OpticalAxisPointing"),
    OutputTopic("theodolite/calibration", "ship_msgs/msg/TheodoliteCalibration", latched=True),
    OutputTopic("theodolite/error_budget", "ship_msgs/msg/ErrorBudget"),
    OutputTopic(_INNOVATION, "ship_msgs/msg/Innovation"),
    OutputTopic("theodolite/error_arcsec", "ship_msgs/msg/PointingErrorArcsec"),
    OutputTopic("input_health", "ship_msgs/msg/InputHealth"),
    OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
)
_SECOND_NS = 1_000_000_000


class OpticalAxisAdapter:
    """The theodolite's optical axis from lights on drones, encoders and the ship's attitude, with its error budget.

    Args:
        config: the node's parameters.
        factory: makes the messages.
        files: where the saved calibration is read and written.

    Raises:
        BadInput: the calibration file cannot be read.
    """

    node_name: ClassVar[str] = "optical_axis"
    config_type: ClassVar[type] = OpticalAxisConfig
    services: ClassVar[tuple[str, ...]] = ("reset", "save_alignment", "load_alignment")
    outputs: tuple[OutputTopic, ...] = _OUTPUTS

    def __init__(self, config: OpticalAxisConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self._config, self._factory, self._files = config, factory, files
        self.core = OpticalAxisCore(config)
        self._inputs = AxisInputs(config, self.core)
        self.inputs: tuple[InputTopic, ...] = self._inputs.topics
        self.health = InputHealthBook(self.inputs, config.max_age_s)
        self.start_warnings: tuple[str, ...] = ()
        self.notices: list[str] = []
        self._saved = self._read_calibration_at_start()
        if self._saved is None and config.calibration_file:
            self.notices.append(f"no calibration at {config.calibration_file} yet: the filter starts as configured")
        self._calibration_messages: list[str] = []
        self._latest: PointingEstimate | None = None
        self._budget_due: PointingEstimate | None = None
        self._conflict: ExposureDecision | None = None
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
            return self._refusal(topic, time_ns, refused.refusal, receive_ns)
        if not taken.covariance_known:
            self.health.noted(topic, Reason.COVARIANCE_UNKNOWN)
        published = self._lights_refused(taken.time_ns, taken.lights_refused)
        if taken.outcome.refusal is not None:
            published += self._refusal(topic, taken.time_ns, taken.outcome.refusal, receive_ns)
        elif not taken.judged:
            self.health.accepted(topic, taken.time_ns, receive_ns)
        return published + self._published(taken.outcome, receive_ns)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Say INVALID where no pointing was put out; once a period, the slow topics."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        self._start(now_ns)
        published = self._published(self.core.tick(now_ns, waiting_ns), now_ns)
        if self._slow_due_ns is None or waiting_ns >= self._slow_due_ns:
            self._slow_due_ns = waiting_ns + round(self._config.slow_topics_period_s * _SECOND_NS)
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
        """Reset, save or load the calibration."""
        actions: dict[str, Callable[[int], str]] = {
            "reset": self._reset,
            "save_alignment": self._save_calibration,
            "load_alignment": self._load_calibration,
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
        """Take the calibration read at the start, as soon as there is a time to judge its age by."""
        if self._saved is not None:
            saved, self._saved = self._saved, None
            self._calibration_messages = self.core.start_from(saved, now_ns)
            self._note_start_from(saved, now_ns)

    def _note_start_from(self, saved: CalibrationPrior, now_ns: int) -> None:
        """Tell which calibration the filter starts from, and how old it is."""
        told = f"calibration {self._config.calibration_file}, {age_words(saved.time_ns, now_ns)}"
        self.notices.append("; ".join([told, *self._calibration_messages]))

    def _read_calibration_at_start(self) -> CalibrationPrior | None:
        if not self._config.calibration_file:
            return None
        return calibration_file.load_if_there(Path(self._config.calibration_file), self._files)

    # -- outputs --------------------------------------------------------------------------------------------

    def _refusal(self, topic: str, time_ns: int, refusal: Refusal, receive_ns: int) -> list[Published]:
        self.health.rejected(topic, refusal, receive_ns, time_ns)
        source = self._inputs.sources[topic]
        return [(_INNOVATION, refusal_message(self._factory, source, time_ns, refusal.reason, refusal.text))]

    def _lights_refused(self, time_ns: int, lights_refused: tuple[tuple[str, Refusal], ...]) -> list[Published]:
        """Lights that had no part in their exposure, each said and counted; the others may be used all the same."""
        published: list[Published] = []
        for name, refusal in lights_refused:
            self.health.noted(BEACONS_TOPIC, refusal.reason)
            message = refusal_message(self._factory, f"light.{name}", time_ns, refusal.reason, refusal.text)
            published.append((_INNOVATION, message))
        return published

    def _published(self, outcome: PointingOutcome, now_ns: int) -> list[Published]:
        published: list[Published] = []
        for decision in outcome.decisions:
            self._count(decision, now_ns)
            published += self._lights_refused(decision.measurement.time_ns, decision.left_out)
            published.append((_INNOVATION, messages_out.innovation(self._factory, decision)))
        for time_ns, refusal in outcome.failures:
            published += self._failed(_POINTING, time_ns, refusal)
        for estimate in outcome.estimates:
            claimed = estimate.status is not Status.INVALID
            self._latest, self._budget_due = estimate, estimate if claimed else None
            published.append((_POINTING, messages_out.pointing(self._factory, estimate)))
        return published

    def _failed(self, what: str, time_ns: int, refusal: Refusal) -> list[Published]:
        """An output that could not be made: told, and nothing else is touched by it."""
        self.health.failed(f"{what}: {refusal.text}")
        return [(_INNOVATION, refusal_message(self._factory, what, time_ns, refusal.reason, refusal.text))]

    def _count(self, decision: ExposureDecision, now_ns: int) -> None:
        time_ns = decision.measurement.time_ns
        if decision.revised:
            self.health.noted(BEACONS_TOPIC, Reason.REVISED)
        elif decision.accepted:
            self.health.accepted(BEACONS_TOPIC, time_ns, now_ns)
            if decision.reason is not Reason.NONE:
                self.health.noted(BEACONS_TOPIC, decision.reason)
        else:
            self.health.rejected(BEACONS_TOPIC, Refusal(decision.reason, decision.text), now_ns, time_ns)
        if decision.reason is Reason.ATTITUDE_CONFLICT:
            self._conflict = decision
        elif decision.accepted:
            self._conflict = None

    def _slow_topics(self, now_ns: int, waiting_ns: int) -> list[Published]:
        factory, published = self._factory, []
        if self._budget_due is not None:
            sources = self.core.filter.model.sources
            published += [
                ("theodolite/error_budget", messages_out.error_budget(factory, self._budget_due, sources)),
                ("theodolite/error_arcsec", messages_out.error_arcsec(factory, self._budget_due)),
            ]
            self._budget_due = None  # no pointing has its budget told twice
        calibration = self.core.calibration()
        published.append(("theodolite/calibration", messages_out.calibration(factory, calibration, now_ns)))
        published += [("input_health", message) for message in self.health.messages(factory, now_ns, waiting_ns)]
        statuses = [
            *self.health.statuses(now_ns, waiting_ns),
            pointing_status(self._latest, self._clock_jumps),
            calibration_status(calibration, self._calibration_messages),
            *conflict_statuses(self._conflict),
        ]
        published.append((DIAGNOSTICS_TOPIC, diagnostic_array(factory, now_ns, self.node_name, statuses)))
        return published

    # -- services -------------------------------------------------------------------------------------------

    def _restart(self, now_ns: int, clock_jumped: bool) -> None:
        self.core.reset(clock_jumped)
        self.health.restart()
        self._latest, self._budget_due, self._slow_due_ns, self._conflict = None, None, None, None

    def _reset(self, now_ns: int) -> str:
        self._restart(now_ns, clock_jumped=False)
        return "the filter starts anew"

    def _save_calibration(self, now_ns: int) -> str:
        path = self._calibration_path()
        prior = self.core.calibration_to_save()
        if prior is None:
            raise BadInput("no light was used yet: there is no calibration to save")
        calibration_file.save(path, prior, self._files)
        return f"calibration saved to {path}"

    def _load_calibration(self, now_ns: int) -> str:
        path = self._calibration_path()
        saved = calibration_file.load(path, self._files)
        self._calibration_messages = self.core.start_from(saved, now_ns)
        self._note_start_from(saved, now_ns)
        self.health.restart()
        self._conflict = None
        return "; ".join([f"calibration loaded from {path}", *self._calibration_messages])

    def _calibration_path(self) -> Path:
        if not self._config.calibration_file:
            raise BadInput("parameter 'calibration_file' is empty: set it to the path of the file to use")
        return Path(self._config.calibration_file)

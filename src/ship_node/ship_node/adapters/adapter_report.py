"""Reports of an adapter: rejections and failures, overload, innovation diagnoses, integrity and conflicts.

The innovations of a node's sources are diagnosed for its diagnostics. Decisions are collected as they come and
evaluated once per diagnostics period, so that no measurement waits for statistics. Results of the core are reported in
:mod:`ship_node.adapters.input_processing`.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_estimation.innovations.innovation_diagnosis import (
    DiagnosisKind,
    InnovationDiagnosis,
    InnovationHistory,
    clock_diagnoses,
)
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.kalman.kalman_filter import StateModel
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import MeasurementDecision, Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_node.adapters.adapter import Overload
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages import common_messages
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import OutputMessage, OutputRows

_MAX_PENDING = 5000
"""Maximum number of pending decisions; above it the oldest are discarded."""

_OK_KINDS = (DiagnosisKind.AS_STATED, DiagnosisKind.UNKNOWN)


class InnovationReport:
    """Innovation diagnoses of a node's sources as diagnostics.

    Attributes:
        pending: decisions that are not evaluated yet, each with the name of its source.
    """

    def __init__(self) -> None:
        self.pending: deque[tuple[str, MeasurementDecision[Any]]] = deque(maxlen=_MAX_PENDING)
        self._history = InnovationHistory()

    def clear(self) -> None:
        """Discard all decisions, for example after a reset of the estimator."""
        self.pending.clear()
        self._history.clear()

    def diagnoses(self) -> dict[str, InnovationDiagnosis]:
        """Return the diagnosis of each source whose measurements were compared with a prediction."""
        while self.pending:
            self._history.add(*self.pending.popleft())
        return self._history.diagnoses()

    def statuses(self) -> list[DiagnosticStatus]:
        """Return one diagnostic status per diagnosis."""
        return [_status(source, diagnosis) for source, diagnosis in self.diagnoses().items()]


def clock_status(model: StateModel, mean: FloatArray, groups: Mapping[str, str]) -> DiagnosticStatus:
    """Return the status of the clock offsets that a filter estimates: WARN if an offset is outside its limits.

    Args:
        model: state model of the filter.
        mean: state vector of the filter.
        groups: as for :func:`ship_estimation.innovations.innovation_diagnosis.clock_diagnoses`.
    """
    issues = clock_diagnoses(model, mean, groups)
    text = "; ".join(issues) or "within configured limits"
    return DiagnosticStatus("clocks", Level.WARN if issues else Level.OK, text)


def _status(source: str, diagnosis: InnovationDiagnosis) -> DiagnosticStatus:
    level = Level.OK if diagnosis.kind in _OK_KINDS else Level.WARN
    values = {"measurements": str(diagnosis.count)}
    if diagnosis.nis_band is not None:
        low, high = diagnosis.nis_band
        values |= {
            "NIS per component": f"{diagnosis.nis:.2f} (expected {low:.2f} to {high:.2f})",
            "factor of its sigma": f"{diagnosis.factor:.2f}",
            "outliers (%)": f"{100.0 * diagnosis.outlier_share:.1f}",
        }
        values |= {f"bias {axis} (sigma)": f"{value:+.2f}" for axis, value in diagnosis.bias_sigma.items()}
        values |= {f"correlation {axis}": f"{value:+.2f}" for axis, value in diagnosis.correlation.items()}
    return DiagnosticStatus(f"verdict {source}", level, diagnosis.text, values)


class OverloadReport:
    """Report of the overload of a node, once a second.

    Args:
        node: name of the node.

    Attributes:
        behind: overload state; None if the node keeps up.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self.behind: Overload | None = None
        self._next_ns = 0

    def change(self, change: Overload, waiting_ns: int) -> str:
        """Set the overload state; return the reason for which messages were dropped."""
        reason = (change if change.behind_s else self.behind or change).text(self._node)
        self.behind = change if change.behind_s else None
        self._next_ns = waiting_ns
        return reason

    def text_due(self, waiting_ns: int) -> str:
        """Return, once a second while the node is behind, the text for the user; otherwise an empty text."""
        if self.behind is None or waiting_ns < self._next_ns:
            return ""
        self._next_ns = waiting_ns + SECOND_NS
        return self.behind.text(self._node)

    def status(self) -> DiagnosticStatus:
        """Return the diagnostic status of the overload."""
        if self.behind is None:
            return DiagnosticStatus("overload", Level.OK, "keeps up with its inputs")
        values = {
            "behind [s]": f"{self.behind.behind_s:.1f}",
            "cores": str(self.behind.cores),
            "load": f"{self.behind.load:.1f}",
        }
        return DiagnosticStatus("overload", Level.ERROR, self.behind.text(self._node), values)


class AdapterReport:
    """Part of an adapter that makes its reports; see :class:`ship_node.adapters.node_adapter.NodeAdapter`.

    Attributes:
        config: the current parameters.
        core: the estimator.
        latest: the last published estimate; None before the first, also after a reset or a step of the time base.
        pending_budget: the last estimate until its error budget is published; None after an INVALID output.
        conflicts: source → text, for sources in persistent conflict.
        innovation_report: innovation diagnoses of the sources.
        published_levels: the protection levels last published.
        next_slow_ns: timeout-clock time of the next slow topics; None if the next tick publishes them.
        overload_report: overload of the node; the estimates of a node that is behind are not published.
    """

    node_name: ClassVar[str]
    main_topic: ClassVar[str]
    """Topic of the estimates. If an estimate cannot be computed, the failure is reported under this name."""
    innovation_topic: ClassVar[str]
    integrity_topic: ClassVar[str] = ""
    """Topic of the protection levels; empty if the node has none."""
    quantities: ClassVar[tuple[str, ...]] = ()
    """Quantities that the protection levels bound."""
    redundancy_key: ClassVar["attrgetter[tuple[Any, ...]]"]
    """Attributes of an output that determine, together with its state, the redundancy of its sources."""
    directions: ClassVar["attrgetter[np.ndarray]"]
    """Attribute of an output: the ``directions`` of a ``PublishedLevels``."""
    integrity_frame: str = ""
    health: InputHealthMonitor

    def __init__(
        self, config: Any, core: Any, factory: MessageFactory, estimate_messages: Callable[[Any], list[OutputMessage]]
    ) -> None:
        self.config, self.core, self.factory = config, core, factory
        self._estimate_messages = estimate_messages
        self.latest: Any = None
        self.pending_budget: Any = None
        self.conflicts: dict[str, str] = {}
        self.innovation_report = InnovationReport()
        self.published_levels = PublishedLevels()
        self.next_slow_ns: int | None = None
        self.overload_report = OverloadReport(self.node_name)

    def call_cores(self, call: Callable[[Any], None]) -> None:
        """Call a function with each estimator of the node."""
        call(self.core)

    def batch_messages(self, runs: Sequence[Any]) -> Iterator[OutputRows]:
        """Return the messages of several runs of outputs; the messages of one output are in order of publication."""
        return iter(())

    def rejected_part_message(self, source: str, time_ns: int, name: str, rejection: Rejection) -> OutputMessage:
        """Return the message about a rejected part (a star, a light) of a measurement."""
        return self.rejection_message(source, time_ns, Rejection(rejection.reason, f"{name}: {rejection.text}"))

    def rejection_message(self, source: str, time_ns: int, rejection: Rejection) -> OutputMessage:
        """Return the message about a rejected input."""
        return self.innovation_topic, common_messages.rejection_message(self.factory, source, time_ns, rejection)

    def report_failure(self, what: str, time_ns: int, rejection: Rejection) -> OutputMessage:
        """Record that an output could not be computed and return the message about it."""
        self.health.record_failure(f"{what}: {rejection.text}")
        return self.rejection_message(what, time_ns, rejection)

    def reset_outputs(self) -> None:
        """Discard the published estimate and the reports; the next tick publishes the slow topics."""
        self.latest = self.pending_budget = self.next_slow_ns = None
        self.reset_reports()

    def reset_reports(self) -> None:
        """Discard the published levels, the conflicts and the diagnoses."""
        self.published_levels = PublishedLevels()
        self.conflicts.clear()
        self.innovation_report.clear()

    def integrity_statuses(self) -> list[DiagnosticStatus]:
        """Return one status with the published protection levels and the excluded sources."""
        known = self.latest is not None and self.latest.status is not Status.INVALID
        return [common_messages.integrity_status(self.published_levels.report if known else None, self.quantities)]

    def conflict_statuses(self) -> list[DiagnosticStatus]:
        """Return one status per source in persistent conflict."""
        return [
            DiagnosticStatus(f"conflict {source}", Level.ERROR, text)
            for source, text in sorted(self.conflicts.items())
        ]

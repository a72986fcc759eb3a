"""Innovation diagnosis of a node's sources, for its diagnostics.

Decisions are collected as they come and evaluated once per diagnostics period, so that no measurement waits for
statistics.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any

from ship_estimation.innovations.innovation_diagnosis import (
    DiagnosisKind,
    InnovationDiagnosis,
    InnovationHistory,
    clock_diagnoses,
)
from ship_estimation.kalman.kalman_filter import StateModel
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.rotations import FloatArray
from ship_node.messages.common_messages import DiagnosticStatus, Level

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
    return DiagnosticStatus(
        "clocks", Level.WARN if issues else Level.OK, "; ".join(issues) or "within configured limits"
    )


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

"""What the innovations say of the sources of a node, for its diagnostics.

Decisions are kept as they come and judged when the diagnostics are due, once a period: a measurement on its way to the
estimate waits for no statistics.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any

from ship_estimation.kalman import StateModel
from ship_estimation.outcome import Decision
from ship_estimation.verdicts import SourceVerdict, VerdictBook, VerdictKind, clock_verdicts
from ship_geometry.rotations import FloatArray
from ship_node.edge.messages_out import DiagnosticStatus, Level

_MOST_PENDING = 5000
"""Of a flood the newest decisions are judged."""

_GOOD = (VerdictKind.AS_STATED, VerdictKind.UNKNOWN)


class VerdictReport:
    """The verdicts about the sources of a node as diagnostics.

    Attributes:
        pending: decisions not judged yet, each with the name of its source.
    """

    def __init__(self) -> None:
        self.pending: deque[tuple[str, Decision[Any]]] = deque(maxlen=_MOST_PENDING)
        self._book = VerdictBook()

    def clear(self) -> None:
        """Forget all, as after a reset of the estimator."""
        self.pending.clear()
        self._book.clear()

    def verdicts(self) -> dict[str, SourceVerdict]:
        """Verdict on each source whose measurements were compared with a prediction."""
        while self.pending:
            self._book.add(*self.pending.popleft())
        return self._book.verdicts()

    def statuses(self) -> list[DiagnosticStatus]:
        """One status for each of these verdicts."""
        return [_status(source, verdict) for source, verdict in self.verdicts().items()]


def clock_status(model: StateModel, mean: FloatArray, groups: Mapping[str, str]) -> DiagnosticStatus:
    """Whether the clock offsets that a filter estimates are within what is configured; arguments as clock_verdicts."""
    told = clock_verdicts(model, mean, groups)
    return DiagnosticStatus("clocks", Level.WARN if told else Level.OK, "; ".join(told) or "within what is configured")


def _status(source: str, verdict: SourceVerdict) -> DiagnosticStatus:
    level = Level.OK if verdict.kind in _GOOD else Level.WARN
    values = {"measurements": str(verdict.count)}
    if verdict.nis_band is not None:
        low, high = verdict.nis_band
        values |= {
            "NIS per component": f"{verdict.nis:.2f} (expected {low:.2f} to {high:.2f})",
            "factor of its sigma": f"{verdict.factor:.2f}",
            "far off (%)": f"{100.0 * verdict.far_share:.1f}",
        }
        values |= {f"bias {axis} (sigma)": f"{value:+.2f}" for axis, value in verdict.bias_sigma.items()}
        values |= {f"correlation {axis}": f"{value:+.2f}" for axis, value in verdict.correlation.items()}
    return DiagnosticStatus(f"verdict {source}", level, verdict.text, values)

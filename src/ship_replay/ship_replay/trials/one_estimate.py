"""The filters with one estimate alone: what those beside it, without each source, cost, and that they do not move it.

``make bench`` measures the cost. On a voyage without faults the outputs are the same.
"""

from typing import Any

from ship_attitude_star.measurements.samples import AttitudeDecision
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.linearised import Linearised
from ship_attitude_star.ship_attitude.state import FilterState, changed
from ship_estimation.kalman import innovation, update
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.alternatives import Alternatives, SourceRows
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.measured.samples import ExposureDecision


class WithoutIntegrity(ShipFilter):
    """The ship's step with one estimate alone, which uses whatever can be compared with it."""

    def __init__(self, config: ShipAttitudeConfig) -> None:
        super().__init__(config)
        self.suspects.table.rows, self.suspects.table.ins_rows = 1, ()

    def _judged(
        self, state: FilterState, predicted: FilterState, measurement: Measurement, found: Linearised
    ) -> tuple[FilterState, AttitudeDecision]:
        linear = found.compared.linear
        _, nis, gain = innovation(predicted.parts, linear)
        correction, parts = update(predicted.parts, linear, gain)
        after = changed(predicted, means=predicted.means + correction, stack=parts)
        decision = AttitudeDecision(measurement, Reason.NONE, True, nis=nis, ins_time_ns=found.ins_time_ns)
        return self._used(after, measurement), decision


class _NoAlternatives:
    """The rows of a theodolite's filter, of which none is carried on."""

    def __init__(self, rows: SourceRows) -> None:
        self._rows = rows

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rows, name)

    def predicted(self, rows: Alternatives, *_: object) -> Alternatives:
        """As they were."""
        return rows

    unknown = predicted


class WithoutAlternatives(SightingStep):
    """The theodolite's step with one estimate alone, its gate and its light checks."""

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        super().__init__(config, filter_)
        filter_.rows = _NoAlternatives(filter_.rows)  # type: ignore[assignment]

    def _learnt(
        self,
        before: CalibrationState,
        after: CalibrationState,
        names: tuple[str, ...],
        compared: Comparison,
        decision: ExposureDecision,
    ) -> tuple[CalibrationState, ExposureDecision]:
        return after, decision

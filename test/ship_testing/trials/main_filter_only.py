"""Filters without subfilters, to measure the cost of subfilters and to show that outputs are the same without them.

``make bench`` measures the cost. On a voyage without faults, the outputs with and without subfilters are equal.
"""

from typing import Any

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.prediction import LinearisedMeasurement
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.exclusion import with_changes
from ship_estimation.kalman.kalman_filter import innovation, update
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Measurement
from ship_stars.attitude_samples import AttitudeDecision
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.filter.subfilters import AxisSubfilters, SubfilterStates
from theodolite_calib.samples.samples import ExposureDecision


class ShipFilterWithoutSubfilters(ShipFilter):
    """The ship's filter step without subfilters, which uses every measurement that can be evaluated."""

    def __init__(self, config: ShipAttitudeConfig) -> None:
        super().__init__(config)
        self.fault_detector.subfilters.count, self.fault_detector.subfilters.ins_subfilters = 1, ()

    def _evaluate(
        self, state: FilterState, predicted: FilterState, measurement: Measurement, found: LinearisedMeasurement
    ) -> tuple[FilterState, AttitudeDecision]:
        linear = found.compared.linear
        _, nis, gain = innovation(predicted.covariance_by_source, linear)
        correction, parts = update(predicted.covariance_by_source, linear, gain)
        after = with_changes(predicted, means=predicted.means + correction, stack=parts)
        decision = AttitudeDecision(measurement, Reason.NONE, True, nis=nis, ins_time_ns=found.ins_time_ns)
        return self._effects.record_accepted(after, measurement), decision


class _NoSubfilters:
    """Subfilters of a theodolite's filter that are never propagated."""

    def __init__(self, rows: AxisSubfilters) -> None:
        self._rows = rows

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rows, name)

    def propagate(self, rows: SubfilterStates, *_: object) -> SubfilterStates:
        """Return the subfilters unchanged."""
        return rows

    add_unknown_errors = propagate


class SightingStepWithoutSubfilters(SightingStep):
    """The theodolite's filter step without subfilters, with its gate and its light checks."""

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        super().__init__(config, filter_)
        filter_.subfilters = _NoSubfilters(filter_.subfilters)  # type: ignore[assignment]

    def _record_accepted(
        self,
        before: CalibrationState,
        after: CalibrationState,
        names: tuple[str, ...],
        compared: Comparison,
        decision: ExposureDecision,
    ) -> tuple[CalibrationState, ExposureDecision]:
        return after, decision

"""Ship filter for smoothing, whose states record the last update of the main filter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.faults.fault_detection import ShipFaultDetector
from ship_attitude_star.ship_attitude.faults.ins_fault_handling import is_ins_excluded_by_stars
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.kind import ComparedMeasurement
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.fault_detection.fault_state import with_changes
from ship_estimation.fault_detection.subfilters import FilterInnovations
from ship_estimation.kalman.rts_smoother import StateUpdate
from ship_estimation.kalman.rts_step import GaussianEstimate
from ship_estimation.plausibility.ins_jump import InsChange
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class TracedState(FilterState):
    """Filter state with its last update.

    Attributes:
        last_update: update by the last accepted measurement or INS change; None before the first update.
    """

    last_update: StateUpdate | None = None

    @property
    def prediction_input(self) -> LocalVertical | None:
        """Vertical at the time of the state, needed for prediction."""
        return self.vertical


class _TracedFaultDetector(ShipFaultDetector):
    """Fault detection on states that record their last update."""

    def initial_state(self, mean: FloatArray, covariance_by_source: FloatArray) -> FilterState:
        """See :meth:`ShipFaultDetector.initial_state`."""
        return TracedState(**vars(super().initial_state(mean, covariance_by_source)))

    def update_filters(
        self,
        state: FilterState,
        predicted: FilterState,
        measurement: Measurement,
        comparison: ComparedMeasurement,
        innovations: FilterInnovations,
        accepted: NDArray[np.bool_],
    ) -> FilterState:
        """See :meth:`ShipFaultDetector.update_filters`."""
        after = super().update_filters(state, predicted, measurement, comparison, innovations, accepted)
        if after.means is state.means:
            return after
        assert isinstance(after, TracedState)
        is_update = measurement.source not in state.excluded and not is_ins_excluded_by_stars(state)
        before = GaussianEstimate(predicted.mean, predicted.covariance)
        return with_changes(
            after, last_update=StateUpdate(before, GaussianEstimate(after.mean, after.covariance), is_update)
        )


class TracedFilter(ShipFilter):
    """Ship filter whose states record their last update; the results are bit-identical to :class:`ShipFilter`."""

    fault_detector_class: ClassVar[type[ShipFaultDetector]] = _TracedFaultDetector

    def apply_ins_change(self, state: FilterState, change: InsChange) -> FilterState:
        """See :meth:`ShipFilter.apply_ins_change`; the inflation is recorded as an update."""
        after = super().apply_ins_change(state, change)
        assert isinstance(after, TracedState)
        both = GaussianEstimate(after.mean, after.covariance)
        leads_back = after.excluded.keys() <= state.excluded.keys()
        return with_changes(after, last_update=StateUpdate(both, both, leads_back, change.time_ns))

"""Calibration filter whose states record their last update for the smoother."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ship_estimation.kalman.rts_smoother import StateUpdate
from ship_estimation.kalman.rts_step import GaussianEstimate
from ship_geometry.rotations import FloatArray
from ship_stars.solution.exposure import StarExposure
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison, Jump
from theodolite_calib.filter.star_comparison import StarComparison
from theodolite_calib.filter.subfilters import AXIS_SOURCES
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.sighting import Sighting


@dataclass(frozen=True)
class TracedState(CalibrationState):
    """State with its last update.

    Attributes:
        last_update: update by the last accepted sighting or the last jump; None if there was none yet.
        is_predicted_only: False if a subfilter became the main filter since the last propagation, so that the state is
            not a prediction from the state before.
    """

    last_update: StateUpdate | None = None
    is_predicted_only: bool = True

    @property
    def prediction_input(self) -> FloatArray | None:
        """Stated covariance of the ship's error from this state on, an input of the prediction."""
        return self.ship_covariance_n


class TracedFilter(CalibrationFilter):
    """:class:`CalibrationFilter` whose states record their updates; the results are bit-identical."""

    def initial_state_from(self, mean: FloatArray, covariance_by_source: FloatArray) -> TracedState:
        """See :meth:`CalibrationFilter.initial_state_from`."""
        return TracedState(**vars(super().initial_state_from(mean, covariance_by_source)))

    def propagate(
        self, state: CalibrationState, time_ns: int, new_ship_covariance_n: FloatArray | None
    ) -> CalibrationState:
        """See :meth:`CalibrationFilter.propagate`."""
        return replace(
            super().propagate(state, time_ns, new_ship_covariance_n), **_trace_fields(is_predicted_only=True)
        )

    def exclude_source(self, state: CalibrationState, source: str) -> CalibrationState:
        """See :meth:`CalibrationFilter.exclude_source`."""
        return replace(super().exclude_source(state, source), **_trace_fields(is_predicted_only=False))

    def inflate_covariance(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        """See :meth:`CalibrationFilter.inflate_covariance`; the inflation is recorded as an update by a jump."""
        after = super().inflate_covariance(state, jump)
        both = GaussianEstimate(after.mean, after.covariance)
        jumped_ns = jump.time_ns if isinstance(jump, EncoderJump) else None
        return replace(after, **_trace_fields(last_update=StateUpdate(both, both, True, jumped_ns)))

    def update_by_beacons(
        self, state: CalibrationState, sighting: Sighting, comparison: Comparison
    ) -> tuple[CalibrationState, Comparison]:
        """See :meth:`CalibrationFilter.update_by_beacons`."""
        after, compared = super().update_by_beacons(state, sighting, comparison)
        return _with_update_trace(state, after), compared

    def update_by_stars(
        self, state: CalibrationState, exposure: StarExposure, comparison: StarComparison
    ) -> CalibrationState:
        """See :meth:`CalibrationFilter.update_by_stars`."""
        return _with_update_trace(state, super().update_by_stars(state, exposure, comparison))


def _with_update_trace(predicted: CalibrationState, after: CalibrationState) -> CalibrationState:
    """Record the update by a sighting.

    The smoother takes no backward step over the update if an axis source is excluded or a subfilter became the main
    filter.
    """
    assert isinstance(predicted, TracedState)
    is_update = predicted.is_predicted_only and not predicted.fault_state.excluded.keys() & AXIS_SOURCES
    before = GaussianEstimate(predicted.mean, predicted.covariance)
    return replace(
        after,
        **_trace_fields(last_update=StateUpdate(before, GaussianEstimate(after.mean, after.covariance), is_update)),
    )


def _trace_fields(**values: Any) -> Mapping[str, Any]:
    """Return fields of a :class:`TracedState`; the base class's methods are typed for states without these fields."""
    return values

"""The calibration filter, whose states tell how their estimate came about: what a smoother must know."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ship_attitude_star.stars.exposure import StarExposure
from ship_estimation.backward import Known
from ship_estimation.backward_chain import Came
from ship_geometry.rotations import FloatArray
from theodolite_calib.filter.alternatives import CHAIN
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison, Jump
from theodolite_calib.filter.star_comparison import StarComparison
from theodolite_calib.measured.encoder_watch import EncoderJump
from theodolite_calib.measured.sighting import Sighting


@dataclass(frozen=True)
class TracedState(CalibrationState):
    """A state with its last step.

    Attributes:
        came: by the last sighting used, or the last jump; None before the first.
        leads_back: of a state that was carried to a moment: whether prediction alone led there. Otherwise an estimate
            without some source has taken the first place on the way.
    """

    came: Came | None = None
    leads_back: bool = True

    @property
    def given(self) -> FloatArray | None:
        """The stated covariance that the ship's error follows from it on, which prediction asks for."""
        return self.ship_steady_n


class TracedFilter(CalibrationFilter):
    """The steps from state to state as :class:`CalibrationFilter` makes them, to the last bit; states are traced."""

    def started(self, mean: FloatArray, parts: FloatArray) -> TracedState:
        """See :meth:`CalibrationFilter.started`."""
        return TracedState(**vars(super().started(mean, parts)))

    def predicted(self, state: CalibrationState, time_ns: int, ship_now_n: FloatArray | None) -> CalibrationState:
        """See :meth:`CalibrationFilter.predicted`."""
        return replace(super().predicted(state, time_ns, ship_now_n), **_of_trace(leads_back=True))

    def without(self, state: CalibrationState, source: str) -> CalibrationState:
        """See :meth:`CalibrationFilter.without`."""
        return replace(super().without(state, source), **_of_trace(leads_back=False))

    def opened(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        """See :meth:`CalibrationFilter.opened`: by the jump an error comes to the state."""
        after = super().opened(state, jump)
        both = Known(after.mean, after.covariance)
        jumped_ns = jump.time_ns if isinstance(jump, EncoderJump) else None
        return replace(after, **_of_trace(came=Came(both, both, True, jumped_ns)))

    def used(
        self, state: CalibrationState, sighting: Sighting, comparison: Comparison
    ) -> tuple[CalibrationState, Comparison]:
        """See :meth:`CalibrationFilter.used`."""
        after, compared = super().used(state, sighting, comparison)
        return _learnt(state, after), compared

    def used_stars(
        self, state: CalibrationState, exposure: StarExposure, comparison: StarComparison
    ) -> CalibrationState:
        """See :meth:`CalibrationFilter.used_stars`."""
        return _learnt(state, super().used_stars(state, exposure, comparison))


def _learnt(predicted: CalibrationState, after: CalibrationState) -> CalibrationState:
    """The state after a sighting; of sources that are excluded the prediction has been forgotten."""
    assert isinstance(predicted, TracedState)
    is_update = predicted.leads_back and not predicted.trust.excluded & CHAIN
    before = Known(predicted.mean, predicted.covariance)
    return replace(after, **_of_trace(came=Came(before, Known(after.mean, after.covariance), is_update)))


def _of_trace(**values: Any) -> Mapping[str, Any]:
    """Fields of a :class:`TracedState`: the base class, whose methods are typed for its own, does not know them."""
    return values

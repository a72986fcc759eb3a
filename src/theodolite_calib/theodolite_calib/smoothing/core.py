"""The core of ``optical_axis`` that tells each pointing a second time, at the end, by what was sighted meanwhile.

What it tells at once is, to the last bit, what :class:`OpticalAxisCore` tells.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.backward import Known
from ship_estimation.backward_chain import Chain
from ship_geometry.rotations import FloatArray
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.alternatives import CHAIN
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_AXES
from theodolite_calib.measured.samples import EncoderRun, EncoderSample, PointingEstimate, PointingOutcome
from theodolite_calib.measured.tracks import ShipAt, ShipRun
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.optical_axis.output import CorrectedAxis, DuePointing
from theodolite_calib.smoothing.between import Between
from theodolite_calib.smoothing.traced_filter import TracedFilter, TracedState

_AT_ONCE = 1000
"""Pointings that are told again together."""

_NO_PARTS = np.empty((0, 3, 3))


class _RestsOn(NamedTuple):
    """What a pointing that is smoothed rests on beside the states.

    Attributes:
        sample: the reading of the encoders.
        ship: of its moment.
        disputed_n: what it adds to its covariance because sources are apart, rad², shape (3, 3).
    """

    sample: EncoderSample
    ship: ShipAt
    disputed_n: FloatArray


class _ToldAtOnce(NamedTuple):
    """A pointing as it was told at once.

    Attributes:
        estimate: without the state that it rests on and without the parts of its covariance: many are kept.
        rests_on: None where it is told again as it was: it was in doubt, or rests on stars alone.
    """

    estimate: PointingEstimate
    rests_on: _RestsOn | None


class SmoothingAxisCore(OpticalAxisCore):
    """The estimator of the main optical axis, now and, at the end of all, once more with hindsight.

    Args:
        config: the node's parameters.
        watch: the sky; None where no camera sees stars.
    """

    filter_class: ClassVar[type[CalibrationFilter]] = TracedFilter

    def __init__(self, config: OpticalAxisConfig, watch: SkyWatch | None = None) -> None:
        super().__init__(config, watch, self._take)

    def _begin(self) -> None:
        """See :meth:`OpticalAxisCore._begin`; pointings published until then are not published again."""
        super()._begin()
        self._told: deque[_ToldAtOnce] = deque()
        self._stated_n: dict[int, FloatArray] = {}
        oldest = self._shell.oldest_state
        assert isinstance(oldest, TracedState)
        self._chain: Chain[FloatArray | None] = Chain(self._between(), oldest)

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """See :meth:`OpticalAxisCore.reconfigure`."""
        super().reconfigure(config)
        self._chain.between = self._between()

    def take_over_outputs(self, live: OpticalAxisCore) -> None:
        """See :meth:`OpticalAxisCore.take_over_outputs`; what the other one put out is smoothed to its end."""
        super().take_over_outputs(live)
        assert isinstance(live, SmoothingAxisCore)
        self._told = deque(_ToldAtOnce(_alone(estimate), None) for estimate in live.smoothed_to_the_end())

    def smoothed_to_the_end(self) -> Iterator[PointingEstimate]:
        """All pointings once more, by all that was sighted, in the order of their stamps; nothing may come after it.

        Those that are not smoothed are as they were told at once.
        """
        self._take(self._shell.states_in_window())
        output = _SmoothedOutput(self.filter, self._between().rows)
        while self._told:
            due = [self._told.popleft() for _ in range(min(len(self._told), _AT_ONCE))]
            known = {
                moment_ns: Known(mean, covariance)
                for moments_ns, (means, covariances) in self._chain.take_until(due[-1].estimate.time_ns)
                for moment_ns, mean, covariance in zip(moments_ns, means, covariances, strict=True)
            }
            for estimate, rests_on in due:
                found = known.get(estimate.time_ns)
                if found is None or rests_on is None:
                    yield estimate
                else:
                    yield output.again(estimate, rests_on, found)

    # -- what is kept ---------------------------------------------------------------------------------------

    def _put_out(self, outcome: PointingOutcome, due: DuePointing, waiting_ns: int) -> None:
        before = len(outcome.estimates)
        super()._put_out(outcome, due, waiting_ns)
        for estimate in outcome.estimates[before:]:
            self._keep(estimate, due)

    def _point_by_stars(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        before = len(outcome.estimates)
        super()._point_by_stars(outcome, waiting_ns)
        for estimate in outcome.estimates[before:]:
            self._told.append(_ToldAtOnce(_alone(estimate), None))

    def _keep(self, estimate: PointingEstimate, due: DuePointing) -> None:
        rests_on = None
        if not (due.doubt or _in_doubt(due.state)):
            rests_on = _RestsOn(due.sample, due.ship, estimate.covariance_n - estimate.undisputed_n)
            if due.ship.slow_covariance_n is not None:
                self._stated_n[due.time_ns] = due.ship.slow_covariance_n
            self._chain.ask(due.time_ns)
        self._told.append(_ToldAtOnce(_alone(estimate), rests_on))

    def _between(self) -> Between:
        return Between(self.filter, self._stated_at)

    def _stated_at(self, times_ns: Sequence[int]) -> FloatArray | None:
        """The ship's error as stated at moments that are asked for; None where the configuration states it."""
        if times_ns[0] not in self._stated_n:
            return None
        return np.array([self._stated_n[time_ns] for time_ns in times_ns])

    def _take(self, states: Sequence[CalibrationState]) -> None:
        for state in states:
            assert isinstance(state, TracedState)
            self._chain.add(state)


class _SmoothedOutput:
    """Makes pointings by states with hindsight, as :class:`CorrectedAxis` makes them by those at once.

    Args:
        filter_: the filter.
        rows: where the states are that are known with hindsight.
    """

    def __init__(self, filter_: CalibrationFilter, rows: NDArray[np.intp]) -> None:
        self._filter, self._rows = filter_, rows
        self._blank = filter_.started(np.zeros(filter_.model.size), np.zeros_like(filter_.model.initial_parts()))
        # What each source has in it is not carried back: one bears all of it.
        self._source = filter_.model.sources.index(SOURCE_AXES)

    def again(self, told: PointingEstimate, rests_on: _RestsOn, known: Known) -> PointingEstimate:
        """A pointing by the states of its own moment."""
        sample, ship, disputed_n = rests_on
        mean, parts = self._blank.mean.copy(), np.zeros_like(self._blank.parts)
        mean[self._rows], parts[self._source, self._rows[:, None], self._rows] = known
        # The ship's error is as the messages state it at the moment: nothing more happens to it.
        state = replace(
            self._blank, time_ns=told.time_ns, mean=mean, parts=parts, ship_steady_n=ship.slow_covariance_n
        )
        corrected = CorrectedAxis(self._filter, state)
        axes = corrected.axes(ShipRun.of([ship]), EncoderRun.of([sample], [""], [0.0]))
        (rotation_nm,), (parts_n,) = axes.rotation_nm, axes.parts_n
        undisputed_n = parts_n.sum(axis=0)
        return replace(
            told,
            rotation_nm=rotation_nm,
            covariance_n=undisputed_n + disputed_n,
            undisputed_n=undisputed_n,
            # Without lights the telescope's attitude is not told.
            rotation_nt=np.where(np.isfinite(told.rotation_nt), rotation_nm @ corrected.rotation_mt, np.nan),
            by_error_n=axes.by_error_n[0],
            rotation_dm=told.rotation_dm if ship.chord_nd is None else ship.chord_nd.T @ rotation_nm,
        )


def _in_doubt(state: CalibrationState) -> bool:
    """Whether lights or stars contradict encoders and ship, or one of these is excluded."""
    return bool(state.refusals) or state.trust.conflict is not None or bool(state.trust.excluded & CHAIN)


def _alone(estimate: PointingEstimate) -> PointingEstimate:
    """A pointing that holds neither states nor arrays of others."""
    return replace(
        estimate,
        rotation_nm=estimate.rotation_nm.copy(),
        parts_n=_NO_PARTS,
        covariance_n=estimate.covariance_n.copy(),
        undisputed_n=estimate.undisputed_n.copy(),
        rotation_nt=estimate.rotation_nt.copy(),
        state=None,
        by_error_n=estimate.by_error_n.copy(),
        rotation_dm=estimate.rotation_dm.copy(),
    )

"""State of the ship-attitude filter after a measurement, and after a step of the time base until UTC is verified.

A :class:`FilterState` is immutable, so the time-ordered log can store states and go back to any of them.

UTC is verified by comparing stars with the INS. If UTC became wrong due to the step, or was wrong before the step, the
stars are rotated about the pole by 15.04″ per second of the step. The attitude from before the step is propagated by
the INS. The stars are not used until UTC is verified or can no longer be verified.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.fault_detection.common_error import NO_CORRECTIONS, CorrectionSums
from ship_estimation.fault_detection.exclusion import FaultState, UnconfirmedStep, UnresolvedFault, with_changes
from ship_estimation.kalman.rts_smoother import StateUpdate
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_kalman
from ship_stars.attitude_samples import AttitudeDecision
from ship_stars.camera.errors import PixelDwell
from ship_stars.sky.sky_model import EARTH_ROTATION_RATE

NO_PIXEL_DWELLS: MappingProxyType[str, PixelDwell] = MappingProxyType({})
"""Pixel dwells before any exposure."""

_MIN_SIGMAS = 6.0
"""Minimum rotation of the sky that stars can detect, in standard deviations of the propagated attitude."""

_DECISIVE_LOG_RATIO = math.log(100.0)
"""Decision threshold of the log-likelihood ratio."""

_MAX_LOG_RATIO_OF_ONE, _MAX_LOG_RATIO = 5.0, 10.0
"""Maximum log-likelihood ratio of one measurement, and of all measurements."""

_MAX_CHI2, _RESIDUAL_RATIO = 16.0, 0.02
"""Maximum sum of squares of a consistent rotation, and additional allowed deviation as a ratio to the sky rotation."""


class SourceInnovation(NamedTuple):
    """Innovation of a source's measurement against the main filter, as a rotation of the device.

    Attributes:
        whitened: whitened rotation vector (unit covariance), shape (3,).
        root: root of the covariance of the rotation vector, rad, shape (3, 3).
        predicted_nv: predicted attitude of the device, horizon from device, shape (3, 3).
    """

    whitened: FloatArray
    root: FloatArray
    predicted_nv: FloatArray

    @property
    def rotation_v(self) -> FloatArray:
        """Rotation vector in the device frame, rad, shape (3,)."""
        rotation_v: FloatArray = self.root @ self.whitened
        return rotation_v

    @property
    def rotation_n(self) -> FloatArray:
        """Rotation vector in the horizon frame, rad, shape (3,)."""
        rotation_n: FloatArray = self.predicted_nv @ self.rotation_v
        return rotation_n


def shared_rotation(innovations: Sequence[SourceInnovation]) -> FloatArray:
    """Return the rotation common to several innovations by least squares.

    Returns:
        Rotation vector in the horizon frame, rad, shape (3,).
    """
    whitening = np.vstack([np.linalg.pinv(one.root) @ one.predicted_nv.T for one in innovations])
    whitened = np.concatenate([one.whitened for one in innovations])
    rotation_n: FloatArray = np.linalg.lstsq(whitening, whitened, rcond=None)[0]
    return rotation_n


@dataclass(frozen=True)
class AttitudeResidual:
    """Residual of a rejected attitude.

    Attributes:
        time_ns: stamp of the measurement.
        turn_n: rotation from predicted to measured attitude, rotation vector in the horizon frame, rad, shape (3,).
        noise_n: covariance of this rotation due to the measurement noise, rad², shape (3, 3).
    """

    time_ns: int
    turn_n: FloatArray
    noise_n: FloatArray


class UtcStep(NamedTuple):
    """A step of the time base after which UTC must be verified.

    Attributes:
        step_s: sum of the steps since UTC was last verified, s.
        log_likelihood_ratio: log-likelihood of the star measurements since the last step if the sky is rotated by
            ``step_s``, minus the log-likelihood if the sky is not rotated.
    """

    step_s: float
    log_likelihood_ratio: float = 0.0


class RecentInnovations(NamedTuple):
    """Windowed innovation means of a source's accepted measurements against the main filter.

    Attributes:
        windowed_means: the windowed means, as in
            :attr:`~ship_estimation.fault_detection.isolation.InnovationMeans.running`, shape (w, 5).
        largest_sigmas: largest deviation of a mean from zero, in standard deviations of the mean.
    """

    windowed_means: FloatArray
    largest_sigmas: float


@dataclass(frozen=True)
class FilterState(FaultState):
    """State of h filters, the main filter first, then the subfilters.

    Attributes:
        time_ns: time of the state; None before the first measurement.
        means: estimated errors, shape (h, n).
        stack: covariance of the main filter by error source, then covariances of the subfilters, as in
            :mod:`ship_estimation.fault_detection.subfilters`, shape (n_sources + h - 1, n, n).
        exclusion_counts: number of exclusions of each source.
        separation_covariance_n: covariance that an output adds for large solution separations and for an earlier error
            shared by the stars, rad², horizon frame, shape (3, 3); not part of ``stack``; None if neither exists.
        last_innovations: innovation of each source's last measurement against the main filter.
        recent_innovations: windowed innovation means of each source's accepted measurements since the last restart of
            the filters.
        received_since_ns: stamp since which each source has been received without a gap, ns.
        common_n: steady-state covariance of the correlated error of each star sensor, rad², horizon frame, shape
            (3, 3).
        consecutive_rejections: number of consecutive rejections of each source.
        last_used_ns: stamp of each source's last accepted measurement, ns.
        pixel_dwells: pixel dwell of the stars in each camera; emptied if the covariance is inflated for an INS jump or
            for consecutive rejections.
        unconfirmed_step: INS jump, possible INS jump, reinstatement of the INS or first star measurement that other
            stars have not confirmed; None if all are confirmed.
        rejected_residuals: residual of each source's last rejected measurement.
        ins_jump_ns: INS stamp just before the first sample after the last jump for which the covariance was inflated;
            None before a jump.
        ins_fault_ns: time of the last reported jump, a later contradiction, or a reinstatement of the INS; None before
            these.
        vertical: vertical at the time of the state; None before the first measurement, or if the filter needs no
            vertical.
        utc_step: step of the time base after which UTC is not verified yet; None otherwise.
        correction_sums: sums of the recent corrections by the star sensors, which show an error that all star sensors
            share.
        last_update: update by the last accepted measurement or INS change, recorded for smoothing; None before the
            first update, or if updates are not recorded.
    """

    time_ns: int | None
    means: FloatArray
    stack: FloatArray
    exclusion_counts: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    last_innovations: MappingProxyType[str, SourceInnovation] = field(default_factory=lambda: MappingProxyType({}))
    recent_innovations: MappingProxyType[str, RecentInnovations] = field(default_factory=lambda: MappingProxyType({}))
    received_since_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    common_n: MappingProxyType[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    consecutive_rejections: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    last_used_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    pixel_dwells: MappingProxyType[str, PixelDwell] = field(default_factory=lambda: NO_PIXEL_DWELLS)
    unconfirmed_step: UnconfirmedStep | None = None
    rejected_residuals: MappingProxyType[str, AttitudeResidual] = field(default_factory=lambda: MappingProxyType({}))
    ins_jump_ns: int | None = None
    ins_fault_ns: int | None = None
    separation_covariance_n: FloatArray | None = None
    vertical: LocalVertical | None = None
    utc_step: UtcStep | None = None
    correction_sums: CorrectionSums = NO_CORRECTIONS
    last_update: StateUpdate | None = None

    @property
    def prediction_input(self) -> LocalVertical | None:
        """Vertical at the time of the state, with which the smoother predicts."""
        return self.vertical

    @property
    def mean(self) -> FloatArray:
        """Estimated errors of the main filter, shape (n,)."""
        mean: FloatArray = self.means[0]
        return mean

    @property
    def covariance_by_source(self) -> FloatArray:
        """Covariance of the main filter by error source, shape (n_sources, n, n)."""
        parts: FloatArray = self.stack[: len(self.stack) - len(self.means) + 1]
        return parts

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the main filter, shape (n, n)."""
        total: FloatArray = compiled_kalman.total(self.stack, len(self.stack) - len(self.means) + 1)
        return total


def with_utc_step(state: FilterState, model: ShipStateModel, step_ns: int) -> FilterState:
    """Return the state after a step of the time base, with UTC to be verified if the stars can detect the step.

    Args:
        state: state with its stamps in the new time base.
        model: state vector.
        step_ns: step of the time base, ns.
    """
    step_s = step_ns / SECOND_NS + (0.0 if state.utc_step is None else state.utc_step.step_s)
    # An unresolved fault that was detected while UTC was not verified belongs to the earlier step, and is dropped.
    unresolved_fault = None if state.utc_step is not None else state.unresolved_fault
    return with_changes(
        state,
        utc_step=UtcStep(step_s) if _is_observable(state, model, step_s) else None,
        unresolved_fault=unresolved_fault,
    )


def with_utc_evaluated(
    state: FilterState, predicted: FilterState, model: ShipStateModel, after: FilterState, decision: AttitudeDecision
) -> tuple[FilterState, AttitudeDecision]:
    """Return state and decision after a star measurement while UTC is not verified.

    Args:
        state: state before the measurement.
        predicted: ``state`` propagated to the time of the measurement.
        model: state vector.
        after: state after the measurement.
        decision: decision about the measurement.

    Returns:
        - UTC is right: the state before the measurement without ``utc_step`` and ``unresolved_fault``, and
          ``decision``.
        - UTC is undecided, and the propagated attitude is no longer accurate enough: the state before the measurement
          without ``utc_step``, and ``decision``.
        - UTC is undecided or wrong: the state before the measurement with the new likelihood ratio, and with an
          unresolved fault if UTC is wrong; and a rejection.
        - The measurement was not compared, or is consistent with neither hypothesis: ``after`` and ``decision``.
    """
    innovation, utc = after.last_innovations.get(decision.measurement.source), state.utc_step
    assert utc is not None
    if utc.log_likelihood_ratio < _DECISIVE_LOG_RATIO and not _is_observable(predicted, model, utc.step_s):
        return with_changes(state, utc_step=None), decision
    if innovation is None or not len(decision.residual):
        return after, decision
    ratio, rotation_n = _log_likelihood_ratio(innovation, utc.step_s)
    if ratio is None:
        return after, decision
    total = min(utc.log_likelihood_ratio + ratio, _MAX_LOG_RATIO)
    if total <= -_DECISIVE_LOG_RATIO:
        return with_changes(state, utc_step=None, unresolved_fault=None), decision
    state = with_changes(state, utc_step=UtcStep(utc.step_s, total))
    if total < _DECISIVE_LOG_RATIO:
        text = f"the clocks stepped by {utc.step_s:+.3f} s: the stars are not used until UTC is verified with the INS"
        return state, replace(decision, accepted=False, reason=Reason.CLOCK, text=text)
    text = (
        f"UTC differs by {utc.step_s:+.1f} s: since the clock step the stars are rotated about the pole by "
        "15.04″ per second of the step; set the clocks right, or call ~/reset if they were wrong before"
    )
    state = with_changes(state, unresolved_fault=UnresolvedFault(text, np.outer(rotation_n, rotation_n)))
    return state, replace(decision, accepted=False, reason=Reason.ATTITUDE_CONFLICT, text=text)


def _is_observable(state: FilterState, model: ShipStateModel, step_s: float) -> bool:
    """True if the attitude of a state is known well enough to detect the rotation of the sky by a step."""
    slow = model.slices["ins.attitude"]
    sigma = math.sqrt(float(np.linalg.eigvalsh(state.covariance[slow, slow])[-1]))
    return EARTH_ROTATION_RATE * abs(step_s) >= _MIN_SIGMAS * sigma


def _log_likelihood_ratio(innovation: SourceInnovation, step_s: float) -> tuple[float | None, FloatArray]:
    """Return the log-likelihood ratio of one measurement, and the rotation of the sky by the step.

    The pole is in the meridian. The latitude is estimated from the measurement, which costs one degree of freedom.

    Returns:
        The ratio, which is None if the innovation is consistent with neither hypothesis.
        The rotation vector, horizon frame, rad, shape (3,).
    """
    whitened_of_n = np.linalg.solve(innovation.root, innovation.predicted_nv.T)
    sign = -math.copysign(1.0, step_s)
    north, up = sign * np.linalg.lstsq(whitened_of_n[:, :2], innovation.whitened, rcond=None)[0]
    latitude = math.atan2(up, max(north, 0.0))
    rotation_n = -EARTH_ROTATION_RATE * step_s * np.array([math.cos(latitude), math.sin(latitude), 0.0])
    by_sky = whitened_of_n @ rotation_n
    squares_unrotated, residual = float(innovation.whitened @ innovation.whitened), innovation.whitened - by_sky
    squares = float(residual @ residual)
    # A NaN innovation is consistent with neither hypothesis.
    fits_sky = squares <= _MAX_CHI2 + _RESIDUAL_RATIO**2 * float(by_sky @ by_sky)
    if not (fits_sky or squares_unrotated <= _MAX_CHI2):
        return None, rotation_n
    ratio = 0.5 * (squares_unrotated - squares - 1.0)
    return min(max(ratio, -_MAX_LOG_RATIO_OF_ONE), _MAX_LOG_RATIO_OF_ONE), rotation_n

"""Verification of UTC after a step of the time base, by comparing stars with the INS.

If UTC became wrong due to the step, or was wrong before the step, the stars are rotated about the pole by 15.04″ per
second of the step. The attitude from before the step is propagated by the INS. The stars are not used until UTC is
verified or can no longer be verified.
"""

import math
from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_attitude_star.ship_attitude.state import FilterState, SourceInnovation, UtcStep
from ship_estimation.fault_detection.fault_state import UnresolvedFault, with_changes
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_stars.samples.attitude_samples import AttitudeDecision
from ship_stars.sky.sky_model import EARTH_ROTATION_RATE

_MIN_SIGMAS = 6.0
"""Minimum rotation of the sky that stars can detect, in standard deviations of the propagated attitude."""

_DECISIVE_LOG_RATIO = math.log(100.0)
"""Decision threshold of the log-likelihood ratio."""

_MAX_LOG_RATIO_OF_ONE, _MAX_LOG_RATIO = 5.0, 10.0
"""Maximum log-likelihood ratio of one measurement, and of all measurements."""

_MAX_CHI2, _RESIDUAL_RATIO = 16.0, 0.02
"""Maximum sum of squares of a consistent rotation, and additional allowed deviation as a ratio to the sky rotation."""


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

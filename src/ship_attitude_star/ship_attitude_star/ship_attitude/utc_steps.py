"""Is UTC right since the time base stepped? The stars are compared with the INS, for which no time has passed.

If UTC became wrong by a step, or was wrong before it, the stars turn about the pole by 15.04″ for each second of the
step. The attitude of before the step, carried by the INS, is kept until the stars have decided. Nothing is learnt from
stars that contradict it: they are used again as soon as they agree with it.
"""

import math
from dataclasses import replace

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeDecision
from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_attitude_star.ship_attitude.state import Apart, Doubt, FilterState, UtcStep, changed
from ship_attitude_star.sky.sky_watch import EARTH_ROTATION_RATE
from ship_estimation.refusals import Reason
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

_LEAST_SIGMAS = 6.0
"""Smallest turn of the sky, in sigmas of the attitude that is kept, that the stars can tell from none."""

_DECIDES = math.log(100.0)
"""Log-likelihood ratio that decides."""

_MOST_AT_ONCE, _MOST = 5.0, 10.0
"""Largest log-likelihood ratio of one measurement, and of all."""

_FITS, _FITS_SHARE = 16.0, 0.02
"""Largest sum of squares of a turn that fits, and the share of the turn of the sky that may be left besides."""


def with_utc_step(state: FilterState, model: ShipStateModel, step_ns: int) -> FilterState:
    """Return the state after a step of the time base, with UTC in question if the stars can tell.

    Args:
        state: with its stamps by the new time base.
        model: of its errors.
        step_ns: the step.
    """
    step_s = step_ns / SECOND_NS + (0.0 if state.utc is None else state.utc.step_s)
    # The doubt of before belongs to another UTC.
    doubt = None if state.utc is not None else state.doubt
    return changed(state, utc=UtcStep(step_s) if _can_tell(state, model, step_s) else None, doubt=doubt)


def with_utc_compared(
    state: FilterState, predicted: FilterState, model: ShipStateModel, after: FilterState, decision: AttitudeDecision
) -> tuple[FilterState, AttitudeDecision]:
    """Return state and decision after a star measurement while UTC is in question.

    Args:
        state: before the measurement.
        predicted: the same at its moment.
        model: of the errors.
        after: with it.
        decision: about it.

    Returns:
        The state before it without the question if UTC is right, or if the attitude that was kept is no longer good
        enough to tell. The state before it, and a refusal, while that is open, and if UTC differs. What was given if
        the measurement fits neither.
    """
    apart, utc = after.apart.get(decision.measurement.source), state.utc
    assert utc is not None
    if utc.log_ratio < _DECIDES and not _can_tell(predicted, model, utc.step_s):
        return changed(state, utc=None), decision
    if apart is None or not len(decision.residual):
        return after, decision
    ratio, turn_n = _log_ratio(apart, utc.step_s)
    if ratio is None:
        return after, decision
    total = min(utc.log_ratio + ratio, _MOST)
    if total <= -_DECIDES:
        return changed(state, utc=None, doubt=None), decision
    state = changed(state, utc=UtcStep(utc.step_s, total))
    if total < _DECIDES:
        text = f"the clocks stepped by {utc.step_s:+.3f} s: not used until UTC is verified with the INS"
        return state, replace(decision, accepted=False, reason=Reason.CLOCK, text=text)
    text = (
        f"UTC differs by {utc.step_s:+.1f} s: since the clock step the stars are rotated about the pole by "
        "15.04″ per second of the step; set the clocks right, or call ~/reset if they were wrong before"
    )
    state = changed(state, doubt=Doubt(text, np.outer(turn_n, turn_n)))
    return state, replace(decision, accepted=False, reason=Reason.ATTITUDE_CONFLICT, text=text)


def _can_tell(state: FilterState, model: ShipStateModel, step_s: float) -> bool:
    """True if stars can tell a sky that is turned by a step from one that is not, by the attitude of a state."""
    slow = model.slices["ins.attitude"]
    sigma = math.sqrt(float(np.linalg.eigvalsh(state.covariance[slow, slow])[-1]))
    return EARTH_ROTATION_RATE * abs(step_s) >= _LEAST_SIGMAS * sigma


def _log_ratio(apart: Apart, step_s: float) -> tuple[float | None, FloatArray]:
    """The log-likelihood ratio of one measurement, None if it fits neither, and the turn of the sky by the step.

    The pole is in the meridian; the latitude is taken from the measurement itself, which costs one degree of freedom.
    """
    whitened_of_n = np.linalg.solve(apart.root, apart.predicted_nv.T)
    turned = -math.copysign(1.0, step_s)
    north, up = turned * np.linalg.lstsq(whitened_of_n[:, :2], apart.whitened, rcond=None)[0]
    latitude = math.atan2(up, max(north, 0.0))
    turn_n = -EARTH_ROTATION_RATE * step_s * np.array([math.cos(latitude), math.sin(latitude), 0.0])
    by_sky = whitened_of_n @ turn_n
    unturned, left = float(apart.whitened @ apart.whitened), apart.whitened - by_sky
    squares = float(left @ left)
    # Written so that NaN fits neither.
    fits_sky = squares <= _FITS + _FITS_SHARE**2 * float(by_sky @ by_sky)
    if not (fits_sky or unturned <= _FITS):
        return None, turn_n
    ratio = 0.5 * (unturned - squares - 1.0)
    return min(max(ratio, -_MOST_AT_ONCE), _MOST_AT_ONCE), turn_n

"""The remembered state of the ship's attitude: a start from it, and how far measurements and other states are from it.

The rules for which these are asked are those of :mod:`ship_estimation.recovery`.
"""

from collections.abc import Sequence

import numpy as np

from ship_attitude_star.ship_attitude.corrected_ins import newest_star_ns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.linearised import NotCompared
from ship_attitude_star.ship_attitude.state import FilterState, changed
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.ins import InsJump
from ship_estimation.outcome import Measurement
from ship_estimation.recovery.displacement import MemoryResidual
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.time_scales import SECOND_NS

_LASTING = (".installation", ".time_offset", ".optics", "ins.attitude")
"""Ends of the names of the states that are compared with the remembered ones: all others vary within minutes."""

_SEEN_RAD = 0.02
"""A turn of the device that a measurement shows no better than this is not seen by it, rad."""


def start_from_memory(filter_: ShipFilter, memory: FilterState, live: FilterState) -> FilterState:
    """Return a start with what is remembered of the errors, and with no measurement and no fault of since then.

    Args:
        filter_: of the estimator.
        memory: the remembered state.
        live: the state of the estimator in use; its record of exclusions and of the INS's jumps is kept.
    """
    return changed(
        filter_.suspects.start(memory.mean, memory.parts),
        time_ns=memory.time_ns,
        vertical=memory.vertical,
        common_n=memory.common_n,
        record=live.record,
        ins_suspected_ns=live.ins_suspected_ns,
    )


def propagate_memory(filter_: ShipFilter, memory: FilterState, jumps: Sequence[InsJump], time_ns: int) -> FilterState:
    """Return the remembered state propagated to a time, with a covariance inflated by the jumps of the INS."""
    for jump in jumps:
        memory = filter_.opened(memory, jump)
    return filter_.predicted(memory, time_ns)


def memory_residual(
    filter_: ShipFilter, memory: FilterState, measurement: Measurement, track: AttitudeTrack, watch: SkyWatch | None
) -> MemoryResidual | None:
    """Return how far a measurement is from a remembered state, as a turn about North, Up and East.

    None where it cannot be compared, or does not show the whole turn of its device.
    """
    state = filter_.predicted(memory, measurement.time_ns)
    found = filter_.linearisation.of(measurement, state.mean, state.covariance, {}, track, watch)
    if found is None or isinstance(found, NotCompared):
        return None
    linear, by_turn = found.compared.linear, found.compared.by_turn
    weighted = np.linalg.solve(linear.noise, by_turn)
    information = by_turn.T @ weighted
    if not np.linalg.eigvalsh(information)[0] >= _SEEN_RAD**-2:
        return None
    noise_v = np.linalg.inv(information)
    to_turn = found.compared.predicted_nv @ noise_v @ weighted.T
    by_state = to_turn @ linear.jacobian
    noise_n = found.compared.predicted_nv @ noise_v @ found.compared.predicted_nv.T
    expected, drift = by_state @ state.covariance @ by_state.T, by_state @ _drift(filter_, state) @ by_state.T
    return MemoryResidual(to_turn @ linear.residual, noise_n, expected, drift)


def departure_sigmas(filter_: ShipFilter, state: FilterState, memory: FilterState, is_later: bool) -> float:
    """Return the largest difference of a lasting state from the remembered one, in standard deviations of both.

    A later state of the same estimator knows all that the remembered one did: then in those of the latter.
    """
    if state.time_ns is None:
        return np.inf
    memory = filter_.predicted(memory, state.time_ns)
    rows = np.concatenate([filter_.model.rows(name) for name in filter_.model.slices if name.endswith(_LASTING)])
    variance = memory.covariance.diagonal()[rows] + (0.0 if is_later else state.covariance.diagonal()[rows])
    difference = np.abs(state.mean - memory.mean)[rows]
    # What is known exactly does not differ. Written so that NaN is compared.
    varies = variance != 0.0
    return float(np.max(difference[varies] / np.sqrt(variance[varies]), initial=0.0))


def is_undisputed(filter_: ShipFilter, state: FilterState, degraded_after: int) -> bool:
    """True if a state rests on stars, no source is excluded or contradicts another, and no jump is unconfirmed."""
    is_open = state.doubt is not None or state.disputed_n is not None or state.utc is not None
    if is_open or state.excluded or state.unconfirmed is not None:
        return False
    refused = max(state.refusals.values(), default=0)
    return newest_star_ns(filter_, state) is not None and refused < degraded_after


def _drift(filter_: ShipFilter, state: FilterState) -> np.ndarray:
    """Return the covariance that comes to a state within a second, shape (n, n)."""
    assert state.time_ns is not None
    before_ns = state.time_ns - SECOND_NS
    here = None if filter_.vertical is None else filter_.vertical.at(before_ns)
    before = changed(state, time_ns=before_ns, vertical=here, stack=np.zeros_like(state.stack))
    return filter_.predicted(before, state.time_ns).covariance

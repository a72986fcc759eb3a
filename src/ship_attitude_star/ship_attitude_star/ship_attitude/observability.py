"""Observability of the filter states: standard deviations relative to the prior, and unobservable combinations.

At constant heading only sums of INS error and installation errors are observable. An unobserved state keeps its prior
standard deviation. An unobserved combination keeps its prior standard deviation even if other combinations of its
states are known well. Standard deviations and combinations are computed from the filter covariance.
"""

from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.kalman.unobservable_combinations import unobservable_combinations
from ship_geometry.rotations import ARCSEC, FloatArray

_AXES = {
    "installation": ("forward", "up", "right"),
    "attitude": ("north", "up", "east"),
    "deflection": ("xi", "eta"),
    "time_offset": ("time_offset",),
}


class Observability(NamedTuple):
    """Observability of the states.

    Attributes:
        sigma_ratios: ratio of the current to the prior standard deviation, by state name; 1 if nothing was observed.
        unobservable_combinations: unobservable combinations of states, as texts with the state names.
    """

    sigma_ratios: dict[str, float]
    unobservable_combinations: tuple[str, ...]


def observability_of(filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState) -> Observability:
    """Return the observability of INS attitude, deflection, installations and clocks for a filter state.

    States with a prior standard deviation of 0 are omitted. Installations and clocks come first in the combinations.
    """
    names, rows, sigmas = [], [], []
    for block, sigma in _prior_sigmas(filter_, config).items():
        prefix, _, kind = block.rpartition(".")
        for axis, row, before in zip(_AXES[kind], filter_.model.state_indices(block).tolist(), sigma, strict=True):
            if before > 0.0:
                names.append(f"{prefix}.{axis}")
                rows.append(row)
                sigmas.append(float(before))
    before = np.array(sigmas)
    covariance = state.covariance[np.ix_(rows, rows)]
    sigma_ratios = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) / before
    return Observability(
        dict(zip(names, sigma_ratios.tolist(), strict=True)), unobservable_combinations(covariance, before, names)
    )


def _prior_sigmas(filter_: ShipFilter, config: ShipAttitudeConfig) -> dict[str, FloatArray]:
    """Return the prior standard deviations by block name, the devices first."""
    blocks = filter_.model.blocks
    own = [name for name in blocks if name.endswith((".installation", ".time_offset")) and not name.startswith("ins.")]
    found = {name: blocks[name].sigma for name in (*own, "ins.time_offset")}
    if config.models_deflection:
        found["gravity.deflection"] = np.full(2, config.gravity.unknown_sigma_arcsec * ARCSEC)
    return found | {"ins.attitude": blocks["ins.attitude"].sigma}

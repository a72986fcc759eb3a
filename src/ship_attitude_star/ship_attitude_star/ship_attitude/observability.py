"""What the data have told of each state of the filter against what was known before, and what they left open.

At constant heading only sums of the INS's error and of installation errors show. A state that the data have not told
keeps its sigma from before; a combination that they have not told keeps it although each of its sums with others may be
known well. Both are read from the covariance that the filter has anyway.
"""

from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.open_combinations import open_combinations
from ship_geometry.rotations import ARCSEC, FloatArray

_AXES = {
    "installation": ("forward", "up", "right"),
    "attitude": ("north", "up", "east"),
    "deflection": ("xi", "eta"),
    "time_offset": ("time_offset",),
}


class ToldStates(NamedTuple):
    """What the data have told.

    Attributes:
        left: by the name of a state, its sigma now over that from before: 1 where nothing was told.
        open: combinations of names that are as open as before.
    """

    left: dict[str, float]
    open: tuple[str, ...]


def learnt(filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState) -> ToldStates:
    """What the data have told of the INS's attitude, the deflection, installations and clocks by a state.

    States that are held, with a sigma of 0, are left out. Installations and clocks lead the combinations, so that the
    INS's error pairs with what is left.
    """
    names, rows, sigmas = [], [], []
    for block, sigma in _known_before(filter_, config).items():
        prefix, _, kind = block.rpartition(".")
        for axis, row, before in zip(_AXES[kind], filter_.model.rows(block).tolist(), sigma, strict=True):
            if before > 0.0:
                names.append(f"{prefix}.{axis}")
                rows.append(row)
                sigmas.append(float(before))
    before = np.array(sigmas)
    covariance = state.covariance[np.ix_(rows, rows)]
    left = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) / before
    return ToldStates(dict(zip(names, left.tolist(), strict=True)), open_combinations(covariance, before, names))


def _known_before(filter_: ShipFilter, config: ShipAttitudeConfig) -> dict[str, FloatArray]:
    """Sigma of each block before any data, by its name; those of the devices first."""
    blocks = filter_.model.blocks
    own = [name for name in blocks if name.endswith((".installation", ".time_offset")) and not name.startswith("ins.")]
    found = {name: blocks[name].sigma for name in (*own, "ins.time_offset")}
    if config.models_deflection:
        found["gravity.deflection"] = np.full(2, config.gravity.unknown_sigma_arcsec * ARCSEC)
    return found | {"ins.attitude": blocks["ins.attitude"].sigma}

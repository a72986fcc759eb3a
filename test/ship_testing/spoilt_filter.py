"""A filter of the ship's attitude that is certain of what is wrong: it does not come back by itself."""

import numpy as np

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.state import changed


def spoil(adapter: ShipAttitudeAdapter) -> None:
    """Make the filter certain of a heading error of the INS that is wrong by 1°."""
    core, model = adapter.core, adapter.core.filter.model
    mean = core.state.mean.copy()
    mean[model.slices["ins.attitude"]] += np.radians([0.0, 1.0, 0.0])
    start = core.filter.suspects.start(mean, 1e-4 * core.state.parts)
    core._shell.reset(changed(start, time_ns=core.state.time_ns, used_ns=core.state.used_ns))

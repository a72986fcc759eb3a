"""A filter of the ship's attitude with a wrong state of small variance, from which it does not recover by itself."""

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_estimation.fault_detection.exclusion import with_changes


def make_overconfident(adapter: ShipAttitudeAdapter) -> None:
    """Set a heading error of the INS that is wrong by 1°, with a small variance."""
    core, model = adapter.core, adapter.core.filter.model
    mean = core.state.mean.copy()
    mean[model.slices["ins.attitude"]] += np.radians([0.0, 1.0, 0.0])
    start = core.filter.fault_detector.initial_state(mean, 1e-4 * core.state.covariance_by_source)
    core._estimator.reset(with_changes(start, time_ns=core.state.time_ns, last_used_ns=core.state.last_used_ns))

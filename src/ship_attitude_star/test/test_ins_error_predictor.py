"""`InsErrorPredictor` predicts the INS errors between two estimates as the filter does."""

import math

import numpy as np
import pytest

from ship_attitude_star.ins_errors.process import own_error_matrix
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.smoothing import InsErrorPredictor
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.fault_detection.exclusion import with_changes
from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate
from ship_estimation.parameters.schema import build
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_stars.attitude_samples import PositionFix

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
DEFLECTION = {"deflection": "constant", "xi_arcsec": 12.0, "eta_arcsec": -7.0, "sigma_arcsec": 5.0}
STARS = {"star_sensors": {"fore": {"azimuth_deg": 0.0, "elevation_deg": 45.0, "flexure_sigma_arcsec": 3.0}}}


def filter_of(**values: object) -> ShipFilter:
    """Return the filter of a ship that sails North at 10 m/s; with a vertical there is a fix each second."""
    config = build(ShipAttitudeConfig, {**STARS, **values})
    vertical = VerticalTrack(config.gravity, config.sky) if config.needs_vertical else None
    for second in range(-10, 80 if vertical is not None else -10):
        place = GeodeticPosition(math.radians(40.0) + second * 10.0 / 6.37e6, math.radians(-66.0), 20.0)
        vertical.insert(PositionFix(START_NS + second * SECOND_NS, place, np.diag([0.01, 0.04, 0.01])))
    return ShipFilter(config, vertical)


CASES = {
    "gauss_markov": {},
    "deflection": {"gravity": DEFLECTION},
    "gravity": {"gravity": DEFLECTION, "horizon": "gravity"},
    "schuler": {"ins": {"model": "schuler"}},
    "schuler_deflection": {"ins": {"model": "schuler"}, "gravity": DEFLECTION},
}


@pytest.mark.parametrize("values", CASES.values(), ids=CASES)
def test_it_equals_the_prediction_of_the_filter(values: dict) -> None:
    filter_, rng = filter_of(**values), np.random.default_rng(4)
    start = filter_.propagate(filter_.initial_state(), START_NS)
    # The states are correlated as after measurements, and their means are not zero.
    mix = np.eye(filter_.model.size) + 0.2 * rng.standard_normal((filter_.model.size,) * 2)
    sigma = np.sqrt(start.covariance.diagonal())
    full = sigma[:, None] * (mix @ mix.T) * sigma
    stack = np.zeros_like(start.stack)
    stack[0], stack[len(start.covariance_by_source) :] = full, full
    state = with_changes(start, stack=stack, means=start.means + 0.3 * sigma * rng.standard_normal(len(sigma)))
    anchor = Anchor(START_NS, GaussianEstimate(state.mean, state.covariance), state.vertical)
    between = InsErrorPredictor(filter_, values.get("horizon") == "gravity")
    times_ns = [START_NS + round(second * SECOND_NS) for second in (0.0, 0.4, 7.3, 33.0, 61.9)]
    later = Anchor(times_ns[-1], anchor.estimate, None)
    found, cross = between.estimates_at(anchor, times_ns, later)
    assert cross is not None
    rows = np.r_[filter_.model.state_indices("ins.attitude"), filter_.model.state_indices("ins.time_offset")]
    for place, time_ns in enumerate(times_ns):
        there = filter_.propagate(state, time_ns)
        of_attitude = np.eye(filter_.model.size)[rows]
        if values.get("horizon") == "gravity":
            assert filter_.vertical is not None
            of_attitude[:3, filter_.model.process_indices[:5]] = own_error_matrix(filter_.vertical.at(time_ns))
        scale = np.sqrt((of_attitude @ there.covariance @ of_attitude.T).diagonal())
        np.testing.assert_allclose(found.mean[place] / scale, of_attitude @ there.mean / scale, atol=1e-9)
        expected = of_attitude @ there.covariance @ of_attitude.T / np.outer(scale, scale)
        np.testing.assert_allclose(found.covariance[place] / np.outer(scale, scale), expected, atol=1e-9)
        # At the times of both estimates, the covariance with the later estimate is known analytically.
        if place == len(times_ns) - 1:
            scales = scale[:, None] * sigma_of(there)
            np.testing.assert_allclose(cross[place] / scales, of_attitude @ there.covariance / scales, atol=1e-9)
        if place == 0:
            scales = scale[:, None] * sigma_of(filter_.propagate(state, times_ns[-1]))
            expected = of_attitude @ between.cross_to(anchor, later)
            np.testing.assert_allclose(cross[place] / scales, expected / scales, atol=1e-9)


def sigma_of(state: object) -> np.ndarray:
    sigma = np.sqrt(state.covariance.diagonal())
    return np.where(sigma > 0.0, sigma, 1.0)

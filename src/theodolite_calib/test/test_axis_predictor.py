"""States between two sightings: the filter's own prediction, and the joint distribution with the next sighting."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_testing.simulated_session import BEACONS_DEG, config
from theodolite_calib.smoothing import AxisStatePredictor, TracedFilter

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
TIMES_NS = [START_NS + round(second * SECOND_NS) for second in (0.0, 0.4, 7.3, 33.0, 61.9)]
TURNED = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
STATED_N = TURNED @ np.diag([4.0, 9.0, 1.0]) @ TURNED.T * ARCSEC**2
ERRORS = {
    "ship__slow_time_s": 40.0,
    "deformation__time_s": 25.0,
    "telescope__azimuth_sigma_arcsec": 3.0,
    "telescope__rotation_sigma_arcsec": 20.0,
    "ship_antenna__sigma_m": 0.01,
    **{f"beacons__{name}__rtk__bias_sigma_m": 0.02 for name in BEACONS_DEG},
}

# Factor of STATED_N at the sighting before, at the times between, and at the sighting after; None if not stated.
STATED = {
    "steady": (1.0, 1.0, 1.0),
    "slowly changing": (1.0, 1.3, 0.8),
    "ever since they came": (9.0, 0.5, 0.5),
    "from when they went": (1.0, 20.0, 20.0),
    "while they were gone": (1.0, 20.0, 1.0),
    "before the first": (None, 4.0, 1.0),
    "never": (None, None, None),
}


def stated_error(size: float | None) -> FloatArray | None:
    return None if size is None else size * STATED_N


def predictor_of(filter_: TracedFilter, size: float | None) -> AxisStatePredictor:
    return AxisStatePredictor(
        filter_, lambda times_ns: None if size is None else np.repeat(stated_error(size)[None], len(times_ns), 0)
    )


def correlated_state(filter_: TracedFilter, size: float | None):
    """Return a state as after sightings: correlated, with a mean other than zero."""
    rng, n = np.random.default_rng(4), filter_.model.size
    state = filter_.propagate(filter_.initial_state(), START_NS, stated_error(size))
    sigma = np.sqrt(state.covariance.diagonal())
    mix = np.eye(n) + 0.2 * rng.standard_normal((n, n))
    parts = np.zeros_like(state.covariance_by_source)
    parts[0] = sigma[:, None] * (mix @ mix.T) * sigma
    return replace(state, covariance_by_source=parts, mean=0.3 * sigma * rng.standard_normal(n))


@pytest.mark.parametrize("sizes", STATED.values(), ids=STATED)
def test_it_is_the_filters_prediction(sizes: tuple) -> None:
    before, between_sizes, after = sizes
    # If the INS is the ship source, the configuration states the ship's error.
    source = "ins/imu" if between_sizes is None else "ship/attitude"
    filter_ = TracedFilter(config(ship__source=source, **ERRORS))
    state = correlated_state(filter_, before)
    between = predictor_of(filter_, between_sizes)
    anchor = Anchor(START_NS, GaussianEstimate(state.mean, state.covariance), state.prediction_input)
    then = filter_.propagate(state, TIMES_NS[-1], stated_error(after))
    later = Anchor(TIMES_NS[-1], GaussianEstimate(then.mean, then.covariance), then.prediction_input)
    found, cross = between.estimates_at(anchor, TIMES_NS, later)
    scale = np.sqrt(then.covariance.diagonal())
    scale = np.where(scale > 0.0, scale, 1.0)
    for place, time_ns in enumerate(TIMES_NS):
        there = filter_.propagate(state, time_ns, stated_error(between_sizes))
        of_states = there.covariance[np.ix_(between.state_indices, between.state_indices)]
        sigma = np.sqrt(np.where(of_states.diagonal() > 0.0, of_states.diagonal(), 1.0))
        np.testing.assert_allclose(found.mean[place] / sigma, there.mean[between.state_indices] / sigma, atol=1e-9)
        both_sigmas = np.outer(sigma, sigma)
        np.testing.assert_allclose(found.covariance[place] / both_sigmas, of_states / both_sigmas, atol=1e-9)
        # The states at both times have a joint distribution for any stated size: no combination has a negative
        # variance.
        whole = np.block([[found.covariance[place], cross[place]], [cross[place].T, then.covariance]])
        both = np.concatenate([sigma, scale])
        assert np.linalg.eigvalsh(whole / np.outer(both, both))[0] > -1e-9
    if between_sizes == after:
        # At the later sighting, the cross-covariance equals the predicted covariance.
        np.testing.assert_allclose(
            cross[-1] / scale, then.covariance[between.state_indices] / scale, atol=1e-9 * scale.max()
        )
    if between_sizes == before:
        expected = between.cross_to(anchor, later)[between.state_indices]
        np.testing.assert_allclose(cross[0] / scale, expected / scale, atol=1e-9 * scale.max())


def test_before_the_first_sighting_the_errors_are_what_they_may_be() -> None:
    filter_ = TracedFilter(config(**ERRORS))
    initial = filter_.initial_state()
    first = filter_.propagate(initial, TIMES_NS[-1], stated_error(1.0))
    anchor = Anchor(None, GaussianEstimate(initial.mean, initial.covariance), initial.prediction_input)
    later = Anchor(TIMES_NS[-1], GaussianEstimate(first.mean, first.covariance), first.prediction_input)
    between = predictor_of(filter_, 1.0)
    found, cross = between.estimates_at(anchor, TIMES_NS, later)
    lasts_s = np.array([(TIMES_NS[-1] - time_ns) * 1e-9 for time_ns in TIMES_NS])
    axes = slice(6, 13)
    assert cross is not None
    for place, last_s in enumerate(lasts_s):
        expected = first.covariance[np.ix_(between.state_indices, between.state_indices)]
        np.testing.assert_allclose(found.covariance[place], expected, atol=1e-20)
        # The axes are constant; ship and deformation decay with their own time constants.
        np.testing.assert_allclose(cross[place, axes, axes], first.covariance[axes, axes])
        np.testing.assert_allclose(cross[place, :3, :3], np.exp(-last_s / 40.0) * STATED_N)
        np.testing.assert_allclose(cross[place, 3:6, 3:6], np.exp(-last_s / 25.0) * first.covariance[3:6, 3:6])


def test_time_before_a_jump_may_be_later_than_its_estimate() -> None:
    # The jump inflates the zero points. A state before the jump has only the earlier errors in common with the inflated
    # state.
    filter_ = TracedFilter(config(**ERRORS))
    state = correlated_state(filter_, 1.0)
    anchor = Anchor(START_NS, GaussianEstimate(state.mean, state.covariance), state.prediction_input)
    between, until_ns = predictor_of(filter_, 1.0), TIMES_NS[2]
    found, cross = between.estimates_at(anchor, [until_ns], anchor)
    there = filter_.propagate(state, until_ns, stated_error(1.0))
    np.testing.assert_allclose(
        found.covariance[0], there.covariance[np.ix_(between.state_indices, between.state_indices)], rtol=1e-9
    )
    decay, _ = filter_.model.transition((until_ns - START_NS) * 1e-9)
    np.testing.assert_allclose(
        cross[0], (decay[:, None] * state.covariance)[between.state_indices], rtol=1e-9, atol=1e-30
    )

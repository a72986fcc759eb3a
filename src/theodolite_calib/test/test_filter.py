"""Calibration filter: its Jacobian, its optimum against a batch least squares, its budget, its iteration."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_testing.simulated_session import BEACONS_DEG, config, session, sweep
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.samples import Exposure
from theodolite_calib.samples.sighting import Sighting

EVERYTHING = {
    "ship__source": "ins/imu",
    "axes__flexure_sigma_arcsec": 10.0,
    "telescope__azimuth_arcsec": 300.0,
    "telescope__elevation_arcsec": -200.0,
    "telescope__rotation_arcsec": 900.0,
    "telescope__azimuth_sigma_arcsec": 2.0,
    "telescope__elevation_sigma_arcsec": 2.0,
    "telescope__rotation_sigma_arcsec": 20.0,
    "telescope__principal_x_m": 2e-4,
    "telescope__lens__forward_m": 0.4,
    "telescope__lens__sigma_m": 0.01,
    "lever__sigma_m": 0.02,
    "ship_antenna__sigma_m": 0.01,
    "air__sigma": 0.06,
    "air__light_sigma": 0.03,
    **{
        f"beacons__{name}__{key}": value
        for name in BEACONS_DEG
        for key, value in {
            "rtk__bias_sigma_m": 0.02,
            "light__up_m": -0.4,
            "light__right_m": 0.2,
            "light__sigma_m": 0.01,
        }.items()
    },
}
"""Configuration with every state of the model."""


def sightings_of(settings, count: int, seed: int = 3) -> list[Sighting]:
    times_s = np.arange(float(count))
    return session(settings, seed, times_s, sweep(times_s)).sightings


def arrays_of(state: CalibrationState) -> list[FloatArray]:
    return [
        state.mean, state.covariance_by_source, state.observability, state.subfilters.mean, state.subfilters.covariances
    ]  # fmt: skip


@pytest.mark.parametrize("later_s", [0, 1])
def test_a_propagation_changes_nothing_in_place(later_s: int) -> None:
    """States are used again after late data. The stated covariance of the ship's error decreases by a step here."""
    filter_ = CalibrationFilter(config(**EVERYTHING))
    mean = np.arange(1.0, filter_.model.size + 1.0) * ARCSEC
    state = filter_.initial_state_from(mean, filter_.model.initial_covariance_by_source())
    state = filter_.propagate(state, SECOND_NS, np.diag(np.array([10.0, 72.0, 10.0]) * ARCSEC) ** 2)
    before = [array.copy() for array in arrays_of(state)]
    after = filter_.propagate(state, (1 + later_s) * SECOND_NS, (2.0 * ARCSEC) ** 2 * np.eye(3))
    ship = filter_.ship_error.columns
    assert np.all(np.abs(after.mean[ship]) < np.abs(state.mean[ship]))
    for array, earlier in zip(arrays_of(state), before, strict=True):
        np.testing.assert_array_equal(array, earlier)


def run_filter(filter_: CalibrationFilter, sightings: list[Sighting]) -> CalibrationState:
    state = filter_.initial_state()
    for sighting in sightings:
        predicted = filter_.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        comparison = filter_.compare(predicted, sighting)
        assert comparison is not None
        state, _ = filter_.update_by_beacons(predicted, sighting, comparison)
    return state


def test_there_is_a_state_for_every_error_that_lasts() -> None:
    names = set(CalibrationFilter(config(**EVERYTHING)).model.slices)
    own = {f"light.{name}.{state}" for name in BEACONS_DEG for state in ("rtk", "lever", "attitude", "refraction")}
    path = {"ship_antenna", "lever", "lens", "refraction"}
    chain = {"ship.attitude", "ship.time_offset", "deformation", "axes", "focal_length", "parallelism"}
    assert names == own | path | chain
    assert set(CalibrationFilter(config()).model.slices) == chain - {"ship.time_offset"}


@pytest.mark.parametrize("seed", [1, 2])
def test_the_jacobian_is_that_of_finite_differences(seed: int) -> None:
    settings = config(**EVERYTHING)
    filter_ = CalibrationFilter(settings)
    rng = np.random.default_rng(seed)
    (sighting,) = sightings_of(settings, 1, seed)
    ship = replace(sighting.ship, rate_d=np.array([0.05, 0.01, -0.02]))
    sighting = replace(sighting, ship=ship)
    sigma = np.sqrt(np.diagonal(filter_.initial_state().covariance))
    mean = 3.0 * sigma * rng.standard_normal(sigma.size)
    for name in BEACONS_DEG:
        # These errors are degrees, with a lever of centimetres. The Jacobian neglects that rotations do not add like
        # vectors.
        mean[filter_.model.slices[f"light.{name}.attitude"]] = 0.0
    found = filter_.sightings.predict(mean, sighting)
    for column, one in enumerate(sigma):
        if one == 0.0:
            continue
        step = np.zeros(sigma.size)
        step[column] = 0.1 * one
        ahead, behind = (filter_.sightings.predict(mean + s, sighting) for s in (step, -step))
        # The residual is measured minus predicted.
        numeric = (behind.residual - ahead.residual) / (2.0 * step[column])
        # The Jacobian neglects that a rotation of the main axis moves N' (0.4 m at 2 km: 2e-4), and that the distance
        # of a light changes its refraction.
        assert found.jacobian[:, column] == pytest.approx(numeric, abs=1e-3 * np.max(np.abs(numeric)) + 1e-12 / one)
        turned = log_rotation(ahead.rotation_nt @ behind.rotation_nt.T) / (2.0 * step[column])
        assert found.by_state_n[:, column] == pytest.approx(turned, abs=1e-6 * np.max(np.abs(turned)) + 1e-12)


def test_the_optimum_is_that_of_a_batch_least_squares() -> None:
    """scipy solves for all errors at all times as whitened unknowns; the last state equals the filter's."""
    settings = config(
        air__sigma=0.06,
        air__time_s=50.0,
        telescope__azimuth_sigma_arcsec=3.0,
        deformation__time_s=20.0,
        beacons__alpha__rtk__bias_sigma_m=0.02,
        ship_antenna__sigma_m=0.01,
    )
    filter_ = CalibrationFilter(settings)
    sightings = sightings_of(settings, 5)
    state = run_filter(filter_, sightings)

    model, steps = filter_.model, len(sightings)
    steady_n = sightings[0].ship.correlated_covariance_n
    assert steady_n is not None
    start = filter_.propagate(filter_.initial_state(), sightings[0].time_ns, steady_n)
    free = np.flatnonzero(np.diagonal(start.covariance) > 0.0)
    decay, noise = model.transition(1.0)
    driving = noise.copy()
    ship = model.slices["ship.attitude"]
    driving[ship] += (1.0 - decay[ship] ** 2) * np.diagonal(steady_n)
    driven = np.flatnonzero(driving > 0.0)
    first, fresh = np.sqrt(np.diagonal(start.covariance))[free], np.sqrt(driving)[driven]

    def states(x: FloatArray) -> list[FloatArray]:
        state_now = np.zeros(model.size)
        state_now[free] = first * x[: free.size]
        all_states = [state_now]
        for step in x[free.size :].reshape(steps - 1, driven.size):
            state_now = decay * state_now
            state_now[driven] += fresh * step
            all_states.append(state_now)
        return all_states

    noises = [filter_.sightings.predict(np.zeros(model.size), s).noise_by_source.values() for s in sightings]
    roots = [np.linalg.cholesky(sum(parts)) for parts in noises]

    def residuals(x: FloatArray) -> FloatArray:
        rows = [
            np.linalg.solve(root, filter_.sightings.predict(mean, sighting).residual)
            for mean, sighting, root in zip(states(x), sightings, roots, strict=True)
        ]
        return np.concatenate([*rows, x])

    unknowns = np.zeros(free.size + (steps - 1) * driven.size)
    found = least_squares(residuals, unknowns, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    sigma = np.sqrt(np.diagonal(state.covariance))
    expected = states(found.x)[-1]
    # Effects that are not linear in the errors are of the order of their squares: 1e-4 of a sigma.
    assert np.abs(state.mean - expected)[free] == pytest.approx(0.0, abs=2e-2 * np.max(sigma[free]))
    assert np.max(np.abs(state.mean - expected)[free] / sigma[free]) < 5e-3
    to_last = np.array([states(column)[-1] for column in np.eye(found.x.size)]).T
    covariance = to_last @ np.linalg.inv(found.jac.T @ found.jac) @ to_last.T
    assert sigma[free] == pytest.approx(np.sqrt(np.diagonal(covariance))[free], rel=2e-3)


def test_distant_start_converges_to_the_same_estimate() -> None:
    """The zero points are off by ten arcminutes; with one linearisation, their squares alone would give 1.7"."""
    far = {"axes__g_arcsec": 600.0, "axes__h_arcsec": -600.0}
    sigma = {"axes__g_sigma_arcsec": 1000.0, "axes__h_sigma_arcsec": 1000.0}
    sightings = sightings_of(config(**sigma), 3)
    off, near = (run_filter(CalibrationFilter(config(**start, **sigma)), sightings) for start in (far, {}))
    model = CalibrationFilter(config()).model
    g, h = model.state_indices("axes")[:2]
    moved = near.mean - off.mean
    # The prior holds each zero point back by a fraction (sigma / 1000")² of the 600".
    left = 600.0 * ARCSEC * np.diagonal(near.covariance)[[g, h]] / (1000.0 * ARCSEC) ** 2
    assert moved[[g, h]] / ARCSEC == pytest.approx([600.0, -600.0], abs=0.02 + 1.1 * np.max(left) / ARCSEC)
    assert off.covariance == pytest.approx(near.covariance, rel=0.05, abs=1e-3 * np.max(near.covariance))


def test_the_parts_are_the_covariance_of_a_filter_with_one() -> None:
    settings = config(**EVERYTHING)
    filter_ = CalibrationFilter(settings)
    sightings = sightings_of(settings, 5)
    state = run_filter(filter_, sightings)
    P = filter_.initial_state().covariance
    last_ns = sightings[0].time_ns
    means = filter_.initial_state()
    for sighting in sightings:
        decay, noise = filter_.model.transition((sighting.time_ns - last_ns) * 1e-9)
        P = decay[:, None] * P * decay + np.diag(noise)
        last_ns = sighting.time_ns
        predicted = filter_.propagate(means, sighting.time_ns, sighting.ship.correlated_covariance_n)
        comparison = filter_.compare(predicted, sighting)
        means, _ = filter_.update_by_beacons(predicted, sighting, comparison)
        after = filter_.sightings.predict(means.mean, sighting)
        H, R = after.jacobian, sum(after.noise_by_source.values())
        P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    sigma = np.sqrt(np.diagonal(P))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    assert (state.covariance - P) / np.outer(scale, scale) == pytest.approx(0.0, abs=1e-4)


def test_normalised_innovations_are_chi_square() -> None:
    """The NIS has 4 degrees of freedom; the filter's model is that of the simulation."""
    settings = config(beacons__alpha__rtk__bias_sigma_m=0.01, air__sigma=0.06)
    filter_ = CalibrationFilter(settings)
    step = SightingStep(settings, filter_)
    values = []
    for seed in range(4):
        state = filter_.initial_state()
        for sighting in sightings_of(settings, 60, seed):
            state, decision = step(state, sighting, Exposure(sighting.time_ns, ()))
            assert decision.accepted
            values.append(decision.nis)
    low, high = mean_nees_band(len(values), 4)
    assert low < np.mean(values) < high


@pytest.mark.parametrize("source", ["ship/attitude", "ins/imu"])
def test_subfilters_are_propagated_as_each_alone(source: str) -> None:
    """Two stacked states are propagated by a minute, with a changed ship error, and over a jump."""
    settings = config(**{**EVERYTHING, "ship__source": source})
    filter_ = CalibrationFilter(settings)
    alone = [run_filter(filter_, sightings_of(settings, 2, seed)) for seed in (3, 4)]
    both = replace(
        alone[0],
        mean=np.stack([a.mean for a in alone]),
        covariance_by_source=np.stack([a.covariance_by_source for a in alone]),
    )
    time_ns = alone[0].time_ns + 60_000_000_000
    stated_n = None if source == "ins/imu" else (ARCSEC * np.diag([3.0, 20.0, 3.0])) ** 2
    jump = EncoderJump(time_ns, ARCSEC * np.array([100.0, -50.0]), ARCSEC)
    later = filter_.inflate_covariance(filter_.propagate(both, time_ns, stated_n), jump)
    assert later.covariance.shape == (2, filter_.model.size, filter_.model.size)
    for index, state in enumerate(alone):
        one = filter_.inflate_covariance(filter_.propagate(state, time_ns, stated_n), jump)
        assert later.mean[index].tobytes() == one.mean.tobytes()
        assert later.covariance_by_source[index].tobytes() == one.covariance_by_source.tobytes()

"""Gate of the sightings: three beacons with a wrong one, runs of rejections, inflated covariances."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_geometry.mount.image import Image
from ship_geometry.rotations import ARCSEC, angle_between
from ship_testing.simulated_session import BEACONS_DEG, config, session, sweep
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.samples.samples import Exposure
from theodolite_calib.samples.sighting import Sighting

THREE_DEG = {**BEACONS_DEG, "charlie": (-2.0, 2.5)}
CHARLIE = {"beacons__charlie__rtk__bias_sigma_m": 0.0}
TIMES_S = np.arange(0.0, 30.0)


def shift_beacons(sighting: Sighting, shift_arcsec: np.ndarray) -> Sighting:
    """Return the sighting with beacons moved on the detector, arcseconds, shape (N, 2)."""
    image = Image(sighting.image.point_m + 0.1 * ARCSEC * shift_arcsec, sighting.image.sigma_m)
    return replace(sighting, image=image)


def exposure(sighting: Sighting) -> Exposure:
    return Exposure(sighting.time_ns, ())


@pytest.fixture(name="three")
def _three_beacons():
    settings = config(**CHARLIE)
    step = SightingStep(settings, CalibrationFilter(settings))
    given = session(settings, 2, TIMES_S, sweep(TIMES_S), beacons_deg=THREE_DEG).sightings
    state = CalibrationFilter(settings).initial_state()
    for sighting in given[:-1]:
        state, decision = step(state, sighting, exposure(sighting))
        assert decision.accepted
    return step, state, given[-1]


def test_decision_has_residual_covariance_and_noise(three) -> None:
    step, state, last = three
    _, decision = step(state, last, exposure(last))
    residual, covariance = decision.residual, decision.covariance
    assert float(residual @ np.linalg.solve(covariance, residual)) == pytest.approx(decision.nis)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), decision.sigma)
    # The difference is the covariance of the prediction and must be positive semidefinite.
    assert np.linalg.eigvalsh(covariance - decision.noise)[0] > -1e-6 * np.trace(covariance)
    assert np.trace(decision.noise) > 0.1 * np.trace(covariance)


@pytest.mark.parametrize("wrong", range(3))
def test_wrong_one_of_three_beacons_is_rejected(three, wrong: int) -> None:
    step, state, last = three
    shift = np.zeros((3, 2))
    shift[wrong] = [90.0, -60.0]
    after, decision = step(state, shift_beacons(last, shift), exposure(last))
    ((name, rejection),) = decision.rejected_parts
    assert name == last.names[wrong]
    assert rejection.reason is Reason.LIGHT_CONFLICT
    assert decision.accepted
    assert decision.reason is Reason.NONE
    others = [row for row in range(3) if row != wrong]
    alone, _ = step(state, last.select(others), exposure(last))
    assert after.mean.tobytes() == alone.mean.tobytes()
    assert after.light_count == 2


def test_two_wrong_of_three_leave_none(three) -> None:
    step, state, last = three
    after, decision = step(
        state, shift_beacons(last, np.array([[90.0, 0.0], [0.0, -120.0], [0.0, 0.0]])), exposure(last)
    )
    assert (after.mean.tobytes(), after.covariance_by_source.tobytes()) == (
        state.mean.tobytes(),
        state.covariance_by_source.tobytes(),
    )
    assert (after.time_ns, after.last_beacons_ns, after.consecutive_rejections) == (
        state.time_ns,
        state.last_beacons_ns,
        1,
    )
    assert decision.reason is Reason.LIGHT_CONFLICT
    assert not decision.accepted


def test_three_names_in_a_circle_are_put_right(three) -> None:
    step, state, last = three
    turned = replace(last, image=Image(last.image.point_m[[1, 2, 0]], last.image.sigma_m))
    after, decision = step(state, turned, exposure(last))
    assert decision.accepted
    assert decision.reason is Reason.LIGHT_CONFLICT
    assert after.mean.tobytes() == step(state, last, exposure(last))[0].mean.tobytes()


def displaced_sightings() -> list[Sighting]:
    times_s = np.arange(0.0, 60.0)
    return session(config(), 4, times_s, sweep(times_s)).sightings


def step_after_slip(lights: tuple[int, ...] = (0,), **gate: float):
    """Return states and decisions; the encoder slips by 600" at 30 s, and one beacon cannot isolate the fault."""
    settings = config(**gate)
    filter_ = CalibrationFilter(settings)
    step, state, found = SightingStep(settings, filter_), filter_.initial_state(), []
    for k, sighting in enumerate(displaced_sightings()):
        encoder = sighting.encoder
        if k >= 30:
            encoder = replace(encoder, azimuth=encoder.azimuth + 600.0 * ARCSEC)
        seen = sighting.select(list(lights)) if k >= 30 else sighting
        state, decision = step(state, replace(seen, encoder=encoder), exposure(sighting))
        found.append((state, decision))
    return found


@pytest.mark.parametrize("row", range(3))
def test_nan_beacon_fails_the_gate(three, row: int) -> None:
    step, state, last = three
    for field in ("point_m", "sigma_m"):
        values = np.array(getattr(last.image, field), dtype=float)
        values[row] = np.nan
        wrong = replace(last, image=replace(last.image, **{field: values}))
        assert_excluded(step, state, wrong, row)


def assert_excluded(step, state, wrong: Sighting, row: int) -> None:
    for sighting in (wrong, wrong.select([row]), wrong.select([row, (row + 1) % 3])):
        after, decision = step(state, sighting, exposure(sighting))
        assert np.isfinite(after.mean).all()
        assert np.isfinite(after.covariance_by_source).all()
        used = [name for name in sighting.names if name not in {name for name, _ in decision.rejected_parts}]
        assert not decision.accepted or wrong.names[row] not in used


def test_run_of_rejections_is_a_conflict_and_keeps_the_estimate() -> None:
    found = step_after_slip()
    reasons = [decision.reason for _, decision in found]
    assert reasons[:30] == [Reason.NONE] * 30
    assert reasons[30:39] == [Reason.GATE] * 9
    assert set(reasons[39:]) == {Reason.ATTITUDE_CONFLICT}
    assert found[-1][1].text.startswith("30 rejections in a row: lights are inconsistent with encoders and ship")
    assert found[-1][0].mean.tobytes() == found[29][0].mean.tobytes()
    assert [state.consecutive_rejections for state, _ in found[28:33]] == [0, 0, 1, 2, 3]


def test_covariance_is_inflated_after_rejections_if_configured() -> None:
    found = step_after_slip(gate__reopen_after=10, gate__reopen_factor=1e4)
    reasons = [decision.reason for _, decision in found]
    assert "covariance inflated by 10000" in found[39][1].text
    assert set(reasons[45:]) == {Reason.NONE}
    # For the same encoder readings, the estimated axis has moved by the slip of the encoders.
    settings, elevation = config(), sweep(np.array([59.0]))[0, 1]
    sightings, last = CalibrationFilter(settings).sightings, displaced_sightings()[-1]
    before, after = (sightings.predict(found[k][0].mean, last).rotation_nt[:, 0] for k in (29, -1))
    turned = float(angle_between(before, after))
    assert turned / ARCSEC == pytest.approx(600.0 * np.cos(elevation), rel=0.05)

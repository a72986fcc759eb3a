"""Sessions from the first beacon to long after the last, over seeds: errors, covariances, unobservable combinations."""

import functools
from dataclasses import dataclass

import numpy as np
import pytest

from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_testing.consistency import sigma_ratio_band
from ship_testing.simulated_session import BEACONS_DEG, Session, config, session, sweep
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.output import CorrectedAxis, PendingPointing
from theodolite_calib.samples.samples import EncoderSample, Exposure
from theodolite_calib.samples.sighting import Sighting

SEEDS = 16
SWEEP_S = np.arange(0.0, 301.0)
AFTER_S = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 600.0])
INS_SIGMA_N = ARCSEC * np.array([10.0, 72.0, 10.0])

# 2" of refraction at 30° of elevation and 2 km, as a coefficient.
REFRACTION = 2.0 * ARCSEC / (2000.0 * np.cos(np.deg2rad(30.0)) / (2.0 * 6_371_000.0))


def each_light(**values: float) -> dict[str, float]:
    return {f"beacons__{name}__{key}": value for name in BEACONS_DEG for key, value in values.items()}


def on_sky(error_n: FloatArray, axis_n: FloatArray) -> float:
    """Return the error of an axis as an angle on the sky, arcseconds."""
    return float(np.linalg.norm(np.cross(error_n, axis_n))) / ARCSEC


def sigma_on_sky(covariance_n: FloatArray, axis_n: FloatArray) -> float:
    return float(np.sqrt(np.trace(covariance_n) - axis_n @ covariance_n @ axis_n)) / ARCSEC


def run_filter(
    settings: OpticalAxisConfig, filter_: CalibrationFilter, session: Session, count: int
) -> CalibrationState:
    state, step = filter_.initial_state(), SightingStep(settings, filter_)
    for sighting in session.sightings[:count]:
        state, _ = step(state, sighting, Exposure(sighting.time_ns, ()))
    return state


@dataclass(frozen=True)
class AxisAt:
    """Main axis at one time: horizon from main frame, and its covariance by source, rad²."""

    rotation_nm: FloatArray
    parts_n: FloatArray


def axis_at(filter_: CalibrationFilter, state: CalibrationState, sighting: Sighting, noise: float) -> AxisAt:
    """Return the main axis of a state at the time of a sighting; ``noise`` is the variance of the encoders, rad²."""
    angles = np.array([sighting.encoder.azimuth, sighting.encoder.elevation])
    reading = EncoderSample(sighting.time_ns, angles, float(np.sqrt(noise)))
    axes = CorrectedAxis(filter_, state).axes([PendingPointing(reading, sighting.ship, "", 0.0, state)])
    return AxisAt(axes.rotation_nm[0], axes.covariance_by_source_n[0])


@dataclass(frozen=True)
class ErrorsAfterBeacons:
    """Errors after the last beacons, arcseconds on the sky, shape (seeds, times)."""

    error: FloatArray
    sigma: FloatArray
    uncalibrated: FloatArray


@functools.cache
def coast_without_beacons() -> ErrorsAfterBeacons:
    """Return errors after a sweep of five minutes with two beacons at 1 Hz; the mount continues without beacons."""
    settings = config(air__sigma=0.06, **each_light(rtk__sigma_m=0.027))
    filter_ = CalibrationFilter(settings)
    times_s = np.concatenate([SWEEP_S, SWEEP_S[-1] + 1e-3 + AFTER_S])
    rows = []
    for seed in range(SEEDS):
        given = session(settings, seed, times_s, sweep(times_s))
        state = run_filter(settings, filter_, given, len(SWEEP_S))
        ins_error_n = INS_SIGMA_N * np.random.default_rng(1000 + seed).standard_normal(3)
        for k in range(len(SWEEP_S), len(times_s)):
            sighting, truth_nm = given.sightings[k], given.rotation_nm[k]
            axis = axis_at(filter_, state, sighting, sighting.encoder.noise)
            error_n = log_rotation(truth_nm @ axis.rotation_nm.T)
            encoder = sighting.encoder
            ins_nd = exp_rotation(-ins_error_n) @ sighting.ship.rotation_nd
            alone_nm = ins_nd @ main_axis_rotation(AxisErrors(), encoder.azimuth, encoder.elevation)
            rows.append(
                (
                    on_sky(error_n, truth_nm[:, 0]),
                    sigma_on_sky(axis.parts_n.sum(axis=0), truth_nm[:, 0]),
                    on_sky(log_rotation(truth_nm @ alone_nm.T), truth_nm[:, 0]),
                )
            )
    return ErrorsAfterBeacons(*np.moveaxis(np.array(rows).reshape(SEEDS, len(AFTER_S), 3), -1, 0))


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
def test_pointing_after_the_last_beacons() -> None:
    """Independent figures: 7.9" over the first 30 s, 29.7" after ten minutes, to which the deformation contributes
    26.3"."""
    left = coast_without_beacons()
    assert rms(left.sigma[:, :7]) < 8.5
    assert rms(left.sigma[:, 7]) == pytest.approx(29.7, rel=0.02)
    # Each session counts as one error of two components, because errors of one session are correlated.
    low, high = sigma_ratio_band(2 * SEEDS)
    for index in (0, 6, 7):
        assert low < rms(left.error[:, index] / left.sigma[:, index]) < high
    assert rms(left.error[:, :7]) < 8.5 * high
    assert rms(left.error[:, 7]) < 31.0 * high


@pytest.mark.slow
def test_better_than_the_ins_and_an_uncalibrated_encoder() -> None:
    left = coast_without_beacons()
    assert rms(left.uncalibrated[:, :7]) > 9.0 * rms(left.sigma[:, :7])
    assert rms(left.uncalibrated[:, 7]) > 2.4 * rms(left.sigma[:, 7])


TEN_SECONDS = {
    # A constant deformation with a wide prior stands for an unknown attitude; a varying one is not part of this test.
    "deformation__sigma_arcsec": 60.0,
    "deformation__time_s": 1e7,
    "ship__white_sigma_arcsec": 0.0,
    "encoder__sigma_arcsec": 0.0,
    "ship__slow_time_s": 1e7,
    **{f"axes__{name}_sigma_arcsec": 0.0 for name in ("g", "h", "c", "I", "beta_x", "beta_y")},
    "air__light_sigma": REFRACTION,
}
NEW_EACH_TIME = {**TEN_SECONDS, "air__time_s": 0.0, **each_light(rtk__sigma_m=0.027)}
THE_SAME_ALL_ALONG = {
    **TEN_SECONDS,
    "air__time_s": 1e7,
    **each_light(rtk__sigma_m=1e-4, rtk__bias_sigma_m=0.027, rtk__bias_time_s=1e7),
}


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("changes", "low", "high"),
    [
        # Independent figures: 0.345" from a hundredth of the variance of one epoch, and 3.2" ± 5 %.
        (NEW_EACH_TIME, 0.33, 0.37),
        (THE_SAME_ALL_ALONG, 3.04, 3.36),
    ],
    ids=["new each time", "the same all along"],
)
def test_ten_seconds_of_beacons_match_their_covariance(changes: dict[str, float], low: float, high: float) -> None:
    settings = config(**changes)
    filter_ = CalibrationFilter(settings)
    times_s = np.arange(0.0, 10.0, 0.1)
    encoder = np.tile(np.deg2rad([70.0, 30.0]), (len(times_s), 1))
    seeds, ratios = 20, []
    for seed in range(seeds):
        # The ship is at rest: roll would separate constant errors in the horizon from constant errors in the deck.
        given = session(settings, seed, times_s, encoder, ship_sigma_n=np.zeros(3), motion_scale=0.0)
        state = run_filter(settings, filter_, given, len(times_s))
        last = given.sightings[-1]
        axis = axis_at(filter_, state, last, 0.0)
        truth_nm = given.rotation_nm[-1]
        sigma = sigma_on_sky(axis.parts_n.sum(axis=0), truth_nm[:, 0])
        assert low < sigma < high
        ratios.append(on_sky(log_rotation(truth_nm @ axis.rotation_nm.T), truth_nm[:, 0]) / sigma)
    least, greatest = sigma_ratio_band(2 * seeds)
    assert least < rms(np.array(ratios)) < greatest


THREE = {"g - deformation_up", "beta_y - deformation_bow", "beta_x + deformation_starboard"}


def unobservable_after(low_deg: float, high_deg: float, **changes: float) -> set[str]:
    settings = config(air__sigma=0.06, **each_light(rtk__sigma_m=0.027), **changes)
    filter_ = CalibrationFilter(settings)
    given = session(settings, 1, SWEEP_S, sweep(SWEEP_S, low_deg, high_deg))
    return set(
        filter_.observability.unobservable_combinations(
            run_filter(settings, filter_, given, len(SWEEP_S)).observability
        )
    )


def test_exactly_three_combinations_are_unobservable_after_a_full_sweep() -> None:
    assert unobservable_after(10.0, 70.0) == THREE


def test_a_narrow_range_of_elevation_leaves_the_valley_of_c_I_and_g() -> None:
    (valley,) = unobservable_after(20.0, 30.0) - THREE
    # The three errors change only the azimuth, by -g - c / cos E - I tan E. About 25° this is zero to first order in
    # the range for g : c : I = 1 : -1.1 : 0.47; the curvature changes the result slightly.
    assert valley == "g - c + 0.46 I"


def test_fixed_errors_are_not_reported() -> None:
    held = {"axes__c_sigma_arcsec": 0.0}
    assert unobservable_after(20.0, 30.0, **held) == THREE


def test_all_is_unobservable_before_the_first_beacon() -> None:
    filter_ = CalibrationFilter(config())
    names = filter_.observability.unobservable_combinations(filter_.initial_state().observability)
    assert set(names) == {
        *("g", "h", "c", "I", "beta_x", "beta_y"),
        *("deformation_bow", "deformation_up", "deformation_starboard"),
    }


def test_a_principal_point_off_its_place_is_seen_by_no_innovation_but_is_in_the_budget() -> None:
    """60 mm at 2 km are 6.2"."""
    settings = config(telescope__lens__sigma_m=0.06, **each_light(rtk__sigma_m=0.005))
    filter_ = CalibrationFilter(settings)
    step = SightingStep(settings, filter_)
    times_s = np.arange(0.0, 60.0)
    given = session(settings, 5, times_s, sweep(times_s), lens_error_m=np.array([0.0, 0.06, 0.0]))
    state, values = filter_.initial_state(), []
    for sighting in given.sightings:
        state, decision = step(state, sighting, Exposure(sighting.time_ns, ()))
        values.append(decision.nis)
    assert np.mean(values) < 5.0  # 4 degrees of freedom
    last = given.sightings[-1]
    axis = axis_at(filter_, state, last, last.encoder.noise)
    source = filter_.model.sources.index("principal_point")
    assert sigma_on_sky(axis.parts_n[source], axis.rotation_nm[:, 0]) > 6.0
    error = on_sky(log_rotation(given.rotation_nm[-1] @ axis.rotation_nm.T), axis.rotation_nm[:, 0])
    assert error > 4.0

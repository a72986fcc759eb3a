"""Faulty sources are detected, isolated, excluded and reinstated; meanwhile no VALID attitude errs by five sigmas.

A ship rolls, pitches and turns. Her INS has rates or not, and she has one to four star sensors. The truth is computed
from formulas. The errors are random with the sigmas of the filter.
"""

import bisect
import copy
import copyreg
import functools
import os
import random
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.faults.fault_detection import ShipFaultDetector
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_estimation.fault_detection.subfilters import filter_covariances
from ship_estimation.integrity.protection_levels import IntegrityReport, IntegrityState
from ship_estimation.parameters.schema import ParameterError, build
from ship_estimation.plausibility.checked_ins import InsJump
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeMeasurement

INS_NS, STAR_NS = SECOND_NS // 20, SECOND_NS // 5
AZIMUTH_DEG = {"aft": 240.0, "bow": 0.0, "port": 120.0, "stern": 180.0}
THREE, FOUR = ("aft", "bow", "port"), ("aft", "bow", "port", "stern")
TWO: dict[str, Any] = {"sensors": ("bow", "port"), "ins": {"time_offset_sigma_s": 0.005}}
"""Two star sensors, and an INS whose clock offset is estimated."""
WITH_PAIRS = {"integrity": {"pairs": True, "max_hypotheses": 16}}
PAIR_SEEDS = range(int(os.environ.get("FAULT_SEEDS", "1")))
"""Seeds of the voyages with two mounting shifts; ``make campaign`` sets FAULT_SEEDS to take more."""

NOISE = np.array([100.0, 3.0, 3.0]) * ARCSEC
UP = np.array([0.0, 1.0, 0.0])
MIRROR = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class InjectedError:
    """An injected error.

    Attributes:
        source: ``ins``, ``ins.clock``, ``ins.axes``, a star sensor, or ``sky`` for all stars.
        turn: rotation vector, rad: of a star sensor in its frame, otherwise in the horizon frame. For ``ins.clock`` the
            first number is the step, s. Any nonzero vector for ``ins.axes`` changes the signs of heading and roll.
        start_s: start of the error, s.
        end_s: end of the error, s.
        per_s: True if ``turn`` is the change per second.
    """

    source: str
    turn: FloatArray
    start_s: float
    end_s: float = 1e9
    per_s: bool = False

    def error_at(self, seconds: float) -> FloatArray:
        if not self.start_s <= seconds < self.end_s:
            return np.zeros(3)
        return self.turn * ((seconds - self.start_s) if self.per_s else 1.0)


def configuration(sensors: tuple[str, ...], **changes: Any) -> ShipAttitudeConfig:
    stars = {name: {"azimuth_deg": AZIMUTH_DEG[name], "elevation_deg": 45.0} for name in sensors}
    return build(ShipAttitudeConfig, {"star_sensors": stars, "ins": {"time_offset_sigma_s": 0.0}, **changes})


def truth(seconds: float) -> FloatArray:
    roll, pitch = 0.09 * np.sin(0.7 * seconds), 0.04 * np.sin(0.9 * seconds + 1.0)
    return rotation_from_angles(0.3 + 0.005 * seconds, pitch, roll)


def rate_d(seconds: float) -> FloatArray:
    step = 1e-4
    return log_rotation(truth(seconds - step).T @ truth(seconds + step)) / (2.0 * step)


@functools.cache
def voyage(
    sensors: tuple[str, ...], error_indices: tuple[int, ...], seconds: float, seed: int, rates: bool
) -> list[tuple[int, Any]]:
    """Return pairs of true time, ns, and INS sample or star measurement, in the order of time."""
    rng, config = np.random.default_rng(seed), configuration(sensors)
    errors = [ERRORS[number] for number in error_indices]
    mounting = {name: exp_rotation(np.array([20.0, 1.0, 1.0]) * ARCSEC * rng.standard_normal(3)) for name in sensors}
    slow_n = np.array([10.0, 72.0, 10.0]) * ARCSEC * rng.standard_normal(3)
    time_s, decay = np.array([1800.0, 10800.0, 1800.0]), INS_NS / SECOND_NS
    arrivals: list[tuple[int, Any]] = []
    for step in range(int(seconds * SECOND_NS / INS_NS)):
        time_ns, now_s = step * INS_NS, step * INS_NS / SECOND_NS
        slow_n = slow_n * np.exp(-decay / time_s) + np.array([10.0, 72.0, 10.0]) * ARCSEC * np.sqrt(
            1.0 - np.exp(-2.0 * decay / time_s)
        ) * rng.standard_normal(3)
        fault_n = sum((error.error_at(now_s) for error in errors if error.source == "ins"), np.zeros(3))
        error_n = slow_n + ARCSEC * rng.standard_normal(3)
        rotation = exp_rotation(-error_n) @ exp_rotation(fault_n) @ truth(now_s)
        rate = rate_d(now_s)
        if any(injected.error_at(now_s).any() for injected in errors if injected.source == "ins.axes"):
            rotation, rate = MIRROR @ rotation @ MIRROR, -MIRROR @ rate
        clock_s = sum(injected.error_at(now_s)[0] for injected in errors if injected.source == "ins.clock")
        stamp_ns = time_ns + round(clock_s * SECOND_NS)
        arrivals.append((time_ns, AttitudeSample(stamp_ns, rotation, rate if rates else None)))
    for index, name in enumerate(sensors):
        phase_ns = 7_000_000 + index * 61_000_000
        for time_ns in range(phase_ns, int((seconds - 0.2) * SECOND_NS), STAR_NS):
            now_s = time_ns / SECOND_NS
            fault_v = sum((one.error_at(now_s) for one in errors if one.source == f"star.{name}"), np.zeros(3))
            sky_n = sum((injected.error_at(now_s) for injected in errors if injected.source == "sky"), np.zeros(3))
            rotation_dv = config.star_sensors[name].rotation_ds @ mounting[name]
            rotation_nv = exp_rotation(sky_n) @ truth(now_s) @ rotation_dv @ exp_rotation(fault_v)
            rotation_nv = rotation_nv @ exp_rotation(NOISE * rng.standard_normal(3))
            arrivals.append((time_ns, AttitudeMeasurement(f"star.{name}", time_ns, rotation_nv, np.diag(NOISE**2))))
    return sorted(arrivals, key=lambda arrival: arrival[0])


@dataclass
class VoyageResult:
    """A core after a voyage, its estimates, changes of the exclusions, integrity reports and reasons of decisions."""

    core: ShipAttitudeCore
    estimates: list[AttitudeEstimate]
    excluded: list[tuple[float, tuple[str, ...]]]
    reports: list[tuple[IntegrityReport, AttitudeEstimate]]
    reasons: list[tuple[str, Reason]]

    def copy(self) -> "VoyageResult":
        """Return an independent copy."""
        lists = self.estimates[:], self.excluded[:], self.reports[:], self.reasons[:]
        return VoyageResult(copy.deepcopy(self.core), *lists)

    def first_exclusion(self) -> tuple[float, tuple[str, ...]]:
        return next(entry for entry in self.excluded if entry[1])

    def estimates_between(self, start_s: float, end_s: float) -> list[AttitudeEstimate]:
        return [one for one in self.estimates if start_s <= one.time_ns / SECOND_NS < end_s]


def run_core(core: ShipAttitudeCore, arrivals: list[tuple[int, Any]]) -> VoyageResult:
    return continue_run(VoyageResult(core, [], [(0.0, ())], [], []), arrivals)


def continue_run(result: VoyageResult, arrivals: list[tuple[int, Any]]) -> VoyageResult:
    core = result.core
    for time_ns, input_ in arrivals:
        add = core.ins.add if isinstance(input_, AttitudeSample) else core.add_measurement
        outcome = add(input_)
        result.estimates += outcome.estimates
        result.reasons += [(decision.measurement.source, decision.reason) for decision in outcome.decisions]
        excluded = tuple(sorted(core.state.excluded))
        if excluded != result.excluded[-1][1]:
            result.excluded.append((time_ns / SECOND_NS, excluded))
        if outcome.estimates and outcome.estimates[-1].time_ns % SECOND_NS == 0:
            result.reports.append((core.integrity(outcome.estimates[-1]), outcome.estimates[-1]))
    return result


ERRORS: list[InjectedError] = []
RUNS_BEFORE_ERRORS: dict[str, VoyageResult] = {}
"""The newest three runs up to the first injected error, for tests that differ only after it; each run is large."""
copyreg.pickle(MappingProxyType, lambda mapping: (MappingProxyType, (dict(mapping),)))  # lets deepcopy copy states


def run_with_errors(
    *errors: InjectedError,
    sensors: tuple[str, ...] = ("aft", "bow", "port"),
    seconds: float = 60.0,
    seed: int = 1,
    rates: bool = True,
    **changes: Any,
) -> VoyageResult:
    numbers = tuple(range(len(ERRORS), len(ERRORS) + len(errors)))
    ERRORS.extend(errors)
    arrivals = voyage(sensors, numbers, seconds, seed, rates)
    start_s = min((error.start_s for error in errors), default=0.0)
    before = bisect.bisect_left(arrivals, start_s * SECOND_NS, key=lambda arrival: arrival[0])
    key = repr((start_s, sensors, seconds, seed, rates, changes))
    if key not in RUNS_BEFORE_ERRORS:
        if len(RUNS_BEFORE_ERRORS) >= 3:
            del RUNS_BEFORE_ERRORS[next(iter(RUNS_BEFORE_ERRORS))]
        RUNS_BEFORE_ERRORS[key] = run_core(ShipAttitudeCore(configuration(sensors, **changes)), arrivals[:before])
    return continue_run(RUNS_BEFORE_ERRORS[key].copy(), arrivals[before:])


def error_sigmas(estimate: AttitudeEstimate) -> float:
    """Largest error of heading, pitch and roll, in sigmas."""
    return float(np.max(np.abs(errors(estimate)) / np.sqrt(np.diagonal(angle_covariance_of(estimate)))))


def errors(estimate: AttitudeEstimate) -> FloatArray:
    error_n = log_rotation(truth(estimate.time_ns / SECOND_NS) @ estimate.rotation_nd.T)
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    return angle_errors_from_rotation_vector(heading, pitch) @ error_n


def angle_covariance_of(estimate: AttitudeEstimate) -> FloatArray:
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    to_angles = angle_errors_from_rotation_vector(heading, pitch)
    return to_angles @ estimate.covariance_n @ to_angles.T


def assert_consistent(sailed: VoyageResult) -> None:
    """Assert that the error of no VALID attitude exceeds five sigmas or the protection level."""
    valid = [one for one in sailed.estimates if one.status is Status.VALID]
    assert max(error_sigmas(one) for one in valid) < 5.0
    assert_within_levels(sailed)


def assert_within_levels(sailed: VoyageResult) -> None:
    for report, estimate in sailed.reports:
        if estimate.status is Status.VALID and report.state is not IntegrityState.UNAVAILABLE:
            assert np.all(np.abs(errors(estimate)) <= report.level)


@pytest.mark.statistics
@pytest.mark.parametrize("sensors", [("aft", "bow", "port"), ("bow", "port")], ids=["three", "two"])
@pytest.mark.parametrize("seed", range(2))
def test_no_source_is_excluded_without_a_fault(sensors: tuple[str, ...], seed: int) -> None:
    sailed = run_with_errors(sensors=sensors, seconds=120.0, seed=seed)
    assert sailed.excluded == [(0.0, ())]
    assert {one.status for one in sailed.estimates_between(1.0, 120.0)} == {Status.VALID}
    assert_consistent(sailed)
    assert all(report.state is IntegrityState.NO_LIMIT for report, _ in sailed.reports[2:])


@pytest.mark.slow
@pytest.mark.parametrize("shift_arcsec", [10.0, 20.0, 50.0, 300.0])
@pytest.mark.parametrize("name", ["aft", "bow", "port"])
def test_a_sensor_with_a_mounting_shift_is_reported_and_excluded(name: str, shift_arcsec: float) -> None:
    shift = InjectedError(f"star.{name}", np.array([0.0, 1.0, 0.0]) * shift_arcsec * ARCSEC, start_s=30.0)
    sailed = run_with_errors(shift, seconds=60.0)
    since_s, excluded = sailed.first_exclusion()
    assert excluded == (f"star.{name}",)
    # A shift of 10″ is three sigmas of one measurement: only the mean of several measurements shows the shift.
    assert 30.0 < since_s < (35.0 if shift_arcsec < 15.0 else 31.5)
    assert_consistent(sailed)


@pytest.mark.slow
def test_after_a_mounting_shift_the_mounting_is_estimated_again_and_after_a_glitch_it_is_kept() -> None:
    turn = np.array([0.0, 0.0, 40.0]) * ARCSEC
    for error in (InjectedError("star.bow", turn, 20.0), InjectedError("star.bow", turn, 20.0, end_s=22.0)):
        sailed = run_with_errors(error, seconds=120.0)
        assert [names for _, names in sailed.excluded] == [(), ("star.bow",), ()]
        came_back_s = sailed.excluded[-1][0]
        assert came_back_s - (22.0 if error.end_s < 1e9 else 20.0) >= 60.0
        assert "star.bow" in sailed.estimates[-1].sources
        learnt, sigma = estimated_mounting(sailed, "star.bow")
        # The true mounting error of 1″ is part of the difference. One sigma of the estimate is 0.9″.
        assert abs(learnt[2] - (turn[2] if error.end_s == 1e9 else 0.0)) < 4.0 * sigma[2] < 4.0 * ARCSEC
        assert_consistent(sailed)


@pytest.mark.slow
def test_a_drifting_sensor_of_three_is_isolated_with_twice_the_reinstatement_time_the_second_time() -> None:
    """Two of 24 other voyages have one VALID attitude in 4800 beyond five sigmas, at most at 5.05."""
    drift = InjectedError("star.port", UP * 10.0 / 60.0 * ARCSEC, 20.0, per_s=True)
    sailed = run_with_errors(drift, seconds=145.0, seed=5, integrity={"return_after_s": 20.0})
    assert [names for _, names in sailed.excluded] == [(), ("star.port",), (), ("star.port",), ()]
    excluded_s, returned_s, again_s, back_s = (seconds for seconds, _ in sailed.excluded[1:])
    # The sensor is consistent as soon as its mounting is estimated again; its measurements are 0.2 s apart.
    assert 20.0 <= returned_s - excluded_s < 20.4
    assert 40.0 <= back_s - again_s < 40.4
    assert sailed.core.state.exclusion_counts == {"star.port": 2}
    assert_consistent(sailed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 9])
def test_a_drifting_sensor_of_two_is_an_unresolved_fault_or_isolated_correctly(seed: int) -> None:
    """The other sensor and an INS that drifts by as much nearly explain the data: isolation may take minutes.

    With a ``_CHI2_MARGIN`` of 0.4 the other sensor was isolated in these two voyages.
    """
    drift = InjectedError("star.port", UP * 5.0 / 60.0 * ARCSEC, 20.0, per_s=True)
    sailed = run_with_errors(drift, sensors=("bow", "port"), seconds=170.0, seed=seed)
    assert {names for _, names in sailed.excluded} <= {(), ("star.port",)}
    unresolved = [one for one in sailed.estimates_between(20.0, 170.0) if one.status is Status.DEGRADED]
    # The fault is unresolved for at least half a minute, and the covariance covers it.
    assert len(unresolved) * INS_NS > 30 * SECOND_NS
    assert max(error_sigmas(one) for one in unresolved) < 5.0
    assert_consistent(sailed)


def test_all_stars_against_an_ins_without_rates_are_an_unresolved_fault_with_covariance() -> None:
    step = InjectedError("ins", np.array([0.0, 100.0, 0.0]) * ARCSEC, 30.0)
    sailed = run_with_errors(step, seconds=60.0, rates=False, ins={"jump_samples": 1000, "time_offset_sigma_s": 0.0})
    # The unresolved fault begins with the first star measurement after the step.
    later = sailed.estimates_between(30.1, 60.0)
    assert {one.status for one in later} == {Status.DEGRADED}
    assert max(error_sigmas(one) for one in sailed.estimates_between(32.0, 60.0)) < 3.0


@pytest.mark.parametrize("after", [2, 6])
@pytest.mark.parametrize(("source", "rates"), [("ins", False), ("sky", True)])
def test_the_configured_number_of_rejections_of_all_stars_excludes_them(
    source: str, rates: bool, after: int
) -> None:
    """The two sensors measure 61 ms apart; a measurement is evaluated up to 0.1 s later, after the next INS samples."""
    changes = {"gate": {"degraded_after": after}, "ins": {"jump_samples": 1000, "time_offset_sigma_s": 0.0}}
    error = InjectedError(source, UP * 100.0 * ARCSEC, 10.0)
    sailed = run_with_errors(error, sensors=("bow", "port"), seconds=15.0, rates=rates, **changes)
    rejected_s = 10.068 + (after - 1) * STAR_NS / SECOND_NS
    estimates = sailed.estimates_between(10.0, 15.0)
    degraded_s = next(one.time_ns / SECOND_NS for one in estimates if one.status is Status.DEGRADED)
    # Without rates the first rejection is a fault, as the INS may have jumped; with rates the third at the latest.
    assert degraded_s <= rejected_s + INS_NS / SECOND_NS
    assert {one.status for one in sailed.estimates_between(degraded_s, 15.0)} == {Status.DEGRADED}
    excluded_s, names = sailed.first_exclusion()
    assert names == ("star.bow", "star.port")
    assert rejected_s < excluded_s <= rejected_s + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("turn_arcsec", [32.0, 100.0])
def test_a_rotated_sky_changes_no_attitude_and_its_stars_are_reinstated_afterwards(turn_arcsec: float) -> None:
    """A position error of a kilometre rotates all stars by 32″."""
    sky = InjectedError("sky", np.array([turn_arcsec, 0.0, 0.0]) * ARCSEC, 30.0, end_s=60.0)
    sailed = run_with_errors(sky, seconds=150.0)
    assert {one.status for one in sailed.estimates_between(31.5, 60.0)} == {Status.DEGRADED}
    assert sailed.estimates[-1].status is Status.VALID
    assert "rejected" in sailed.estimates_between(40.0, 41.0)[0].text
    assert_consistent(sailed)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize(("tilt_time_s", "seed"), [(1800.0, 1), (1800.0, 2), (1800.0, 3), (100.0, 1)])
def test_stars_with_a_constant_shared_error_stay_excluded(tilt_time_s: float, seed: int, axis: int) -> None:
    """The INS covariance grows while the stars are excluded: stars within this covariance are not yet consistent."""
    ins = {"ins": {"tilt_time_s": tilt_time_s, "time_offset_sigma_s": 0.0}}
    sailed = run_with_errors(
        InjectedError("sky", np.eye(3)[axis] * 25.0 * ARCSEC, 30.0), seconds=240.0, seed=seed, **ins
    )
    assert {one.status for one in sailed.estimates_between(32.0, 240.0)} == {Status.DEGRADED}


def test_of_two_sensors_excluded_together_the_consistent_one_is_reinstated() -> None:
    """Errors of 12° and 20° are neither mounting shifts nor common errors: each sensor has its own remaining ratio."""
    ends = InjectedError("star.bow", UP * np.deg2rad(12.0), 20.0, end_s=40.0)
    lasts = InjectedError("star.port", UP * np.deg2rad(20.0), 20.0)
    sailed = run_with_errors(ends, lasts, sensors=FOUR, seconds=130.0, **WITH_PAIRS)
    assert sailed.first_exclusion()[1] == ("star.bow", "star.port")
    assert sailed.excluded[-1][1] == ("star.port",)
    assert_consistent(sailed)


def test_one_sensor_against_the_ins_is_an_unresolved_fault_without_level() -> None:
    shift = InjectedError("star.bow", np.array([0.0, 0.0, 50.0]) * ARCSEC, 30.0)
    sailed = run_with_errors(shift, sensors=("bow",), seconds=60.0)
    assert {report.state for report, _ in sailed.reports} == {IntegrityState.UNAVAILABLE}
    assert all(np.all(np.isnan(report.level)) for report, _ in sailed.reports)
    assert {one.status for one in sailed.estimates_between(31.5, 60.0)} == {Status.DEGRADED}
    assert_consistent(sailed)


def test_the_excluding_decision_and_later_ones_have_the_reason_excluded() -> None:
    sailed = run_with_errors(InjectedError("star.bow", UP * 60.0 * ARCSEC, 20.0), seconds=30.0)
    assert ("star.bow", Reason.EXCLUDED) in sailed.reasons
    assert {source for source, reason in sailed.reasons if reason is Reason.EXCLUDED} == {"star.bow"}


@pytest.mark.slow
def test_levels_above_their_limit_make_the_attitude_degraded_and_a_single_source_too() -> None:
    limits = {"integrity": {"alert_limit_arcsec": [15.0, 15.0, 15.0]}}
    of_three = run_with_errors(seconds=200.0, **limits)
    assert of_three.estimates[-1].status is Status.VALID
    assert of_three.reports[-1][0].state is IntegrityState.MET
    of_two = run_with_errors(sensors=("bow", "port"), seconds=60.0, **limits)
    assert of_two.estimates[-1].status is Status.DEGRADED
    assert "alert limit" in of_two.estimates[-1].text
    assert of_two.reports[-1][0].state is IntegrityState.EXCEEDED
    of_one = run_with_errors(sensors=("bow",), seconds=20.0, **limits)
    assert of_one.estimates[-1].status is Status.DEGRADED


def estimated_mounting(sailed: VoyageResult, source: str) -> tuple[FloatArray, FloatArray]:
    """Return the estimated mounting error of a star sensor (rotation vector, device frame, rad) and its sigmas."""
    mounting, state = sailed.core.filter.model.slices[f"{source}.installation"], sailed.core.state
    return state.mean[mounting], np.sqrt(np.diagonal(state.covariance)[mounting])


def mountings(sailed: VoyageResult) -> FloatArray:
    """Return mounting errors of the star sensors across the boresight and the INS clock offset, each in its sigmas."""
    model, state = sailed.core.filter.model, sailed.core.state
    rows = [row for name in model.slices if "installation" in name for row in model.state_indices(name)[1:]]
    rows += list(model.state_indices("ins.time_offset"))
    sigma = np.sqrt(np.maximum(np.diagonal(state.covariance), 1e-30))
    mounted: FloatArray = (state.mean / sigma)[rows]
    return mounted


@functools.cache
def clean_mountings(seconds: float) -> FloatArray:
    """Return the mountings of configuration TWO after a voyage without injected errors."""
    return mountings(run_with_errors(seconds=seconds, **TWO))


def assert_mounting_unchanged(sailed: VoyageResult, seconds: float) -> None:
    """Assert that the mountings equal those without the error to three sigmas, and that the last status is VALID."""
    np.testing.assert_allclose(mountings(sailed), clean_mountings(seconds), atol=3.0)
    assert sailed.estimates[-1].status is Status.VALID


def ins_clock_error(step_s: float) -> InjectedError:
    return InjectedError("ins.clock", np.array([step_s, 0.0, 0.0]), 30.0, end_s=50.0)


@pytest.mark.parametrize("step_s", [0.0295, 0.012, -0.02, -0.035])
def test_a_small_step_of_the_ins_clock_is_reported_at_once_and_estimated_as_an_offset(step_s: float) -> None:
    sailed = run_with_errors(ins_clock_error(step_s), seconds=65.0, **TWO)
    assert {names for _, names in sailed.excluded} == {()}
    first = sailed.estimates_between(30.0 + step_s, 32.0)[0]
    assert first.status is Status.DEGRADED
    assert_consistent(sailed)
    assert {one.status for one in sailed.estimates_between(31.5, 49.0)} == {Status.VALID}
    assert_mounting_unchanged(sailed, 65.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "error", [ins_clock_error(-0.4), ins_clock_error(0.3), InjectedError("ins.axes", UP, 30.0, 50.0)]
)
def test_an_ins_that_reported_a_jump_is_excluded_and_not_the_stars(error: InjectedError) -> None:
    sailed = run_with_errors(error, seconds=125.0, **TWO)
    assert [names for _, names in sailed.excluded] == [(), ("ins",), ()]
    assert 30.0 < sailed.excluded[1][0] < 32.0
    # The INS is reinstated after it was consistent for integrity.return_after_s.
    assert 110.0 <= sailed.excluded[2][0] < 112.0
    assert {one.status for one in sailed.estimates_between(31.0, 110.0)} == {Status.DEGRADED}
    assert max(error_sigmas(one) for one in sailed.estimates_between(55.0, 110.0)) < 5.0
    assert_consistent(sailed)
    assert_mounting_unchanged(sailed, 125.0)


def test_one_sensor_against_an_ins_that_reported_a_jump_is_an_unresolved_fault_of_both() -> None:
    sailed = run_with_errors(ins_clock_error(-0.4), sensors=("bow",), seconds=50.0, ins={"time_offset_sigma_s": 0.005})
    assert {one.status for one in sailed.estimates_between(31.0, 50.0)} == {Status.DEGRADED}
    assert "star.bow is rejected: the INS and all stars contradict each other" in sailed.estimates[-1].text
    assert_consistent(sailed)


@pytest.mark.parametrize(("sensors", "excluded"), [(("bow", "port"), {"ins": 1}), (("bow",), {})])
def test_a_drifting_ins_is_excluded_if_others_check_each_other(
    sensors: tuple[str, ...], excluded: dict[str, int]
) -> None:
    core = run_with_errors(sensors=sensors, seconds=20.0).core
    state = core.state
    assert state.time_ns is not None
    jump = InsJump(state.time_ns + SECOND_NS, 7.0 * UP * ARCSEC, 0.3 * ARCSEC, is_drift=True)
    after = core.filter.apply_ins_change(state, jump)
    assert dict(after.exclusion_counts) == excluded
    # If there is one sensor, no measurements except its own can confirm the attitude.
    assert (after.unconfirmed_step is not None) == (not excluded)
    assert dict(core.filter.apply_ins_change(after, jump).exclusion_counts) == excluded


def test_with_one_star_sensor_left_the_ins_is_not_excluded() -> None:
    """A fault of the INS or of the single remaining sensor cannot be isolated."""
    shift = InjectedError("star.bow", np.array([0.0, 0.0, 3600.0]) * ARCSEC, 10.0)
    drift = InjectedError("ins", UP * 1.0 * ARCSEC, 30.0, per_s=True)
    sailed = run_with_errors(shift, drift, sensors=("bow", "port"), seconds=90.0)
    assert "ins" not in {name for _, names in sailed.excluded for name in names}


def test_with_the_ins_excluded_neither_of_two_star_sensors_is_isolated() -> None:
    """A fault of either sensor explains the contradiction."""
    drift = InjectedError("ins", np.array([0.0, 0.0, 3.3]) * ARCSEC, 30.0, per_s=True)
    shift = InjectedError("star.bow", np.array([0.0, 0.0, 60.0]) * ARCSEC, 65.0)
    sailed = run_with_errors(drift, shift, sensors=("bow", "port"), seconds=85.0)
    names = [names for _, names in sailed.excluded]
    assert ("ins",) in names
    assert not {"star.bow", "star.port"} & set(names[-1])
    assert {one.status for one in sailed.estimates_between(67.0, 85.0)} == {Status.DEGRADED}
    assert_consistent(sailed)


@pytest.mark.slow
def test_solution_separations_are_in_the_covariance_and_not_in_the_levels() -> None:
    sailed = run_with_errors(InjectedError("star.port", UP * 10.0 / 60.0 * ARCSEC, 20.0, per_s=True), seconds=240.0)
    published = [
        one for one in sailed.estimates if one.status is Status.VALID and one.state.separation_covariance_n is not None
    ]
    assert published
    for one in published[:: max(len(published) // 20, 1)]:
        assert one.covariance_n - one.covariance_without_separation_n == pytest.approx(
            one.state.separation_covariance_n, rel=1e-6
        )
        alone = replace(
            one,
            state=replace(one.state, separation_covariance_n=None),
            covariance_n=one.covariance_without_separation_n,
        )
        assert sailed.core.integrity(one).level.tolist() == sailed.core.integrity(alone).level.tolist()


def test_a_mounting_shift_of_four_sigmas_is_in_the_covariance_before_an_exclusion() -> None:
    """Half of the shift is in the attitude within a second; the faulty sensor is isolated after two seconds."""
    shift = InjectedError("star.port", -13.0 * UP * ARCSEC, 120.0)
    sailed = run_with_errors(shift, sensors=("bow", "port"), seconds=128.0, seed=2)
    valid = [one for one in sailed.estimates_between(120.0, 128.0) if one.status is Status.VALID]
    without_separation = [replace(one, covariance_n=one.covariance_without_separation_n) for one in valid]
    assert max(error_sigmas(one) for one in without_separation) > 5.0
    assert max(error_sigmas(one) for one in valid) < 5.0


def run_with_stars_excluded(
    error: InjectedError, start_s: float, end_s: float, seconds: float, seed: int, names: str = "star."
) -> VoyageResult:
    """Run a voyage with two sensors; sources whose names begin with `names` send nothing from start_s to end_s."""
    ERRORS.append(error)
    arrivals = [
        (time_ns, input_)
        for time_ns, input_ in voyage(("bow", "port"), (len(ERRORS) - 1,), seconds, seed, True)
        if isinstance(input_, AttitudeSample)
        or not (input_.source.startswith(names) and start_s <= time_ns / SECOND_NS < end_s)
    ]
    return run_core(ShipAttitudeCore(configuration(("bow", "port"))), arrivals)


def test_the_reinstatement_timer_restarts_after_a_timeout() -> None:
    """A sensor is excluded after a mounting shift at 10 s.

    The sensor sends no data from 20 to 65 s, so the reinstatement time of 60 s starts at 65 s.
    """
    sailed = run_with_stars_excluded(
        InjectedError("star.port", UP * 60.0 * ARCSEC, 10.0), 20.0, 65.0, 135.0, 1, "star.port"
    )
    (excluded_s, excluded), (returned_s, returned) = sailed.excluded[1:]
    assert 10.0 < excluded_s < 11.0
    assert 65.0 + 59.0 < returned_s < 65.0 + 63.0
    assert (excluded, returned) == (("star.port",), ())


def test_the_reinstatement_timer_of_the_ins_restarts_without_measurements() -> None:
    """The INS clock is 0.1 s off from 10 to 16 s.

    No stars are measured from 25 to 80 s, so the reinstatement time of 60 s starts at 80 s.
    """
    error = InjectedError("ins.clock", np.array([0.1, 0.0, 0.0]), 10.0, end_s=16.0)
    sailed = run_with_stars_excluded(error, 25.0, 80.0, 145.0, 1)
    (excluded_s, excluded), (returned_s, returned) = sailed.excluded[1:]
    assert 10.0 < excluded_s < 11.0
    assert 80.0 + 59.0 < returned_s < 80.0 + 63.0
    assert (excluded, returned) == (("ins",), ())


@pytest.mark.parametrize(("seed", "size_arcsec"), [(1, -20.0), (2, -20.0), (5, -15.0)])
def test_a_mounting_shift_without_stars_does_not_exclude_the_ins(seed: int, size_arcsec: float) -> None:
    sailed = run_with_stars_excluded(
        InjectedError("star.port", size_arcsec * UP * ARCSEC, 50.0), 42.0, 60.0, 75.0, seed
    )
    assert "ins" not in {name for _, names in sailed.excluded for name in names}
    assert_consistent(sailed)


@pytest.mark.slow
@pytest.mark.parametrize(
    "errors",
    [
        (),
        (InjectedError("star.bow", 40.0 * ARCSEC * UP, 12.0, 20.0),),
        (
            InjectedError("star.bow", 0.5 * ARCSEC * UP, 10.0, per_s=True),
            InjectedError("ins", 300.0 * ARCSEC * UP, 15.0),
        ),
        (
            InjectedError("star.aft", np.full(3, 60.0 * ARCSEC), 14.0),
            InjectedError("star.port", 90.0 * ARCSEC * UP, 18.0, 25.0),
        ),
    ],
)
def test_the_fast_consistency_test_equals_the_full_one(
    errors: tuple[InjectedError, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = run_with_errors(*errors, seconds=40.0)
    calls = []
    monkeypatch.setattr(ShipFaultDetector, "_is_all_consistent", lambda *_: bool(calls.append(None)))
    RUNS_BEFORE_ERRORS.clear()
    looked = run_with_errors(*errors, seconds=40.0)
    assert calls
    assert (looked.excluded, looked.reasons) == (expected.excluded, expected.reasons)
    for one, other in zip(looked.estimates, expected.estimates, strict=True):
        assert (one.status, one.text) == (other.status, other.text)
        np.testing.assert_array_equal(one.rotation_nd, other.rotation_nd)
        np.testing.assert_array_equal(one.covariance_n, other.covariance_n)
    RUNS_BEFORE_ERRORS.clear()


def test_without_faults_large_separations_are_rare() -> None:
    """A component is beyond 3 sigmas once in 370; (2 sources × 3 windows + 3 subfilters) × 3 axes are 27 components.

    Each seed gives one sample, because the separations (installations) are one draw per voyage.
    """
    seeds = range(1, 17)
    ends = [run_with_errors(sensors=("bow", "port"), seconds=20.0, seed=seed).estimates[-1].state for seed in seeds]
    separated = sum(state.separation_covariance_n is not None for state in ends)
    assert separated <= binom.ppf(0.999, len(seeds), 27 / 370)


@pytest.mark.slow
@pytest.mark.parametrize(("shifted", "changes"), [(("aft",), {}), (("aft", "port"), WITH_PAIRS)])
def test_any_order_within_the_lag_ends_in_the_same_state_exclusions_included(
    shifted: tuple[str, ...], changes: dict[str, Any]
) -> None:
    ERRORS.extend(InjectedError(f"star.{name}", np.array([0.0, 25.0, 0.0]) * ARCSEC, 10.0) for name in shifted)
    arrivals = voyage(THREE, tuple(range(len(ERRORS) - len(shifted), len(ERRORS))), 25.0, 3, True)
    mixed = random.Random(4)
    shuffled = sorted(arrivals, key=lambda arrival: arrival[0] + mixed.uniform(0.0, 1.5) * SECOND_NS)
    states = [
        run_core(ShipAttitudeCore(configuration(THREE, **changes)), run).core.state for run in (arrivals, shuffled)
    ]
    assert states[0].excluded == states[1].excluded
    assert set(states[0].excluded) == {f"star.{name}" for name in shifted}
    for name in ("means", "stack"):
        assert getattr(states[0], name).tobytes() == getattr(states[1], name).tobytes()
    for name in ("running", "excess", "rejection_counts"):
        assert (
            getattr(states[0].innovation_means, name).tobytes() == getattr(states[1].innovation_means, name).tobytes()
        )


def test_a_subfilter_without_a_sensor_equals_a_filter_without_it() -> None:
    """Only the linearisation point differs: the subfilter has that of the main filter."""
    arrivals = voyage(("bow", "port"), (), 20.0, 5, True)
    core = run_core(ShipAttitudeCore(configuration(("bow", "port"))), arrivals).core
    without = configuration(("port",))
    single = run_core(
        ShipAttitudeCore(without), [a for a in arrivals if getattr(a[1], "source", "") != "star.bow"]
    ).core
    ins = core.filter.model.slices["ins.attitude"]
    index = core.filter.fault_detector.subfilters.names.index("star.bow") + 1
    np.testing.assert_allclose(core.state.means[index, ins], single.state.mean[ins], atol=1e-3 * ARCSEC)
    covariance = filter_covariances(core.state.stack, len(core.state.means))[index]
    np.testing.assert_allclose(covariance[ins, ins], single.state.covariance[ins, ins], rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [THREE, FOUR], ids=["three", "four"])
@pytest.mark.parametrize("shifts_arcsec", [(30.0, 30.0), (15.0, -15.0)], ids=["equal", "differently"])
def test_two_simultaneous_mounting_shifts_are_excluded_with_pairs(
    sensors: tuple[str, ...], shifts_arcsec: tuple[float, float]
) -> None:
    shifts_rad = dict(zip(("bow", "port"), ARCSEC * np.array(shifts_arcsec), strict=True))
    errors = [InjectedError(f"star.{name}", UP * shift_rad, 15.0) for name, shift_rad in shifts_rad.items()]
    sailed = run_with_errors(*errors, sensors=sensors, seconds=20.0, **WITH_PAIRS)
    since_s, excluded = sailed.first_exclusion()
    assert excluded == ("star.bow", "star.port")
    assert since_s < 16.0  # within five measurements of each
    assert sailed.estimates[-1].status is Status.VALID
    assert_consistent(sailed)
    # Two remaining sensors check each other; a single remaining sensor is not checked.
    report = sailed.reports[-1][0]
    assert (report.state is IntegrityState.UNAVAILABLE) == (sensors == THREE)
    assert not any("+" in name for name in report.hypotheses)
    # Subfilters without one source show the fault, but do not isolate it. All stars may be excluded
    # together, if the corrections add up to more than the drift of the INS.
    without_pairs = run_with_errors(*errors, sensors=sensors, seconds=20.0)
    every_star = tuple(f"star.{name}" for name in sorted(sensors))
    assert {names for _, names in without_pairs.excluded} <= {(), every_star}
    assert without_pairs.estimates[-1].status is Status.DEGRADED


@pytest.mark.parametrize("sensors", [THREE, FOUR], ids=["three", "four"])
def test_two_mounting_shifts_of_any_size_are_isolated_and_no_error_exceeds_its_level(sensors: tuple[str, ...]) -> None:
    named = 0
    for seed in PAIR_SEEDS:
        rng = np.random.default_rng([9, seed])
        pair = rng.choice(sensors, 2, replace=False)
        shifts_rad = ARCSEC * 10.0 ** rng.uniform(1.0, 2.0, 2)
        ways = [np.array([0.0, np.cos(way), np.sin(way)]) for way in rng.uniform(0.0, 2.0 * np.pi, 2)]
        errors = [
            InjectedError(f"star.{name}", of * way, 20.0) for name, of, way in zip(pair, shifts_rad, ways, strict=True)
        ]
        sailed = run_with_errors(*errors, sensors=sensors, seconds=30.0, seed=100 + seed, **WITH_PAIRS)
        named += sailed.excluded[-1][1] == tuple(sorted(f"star.{name}" for name in pair))
        assert_within_levels(sailed)
    assert named >= 0.9 * len(PAIR_SEEDS)


def test_two_excluded_sensors_are_reinstated_independently() -> None:
    shift, glitch = (
        InjectedError("star.bow", UP * 40.0 * ARCSEC, 10.0),
        InjectedError("star.port", -UP * 60.0 * ARCSEC, 10.0, end_s=30.0),
    )
    sailed = run_with_errors(shift, glitch, seconds=100.0, **WITH_PAIRS)
    both = ("star.bow", "star.port")
    assert [names for _, names in sailed.excluded] == [(), both, ("star.port",), ()]
    # Each is consistent for a minute: bow from its exclusion on (new mounting), port from the end of its glitch on.
    came_back_s = [seconds for seconds, _ in sailed.excluded[2:]]
    assert 70.0 < came_back_s[0] < 75.0
    assert 90.0 < came_back_s[1] < 95.0
    assert set(sailed.estimates[-1].sources) == {"ins", "star.aft", *both}
    assert_consistent(sailed)


def test_with_pairs_a_single_fault_excludes_one_source() -> None:
    for name, shift_arcsec in (("aft", 12.0), ("port", 300.0)):
        sailed = run_with_errors(
            InjectedError(f"star.{name}", UP * shift_arcsec * ARCSEC, 15.0), seconds=20.0, **WITH_PAIRS
        )
        assert [names for _, names in sailed.excluded] == [(), (f"star.{name}",)]
        assert_consistent(sailed)


def test_two_of_three_are_not_isolated_against_an_ins_that_may_have_stepped() -> None:
    """One sensor and an INS without rates agree by chance as well as the two other sensors do: two against two."""
    errors = InjectedError("ins", UP * 50.0 * ARCSEC, 15.0), InjectedError("star.bow", UP * 40.0 * ARCSEC, 15.0)
    sailed = run_with_errors(*errors, seconds=25.0, rates=False, **WITH_PAIRS)
    assert ("star.aft", "star.port") not in [names for _, names in sailed.excluded]
    assert {one.status for one in sailed.estimates_between(15.7, 25.0)} == {Status.DEGRADED}


def test_the_attitude_does_not_depend_on_pair_subfilters_and_the_levels_grow() -> None:
    plain, with_pairs = (run_with_errors(seconds=60.0, **changes) for changes in ({}, WITH_PAIRS))
    assert with_pairs.excluded == [(0.0, ())]
    for one, other in zip(plain.estimates, with_pairs.estimates, strict=True):
        assert one.rotation_nd.tobytes() == other.rotation_nd.tobytes()
        assert one.covariance_by_source_n.tobytes() == other.covariance_by_source_n.tobytes()
        assert one.status is other.status
    first, last = plain.core.state, with_pairs.core.state
    assert first.mean.tobytes() == last.mean.tobytes()
    assert first.covariance_by_source.tobytes() == last.covariance_by_source.tobytes()
    lower, higher = plain.reports[-1][0], with_pairs.reports[-1][0]
    assert lower.hypotheses == ("star.aft", "star.bow", "star.port", "ins", "all_stars")
    assert higher.hypotheses[:4] == lower.hypotheses[:4]
    assert np.all(higher.level > lower.level)
    assert higher.dominant in higher.hypotheses[4:]


def test_a_subfilter_without_two_sensors_equals_a_filter_without_them() -> None:
    """Only the linearisation point differs: the subfilter has that of the main filter."""
    arrivals = voyage(THREE, (), 20.0, 5, True)
    core = run_core(ShipAttitudeCore(configuration(THREE, **WITH_PAIRS)), arrivals).core
    left_out = {"star.aft", "star.bow"}
    of_port = [arrival for arrival in arrivals if getattr(arrival[1], "source", "") not in left_out]
    single = run_core(ShipAttitudeCore(configuration(("port",))), of_port).core
    ins = core.filter.model.slices["ins.attitude"]
    index = core.filter.fault_detector.subfilters.names.index("star.aft+star.bow") + 1
    np.testing.assert_allclose(core.state.means[index, ins], single.state.mean[ins], atol=1e-3 * ARCSEC)
    covariance = filter_covariances(core.state.stack, len(core.state.means))[index]
    np.testing.assert_allclose(covariance[ins, ins], single.state.covariance[ins, ins], rtol=1e-5)


def test_more_hypotheses_than_allowed_are_refused_by_name() -> None:
    with pytest.raises(ParameterError, match=r"integrity\.max_hypotheses' = 3 is less than the 5"):
        ShipFilter(configuration(("aft", "bow", "port"), integrity={"max_hypotheses": 3}))


def test_an_unresolved_fault_is_in_the_error_budget() -> None:
    sailed = run_with_errors(
        InjectedError("star.bow", np.array([0.0, 0.0, 50.0]) * ARCSEC, 10.0), sensors=("bow",), seconds=20.0
    )
    last = sailed.estimates[-1]
    assert last.status is Status.DEGRADED
    np.testing.assert_allclose(last.covariance_by_source_n.sum(axis=0), last.covariance_n, rtol=1e-9)
    assert np.sqrt(np.trace(last.covariance_n)) > 40.0 * ARCSEC

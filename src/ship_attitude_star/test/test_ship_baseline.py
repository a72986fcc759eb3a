"""Baseline of two antennas as an input of ``ship_attitude``: direction, length, errors, bad input.

Limits are 99.9 % of chi-square. Expected accuracies are computed in each test, not by the filter.
"""

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Vector3

from ship_attitude_star.messages.input_messages import baseline
from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.device import LinearisationPoint
from ship_attitude_star.ship_attitude.measurements.devices import BASELINE, BaselineMeasurement
from ship_attitude_star.ship_attitude.measurements.prediction import predict_attitude
from ship_estimation.parameters.schema import ParameterError, build
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, exp_rotation, wrap_pi
from ship_geometry.tracks.attitude_track import AttitudeSample, InterpolatedAttitude
from ship_msgs.msg import RtkBaseline
from ship_node.messages.field_checks import MessageRejected

START_NS = 1_700_000_000_000_000_000
BASELINE_D = np.array([8.0, 0.4, -1.5])
SECTION = {"forward_m": 8.0, "up_m": 0.4, "right_m": -1.5, "sigma_m": 0.002, "bias_sigma_m": 0.0}


def make_config(**changes: Any) -> ShipAttitudeConfig:
    return build(ShipAttitudeConfig, {"ship_baseline": {**SECTION, **changes}})


def true_attitude(time_s: float) -> np.ndarray:
    """Return the true attitude of the ship at a time: motion in waves about heading 40°."""
    roll, pitch = 0.05 * np.sin(0.6 * time_s), 0.02 * np.sin(0.9 * time_s)
    return rotation_from_angles(0.7 + 0.01 * np.sin(0.3 * time_s), pitch, roll)


def run_core(
    core: ShipAttitudeCore, ins_error_n: np.ndarray, solutions: Any, seconds: int = 60
) -> tuple[list[Any], list[Any]]:
    """Return estimates and decisions with an INS at 20 Hz and a baseline ``solutions(second, true_nd)`` at 1 Hz."""
    estimates, decisions = [], []
    for number in range(20 * seconds + 1):
        time_s = number / 20.0
        time_ns = START_NS + number * 50_000_000
        outcome = core.ins.add(AttitudeSample(time_ns, exp_rotation(-ins_error_n) @ true_attitude(time_s)))
        estimates += outcome.estimates
        decisions += outcome.decisions
        if number and number % 20 == 0:
            vector_n = solutions(number // 20, true_attitude(time_s))
            if vector_n is not None:
                noise_n = 0.004**2 * np.eye(3)
                outcome = core.add_measurement(BaselineMeasurement(time_ns, vector_n, noise_n))
                decisions += outcome.decisions
                estimates += outcome.estimates
    return estimates, decisions


def test_it_makes_the_heading_of_an_ins_observable() -> None:
    rng = np.random.default_rng(1)
    error_n = np.array([5.0, 60.0, -4.0]) * ARCSEC
    estimates, decisions = run_core(
        ShipAttitudeCore(make_config()), error_n, lambda _, true_nd: true_nd @ BASELINE_D + rng.normal(0.0, 0.004, 3)
    )
    last, heading = estimates[-1], angles_from_rotation(true_attitude(60.0))[0]
    # A survey error of 2 mm and 60 solutions with 4 mm of noise, over 8.1 m, give 52″. The INS error is 60″, sigma 72″.
    expected = np.hypot(0.002, 0.004 / np.sqrt(60.0)) / np.hypot(8.0, 1.5)
    alone = 72.0 * ARCSEC
    together = 1.0 / np.sqrt(expected**-2 + alone**-2)
    assert np.sqrt(last.covariance_n[1, 1]) == pytest.approx(together, rel=0.03)
    assert abs(wrap_pi(angles_from_rotation(last.rotation_nd)[0] - heading)) < 3.3 * together
    assert all(decision.accepted for decision in decisions)
    # No star: the attitude is not VALID, and the horizon is that of gravity.
    assert (last.status, last.horizon.name) == (Status.DEGRADED, "GRAVITY")
    assert last.sources == ("ins", BASELINE)
    np.testing.assert_allclose(last.covariance_by_source_n.sum(axis=0), last.covariance_n, rtol=1e-9)


def test_jacobian_is_the_difference_quotient() -> None:
    filter_ = ShipFilter(make_config(bias_sigma_m=0.01))
    model, device = filter_.model, filter_.devices[BASELINE]
    rng = np.random.default_rng(2)
    rotation_nd = true_attitude(3.0)
    ins = InterpolatedAttitude(rotation_nd, np.array([0.01, -0.02, 0.03]), 1.0, np.zeros((3, 3)), None)
    measured = BaselineMeasurement(START_NS, rotation_nd @ BASELINE_D + rng.normal(0.0, 0.004, 3), 1.6e-5 * np.eye(3))

    def residuals_at(mean: np.ndarray) -> Any:
        predicted = predict_attitude(device, model, mean, ins)
        return device.linearise(measured, LinearisationPoint(model, mean, np.eye(model.size), predicted, None))

    mean = 20.0 * ARCSEC * rng.standard_normal(model.size)
    clock = model.state_indices("ins.time_offset")
    mean[clock] = 0.001
    analytic, step = residuals_at(mean).linear.jacobian, 1e-6
    for state in range(model.size):
        if state in clock:
            continue  # The time of the INS attitude is not changed here.
        off = np.zeros(model.size)
        off[state] = step
        quotient = (residuals_at(mean - off).linear.residual - residuals_at(mean + off).linear.residual) / (2.0 * step)
        np.testing.assert_allclose(analytic[:, state], quotient, atol=2e-3)


@pytest.mark.statistics
def test_errors_of_many_draws_are_consistent_with_the_covariance() -> None:
    squares, draws = [], 60
    for seed in range(draws):
        rng = np.random.default_rng(100 + seed)
        error_n = np.array([10.0, 72.0, 10.0]) * ARCSEC * rng.standard_normal(3)
        surveyed = BASELINE_D + 0.002 * rng.standard_normal(3)
        slow_n = 0.003 * rng.standard_normal(3)

        def solution(_: int, true_nd: np.ndarray, surveyed=surveyed, slow_n=slow_n, rng=rng) -> np.ndarray:
            return true_nd @ surveyed + slow_n + rng.normal(0.0, 0.004, 3)

        core = ShipAttitudeCore(make_config(bias_sigma_m=0.003, bias_time_s=1e6))
        estimates, _ = run_core(core, error_n, solution, seconds=8)
        last = estimates[-1]
        heading = angles_from_rotation(true_attitude(8.0))[0]
        off = float(wrap_pi(angles_from_rotation(last.rotation_nd)[0] - heading))
        squares.append(off**2 / last.covariance_n[1, 1])
    # chi-square of 60 degrees of freedom: 30.3 to 100.9 (99.9 %).
    assert 30.3 < sum(squares) < 100.9


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda vector_n: 1.02 * vector_n, "wrong RTK solution"),
        (lambda vector_n: -vector_n, "are base and rover exchanged?"),
        (lambda vector_n: np.full(3, np.nan), "wrong RTK solution"),
    ],
)
def test_a_wrong_solution_is_rejected_and_changes_nothing(change: Any, text: str) -> None:
    cores = ShipAttitudeCore(make_config()), ShipAttitudeCore(make_config())
    error_n = np.array([0.0, 20.0, 0.0]) * ARCSEC

    def solutions(second: int, true_nd: np.ndarray) -> np.ndarray:
        vector_n = true_nd @ BASELINE_D
        return change(vector_n) if second == 5 else vector_n

    with_it, decisions = run_core(cores[0], error_n, solutions, seconds=10)
    without, _ = run_core(cores[1], error_n, lambda second, nd: None if second == 5 else nd @ BASELINE_D, seconds=10)
    rejected = [decision for decision in decisions if not decision.accepted]
    assert [decision.reason for decision in rejected] == [Reason.GATE]
    assert text in rejected[0].text
    np.testing.assert_array_equal(with_it[-1].rotation_nd, without[-1].rotation_nd)
    np.testing.assert_array_equal(with_it[-1].covariance_n, without[-1].covariance_n)


@pytest.mark.parametrize(
    ("wrong_d", "text"),
    [
        # The length changes by 50 mm.
        (np.array([0.0, 0.0, 0.3]), "baseline length"),
        # In the deck and perpendicular to the baseline: the length changes by 6 mm.
        (0.3 * np.array([-BASELINE_D[2], 0.0, BASELINE_D[0]]) / np.hypot(BASELINE_D[0], BASELINE_D[2]), "NIS"),
    ],
)
def test_a_wrong_transverse_ambiguity_is_rejected(wrong_d: np.ndarray, text: str) -> None:
    # 0.3 m across at 8 m are 2 degrees.
    def solutions(second: int, true_nd: np.ndarray) -> np.ndarray:
        return true_nd @ (BASELINE_D + (wrong_d if second >= 10 else 0.0))

    estimates, decisions = run_core(ShipAttitudeCore(make_config()), np.zeros(3), solutions, seconds=30)
    wrong = [d for d in decisions if d.measurement.time_ns > START_NS + 9.5e9]
    assert len(wrong) > 15
    assert not any(d.accepted for d in wrong)
    assert text in wrong[0].text
    heading = angles_from_rotation(true_attitude(30.0))[0]
    assert abs(wrap_pi(angles_from_rotation(estimates[-1].rotation_nd)[0] - heading)) < 60.0 * ARCSEC


def test_a_too_short_baseline_is_refused_by_name() -> None:
    with pytest.raises(ParameterError, match=r"ship_baseline\.forward_m"):
        make_config(forward_m=0.1, up_m=0.0, right_m=0.0)


def test_without_the_section_there_is_no_such_device() -> None:
    assert BASELINE not in ShipFilter(build(ShipAttitudeConfig, {})).devices


def test_alignment_contains_its_direction() -> None:
    core = ShipAttitudeCore(make_config())
    run_core(core, np.zeros(3), lambda _, true_nd: true_nd @ BASELINE_D, seconds=3)
    alignment = current_alignment(core.filter, core.config, core.state)
    at = dict(zip(alignment.names, alignment.values, strict=True))
    assert at["baseline.azimuth"] == pytest.approx(np.arctan2(-1.5, 8.0) % (2.0 * np.pi), abs=1e-4)
    assert at["baseline.elevation"] == pytest.approx(np.arctan2(0.4, np.hypot(8.0, 1.5)), abs=1e-4)


def test_the_same_solutions_end_in_the_same_bits() -> None:
    ends = [
        run_core(ShipAttitudeCore(make_config()), np.zeros(3), lambda _, true_nd: true_nd @ BASELINE_D, seconds=5)[0][
            -1
        ]
        for _ in range(2)
    ]
    np.testing.assert_array_equal(ends[0].covariance_n, ends[1].covariance_n)
    np.testing.assert_array_equal(ends[0].rotation_nd, ends[1].rotation_nd)


def solution_message(**changes: Any) -> RtkBaseline:
    message = RtkBaseline(base_id="", rover_id="", enu=Vector3(x=5.0, y=6.0, z=0.4), fix=RtkBaseline.FIXED)
    message.header.stamp.sec, message.covariance = START_NS // 1_000_000_000, 1e-4 * np.eye(3).ravel()
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"enu": Vector3(x=float("nan"), y=6.0, z=0.4)}, Reason.NON_FINITE),
        ({"enu": Vector3(x=float("inf"), y=6.0, z=0.4)}, Reason.NON_FINITE),
        ({"covariance": np.full(9, np.nan)}, Reason.NON_FINITE),
        ({"covariance": np.full(9, np.inf)}, Reason.NON_FINITE),
        ({"covariance": np.diag([1e-4, -1e-4, 1e-4]).ravel()}, Reason.BAD_COVARIANCE),
        ({"covariance": np.array([1.0, 0.5, 0.0, -0.5, 1.0, 0.0, 0.0, 0.0, 1.0])}, Reason.BAD_COVARIANCE),
        ({"covariance": 1e300 * np.eye(3).ravel()}, Reason.BAD_COVARIANCE),
        ({"enu": Vector3()}, Reason.UNITS),
        ({"enu": Vector3(x=1e300)}, Reason.UNITS),
        ({"fix": RtkBaseline.FLOAT}, Reason.NOT_FIXED),
        ({"fix": 200}, Reason.NOT_FIXED),
    ],
)
def test_an_unusable_message_is_rejected_with_the_reason(changes: dict[str, Any], reason: Reason) -> None:
    config = make_config().ship_baseline
    assert baseline(solution_message(), START_NS, config).covariance_known
    with pytest.raises(MessageRejected) as rejected:
        baseline(solution_message(**changes), START_NS, config)
    assert rejected.value.rejection.reason is reason


def test_a_covariance_of_zeros_is_the_configured_one() -> None:
    config = make_config(noise_sigma_m=0.02).ship_baseline
    read = baseline(solution_message(covariance=np.zeros(9)), START_NS, config)
    assert not read.covariance_known
    np.testing.assert_array_equal(read.value.noise_n, 0.02**2 * np.eye(3))

"""Errors drawn by a run: size, independence, and the equations of models.md §4."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import AngleMotion, Outage
from ship_simulation.scenario.scenario import Ins, Position, Reference, Scenario, StarSensor
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.ship.motion import make_carrier
from ship_testing.consistency import sigma_ratio_band

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"
QUIET_INS = Ins(
    rate_hz=10.0, tilt_sigma_arcsec=0.0, heading_sigma_arcsec=0.0, white_sigma_arcsec=0.0, time_offset_sigma_s=0.0
)


def paper(**changes) -> Scenario:
    return dataclasses.replace(load_scenario(SCENARIOS / "paper.yaml"), **changes)


def with_ins(scenario: Scenario, **changes) -> Scenario:
    return dataclasses.replace(scenario, ins=dataclasses.replace(scenario.ins, **changes))


def with_star(scenario: Scenario, sensor_id: str, **changes) -> Scenario:
    sensor = dataclasses.replace(scenario.star_sensors[sensor_id], **changes)
    return dataclasses.replace(scenario, star_sensors={**scenario.star_sensors, sensor_id: sensor})


def assert_sigma(values, sigma, probability=0.999):
    """Check that the RMS of independent values matches a sigma, within the chi² band."""
    low, high = sigma_ratio_band(values.size, probability)
    assert low < np.sqrt(np.mean(values**2)) / sigma < high


def test_a_run_starts_at_its_time_and_keeps_its_rates():
    run = simulate(paper(duration_s=10.0), seed=1)
    # 2014-07-09T11:50:07Z is 1404906607 by `date -u +%s`.
    assert run.start_ns == 1_404_906_607_800_000_000
    assert run.ins.time_ns[0] == run.start_ns
    assert run.ins.time_ns[-1] == run.start_ns + 10 * SECOND_NS
    assert set(np.diff(run.ins.time_ns)) == {10_000_000}
    assert set(np.diff(run.stars["fore"].time_ns)) == {200_000_000}
    assert set(np.diff(run.ins.time_ns[run.truth.ins_index])) == {100_000_000}
    assert run.truth.ins_index[-1] == run.ins.time_ns.size - 1


def test_ins_samples_obey_the_equation_of_the_model():
    run = simulate(paper(duration_s=60.0), seed=5)
    truth = run.truth.ins
    true_nd = make_carrier(run.scenario.carrier, run.seed).attitude(
        (run.ins.time_ns - run.start_ns) / SECOND_NS + truth.time_offset_s
    )
    # R_true(s + tau) = exp(a) exp(w) R_ins(s), so w is the remainder.
    white_n = log_rotation(exp_rotation(-truth.attitude_error_n) @ true_nd @ np.swapaxes(run.ins.rotation_nd, -1, -2))
    for axis in range(3):
        assert_sigma(white_n[:, axis], 1.0 * ARCSEC)
    neighbours = np.mean(white_n[1:] * white_n[:-1], axis=0) / ARCSEC**2
    np.testing.assert_allclose(neighbours, 0.0, atol=3.3 / np.sqrt(len(white_n)))


def test_ins_rates_are_those_at_the_time_of_validity():
    run = simulate(with_ins(paper(duration_s=5.0), time_offset_s=0.5), seed=2)
    times_s = (run.ins.time_ns - run.start_ns) / SECOND_NS + run.truth.ins.time_offset_s
    assert 0.4 < run.truth.ins.time_offset_s < 0.6
    expected = make_carrier(run.scenario.carrier, run.seed).body_rate(times_s)
    np.testing.assert_array_equal(run.ins.rate_d, expected)
    noisy = simulate(with_ins(paper(duration_s=60.0), rate_sigma_arcsec_per_s=4.0), seed=2)
    quiet = simulate(paper(duration_s=60.0), seed=2)
    assert_sigma((noisy.ins.rate_d - quiet.ins.rate_d).ravel(), 4.0 * ARCSEC)


def test_correlated_rate_errors_have_the_configured_sigma_and_correlation_time():
    """Each run gives an independent draw.

    Samples 1 s apart, with a time constant of 10 s, have a correlation of exp(-0.1).
    """
    biased = with_ins(
        paper(duration_s=1.0), rate_hz=1.0, rate_bias_sigma_arcsec_per_s=5.0, rate_bias_time_s=10.0
    )
    quiet = with_ins(paper(duration_s=1.0), rate_hz=1.0)
    errors = np.array([simulate(biased, seed).ins.rate_d - simulate(quiet, seed).ins.rate_d for seed in range(300)])
    assert_sigma(errors[:, 1].ravel(), 5.0 * ARCSEC)
    kept = np.mean(errors[:, 0] * errors[:, 1]) / (5.0 * ARCSEC) ** 2
    assert kept == pytest.approx(np.exp(-0.1), abs=3.3 / np.sqrt(900.0))


def test_gyroscopes_at_rest_measure_the_earth_rate():
    """At 30° north with the bow to the East, half the Earth rate is about Up, and 0.87 of it about North (port)."""
    still = paper(duration_s=1.0)
    carrier = dataclasses.replace(still.carrier, heading=AngleMotion(90.0), pitch=AngleMotion(), roll=AngleMotion())
    still = dataclasses.replace(still, carrier=carrier, position=Position(latitude_deg=30.0))
    run = simulate(with_ins(still, rate_hz=1.0, rate_has_earth_rate=True), seed=1)
    turn = 2.0 * np.pi / (23 * 3600.0 + 56 * 60.0 + 4.0905)
    expected = np.array([0.0, 0.5, -np.sqrt(0.75)]) * turn
    np.testing.assert_allclose(run.ins.rate_d, np.broadcast_to(expected, run.ins.rate_d.shape), atol=1e-6 * turn)


def test_truth_is_the_attitude_at_the_stamp_itself():
    run = simulate(with_ins(paper(duration_s=5.0), time_offset_s=0.5), seed=2)
    since_start_s = (run.ins.time_ns[run.truth.ins_index] - run.start_ns) / SECOND_NS
    carrier = make_carrier(run.scenario.carrier, run.seed)
    np.testing.assert_array_equal(run.truth.rotation_nd, carrier.attitude(since_start_s))
    np.testing.assert_array_equal(run.truth.rate_d, carrier.body_rate(since_start_s))


def test_constants_of_many_runs_have_their_sigmas():
    scenario = with_ins(paper(duration_s=1.0), rate_hz=1.0)
    scenario = with_star(scenario, "fore", time_offset_sigma_s=0.002)
    runs = [simulate(scenario, seed).truth for seed in range(300)]
    attitude_error = np.array([truth.ins.attitude_error_n[0] for truth in runs])
    for axis, sigma_arcsec in enumerate([10.0, 72.0, 10.0]):
        assert_sigma(attitude_error[:, axis], sigma_arcsec * ARCSEC)
    assert_sigma(np.array([truth.ins.time_offset_s for truth in runs]), 0.005)
    assert_sigma(np.array([truth.stars["fore"].time_offset_s for truth in runs]), 0.002)
    sigma_v = ARCSEC * np.array([20.0, 1.0, 1.0])
    for sensor_id in ("fore", "starboard"):
        errors = np.array([truth.stars[sensor_id].installation_error_v for truth in runs])
        low, high = mean_nees_band(len(runs), 3)
        assert low < np.mean(np.sum((errors / sigma_v) ** 2, axis=1)) < high
        assert_sigma(errors[:, 0], sigma_v[0])


def test_star_samples_obey_the_equation_of_the_model():
    scenario = with_star(paper(duration_s=200.0), "starboard", roll_deg=30.0, time_offset_s=0.3)
    run = simulate(scenario, seed=4)
    samples, truth = run.stars["starboard"], run.truth.stars["starboard"]
    times_s = (samples.time_ns - run.start_ns) / SECOND_NS + 0.3
    mounted = rotation_from_angles(*np.deg2rad([90.0, 45.0, 30.0])) @ exp_rotation(truth.installation_error_v)
    np.testing.assert_allclose(truth.rotation_dv, mounted, rtol=0.0, atol=1e-15)
    clean_nv = make_carrier(scenario.carrier, run.seed).attitude(times_s) @ mounted
    noise_v = log_rotation(np.swapaxes(clean_nv, -1, -2) @ samples.rotation_nv)
    for axis, sigma_arcsec in enumerate([100.0, 3.0, 3.0]):
        assert_sigma(noise_v[:, axis], sigma_arcsec * ARCSEC)
        assert samples.noise_v[axis, axis] == pytest.approx((sigma_arcsec * ARCSEC) ** 2)
    np.testing.assert_array_equal(samples.common_n, np.zeros((3, 3)))


def test_flexure_and_common_error_are_correlated_and_in_their_own_frames():
    clean = with_star(
        paper(duration_s=600.0),
        "fore",
        **dict.fromkeys(("sigma_forward_arcsec", "sigma_up_arcsec", "sigma_right_arcsec"), 0.0),
    )
    without = simulate(clean, seed=1).stars["fore"].rotation_nv
    true_nd = make_carrier(clean.carrier, 1).attitude(np.arange(3001) / 5.0)
    bent = simulate(with_star(clean, "fore", flexure_sigma_arcsec=5.0, flexure_time_s=0.2), seed=1).stars["fore"]
    bend_n = log_rotation(bent.rotation_nv @ np.swapaxes(without, -1, -2))
    bend_d = (np.swapaxes(true_nd, -1, -2) @ bend_n[..., None])[..., 0]
    # Samples a correlation time apart have correlation exp(-1): only every fifth counts as independent.
    for axis in range(3):
        assert_sigma(bend_d[::5, axis], 5.0 * ARCSEC)
        correlation = np.mean(bend_d[1:, axis] * bend_d[:-1, axis]) / np.mean(bend_d[:, axis] ** 2)
        assert correlation == pytest.approx(np.exp(-1.0), abs=0.08)
    shared = simulate(with_star(clean, "fore", common_sigma_arcsec=2.0, common_time_s=0.2), seed=1).stars["fore"]
    shared_n = log_rotation(shared.rotation_nv @ np.swapaxes(without, -1, -2))
    assert_sigma(shared_n[::5].ravel(), 2.0 * ARCSEC)
    np.testing.assert_allclose(shared.common_n, (2.0 * ARCSEC) ** 2 * np.eye(3), rtol=1e-12)


def test_a_reference_shows_the_attitude_of_the_ins_stamped_earlier_by_its_offset():
    reference = Reference(
        rate_hz=10.0,
        heading_deg=-0.823,
        pitch_deg=-0.039,
        roll_deg=-0.225,
        installation_sigma_arcsec=0.0,
        sigma_roll_arcsec=0.0,
        sigma_pitch_arcsec=0.0,
        sigma_heading_arcsec=0.0,
        time_offset_s=0.2,
        time_offset_sigma_s=0.0,
    )
    ins = dataclasses.replace(QUIET_INS, time_offset_s=0.05)
    run = simulate(paper(duration_s=20.0, ins=ins, references={"s330": reference}), seed=1)
    turn = rotation_from_angles(*np.deg2rad([-0.823, -0.039, -0.225]))
    # The reference stamped t shows what the INS shows stamped t - 0.2 s: two samples earlier at 10 Hz.
    expected = run.ins.rotation_nd[:-2] @ turn
    np.testing.assert_allclose(run.references["s330"].rotation_nv[2:], expected, rtol=0.0, atol=1e-9)


def test_noise_of_a_reference_belongs_to_its_axes():
    reference = Reference(rate_hz=10.0, sigma_roll_arcsec=10.0, sigma_pitch_arcsec=20.0, sigma_heading_arcsec=40.0)
    run = simulate(paper(duration_s=200.0, references={"gyro": reference}), seed=1)
    truth, samples = run.truth.references["gyro"], run.references["gyro"]
    times_s = (samples.time_ns - run.start_ns) / SECOND_NS - truth.time_offset_s + run.truth.ins.time_offset_s
    clean = make_carrier(run.scenario.carrier, 1).attitude(times_s) @ truth.rotation_dv
    noise_v = log_rotation(np.swapaxes(clean, -1, -2) @ samples.rotation_nv)
    # About forward (roll), up (heading), right (pitch).
    for axis, sigma_arcsec in enumerate([10.0, 40.0, 20.0]):
        assert_sigma(noise_v[:, axis], sigma_arcsec * ARCSEC)
        assert samples.noise_v[axis, axis] == pytest.approx((sigma_arcsec * ARCSEC) ** 2)


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    first, again, other = (simulate(paper(duration_s=5.0), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.ins.rotation_nd, again.ins.rotation_nd)
    np.testing.assert_array_equal(first.stars["fore"].rotation_nv, again.stars["fore"].rotation_nv)
    assert first.truth.ins.time_offset_s != other.truth.ins.time_offset_s
    assert np.abs(first.ins.rotation_nd - other.ins.rotation_nd).max() > 1e-6


def test_a_further_device_does_not_change_the_others():
    scenario = paper(duration_s=5.0)
    more = dataclasses.replace(
        scenario,
        star_sensors={"aft": StarSensor(azimuth_deg=180.0, elevation_deg=45.0), **scenario.star_sensors},
        references={"gyro": Reference()},
    )
    few, many = simulate(scenario, seed=1), simulate(more, seed=1)
    np.testing.assert_array_equal(few.ins.rotation_nd, many.ins.rotation_nd)
    for sensor_id in scenario.star_sensors:
        np.testing.assert_array_equal(few.stars[sensor_id].rotation_nv, many.stars[sensor_id].rotation_nv)
    assert np.abs(many.stars["aft"].rotation_nv - many.stars["fore"].rotation_nv).max() > 0.1


def test_an_outage_removes_samples_and_keeps_the_others_unchanged():
    scenario = paper(duration_s=20.0)
    whole = simulate(scenario, seed=1).stars["fore"]
    cut = simulate(with_star(scenario, "fore", outages={"clouds": Outage(5.0, 15.0)}), seed=1).stars["fore"]
    since_start_s = (cut.time_ns - whole.time_ns[0]) / SECOND_NS
    assert not np.any((since_start_s >= 5.0) & (since_start_s < 15.0))
    assert cut.time_ns.size == whole.time_ns.size - 50
    kept = np.isin(whole.time_ns, cut.time_ns)
    np.testing.assert_array_equal(cut.rotation_nv, whole.rotation_nv[kept])
    np.testing.assert_array_equal(cut.log_time_ns, whole.log_time_ns[kept])


def test_late_star_data_arrive_shuffled_and_within_the_lag():
    run = simulate(dataclasses.replace(load_scenario(SCENARIOS / "late_shuffled.yaml"), duration_s=60.0), seed=1)
    samples = run.stars["fore"]
    delay_s = (samples.log_time_ns - samples.time_ns) / SECOND_NS
    assert delay_s.min() >= 0.5
    assert delay_s.max() < 2.0
    assert delay_s.std() == pytest.approx(0.8 / np.sqrt(12.0), rel=0.15)
    assert np.count_nonzero(np.diff(samples.log_time_ns) < 0) > 20


def test_arrivals_are_in_order_of_log_time_with_the_ins_first():
    scenario = with_star(with_ins(paper(duration_s=2.0), latency_s=0.1), "fore", latency_s=0.1)
    run = simulate(scenario, seed=1)
    arrivals = run.arrivals()
    log_times = [log_time_ns for log_time_ns, _, _ in arrivals]
    assert log_times == sorted(log_times)
    assert len(arrivals) == run.ins.time_ns.size + sum(s.time_ns.size for s in run.stars.values())
    assert [source for _, source, _ in arrivals[:2]] == ["ins", "star.fore"]
    assert arrivals[0][0] == run.start_ns + SECOND_NS // 10

"""Checks of INS samples, over minutes of healthy streams of many kinds, and with faults."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import InsJump
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.plausibility.integrated_rates import RateStatus
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_testing.ins_streams import CALM, STORM, stream

NOTHING_LATE = AttitudeTrack(500_000_000)
"""Accepted samples, which are used only if a sample is late."""


def check_sample(samples: list[AttitudeSample]) -> tuple[list[str], InsCheck, int]:
    """Return the rejection reason of each sample, the check after all samples, and the number of samples with jumps."""
    ins_check, results, jumps = InsCheck(CheckedInsConfig()), [], 0
    for sample in samples:
        result = ins_check.check(sample, NOTHING_LATE, {})
        results.append("" if result.rejection is None else result.rejection.reason.name)
        jumps += bool(result.jumps)
    return results, ins_check, jumps


PRINTED = "0.01° at 100 Hz in calm swell"
HEALTHY: dict[str, dict[str, Any]] = {
    PRINTED: {"duration_s": 120.0, "rate_hz": 100.0, "amplitude_deg": CALM, "printed_deg": 0.01},
    "0.01° at 100 Hz in swell": {"duration_s": 60.0, "rate_hz": 100.0, "printed_deg": 0.01},
    "0.01° at 10 Hz": {"duration_s": 120.0, "rate_hz": 10.0, "amplitude_deg": CALM, "printed_deg": 0.01},
    "0.1° at 50 Hz": {"duration_s": 60.0, "rate_hz": 50.0, "amplitude_deg": CALM, "printed_deg": 0.1},
    "at rest, rates with the Earth's turn": {
        "duration_s": 60.0,
        "rate_hz": 50.0,
        "amplitude_deg": (0.0, 0.0, 0.0),
        "printed_deg": 0.01,
        "white_arcsec": 0.1,
        "bias_arcsec_per_s": 15.0,
    },
    "noisier than configured": {"duration_s": 60.0, "rate_hz": 50.0, "white_arcsec": 10.0},
    "noisy rates": {"duration_s": 60.0, "rate_hz": 100.0, "amplitude_deg": CALM, "rate_noise_arcsec_per_s": 180.0},
    "rates that lag": {"duration_s": 60.0, "rate_hz": 10.0, "rate_delay_s": 0.02},
    "storm": {"duration_s": 60.0, "rate_hz": 20.0, "amplitude_deg": STORM},
    "2 Hz": {"duration_s": 120.0, "rate_hz": 2.0},
}


@pytest.mark.parametrize("name", HEALTHY)
def test_no_sample_of_a_healthy_ins_is_rejected(name: str) -> None:
    results, ins_check, jumps = check_sample(stream(**HEALTHY[name]))
    assert (set(results), jumps) == ({""}, 0)
    assert ins_check.rate_status in (RateStatus.UNPROVEN, RateStatus.MEASURED)


def test_freeze_in_calm_swell_is_detected_within_two_seconds_and_ends_with_the_next_value() -> None:
    """An INS with a resolution of a hundredth of a degree, frozen for three seconds while its rates continue."""
    samples = stream(**HEALTHY[PRINTED])
    frozen = [replace(s, rotation_nd=samples[3000].rotation_nd) for s in samples[3000:3300]]
    results, _, jumps = check_sample([*samples[:3000], *frozen, *samples[3300:]])
    detected = results.index("STUCK")
    assert 3000 < detected <= 3200
    assert set(results[detected:3300]) == {"STUCK"}
    moved = next(i for i in range(3300, 3400) if np.any(samples[i].rotation_nd != frozen[0].rotation_nd))
    assert set(results[moved:]) == {""}
    assert jumps == 0


def test_attitudes_accepted_against_the_rates_are_a_jump() -> None:
    """The INS freezes and then drifts by 165″/min, which the stuck check cannot detect; its rates continue."""
    samples = stream(20.0, 100.0)
    frozen, drifts_ns = samples[1000], samples[1080].time_ns
    faulty = [
        replace(s, rotation_nd=east_attitude(2.75e-9 * max(s.time_ns - drifts_ns, 0)) @ frozen.rotation_nd)
        for s in samples[1000:1500]
    ]
    ins_check = InsCheck(CheckedInsConfig())
    found = [ins_check.check(sample, NOTHING_LATE, {}) for sample in [*samples[:1000], *faulty]]
    reasons = {result.rejection.reason.name for result in found if result.rejection is not None}
    assert reasons == {"GATE", "STUCK"}
    taken = next(n for n in range(1080, 1500) if found[n].rejection is None)
    assert found[taken].jumps, "from here on the attitude is degrees wrong"
    assert not any(result.jumps for result in [*found[:taken], *found[taken + 1 :]])


def east_attitude(arcsec: float) -> np.ndarray:
    return exp_rotation(np.array([0.0, 0.0, arcsec * ARCSEC]))


@pytest.mark.parametrize("rate_hz", [100.0, 50.0, 20.0, 10.0, 2.0])
@pytest.mark.parametrize("factor", [0.0, -1.0])
def test_wrong_rates_are_detected_early(rate_hz: float, factor: float) -> None:
    ins_check, samples = InsCheck(CheckedInsConfig()), stream(10.0, rate_hz, rate_factor=factor)
    results = [ins_check.check(sample, NOTHING_LATE, {}) for sample in samples]
    assert all(result.rejection is None for result in results)
    dropped = [n for n, result in enumerate(results) if result.rates_wrong_after_ns is not None]
    assert len(dropped) == 1
    assert dropped[0] <= max(0.3 * rate_hz, 3)
    assert all(result.sample.rate_d is None for result in results[dropped[0] :])
    assert ins_check.rate_status is RateStatus.NOT_MEASURED


def test_noise_is_not_accepted_as_rates() -> None:
    results, ins_check, _ = check_sample(stream(20.0, 100.0, rate_factor=0.0, rate_noise_arcsec_per_s=3600.0))
    assert set(results) == {""}
    assert ins_check.rate_status is RateStatus.NOT_MEASURED


@pytest.mark.parametrize(("factor", "slope"), [(np.rad2deg(1.0), 57.3), (np.deg2rad(1.0), 1.0 / 57.3)])
def test_wrong_unit_is_identified_and_right_rates_are_confirmed_again(factor: float, slope: float) -> None:
    wrong, right = stream(20.0, 50.0, rate_factor=factor), stream(40.0, 50.0)
    results, ins_check, _ = check_sample(wrong)
    assert 5.0 <= results.index("UNITS") / 50.0 <= 6.5
    assert set(results[results.index("UNITS") :]) == {"UNITS"}
    back = [ins_check.check(sample, NOTHING_LATE, {}) for sample in right[1000:]]
    rejected = [n for n, result in enumerate(back) if result.rejection is not None]
    assert max(rejected) < 2.5 * 50.0
    assert ins_check.rate_status is RateStatus.MEASURED
    assert back[-1].sample.rate_d is not None


def test_rates_at_rest_are_not_checked() -> None:
    """Zero rates are right at rest: only motion shows that they are wrong."""
    still, moving = stream(10.0, 50.0, (0.0, 0.0, 0.0), rate_factor=0.0), stream(20.0, 50.0, rate_factor=0.0)[500:]
    _, ins_check, _ = check_sample(still)
    assert ins_check.rate_status is RateStatus.UNPROVEN
    # At the start of the swell, attitude and motion jump.
    assert [ins_check.check(sample, NOTHING_LATE, {}).rejection for sample in moving][8:] == [None] * (len(moving) - 8)
    assert ins_check.rate_status is RateStatus.NOT_MEASURED


@pytest.mark.parametrize("arcsec", [30.0, 100.0, 3600.0])
def test_step_of_ten_sigmas_is_detected_at_the_sample(arcsec: float) -> None:
    samples = stream(20.0, 100.0)
    step = exp_rotation(np.array([arcsec, 0.0, 0.0]) * ARCSEC)
    results, _, jumps = check_sample(
        [replace(s, rotation_nd=step @ s.rotation_nd) if n >= 1000 else s for n, s in enumerate(samples)]
    )
    assert [n for n, result in enumerate(results) if result] == list(range(1000, 1005))
    assert (set(results), jumps) == ({"", "GATE"}, 1)


def test_single_wrong_rate_is_no_jump() -> None:
    samples = stream(20.0, 50.0)
    samples[500] = replace(samples[500], rate_d=np.array([0.0, 3.0, 0.0]))
    results, ins_check, jumps = check_sample(samples)
    assert [n for n, result in enumerate(results) if result] == [500]
    assert (jumps, ins_check.rate_status) == (0, RateStatus.MEASURED)


def test_nan_sample_is_rejected() -> None:
    samples = stream(10.0, 50.0)
    samples[300] = replace(samples[300], rotation_nd=np.full((3, 3), np.nan))
    results, _, jumps = check_sample(samples)
    assert [n for n, result in enumerate(results) if result] == [300]
    assert jumps == 0


def test_changed_noise_applies_at_once() -> None:
    samples = stream(20.0, 50.0)
    samples[700] = replace(samples[700], rotation_nd=exp_rotation(np.full(3, 40.0 * ARCSEC)) @ samples[700].rotation_nd)
    for sigma_arcsec, rejected in ((1.0, {"", "GATE"}), (20.0, {""})):
        ins_check = InsCheck(CheckedInsConfig())
        for sample in samples[:500]:
            ins_check.check(sample, NOTHING_LATE, {})
        ins_check.reconfigure(CheckedInsConfig(white_sigma_arcsec=sigma_arcsec))
        later = [ins_check.check(sample, NOTHING_LATE, {}).rejection for sample in samples[500:]]
        assert {"" if rejection is None else rejection.reason.name for rejection in later} == rejected
        assert Counter(rejection is None for rejection in later)[False] <= 1


def test_jump_that_a_clock_step_explains_is_shared_equally() -> None:
    """Mean and covariance equal those of draws that attribute each jump to the attitude or to the clock."""
    rng, jump = np.random.default_rng(5), InsJump(0, np.array([2e-3, -1e-3, 5e-4]), 1e-12, -0.03)
    of_clock = rng.random(40_000) < 0.5
    changed = np.column_stack([-jump.jump_n * ~of_clock[:, None], jump.clock_s * of_clock])
    mean, covariance = jump.shared_with_clock
    scale = np.append(np.abs(jump.jump_n), 0.03)
    np.testing.assert_allclose(changed.mean(axis=0) / scale, mean / scale, atol=0.01)
    scale = np.outer(scale, scale)
    # The sigma of a clock step is a tenth of the step, and two large rotations do not commute.
    np.testing.assert_allclose(np.cov(changed.T) / scale, covariance / scale, atol=0.02)


@pytest.mark.parametrize("step_s", [0.02, -0.05, 0.3])
@pytest.mark.parametrize("rate_hz", [20, 100])
def test_clock_step_of_an_ins_is_identified(step_s: float, rate_hz: int) -> None:
    """The ship rolls by 6 degrees with a period of 8 s; the stamps of her INS step, and her attitude does not."""

    def sample(time_s: float, stamp_s: float) -> AttitudeSample:
        roll, rate = 0.1 * np.sin(0.8 * time_s), 0.08 * np.cos(0.8 * time_s)
        noise = np.random.default_rng(round(1e4 * time_s)).normal(0.0, 5e-6, 3)
        rotation = exp_rotation(noise) @ exp_rotation(np.array([roll, 0.0, 0.0]))
        return AttitudeSample(round(stamp_s * 1e9), rotation, np.array([rate, 0.0, 0.0]))

    ins_check, times_s = InsCheck(CheckedInsConfig()), np.arange(0.0, 25.0, 1.0 / rate_hz)
    results = [ins_check.check(sample(t, t + step_s * (t >= 23.0)), NOTHING_LATE, {}) for t in times_s]
    (jumps,) = [one.jumps for one in results if one.jumps]
    assert jumps[0].is_clock_step
    assert jumps[0].clock_s == pytest.approx(-step_s, rel=0.1)


@pytest.mark.parametrize("per_min_arcsec", [0.0, 100.0, 200.0])
def test_drift_of_the_attitude_against_its_rates_is_detected_within_seconds(per_min_arcsec: float) -> None:
    """The INS error walks by 0.3″ in a second, as a tilt error does; after a hundred seconds the INS also drifts."""
    samples, rng = stream(140.0, 50.0), np.random.default_rng(4)
    walk = np.cumsum(rng.normal(0.0, 0.3 / np.sqrt(50.0), len(samples)))
    drifts_s = [max(one.time_ns - samples[5000].time_ns, 0) * 1e-9 for one in samples]
    off = walk + per_min_arcsec / 60.0 * np.array(drifts_s)
    ins_check, detected_s = InsCheck(CheckedInsConfig()), []
    for one, east, drifting_s in zip(samples, off, drifts_s, strict=True):
        checked = ins_check.check(replace(one, rotation_nd=east_attitude(east) @ one.rotation_nd), NOTHING_LATE, {})
        if checked.jumps:
            detected_s.append(drifting_s)
            assert checked.jumps[0].is_drift
            assert checked.rejection is not None
            assert "drifted" in checked.rejection.text
    assert bool(detected_s) == (per_min_arcsec > 0.0)
    assert not detected_s or 0.0 < detected_s[0] < 7.0


@pytest.mark.parametrize(("every", "phase"), [(5, 1), (10, 2)])
def test_two_ins_on_one_topic_are_checked_to_the_end(every: int, phase: int) -> None:
    samples, other_d = stream(duration_s=40.0, rate_hz=50.0), exp_rotation([0.0, 0.0, np.deg2rad(0.5)])
    other = [replace(sample, rotation_nd=sample.rotation_nd @ other_d) for sample in samples[phase::every]]
    both = sorted([*samples[::5], *other], key=lambda sample: sample.time_ns)
    results, _, _ = check_sample(both)
    assert len(results) == len(both)

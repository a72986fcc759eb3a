"""Excess noise of an INS: detected in time, with its size and end; no false detection."""

import os
from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.ins_check import InsCheck
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack, ExtraNoise
from ship_testing.every_case import check_every_case
from ship_testing.ins_streams import CALM, STORM, SWELL, Angles, stream, with_step

NOTHING_LATE = AttitudeTrack(500_000_000)
HOURS = float(os.environ.get("NOISE_HOURS", "0.5"))
"""Hours of each healthy stream up to 20 Hz, fewer at 100 Hz; set ``NOISE_HOURS=10`` for 10."""


def noisy(samples: list[AttitudeSample], sigma_arcsec: float, first: int) -> list[AttitudeSample]:
    """Return the samples with additional attitude noise from sample number ``first`` on."""
    turns = exp_rotation(sigma_arcsec * ARCSEC * np.random.default_rng(3).standard_normal((len(samples), 3)))
    return [
        replace(sample, rotation_nd=turn @ sample.rotation_nd) if number >= first else sample
        for number, (sample, turn) in enumerate(zip(samples, turns, strict=True))
    ]


def with_jitter(samples: list[AttitudeSample], sigma_s: float, first: int) -> list[AttitudeSample]:
    late_ns = np.abs(np.random.default_rng(4).normal(0.0, sigma_s * 1e9, len(samples))).astype(int)
    return [
        replace(sample, time_ns=sample.time_ns + int(late)) if number >= first else sample
        for number, (sample, late) in enumerate(zip(samples, late_ns, strict=True))
    ]


def changes(samples: list[AttitudeSample], **config: float) -> list[tuple[float, ExtraNoise]]:
    """Return the changes of the noise: time after the first sample, s, and the noise then."""
    ins_check, found = InsCheck(CheckedInsConfig(**config)), []
    for sample in samples:
        checked: CheckedInsSample = ins_check.check(sample, NOTHING_LATE, {})
        if checked.noise is not None:
            found.append(((sample.time_ns - samples[0].time_ns) * 1e-9, checked.noise))
    return found


def sigma_arcsec(noise: ExtraNoise) -> float:
    return float(np.sqrt(noise.white_rad2)) / ARCSEC


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize(("ratio", "within_s"), [(3.0, 2.0), (10.0, 2.0), (30.0, 2.0)])
def test_large_excess_is_detected_within_two_seconds(rate_hz: float, ratio: float, within_s: float) -> None:
    """At ten samples a second the necessary 20 steps take twice as long."""
    onset_s = 30.0
    found = changes(noisy(stream(40.0, rate_hz), ratio, round(onset_s * rate_hz)))
    assert onset_s < found[0][0] < onset_s + within_s * max(1.0, 20.0 / rate_hz)
    assert 0.7 * ratio < sigma_arcsec(found[-1][1]) < 1.4 * ratio


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_excess_of_one_half_is_detected_within_half_a_minute(rate_hz: float) -> None:
    # Noise of 1″ and further noise make 1.5″ together.
    found = changes(noisy(stream(90.0, rate_hz), np.sqrt(1.5**2 - 1.0), round(40.0 * rate_hz)))
    assert 40.0 < found[0][0] < 70.0


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_jitter_is_distinguished_from_attitude_noise_and_its_end_is_detected(rate_hz: float) -> None:
    samples = stream(60.0, rate_hz)
    first, last = round(30.0 * rate_hz), round(45.0 * rate_hz)
    ends = [*with_jitter(samples[:last], 0.004, first), *samples[last:]]
    found = changes(ends)
    assert 30.0 < found[0][0] < 32.0
    # The standard deviation of the folded normal is 0.60 of its parameter.
    jitter_s = float(np.sqrt(next(noise for time_s, noise in reversed(found) if time_s < 45.0).jitter_s2))
    assert 0.7 * 0.6 * 0.004 < jitter_s < 1.4 * 0.6 * 0.004
    assert found[-1][0] < 48.0
    assert found[-1][1].white_rad2 == found[-1][1].jitter_s2 == 0.0
    assert found[-1][1].clock_sigma_s > 0.0


def test_at_rest_jitter_is_not_reported() -> None:
    moving, resting = stream(30.0, 50.0), stream(30.0, 50.0, amplitude_deg=(0.0, 0.0, 0.0))
    later_ns = moving[-1].time_ns + 20_000_000 - resting[0].time_ns
    samples = [*moving, *(replace(sample, time_ns=sample.time_ns + later_ns) for sample in resting)]
    assert not changes(with_jitter(samples, 0.004, len(moving)))


HEALTHY: dict[str, dict[str, object]] = {
    "swell at 20 Hz": {"rate_hz": 20.0},
    "storm at 20 Hz": {"rate_hz": 20.0, "amplitude_deg": STORM},
    "calm at 20 Hz": {"rate_hz": 20.0, "amplitude_deg": CALM},
    "noisy rates": {"rate_hz": 20.0, "rate_noise_arcsec_per_s": 60.0},
    "rates that lag": {"rate_hz": 20.0, "rate_delay_s": 0.002},
    "rates a thousandth too large": {"rate_hz": 20.0, "rate_factor": 1.001, "bias_arcsec_per_s": 10.0},
    "a turn": {"rate_hz": 20.0, "turn_deg_per_s": 5.0},
    "five samples a second": {"rate_hz": 5.0},
    "a hundred samples a second": {"rate_hz": 100.0},
}


@pytest.mark.slow
def test_healthy_streams_have_no_excess() -> None:
    def check(name: str) -> None:
        kind = HEALTHY[name]
        samples = stream(HOURS * 3600.0 * min(20.0 / float(str(kind["rate_hz"])), 1.0), **kind)  # type: ignore[arg-type]
        assert changes(samples) == []

    check_every_case(((name,) for name in HEALTHY), check)


@pytest.mark.parametrize("amplitude_deg", [SWELL, STORM])
def test_steps_are_not_noise(amplitude_deg: Angles) -> None:
    samples = stream(60.0, 20.0, amplitude_deg)
    for number, first in enumerate(range(500, 1200, 60)):
        samples = with_step(samples, first, (0.0, 40.0 * (-1.0) ** number, 0.0), first + 30)
    assert changes(samples) == []


def test_a_larger_stated_noise_has_no_excess() -> None:
    samples = noisy(stream(60.0, 20.0), 5.0, 0)
    assert changes(samples, white_sigma_arcsec=5.1) == []
    assert changes(samples, white_sigma_arcsec=1.0) != []


def test_larger_stated_noise_ends_or_reduces_an_excess() -> None:
    """Noise of 1″ and further noise of 5″ make 5.1″ together."""
    samples = noisy(stream(20.0, 20.0), 5.0, 0)
    for stated_arcsec, excess_arcsec in ((5.1, 0.0), (2.0, np.sqrt(26.0 - 4.0))):
        ins_check = InsCheck(CheckedInsConfig(white_sigma_arcsec=1.0))
        for sample in samples[:-1]:
            ins_check.check(sample, NOTHING_LATE, {})
        assert ins_check.comparison.excess_text != ""
        ins_check.reconfigure(CheckedInsConfig(white_sigma_arcsec=stated_arcsec))
        noise = ins_check.check(samples[-1], NOTHING_LATE, {}).noise
        assert noise is not None
        assert noise.from_ns == samples[-2].time_ns
        assert sigma_arcsec(noise) == pytest.approx(excess_arcsec, rel=0.3)
        assert (ins_check.comparison.excess_text != "") == (excess_arcsec > 0.0)


def test_extra_noise_applies_from_its_stamp_on() -> None:
    track, rate_d = AttitudeTrack(10**9), np.array([0.1, 0.0, 0.0])
    for number in range(5):
        rotation_nd: FloatArray = exp_rotation(0.1 * number * rate_d)
        track.insert(AttitudeSample(number * 10**8, rotation_nd, rate_d))
    without = {time_ns: track.at(time_ns) for time_ns in (150_000_000, 200_000_000, 250_000_000)}
    assert track.add_noise(ExtraNoise(200_000_000, white_rad2=4e-10, jitter_s2=1e-6)) == 199_999_999
    expected_d = np.diag([4e-10 + 1e-8, 4e-10, 4e-10])
    for time_ns, before in without.items():
        found = track.at(time_ns)
        assert before is not None
        assert found is not None
        more_d = found.error_covariance_d - before.error_covariance_d
        expected = before.noise_gain * expected_d if time_ns >= 200_000_000 else 0.0 * expected_d
        np.testing.assert_allclose(more_d, expected, atol=1e-18)
    np.testing.assert_allclose(track.propagate_newest(0.0).error_covariance_d, expected_d, rtol=1e-6, atol=1e-15)

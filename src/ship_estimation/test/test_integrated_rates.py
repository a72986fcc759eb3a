"""Steps of an INS attitude against the rates of the same INS: detection, time and size of each step."""

import os
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import chi, chi2

from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import InsJump
from ship_estimation.plausibility.ins_check import InsCheck
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_testing.ins_streams import CALM, STORM, SWELL, stream, with_step

RATES_HZ = (20.0, 50.0, 100.0, 200.0)
LEARNT_S = 16.0
"""Time after which the statistics of the INS are known, s."""
DAY_EARTH = 2.0 * np.pi / 86164.0905
TEN_MINUTES = int(os.environ.get("TEN_MINUTES", "2"))
"""Number of runs of ten minutes without a step; ``make campaign`` uses more."""
NOTHING_LATE = AttitudeTrack(500_000_000)


class CheckedStream(NamedTuple):
    """Indices of the rejected samples of a run, and jumps by the index of the sample that reported them."""

    rejected: list[int]
    jumps: dict[int, tuple[InsJump, ...]]
    ins_check: InsCheck


def check_stream(samples: Iterable[AttitudeSample], **config: Any) -> CheckedStream:
    found = CheckedStream([], {}, InsCheck(CheckedInsConfig(**config)))
    for number, sample in enumerate(samples):
        checked = found.ins_check.check(sample, NOTHING_LATE, {})
        if checked.rejection is not None:
            found.rejected.append(number)
        if checked.jumps:
            found.jumps[number] = checked.jumps
    return found


def number_at(rate_hz: float, seconds: float = LEARNT_S) -> int:
    return round(seconds * rate_hz)


def assert_inflated(
    found: CheckedStream, samples: list[AttitudeSample], first: int, arcsec_n: tuple[float, float, float]
) -> None:
    """Check that one step was found, at the right time, and that the covariance covers it."""
    (jumps,) = found.jumps.values()
    taken = next(n for n in range(first, len(samples)) if n not in found.rejected)
    assert jumps[0].time_ns < samples[taken].time_ns
    assert jumps[-1].time_ns >= samples[first - 1].time_ns
    jump, step_n = jumps[-1], np.array(arcsec_n) * ARCSEC
    assert step_n @ np.linalg.solve(jump.covariance_n, step_n) < chi2(3).isf(1e-4)
    assert np.linalg.norm(jump.jump_n - step_n) < chi(3).isf(1e-4) * jump.sigma_rad


# -- steps ---------------------------------------------------------------------------------------------------------


@pytest.mark.statistics
@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize(
    "motion",
    [
        {"amplitude_deg": CALM},
        {"amplitude_deg": SWELL},
        {"amplitude_deg": STORM},
        {"amplitude_deg": CALM, "turn_deg_per_s": 10.0},
        {"amplitude_deg": SWELL, "turn_deg_per_s": 20.0},
    ],
    ids=["calm", "swell", "storm", "10 deg/s", "20 deg/s in swell"],
)
def test_steps_from_fourteen_sigma_on_are_detected_at_the_sample(rate_hz: float, motion: dict[str, Any]) -> None:
    """White noise of 1″; each sample after the step is rejected until the step is accepted, five samples later."""
    samples, first = stream(LEARNT_S + 1.0, rate_hz, **motion), number_at(rate_hz)
    for axis, arcsec in ((0, 14.0), (1, 14.0), (2, -20.0), (1, 30.0), (0, 100.0), (1, 300.0)):
        step = tuple(arcsec * np.eye(3)[axis])
        changed = with_step(samples, first, step)
        found = check_stream(changed)
        assert found.rejected == list(range(first, first + 5))
        assert list(found.jumps) == [first + 5]
        assert_inflated(found, changed, first, step)


@pytest.mark.statistics
@pytest.mark.parametrize(("rate_hz", "least_arcsec"), [(20.0, 12.0), (50.0, 7.0), (100.0, 6.0), (200.0, 5.0)])
def test_smaller_steps_are_detected_within_a_fifth_of_a_second(rate_hz: float, least_arcsec: float) -> None:
    """Forty runs for each rate; ``least_arcsec`` is the value in the documentation."""
    first = number_at(rate_hz)
    for seed in range(40):
        step = np.random.default_rng(seed).standard_normal(3)
        arcsec_n = tuple(least_arcsec * step / np.linalg.norm(step))
        changed = with_step(stream(LEARNT_S + 1.0, rate_hz, seed=seed), first, arcsec_n)
        found = check_stream(changed)
        assert len(found.jumps) == 1, seed
        # After a rejection the consistent samples are counted again.
        assert first <= min([*found.rejected, *found.jumps]) <= first + round(0.2 * rate_hz), seed
        # Means find a smaller step after some of its samples are accepted: the sample at the detection is rejected.
        (known,) = found.jumps
        assert known in found.rejected or known - 1 in found.rejected, seed
        assert_inflated(found, changed, first, arcsec_n)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("length", [1, 2, 5])
@pytest.mark.parametrize("arcsec", [14.0, 30.0, 300.0])
def test_a_step_that_goes_back_is_a_glitch(rate_hz: float, length: int, arcsec: float) -> None:
    first = number_at(rate_hz)
    found = check_stream(with_step(stream(LEARNT_S + 1.0, rate_hz), first, (0.0, arcsec, 0.0), first + length))
    assert found.rejected == list(range(first, first + length))
    assert not found.jumps


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("arcsec", [200.0, 300.0])
def test_steps_of_an_ins_with_a_resolution_of_a_hundredth_of_a_degree_are_detected(
    rate_hz: float, arcsec: float
) -> None:
    first = number_at(rate_hz)
    changed = with_step(stream(LEARNT_S + 1.0, rate_hz, printed_deg=0.01), first, (0.0, arcsec, 0.0))
    found = check_stream(changed)
    assert found.rejected == list(range(first, first + 5))
    assert_inflated(found, changed, first, (0.0, arcsec, 0.0))


@pytest.mark.parametrize("turned_too", [False, True])
def test_permanently_exchanged_axes_are_rejected_and_then_inflate_the_covariance(turned_too: bool) -> None:
    """Bow and starboard are exchanged in the attitudes, with ``turned_too`` also in the rates."""
    samples, first = stream(LEARNT_S + 4.0, 50.0), number_at(50.0)
    exchange = rotation_from_angles(np.pi / 2.0, 0.0, 0.0)
    changed = [replace(s, rotation_nd=s.rotation_nd @ exchange) for s in samples[first:]]
    if turned_too:
        changed = [replace(s, rate_d=exchange.T @ s.rate_d) for s in changed]
    found = check_stream([*samples[:first], *changed])
    assert found.rejected[:5] == list(range(first, first + 5))
    ((number, jumps),) = found.jumps.items()
    assert number == found.rejected[-1] + 1
    assert number <= first + round(0.7 * 50.0)
    assert np.linalg.norm(jumps[0].jump_n) == pytest.approx(np.pi / 2.0, abs=0.1)


@pytest.mark.parametrize("missing", ["none", "nan"])
def test_occasionally_missing_rates_do_not_end_the_line(missing: str) -> None:
    samples, first = stream(LEARNT_S + 1.0, 100.0), number_at(100.0)
    gone = None if missing == "none" else np.full(3, np.nan)
    samples = [replace(s, rate_d=gone) if n % 7 == 3 and abs(n - first) > 1 else s for n, s in enumerate(samples)]
    changed = with_step(samples, first, (0.0, 14.0, 0.0))
    found = check_stream(changed)
    assert first <= min(found.rejected) <= first + 1
    assert_inflated(found, changed, first, (0.0, 14.0, 0.0))


def test_freeze_in_a_slow_rotation_is_detected_with_known_rate_drift() -> None:
    """The gyroscopes have a bias of 30″/s and measure the Earth rate; the INS freezes during a rotation of 40″/s.

    Rates with an error of up to 60″/s cannot distinguish such a rotation from a bias that is not yet known.
    """
    earth_n = DAY_EARTH * np.array([0.5, np.sqrt(0.75), 0.0])
    errors = {"bias_arcsec_per_s": 30.0, "earth_n": earth_n}
    for known_s, seen in ((60.0, True), (3.0, False)):
        waves = stream(known_s, 100.0, **errors)
        slow = stream(4.0, 100.0, (0.0, 0.0, 0.0), turn_deg_per_s=40.0 / 3600.0, **errors)
        # After the waves the ship continues without them.
        onto = waves[-1].rotation_nd @ slow[0].rotation_nd.T
        after_ns = waves[-1].time_ns - slow[0].time_ns + 10_000_000
        moving = [replace(s, time_ns=s.time_ns + after_ns, rotation_nd=onto @ s.rotation_nd) for s in slow]
        frozen = [replace(s, rotation_nd=moving[99].rotation_nd) for s in moving[100:]]
        found = check_stream([*waves, *moving[:100], *frozen], rate_has_earth_rate=True)
        assert bool([n for n in found.rejected if n >= len(waves) + 100]) == seen


# -- none ----------------------------------------------------------------------------------------------------------


@pytest.mark.statistics
def test_noise_alone_is_no_step_in_the_reference_motion() -> None:
    """The bound is 7.3 sigma of three axes. Six tests per sample at 100 Hz give at most 3.4e-5 false steps an hour.

    The test runs over twenty minutes of samples, in ``make campaign`` over an hour.
    """
    per_hour = 6 * 360_000 * chi(3).sf(7.3)
    assert per_hour < 4e-5
    kinds = {"rate_noise_arcsec_per_s": 5.0, "bias_arcsec_per_s": 5.0}
    rejected = jumps = 0
    for seed in range(TEN_MINUTES):
        found = check_stream(stream(600.0, 100.0, seed=seed, **kinds), rate_sigma_arcsec_per_s=5.0)
        rejected, jumps = rejected + len(found.rejected), jumps + len(found.jumps)
    assert (rejected, jumps) == (0, 0)


@pytest.mark.statistics
@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
@pytest.mark.parametrize("amplitude_deg", [CALM, SWELL, STORM])
@pytest.mark.parametrize(
    "kinds",
    [
        {"printed_deg": 0.01},
        {"white_arcsec": 5.0},
        {"rate_noise_arcsec_per_s": 60.0},
        {"rate_delay_s": 0.002},
        {"bias_arcsec_per_s": 60.0, "rate_factor": 1.002},
    ],
    ids=["printed", "noisier than configured", "noisy rates", "rates that lag", "bias and scale"],
)
def test_larger_noise_than_configured_is_estimated(rate_hz: float, amplitude_deg: Any, kinds: dict[str, float]) -> None:
    found = check_stream(stream(120.0, rate_hz, amplitude_deg, **kinds))
    assert (found.rejected, found.jumps) == ([], {})


def test_start_of_a_rotation_is_no_step() -> None:
    """The rotation reaches 20°/s within four seconds; its rates lag by 2 ms and are 0.1 % too large."""
    t_s = np.arange(0.0, 40.0, 0.01)

    def true_nd(at_s: FloatArray) -> FloatArray:
        since_s = np.clip(at_s - 20.0, 0.0, None)
        ramp_s = np.minimum(since_s, 4.0)
        heading_deg = 2.5 * ramp_s**2 + 20.0 * (since_s - ramp_s)
        return rotation_from_angles(*np.deg2rad([heading_deg, 0.0 * at_s, 0.3 * np.sin(2.0 * np.pi * at_s / 9.0)]))

    noise = ARCSEC * np.random.default_rng(3).standard_normal((t_s.size, 3))
    before, after = (true_nd(t_s - 0.002 + step_s) for step_s in (-1e-4, 1e-4))
    rate_d = 1.001 * log_rotation(np.swapaxes(before, 1, 2) @ after) / 2e-4
    values = zip(t_s, exp_rotation(noise) @ true_nd(t_s), rate_d, strict=True)
    samples = [AttitudeSample(10**18 + round(t * 1e9), rotation_nd, rate) for t, rotation_nd, rate in values]
    found = check_stream(samples)
    assert (found.rejected, found.jumps) == ([], {})
    assert check_stream(with_step(samples, 3000, (0.0, 14.0, 0.0))).rejected == list(range(3000, 3005))


@pytest.mark.slow
def test_changed_rate_noise_applies_at_once() -> None:
    """A configured rate noise of 60″/s makes the line before the step shorter, and steps of 14″ are detected."""
    first = number_at(100.0)
    counts = []
    for sigma in (0.0, 60.0):
        seen = 0
        for seed in range(10):
            samples = stream(LEARNT_S + 1.0, 100.0, rate_noise_arcsec_per_s=60.0, seed=seed)
            found = check_stream(with_step(samples, first, (0.0, 14.0, 0.0)), rate_sigma_arcsec_per_s=sigma)
            seen += found.rejected[:1] == [first]
        counts.append(seen)
    assert counts[0] <= 5
    assert counts[1] >= 8
    ins_check = InsCheck(CheckedInsConfig())
    samples, first = stream(32.0, 100.0, rate_noise_arcsec_per_s=60.0), number_at(100.0, 30.0)
    samples, rejected = with_step(samples, first, (0.0, 20.0, 0.0)), []
    for number, sample in enumerate(samples):
        if number == 100:
            ins_check.reconfigure(CheckedInsConfig(rate_sigma_arcsec_per_s=60.0))
        if ins_check.check(sample, NOTHING_LATE, {}).rejection is not None:
            rejected.append(number)
    assert rejected[0] == first

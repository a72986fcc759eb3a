"""Results of the ship check do not depend on the announced batch of samples, right or wrong."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest

from ship_estimation.parameters.ins import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.ins_check import InsCheck
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeTrack
from theodolite_calib.samples.batch_ship_check import BatchShipCheck, stated_step_rad
from theodolite_calib.samples.samples import ShipSample

CONFIG = CheckedInsConfig(white_sigma_arcsec=2.0)
RATE_HZ, SECONDS = 50, 30
STEP_NS = 1_000_000_000 // RATE_HZ
COUNT = RATE_HZ * SECONDS
BLOCK = 170
RNG_SEED = 8


def rolling(time_s: float) -> FloatArray:
    return exp_rotation(np.array([0.1 * np.sin(0.8 * time_s), 0.02 * time_s, 0.05 * np.sin(1.1 * time_s + 0.4)]))


def voyage(jump_at: int | None = None, wrong_rates_from: int | None = None) -> list[ShipSample]:
    """Return samples of a rolling ship; the stated sigma is reset every 2 s and grows fast in every third period."""
    rng, samples = np.random.default_rng(RNG_SEED), []
    for k in range(COUNT):
        time_s = k / RATE_HZ
        rotation_nd, h_s = rolling(time_s), 1e-4
        turned = rolling(time_s - h_s).T @ rolling(time_s + h_s)
        rate_d = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / (2.0 * h_s)
        if wrong_rates_from is not None and k >= wrong_rates_from:
            rate_d = 3.0 * rate_d
        if jump_at is not None and k >= jump_at:
            rotation_nd = exp_rotation([0.0, 0.01, 0.0]) @ rotation_nd
        rotation_nd = rotation_nd @ exp_rotation(2.0 * ARCSEC * rng.standard_normal(3))
        period, since = divmod(k, 2 * RATE_HZ)
        sigma_rad = (10.0 + (1e-4 if period % 3 else 0.02) * since) * ARCSEC
        samples.append(ShipSample(k * STEP_NS, rotation_nd, rate_d, sigma_rad**2 * np.eye(3)))
    return samples


class Run:
    """Ship check of single samples or of batches, with its results; the stated steps are as in ``ship_check``."""

    def __init__(self, ship_check: BatchShipCheck | InsCheck) -> None:
        self.ship_check, self.results = ship_check, []
        self._used, self._stated = AttitudeTrack(500_000_000), None

    def check_samples(self, samples: Iterable[ShipSample]) -> None:
        for sample in samples:
            stated_rad = stated_step_rad(sample.correlated_covariance_n, self._stated)
            checked = self._check(sample, stated_rad)
            self.results.append((comparable_result(checked), self.ship_check.rate_status))
            if checked.rejection is None and (self._used.newest is None or sample.time_ns > self._used.newest.time_ns):
                self._stated = sample.correlated_covariance_n
                self._used.insert(checked.sample)

    def _check(self, sample: ShipSample, reported_step_rad: float) -> CheckedInsSample:
        if isinstance(self.ship_check, InsCheck):
            return self.ship_check.check(sample, self._used, {}, reported_step_rad)
        return self.ship_check.check(sample, self._used, reported_step_rad)


def comparable_result(result: CheckedInsSample) -> tuple[Any, ...]:
    """Return all fields of a result, comparable to the bit."""
    jumps = tuple((jump.time_ns, jump.jump_n.tolist(), jump.sigma_rad, jump.is_drift) for jump in result.jumps)
    return result.sample.content(), result.rejection, jumps, result.rates_wrong_after_ns


def one_by_one(samples: Sequence[ShipSample]) -> list[Any]:
    run = Run(InsCheck(CONFIG))
    run.check_samples(samples)
    return run.results


VOYAGES = {
    "calm": voyage(),
    "jump": voyage(jump_at=1100),
    "wrong rates": voyage(wrong_rates_from=900),
}


@pytest.mark.parametrize("name", VOYAGES)
def test_announced_batch_gives_the_same_results(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ahead, looked = [], InsCheck.check_block

    def count_calls(ship_check: InsCheck, *arguments: Any) -> Any:
        followed = looked(ship_check, *arguments)
        ahead.append(followed.count)
        return followed

    monkeypatch.setattr(InsCheck, "check_block", count_calls)
    run, samples = Run(BatchShipCheck(CONFIG)), VOYAGES[name]
    for start in range(0, COUNT, BLOCK):
        run.ship_check.expect(samples[start : start + BLOCK])
        run.check_samples(samples[start : start + BLOCK])
    assert run.results == one_by_one(samples)
    assert sum(ahead) > COUNT // 3
    if name != "calm":
        assert any(one[0][1] is not None or one[0][3] is not None for one in run.results)


@pytest.mark.parametrize("name", VOYAGES)
def test_wrong_announcement_gives_the_same_results(name: str) -> None:
    """Every block lacks one of its samples, has one twice, or changes its order at some sample."""
    run, samples, came = Run(BatchShipCheck(CONFIG)), VOYAGES[name], []
    for number, start in enumerate(range(0, COUNT, BLOCK)):
        block = samples[start : start + BLOCK]
        middle = len(block) // 2
        coming = [
            block[:middle] + block[middle + 1 :],
            block[:middle] + block[middle - 1 :],
            [*block[:middle], block[middle + 1], block[middle], *block[middle + 2 :]],
        ][number % 3]
        run.ship_check.expect(block)
        run.check_samples(coming)
        came += coming
    assert run.results == one_by_one(came)


def test_partial_or_early_announcement_gives_the_same_results() -> None:
    run, samples = Run(BatchShipCheck(CONFIG)), VOYAGES["calm"]
    run.check_samples(samples[:600])
    run.ship_check.expect(samples[600:700])
    run.ship_check.expect(samples[700:900])
    run.check_samples(samples[600:800])
    run.ship_check.expect(samples[900:1000])  # samples 800 to 900 have not arrived yet
    run.check_samples(samples[800:])
    assert run.results == one_by_one(samples)


def test_noise_change_within_a_batch() -> None:
    run, plain, samples = Run(BatchShipCheck(CONFIG)), Run(InsCheck(CONFIG)), VOYAGES["calm"]
    louder = CheckedInsConfig(white_sigma_arcsec=20.0)
    run.ship_check.expect(samples)
    for some in (slice(0, 1000), slice(1000, COUNT)):
        for one in (run, plain):
            one.check_samples(samples[some])
            one.ship_check.reconfigure(louder)
    assert run.results == plain.results


def test_unreported_step_is_checked_one_by_one() -> None:
    ship_check, used, samples = BatchShipCheck(CONFIG), AttitudeTrack(500_000_000), voyage()
    at = 6 * RATE_HZ
    for sample in samples[:at]:
        used.insert(ship_check.check(sample, used, 0.0).sample)
    ship_check.expect(samples[at : at + BLOCK])
    ship_check.check(samples[at], used, np.nan)
    assert ship_check._checked_block is None
    ship_check.check(samples[at + 1], used, 0.0)
    assert ship_check._checked_block is not None

"""The INS step detector: samples of a block against the same samples one by one.

Its detections are tested in test_integrated_rates.
"""

import copy
import math
from typing import Any

import numpy as np
import pytest

from ship_estimation.plausibility.ins_step_detector import InsStepDetector, LineUpdate
from ship_estimation.plausibility.integrated_rates import IntegratedAttitude, IntegratedRun
from ship_geometry.rotations import exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample

_RATE_NS, _SAMPLES = 10_000_000, 3000


class Stream:
    """Samples of a constant attitude with noise, and the attitude by integrated rates, which drifts."""

    def __init__(self, stepped_from: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        turned = rng.normal(0.0, 5e-6, (_SAMPLES, 3))
        turned[stepped_from:] += [0.0, 4e-5, 0.0]
        self.times_ns = np.arange(_SAMPLES) * _RATE_NS
        self.rotations = np.array([exp_rotation(vector) for vector in turned])
        drift = np.arange(_SAMPLES)[:, None] * np.array([1e-8, 0.0, 2e-8])
        self.by_rates = np.array([exp_rotation(vector) for vector in drift])
        self.rates = rng.normal(0.0, 1e-5, (_SAMPLES, 3))
        # The integration error grows irregularly, so that the bounds must widen sometimes.
        self.missed = np.cumsum(rng.choice([1e-9, 5e-7], _SAMPLES, p=[0.99, 0.01]))

    def look(self, detector: InsStepDetector, number: int) -> bool | None:
        """Check one sample; the caller accepts it."""
        sample = AttitudeSample(int(self.times_ns[number]), self.rotations[number], self.rates[number])
        integrated = IntegratedAttitude(self.by_rates[number], 0, float(self.missed[number]))
        return detector.check(sample, integrated, first_rad=1e-4, coarseness_rad=0.0)

    def follow(self, detector: InsStepDetector, some: slice) -> tuple[int, LineUpdate | None]:
        """Accept some samples as a block."""
        integrated = IntegratedRun(self.by_rates[some], 0, self.missed[some])
        return detector.accept_block(self.times_ns[some], self.rotations[some], self.rates[some], integrated, 1e-4, 0.0)


def _state(detector: InsStepDetector) -> dict[str, Any]:
    """Return the state of the detector, without unused rows."""
    state = dict(vars(detector))
    for name in ("_rows", "_rates", "_times"):
        state[name] = state[name][: detector._end]
    return {name: value.tobytes() if isinstance(value, np.ndarray) else value for name, value in state.items()} | {
        "_period": detector._period.ns,
        "_full": None,
        "_plan": detector.smallest_rad,
    }


def has_no_step(update: LineUpdate | None) -> bool:
    """True if accepted samples show no step."""
    return update is None or update.step is None


@pytest.mark.parametrize("block", [1, 7, 64, 500])
def test_block_gives_the_state_of_single_samples(block: int) -> None:
    stream, step = Stream(stepped_from=2000, seed=1), 2000
    single = InsStepDetector(5e-6, 0.0)
    for number in range(1000):
        stream.look(single, number)
        assert has_no_step(single.accept())
    together, number = copy.deepcopy(single), 1000
    while (followed := stream.follow(together, slice(number, number + block)))[0]:
        count, update = followed
        for other in range(number, number + count):
            assert stream.look(single, other)
            last = single.accept()
            assert has_no_step(last)
        assert repr(last) == repr(update)
        assert _state(single) == _state(together)
        number += count
    # accept_block() stops before the first sample that may be off the line; check() decides about this sample.
    assert step <= number < step + 20
    assert stream.look(single, number) is not None
    assert max(single._sizes) > 1.0


def test_nan_sample_is_not_accepted_in_a_block() -> None:
    stream, detector = Stream(stepped_from=_SAMPLES, seed=2), InsStepDetector(5e-6, 0.0)
    for number in range(1000):
        stream.look(detector, number)
        detector.accept()
    stream.rotations[1010] = np.nan
    assert stream.follow(detector, slice(1000, 1100))[0] == 10


def test_samples_after_a_gap_are_not_accepted_in_a_block() -> None:
    stream, detector = Stream(stepped_from=_SAMPLES, seed=3), InsStepDetector(5e-6, 0.0)
    for number in range(1000):
        stream.look(detector, number)
        detector.accept()
    stream.times_ns[1020:] += 9 * _RATE_NS
    assert stream.follow(detector, slice(1000, 1100))[0] == 20


def test_statistics_start_before_the_first_bound_is_known() -> None:
    stream, detector = Stream(stepped_from=2000, seed=1), InsStepDetector(5e-6, 0.0)
    for number in range(1900):
        sample = AttitudeSample(int(stream.times_ns[number]), stream.rotations[number], stream.rates[number])
        integrated = IntegratedAttitude(stream.by_rates[number], 0, 0.0)
        detector.check(sample, integrated, first_rad=math.inf, coarseness_rad=0.0)
        assert has_no_step(detector.accept())
    assert detector.is_ready
    assert detector.smallest_rad < 1e-4

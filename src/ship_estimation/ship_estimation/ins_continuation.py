"""Where the samples of an INS lead: by its rates, by the motion before, or only by what a hull can turn in the time."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ship_estimation.jump_guard import Continuation, Step, far_bound_rad, size, within
from ship_estimation.rate_guard import RateGuard, RateIntegrator, Rates
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation

_LARGEST_ACCELERATION = math.radians(60.0)
"""Of a hull: a small craft that rolls by 30 degrees in five seconds comes to 47 degrees per second squared."""
_LONGEST_STEP_S = 1.0
_CHANGE_SHARE = 0.25
"""Of the change of the rate over a step, times its time: what the mean of two rates may miss of the turn."""
_SHORTEST_PERIOD_S = 4.0
"""Of a hull's motion: the mean of two rates then gives the turn but for (2 pi h / period)² / 12 of it."""


class Known(NamedTuple):
    """A sample and what led to it.

    Attributes:
        sample: itself.
        number: of all samples.
        before: the one that tells how it moves; None where there is none.
        integrated: attitude by the rates alone at its stamp; None where it has no rate.
        leg: which unbroken run of rates it belongs to.
        missed_rad: what the integration may have missed since that began.
    """

    sample: AttitudeSample
    number: int
    before: AttitudeSample | None
    integrated: FloatArray | None
    leg: int
    missed_rad: float

    def moved_by(self, before: AttitudeSample | None) -> "Known":
        """The same where another one tells how it moves."""
        return Known(self.sample, self.number, before, self.integrated, self.leg, self.missed_rad)


class Way(NamedTuple):
    """Where an earlier sample leads, and where the later one is.

    Attributes:
        difference_n: of the later one from there, rotation vector in the horizon frame, rad, shape (3,).
        bound_rad: how large that may be.
        led: whether something led there, and not only the time that has passed.
    """

    difference_n: FloatArray
    bound_rad: float
    led: bool = True

    @property
    def kept(self) -> bool:
        """Whether the later sample is where the earlier one leads."""
        return within(self.difference_n, self.bound_rad)

    def refusal(self) -> Refusal:
        """Why the later sample is not believed."""
        off, bound = math.degrees(size(self.difference_n)), math.degrees(self.bound_rad)
        text = f"orientation is {off:.3g}° from where the samples before lead: more than {bound:.3g}°"
        return Refusal(Reason.GATE, text)


class InsContinuation:
    """Compares the samples of one INS with where those before lead, and learns how far good ones are from there.

    Args:
        sigma_rad: noise of an attitude about its worst axis.
        stuck: knows how coarsely the attitudes are printed.
        rates: knows what the rates are worth.
    """

    def __init__(self, sigma_rad: float, stuck: StuckGuard, rates: RateGuard) -> None:
        self._stuck, self._rates = stuck, rates
        self._integrator = RateIntegrator()
        self._by_rates, self._by_motion = Continuation(sigma_rad), Continuation(sigma_rad)

    def reconfigure(self, sigma_rad: float) -> None:
        """Go on with another noise."""
        self._by_rates.sigma_rad = self._by_motion.sigma_rad = sigma_rad

    @property
    def rates_trusted(self) -> bool:
        """Whether the rates are known to be measured."""
        return self._rates.rates is Rates.MEASURED

    @property
    def rate_noise_rad(self) -> float:
        """What the noise of a rate adds to an attitude integrated from sample to sample, each axis."""
        return self._by_rates.typical_rad / math.sqrt(6.0)

    def known(self, previous: Known | None, sample: AttitudeSample) -> Known:
        """The next sample, joined to the one before by its rates where it can be."""
        if sample.rate_d is None:
            self._integrator.interrupt()
        joined = sample.rate_d is not None and self._integrator.advance(sample.time_ns, sample.rate_d)
        integrated = None if sample.rate_d is None else self._integrator.rotation
        if previous is None:
            return Known(sample, 0, None, integrated, 0, 0.0)
        missed_rad = previous.missed_rad + _missed_rad(previous.sample, sample) if joined else 0.0
        leg = previous.leg if joined else previous.leg + 1
        return Known(sample, previous.number + 1, previous.sample, integrated, leg, missed_rad)

    def way(self, start: Known, end: Known) -> Way:
        """The way by the rates of all samples between or, where these do not lead there, by the motion before."""
        if not self.rates_trusted or start.leg != end.leg:
            return self.moved(start, end)
        return self._led(start, end, end.number - start.number, end.missed_rad - start.missed_rad)

    def moved(self, start: Known, end: Known) -> Way:
        """The way by going on as before; where that is too long, only the time bounds it."""
        seconds, before = _seconds(start.sample, end.sample), start.before
        turned_s = 0.0 if before is None else _seconds(before, start.sample)
        if before is None or max(seconds, turned_s) > _LONGEST_STEP_S:
            return self.far(start.sample, end.sample)
        ratio = seconds / turned_s
        turn_d = ratio * log_rotation(before.rotation_nd.T @ start.sample.rotation_nd)
        difference_n = log_rotation(end.sample.rotation_nd @ (start.sample.rotation_nd @ exp_rotation(turn_d)).T)
        uncertain_rad = 0.5 * _LARGEST_ACCELERATION * seconds * (seconds + turned_s)
        gain = 1.0 + (1.0 + ratio) ** 2 + ratio**2
        step = Step(seconds, 1, uncertain_rad, gain, self._stuck.coarseness_rad)
        return Way(difference_n, self._by_motion.bound_rad(step))

    def between(self, start: AttitudeSample, end: AttitudeSample) -> Way:
        """The way by the rates of two samples alone."""
        seconds = _seconds(start, end)
        if not self.rates_trusted or start.rate_d is None or end.rate_d is None or seconds > _LONGEST_STEP_S:
            return self.far(start, end)
        predicted_nd = start.rotation_nd @ exp_rotation((0.5 * seconds) * (start.rate_d + end.rate_d))
        step = Step(seconds, 1, _missed_rad(start, end), 2.0, self._stuck.coarseness_rad)
        return Way(log_rotation(end.rotation_nd @ predicted_nd.T), self._by_rates.bound_rad(step))

    def far(self, start: AttitudeSample, end: AttitudeSample) -> Way:
        """The way, of which is known only what a hull can turn in the time."""
        seconds = _seconds(start, end)
        step = Step(seconds, 1, far_bound_rad(seconds), 2.0, self._stuck.coarseness_rad)
        difference_n = log_rotation(end.rotation_nd @ start.rotation_nd.T)
        return Way(difference_n, self._by_motion.bound_rad(step), led=False)

    def within_reach(self, start: AttitudeSample, end: AttitudeSample) -> bool:
        """Whether a hull can turn from one to the other in the time."""
        bound_rad = far_bound_rad(_seconds(start, end))
        # 0.75 of the chord between two matrices is more than the turn: good samples need no logarithm.
        chord = size((end.rotation_nd - start.rotation_nd).ravel())
        return 0.75 * chord <= bound_rad <= 1.0 or self.far(start, end).kept

    def learn(self, taken: Known, known: Known, way: Way) -> None:
        """How far good samples are from where the ones before lead; ``way`` is that from ``taken`` to ``known``."""
        if self.rates_trusted:
            if taken.leg == known.leg:
                self._by_rates.learn(way.difference_n)
            return
        if way.led:
            self._by_motion.learn(way.difference_n)
        if self._rates.usable and taken.leg == known.leg and known.integrated is not None:
            self._by_rates.learn(self._led(taken, known, 1, 0.0).difference_n)

    def forget_rates(self) -> None:
        """Learn anew how good the rates are."""
        self._by_rates.forget()

    def _led(self, start: Known, end: Known, samples: int, missed_rad: float) -> Way:
        """The way by the integrated rates."""
        assert start.integrated is not None
        assert end.integrated is not None
        # At the INS's rate; the method takes half the time of the operator.
        predicted_nd = start.sample.rotation_nd.dot(start.integrated.T).dot(end.integrated)
        step = Step(_seconds(start.sample, end.sample), samples, missed_rad, 2.0, self._stuck.coarseness_rad)
        return Way(log_rotation(end.sample.rotation_nd.dot(predicted_nd.T)), self._by_rates.bound_rad(step))


def moved_back(sample: AttitudeSample, taken: Known) -> AttitudeSample | None:
    """Where the deck would have been before a sample, had it moved as it did before the last sample that was taken.

    After a jump this leads to the next sample.
    """
    if taken.before is None:
        return None
    ratio = _seconds(taken.sample, sample) / _seconds(taken.before, taken.sample)
    turn_d = ratio * log_rotation(taken.before.rotation_nd.T @ taken.sample.rotation_nd)
    return replace(taken.sample, rotation_nd=sample.rotation_nd @ exp_rotation(-turn_d))


def _seconds(first: AttitudeSample, second: AttitudeSample) -> float:
    return (second.time_ns - first.time_ns) * 1e-9


def _missed_rad(first: AttitudeSample, second: AttitudeSample) -> float:
    """What the mean of two rates may miss of the turn between them, rad."""
    assert first.rate_d is not None
    assert second.rate_d is not None
    seconds = _seconds(first, second)
    change, mean = size(second.rate_d - first.rate_d), 0.5 * size(second.rate_d + first.rate_d)
    share = (2.0 * np.pi * seconds / _SHORTEST_PERIOD_S) ** 2 / 12.0
    return seconds * (_CHANGE_SHARE * change + share * mean)

"""The attitude by an INS's rates alone, and steps of the measured attitude against it.

Attitude and integrated rates of a healthy INS differ by a turn that drifts slowly: by the bias of the gyroscopes, by
the Earth's turn where the rates hold it, by what integration misses. Over a second that is a straight line. A step of
the attitude breaks the line, and shows at once where it is many times the noise of a sample; the mean of several
samples after it against the line before shows a smaller one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_watch
from ship_estimation.line_steps import Period, StepPlan, doubling, located, step_plan
from ship_estimation.value_guards import ACROSS, Match, size
from ship_geometry import compiled_rotations
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_geometry.time_scales import SECOND_NS

StampArray = NDArray[np.int64]
"""Stamps, ns."""

_LONGEST_STEP_NS = SECOND_NS
"""Rates that are further apart are not joined by integration."""


class Integrated(NamedTuple):
    """The attitude by the rates alone.

    Attributes:
        rotation: the attitude, from an arbitrary start, shape (3, 3).
        run: number of the unbroken run of rates to which it belongs; attitudes of two runs must not be compared.
        missed_rad: what the integration may have missed since that run began.
    """

    rotation: FloatArray
    run: int
    missed_rad: float


class IntegratedRun(NamedTuple):
    """The attitudes by the rates alone of N samples that belong to one run; see :class:`Integrated`.

    Attributes:
        rotations: shape (N, 3, 3).
        run: number of the run.
        missed_rad: shape (N,).
    """

    rotations: FloatArray
    run: int
    missed_rad: FloatArray

    def one(self, number: int) -> Integrated:
        """One of them."""
        return Integrated(self.rotations[number], self.run, float(self.missed_rad[number]))


class RateIntegrator:
    """Integrates the rates of one INS in the order of their stamps.

    >>> integrator = RateIntegrator()
    >>> turns = [integrator.integrate(n * 100_000_000, np.array([0.0, 0.0, 0.1])) for n in range(11)]
    >>> print(log_rotation(turns[-1].rotation).round(6) + 0.0)
    [0.  0.  0.1]
    """

    def __init__(self) -> None:
        self._integrated = Integrated(np.eye(3), 0, 0.0)
        self._last: tuple[int, FloatArray] | None = None
        self._twice_drift_d = np.zeros(3)

    def integrate(self, time_ns: int, rate_d: FloatArray | None) -> Integrated | None:
        """Integrate the rates up to the next sample: the mean of two successive rates turns the attitude.

        For motion of one period the error is a constant small share of the turn. Where the step from the last sample
        with a rate is too long to integrate, a new run begins.

        Args:
            time_ns: stamp of the sample, later than all before.
            rate_d: its angular velocity in the deck frame, rad/s, shape (3,); None where it has none.

        Returns:
            The attitude by the rates alone; None where the sample has no rate, or one that is not a number.
        """
        if rate_d is None:
            return None
        rotation, run, missed_rad = self._integrated
        if self._last is None or not 0 < time_ns - self._last[0] <= _LONGEST_STEP_NS:
            run, missed_rad = run + 1, 0.0 * float(rate_d.sum())
        else:
            rotations, missed = self._integrate(np.array([time_ns]), rate_d[None])
            rotation, missed_rad = rotations[0], float(missed[0])
        if not missed_rad < math.inf:
            return None
        self._integrated, self._last = Integrated(rotation, run, missed_rad), (time_ns, rate_d)
        return self._integrated

    def integrate_all(self, times_ns: StampArray, rates_d: FloatArray) -> "IntegratedRun":
        """The same for the samples of a block, in which nothing is taken yet: see :meth:`take`.

        Args:
            times_ns: their stamps, shape (N,).
            rates_d: their rates, rad/s, shape (N, 3).

        Returns:
            The attitudes of those that go on with the run of before; none where there is no run.
        """
        if self._last is None:
            return IntegratedRun(np.empty((0, 3, 3)), self._integrated.run, np.empty(0))
        rotations, missed = self._integrate(times_ns, rates_d)
        joined = int(np.count_nonzero(missed < math.inf))
        return IntegratedRun(rotations[:joined], self._integrated.run, missed[:joined])

    def take(self, time_ns: int, rate_d: FloatArray, integrated: Integrated) -> None:
        """Go on from a sample of a block, its rate in rad/s, shape (3,)."""
        self._integrated, self._last = integrated, (time_ns, rate_d)

    def _integrate(self, times_ns: StampArray, rates_d: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Attitudes by the rates, shape (N, 3, 3), and what may be missed, infinite from a gap on, shape (N,)."""
        assert self._last is not None
        rotation, _, missed_rad = self._integrated
        turns_d, missed = compiled_watch.turns(
            times_ns, rates_d, *self._last, missed_rad, self._twice_drift_d, _LONGEST_STEP_NS
        )
        return compiled_rotations.turned_on(rotation, turns_d), missed

    def take_out(self, drift_d: FloatArray) -> None:
        """From now on the rates are taken to be larger by this than the turn of the deck, rad/s, shape (3,)."""
        self._twice_drift_d = 2.0 * drift_d


def missed_by_mean_rad(first_rate_d: FloatArray, second_rate_d: FloatArray, seconds: float) -> float:
    """What the mean of two rates (rad/s, shape (3,)) may miss of the turn between them, rad.

    >>> steady = np.array([0.0, 0.0, 0.1])
    >>> missed_by_mean_rad(steady, steady, seconds=0.0)
    0.0
    """
    missed_rad: float = compiled_watch.missed_by_mean(first_rate_d, second_rate_d, seconds)
    return missed_rad


_BEFORE_S, _AFTER_S = (0.5, 0.25, 0.125), 0.2
"""Samples of so long tell the line, the shorter the noisier the rates; of up to so long whether there was a step."""
_LEAST_BEFORE, _LONGEST_PERIOD_NS = 16, SECOND_NS // 5
"""At fewer than five samples a second the waves between two of them hide small steps, and nothing is looked for."""
_GAP = 8
"""The line does not lead over a gap of more than so many periods."""
_SIGMAS = 7.3
"""What noise of three axes exceeds once in 6e10 times; docs/explanation/when_inputs_fail.md says how often an hour."""
_POWER, _TYPICAL = 4, 3.10
"""The same in eighth roots of the mean eighth power of such noise, 945 sigma⁸: of the square the fourth power."""
_LAG_S = 0.0025
"""Rates may lag behind the attitude by this much."""
_LEARN_HZ, _MEMORY = 25.0, 1500
"""How often steps of no sample are learnt in a second, and of how many the mean is made."""
_LEARNT_ONE, _LEARNT_ALL = 64, 250
"""So many are learnt before a sample is judged by the line, and before means are."""
_UNKNOWN_RAD = 10.0
"""No step is as large: what is not known yet is not judged."""
_FAR_RAD = 1e-3
"""Rotation vectors of this size still add like vectors, to a hundredth of an arcsecond."""


_ROOM = 4
"""Samples are kept in an array so many times as long as the line."""
_SET_EVERY, _FORGET = 8, 0.78
"""Bounds follow what was learnt so many times in between; of what integration feigned at most so much is left then."""


class FoundStep(NamedTuple):
    """A step of the attitude that means before and after have told.

    Attributes:
        first_ns: stamp of the first sample that may lie after the step.
        last_ns: stamp of the first sample that surely does.
        step_n: rotation vector in the horizon frame, rad, shape (3,).
        sigma_rad: its standard deviation about each axis.
    """

    first_ns: int
    last_ns: int
    step_n: FloatArray
    sigma_rad: float


class Learnt(NamedTuple):
    """What samples on a line tell of their errors.

    Attributes:
        drift_n: how fast the attitude runs away from the rates, horizon frame, rad/s, shape (3,).
        seconds: over how long.
        turning: how fast the deck turned in that time, all in all, rad/s.
        typical_rad: how far a sample is from the place where the one before leads, root mean square.
    """

    drift_n: FloatArray
    seconds: float
    turning: float
    typical_rad: float


class StepWatch:
    """Watches the attitude of one INS against its own integrated rates.

    It learns the period of the samples and how large a step their errors feign: by a high power, in which the rare
    large ones count, as rounding makes them.

    Args:
        white_rad: noise of an attitude, each axis.
        rate_sigma_rad_per_s: noise of a rate, each axis.

    Attributes:
        learnt: what the samples kept of late tell of their errors; None where nothing new is known.

    >>> watch, turned = StepWatch(5e-6, 0.0), np.random.default_rng(1).normal(0.0, 5e-6, (1500, 3))
    >>> turned[1400:] += [0.0, 3e-5, 0.0]
    >>> for n, vector in enumerate(turned):
    ...     sample = AttitudeSample(n * 10_000_000, exp_rotation(vector), np.zeros(3))
    ...     fits = watch.look(sample, Integrated(np.eye(3), 0, 0.0), first_rad=1e-4, coarseness_rad=0.0)
    ...     found = watch.keep()
    ...     if found is not None:
    ...         break
    >>> found.first_ns // 10_000_000, 1400 <= n < 1420, (found.step_n * 1e5).round() + 0.0
    (1400, True, array([0., 3., 0.]))
    """

    def __init__(self, white_rad: float, rate_sigma_rad_per_s: float) -> None:
        self._period = Period()
        self._white_rad, self._rate_sigma = white_rad, rate_sigma_rad_per_s
        self._rows, self._rates, self._times = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        self._full: StepPlan | None = None
        self._learn_every = self._learns = self._since_learnt = 0
        self._high = np.zeros(0)
        self._coarseness_rad = self._missed_rad = self._missed_before_rad = self._feigned_rad = 0.0
        self._run, self._last_ns = -1, 0
        self._to_line: FloatArray | None = None
        self.learnt: Learnt | None = None
        self.restart()

    def reconfigure(self, white_rad: float, rate_sigma_rad_per_s: float) -> None:
        """Go on with another noise."""
        if (white_rad, rate_sigma_rad_per_s) != (self._white_rad, self._rate_sigma):
            self._white_rad, self._rate_sigma = white_rad, rate_sigma_rad_per_s
            if self._period.ns:
                self._make_plan()

    def forget(self) -> None:
        """Learn the errors of the samples anew: the rates, or how they are measured, have changed."""
        self._learns = 0
        self._high[:] = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin a new line with the next sample: the attitude has stepped, or a line does not lead so far."""
        self._end = self._newest = 0
        self._to_line = None
        self._plan: StepPlan | None = None
        self._judges = False
        self._pending: FloatArray | None = None
        self._sizes: list[float] = []

    @property
    def smallest_rad(self) -> float:
        """The smallest step that is told from noise; infinite where none is."""
        return math.inf if self._plan is None else float(self._bounds[-1])

    @property
    def judges(self) -> bool:
        """Whether samples are judged by a line as long as it is to be."""
        return self._plan is not None and self._plan is self._full and self._judges

    def look(
        self,
        sample: AttitudeSample,
        integrated: Integrated,
        first_rad: float,
        coarseness_rad: float,
    ) -> bool | None:
        """Whether a sample lies on the line of those kept; None where that is not known, and NaN does not.

        Args:
            sample: with a rate; later than all kept.
            integrated: the attitude by its rates.
            first_rad: how far a good sample may be from the line as long as the watch has not learnt it itself.
            coarseness_rad: steps in which the attitude is printed; zero where every value is new.
        """
        self._pending, time_ns = None, sample.time_ns
        if self._full is None:
            if 0 < self._period.seen(time_ns) <= _LONGEST_PERIOD_NS:
                self._make_plan()
            return None
        if integrated.run != self._run or time_ns - self._last_ns > _GAP * self._period.ns:
            self.restart()
            self._run, self._missed_rad = integrated.run, integrated.missed_rad
        if self._to_line is None:
            self._to_line = integrated.rotation.dot(sample.rotation_nd.T)
        missed_rad = integrated.missed_rad - self._missed_rad
        # What integration misses alike in every step is a slope. A change of it feigns a step.
        feigned_rad = abs(missed_rad - self._missed_before_rad)
        self._missed_rad, self._missed_before_rad = integrated.missed_rad, missed_rad
        self._now_ns = time_ns
        self._first_rad, self._coarseness_rad = first_rad, coarseness_rad
        self._newest, self._rates[self._end] = self._end, sample.rate_d
        (row,) = compiled_rotations.differences(sample.rotation_nd[None], integrated.rotation[None], self._to_line)
        self._rows[self._end] = self._pending = row
        plan = self._plan
        if plan is None:
            return None
        if feigned_rad > self._feigned_rad:
            self._feigned_rad = 1.5 * feigned_rad
            self._set_bounds(plan)
        rows = self._rows[self._end + 1 - plan.length : self._end + 1]
        self._sizes = compiled_watch.step_sizes(self._scaled, rows, 1)[0].tolist()
        if not self._judges:
            return None
        # Where more than this sample alone speaks for a step, it began before, and this sample goes on after it.
        return self._sizes[0] <= 1.0 or max(self._sizes[1:], default=0.0) > self._sizes[0]

    def match(self) -> Match:
        """The sample that was looked at last, against the line."""
        assert self._plan is not None
        step = self._plan.weights[0].dot(self._rows[self._end + 1 - self._plan.length : self._end + 1])
        return Match(step, float(self._bounds[0]), self._sizes[0] <= 1.0)

    def keep(self) -> FoundStep | None:
        """Take the sample that was looked at last for a good one; the step that it makes known, if any."""
        if self._pending is None:
            return None
        self._times[self._end] = self._last_ns = self._now_ns
        self._end, self._pending = self._end + 1, None
        if self._sizes and not max(self._sizes) <= 1.0 and not (self._plan is None or self._lags(self._plan)):
            found = self._found()
            self.restart()
            return found
        self._since_learnt += 1
        if self._since_learnt >= self._learn_every:
            self._learn()
        if self._end == len(self._rows):
            self._shift()
        return None

    def follow(
        self,
        times_ns: StampArray,
        rotations_nd: FloatArray,
        rates_d: FloatArray,
        integrated: IntegratedRun,
        first_rad: float,
        coarseness_rad: float,
    ) -> int:
        """Take the samples of a block, from the first one on, that lie on the line of those kept; returns how many.

        Each is taken as by :meth:`look` and :meth:`keep`. The next one may be taken likewise, after what was learnt
        with the last one; where none is taken the first one is for these: it may be off the line, or begin one.

        Args:
            times_ns: stamps, each later than all kept, shape (N,).
            rotations_nd: attitudes, shape (N, 3, 3).
            rates_d: rad/s, shape (N, 3).
            integrated: the attitudes by the rates.
            first_rad: and the next one as in :meth:`look`.
            coarseness_rad: rad.
        """
        plan = self._plan
        if plan is None or self._to_line is None or not self.judges or integrated.run != self._run:
            return 0
        count = min(len(times_ns), len(self._rows) - self._end, self._until_bounds_are_set())
        missed_rad = np.diff(integrated.missed_rad[:count], prepend=self._missed_rad)
        feigned_rad = np.abs(np.diff(missed_rad, prepend=self._missed_before_rad))
        if feigned_rad[0] > self._feigned_rad:
            self._feigned_rad = 1.5 * float(feigned_rad[0])
            self._set_bounds(plan)
        near = np.diff(times_ns[:count], prepend=self._last_ns) <= _GAP * self._period.ns
        end, length = self._end, plan.length
        self._rows[end : end + count] = compiled_rotations.differences(
            rotations_nd[:count], integrated.rotations[:count], self._to_line
        )
        sizes = compiled_watch.step_sizes(self._scaled, self._rows[end + 1 - length : end + count], count)
        # Written so that NaN ends it.
        on_line = near & (feigned_rad <= self._feigned_rad) & (sizes <= 1.0).all(axis=1)
        count = count if on_line.all() else int(np.argmin(on_line))
        if count == 0:
            return 0
        self._rates[end : end + count], self._times[end : end + count] = rates_d[:count], times_ns[:count]
        self._end, self._newest, self._pending = end + count, end + count - 1, None
        self._missed_rad = float(integrated.missed_rad[count - 1])
        self._missed_before_rad = float(missed_rad[count - 1])
        self._last_ns = self._now_ns = int(times_ns[count - 1])
        self._first_rad, self._coarseness_rad = first_rad, coarseness_rad
        for place in range(self._learn_every - 1 - self._since_learnt, count, self._learn_every):
            self._sizes = sizes[place].tolist()
            self._learn()
            self._since_learnt = -1 - place
        self._since_learnt += count
        self._sizes = sizes[count - 1].tolist()
        if self._end == len(self._rows):
            self._shift()
        return count

    def _until_bounds_are_set(self) -> int:
        """Number of samples up to the next one with which bounds are set."""
        learns = _SET_EVERY - self._learns % _SET_EVERY
        return learns * self._learn_every - self._since_learnt

    def _lags(self, plan: StepPlan) -> bool:
        """Whether rates that lag a little explain what looks like a step, as where a turn begins."""
        steps = plan.weights.dot(self._rates[self._newest + 1 - plan.length : self._newest + 1])
        feigned_rad = _LAG_S * np.sqrt(np.sum(steps * steps, axis=1))
        return bool(np.all(np.sqrt(self._sizes) * self._bounds <= self._bounds + feigned_rad))

    # -- what is learnt -------------------------------------------------------------------------------------

    def _make_plan(self) -> None:
        """Choose how long the line is by the period of the samples and their noise, and learn anew."""
        per_s = SECOND_NS / self._period.ns
        after = max(round(_AFTER_S * per_s), 1)
        lengths = {max(round(seconds * per_s), _LEAST_BEFORE) + after for seconds in _BEFORE_S}
        plans = [step_plan(length, doubling(after)) for length in sorted(lengths)]
        self._full = min(plans, key=lambda plan: float(np.sum(self._sigmas(plan))))
        self._rows, self._rates = np.zeros((2, _ROOM * self._full.length, 3))
        self._times = np.zeros(len(self._rows), dtype=np.int64)
        self._learn_every = max(round(per_s / _LEARN_HZ), 1)
        self._high = np.zeros(len(self._full.counts))
        self.forget()

    def _learn(self) -> None:
        """Learn how large the steps are that no sample made, and go over to a longer line where there is one."""
        assert self._full is not None
        self._since_learnt, full, before = 0, self._full, self._plan
        if before is full:
            self._learns += 1
            squares = np.array(self._sizes) * self._bounds * self._bounds
            self._high += (squares**_POWER - self._high) / min(self._learns, _MEMORY)
            if self._learns % _SET_EVERY == 0 or not self._judges:
                self._feigned_rad *= _FORGET
                self._set_bounds(full)
            return
        for share in (1, 2, 4):
            length = full.length // share
            if self._end >= length:
                after = [count for count in full.counts if share == 1 or count <= length // 3]
                self._plan = full if share == 1 else step_plan(length, tuple(after) or (1,))
                self._set_bounds(self._plan)
                return

    def _set_bounds(self, plan: StepPlan) -> None:
        """The largest steps that errors of good samples feign."""
        known = self._learns >= _LEARNT_ONE
        self._judges = known or self._first_rad < math.inf
        noise_rad = _SIGMAS * self._sigmas(plan)
        assert self._full is not None
        learnt_rad = _TYPICAL * self._high[: len(plan.white)] ** (0.5 / _POWER)
        noise_rad = np.maximum(noise_rad, learnt_rad * plan.white / self._full.white[: len(plan.white)])
        self._bounds = noise_rad + ACROSS * self._coarseness_rad + self._feigned_rad
        if not known:
            self._bounds[0] = max(self._bounds[0], self._first_rad)
        if self._learns < _LEARNT_ALL:
            self._bounds[int(self._judges) :] += _UNKNOWN_RAD
        self._scaled = plan.weights / self._bounds[:, None]

    def _sigmas(self, plan: StepPlan) -> FloatArray:
        """Sigma of each step of a plan by the noise of attitudes and rates, each axis, rad."""
        turn_rad = self._rate_sigma * self._period.ns * 1e-9
        sigmas: FloatArray = np.hypot(self._white_rad * plan.white, turn_rad * plan.walk)
        return sigmas

    def _shift(self) -> None:
        """Make room for further samples, and let the line start anew where it has led far."""
        assert self._full is not None
        keep, rows = self._full.length, self._rows
        seconds = float(self._times[-1] - self._times[0]) * 1e-9 * (1.0 - 1.0 / _ROOM)
        drift_n = (rows[-keep:].mean(axis=0) - rows[:keep].mean(axis=0)) / seconds
        typical_rad = math.sqrt(float(np.mean(np.sum(np.diff(rows, axis=0) ** 2, axis=1))))
        self.learnt = Learnt(drift_n, seconds, size(self._rates.mean(axis=0)), typical_rad)
        for values in (rows, self._rates, self._times):
            values[:keep] = values[-keep:].copy()
        self._end = keep
        if size(rows[keep - 1]) > _FAR_RAD:
            assert self._to_line is not None
            self._to_line = self._to_line.dot(exp_rotation(-rows[keep - 1]))
            rows[:keep] -= rows[keep - 1].copy()

    def _found(self) -> FoundStep:
        """The step between the samples kept, as large as it is and at all moments at which it may have happened."""
        assert self._plan is not None
        worst = max(range(len(self._sizes)), key=self._sizes.__getitem__)
        # By how much the samples are worse than their noise says.
        excess = float(self._bounds[worst]) / (_SIGMAS * float(self._sigmas(self._plan)[worst]))
        everywhere = step_plan(self._plan.length, tuple(range(1, self._plan.counts[-1] + 1)))
        sigmas_rad = excess * self._sigmas(everywhere)
        rows = self._rows[self._end - everywhere.length : self._end]
        step_n, sigma_rad, counts = located(everywhere, rows, sigmas_rad)
        first_ns, last_ns = (int(self._times[self._end - count]) for count in (max(counts), min(counts)))
        return FoundStep(first_ns, last_ns, step_n, sigma_rad)

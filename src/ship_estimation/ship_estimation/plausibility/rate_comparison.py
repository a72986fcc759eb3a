"""Comparison of an INS's attitudes with its integrated rates, which shows steps, drift and excess noise.

Steps are detected by :mod:`ship_estimation.plausibility.ins_step_detector`, excess noise is measured by
:mod:`ship_estimation.plausibility.excess_noise`, and drift is detected here (:class:`RateDriftDetector`). The rates
have a slowly changing bias, and the attitude error is a random walk. Their relative drift is therefore similar from one
piece of some seconds to the next. If this drift changes suddenly, the attitude drifts or the bias of the rates has
changed.
"""

import math

import numpy as np

from ship_estimation.plausibility.checked_ins import CheckedInsSample, InsJump
from ship_estimation.plausibility.excess_noise import ExcessNoise
from ship_estimation.plausibility.ins_step_detector import InsStepDetector, LineUpdate
from ship_estimation.plausibility.integrated_rates import (
    IntegratedAttitude,
    RateConsistencyCheck,
    RateIntegrator,
    RateStatus,
)
from ship_estimation.plausibility.predictions import InsPredictions
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, ExtraNoise

_OVER = (1, 2, 4)
"""Numbers of pieces that are tested together; a slower drift needs more pieces."""
_LIMIT, _LIMIT_EARLY = 36.0, 25.0
"""Chi² limits of three axes, in general and in the first minute. The first limit is exceeded once in 1e7 pieces of two
seconds, which is once in thousands of hours. The second value gives a wider limit, as for Student's distribution, while
few pieces determine the spread."""
_LEAST, _MEMORY = 8, 500
"""Number of pieces from which the spread of the drifts is known, and number over which the spread is averaged."""
_FARTHEST = 3.0
"""Bound of a drift in the estimate of the spread, sigmas, so that a piece with a fault does not enlarge the spread."""

_FASTER = 1.5
"""Ratio to the fastest earlier rotation above which a piece is not tested, because the piece shows new scale errors."""


class RateDriftDetector:
    """Detector of drift of one INS attitude against its rates, in successive pieces of time.

    >>> detector, rng = RateDriftDetector(), np.random.default_rng(1)
    >>> clean = [detector.detect(rng.normal(0.0, 1e-6, 3), 2.0, 0.1) for _ in range(30)]
    >>> drift_n, _ = detector.detect(np.array([0.0, 2e-5, 0.0]), 2.0, 0.1)
    >>> set(clean), (drift_n * 1e5).round() + 0.0
    ({None}, array([0., 4., 0.]))
    """

    def __init__(self) -> None:
        self._square, self._known = np.zeros(3), 0
        self._slopes_n: list[FloatArray] = []
        self._turning: list[float] = []
        self._fastest = 0.0
        self._fresh = -1

    def reset(self) -> None:
        """Reset the spread of the drifts, because the rates or their calibration have changed."""
        self._square, self._known, self._fresh = np.zeros(3), 0, -1
        self._fastest = 0.0
        self._slopes_n.clear()
        self._turning.clear()

    def detect(self, slope_n: FloatArray, seconds: float, turning: float) -> tuple[FloatArray, float] | None:
        """Return the drift of the attitude in this piece and up to three pieces before, if the drift is unusual.

        Args:
            slope_n: drift in the piece minus the estimated drift, horizon frame, rad/s, shape (3,).
            seconds: length of the piece, s.
            turning: magnitude of the ship's mean angular velocity in the piece, rad/s.

        Returns:
            Rotation vector of the drift in the horizon frame, rad, shape (3,), and its standard deviation about the
            worst axis. None if the drift is usual or cannot be tested.
        """
        self._fresh += 1
        if self._fresh == 0 and not self._known:
            return None  # the first piece contains the whole bias
        self._slopes_n.append(slope_n)
        self._turning.append(turning)
        if len(self._slopes_n) > _OVER[-1]:
            # Pieces under test do not enter the spread.
            self._learn(self._slopes_n.pop(0), self._turning.pop(0))
        if self._known < _LEAST:
            return None
        if not turning <= _FASTER * self._fastest:
            self._fresh = 0
            return None
        limit = max(_LIMIT, self._known * math.expm1(_LIMIT_EARLY / self._known))
        for over in _OVER:
            summed_n = np.sum(self._slopes_n[-over:], axis=0)
            square = over * self._square
            # The condition is false for a spread of zero and for NaN.
            if over <= self._fresh and square.min() > 0.0 and float(np.sum(summed_n**2 / square)) > limit:
                self._fresh = 0
                return summed_n * seconds, math.sqrt(float(square.max())) * seconds
        return None

    def _learn(self, slope_n: FloatArray, turning: float) -> None:
        known = self._known >= _LEAST
        if known and turning > _FASTER * self._fastest:
            # The spread grows at once, because every piece during this rotation shows the same scale error.
            self._square = np.maximum(self._square, slope_n**2)
        elif known:
            slope_n = np.minimum(np.abs(slope_n), _FARTHEST * np.sqrt(self._square))
        self._fastest = max(self._fastest, turning)
        self._known = min(self._known + 1, _MEMORY)
        self._square = self._square + (slope_n**2 - self._square) / self._known


class RateComparison:
    """Comparison of attitudes with integrated rates.

    The drift of the rates and the noise of the attitudes are measured too, and set in the predictions.

    Args:
        predictions: predictions of an attitude by earlier samples.
        rate_check: check of the rates, restarted after a step.

    Attributes:
        integrator: integrates the rates, corrected for their drift.
        step_detector: compares each attitude with the line of earlier attitudes.
        excess: excess noise of the attitudes.
        drift_updates: number of estimates of the rates' drift.
        sigma_rad: noise of an attitude, the stated noise or, if larger, the measured noise, rad.
        new_noise: excess noise that is estimated but not returned with a sample yet; None without new noise.
    """

    def __init__(self, predictions: InsPredictions, rate_check: RateConsistencyCheck) -> None:
        self._predictions, self._rate_check = predictions, rate_check
        self.integrator, self.step_detector = RateIntegrator(), InsStepDetector(ARCSEC, 0.0)
        self.excess, self._drift_detector = ExcessNoise(ARCSEC), RateDriftDetector()
        self.drift_updates = 0
        self.new_noise: ExtraNoise | None = None

    def reconfigure(self, stated_rad: float, rate_sigma_rad_per_s: float) -> None:
        """Set the stated noise of the attitudes, rad, and of the rates, rad/s."""
        self._stated_rad, self._rate_sigma = stated_rad, rate_sigma_rad_per_s
        self.new_noise = self.excess.reconfigure(stated_rad) or self.new_noise
        self._set_sigma()

    def _set_sigma(self) -> None:
        """Set the noise of all checks to the stated noise or, if larger, to the measured noise."""
        self.sigma_rad = self.excess.sigma_rad
        self._predictions.rate_bound.sigma_rad = self._predictions.motion_bound.sigma_rad = self.sigma_rad
        self.step_detector.reconfigure(self.sigma_rad, self._rate_sigma)

    @property
    def excess_text(self) -> str:
        """Text of measured and stated noise of the samples; empty without excess noise."""
        found = self.excess.found
        return "" if found is None else found.text(self._stated_rad)

    def check(
        self, sample: AttitudeSample, integrated: IntegratedAttitude, coarseness_rad: float, accepts: bool
    ) -> tuple[bool | None, tuple[InsJump, ...]]:
        """Check a sample against the line of the accepted samples, and measure the noise.

        Args:
            sample: sample with a rate.
            integrated: attitude by integrated rates at the stamp of the sample.
            coarseness_rad: resolution of the attitudes.
            accepts: True to accept the sample at once if it is on the line.

        Returns:
            Result of :meth:`InsStepDetector.check`, None also without confirmed rates; and the jump that an accepted
            sample shows.
        """
        predictions, detector, is_on_line, update = self._predictions, self.step_detector, None, None
        measured = self._rate_check.status is RateStatus.MEASURED
        if measured:
            if predictions.reported_step_rad and predictions.reported_step_rad > detector.smallest_rad:
                detector.restart()
            is_on_line = detector.check(sample, integrated, predictions.rate_bound.noise_rad, coarseness_rad)
            if is_on_line and accepts:
                update = detector.accept()
            elif is_on_line is False:
                self.excess.start_collecting(sample.time_ns, predictions.rate_bound.typical_rad)
        if self.excess.is_collecting:
            self.new_noise = self.excess.observe(sample, integrated, measured) or self.new_noise
        return is_on_line, () if update is None else self.apply_update(update, sample)

    def accept(self, sample: AttitudeSample) -> tuple[InsJump, ...]:
        """Accept a sample that further checks have confirmed; return the jump that it shows."""
        update = self.step_detector.accept()
        return () if update is None else self.apply_update(update, sample)

    def apply_update(self, update: LineUpdate, sample: AttitudeSample) -> tuple[InsJump, ...]:
        """Update drift and noise from the line up to a sample; return a step or an unusually large drift as a jump."""
        if update.step is not None:
            self.excess.start_collecting(sample.time_ns, self._predictions.rate_bound.typical_rad)
            self._rate_check.restart()
            step, moments_ns = update.step, sorted({update.step.first_ns, update.step.last_ns})
            return tuple(InsJump(time_ns - 1, step.step_n, step.sigma_rad) for time_ns in moments_ns)
        if update.noise is not None:
            self.new_noise = self.excess.add(update.noise) or self.new_noise
        learnt = update.statistics
        if learnt is None:
            return ()
        self.drift_updates += 1
        self.integrator.set_drift(self._predictions.drift.update(learnt.drift_n, sample.rotation_nd))
        self._predictions.rate_bound.set_typical(learnt.typical_rad)
        drift = self._drift_detector.detect(learnt.drift_n, learnt.seconds, learnt.turning)
        return () if drift is None else (InsJump(sample.time_ns - 1, *drift, is_drift=True),)

    def with_noise(self, checked: CheckedInsSample) -> CheckedInsSample:
        """Return the result with new excess noise, if any; all checks then use this noise with new statistics."""
        noise, self.new_noise = self.new_noise, None
        if noise is None:
            return checked
        self._set_sigma()
        self.step_detector.reset_statistics()
        self._predictions.rate_bound.reset()
        return checked._replace(noise=noise)

    def reset(self) -> None:
        """Drop all statistics, because the rates were found to be wrong."""
        self._predictions.rate_bound.reset()
        self.step_detector.reset_statistics()
        self._drift_detector.reset()
        self.excess.reset()

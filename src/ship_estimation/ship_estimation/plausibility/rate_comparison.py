"""Comparison of an INS's attitudes with its integrated rates, which shows steps, drift and excess noise."""

from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.excess_noise import ExcessNoise
from ship_estimation.plausibility.ins_jump import InsJump
from ship_estimation.plausibility.ins_predictions import InsPredictions
from ship_estimation.plausibility.ins_step_detector import InsStepDetector
from ship_estimation.plausibility.integrated_rates import IntegratedAttitude, RateIntegrator
from ship_estimation.plausibility.rate_consistency import RateConsistencyCheck, RateStatus
from ship_estimation.plausibility.rate_drift_detector import RateDriftDetector
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeSample, ExtraNoise


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
    """

    def __init__(self, predictions: InsPredictions, rate_check: RateConsistencyCheck) -> None:
        self._predictions, self._rate_check = predictions, rate_check
        self.integrator, self.step_detector = RateIntegrator(), InsStepDetector(ARCSEC, 0.0)
        self.excess, self._drift_detector = ExcessNoise(ARCSEC), RateDriftDetector()
        self.drift_updates = 0
        # Excess noise that is estimated but not returned with a sample yet.
        self._new_noise: ExtraNoise | None = None

    def reconfigure(self, stated_rad: float, rate_sigma_rad_per_s: float) -> None:
        """Set the stated noise of the attitudes, rad, and of the rates, rad/s."""
        self._stated_rad, self._rate_sigma = stated_rad, rate_sigma_rad_per_s
        self._new_noise = self.excess.reconfigure(stated_rad) or self._new_noise
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

    @property
    def can_accept_block(self) -> bool:
        """True if samples may be accepted together: the line is established and no excess noise is being measured."""
        return self.step_detector.is_ready and not self.excess.is_collecting

    @property
    def has_new_noise(self) -> bool:
        """True if excess noise was estimated that :meth:`with_noise` has not returned yet."""
        return self._new_noise is not None

    def check(self, sample: AttitudeSample, integrated: IntegratedAttitude, coarseness_rad: float) -> bool | None:
        """Return the result of :meth:`InsStepDetector.check`, None also without confirmed rates; collect noise samples.

        Args:
            sample: sample with a rate.
            integrated: attitude by integrated rates at the stamp of the sample.
            coarseness_rad: resolution of the attitudes.
        """
        predictions, on_line = self._predictions, None
        measured = self._rate_check.status is RateStatus.MEASURED
        if measured:
            if predictions.reported_step_rad and predictions.reported_step_rad > self.step_detector.smallest_rad:
                self.step_detector.restart()
            on_line = self.step_detector.check(sample, integrated, predictions.rate_bound.noise_rad, coarseness_rad)
            if on_line is False:
                self.excess.start_collecting(sample.time_ns, predictions.rate_bound.typical_rad)
        if self.excess.is_collecting:
            self._new_noise = self.excess.observe(sample, integrated, measured) or self._new_noise
        return on_line

    def accept(self, sample: AttitudeSample) -> tuple[InsJump, ...]:
        """Add the checked sample to the line by which the next samples are checked; return the jump that it shows."""
        found = self.step_detector.accept()
        if found is None:
            return self.drift_jumps(sample)
        self.excess.start_collecting(sample.time_ns, self._predictions.rate_bound.typical_rad)
        self._rate_check.restart()
        moments_ns = sorted({found.first_ns, found.last_ns})
        return tuple(InsJump(time_ns - 1, found.step_n, found.sigma_rad) for time_ns in moments_ns)

    def drift_jumps(self, sample: AttitudeSample) -> tuple[InsJump, ...]:
        """Update drift and noise from the samples on the line; return an unusually large drift as a jump."""
        sums, self.step_detector.noise = self.step_detector.noise, None
        if sums is not None:
            self._new_noise = self.excess.add(sums) or self._new_noise
        learnt, self.step_detector.line_statistics = self.step_detector.line_statistics, None
        if learnt is None:
            return ()
        self.drift_updates += 1
        self.integrator.set_drift(self._predictions.drift.update(learnt.drift_n, sample.rotation_nd))
        self._predictions.rate_bound.set_typical(learnt.typical_rad)
        drift = self._drift_detector.detect(learnt.drift_n, learnt.seconds, learnt.turning)
        return () if drift is None else (InsJump(sample.time_ns - 1, drift.turn_n, drift.sigma_rad, is_drift=True),)

    def with_noise(self, checked: CheckedInsSample) -> CheckedInsSample:
        """Return the result with new excess noise, if any; all checks then use this noise with new statistics."""
        noise, self._new_noise = self._new_noise, None
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

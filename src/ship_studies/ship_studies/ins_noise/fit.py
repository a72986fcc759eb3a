"""Parameters of a model by maximum likelihood, with their covariance, and the consistency check of the fitted model.

**Search.** The search varies the logarithms of the parameters, first with few epochs, which is fast and sufficiently
close, then with all epochs. Gradients and second derivatives are differences of likelihoods computed together. The
covariance follows from the observed information.

**Correlation times.** If a record is only a few correlation times long, the likelihood of the time is skewed: it falls
off fast towards short times and slowly towards long times. The maximum of the likelihood is at too short a time, on
average by half the variance of the logarithm. The curvature at the maximum is larger for shorter times, so the stated
sigma is too small when the error is large. In 200 records, each six correlation times long, the errors were 1.1 to 1.4
times the sigma from the curvature. So the likelihood is integrated, with Jeffreys' prior (1946): the square root of the
Fisher information.

**Check.** The record is cut into equal intervals. At the beginning of each interval except the first, the filter has
used all earlier stars. The filter predicts the INS's error to the end of the interval without stars, and the last stars
of the interval determine the prediction error. Under the model the errors of successive intervals are independent,
because each prediction uses all earlier stars. So the sum of the normalised squared errors follows chi², and their mean
has a known band.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import FloatArray
from ship_studies.ins_noise.processes import FittableInsModel, SuiteParameter
from ship_studies.ins_noise.star_record import EpochFilter, StarRecord

_GRID = 2001
_POWER = 0.25
"""Exponent p: the estimate of the rate 1/τ is the mean of (1/τ)^p, raised to the power 1/p.

With this exponent, the ratio of RMS error to sigma is nearest to 1 in simulated records of 1 to 200 correlation times.
The mean of the logarithm has a sigma that is too large by a fifth, due to a long tail towards long times.
"""

_FIRST_EPOCHS = 300
_GRADIENT_STEP, _CURVATURE_STEP = 1e-4, 0.02
_LEAST_GAIN = 0.01
"""Gain in log likelihood per step below which a search ends. One sigma off the maximum, the loss is 0.5."""

_MAX_BATCH = 12
"""Maximum number of parameter sets computed together; more sets need more memory and are hardly faster."""

_UNKNOWN_LOG_SIGMA = 10.0
"""Sigma of the logarithm of a parameter that a record does not determine."""

_SECOND_START_FACTOR = 0.03
"""Factor on the configured correlation times at the start of a second search, as one search may stop near a saddle."""

_STEPS = np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0])
"""Distances from the maximum, in sigmas from the curvature, at which a correlation time's likelihood is computed."""

_WIDEST_STEP = 1.0
"""Upper limit of the sigma that is multiplied by :data:`_STEPS`; a larger sigma does not describe the likelihood."""

SHARES = (2, 4, 8, 16)
"""Numbers of intervals in a record: longer horizons are too rare to test, and much shorter horizons are not outages."""

_MAX_INTERVAL_RATIO = 1.25
"""Maximum ratio of the length of an interval to the horizon; an interval is excluded if stars return later."""

_CHECKED_SHARE = 0.125
"""Share of an interval at its end whose stars determine the prediction error."""

_MAX_CHECKED_EPOCHS = 50
"""Maximum number of epochs that determine a prediction error; more epochs do not improve the comparison."""

_PARTS = {"tilt": [0, 2], "heading": [1]}


def mean_log_time(logs: FloatArray, log_likelihoods: FloatArray, duration_s: float) -> tuple[float, float]:
    """Return the estimate of the logarithm of a correlation time, and its variance.

    The noise density of the Gauss-Markov process is assumed known, since every record determines this density. The
    Fisher information of the logarithm of the time is then (1 + duration / time) / 2.

    Args:
        logs: increasing logarithms of times (s), shape (N,).
        log_likelihoods: log likelihoods at these times, shape (N,).
        duration_s: length of the record, s.

    Example:
        A long record, whose likelihood is that of a normal distribution of the logarithm:

        >>> logs = np.log(60.0) + 0.05 * np.linspace(-8.0, 8.0, 41)
        >>> mean, variance = mean_log_time(logs, -0.5 * ((logs - np.log(60.0)) / 0.05) ** 2, 24_000.0)
        >>> print(round(float(np.exp(mean)), 1), round(variance**0.5, 3))
        59.9 0.05
    """
    times = np.linspace(logs[0], logs[-1], _GRID)
    log_density = PchipInterpolator(logs, log_likelihoods)(times) + 0.5 * np.log1p(duration_s * np.exp(-times))
    weights = np.exp(log_density - np.max(log_density))
    weights /= np.sum(weights)
    middle = float(np.sum(weights * times))
    powers = np.exp(-_POWER * (times - middle))
    mean = float(np.sum(weights * powers))
    variance = float(np.sum(weights * (powers - mean) ** 2))
    return middle - np.log(mean) / _POWER, variance / (_POWER * mean) ** 2


@dataclass(frozen=True)
class FittedModel:
    """A model with its fitted parameters.

    Attributes:
        model: model of the INS's error.
        values: most likely parameter values, shape (p,); for a correlation time the mean instead, and the other values
            are shifted accordingly.
        covariance: covariance of the logarithms of the parameters, shape (p, p); the variance of a parameter at a bound
            is `_UNKNOWN_LOG_SIGMA` squared, unless it is a correlation time.
        log_likelihood: maximum log likelihood of the record.
    """

    model: FittableInsModel
    values: FloatArray
    covariance: FloatArray
    log_likelihood: float

    @property
    def aic(self) -> float:
        """Akaike's criterion: twice the number of parameters minus twice the log likelihood; smaller is better."""
        return 2.0 * len(self.values) - 2.0 * self.log_likelihood

    @property
    def log_sigmas(self) -> FloatArray:
        """Sigma of the logarithm of each parameter, the relative sigma if it is small, shape (p,)."""
        sigmas: FloatArray = np.sqrt(np.diagonal(self.covariance))
        return sigmas

    def suite_value(self, parameter: SuiteParameter) -> tuple[float, float]:
        """Return the value of a suite parameter, and the sigma of its logarithm."""
        value = float(np.exp(parameter.constant + parameter.weights @ np.log(self.values)))
        return value, float(np.sqrt(parameter.weights @ self.covariance @ parameter.weights))


def fit(record: StarRecord, model: FittableInsModel) -> FittedModel:
    """Return the model fitted to a record: its most likely parameters, with the means of the correlation times."""
    few = _Search(record.with_every_nth_epoch(-(-len(record.times_s) // _FIRST_EPOCHS)), model)
    starts = np.log([parameter.start for parameter in model.parameters])
    quicker = starts + np.log(_SECOND_START_FACTOR) * _is_time(model)
    candidates = [few.find_minimum(start) for start in np.unique([starts, quicker], axis=0)]
    all_ = _Search(record, model)
    best = all_.find_minimum(min(candidates, key=few.cost))
    point, covariance = _use_mean_times(all_, best, all_.covariance(best))
    return FittedModel(model, np.exp(point), covariance, -all_.cost(best))


def _use_mean_times(search: "_Search", best: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return logarithms and covariance of the parameters, with mean and variance of each correlation time.

    The other parameters are shifted according to their correlation with each correlation time.
    """
    point = best.copy()
    for row in np.flatnonzero(_is_time(search.model)):
        variance = covariance[row, row]
        along = covariance[:, row] / variance
        steps = min(float(np.sqrt(variance)), _WIDEST_STEP) * np.concatenate([-_STEPS[::-1], [0.0], _STEPS])
        logs = np.unique(np.clip(best[row] + steps, *search.bounds[row]))
        points = np.clip(best + (logs - best[row])[:, None] * along, *search.bounds.T)
        mean, own_variance = mean_log_time(logs, -search.costs(points), search.record.duration_s)
        point += (mean - best[row]) * along
        covariance = covariance + (own_variance - variance) * np.outer(along, along)
    return point, covariance


def _is_time(model: FittableInsModel) -> NDArray[np.bool_]:
    return np.array([parameter.name.startswith("τ") for parameter in model.parameters])


class _Search:
    def __init__(self, record: StarRecord, model: FittableInsModel) -> None:
        self.record, self.model = record, model
        self.bounds = np.log([(parameter.least, parameter.most) for parameter in model.parameters])

    def cost(self, point: FloatArray) -> float:
        """Return minus the log likelihood at logarithms of parameters, shape (p,)."""
        return float(self.costs(point[None])[0])

    def find_minimum(self, start: FloatArray) -> FloatArray:
        """Return the most likely point found by a search from a start, shape (p,)."""

        def cost_and_slope(point: FloatArray) -> tuple[float, FloatArray]:
            at, *shifted = self.costs(np.vstack([point, point + _GRADIENT_STEP * np.eye(len(point))]))
            return float(at), (np.array(shifted) - at) / _GRADIENT_STEP

        inside = np.clip(start, *self.bounds.T)
        relative = _LEAST_GAIN / abs(self.cost(inside))
        found = minimize(
            cost_and_slope, inside, jac=True, method="L-BFGS-B", bounds=self.bounds, options={"ftol": relative}
        )
        point: FloatArray = found.x
        return point

    def covariance(self, point: FloatArray) -> FloatArray:
        """Return the covariance of the logarithms at the most likely point, shape (p, p): the inverse Hessian."""
        count, step = len(point), _CURVATURE_STEP
        free = np.flatnonzero(np.all(np.abs(self.bounds - point[:, None]) > step, axis=1))
        unit = step * np.eye(count)[free]
        pairs = [(i, j) for i in range(len(free)) for j in range(i + 1)]
        points = [point, *(point + unit), *(point - unit), *(point + unit[i] + unit[j] for i, j in pairs)]
        costs = self.costs(np.array(points))
        at, up = costs[0], costs[1 : 1 + len(free)]
        down, both = costs[1 + len(free) : 1 + 2 * len(free)], costs[1 + 2 * len(free) :]
        curvature = np.zeros((len(free), len(free)))
        for (i, j), cost in zip(pairs, both, strict=True):
            curvature[i, j] = curvature[j, i] = (cost - up[i] - up[j] + at) / step**2
        curvature[np.diag_indices(len(free))] = (up - 2.0 * at + down) / step**2
        values, vectors = np.linalg.eigh(curvature)
        # A direction with a flat likelihood, or negative curvature from numerical noise, is not determined.
        inverse = (vectors / np.maximum(values, _UNKNOWN_LOG_SIGMA**-2)) @ vectors.T
        covariance = _UNKNOWN_LOG_SIGMA**2 * np.eye(count)
        covariance[np.ix_(free, free)] = inverse
        return covariance

    def costs(self, points: FloatArray) -> FloatArray:
        """Return minus the log likelihood at N sets of logarithms of parameters, shape (N,)."""
        found = []
        for begin in range(0, len(points), _MAX_BATCH):
            values = np.exp(points[begin : begin + _MAX_BATCH])
            steps = self.model.steps(values, self.record.times_s)
            found.append(-EpochFilter(self.record, steps).log_likelihoods())
        return np.concatenate(found)


class PredictionError(NamedTuple):
    """Error of predictions of tilt or heading.

    Attributes:
        rms_arcsec: RMS error of one axis.
        sigma_arcsec: predicted sigma of one axis, without the part that the stars at the end do not observe.
        nees: mean normalised error squared; two degrees of freedom for tilt, one for heading.
        nees_limit: upper limit of the 99.9 % band of ``nees``.
    """

    rms_arcsec: float
    sigma_arcsec: float
    nees: float
    nees_limit: float

    @property
    def is_consistent(self) -> bool:
        """True if the mean NEES is at most its limit; False for NaN."""
        return self.nees <= self.nees_limit


class OutageCheck(NamedTuple):
    """Predictions over one horizon compared with the stars at its end.

    Attributes:
        horizon_s: length of the intervals without stars.
        intervals: number of intervals.
        parts: ``tilt`` and ``heading`` → error of the predictions.
    """

    horizon_s: float
    intervals: int
    parts: dict[str, PredictionError]


def outage_checks(record: StarRecord, fitted: FittedModel) -> list[OutageCheck]:
    """Return the checks of a fitted model for each of SHARES that the record allows."""
    epochs = EpochFilter(record, fitted.model.steps(fitted.values[None], record.times_s))
    times_s, checks = record.times_s, []
    for share in SHARES:
        horizon_s = record.duration_s / share
        found = []
        for begin_s in horizon_s * np.arange(1, share):
            begin = int(np.searchsorted(times_s, begin_s, side="right")) - 1
            # By rounding, the last interval may end slightly after the record.
            end = int(np.searchsorted(times_s, begin_s + horizon_s - 1e-6))
            is_there = end < len(times_s) and times_s[end] - begin_s <= _MAX_INTERVAL_RATIO * horizon_s
            if is_there and end > begin:
                found.append(_prediction_error(epochs, begin, end))
        if found:
            checks.append(_outage_check(horizon_s, *(np.array(column) for column in zip(*found, strict=True))))
    return checks


def _prediction_error(epochs: EpochFilter, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
    """Return the correction of a prediction by the last stars, arcsec, shape (3,), and its covariance, (3, 3).

    Directions that the stars do not observe, such as a rotation about the only boresight, are not corrected and not
    tested.
    """
    estimate = epochs.estimate_at(begin)
    predicted = epochs.predict(estimate, begin, end)
    since_s = epochs.times_s[end] - _CHECKED_SHARE * (epochs.times_s[end] - epochs.times_s[begin])
    last = max(int(np.searchsorted(epochs.times_s, since_s)), end + 1 - _MAX_CHECKED_EPOCHS, begin + 1)
    corrected, at = estimate, begin
    for epoch in range(last, end + 1):
        corrected, at = epochs.update(epochs.predict(corrected, at, epoch), epoch), epoch
    # The covariance of the correction is the reduction of the covariance.
    return corrected.mean[:3] - predicted.mean[:3], predicted.covariance[:3, :3] - corrected.covariance[:3, :3]


def _outage_check(horizon_s: float, errors_by_interval: FloatArray, covariance: FloatArray) -> OutageCheck:
    parts = {}
    for name, axes in _PARTS.items():
        errors, claimed = errors_by_interval[:, axes], covariance[:, axes][:, :, axes]
        parts[name] = PredictionError(
            rms_arcsec=float(np.sqrt(np.mean(errors**2))),
            sigma_arcsec=float(np.sqrt(np.mean(np.diagonal(claimed, axis1=1, axis2=2)))),
            nees=float(np.mean(normalized_error_squared(errors, claimed))),
            nees_limit=mean_nees_band(len(errors), len(axes))[1],
        )
    return OutageCheck(horizon_s, len(errors_by_interval), parts)

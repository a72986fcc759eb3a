"""Parameters of a model by maximum likelihood, with their covariance from the observed information.

The search varies the logarithms of the parameters, first with few epochs, which is fast and sufficiently close, then
with all epochs. Gradients and second derivatives are differences of likelihoods computed together.

Correlation times are an exception (:mod:`ship_studies.ins_noise.correlation_time`): a maximum and its curvature
describe their likelihood only in records of many correlation times.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ship_geometry.rotations import FloatArray
from ship_studies.ins_noise.correlation_time import mean_log_time
from ship_studies.ins_noise.likelihood import log_likelihoods
from ship_studies.ins_noise.processes import FittableInsModel, SuiteParameter
from ship_studies.ins_noise.star_record import StarRecord

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
        mean, own_variance = mean_log_time(logs, -search.costs(points), search.duration_s)
        point += (mean - best[row]) * along
        covariance = covariance + (own_variance - variance) * np.outer(along, along)
    return point, covariance


def _is_time(model: FittableInsModel) -> NDArray[np.bool_]:
    return np.array([parameter.name.startswith("τ") for parameter in model.parameters])


class _Search:
    def __init__(self, record: StarRecord, model: FittableInsModel) -> None:
        self._record, self.model = record, model
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

    @property
    def duration_s(self) -> float:
        """Length of the record, s."""
        return self._record.duration_s

    def costs(self, points: FloatArray) -> FloatArray:
        """Return minus the log likelihood at N sets of logarithms of parameters, shape (N,)."""
        found = []
        for begin in range(0, len(points), _MAX_BATCH):
            values = np.exp(points[begin : begin + _MAX_BATCH])
            steps = self.model.steps(values, self._record.times_s)
            found.append(-log_likelihoods(self._record, steps))
        return np.concatenate(found)

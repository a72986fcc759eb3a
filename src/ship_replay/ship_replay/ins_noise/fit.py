"""The parameters of a model by maximum likelihood, with their covariance by the observed information.

The search walks over logarithms: first by few epochs, which is fast and near enough, then by all. Gradients and the
matrix of second derivatives are differences of likelihoods that run side by side.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ship_geometry.rotations import FloatArray
from ship_replay.ins_noise.likelihood import log_likelihoods
from ship_replay.ins_noise.processes import InsErrorModel, ToldParameter
from ship_replay.ins_noise.star_record import StarRecord

_FIRST_EPOCHS = 300
_GRADIENT_STEP, _CURVATURE_STEP = 1e-4, 0.02
_LEAST_GAIN = 0.01
"""Of a step's log likelihood: a search ends where steps gain less. A sigma away a half is lost."""

_MOST_TOGETHER = 12
"""Sets of parameters that run side by side: more would need more memory and gain little."""

_NOTHING_KNOWN = 10.0
"""Sigma of a logarithm that a record tells nothing of."""

_QUICKER = 0.03
"""A second search begins with this share of the configured correlation times: one alone may stop beside a saddle."""


@dataclass(frozen=True)
class FittedModel:
    """A model with the parameters that make a record most likely.

    Attributes:
        model: of the INS's error.
        values: of its parameters, shape (p,).
        covariance: of their logarithms, shape (p, p); _NOTHING_KNOWN squared for one at a bound.
        log_likelihood: of the record.
    """

    model: InsErrorModel
    values: FloatArray
    covariance: FloatArray
    log_likelihood: float

    @property
    def aic(self) -> float:
        """Akaike's criterion: twice the number of parameters minus twice the log likelihood; the less the better."""
        return 2.0 * len(self.values) - 2.0 * self.log_likelihood

    @property
    def log_sigmas(self) -> FloatArray:
        """Of each parameter: its relative sigma, where that is small, shape (p,)."""
        sigmas: FloatArray = np.sqrt(np.diagonal(self.covariance))
        return sigmas

    def told(self, what: ToldParameter) -> tuple[float, float]:
        """Value of a parameter of the suite, and the sigma of its logarithm."""
        value = float(np.exp(what.constant + what.weights @ np.log(self.values)))
        return value, float(np.sqrt(what.weights @ self.covariance @ what.weights))


def fit(record: StarRecord, model: InsErrorModel) -> FittedModel:
    """The model's parameters that make a record most likely."""
    few = _Search(record.thinned(-(-len(record.times_s) // _FIRST_EPOCHS)), model)
    starts = np.log([parameter.start for parameter in model.parameters])
    quicker = starts + np.log(_QUICKER) * _is_time(model)
    begun = [few.climbed(start) for start in np.unique([starts, quicker], axis=0)]
    all_ = _Search(record, model)
    best = all_.climbed(min(begun, key=few.cost))
    return FittedModel(model, np.exp(best), all_.covariance(best), -all_.cost(best))


def _is_time(model: InsErrorModel) -> NDArray[np.bool_]:
    return np.array([parameter.name.startswith("τ") for parameter in model.parameters])


class _Search:
    def __init__(self, record: StarRecord, model: InsErrorModel) -> None:
        self._record, self._model = record, model
        self._bounds = np.log([(parameter.least, parameter.most) for parameter in model.parameters])

    def cost(self, point: FloatArray) -> float:
        """Minus the log likelihood at logarithms of parameters, shape (p,)."""
        return float(self._costs(point[None])[0])

    def climbed(self, start: FloatArray) -> FloatArray:
        """The most likely point that a search from a start reaches, shape (p,)."""

        def cost_and_slope(point: FloatArray) -> tuple[float, FloatArray]:
            at, *beside = self._costs(np.vstack([point, point + _GRADIENT_STEP * np.eye(len(point))]))
            return float(at), (np.array(beside) - at) / _GRADIENT_STEP

        inside = np.clip(start, *self._bounds.T)
        relative = _LEAST_GAIN / abs(self.cost(inside))
        found = minimize(
            cost_and_slope, inside, jac=True, method="L-BFGS-B", bounds=self._bounds, options={"ftol": relative}
        )
        point: FloatArray = found.x
        return point

    def covariance(self, point: FloatArray) -> FloatArray:
        """Of the logarithms at the most likely point, shape (p, p): the inverse of the matrix of second derivatives."""
        count, step = len(point), _CURVATURE_STEP
        free = np.flatnonzero(np.all(np.abs(self._bounds - point[:, None]) > step, axis=1))
        unit = step * np.eye(count)[free]
        pairs = [(i, j) for i in range(len(free)) for j in range(i + 1)]
        points = [point, *(point + unit), *(point - unit), *(point + unit[i] + unit[j] for i, j in pairs)]
        costs = self._costs(np.array(points))
        at, up = costs[0], costs[1 : 1 + len(free)]
        down, both = costs[1 + len(free) : 1 + 2 * len(free)], costs[1 + 2 * len(free) :]
        curvature = np.zeros((len(free), len(free)))
        for (i, j), cost in zip(pairs, both, strict=True):
            curvature[i, j] = curvature[j, i] = (cost - up[i] - up[j] + at) / step**2
        curvature[np.diag_indices(len(free))] = (up - 2.0 * at + down) / step**2
        values, vectors = np.linalg.eigh(curvature)
        # A direction in which the likelihood is flat, or bent the other way by the noise of differences, is not told.
        inverse = (vectors / np.maximum(values, _NOTHING_KNOWN**-2)) @ vectors.T
        covariance = _NOTHING_KNOWN**2 * np.eye(count)
        covariance[np.ix_(free, free)] = inverse
        return covariance

    def _costs(self, points: FloatArray) -> FloatArray:
        found = []
        for begin in range(0, len(points), _MOST_TOGETHER):
            values = np.exp(points[begin : begin + _MOST_TOGETHER])
            steps = self._model.steps(values, self._record.times_s)
            found.append(-log_likelihoods(self._record, steps))
        return np.concatenate(found)

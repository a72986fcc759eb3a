"""The state vector by names, and Kalman steps on a covariance that is kept as a sum over the sources of error.

A state vector is made of named blocks (:class:`StateBlock`, :class:`StateModel`): which slice is which quantity, how it
evolves, which source its noise is booked to. Its covariance P is carried as ``parts``, shape (n_sources, n, n), with
P = parts.sum(axis=0). All steps are linear in P (the update in Joseph's form), so each part goes through with the
filter's own gain and the sum stays exact: this is the error budget.

:func:`predict`, :meth:`StateModel.transition` and :meth:`StateModel.booked_noise` work along the last axes alone: the
covariance may have leading axes (...), one entry for each of several hypotheses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg.lapack as lapack
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray

_BEYOND_SIGMAS = 5.0
_NO_TIME_S = 1e-200


@dataclass(frozen=True)
class StateBlock:
    """One named part of the state with the process that drives it.

    Every element is a first-order Gauss–Markov process x' = -x / T + noise with steady standard deviation
    ``sigma``, or, where ``time_s`` is infinite, a constant that starts with ``sigma`` and walks by ``walk``
    per square root of a second. ``time_s`` = 0 is white noise: independent at every new moment.

    Attributes:
        name: for example ``ins.attitude`` or ``star.fore.installation``.
        sigma: standard deviation of each element before any measurement, shape (n,).
        time_s: correlation time of each element in seconds, shape (n,).
        walk: random walk per square root of a second, shape (n,); only where ``time_s`` is infinite.
        source: the error source its noise is booked to.
    """

    name: str
    sigma: FloatArray
    time_s: FloatArray
    walk: FloatArray
    source: str


def block(
    name: str,
    sigma: FloatArray | list[float],
    source: str,
    time_s: FloatArray | list[float] | float = np.inf,
    walk: FloatArray | list[float] | float = 0.0,
) -> StateBlock:
    """A :class:`StateBlock` with scalars broadcast to the length of ``sigma``.

    Example:
        The slow error of an INS: 10″ in tilt over half an hour, 72″ in heading over three hours.

        >>> from ship_geometry.rotations import ARCSEC
        >>> sigma = [10.0 * ARCSEC, 72.0 * ARCSEC]
        >>> error = block("ins.attitude", sigma, source="ins_drift", time_s=[1800.0, 10_800.0])
        >>> print(error.name, error.time_s, error.walk)
        ins.attitude [ 1800. 10800.] [0. 0.]
    """
    sigma = np.asarray(sigma, dtype=float)
    return StateBlock(
        name,
        sigma,
        np.broadcast_to(np.asarray(time_s, dtype=float), sigma.shape).copy(),
        np.broadcast_to(np.asarray(walk, dtype=float), sigma.shape).copy(),
        source,
    )


class StateModel:
    """Blocks laid end to end, with the transition of the whole vector.

    Args:
        blocks: the parts, in order.
        noise_sources: sources of measurement noise, booked beside the blocks' own.

    Example:
        >>> ins, mount = block("ins", [10.0], "ins_drift", time_s=1800.0), block("mount", [20.0], "installation")
        >>> model = StateModel([ins, mount], noise_sources=["star_noise"])
        >>> print(model.sources, model.slices["mount"])
        ['ins_drift', 'installation', 'star_noise'] slice(1, 2, None)
        >>> decay, noise = model.transition(dt_s=1800.0)  # what is left of each, and the variance that comes new
        >>> print(decay.round(3), noise.round(1))
        [0.368 1.   ] [86.5  0. ]
    """

    def __init__(self, blocks: list[StateBlock], noise_sources: list[str]) -> None:
        self.blocks = {b.name: b for b in blocks}
        self.slices: dict[str, slice] = {}
        start = 0
        for b in blocks:
            self.slices[b.name] = slice(start, start + b.sigma.size)
            start += b.sigma.size
        self.size = start
        self.sources = list(dict.fromkeys([b.source for b in blocks] + noise_sources))
        time_s = np.concatenate([b.time_s for b in blocks])
        # White noise decays to nothing in any time but 0, and without a division by zero.
        self._time_s = np.where(time_s == 0.0, _NO_TIME_S, time_s)
        sigma = np.concatenate([b.sigma for b in blocks])
        walk = np.concatenate([b.walk for b in blocks])
        self._steady_variance = np.where(np.isfinite(self._time_s), sigma**2, 0.0)
        self._walk_variance = np.where(np.isfinite(self._time_s), 0.0, walk**2)
        self._source_rows = np.zeros((len(self.sources), self.size))
        for b in blocks:
            self._source_rows[self.sources.index(b.source), self.slices[b.name]] = 1.0
        self._initial_variance = sigma**2

    def rows(self, name: str) -> NDArray[np.intp]:
        """Indices of a block in the state."""
        return np.arange(self.slices[name].start, self.slices[name].stop)

    def initial_parts(self) -> FloatArray:
        """Covariance parts before any measurement, shape (n_sources, n, n)."""
        return self.booked(np.diag(self._initial_variance))

    def booked(self, covariance: FloatArray) -> FloatArray:
        """A covariance split by the sources of the blocks, shape (n_sources, n, n).

        Cross terms between blocks of different sources must be zero.
        """
        rows = self._source_rows
        return rows[:, :, None] * covariance * rows[:, None, :]

    def transition(self, dt_s: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Diagonal of the transition matrix and of the process noise over ``dt_s`` >= 0, shapes (..., n), (..., n)."""
        if isinstance(dt_s, float) and dt_s == 0.0:
            return np.ones(self.size), np.zeros(self.size)
        dt_s = np.asarray(dt_s)[..., None]
        decay = np.exp(-dt_s / self._time_s)
        return decay, self._steady_variance * (1.0 - decay * decay) + self._walk_variance * dt_s

    def booked_noise(self, noise_diagonal: FloatArray) -> FloatArray:
        """Process noise diagonals by source, shape (..., n_sources, n), for diagonals (..., n)."""
        return self._source_rows * noise_diagonal[..., None, :]


def slow_error_later(error: FloatArray, decay: FloatArray, sigma: FloatArray) -> FloatArray:
    """A slow error after some time, shape (n,): it dies out; what is far beyond its sigma, as after a jump, stays.

    Example:
        >>> sigma, decay = np.array([10.0, 10.0]), np.array([0.5, 0.5])
        >>> print(slow_error_later(np.array([8.0, 3600.0]), decay, sigma))  # the second is a jump of a degree: it stays
        [   4. 3600.]
    """
    return np.where(lasting(error, sigma), error, decay * error)


def lasting(error: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """Which elements of a slow error are far beyond their sigma, and so do not die out, shape (n,).

    Example:
        >>> print(lasting(np.array([8.0, 3600.0]), sigma=np.array([10.0, 10.0])))
        [False  True]
    """
    beyond: NDArray[np.bool_] = np.abs(error) > _BEYOND_SIGMAS * sigma
    return beyond


@dataclass(frozen=True)
class LinearMeasurement:
    """A measurement linearised at the predicted state: residual = jacobian @ error + noise.

    Attributes:
        residual: measured minus predicted, shape (m,).
        jacobian: shape (m, n).
        noise_by_source: covariance of the measurement noise, shape (m, m), by the index of the source that it is
            booked to.
    """

    residual: FloatArray
    jacobian: FloatArray
    noise_by_source: Mapping[int, FloatArray]

    @cached_property
    def noise(self) -> FloatArray:
        """Covariance of the whole measurement noise, shape (m, m)."""
        first, *others = self.noise_by_source.values()
        return sum(others, start=first)


def predict(parts: FloatArray, decay: FloatArray, booked_noise: FloatArray) -> FloatArray:
    """Parts after a step with diagonal transition ``decay`` (..., n) and process noise (..., n_sources, n).

    Example:
        One state, whose covariance of 4 belongs to one source; it decays by half, and 1 comes new:

        >>> print(predict(np.array([[[4.0]]]), decay=np.array([0.5]), booked_noise=np.array([[1.0]])))
        [[[2.]]]
    """
    predicted: FloatArray = parts * (decay[..., :, None] * decay[..., None, :])[..., None, :, :]
    diagonal = np.arange(decay.shape[-1])
    predicted[..., diagonal, diagonal] += booked_noise
    return predicted


def innovation(parts: FloatArray, measurement: LinearMeasurement) -> tuple[FloatArray, float]:
    """Innovation covariance, shape (m, m), and normalised innovation squared (chi² with m degrees).

    Example:
        A state with variance 3, measured with variance 1 and found 4 away, two sigma of their sum:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> covariance, nis = innovation(parts, measured)
        >>> print(covariance, round(nis, 6))
        [[4.]] 4.0
    """
    h = measurement.jacobian
    covariance = h @ parts.sum(axis=0) @ h.T + measurement.noise
    _, solution, info = lapack.dposv(covariance, measurement.residual)
    if info != 0:
        raise np.linalg.LinAlgError("innovation covariance is not positive definite")
    return covariance, float(measurement.residual @ solution)


def update(
    parts: FloatArray, measurement: LinearMeasurement, innovation_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Correction of the state, shape (n,), and the parts after a measurement.

    Args:
        parts: before the measurement, shape (n_sources, n, n).
        measurement: linearised at the predicted state.
        innovation_covariance: as :func:`innovation` gives it.

    Example:
        The measurement of :func:`innovation` has the weight 3/4, and the parts add up to the new variance 3/4:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> correction, parts = update(parts, measured, innovation(parts, measured)[0])
        >>> print(correction.round(6), parts.ravel().round(6))
        [3.] [0.1875 0.5625]
    """
    h = measurement.jacobian
    cross = h @ parts.sum(axis=0)
    _, gain_transposed, _ = lapack.dposv(innovation_covariance, cross)
    gain = gain_transposed.T
    keep = np.eye(parts.shape[-1]) - gain @ h
    updated: FloatArray = keep @ parts @ keep.T
    for source_index, noise in measurement.noise_by_source.items():
        updated[source_index] += gain @ noise @ gain.T
    updated = 0.5 * (updated + updated.transpose(0, 2, 1))
    return gain @ measurement.residual, updated

"""The state vector by names, and Kalman steps on a covariance that is kept as a sum over the sources of error.

A state vector is made of named blocks (:class:`StateBlock`, :class:`StateModel`): which slice is which quantity, how it
evolves, which source its noise is booked to. Its covariance P is carried as ``parts``, shape (n_sources, n, n), with
P = parts.sum(axis=0). All steps are linear in P (the update in Joseph's form), so each part goes through with the
filter's own gain and the sum stays exact: this is the error budget.

The steps themselves are compiled (:mod:`ship_estimation.compiled_steps`); here is told what they are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_steps
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

    Attributes:
        blocks: by name.
        slices: which states they are.
        size: number of states, n.
        sources: of error, by name, in the order of the parts.
        source_indices: where each source stands among them.
        source_of: index of the source that the noise of each state is booked to, shape (n,).

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
        self.source_indices = {source: index for index, source in enumerate(self.sources)}
        time_s = np.concatenate([b.time_s for b in blocks])
        # White noise decays to nothing in any time but 0, and without a division by zero.
        self._time_s = np.where(time_s == 0.0, _NO_TIME_S, time_s)
        sigma = np.concatenate([b.sigma for b in blocks])
        walk = np.concatenate([b.walk for b in blocks])
        self._steady_variance = np.where(np.isfinite(self._time_s), sigma**2, 0.0)
        self._walk_variance = np.where(np.isfinite(self._time_s), 0.0, walk**2)
        self.source_of: NDArray[np.intp] = np.repeat(
            [self.source_indices[b.source] for b in blocks], [b.sigma.size for b in blocks]
        ).astype(np.intp)
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
        own = self.source_of == np.arange(len(self.sources))[:, None]
        return np.where(own[:, :, None] & own[:, None, :], covariance, 0.0)

    def transition(self, dt_s: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Diagonal of the transition matrix and of the process noise over ``dt_s`` >= 0, shapes (..., n), (..., n)."""
        if isinstance(dt_s, float) and dt_s == 0.0:
            return np.ones(self.size), np.zeros(self.size)
        if isinstance(dt_s, float):
            found: tuple[FloatArray, FloatArray] = compiled_steps.transition(
                dt_s, self._time_s, self._steady_variance, self._walk_variance
            )
            return found
        dt_s = np.asarray(dt_s)[..., None]
        decay = np.exp(-dt_s / self._time_s)
        return decay, self._steady_variance * (1.0 - decay * decay) + self._walk_variance * dt_s

    def later(
        self, dt_s: float, means: FloatArray, stack: FloatArray, slow: str
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What some time leaves of each state, shape (n,), and the estimates and covariances of all rows after it.

        Args:
            dt_s: the time, not negative.
            means: estimates of h rows, shape (h, n); those of a slow error become as :func:`slow_error_later` tells.
            stack: their covariances (:mod:`ship_estimation.hypotheses`), shape (n_sources + h - 1, n, n).
            slow: name of the block of that slow error.

        Example:
            Half an hour later the error of 8 is 3; the jump of 3600 stays:

            >>> model = StateModel([block("ins", [10.0, 10.0], "ins_drift", time_s=1800.0)], noise_sources=[])
            >>> _, means, stack = model.later(1800.0, np.array([[8.0, 3600.0]]), 4.0 * np.eye(2)[None], "ins")
            >>> print(means.round(1).tolist(), stack[0].diagonal().round())
            [[2.9, 3600.0]] [87. 87.]
        """
        found: tuple[FloatArray, FloatArray, FloatArray] = compiled_steps.later(
            dt_s,
            means,
            np.ascontiguousarray(stack),
            self._time_s,
            self._steady_variance,
            self._walk_variance,
            self.source_of,
            self.slices[slow].start,
            self.blocks[slow].sigma,
            _BEYOND_SIGMAS,
        )
        return found


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
        noise: covariance of the whole measurement noise, shape (m, m).
        booked: the noise by source as the compiled steps take it.
    """

    residual: FloatArray
    jacobian: FloatArray
    noise_by_source: Mapping[int, FloatArray]
    noise: FloatArray = field(init=False, repr=False)
    booked: tuple[tuple[int, FloatArray], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # The compiled steps read matrices row by row.
        booked = tuple((index, np.ascontiguousarray(part)) for index, part in self.noise_by_source.items())
        (_, total), *others = booked
        for _, part in others:
            total = total + part
        object.__setattr__(self, "noise", total)
        object.__setattr__(self, "booked", booked)


class ResidualCompared(NamedTuple):
    """A measurement of m components beside an estimate of n states.

    Attributes:
        covariance: of the residual, shape (m, m).
        nis: normalised innovation squared: chi² with m degrees of freedom where all is as modelled.
        gain: of the optimal update, shape (n, m).
    """

    covariance: FloatArray
    nis: float
    gain: FloatArray


def predict(
    stack: FloatArray, decay: FloatArray, noise: FloatArray, source_of: NDArray[np.intp], rows: int = 1
) -> FloatArray:
    """The covariances after a step with diagonal transition and process noise, both of shape (n,).

    Args:
        stack: covariance by source, and those of further rows (:mod:`ship_estimation.hypotheses`), if there are any,
            shape (n_sources + h - 1, n, n); several such stacks may be given, as a leading axis.
        decay: what is left of each state.
        noise: variance that comes new.
        source_of: index of the source to which it is booked (:attr:`StateModel.source_of`).
        rows: h; the further rows have no budget.

    Example:
        One state, whose covariance of 4 belongs to the first of two sources; it decays by half, and 1 comes new:

        >>> parts = np.array([[[4.0]], [[0.0]]])
        >>> print(predict(parts, decay=np.array([0.5]), noise=np.array([1.0]), source_of=np.array([0])).ravel())
        [2. 0.]
    """
    stacks = np.ascontiguousarray(stack).reshape(-1, *stack.shape[-3:])
    predicted: FloatArray = compiled_steps.carried(stacks, stack.shape[-3] - rows + 1, decay, noise, source_of)
    return predicted.reshape(stack.shape)


def innovation(parts: FloatArray, measurement: LinearMeasurement) -> ResidualCompared:
    """A measurement beside the estimate whose covariance is the sum of the parts.

    Raises:
        numpy.linalg.LinAlgError: the covariance of the residual is not positive definite.

    Example:
        A state with variance 3, measured with variance 1 and found 4 away, two sigma of their sum:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> covariance, nis, gain = innovation(parts, measured)
        >>> print(covariance, round(nis, 6), gain)
        [[4.]] 4.0 [[0.75]]
    """
    mean, residual = np.zeros((1, parts.shape[-1])), measurement.residual
    stack, no_turn = np.ascontiguousarray(parts), np.zeros((len(residual), 3))
    _, covariance, nis, gain, *_ = compiled_steps.compared(
        mean, stack, residual, measurement.jacobian, measurement.noise, mean[0], no_turn
    )
    return ResidualCompared(covariance[0], float(nis[0]), gain[0])


def update(
    parts: FloatArray, measurement: LinearMeasurement, gain: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Correction of the state, shape (n,), and the parts after a measurement.

    Args:
        parts: before the measurement, shape (n_sources, n, n).
        measurement: linearised at the predicted state.
        gain: as :func:`innovation` gives it; the form is Joseph's, which is right for any.

    Example:
        The measurement of :func:`innovation` has the weight 3/4, and the parts add up to the new variance 3/4:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> correction, parts = update(parts, measured, innovation(parts, measured).gain)
        >>> print(correction, parts.ravel())
        [3.] [0.1875 0.5625]
    """
    corrections, updated = compiled_steps.updated(
        np.ascontiguousarray(parts),
        measurement.jacobian,
        measurement.residual[None],
        gain[None],
        np.ones((1, len(gain)), dtype=np.uint8),
        measurement.booked,
        measurement.noise,
    )
    return corrections[0], updated

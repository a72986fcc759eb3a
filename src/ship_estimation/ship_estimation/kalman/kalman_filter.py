"""State vector of named blocks, and Kalman filter steps on a covariance that is kept by error source.

A state vector consists of named blocks (:class:`StateBlock`, :class:`StateModel`). A block defines the slice of the
state for one quantity, how the quantity evolves, and the error source of its process noise. The covariance P is kept as
``parts``, shape (n_sources, n, n), with P = parts.sum(axis=0). All steps are linear in P; the measurement update has
Joseph's form. Each part is therefore propagated like P and updated with the gain of P, and the parts always add up to
P. The parts are the covariance by error source, the error budget.

:meth:`StateModel.propagate` and :func:`propagate_covariance` are the time update. :func:`innovation` and :func:`update`
are the measurement update. The arithmetic is compiled (:mod:`ship_kernels.compiled_kalman`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_kalman

_MODEL_SIGMAS = 5.0
_NO_TIME_S = 1e-200


@dataclass(frozen=True)
class StateBlock:
    """One named block of the state with the process that drives it.

    Every element is a first-order Gauss–Markov process x' = -x / T + noise with T = ``time_s`` and steady standard
    deviation ``sigma``, except in two cases.
    An element with infinite ``time_s`` is a constant with prior ``sigma``, plus a random walk if ``walk`` is not zero.
    An element with ``time_s`` = 0 is white noise: independent at every time.

    Attributes:
        name: for example ``ins.attitude`` or ``star.fore.installation``.
        sigma: standard deviation of each element before any measurement, shape (n,).
        time_s: correlation time of each element in seconds, shape (n,).
        walk: random walk per square root of a second, shape (n,); only where ``time_s`` is infinite.
        source: error source of the prior covariance and of the process noise of the block.
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
    """Return a :class:`StateBlock` with scalars broadcast to the length of ``sigma``.

    Example:
        The correlated error of an INS is 10″ in tilt, with a correlation time of half an hour, and 72″ in heading, with
        three hours:

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
    """State vector that consists of blocks, and its propagation.

    Args:
        blocks: blocks in the order of their states.
        noise_sources: error sources of measurement noise, in addition to the error sources of the blocks.

    Attributes:
        blocks: blocks by name.
        slices: slice of the states of each block.
        size: number of states, n.
        sources: error sources, by name, in the order of the parts.
        source_indices: index of each error source.
        source_of: index of the error source of each state's process noise, shape (n,).

    Example:
        >>> ins, mount = block("ins", [10.0], "ins_drift", time_s=1800.0), block("mount", [20.0], "installation")
        >>> model = StateModel([ins, mount], noise_sources=["star_noise"])
        >>> print(model.sources, model.slices["mount"])
        ['ins_drift', 'installation', 'star_noise'] slice(1, 2, None)

        Decay factors and added variance of a step:

        >>> decay, noise = model.transition(dt_s=1800.0)
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
        # White noise decays to zero in any time above 0; a tiny time constant avoids a division by zero.
        self._time_s = np.where(time_s == 0.0, _NO_TIME_S, time_s)
        sigma = np.concatenate([b.sigma for b in blocks])
        walk = np.concatenate([b.walk for b in blocks])
        self._steady_variance = np.where(np.isfinite(self._time_s), sigma**2, 0.0)
        self._walk_variance = np.where(np.isfinite(self._time_s), 0.0, walk**2)
        self.source_of: NDArray[np.intp] = np.repeat(
            [self.source_indices[b.source] for b in blocks], [b.sigma.size for b in blocks]
        ).astype(np.intp)
        self._initial_variance = sigma**2

    def state_indices(self, name: str) -> NDArray[np.intp]:
        """Return the indices of a block in the state."""
        return np.arange(self.slices[name].start, self.slices[name].stop)

    def initial_covariance_by_source(self) -> FloatArray:
        """Return the covariance by error source before any measurement, shape (n_sources, n, n)."""
        return self.covariance_by_source(np.diag(self._initial_variance))

    def covariance_by_source(self, covariance: FloatArray) -> FloatArray:
        """Return a covariance split by the error sources of the blocks, shape (n_sources, n, n).

        Cross terms between blocks of different sources must be zero.
        """
        own = self.source_of == np.arange(len(self.sources))[:, None]
        return np.where(own[:, :, None] & own[:, None, :], covariance, 0.0)

    def transition(self, dt_s: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the diagonals of the transition matrix and process noise over ``dt_s`` >= 0, shapes (..., n)."""
        if isinstance(dt_s, float):
            found: tuple[FloatArray, FloatArray] = compiled_kalman.transition(
                dt_s, self._time_s, self._steady_variance, self._walk_variance
            )
            return found
        dt_s = np.asarray(dt_s)[..., None]
        decay = np.exp(-dt_s / self._time_s)
        return decay, self._steady_variance * (1.0 - decay * decay) + self._walk_variance * dt_s

    def propagate(
        self, dt_s: float, means: FloatArray, stack: FloatArray, correlated: str
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Propagate the main filter and all subfilters over ``dt_s``.

        Args:
            dt_s: time step, s, not negative.
            means: states of h filters, shape (h, n). The correlated error is propagated by
                :func:`propagate_correlated_error`.
            stack: covariances of the filters (:mod:`ship_estimation.fault_detection.subfilters`), shape
                (n_sources + h - 1, n, n).
            correlated: name of the block of the correlated error.

        Returns:
            Decay factor of each state, shape (n,), and the propagated means and stack.

        Example:
            After half an hour the error of 8 has decayed to 2.9. The error of 3600 is a step and does not decay:

            >>> model = StateModel([block("ins", [10.0, 10.0], "ins_drift", time_s=1800.0)], noise_sources=[])
            >>> _, means, stack = model.propagate(1800.0, np.array([[8.0, 3600.0]]), 4.0 * np.eye(2)[None], "ins")
            >>> print(means.round(1).tolist(), stack[0].diagonal().round())
            [[2.9, 3600.0]] [87. 87.]
        """
        found: tuple[FloatArray, FloatArray, FloatArray] = compiled_kalman.propagate(
            dt_s,
            means,
            np.ascontiguousarray(stack),
            self._time_s,
            self._steady_variance,
            self._walk_variance,
            self.source_of,
            self.slices[correlated].start,
            self.blocks[correlated].sigma,
            _MODEL_SIGMAS,
        )
        return found


def propagate_correlated_error(error: FloatArray, decay: FloatArray, sigma: FloatArray) -> FloatArray:
    """Propagate a correlated error, in which an element decays unless it is a step (:func:`exceeds_model`).

    Args:
        error: the error, shape (n,).
        decay: decay factor of each element, shape (n,).
        sigma: steady standard deviation of each element, shape (n,).

    Example:
        >>> sigma, decay = np.array([10.0, 10.0]), np.array([0.5, 0.5])
        >>> print(propagate_correlated_error(np.array([8.0, 3600.0]), decay, sigma))  # a step of a degree is kept
        [   4. 3600.]
    """
    return np.where(exceeds_model(error, sigma), error, decay * error)


def exceeds_model(error: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """True for each element that exceeds five sigma, shape (n,); such an element of the error counts as a step.

    Example:
        >>> print(exceeds_model(np.array([8.0, 3600.0]), sigma=np.array([10.0, 10.0])))
        [False  True]
    """
    beyond: NDArray[np.bool_] = np.abs(error) > _MODEL_SIGMAS * sigma
    return beyond


@dataclass(frozen=True)
class LinearMeasurement:
    """A measurement linearised at the predicted state: residual = jacobian @ error + noise.

    Attributes:
        residual: measured minus predicted, shape (m,).
        jacobian: Jacobian of the measurement with respect to the states, shape (m, n).
        noise_by_source: covariance of the measurement noise, shape (m, m), by index of the error source.
        noise: covariance of the whole measurement noise, shape (m, m).
        noise_parts: ``noise_by_source`` as contiguous matrices, for the compiled steps.
    """

    residual: FloatArray
    jacobian: FloatArray
    noise_by_source: Mapping[int, FloatArray]
    noise: FloatArray = field(init=False, repr=False)
    noise_parts: tuple[tuple[int, FloatArray], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # The compiled steps need C-contiguous matrices.
        noise_parts = tuple((index, np.ascontiguousarray(part)) for index, part in self.noise_by_source.items())
        (_, total), *others = noise_parts
        for _, part in others:
            total = total + part
        object.__setattr__(self, "noise", total)
        object.__setattr__(self, "noise_parts", noise_parts)


class InnovationAndGain(NamedTuple):
    """Innovation covariance, NIS and Kalman gain of a measurement of m components, for n states.

    Attributes:
        covariance: innovation covariance, shape (m, m).
        nis: normalised innovation squared, chi² with m degrees of freedom if the model holds.
        gain: Kalman gain, shape (n, m).
    """

    covariance: FloatArray
    nis: float
    gain: FloatArray


def propagate_covariance(
    stack: FloatArray, decay: FloatArray, noise: FloatArray, source_of: NDArray[np.intp], filter_count: int = 1
) -> FloatArray:
    """Return the propagated covariances (time update), for a diagonal transition matrix and diagonal process noise.

    Args:
        stack: parts of the main filter, then one covariance for each subfilter
            (:mod:`ship_estimation.fault_detection.subfilters`), shape (n_sources + h - 1, n, n); or several stacks,
            with a leading axis.
        decay: decay factor of each state, shape (n,).
        noise: variance of the process noise of each state, shape (n,).
        source_of: index of the error source of the noise of each state, shape (n,) (:attr:`StateModel.source_of`).
        filter_count: number of filters in the stack, h.

    Example:
        The covariance of one state is 4, all from the first of two sources. The state decays by half, and noise of 1 is
        added:

        >>> parts = np.array([[[4.0]], [[0.0]]])
        >>> print(propagate_covariance(parts, np.array([0.5]), np.array([1.0]), source_of=np.array([0])).ravel())
        [2. 0.]
    """
    stacks = np.ascontiguousarray(stack).reshape(-1, *stack.shape[-3:])
    propagated: FloatArray = compiled_kalman.predicted_covariances(
        stacks, stack.shape[-3] - filter_count + 1, decay, noise, source_of
    )
    return propagated.reshape(stack.shape)


def innovation(parts: FloatArray, measurement: LinearMeasurement) -> InnovationAndGain:
    """Return innovation covariance, NIS and gain of a measurement, for a state covariance by error source.

    Raises:
        numpy.linalg.LinAlgError: the innovation covariance is not positive definite.

    Example:
        The state has variance 3 and the measurement has variance 1. The innovation of 4 is two sigma of the sum:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> covariance, nis, gain = innovation(parts, measured)
        >>> print(covariance, round(nis, 6), gain)
        [[4.]] 4.0 [[0.75]]
    """
    mean, residual = np.zeros((1, parts.shape[-1])), measurement.residual
    stack, no_rotation = np.ascontiguousarray(parts), np.zeros((len(residual), 3))
    _, covariance, nis, gain, *_ = compiled_kalman.innovations(
        mean, stack, residual, measurement.jacobian, measurement.noise, mean[0], no_rotation
    )
    return InnovationAndGain(covariance[0], float(nis[0]), gain[0])


def update(
    covariance_by_source: FloatArray, measurement: LinearMeasurement, gain: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the correction of the state, shape (n,), and the covariance by error source after a measurement update.

    Args:
        covariance_by_source: covariance by error source before the measurement, shape (n_sources, n, n).
        measurement: measurement linearised at the predicted state.
        gain: gain as returned by :func:`innovation`; Joseph's form is valid for any gain.

    Example:
        In the example of :func:`innovation` the gain is 3/4, and the parts add up to the new variance, 3/4:

        >>> measured = LinearMeasurement(np.array([4.0]), np.array([[1.0]]), {1: np.array([[1.0]])})
        >>> parts = np.array([[[3.0]], [[0.0]]])  # by the INS, by the stars
        >>> correction, parts = update(parts, measured, innovation(parts, measured).gain)
        >>> print(correction, parts.ravel())
        [3.] [0.1875 0.5625]
    """
    corrections, updated = compiled_kalman.update(
        np.ascontiguousarray(covariance_by_source),
        measurement.jacobian,
        measurement.residual[None],
        gain[None],
        np.ones((1, len(gain)), dtype=np.uint8),
        measurement.noise_parts,
        measurement.noise,
    )
    return corrections[0], updated

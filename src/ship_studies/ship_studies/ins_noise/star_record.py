"""Record of star measurements compared with the INS, and its likelihood for a process of the INS's error.

**Record.** Let u be the error of the INS's attitude, c all other correlated errors (installations, clocks, errors
shared by messages) and w the INS's white noise, with a gain g. As linearised by the filter, a measurement is
z = J_u (u + g w) + J_c c + noise. An epoch consists of all measurements of one stamp, stored as the information matrix
of (u, c, z). In this form w, which all measurements of an epoch share, can be integrated out for any sigma without loss
of information. A record with too many epochs is thinned, which loses precision but causes no bias.

**Likelihood.** A Kalman filter over the epochs uses the information (matrix L, vector h) of each epoch, which has the
same form for any number and kind of measurements. The exact likelihood is the density of the innovations (Schweppe
1965):

    log p = -1/2 log det(I + L P) + h·m - 1/2 m·L m + 1/2 r·(P' r)

with r = h - L m and P' = P - P (I + L P)^-1 L P.

Constants (installations, clocks) are not states: the mean is propagated as a linear function of the constants, which
are integrated out at the end (de Jong 1991). Several parameter sets are computed together, so that a gradient by
differences takes little longer than one likelihood.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import StateModel
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.ins_noise.session import NoiseSession, StarInnovation

MOST_EPOCHS = 6000
"""Maximum number of epochs of a record, more than three hours at 0.5 Hz; longer records are thinned."""

_INS_BLOCKS = ("ins.attitude", "ins.noise", "gravity.deflection")
"""Blocks of states that belong to the error to be identified."""


@dataclass(frozen=True)
class TimeVaryingStates:
    """Time-varying states other than the INS's error, in units of their own sigmas at the start (arcsec if zero).

    Attributes:
        covariance: covariance at the start, which is the steady covariance of Gauss-Markov states, shape (c, c).
        time_s: correlation times, shape (c,); infinite for random walks.
        walk: random walk per square root of a second, shape (c,).
    """

    covariance: FloatArray
    time_s: FloatArray
    walk: FloatArray

    @property
    def count(self) -> int:
        """Number of states."""
        return len(self.time_s)

    def propagation(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the decay factors over time steps (s), shape (e, c), and the process noise, shape (e, c, c)."""
        decay = np.exp(-dt_s[:, None] / self.time_s)
        fresh = self.covariance * (1.0 - decay[:, :, None] * decay[:, None, :])
        rows = np.arange(self.count)
        fresh[:, rows, rows] += self.walk**2 * dt_s[:, None]
        return decay, fresh


@dataclass(frozen=True)
class StarRecord:
    """A record of E epochs.

    Attributes:
        times_s: times of the epochs since the first, shape (E,).
        information: information of (u in arcseconds, time-varying states, constants, z), shape (E, s, s).
        white_gain: ratio of the INS's white-noise variance in an epoch to that in a sample, shape (E,).
        log_constant: part of the log likelihood that does not depend on parameters.
        time_varying: time-varying states, in the columns after u.
        constants: prior covariance of the constants, in units of their sigmas, shape (c, c).
        names: name of the block of each column after u, z excepted.
        epoch_step: thinning factor of the epochs.
    """

    times_s: FloatArray
    information: FloatArray
    white_gain: FloatArray
    log_constant: float
    time_varying: TimeVaryingStates
    constants: FloatArray
    names: tuple[str, ...]
    epoch_step: int

    @property
    def duration_s(self) -> float:
        """Time from the first to the last epoch, s."""
        return float(self.times_s[-1])

    def with_every_nth_epoch(self, step: int) -> "StarRecord":
        """Return the record with every nth epoch; the constant of its log likelihood is still that of all epochs."""
        kept = slice(None, None, step)
        return replace(
            self,
            times_s=self.times_s[kept],
            information=self.information[kept],
            white_gain=self.white_gain[kept],
            epoch_step=self.epoch_step * step,
        )


def star_record(session: NoiseSession, most_epochs: int = MOST_EPOCHS) -> StarRecord:
    """Return the record of a session's comparisons."""
    model, pairs, others = session.model, session.comparisons, _other_states(session)
    stamps = np.array([pair.time_ns for pair in pairs], dtype=np.int64)
    kept, of_epoch = np.unique(stamps, return_inverse=True)
    every = -(-len(kept) // most_epochs)
    kept = kept[::every]
    size = 3 + len(others.rows) + 1
    information, gains = np.zeros((len(kept), size, size)), np.ones(len(kept))
    log_constant = 0.0
    for pair, epoch in zip(pairs, of_epoch.tolist(), strict=True):
        if epoch % every:
            continue
        columns = _columns(pair, model, others)
        information[epoch // every] += columns.T @ np.linalg.solve(pair.noise, columns)
        gains[epoch // every] = _white_gain(pair, model)
        log_constant -= 0.5 * (len(pair.value) * np.log(2.0 * np.pi) + float(np.linalg.slogdet(pair.noise)[1]))
    times_s = (kept - kept[0]) / SECOND_NS
    return StarRecord(
        times_s, information, gains, log_constant, others.time_varying, others.constants, others.names, every
    )


def _columns(pair: StarInnovation, model: StateModel, others: "_OtherStates") -> FloatArray:
    """Return the columns of a comparison, shape (m, s): derivatives by u and by the other scaled states, then value."""
    by_attitude = ARCSEC * pair.jacobian[:, model.slices["ins.attitude"]]
    return np.column_stack([by_attitude, pair.jacobian[:, others.rows] * others.scale, pair.value])


def _white_gain(pair: StarInnovation, model: StateModel) -> float:
    """Return the ratio of white-noise variance in a comparison to that in a sample; interpolation reduces the noise."""
    by_white, by_slow = (pair.jacobian[:, model.slices[name]] for name in ("ins.noise", "ins.attitude"))
    return float((np.sum(by_white * by_slow) / np.sum(by_slow**2)) ** 2)


class _OtherStates(NamedTuple):
    """Indices, sigmas and models of the states other than the INS's error, time-varying states first."""

    rows: NDArray[np.intp]
    scale: FloatArray
    names: tuple[str, ...]
    time_varying: TimeVaryingStates
    constants: FloatArray


def _other_states(session: NoiseSession) -> _OtherStates:
    """Return the states with a non-zero sigma or random walk on which a comparison depends."""
    model = session.model
    covariance, time_s, walk = np.zeros((model.size, model.size)), np.zeros(model.size), np.zeros(model.size)
    names = np.empty(model.size, dtype=object)
    for name, block in model.blocks.items():
        states = model.slices[name]
        source, _, kind = name.rpartition(".")
        is_common = kind == "common" and source in session.common_n
        covariance[states, states] = session.common_n[source] if is_common else np.diag(block.sigma**2)
        time_s[states], walk[states], names[states] = block.time_s, block.walk, name
    matters = np.any([np.any(pair.jacobian != 0.0, axis=0) for pair in session.comparisons], axis=0)
    matters &= (np.diagonal(covariance) > 0.0) | (walk > 0.0)
    for name in _INS_BLOCKS:
        if name in model.slices:
            matters[model.slices[name]] = False
    moves = np.isfinite(time_s) | (walk > 0.0)
    moving, constant = np.flatnonzero(matters & moves), np.flatnonzero(matters & ~moves)
    rows = np.concatenate([moving, constant])
    scale = np.sqrt(np.diagonal(covariance)[rows])
    scale[scale == 0.0] = ARCSEC
    scaled = covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
    count = len(moving)
    walking = np.where(np.isinf(time_s[moving]), walk[moving], 0.0) / scale[:count]
    return _OtherStates(
        rows,
        scale,
        tuple(names[rows]),
        TimeVaryingStates(scaled[:count, :count], time_s[moving], walking),
        scaled[count:, count:],
    )


def marginalise_white_noise(record: StarRecord, white: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the information of the epochs with the INS's white noise integrated out.

    Args:
        record: record of E epochs.
        white: variance of a sample's noise about (North, Up, East), arcsec², shape (3,).

    Returns:
        Information of the same columns, shape (E, s, s), and the remaining part of the log likelihood, shape (E,).
    """
    root = np.sqrt(record.white_gain[:, None] * white)
    by_u = root[:, :, None] * record.information[:, :3]
    with_noise = np.eye(3) + by_u[:, :, :3] * root[:, None, :]
    marginal = np.swapaxes(by_u, -1, -2) @ np.linalg.solve(with_noise, by_u)
    return record.information - marginal, -0.5 * np.linalg.slogdet(with_noise)[1]


class ProcessSteps(NamedTuple):
    """Process of an INS's error along E epochs, for k parameter sets and n states.

    The first three states are u, the attitude error, in arcseconds.

    Attributes:
        start: covariance at the first epoch, shape (k, n, n).
        transition: transition to each further epoch, shape (k, E - 1, n, n), or (1, E - 1, n, n) for all sets.
        noise: covariance of the process noise of each step, shape (k, E - 1, n, n).
        white: variance of a sample's white noise about each axis, arcsec², shape (k, 3).
    """

    start: FloatArray
    transition: FloatArray
    noise: FloatArray
    white: FloatArray


class StateEstimate(NamedTuple):
    """Estimate of states and constants together.

    Attributes:
        mean: mean of n states and c constants, shape (n + c,).
        covariance: covariance of states and constants, shape (n + c, n + c).
    """

    mean: FloatArray
    covariance: FloatArray


class EpochFilter:
    """Kalman filter over a record for k parameter sets of a process.

    The states are u (attitude error of the INS), the record's time-varying states, then the other states of the
    process.

    Args:
        record: record of star measurements.
        steps: process along the record.

    Attributes:
        times_s: times of the epochs, shape (E,).
    """

    def __init__(self, record: StarRecord, steps: ProcessSteps) -> None:
        marginalised = [marginalise_white_noise(record, white) for white in steps.white]
        self._record, self._sets = record, len(steps.start)
        self.times_s = record.times_s
        self._observed_size = 3 + record.time_varying.count
        self._information = np.array([matrix for matrix, _ in marginalised])
        self._log_factors = np.array([log_factor for _, log_factor in marginalised])
        self._start, self._transition, self._noise = _with_time_varying(record, steps)
        self._run()

    def _run(self) -> None:
        """Propagate and update means and covariances through all epochs."""
        observed_size, information, count = self._observed_size, self._information, len(self._record.times_s)
        matrices = information[:, :, :observed_size, :observed_size]
        # Information vector of an epoch on the states, and its derivatives with respect to the constants.
        vectors = np.concatenate(
            [information[:, :, :observed_size, -1:], -information[:, :, :observed_size, observed_size:-1]], axis=-1
        )
        transitions, back = self._transition, np.swapaxes(self._transition, -1, -2)
        size, columns = self._start.shape[-1], vectors.shape[-1]
        self._means = np.zeros((self._sets, count, size, columns))
        self._covariances = np.zeros((self._sets, count, size, size))
        self._before = np.zeros((self._sets, count, observed_size, columns))
        self._spreads = np.zeros((self._sets, count, observed_size, observed_size))
        mean, covariance, unit = np.zeros((self._sets, size, columns)), self._start, np.eye(observed_size)
        for epoch in range(count):
            if epoch:
                transition = transitions[:, epoch - 1]
                mean = transition @ mean
                covariance = transition @ covariance @ back[:, epoch - 1] + self._noise[:, epoch - 1]
            matrix = matrices[:, epoch]
            observed_covariance, before = covariance[:, :, :observed_size], mean[:, :observed_size]
            spread = unit + matrix @ observed_covariance[:, :observed_size]
            rest = vectors[:, epoch] - matrix @ before
            solved = np.linalg.solve(spread, np.concatenate([matrix, rest], axis=-1))
            self._before[:, epoch], self._spreads[:, epoch] = before, spread
            mean = mean + observed_covariance @ solved[:, :, observed_size:]
            covariance = covariance - observed_covariance @ solved[:, :, :observed_size] @ np.swapaxes(
                observed_covariance, -1, -2
            )
            # Without this step, asymmetry due to rounding would grow.
            covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
            self._means[:, epoch], self._covariances[:, epoch] = mean, covariance
        after = self._means[:, :, :observed_size]
        rests = vectors - matrices @ self._before
        self._squares = (
            _as_function_of_constants(information[:, :, observed_size:, observed_size:])
            - np.swapaxes(vectors, -1, -2) @ self._before
            - np.swapaxes(self._before, -1, -2) @ rests
            - np.swapaxes(rests, -1, -2) @ (after - self._before)
        )

    def log_likelihoods(self) -> FloatArray:
        """Return the log likelihood of each parameter set, shape (k,)."""
        squares, prior = self._squares.sum(axis=1), self._record.constants
        by_constants, information = squares[:, 1:, :1], squares[:, 1:, 1:]
        with_prior = np.eye(len(prior)) + information @ prior
        explained = np.swapaxes(by_constants, -1, -2) @ prior @ np.linalg.solve(with_prior, by_constants)
        determinants = np.linalg.slogdet(self._spreads)[1].sum(axis=1) + np.linalg.slogdet(with_prior)[1]
        of_record = self._record.log_constant + self._log_factors.sum(axis=1)
        found: FloatArray = of_record - 0.5 * (squares[:, 0, 0] - explained[:, 0, 0] + determinants)
        return found

    def estimate_at(self, epoch: int) -> StateEstimate:
        """Return the estimate after an epoch, from all epochs up to it, for the first parameter set."""
        squares, prior = self._squares[0, : epoch + 1].sum(axis=0), self._record.constants
        covariance = np.linalg.solve(np.eye(len(prior)) + prior @ squares[1:, 1:], prior)
        constants = -covariance @ squares[1:, 0]
        mean, by_constants = self._means[0, epoch, :, 0], self._means[0, epoch, :, 1:]
        shared = by_constants @ covariance
        of_states = self._covariances[0, epoch] + shared @ by_constants.T
        return StateEstimate(
            np.concatenate([mean + by_constants @ constants, constants]),
            np.block([[of_states, shared], [shared.T, covariance]]),
        )

    def predict(self, estimate: StateEstimate, epoch: int, later: int) -> StateEstimate:
        """Propagate an estimate from an epoch to a later epoch."""
        size = self._start.shape[-1]
        mean, covariance = estimate.mean.copy(), estimate.covariance.copy()
        for step in range(epoch, later):
            transition = self._transition[0, step]
            mean[:size] = transition @ mean[:size]
            covariance[:size] = transition @ covariance[:size]
            covariance[:, :size] = covariance[:, :size] @ transition.T
            covariance[:size, :size] += self._noise[0, step]
        return StateEstimate(mean, covariance)

    def update(self, estimate: StateEstimate, epoch: int) -> StateEstimate:
        """Update an estimate with the information of an epoch."""
        information = self._information[0, epoch]
        size = self._start.shape[-1]
        rows = np.r_[0 : self._observed_size, size : len(estimate.mean)]
        matrix, vector = information[:-1, :-1], information[:-1, -1]
        observed_covariance = estimate.covariance[:, rows]
        spread = np.eye(len(rows)) + matrix @ observed_covariance[rows]
        after = estimate.covariance - observed_covariance @ np.linalg.solve(spread, matrix @ observed_covariance.T)
        return StateEstimate(estimate.mean + after[:, rows] @ (vector - matrix @ estimate.mean[rows]), after)


def _with_time_varying(record: StarRecord, steps: ProcessSteps) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return start, transitions and noise of the process and the record's time-varying states, in filter order."""
    time_varying = record.time_varying
    decay, fresh = time_varying.propagation(np.diff(record.times_s))
    size = steps.start.shape[-1]
    others = np.arange(3, 3 + time_varying.count)
    own = np.r_[0:3, 3 + time_varying.count : size + time_varying.count]
    found = []
    for of_process in steps[:3]:
        whole = np.zeros((*of_process.shape[:-2], size + time_varying.count, size + time_varying.count))
        whole[..., own[:, None], own] = of_process
        found.append(whole)
    start, transition, noise = found
    start[:, others[:, None], others] = time_varying.covariance
    transition[:, :, others, others] = decay
    noise[:, :, others[:, None], others] = fresh
    return start, transition, noise


def _as_function_of_constants(information: FloatArray) -> FloatArray:
    """Return the information of (constants, z) as a quadratic form of (1, constants), shape (..., 1 + c, 1 + c)."""
    turned: FloatArray = np.roll(information, 1, axis=(-1, -2))
    turned[..., 0, 1:] *= -1.0
    turned[..., 1:, 0] *= -1.0
    return turned

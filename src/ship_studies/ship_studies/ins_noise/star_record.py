"""Record of star measurements compared with the INS, condensed for the likelihood.

Let u be the error of the INS's attitude, c all other correlated errors (installations, clocks, errors shared by
messages) and w the INS's white noise, with a gain g. As linearised by the filter, a measurement is z = J_u (u + g w) +
J_c c + noise. An epoch consists of all measurements of one stamp, stored as the information matrix of (u, c, z). In
this form w, which all measurements of an epoch share, can be integrated out for any sigma without loss of information.

A record with too many epochs is thinned, which loses precision but causes no bias.
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

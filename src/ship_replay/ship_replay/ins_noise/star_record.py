"""A record of star measurements against the INS, condensed to what a likelihood needs.

With u the error of the INS's attitude, c all that lasts beside it (installations, clocks, what messages share) and w
the INS's white noise, a measurement is z = J_u (u + g w) + J_c c + noise, the filter's own linearisation. Of all
measurements of one stamp, an epoch, the information matrix of (u, c, z) is kept: in it w, the same for all of them,
integrates out in closed form for any sigma, so that nothing is lost of what a scatter tells about white noise.

A record of more epochs than a likelihood can take one by one is thinned, which loses precision and not truth.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman import StateModel
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_replay.ins_noise.session import NoiseSession, StarPair

MOST_EPOCHS = 6000
"""Of a record, more than three hours at 0.5 Hz; of more of them every so many are taken."""

_OF_INS = ("ins.attitude", "ins.noise", "gravity.deflection")
"""States that are to be found, or part of that."""


@dataclass(frozen=True)
class Moving:
    """What changes beside the INS's error, in units of its own sigmas at the start.

    Attributes:
        covariance: at the start, and the steady one of those that die out, shape (c, c).
        time_s: in which each dies out; infinite for what walks, shape (c,).
        walk: per square root of a second of what walks, shape (c,).
    """

    covariance: FloatArray
    time_s: FloatArray
    walk: FloatArray

    @property
    def count(self) -> int:
        """Number of the states."""
        return len(self.time_s)

    def over(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is left of each state after times, shape (e, c), and the covariance that comes new, shape (e, c, c)."""
        decay = np.exp(-dt_s[:, None] / self.time_s)
        fresh = self.covariance * (1.0 - decay[:, :, None] * decay[:, None, :])
        rows = np.arange(self.count)
        fresh[:, rows, rows] += self.walk**2 * dt_s[:, None]
        return decay, fresh


@dataclass(frozen=True)
class StarRecord:
    """A record of E epochs.

    Attributes:
        times_s: of the epochs since the first, shape (E,).
        information: of (u in arcseconds, what moves, constants, z), shape (E, s, s).
        white_gain: variance of the INS's white noise in an epoch over that of a sample, shape (E,).
        log_constant: part of the log likelihood that no parameter changes.
        moving: what the columns after u are.
        constants: covariance beforehand of those after, in units of their sigmas, shape (c, c).
        names: of the blocks that all these columns belong to.
        every: of how many epochs one was taken.
    """

    times_s: FloatArray
    information: FloatArray
    white_gain: FloatArray
    log_constant: float
    moving: Moving
    constants: FloatArray
    names: tuple[str, ...]
    every: int

    @property
    def duration_s(self) -> float:
        """From the first to the last epoch."""
        return float(self.times_s[-1])

    def thinned(self, every: int) -> "StarRecord":
        """Every so many epochs of the record; its likelihood lacks a constant."""
        kept = slice(None, None, every)
        return replace(
            self,
            times_s=self.times_s[kept],
            information=self.information[kept],
            white_gain=self.white_gain[kept],
            every=self.every * every,
        )


def star_record(session: NoiseSession, most_epochs: int = MOST_EPOCHS) -> StarRecord:
    """The record of a session's pairs."""
    model, pairs, beside = session.model, session.pairs, _beside(session)
    stamps = np.array([pair.time_ns for pair in pairs], dtype=np.int64)
    kept, of_epoch = np.unique(stamps, return_inverse=True)
    every = -(-len(kept) // most_epochs)
    kept = kept[::every]
    size = 3 + len(beside.rows) + 1
    information, gains = np.zeros((len(kept), size, size)), np.ones(len(kept))
    log_constant = 0.0
    for pair, epoch in zip(pairs, of_epoch.tolist(), strict=True):
        if epoch % every:
            continue
        columns = _columns(pair, model, beside)
        information[epoch // every] += columns.T @ np.linalg.solve(pair.noise, columns)
        gains[epoch // every] = _white_gain(pair, model)
        log_constant -= 0.5 * (len(pair.value) * np.log(2.0 * np.pi) + float(np.linalg.slogdet(pair.noise)[1]))
    times_s = (kept - kept[0]) / SECOND_NS
    return StarRecord(times_s, information, gains, log_constant, beside.moving, beside.constants, beside.names, every)


def _columns(pair: StarPair, model: StateModel, beside: "_Beside") -> FloatArray:
    """Jacobian by u and what is beside it, in their units, and the value, shape (m, s)."""
    by_attitude = ARCSEC * pair.jacobian[:, model.slices["ins.attitude"]]
    return np.column_stack([by_attitude, pair.jacobian[:, beside.rows] * beside.scale, pair.value])


def _white_gain(pair: StarPair, model: StateModel) -> float:
    """An attitude between samples has less of their noise: the white error stands beside the slow one, but for that."""
    by_white, by_slow = (pair.jacobian[:, model.slices[name]] for name in ("ins.noise", "ins.attitude"))
    return float((np.sum(by_white * by_slow) / np.sum(by_slow**2)) ** 2)


class _Beside(NamedTuple):
    """States beside the INS's error, those that move first: which they are, their sigmas, and what they do."""

    rows: NDArray[np.intp]
    scale: FloatArray
    names: tuple[str, ...]
    moving: Moving
    constants: FloatArray


def _beside(session: NoiseSession) -> _Beside:
    """The states that are not known to be nothing and that some pair depends on."""
    model = session.model
    covariance, time_s, walk = np.zeros((model.size, model.size)), np.zeros(model.size), np.zeros(model.size)
    names = np.empty(model.size, dtype=object)
    for name, block in model.blocks.items():
        states = model.slices[name]
        source, _, kind = name.rpartition(".")
        is_common = kind == "common" and source in session.common_n
        covariance[states, states] = session.common_n[source] if is_common else np.diag(block.sigma**2)
        time_s[states], walk[states], names[states] = block.time_s, block.walk, name
    matters = np.any([np.any(pair.jacobian != 0.0, axis=0) for pair in session.pairs], axis=0)
    matters &= (np.diagonal(covariance) > 0.0) | (walk > 0.0)
    for name in _OF_INS:
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
    return _Beside(
        rows, scale, tuple(names[rows]), Moving(scaled[:count, :count], time_s[moving], walking), scaled[count:, count:]
    )


def white_taken_out(record: StarRecord, white: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the epochs say with the INS's white noise integrated out.

    Args:
        record: of E epochs.
        white: variance of a sample's noise about (North, Up, East), arcsec², shape (3,).

    Returns:
        Information of the same columns, shape (E, s, s), and what is left of the log likelihood, shape (E,).
    """
    root = np.sqrt(record.white_gain[:, None] * white)
    by_u = root[:, :, None] * record.information[:, :3]
    with_noise = np.eye(3) + by_u[:, :, :3] * root[:, None, :]
    taken = np.swapaxes(by_u, -1, -2) @ np.linalg.solve(with_noise, by_u)
    return record.information - taken, -0.5 * np.linalg.slogdet(with_noise)[1]

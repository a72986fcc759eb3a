"""Running means of whitened turns: how well every row of hypotheses agrees with every source.

Every row of hypotheses (:mod:`ship_estimation.hypotheses`) sees the measurements of every source. Where the row is
right and uses a source, the whitened turns of that source have the mean zero, the covariance one, and are independent
of one another. Their running means over few and over many measurements therefore tell a knock within three
measurements and a creeping error later. Who is wrong, :mod:`ship_estimation.exclusion` concludes from them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_means
from ship_estimation.gates import chi_square_gate
from ship_estimation.protection import IntegrityConfig
from ship_geometry.rotations import FloatArray

MEANS_OVER = (3, 30, 300)
"""Measurements over which whitened turns are averaged."""

MEASUREMENTS_PER_H = 18_000
"""Of one source, for the probability of a false exclusion: five in a second."""

WELL = 0.5
"""A source that well agrees stays below this share of the chi² that excludes it."""

LONG_AGO_NS = -(2**62)
"""Before any stamp: of a source not heard, or that contradicts nothing."""

SEEN_BY_ROWS = ("running", "excess", "refused")
"""What of :class:`Means` each row has seen for itself."""

_LARGEST_TURN = math.sqrt(0.5)
"""A whitened turn counts as no larger, as a share of the root of the limit: two gross errors in a row leave the mean
over three below the limit, the third does not."""

_WEIGHTS = np.array([2.0 / (count + 1.0) for count in MEANS_OVER])
"""Of a measurement in each mean, shape (w,)."""

_NO_NOISE = np.zeros((3, 3))

NO_MEANS = np.zeros((len(MEANS_OVER), 5))
"""The columns of :class:`Means` before any measurement."""


@dataclass(frozen=True)
class Means:
    """Running means of whitened turns; h rows, s sources, w lengths.

    Attributes:
        running: in five columns the mean turn (three), the share of the mean that measurements fill (0 at the start, 1
            soon), and the variance of a mean of independent turns as a share of that of one; shape (h, s, w, 5).
        excess: largest chi² of a mean over its limit, shape (h, s); of a source that a row does without only that of
            the first row counts.
        refused: refusals in a row, shape (h, s).
        heard_ns: stamp of the last measurement of each source, shape (s,).
        contradicts_ns: since when the first row does not well agree with each source, shape (s,); far in the past where
            it does.
    """

    running: FloatArray
    excess: FloatArray
    refused: NDArray[np.int64]
    heard_ns: NDArray[np.int64]
    contradicts_ns: NDArray[np.int64]


def no_means(rows: int, sources: int) -> Means:
    """Before any measurement.

    Example:
        >>> no_means(rows=3, sources=2).running.shape
        (3, 2, 3, 5)
    """
    return Means(
        running=np.zeros((rows, sources, len(MEANS_OVER), 5)),
        excess=np.zeros((rows, sources)),
        refused=np.zeros((rows, sources), dtype=np.int64),
        heard_ns=np.full(sources, LONG_AGO_NS),
        contradicts_ns=np.full(sources, LONG_AGO_NS),
    )


def excess_limit(config: IntegrityConfig, sources: int) -> float:
    """The chi² that no mean of a source that is right exceeds, but for half of the false exclusions configured.

    A mean over N measurements has an independent value every N measurements.

    Example:
        >>> print(round(excess_limit(IntegrityConfig(), sources=2), 1))
        37.4
    """
    tests_per_h = sources * MEASUREMENTS_PER_H * sum(1.0 / count for count in MEANS_OVER)
    return chi_square_gate(1.0 - 0.5 * config.false_exclusions_per_h / tests_per_h, 3)


def observed(
    means: Means,
    source: int | Sequence[int],
    turn: FloatArray,
    accepted: NDArray[np.bool_],
    time_ns: int,
    limit: float,
    turn_noise: FloatArray | None = None,
) -> Means:
    """The means after a measurement, or after one of each of several sources at the same moment.

    Args:
        means: before.
        source: its index; or those of l sources, and the arrays have an axis more.
        turn: whitened, in every row, shape (h, 3) or (h, l, 3).
        accepted: whether its NIS passed the gate of each row, shape (h,) or (h, l).
        time_ns: its stamp.
        limit: by :func:`excess_limit`.
        turn_noise: where the first row does without the source, the share of the noise in its turn, shape (3, 3).

    Example:
        Turns of three sigmas, always in the same direction, are too many after a few measurements:

        >>> found, turn = no_means(1, 1), np.array([[3.0, 0.0, 0.0]])
        >>> for number in range(8):
        ...     found = observed(found, 0, turn, np.array([True]), number, limit=37.4)
        ...     if found.excess[0, 0] > 1.0: break
        >>> number
        4
    """
    if isinstance(source, int):
        source, turn, accepted = (source,), turn[:, None], accepted[:, None]
    after = compiled_means.observed(
        means.running,
        means.excess,
        means.refused,
        means.heard_ns,
        means.contradicts_ns,
        tuple(source),
        turn,
        accepted.view(np.uint8),
        time_ns,
        _WEIGHTS,
        limit,
        _LARGEST_TURN * math.sqrt(limit),
        WELL,
        LONG_AGO_NS,
        turn_noise is not None,
        _NO_NOISE if turn_noise is None else turn_noise,
    )
    if after is not None:
        return Means(*after)
    # What is no number has no mean; it is a refusal.
    refused = means.refused.copy()
    refused[:, list(source)] += 1
    return replace(means, refused=refused)


def averaged(running: FloatArray, turn: FloatArray) -> tuple[FloatArray, float]:
    """The columns of :attr:`Means.running` of one row and source after one turn more, and how far a mean is off.

    That is the component of a mean, of all lengths, that is farthest from zero in its own sigmas.

    Args:
        running: before, shape (w, 5).
        turn: whitened, shape (3,).

    Example:
        >>> running, sigmas = averaged(NO_MEANS, np.array([0.0, 4.0, 1.0]))
        >>> print(running[0], round(sigmas, 6))
        [0.   2.   0.5  0.5  0.25] 4.0
    """
    after: tuple[FloatArray, float] = compiled_means.averaged(running, turn, _WEIGHTS)
    return after


def forgotten(means: Means, rows: Sequence[int] | slice, sources: Sequence[int] | slice) -> Means:
    """The means without what some rows saw of some sources.

    Example:
        >>> seen = replace(no_means(2, 2), refused=np.array([[1, 2], [3, 4]]))
        >>> forgotten(seen, slice(None), [1]).refused.tolist()
        [[1, 0], [3, 0]]
    """
    cut = {}
    for name in SEEN_BY_ROWS:
        values = getattr(means, name).copy()
        values[rows, sources] = 0
        cut[name] = values
    return replace(means, **cut)

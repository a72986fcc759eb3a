"""Which source is wrong, since when it is excluded, and when it may return.

Every row of hypotheses (:mod:`ship_estimation.hypotheses`) sees the measurements of every source. Where the row is
right and uses a source, the whitened turns of that source have the mean zero, the covariance one, and are independent
of one another. Their running means over few and over many measurements therefore tell a knock within three
measurements and a creeping error later. A source is wrong where the row of all sources does not agree with what it
sees, or stands too far from the row without that source, while all that the row without it uses agrees.

What is excluded is watched by the row that leaves it out. It returns once it has agreed with the others for a while:
the others know how it is mounted now, be it as before or, after a knock, anew.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.gates import chi_square_gate
from ship_estimation.hypotheses import RowsCompared
from ship_estimation.protection import IntegrityConfig
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

MEANS_OVER = (3, 30, 300)
"""Measurements over which whitened turns are averaged."""

MEASUREMENTS_PER_H = 18_000
"""Of one source, for the probability of a false exclusion: five in a second."""

HEARD_NS = 10 * SECOND_NS
"""A source not heard of for so long contradicts nobody."""

_LARGEST_TURN = math.sqrt(0.5)
"""A whitened turn counts as no larger, as a share of the root of the limit: two gross errors in a row leave the mean
over three below the limit, the third does not."""

_CLEARER = 0.4
"""By so much of its limit the chi² of the row that explains a fault is smaller than that of any other row: with the
usual limits the fault is a thousand times as probable there."""

_FARTHER = 1.3
"""Where all rows agree with what they see, the one that stands so many times farther off than any other explains it."""

_WELL = 0.5
"""A source that well agrees stays below this share of the chi² that excludes it."""

_MOST_DOUBLINGS = 6

_LONG_AGO_NS = -(2**62)

SEEN_BY_ROWS = ("running", "excess", "refused")
"""What of :class:`Means` each row has seen for itself."""

_HALF_BACK = 0.5
"""A source that was not knocked, and yet contradicted all others, has come back when less of its distance is left."""

_WEIGHTS = np.array([2.0 / (count + 1.0) for count in MEANS_OVER])[:, None]
_GAINED = np.hstack([np.repeat(_WEIGHTS, 4, axis=1), _WEIGHTS**2])
_KEPT = np.hstack([np.repeat(1.0 - _WEIGHTS, 4, axis=1), (1.0 - _WEIGHTS) ** 2])
"""What a measurement adds to the columns of :class:`Means`, and what it leaves of them, shape (w, 5)."""


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
        heard_ns=np.full(sources, _LONG_AGO_NS),
        contradicts_ns=np.full(sources, _LONG_AGO_NS),
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
    refused = means.refused.copy()
    size = np.sqrt(np.einsum("...k,...k->...", turn, turn))
    if not size.max() < np.inf:
        # What is no number has no mean; it is a refusal.
        refused[:, source] += 1
        return replace(means, refused=refused)
    refused[:, source] = np.where(accepted, 0, refused[:, source] + 1)
    largest = _LARGEST_TURN * math.sqrt(limit)
    seen = np.ones((*size.shape, 1, 5))
    seen[..., 0, :3] = turn * (largest / np.maximum(size, largest))[..., None]
    running, excess, heard_ns = means.running.copy(), means.excess.copy(), means.heard_ns.copy()
    running[:, source] = now = _KEPT * running[:, source] + _GAINED * seen
    # What a row uses it has whitened to independent turns.
    chi2 = np.einsum("...k,...k->...", now[..., :3], now[..., :3]) / now[..., 4]
    if turn_noise is not None:
        chi2[0] = _chi2_beside(now[0], turn_noise)
    excess[:, source] = chi2.max(axis=-1) / limit
    heard_ns[source] = np.maximum(heard_ns[source], time_ns)
    contradicts_ns = means.contradicts_ns.copy()
    well = (excess[0, source] <= _WELL) & (refused[0, source] == 0)  # NaN does not agree
    since_ns = np.where(contradicts_ns[source] == _LONG_AGO_NS, time_ns, contradicts_ns[source])
    contradicts_ns[source] = np.where(well, _LONG_AGO_NS, since_ns)
    return Means(running, excess, refused, heard_ns, contradicts_ns)


def _chi2_beside(running: FloatArray, turn_noise: FloatArray) -> FloatArray:
    """Chi² of the means of a source that the row does without, shape (w,).

    The row sees them against an error of its own that lasts: only the measurement's noise averages out.

    Args:
        running: as in :class:`Means`, of one row and source, shape (w, 5).
        turn_noise: share of the noise of the last measurement, shape (3, 3).
    """
    turn, filled, variance = np.split(running[:, :, None], (3, 4), axis=1)
    lasting = filled**2
    covariance = (variance - lasting) * turn_noise + (lasting + 1e-9) * np.eye(3)
    chi2: FloatArray = np.sum(turn * np.linalg.solve(covariance, turn), axis=(-2, -1))
    return chi2


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


@dataclass(frozen=True)
class Exclusion:
    """A source that is not used.

    Attributes:
        since_ns: stamp of the measurement that led to it.
        times: how often the source was excluded, with this time; each time it must agree for twice as long.
        agrees_since_ns: since when it has agreed with the others; None where it does not.
        apart: how far the source was from the others at that time, rotation vector of the device, rad, shape (3,): it
            must come back from there; None where its mounting is learnt anew.
    """

    since_ns: int
    times: int = 1
    agrees_since_ns: int | None = None
    apart: FloatArray | None = None


@dataclass(frozen=True)
class Finding:
    """What the rows say together.

    Attributes:
        fault: whether a source is wrong.
        row: of the hypothesis that explains it; None where none does, or more than one.
        explaining: the rows that explain it, the one that does so best first.
    """

    fault: bool
    row: int | None = None
    explaining: tuple[int, ...] = ()


def find_fault(
    means: Means,
    uses: NDArray[np.bool_],
    statistic: FloatArray,
    threshold: float,
    candidates: Sequence[int],
    now_ns: int,
    degraded_after: int = 3,
    larger: Sequence[int] = (),
) -> Finding:
    """Which source is wrong, if any; or which two are.

    Args:
        means: what every row has seen of every source.
        uses: which sources each row uses, shape (h, s).
        statistic: distance of each row from the first one, sigmas, shape (h,); 0 for the first.
        threshold: that a distance does not exceed where all sources are right.
        candidates: the rows that may explain a fault, in the order of their preference.
        now_ns: the moment.
        degraded_after: refusals in a row of one source that contradict a row.
        larger: rows that leave out more than one of the candidates does. Such a row explains what each of them does
            that it contains; so it is asked only where all candidates are contradicted, or where it stands clearly
            farther off than any other.

    Example:
        Three rows: by both sources, without the first one, without the second. The first source contradicts all that
        use it; so it is wrong:

        >>> excess, heard_ns = np.array([[2.0, 0.1], [9.0, 0.1], [2.0, 0.1]]), np.zeros(2, dtype=int)
        >>> seen = replace(no_means(3, 2), excess=excess, heard_ns=heard_ns)
        >>> uses = np.array([[True, True], [False, True], [True, False]])
        >>> find_fault(seen, uses, np.array([0.0, 4.0, 1.0]), 5.0, [1, 2], now_ns=0)
        Finding(fault=True, row=1, explaining=(1,))
    """
    heard = means.heard_ns >= now_ns - HEARD_NS
    agree = (means.excess[0] <= 1.0) & (means.refused[0] < degraded_after)  # NaN does not
    agrees = bool((agree | ~(uses[0] & heard)).all())
    if agrees and all(statistic[row] <= threshold for row in (*candidates, *larger)):  # NaN is not
        return Finding(fault=False)
    counts = uses & heard
    contradicted = np.where(means.refused >= degraded_after, np.maximum(means.excess, 2.0), means.excess)
    worst = np.max(np.where(counts, contradicted, 0.0), axis=-1, initial=0.0)
    # A row explains a fault where all that it uses was heard since the contradiction began, and well agrees with it.
    began_ns = np.max(means.contradicts_ns, initial=_LONG_AGO_NS, where=heard)
    well = (means.excess <= _WELL) & (means.refused == 0) & (means.heard_ns >= began_ns)
    explains = np.all(well | ~counts, axis=-1)
    asked = larger if larger and not np.any(worst[candidates] <= 1.0) else candidates
    explaining = sorted((row for row in asked if explains[row]), key=lambda row: worst[row])
    if not explaining:
        return Finding(fault=True)
    best = explaining[0]
    if all(not worst[row] < worst[best] + _CLEARER for row in asked if row != best):
        return Finding(fault=True, row=best, explaining=tuple(explaining))
    row = None
    if agrees and len(explaining) > 1:
        both = [*explaining, *(row for row in larger if explains[row])]
        row = _farthest(both, statistic, threshold) or _farthest(explaining, statistic, threshold)
    return Finding(fault=True, row=row, explaining=tuple(explaining))


def _farthest(rows: Sequence[int], statistic: FloatArray, threshold: float) -> int | None:
    """Which of two rows or more stands beyond the threshold, and clearly farther than the others; None: none does."""
    farthest, second = sorted(rows, key=lambda row: -statistic[row])[:2]
    clear = statistic[farthest] > max(threshold, _FARTHER * statistic[second])
    return farthest if clear else None


def watched(
    exclusion: Exclusion, means: Means, source: int, compared: RowsCompared, time_ns: int, return_after_s: float
) -> tuple[Exclusion, bool]:
    """An excluded source after one of its measurements, and whether it is used again.

    A source whose mounting is not learnt anew must have come back: that the covariance of the others has grown, until
    its error is small beside that, is no agreement.

    Args:
        exclusion: before.
        means: with that measurement; the first row is that without the source.
        source: its index.
        compared: the measurement with every row.
        time_ns: the stamp.
        return_after_s: how long it must agree after its first exclusion.

    Example:
        >>> one = RowsCompared(*(np.empty(0),) * 4, np.zeros((1, 3)), 0.5 * np.eye(3), np.eye(3)[None])
        >>> agreed = Exclusion(since_ns=0, agrees_since_ns=5 * SECOND_NS)
        >>> watched(agreed, no_means(1, 1), 0, one, 70 * SECOND_NS, return_after_s=60.0)[1]
        True
    """
    agrees = means.excess[0, source] <= _WELL and means.refused[0, source] == 0  # NaN does not agree
    if exclusion.apart is not None:
        agrees = agrees and bool(_share_left(exclusion.apart, compared) <= _HALF_BACK)
    if not agrees:
        return replace(exclusion, agrees_since_ns=None), False
    since_ns = time_ns if exclusion.agrees_since_ns is None else exclusion.agrees_since_ns
    return replace(exclusion, agrees_since_ns=since_ns), (time_ns - since_ns) / SECOND_NS >= must_agree_s(
        exclusion, return_after_s
    )


def must_agree_s(exclusion: Exclusion, return_after_s: float) -> float:
    """How long an excluded source must agree before it is used again, s.

    Example:
        >>> must_agree_s(Exclusion(since_ns=0, times=3), return_after_s=60.0)
        240.0
    """
    return return_after_s * 2.0 ** min(exclusion.times - 1, _MOST_DOUBLINGS)


def _share_left(apart: FloatArray, compared: RowsCompared) -> float:
    """How much of the distance at first, rotation vector of the device in rad, the measurement still has."""
    whitened = np.linalg.pinv(compared.turn_root[0]) @ apart
    return float(whitened @ compared.turn[0] / (whitened @ whitened))

"""Which source is wrong, since when it is excluded, and when it may return.

Every row of hypotheses (:mod:`ship_estimation.hypotheses`) sees the measurements of every source, and running means
(:mod:`ship_estimation.running_means`) tell how well it agrees with each. A source is wrong where the row of all
sources does not agree with what it sees, or stands too far from the row without that source, while all that the row
without it uses agrees.

What is excluded is watched by the row that leaves it out. It returns once it has agreed with the others for a while:
the others know how it is mounted now, be it as before or, after a knock, anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.running_means import LONG_AGO_NS, WELL, Means
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

HEARD_NS = 10 * SECOND_NS
"""A source not heard of for so long contradicts nobody."""

_CLEARER = 0.6
"""By so much of its limit the chi² of the row that explains a fault is smaller than that of any other row: with the
usual limits the fault is 75 000 times as probable there. A source that creeps is judged anew at hundreds of
measurements before anybody is named: with 2 000 to one, six voyages of 40 named a sensor that was right."""

_FARTHER = 1.3
"""Where all rows agree with what they see, the one that stands so many times farther off than any other explains it."""

_MOST_DOUBLINGS = 6

_HALF_BACK = 0.5
"""A source that was not knocked, and yet contradicted all others, has come back when less of its distance is left."""

_DRIFT_SIGMAS = 3.0
"""The others show that it has come back only while half of its distance is so many standard deviations of their own
error: an INS that carries on alone drifts by as much in time."""

_MEAN_OVER = 20
"""Measurements over which the share of a distance that is left is averaged: one of them has more noise than half of a
small distance."""

_GROSS = 2.0
"""A measurement farther off than so many times the distance counts as that far: one gross error delays a return only
by some measurements."""


@dataclass(frozen=True)
class Exclusion:
    """A source that is not used.

    Attributes:
        since_ns: stamp of the measurement that led to it.
        times: how often the source was excluded, with this time; each time it must agree for twice as long.
        agrees_since_ns: since when it has agreed with the others; None where it does not.
        apart: how far the source was from the others at that time, rotation vector of the device, rad, shape (3,): it
            must come back from there; None where its mounting is learnt anew.
        share_left: share of ``apart`` that is left, mean over some measurements.
        farther_since_ns: since when it is much farther from the others than then, in the same direction; None where
            it is not.
        is_shared: True if all stars were excluded together, for an error that they may share.
        on_suspicion: whether it told a fault of its own and nobody has contradicted it yet.
    """

    since_ns: int
    times: int = 1
    agrees_since_ns: int | None = None
    apart: FloatArray | None = None
    share_left: float = 1.0
    farther_since_ns: int | None = None
    is_shared: bool = False
    on_suspicion: bool = False


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


_NO_FAULT = Finding(fault=False)


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

        >>> from ship_estimation.running_means import no_means
        >>> excess, heard_ns = np.array([[2.0, 0.1], [9.0, 0.1], [2.0, 0.1]]), np.zeros(2, dtype=int)
        >>> seen = replace(no_means(3, 2), excess=excess, heard_ns=heard_ns)
        >>> uses = np.array([[True, True], [False, True], [True, False]])
        >>> find_fault(seen, uses, np.array([0.0, 4.0, 1.0]), 5.0, [1, 2], now_ns=0)
        Finding(fault=True, row=1, explaining=(1,))
    """
    agrees = _first_row_agrees(means, uses[0], now_ns - HEARD_NS, degraded_after)
    sigmas = statistic.tolist()
    if agrees and all(sigmas[row] <= threshold for row in (*candidates, *larger)):  # NaN is not
        return _NO_FAULT
    heard = means.heard_ns >= now_ns - HEARD_NS
    counts = uses & heard
    contradicted = np.where(means.refused >= degraded_after, np.maximum(means.excess, 2.0), means.excess)
    worst = np.max(np.where(counts, contradicted, 0.0), axis=-1, initial=0.0)
    # A row explains a fault where all that it uses was heard since the contradiction began, and well agrees with it.
    began_ns = np.max(means.contradicts_ns, initial=LONG_AGO_NS, where=heard)
    well = (means.excess <= WELL) & (means.refused == 0) & (means.heard_ns >= began_ns)
    explains = np.all(well | ~counts, axis=-1)
    asked = larger if larger and not np.any(worst[candidates] <= 1.0) else candidates
    explaining = sorted((row for row in asked if explains[row]), key=lambda row: worst[row])
    if not explaining:
        return Finding(fault=True)
    best = explaining[0]
    if all(not worst[row] < worst[best] + _CLEARER for row in asked if row != best):
        return Finding(fault=True, row=best, explaining=tuple(explaining))
    row = None
    # After a refusal the first row has not used all that the others have: its distance from them tells nothing then.
    if agrees and len(explaining) > 1 and not (means.refused[0] * counts[0]).any():
        both = [*explaining, *(row for row in larger if explains[row])]
        row = _farthest(both, statistic, threshold) or _farthest(explaining, statistic, threshold)
    return Finding(fault=True, row=row, explaining=tuple(explaining))


def agrees_with_all(means: Means, degraded_after: int) -> bool:
    """Whether the first row agrees with every source, as :func:`find_fault` asks of those that it uses and has heard.

    Example:
        >>> from ship_estimation.running_means import no_means
        >>> agrees_with_all(no_means(rows=3, sources=2), degraded_after=3)
        True
    """
    by_source = zip(means.excess[0].tolist(), means.refused[0].tolist(), strict=True)
    return all(excess <= 1.0 and refused < degraded_after for excess, refused in by_source)  # NaN does not agree


def _first_row_agrees(means: Means, uses: NDArray[np.bool_], since_ns: int, degraded_after: int) -> bool:
    """Whether the first row agrees with all sources that it uses and that were heard since a moment."""
    by_source = zip(
        means.excess[0].tolist(), means.refused[0].tolist(), means.heard_ns.tolist(), uses.tolist(), strict=True
    )
    # NaN does not agree.
    return all(
        excess <= 1.0 and refused < degraded_after
        for excess, refused, heard_ns, used in by_source
        if used and heard_ns >= since_ns
    )


def _farthest(rows: Sequence[int], statistic: FloatArray, threshold: float) -> int | None:
    """Which of two rows or more stands beyond the threshold, and clearly farther than the others; None: none does."""
    farthest, second = sorted(rows, key=lambda row: -statistic[row])[:2]
    clear = statistic[farthest] > max(threshold, _FARTHER * statistic[second])
    return farthest if clear else None


def judge_return(
    exclusion: Exclusion,
    means: Means,
    source: int,
    time_ns: int,
    return_after_s: float,
    measured_share: float = 0.0,
    share_sigma: float = 0.0,
) -> tuple[Exclusion, bool]:
    """Return an excluded source's exclusion after one of its measurements, and True if it is used again.

    A source whose mounting is not learnt anew must have come back: that the covariance of the others has grown, until
    its error is small beside that, is no agreement.

    Args:
        exclusion: before.
        means: with that measurement; the first row is that without the source.
        source: its index.
        time_ns: the stamp.
        return_after_s: how long it must agree after its first exclusion.
        measured_share: share of :attr:`Exclusion.apart` that is left by that measurement.
        share_sigma: its standard deviation by the error of the others, without the noise of the measurement.

    Example:
        >>> from ship_estimation.running_means import no_means
        >>> agreed = Exclusion(since_ns=0, agrees_since_ns=5 * SECOND_NS)
        >>> judge_return(agreed, no_means(1, 1), 0, 70 * SECOND_NS, return_after_s=60.0)[1]
        True
    """
    agrees = means.excess[0, source] <= WELL and means.refused[0, source] == 0  # NaN does not agree
    if exclusion.apart is not None:
        measured_share = measured_share if abs(measured_share) < _GROSS else _GROSS  # NaN is gross
        share_left = exclusion.share_left + (measured_share - exclusion.share_left) * 2.0 / (_MEAN_OVER + 1.0)
        exclusion = replace(exclusion, share_left=share_left)
        agrees = agrees and share_left <= _HALF_BACK and _DRIFT_SIGMAS * share_sigma <= _HALF_BACK
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

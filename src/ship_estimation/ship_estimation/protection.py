"""Protection levels: how far an estimate may be wrong under a fault of one source that nothing has told.

An estimate by all sources stands beside one by all but source i. Where source i is right, the two differ by d_i with
the covariance P_i - P_0. A source whose |d_i| is above K_fa σ(d_i) is excluded. What is not excluded may still be
wrong, but not by more than the level

    max( K_0 σ_0,  max over i of  K_fa σ(d_i) + K_md,i σ_i )

of each component: where source i is wrong the estimate without it is right, and the estimate with it is at most the
threshold away. This is the solution separation of ARAIM (Blanch et al. 2015, IEEE Trans. Aerosp. Electron. Syst. 51,
DOI 10.1109/TAES.2014.130739).
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_integrity
from ship_estimation.chi_square import normal_value_above
from ship_estimation.parameter_fields import parameter, section
from ship_estimation.parameters import ParameterError
from ship_geometry.rotations import ARCSEC, FloatArray

TESTS_PER_H = 360
"""Independent values of a separation in an hour: it changes over ten seconds and more, as the slow error of an INS is
found anew."""

NORMAL_95 = 1.96
"""95 % of a normal error lie within so many sigmas to both sides: what the suite calls the accuracy of an angle."""

_COMPONENTS = 3
LEAST_SHARE, LEAST_VARIANCE_RAD2 = 1e-6, 1e-24
"""What the variance of a distance has at least, as a share of the variance by all sources and by itself: of a source
that is taken for exact nothing is apart by more than rounding."""
UNDISPUTED_SIGMAS = 3.0
"""Estimates without one source that are no further from that by all are as near as they are when all is right."""
_NO_LEVEL = np.full(_COMPONENTS, np.nan)
_NO_LEVEL.flags.writeable = False
_MOST_PROBABLE_MISS = 0.5
"""A level never lies below the threshold itself, however improbable the fault is."""


@dataclass(frozen=True, kw_only=True)
class PriorConfig:
    """How often a source of each kind goes wrong without a word."""

    ins: float = parameter(
        1e-4, doc="INS: a step or a drift that its own rates do not tell", unit="1/h", minimum=1e-12, maximum=1.0
    )
    star_sensor: float = parameter(1e-3, doc="star sensor: knocked or drifting", unit="1/h", minimum=1e-12, maximum=1.0)
    reference: float = parameter(1e-2, doc="other attitude system", unit="1/h", minimum=1e-12, maximum=1.0)
    all_stars: float = parameter(
        5e-6,
        doc="an error that all star sensors share: position, UTC, refraction",
        unit="1/h",
        minimum=1e-12,
        maximum=1.0,
    )
    ship_attitude: float = parameter(
        1e-3, doc="the ship's attitude under the theodolite", unit="1/h", minimum=1e-12, maximum=1.0
    )
    beacon: float = parameter(1e-2, doc="drone: a wrong baseline or light", unit="1/h", minimum=1e-12, maximum=1.0)
    encoder: float = parameter(1e-3, doc="encoders: a slip", unit="1/h", minimum=1e-12, maximum=1.0)


@dataclass(frozen=True, kw_only=True)
class IntegrityConfig:
    """How sure the protection levels are, and when a source is excluded and returns."""

    p_hmi: float = parameter(
        1e-5,
        doc="probability that an error is above its protection level and nothing says so",
        unit="1/h",
        minimum=1e-12,
        maximum=0.1,
    )
    false_exclusions_per_h: float = parameter(
        1e-3, doc="exclusions of sources that are right", unit="1/h", minimum=1e-9, maximum=10.0
    )
    alert_limit_arcsec: tuple[float, ...] = parameter(
        (),
        doc="largest protection level of heading, pitch, roll; or of azimuth times cos E, elevation, image rotation; "
        "above it the output is DEGRADED; empty: the level is told and limits nothing",
        unit="arcsec",
        minimum=0.001,
        maximum=648_000.0,
    )
    return_after_s: float = parameter(
        60.0, doc="an excluded source is used again once it has agreed so long", unit="s", minimum=1.0, maximum=86400.0
    )
    max_hypotheses: int = parameter(
        8, doc="most estimates side by side: all sources, and without those of each hypothesis", minimum=2, maximum=64
    )
    prior_per_h: PriorConfig = section(PriorConfig)

    def __post_init__(self) -> None:
        if len(self.alert_limit_arcsec) not in (0, _COMPONENTS):
            raise ParameterError(
                f"parameter 'integrity.alert_limit_arcsec' must have three values or none, got "
                f"{len(self.alert_limit_arcsec)}",
                "integrity.alert_limit_arcsec",
                value=self.alert_limit_arcsec,
            )

    @property
    def alert_limit(self) -> FloatArray:
        """Of each component, rad, shape (3,); NaN where none is configured."""
        return ARCSEC * np.array(self.alert_limit_arcsec or [math.nan] * _COMPONENTS)


def prior_of_all(priors_per_h: Sequence[float]) -> float:
    """How often in an hour independent sources go wrong together: the product of their probabilities in that hour.

    The probability of several faults at a time is the product of those of each (Blanch et al. 2015, the fault modes of
    section III). Each is that of an exposure: here the hour of ``p_hmi``. So the two faults begin in the same hour, in
    any order. That an older fault which nothing has told is met by a second one is not counted.

    Example:
        Two sources, each of which fails once in a thousand hours:

        >>> prior_of_all([1e-3, 1e-3])
        1e-06
    """
    return math.prod(priors_per_h)


@dataclass(frozen=True)
class Factors:
    """Numbers of sigmas for a set of hypotheses.

    Attributes:
        right: K_0, of the estimate by all sources.
        false_exclusion: K_fa, of a separation.
        missed: K_md of each hypothesis, of the estimate without its source, shape (h,).
    """

    right: float
    false_exclusion: float
    missed: FloatArray


def factors(config: IntegrityConfig, priors_per_h: Sequence[float]) -> Factors:
    """The numbers of sigmas that keep the configured probabilities.

    The probability of misleading information is shared out in equal parts to "all sources are right" and to each
    hypothesis. Half of the false exclusions is shared out to all separations and to their independent values in an hour
    (:data:`TESTS_PER_H`).

    Args:
        config: the probabilities.
        priors_per_h: how often the source of each hypothesis goes wrong in an hour; of several by
            :func:`prior_of_all`. Where it is no more than twice the share the level is the threshold alone.

    Example:
        Two star sensors and an INS, each of which fails once in a thousand hours:

        >>> found = factors(IntegrityConfig(), [1e-3, 1e-3, 1e-3])
        >>> print(round(found.right, 2), round(found.false_exclusion, 2), found.missed.round(2))
        5.97 5.25 [2.81 2.81 2.81]
    """
    share = config.p_hmi / (len(priors_per_h) + 1)
    tests = _COMPONENTS * TESTS_PER_H
    missed = [normal_value_above(min(share / prior, _MOST_PROBABLE_MISS)) for prior in priors_per_h]
    return Factors(
        right=normal_value_above(0.5 * share / tests),
        # On both sides; the other half of the false exclusions is that of ship_estimation.running_means.
        false_exclusion=normal_value_above(0.25 * config.false_exclusions_per_h / (tests * max(len(priors_per_h), 1))),
        missed=np.array(missed),
    )


class Separation(NamedTuple):
    """An output beside those that leave one source out each; h hypotheses in question, three components.

    Attributes:
        statistic: largest |d_i| / σ(d_i) over the components, shape (h,).
        level: protection level of each component, shape (3,).
        dominant: which hypothesis makes the largest level; -1 for that of all sources.
        widest: largest sigma of a state that makes the components, in any hypothesis.
    """

    statistic: FloatArray
    level: FloatArray
    dominant: int
    widest: float


def separation(
    k: Factors,
    rows: NDArray[np.intp],
    states: NDArray[np.intp],
    by_output: tuple[FloatArray, FloatArray, FloatArray],
    mean: FloatArray,
    means: FloatArray,
    parts: FloatArray,
    left_out: FloatArray,
) -> Separation:
    """The separations of the outputs without one source from that by all, and the protection levels.

    Args:
        k: numbers of sigmas of h hypotheses.
        rows: which of them are in question, and told of.
        states: that make the components, shape (n,).
        by_output: the components by the errors of the output, shape (3, 3); by these states, shape (3, n); the
            covariance of the errors of the output, by all sources, shape (3, 3).
        mean: of all states by all sources, shape (m,).
        means: without one source each, shape (h, m).
        parts: whose sum is the covariance of all states by all sources, shape (p, m, m).
        left_out: that without one source each, shape (h, m, m).

    Example:
        A source is left out; the estimate moves by 4″, and its sigma grows from 1.8″ to 3″, in each component alike:

        >>> k, every = Factors(right=6.0, false_exclusion=5.0, missed=np.array([2.0])), np.eye(3)
        >>> found = separation(k, np.array([0]), np.arange(3), (every, every, 3.24 * every), np.zeros(3),
        ...                    np.full((1, 3), 4.0), 3.24 * every[None], 9.0 * every[None])
        >>> print(found.statistic.round(2), found.level.round(1), found.dominant, found.widest)
        [1.67] [18. 18. 18.] 0 3.0
    """
    found = compiled_integrity.separation(
        states,
        *by_output,
        mean,
        means,
        parts,
        left_out,
        rows,
        k.right,
        k.false_exclusion,
        k.missed,
        LEAST_SHARE,
        LEAST_VARIANCE_RAD2,
    )
    return Separation(*found)


def separation_sigma(variance: FloatArray, variance_0: FloatArray) -> FloatArray:
    """Standard deviation of each distance of an estimate without one source from the estimate by all, shape (h, 3).

    Args:
        variance: of the components without each source, rad², shape (h, 3).
        variance_0: of those by all sources, rad², shape (3,).

    Example:
        >>> print(separation_sigma(np.array([[9.0, 25.0, 16.0]]), np.array([0.0, 16.0, 16.0])))
        [[3.    3.    0.004]]
    """
    sigma: FloatArray = compiled_integrity.separation_sigmas(variance, variance_0, LEAST_SHARE, LEAST_VARIANCE_RAD2)
    return sigma


def disputed(distance: FloatArray, statistic: FloatArray) -> FloatArray:
    """What an output adds to its covariance where estimates without one source stand apart from that by all.

    A source that creeps moves the estimate by all away from the one without it long before the separation is beyond
    the threshold at which it is excluded. Until then nobody knows which of the two is right, so that the covariance
    holds both: of each row d dᵀ (1 - 9 / s²) where its separation s is above three sigmas. It begins from nothing
    there, so that nothing jumps. The rows are added up.

    It is for what is put out alone. The estimates, their separations and the levels rest on the covariance without it.

    Args:
        distance: components of the estimate without each source minus those by all, or the states that make them,
            shape (h, n).
        statistic: the separation of each, sigmas, shape (h,); a row of which this or the distance is no number adds
            nothing.

    Returns:
        Covariance of the components, shape (n, n).

    Example:
        One estimate is 10″ away in the second component, at six sigmas; another one is as near as it should be:

        >>> print(disputed(np.array([[0.0, 10.0, 0.0], [4.0, 4.0, 4.0]]), np.array([6.0, 2.0])))
        [[ 0.  0.  0.]
         [ 0. 75.  0.]
         [ 0.  0.  0.]]
    """
    known = np.all(np.isfinite(distance), axis=-1, keepdims=True)
    # fmax takes the limit where there is no number.
    weight = 1.0 - (UNDISPUTED_SIGMAS / np.fmax(statistic, UNDISPUTED_SIGMAS)) ** 2
    apart = np.where(known, distance, 0.0)
    added: FloatArray = (weight * apart.T) @ apart
    return added


class IntegrityState(enum.IntEnum):
    """Whether the levels are within their alert limits; the values are those of ship_msgs/Integrity."""

    MET = 0
    EXCEEDED = 1
    UNAVAILABLE = 2
    NO_LIMIT = 3


class IntegrityReport(NamedTuple):
    """How far an output may be wrong although nothing says so, and who is excluded; h hypotheses.

    Attributes:
        time_ns: stamp of the output.
        state: of the levels against their limits.
        level: protection level of each component, rad, shape (3,); NaN where there is none.
        hypotheses: the sources of which each is left out in turn.
        statistic: largest separation of each, sigmas, shape (h,).
        threshold: that it must not exceed, sigmas.
        excluded: the sources that are excluded, and since which stamp.
        dominant: the hypothesis that makes the largest level; empty for that of all sources.
        widest: largest sigma of a state that makes the components, in any hypothesis, rad: so much of it as the
            components turn enters them.
    """

    time_ns: int
    state: IntegrityState
    level: FloatArray
    hypotheses: tuple[str, ...]
    statistic: FloatArray
    threshold: float
    excluded: tuple[tuple[str, int], ...]
    dominant: str
    widest: float


def integrity_report(
    time_ns: int,
    config: IntegrityConfig,
    k: Factors,
    names: tuple[str, ...],
    found: Separation,
    excluded: tuple[tuple[str, int], ...],
    checked: bool,
) -> IntegrityReport:
    """What is to be said of an output.

    Args:
        time_ns: its stamp.
        config: with the alert limits.
        k: numbers of sigmas.
        names: of the hypotheses in question; not those without a source that is excluded in any case.
        found: the output beside those of these hypotheses.
        excluded: the sources that are excluded, and since which stamp.
        checked: whether the sources in use are enough to check one another; else there is no level, nor is there one
            where a separation is beyond the threshold.

    Example:
        >>> limits = IntegrityConfig(alert_limit_arcsec=(24.0, 24.0, 24.0))
        >>> k = Factors(right=6.0, false_exclusion=5.0, missed=np.array([2.0]))
        >>> found = Separation(np.array([1.67]), np.full(3, 18.0 * ARCSEC), 0, 3.0 * ARCSEC)
        >>> told = integrity_report(0, limits, k, ("star.bow",), found, excluded=(), checked=True)
        >>> print(told.state.name, told.dominant, (told.level / ARCSEC).round(1))
        MET star.bow [18. 18. 18.]
    """
    # A level counts on separations within the threshold; NaN is not within it.
    checked = checked and all(statistic <= k.false_exclusion for statistic in found.statistic.tolist())
    level = found.level if checked and names else _NO_LEVEL
    state = IntegrityState.UNAVAILABLE
    if checked and not config.alert_limit_arcsec:
        state = IntegrityState.NO_LIMIT
    elif checked:
        # NaN is not within its limit.
        state = IntegrityState.MET if np.all(level <= config.alert_limit) else IntegrityState.EXCEEDED
    return IntegrityReport(
        time_ns=time_ns,
        state=state,
        level=level,
        hypotheses=names,
        statistic=found.statistic,
        threshold=k.false_exclusion,
        excluded=excluded,
        dominant=names[found.dominant] if checked and found.dominant >= 0 else "",
        widest=found.widest,
    )


def above_limit(report: IntegrityReport, quantities: Sequence[str]) -> str:
    """Why the levels do not meet their limits; empty where they do, or where none are configured.

    Example:
        >>> level = ARCSEC * np.array([3.6, 7.2, 14.4])
        >>> told = IntegrityReport(0, IntegrityState.EXCEEDED, level, ("ins",), np.zeros(1), 5.1, (), "ins", 0.0)
        >>> above_limit(told, ["heading", "pitch", "roll"])
        'a protection level is above its alert limit: heading 3.6″, pitch 7.2″, roll 14.4″'
    """
    if report.state is IntegrityState.EXCEEDED:
        levels = ", ".join(
            f"{name} {math.degrees(level) * 3600.0:.1f}″" for name, level in zip(quantities, report.level, strict=True)
        )
        return f"a protection level is above its alert limit: {levels}"
    if report.state is IntegrityState.UNAVAILABLE:
        why = "too few sources check one another, or they contradict one another"
        return f"there is no protection level, and alert limits are configured: {why}"
    return ""

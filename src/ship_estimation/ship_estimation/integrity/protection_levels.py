"""Protection levels, which bound the error of an output under an undetected fault of one source.

The main filter uses all sources; subfilter i excludes source i. Without a fault of source i the solution separation d_i
of the two filters has the covariance P_i - P_0. If |d_i| exceeds its threshold K_fa σ(d_i), a fault is detected. The
error of a component under an undetected fault is bounded by the protection level

    max( K_0 σ_0,  max over i of  K_fa σ(d_i) + K_md,i σ_i )

If source i has an undetected fault, subfilter i is fault-free, and the solution separation d_i is within its threshold.
This is the method of ARAIM (Blanch et al. 2015, IEEE Trans. Aerosp. Electron. Syst. 51, DOI 10.1109/TAES.2014.130739).
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import normal_value_above
from ship_estimation.parameters.fields import parameter, section
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_innovations

TESTS_PER_H = 360
"""Number of independent values of a solution separation in an hour.

A separation changes as slowly as the estimate of the INS's correlated error, over ten seconds or more."""

NORMAL_95 = 1.96
"""Half-width of the two-sided 95 % interval of a normal error, sigmas; it defines the accuracy of an angle."""

_COMPONENTS = 3
LEAST_SHARE, LEAST_VARIANCE_RAD2 = 1e-6, 1e-24
"""Minimum variance of a solution separation, as a share of the main filter's variance and absolute, rad². The variances
of main filter and subfilter may be equal, or zero for exact sources. Without the minimum, rounding errors of the states
would then exceed the threshold."""
INFLATION_START_SIGMAS = 3.0
"""Solution separation above which the published covariance is inflated, sigmas; smaller separations are usual."""
_NO_LEVEL = np.full(_COMPONENTS, np.nan)
_NO_LEVEL.flags.writeable = False
_MAX_MISSED_DETECTION = 0.5
"""Maximum probability of a missed detection. With this maximum K_md is not negative, so no level is below K_fa
σ(d_i)."""


@dataclass(frozen=True, kw_only=True)
class PriorConfig:
    """Rates of the faults that a source itself does not report, for each kind of source."""

    ins: float = parameter(
        1e-4, doc="INS: a step or a drift that its own rates do not show", unit="1/h", minimum=1e-12, maximum=1.0
    )
    star_sensor: float = parameter(
        1e-3, doc="star sensor: mounting shift or drift", unit="1/h", minimum=1e-12, maximum=1.0
    )
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
    """Parameters of the protection levels, and of fault exclusion and reinstatement."""

    p_hmi: float = parameter(
        1e-5,
        doc="probability that an error exceeds its protection level without an alert",
        unit="1/h",
        minimum=1e-12,
        maximum=0.1,
    )
    false_exclusions_per_h: float = parameter(
        1e-3, doc="rate of exclusions of fault-free sources", unit="1/h", minimum=1e-9, maximum=10.0
    )
    alert_limit_arcsec: tuple[float, ...] = parameter(
        (),
        doc="largest protection level of heading, pitch, roll; or of azimuth times cos E, elevation, image rotation; "
        "above it the output is DEGRADED; empty: the level is published without a limit",
        unit="arcsec",
        minimum=0.001,
        maximum=648_000.0,
    )
    return_after_s: float = parameter(
        60.0, doc="consistent time before an excluded source is reinstated", unit="s", minimum=1.0, maximum=86400.0
    )
    max_hypotheses: int = parameter(
        8, doc="maximum number of filters: the main filter and one subfilter for each hypothesis", minimum=2, maximum=64
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
        """Alert limit of each component, rad, shape (3,); NaN without configured limits."""
        return ARCSEC * np.array(self.alert_limit_arcsec or [math.nan] * _COMPONENTS)


def joint_prior_per_h(priors_per_h: Sequence[float]) -> float:
    """Return the rate of simultaneous faults of independent sources, 1/h, the product of their hourly probabilities.

    Each factor is the probability that a fault begins in the exposure time of ``p_hmi``, one hour (Blanch et al. 2015,
    fault modes of section III). Both faults therefore begin in the same hour, in any order. A second fault that follows
    an older undetected fault is not counted.

    Example:
        Two sources with one fault in a thousand hours each:

        >>> joint_prior_per_h([1e-3, 1e-3])
        1e-06
    """
    return math.prod(priors_per_h)


@dataclass(frozen=True)
class SigmaMultipliers:
    """Sigma multipliers K of a set of fault hypotheses.

    Attributes:
        fault_free: K_0, for the main filter.
        false_exclusion: K_fa, for a solution separation.
        missed_detection: K_md of each hypothesis, for its subfilter, shape (h,).
    """

    fault_free: float
    false_exclusion: float
    missed_detection: FloatArray


def sigma_multipliers(config: IntegrityConfig, priors_per_h: Sequence[float]) -> SigmaMultipliers:
    """Return the sigma multipliers for the configured probabilities.

    The probability of misleading information is allocated in equal parts to the fault-free case and to each hypothesis.
    Half of the rate of false exclusions is allocated equally to the solution separations. There is one separation for
    each hypothesis and component, with :data:`TESTS_PER_H` independent values in an hour.

    Args:
        config: configuration with the probabilities.
        priors_per_h: fault rate of each hypothesis, 1/h; for a hypothesis of several sources from
            :func:`joint_prior_per_h`. K_md is zero if the rate is at most twice the probability that is allocated to
            the hypothesis.

    Example:
        Two star sensors and an INS with one fault in a thousand hours each:

        >>> found = sigma_multipliers(IntegrityConfig(), [1e-3, 1e-3, 1e-3])
        >>> print(round(found.fault_free, 2), round(found.false_exclusion, 2), found.missed_detection.round(2))
        5.97 5.25 [2.81 2.81 2.81]
    """
    share = config.p_hmi / (len(priors_per_h) + 1)
    tests = _COMPONENTS * TESTS_PER_H
    missed = [normal_value_above(min(share / prior, _MAX_MISSED_DETECTION)) for prior in priors_per_h]
    return SigmaMultipliers(
        fault_free=normal_value_above(0.5 * share / tests),
        # The test is two-sided. The other half of the false exclusions is allocated to
        # ship_estimation.fault_detection.isolation.
        false_exclusion=normal_value_above(0.25 * config.false_exclusions_per_h / (tests * max(len(priors_per_h), 1))),
        missed_detection=np.array(missed),
    )


class ProtectionLevels(NamedTuple):
    """Protection levels and solution separations of an output, for h tested hypotheses and three components.

    Attributes:
        statistic: largest |d_i| / σ(d_i) over the components, shape (h,).
        level: protection level of each component, shape (3,).
        dominant: index of the tested hypothesis with the largest level; -1 for the fault-free case.
        largest_sigma: largest standard deviation, in any subfilter, of a state that determines the components.
    """

    statistic: FloatArray
    level: FloatArray
    dominant: int
    largest_sigma: float


def protection_levels(
    k: SigmaMultipliers,
    tested_subfilters: NDArray[np.intp],
    states: NDArray[np.intp],
    output_errors: tuple[FloatArray, FloatArray, FloatArray],
    mean: FloatArray,
    means: FloatArray,
    covariance_by_source: FloatArray,
    subfilter_covariances: FloatArray,
) -> ProtectionLevels:
    """Return the protection levels of an output, and the solution separations of the subfilters from the main filter.

    The error of an output is the error of its states plus output noise, which is the same in every filter.

    Args:
        k: sigma multipliers of h hypotheses.
        tested_subfilters: indices of the tested subfilters, 0 for the first. The subfilter of an excluded source
            is not tested.
        states: indices of the n states that determine the components, shape (n,).
        output_errors: three matrices. The first is the Jacobian of the components with respect to the error of the
            output, shape (3, 3). The second is the Jacobian of the components with respect to these states,
            shape (3, n). The third is the covariance of the output in the main filter, output noise included,
            shape (3, 3).
        mean: states of the main filter, shape (m,).
        means: states of each subfilter, shape (h, m).
        covariance_by_source: covariance of the main filter by error source, shape (p, m, m).
        subfilter_covariances: covariance of each subfilter, shape (h, m, m).

    Example:
        The subfilter differs from the main filter by 4″ in each component; its sigma is 3″ instead of 1.8″:

        >>> k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.0, missed_detection=np.array([2.0]))
        >>> every = np.eye(3)
        >>> found = protection_levels(k, np.array([0]), np.arange(3), (every, every, 3.24 * every), np.zeros(3),
        ...                    np.full((1, 3), 4.0), 3.24 * every[None], 9.0 * every[None])
        >>> print(found.statistic.round(2), found.level.round(1), found.dominant, found.largest_sigma)
        [1.67] [18. 18. 18.] 0 3.0
    """
    found = compiled_innovations.solution_separation(
        states,
        *output_errors,
        mean,
        means,
        covariance_by_source,
        subfilter_covariances,
        tested_subfilters,
        k.fault_free,
        k.false_exclusion,
        k.missed_detection,
        LEAST_SHARE,
        LEAST_VARIANCE_RAD2,
    )
    return ProtectionLevels(*found)


def separation_sigma(variance: FloatArray, variance_0: FloatArray) -> FloatArray:
    """Return the standard deviation of each solution separation, rad, shape (h, 3).

    Args:
        variance: variance of the components in each subfilter, rad², shape (h, 3).
        variance_0: variance of the components in the main filter, rad², shape (3,).

    Example:
        >>> print(separation_sigma(np.array([[9.0, 25.0, 16.0]]), np.array([0.0, 16.0, 16.0])))
        [[3.    3.    0.004]]
    """
    sigma: FloatArray = compiled_innovations.separation_sigmas(variance, variance_0, LEAST_SHARE, LEAST_VARIANCE_RAD2)
    return sigma


def separation_inflation(separations: FloatArray, statistic: FloatArray) -> FloatArray:
    """Return the covariance that is added to an output because of its solution separations.

    A drifting source separates the main filter from the subfilter without this source long before the separation
    exceeds the threshold. Until then the published covariance covers both solutions. Each subfilter whose separation d
    exceeds three sigmas adds d dᵀ (1 - 9 / s²), where s is the largest component of d in sigmas. The term is
    continuous, because it is zero at s = 3.

    The term is added to published covariances only. States, separations and protection levels do not contain the term.

    Args:
        separations: solution separations of each subfilter, in n components or in n states, shape (h, n).
        statistic: largest separation of each subfilter, sigmas, shape (h,). A subfilter with NaN adds nothing.

    Returns:
        Added covariance of these components or states, shape (n, n).

    Example:
        One subfilter is separated by 10″ in the second component, six sigmas. Another subfilter is within three sigmas:

        >>> print(separation_inflation(np.array([[0.0, 10.0, 0.0], [4.0, 4.0, 4.0]]), np.array([6.0, 2.0])))
        [[ 0.  0.  0.]
         [ 0. 75.  0.]
         [ 0.  0.  0.]]
    """
    known = np.all(np.isfinite(separations), axis=-1, keepdims=True)
    # fmax returns the limit for NaN.
    weight = 1.0 - (INFLATION_START_SIGMAS / np.fmax(statistic, INFLATION_START_SIGMAS)) ** 2
    separation = np.where(known, separations, 0.0)
    added: FloatArray = (weight * separation.T) @ separation
    return added


class IntegrityState(enum.IntEnum):
    """State of the protection levels against their alert limits; the values are those of ship_msgs/Integrity."""

    MET = 0
    EXCEEDED = 1
    UNAVAILABLE = 2
    NO_LIMIT = 3


class IntegrityReport(NamedTuple):
    """Protection levels of an output and the excluded sources, for h hypotheses.

    Attributes:
        time_ns: stamp of the output.
        state: state of the levels against their alert limits.
        level: protection level of each component, rad, shape (3,); NaN without a level.
        hypotheses: name of each hypothesis, the source or sources that its subfilter excludes, or all stars.
        statistic: largest solution separation of each hypothesis, sigmas, shape (h,).
        threshold: threshold of the solution separations, K_fa, sigmas.
        excluded: the excluded sources, and the stamp since which each is excluded.
        dominant: the hypothesis with the largest level; empty for the fault-free case.
        largest_sigma: largest standard deviation, in any subfilter, of a state that determines the components, rad. A
            rotation of the directions in which components are measured changes the levels in proportion to this sigma.
    """

    time_ns: int
    state: IntegrityState
    level: FloatArray
    hypotheses: tuple[str, ...]
    statistic: FloatArray
    threshold: float
    excluded: tuple[tuple[str, int], ...]
    dominant: str
    largest_sigma: float


def integrity_report(
    time_ns: int,
    config: IntegrityConfig,
    k: SigmaMultipliers,
    names: tuple[str, ...],
    found: ProtectionLevels,
    excluded: tuple[tuple[str, int], ...],
    is_checked: bool,
) -> IntegrityReport:
    """Return the integrity report of an output.

    Args:
        time_ns: stamp of the output.
        config: configuration with the alert limits.
        k: sigma multipliers.
        names: names of the tested hypotheses; sources that are excluded already are not tested.
        found: protection levels and solution separations of these hypotheses.
        excluded: the excluded sources, and the stamp since which each is excluded.
        is_checked: True if the sources in use can check one another. A level requires such sources, and separations
            within the threshold.

    Example:
        >>> limits = IntegrityConfig(alert_limit_arcsec=(24.0, 24.0, 24.0))
        >>> k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.0, missed_detection=np.array([2.0]))
        >>> found = ProtectionLevels(np.array([1.67]), np.full(3, 18.0 * ARCSEC), 0, 3.0 * ARCSEC)

        >>> report = integrity_report(0, limits, k, ("star.bow",), found, excluded=(), is_checked=True)
        >>> print(report.state.name, report.dominant, (report.level / ARCSEC).round(1))
        MET star.bow [18. 18. 18.]
    """
    # A level requires separations within the threshold; NaN is not within it.
    is_checked = is_checked and all(statistic <= k.false_exclusion for statistic in found.statistic.tolist())
    level = found.level if is_checked and names else _NO_LEVEL
    state = IntegrityState.UNAVAILABLE
    if is_checked and not config.alert_limit_arcsec:
        state = IntegrityState.NO_LIMIT
    elif is_checked:
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
        dominant=names[found.dominant] if is_checked and found.dominant >= 0 else "",
        largest_sigma=found.largest_sigma,
    )


def alert_limit_text(report: IntegrityReport, quantities: Sequence[str]) -> str:
    """Return the reason why the alert limits are not met; empty if they are met.

    The limits must be configured, because the text for missing protection levels states that they are.

    Example:
        >>> level = ARCSEC * np.array([3.6, 7.2, 14.4])
        >>> report = IntegrityReport(0, IntegrityState.EXCEEDED, level, ("ins",), np.zeros(1), 5.1, (), "ins", 0.0)

        >>> alert_limit_text(report, ["heading", "pitch", "roll"])
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

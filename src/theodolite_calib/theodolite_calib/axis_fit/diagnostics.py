"""Diagnostics of a fit: errors that its sightings cannot separate, and tables that fit better if read differently.

**Near dependencies.** Belsley, Kuh, Welsch, "Regression Diagnostics" (1980), ch. 3: the columns of the design are
scaled to unit length. A singular value far below the largest (its condition index is far above 1) belongs to a
combination of errors that hardly moves the pointing of these sightings. The errors whose variance comes mostly from it
are involved in it.

**Other readings of the table.** They are compared by the likelihood of the numbers in the table, not by the residuals
on the sky. An offset that was already multiplied by cos E has smaller residuals, because it is smaller. With the scale
s of n sightings,

    log L = -2 n log s + sum log |d(sky) / d(offset)|

where the derivative is cos E for an azimuth offset as such and 1 for one that was already multiplied. No sighting can
show that both offsets have the wrong sign: all errors then have the wrong sign too, and the likelihood is the same.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.robust_fit import PRIOR_SIGMAS, AxisFit, fit
from theodolite_calib.axis_fit.sightings import Sightings, directions

NEAR_DEPENDENCY_INDEX = 10.0
"""Condition index from which on a combination of errors is reported."""

CORRELATED = 0.9
"""Size of a correlation from which on a pair of errors is reported."""

_PARTICIPATION_SHARE = 0.25
"""Minimum share of an error's variance for the error to be involved in a combination."""
_OPEN_PARTICIPATION_RATIO = 0.02
"""Minimum change of an error for it to be involved in an unobservable combination, as a ratio to the largest one."""
_PRIOR_LIMIT_RAD = float(PRIOR_SIGMAS[-1])
"""Prior standard deviation of a small error, rad; a combination with larger changes is unobservable."""
_ROUNDING = 1e-15


@dataclass(frozen=True)
class NearDependency:
    """Near dependency: errors whose joint change hardly affects the sightings.

    Attributes:
        names: names of the errors involved.
        changes: change of each of them for one sigma of the combination, signed, rad.
        effect: effect of this change on the pointing, RMS over the sightings, rad.
    """

    names: tuple[str, ...]
    changes: tuple[float, ...]
    effect: float


@dataclass(frozen=True)
class Unobservable:
    """Errors with unobservable combinations.

    Attributes:
        names: names of the errors involved.
        count: number of independent unobservable combinations.
    """

    names: tuple[str, ...]
    count: int


def condition_number(fit: AxisFit) -> float:
    """Return the largest condition index of the design with columns of unit length."""
    indices, _ = _combinations(fit)
    return float(indices[-1])


def unobservable(fit: AxisFit) -> Unobservable | None:
    """Return the errors with unobservable combinations; None if every error is observable."""
    _, runs = _combinations(fit)
    sizes = np.abs(runs)
    is_open = np.max(sizes, axis=1) > _PRIOR_LIMIT_RAD
    # Errors that are not involved change a little too, by second-order effects of the errors themselves.
    takes_part = np.any(
        sizes[is_open] > _OPEN_PARTICIPATION_RATIO * np.max(sizes[is_open], axis=1, keepdims=True), axis=0
    )
    names = tuple(name for name, taking_part in zip(fit.fitted, takes_part, strict=True) if taking_part)
    return Unobservable(names, int(np.sum(is_open))) if names else None


def near_dependencies(fit: AxisFit) -> list[NearDependency]:
    """Return the observable combinations with at least :data:`NEAR_DEPENDENCY_INDEX`, by falling condition index."""
    indices, runs = _combinations(fit)
    shares = runs**2 / np.sum(runs**2, axis=0)
    effect = fit.scale / np.sqrt(len(fit.weights))
    found = []
    for index, run, share in zip(indices, runs, shares, strict=True):
        part = np.flatnonzero(share > _PARTICIPATION_SHARE)
        if index < NEAR_DEPENDENCY_INDEX or np.any(np.abs(run) > _PRIOR_LIMIT_RAD) or len(part) == 0:
            continue
        signed = run[part] * np.sign(run[part[0]])
        found.append(NearDependency(tuple(fit.fitted[i] for i in part), tuple(signed.tolist()), effect))
    return found[::-1]


def correlated_pairs(fit: AxisFit) -> list[tuple[str, str, float]]:
    """Return the pairs of names with a correlation of at least :data:`CORRELATED`, with it, by falling size."""
    correlation = fit.correlation
    pairs = [
        (fit.fitted[i], fit.fitted[j], float(correlation[i, j]))
        for i, j in combinations(range(len(fit.fitted)), 2)
        if abs(correlation[i, j]) >= CORRELATED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _combinations(fit: AxisFit) -> tuple[FloatArray, FloatArray]:
    """Return condition indices, rising, (k,), and the errors' changes for one sigma of each combination, (k, k)."""
    design = (np.sqrt(fit.weights)[:, None, None] * fit.design).reshape(-1, len(fit.fitted))
    lengths = np.linalg.norm(design, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    _, singular, vectors = np.linalg.svd(design / lengths, full_matrices=False)
    singular = np.maximum(singular, _ROUNDING * singular[0])
    return singular[0] / singular, fit.scale * vectors / singular[:, None] / lengths


_MIN_LOG_LIKELIHOOD_GAIN = 10.0
"""Gain of the log-likelihood from which on another reading is reported: twenty thousand times as likely."""
_LEAST_COSINE = 1e-3
"""Minimum cosine of the elevation, used near the zenith where it is a divisor."""


def table_warnings(sightings: Sightings, fixed: Mapping[str, float]) -> list[str]:
    """Return warnings about the table as it was read.

    Args:
        sightings: sightings as read, at least as many as there are errors to fit.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    # Errors common to sightings affect all readings equally. Here they count by the correlation of neighbours.
    without_shared_errors = replace(sightings, correlated_errors=())
    given, independent = _log_likelihood(without_shared_errors, fixed)
    best, text = max((_gain(other, given, fixed), words) for other, words in _readings(without_shared_errors))
    return [text] if independent * best > _MIN_LOG_LIKELIHOOD_GAIN else []


def _gain(reading: tuple[Sightings, float], given: float, fixed: Mapping[str, float]) -> float:
    sightings, by_derivative = reading
    likelihood, _ = _log_likelihood(sightings, fixed)
    return likelihood + by_derivative - given


def _log_likelihood(sightings: Sightings, fixed: Mapping[str, float]) -> tuple[float, float]:
    """Return the log-likelihood of the directions, and the ratio of independent sightings."""
    result = fit(sightings, fixed)
    share = min(1.0, max(0.0, (1.0 - result.neighbour_correlation) / (1.0 + result.neighbour_correlation)))
    return -2.0 * len(sightings.labels) * float(np.log(result.scale)), share


def _readings(sightings: Sightings) -> Iterator[tuple[tuple[Sightings, float], str]]:
    """Yield other readings of the table, each with the term of its derivative in the likelihood, and its text."""
    azimuth, elevation = sightings.offsets()
    cosine = np.cos(sightings.elevation)
    cosine = np.where(np.abs(cosine) < _LEAST_COSINE, _LEAST_COSINE, cosine)
    yield (
        (_with_offsets(sightings, azimuth / cosine, elevation), -float(np.sum(np.log(np.abs(cosine))))),
        "azimuth_offset_deg seems already multiplied by cos E: expected true minus encoder, not multiplied",
    )
    words = "seems to have the opposite sign of {}: give true minus encoder in both"
    yield (
        (_with_offsets(sightings, -azimuth, elevation), 0.0),
        f"azimuth_offset_deg {words.format('elevation_offset_deg')}",
    )


def _with_offsets(sightings: Sightings, azimuth: FloatArray, elevation: FloatArray) -> Sightings:
    return replace(sightings, direction_d=directions(sightings.azimuth + azimuth, sightings.elevation + elevation))

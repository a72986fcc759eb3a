"""Diagnostics of a fit: errors that its sightings cannot separate, and tables that fit better if read differently.

**Near dependencies.** Belsley, Kuh, Welsch, "Regression Diagnostics" (1980), ch. 3: the columns of the design are
scaled to unit length. A singular value far below the largest (its condition index is far above 1) belongs to a
combination of errors that hardly moves the pointing of these sightings. An error is involved in a combination if a
large part of the error's variance comes from this combination.

**Other readings of the table.** The offsets in the table may have another sign or unit than assumed. Such readings are
compared by the likelihood of the numbers in the table. Residuals on the sky are not comparable, because offsets already
multiplied by cos E are smaller and have smaller residuals. With the scale s of n sightings,

    log L = -2 n log s + sum log |d(sky) / d(offset)|

where the derivative is cos E for a plain azimuth offset, and 1 for an offset already multiplied by cos E. If both
offsets have the wrong sign, no sighting can show this: all errors have the wrong sign, and the likelihood is equal.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_studies.axis_fit.robust_fit import PRIOR_SIGMAS, AxisFit, fit
from ship_studies.axis_fit.sightings import Sightings, directions

NEAR_DEPENDENCY_INDEX = 10.0
"""Minimum condition index of a combination of errors that is reported."""

CORRELATED = 0.9
"""Minimum size of the correlation of a pair of errors that is reported."""

_PARTICIPATION_SHARE = 0.25
"""Minimum part of an error's variance due to a combination for the error to be involved in that combination."""
_OPEN_PARTICIPATION_RATIO = 0.02
"""Minimum ratio of an error's change to the largest change for the error to belong to an unobservable combination."""
_PRIOR_LIMIT_RAD = float(PRIOR_SIGMAS[-1])
"""Prior standard deviation of a small error, rad; a combination with larger changes is unobservable."""
_ROUNDING = 1e-15

_MIN_LOG_LIKELIHOOD_GAIN = 10.0
"""Minimum gain in log-likelihood for which another reading is reported: the reading is then 20 000 times as likely."""
_LEAST_COSINE = 1e-3
"""Minimum cosine of the elevation, used near the zenith where it is a divisor."""


@dataclass(frozen=True)
class NearDependency:
    """Near dependency: errors whose joint change hardly affects the sightings.

    Attributes:
        names: names of the errors involved.
        changes: change of each error for one sigma of the combination, signed, rad.
        effect: effect of these changes on the pointing, RMS over the sightings, rad.
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
    # Other errors change a little too, due to second-order effects.
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
    """Return pairs of errors with their correlation, if its size is at least :data:`CORRELATED`, by falling size."""
    correlation = fit.correlation
    pairs = [
        (fit.fitted[i], fit.fitted[j], float(correlation[i, j]))
        for i, j in combinations(range(len(fit.fitted)), 2)
        if abs(correlation[i, j]) >= CORRELATED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _combinations(fit: AxisFit) -> tuple[FloatArray, FloatArray]:
    """Return rising condition indices, (k,), and the errors' changes for one sigma of each combination, (k, k)."""
    design = (np.sqrt(fit.weights)[:, None, None] * fit.design).reshape(-1, len(fit.fitted))
    lengths = np.linalg.norm(design, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    _, singular, vectors = np.linalg.svd(design / lengths, full_matrices=False)
    singular = np.maximum(singular, _ROUNDING * singular[0])
    return singular[0] / singular, fit.scale * vectors / singular[:, None] / lengths


def table_warnings(sightings: Sightings, fixed: Mapping[str, float]) -> list[str]:
    """Return warnings about the table as it was read.

    Args:
        sightings: sightings as read, at least as many as there are errors to fit.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    # Common errors of sightings affect all readings equally; the correlation of neighbours replaces them here.
    without_shared_errors = replace(sightings, correlated_errors=())
    given, independent = _log_likelihood(without_shared_errors, fixed)
    best, text = max((_gain(other, given, fixed), words) for other, words in _readings(without_shared_errors))
    return [text] if independent * best > _MIN_LOG_LIKELIHOOD_GAIN else []


def _gain(reading: tuple[Sightings, float], given: float, fixed: Mapping[str, float]) -> float:
    sightings, by_derivative = reading
    likelihood, _ = _log_likelihood(sightings, fixed)
    return likelihood + by_derivative - given


def _log_likelihood(sightings: Sightings, fixed: Mapping[str, float]) -> tuple[float, float]:
    """Return the log-likelihood of the directions, and the ratio of independent sightings to all sightings."""
    result = fit(sightings, fixed)
    share = min(1.0, max(0.0, (1.0 - result.neighbour_correlation) / (1.0 + result.neighbour_correlation)))
    return -2.0 * len(sightings.labels) * float(np.log(result.scale)), share


def _readings(sightings: Sightings) -> Iterator[tuple[tuple[Sightings, float], str]]:
    """Yield other readings of the table, each with the derivative's term of the log-likelihood, and a warning."""
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

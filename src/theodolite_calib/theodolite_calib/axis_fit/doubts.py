"""What speaks against a fit: errors that its sightings cannot tell apart, and a table that fits better read otherwise.

**Errors that run together.** Belsley, Kuh, Welsch, "Regression Diagnostics" (1980), ch. 3: the columns of the design
are scaled to unit length. A singular value far below the largest (its condition index is far above 1) belongs to a
combination of errors that hardly moves the pointing of these sightings. The errors that owe it most of their variance
take part in it.

**Other readings of the table.** They are compared by the likelihood of the numbers in the table, not by what is left on
the sky: an offset that was already multiplied by cos E leaves less, because it is smaller. With the scale s of n
sightings,

    log L = -2 n log s + sum log |d(sky) / d(offset)|

where the derivative is cos E for an azimuth offset as such and 1 for one that was multiplied already. No sighting can
tell whether both offsets have the wrong sign: all errors then have the wrong sign too, and the likelihood is the same.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.robust_fit import PRIOR_SIGMAS, AxisFit, fit
from theodolite_calib.axis_fit.sightings import Sightings, directions

POORLY_TOLD_APART = 10.0
"""A combination of errors with this condition index or a larger one is named."""

CORRELATED = 0.9
"""A pair of errors whose correlation has this size or a larger one is named."""

_TAKES_PART = 0.25
"""An error takes part in a combination that makes this share of its variance."""
_TAKES_PART_OPEN = 0.02
"""An error takes part in an open combination where it runs by this share of the longest run in it."""
_KNOWN_BEFORE = float(PRIOR_SIGMAS[-1])
"""What is known of a small error without sightings, rad: of a combination that may run further nothing is known."""
_ROUNDING = 1e-15


@dataclass(frozen=True)
class UnseenRun:
    """A combination of errors that may run together, nearly unseen by the sightings.

    Attributes:
        names: names of the errors that take part.
        run: how far each of them runs for one sigma of the combination, with its sign, rad.
        effect: what this run changes in the pointing, RMS over the sightings, rad.
    """

    names: tuple[str, ...]
    run: tuple[float, ...]
    effect: float


@dataclass(frozen=True)
class Unobservable:
    """Errors of which the sightings leave some combinations entirely open.

    Attributes:
        names: names of the errors that take part.
        count: number of independent combinations of them that are open.
    """

    names: tuple[str, ...]
    count: int


def condition_number(fit: AxisFit) -> float:
    """The largest condition index of the design with columns of unit length."""
    indices, _ = _combinations(fit)
    return float(indices[-1])


def unobservable(fit: AxisFit) -> Unobservable | None:
    """The errors of which the sightings say nothing; None where they say something about every error."""
    _, runs = _combinations(fit)
    sizes = np.abs(runs)
    is_open = np.max(sizes, axis=1) > _KNOWN_BEFORE
    # Errors that take no part run along a little, by second-order effects of the errors themselves.
    takes_part = np.any(sizes[is_open] > _TAKES_PART_OPEN * np.max(sizes[is_open], axis=1, keepdims=True), axis=0)
    names = tuple(name for name, taking_part in zip(fit.fitted, takes_part, strict=True) if taking_part)
    return Unobservable(names, int(np.sum(is_open))) if names else None


def poorly_told_apart(fit: AxisFit) -> list[UnseenRun]:
    """The combinations from :data:`POORLY_TOLD_APART` on that are not entirely open, by falling condition index."""
    indices, runs = _combinations(fit)
    shares = runs**2 / np.sum(runs**2, axis=0)
    effect = fit.scale / np.sqrt(len(fit.weights))
    found = []
    for index, run, share in zip(indices, runs, shares, strict=True):
        part = np.flatnonzero(share > _TAKES_PART)
        if index < POORLY_TOLD_APART or np.any(np.abs(run) > _KNOWN_BEFORE) or len(part) == 0:
            continue
        signed = run[part] * np.sign(run[part[0]])
        found.append(UnseenRun(tuple(fit.fitted[i] for i in part), tuple(signed.tolist()), effect))
    return found[::-1]


def correlated_pairs(fit: AxisFit) -> list[tuple[str, str, float]]:
    """Pairs of names whose correlation is :data:`CORRELATED` or larger, with it, by falling size."""
    correlation = fit.correlation
    pairs = [
        (fit.fitted[i], fit.fitted[j], float(correlation[i, j]))
        for i, j in combinations(range(len(fit.fitted)), 2)
        if abs(correlation[i, j]) >= CORRELATED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _combinations(fit: AxisFit) -> tuple[FloatArray, FloatArray]:
    """Condition indices, rising, shape (k,), and how far each error runs for one sigma of each combination, (k, k)."""
    design = (np.sqrt(fit.weights)[:, None, None] * fit.design).reshape(-1, len(fit.fitted))
    lengths = np.linalg.norm(design, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    _, singular, vectors = np.linalg.svd(design / lengths, full_matrices=False)
    singular = np.maximum(singular, _ROUNDING * singular[0])
    return singular[0] / singular, fit.scale * vectors / singular[:, None] / lengths


_TOLD = 10.0
"""Another reading is named when the logarithm of its likelihood is larger by this: twenty thousand times as likely."""
_LEAST_COSINE = 1e-3
"""A smaller cosine of the elevation, near the zenith, is taken for this one where something is divided by it."""


def doubts(sightings: Sightings, fixed: Mapping[str, float]) -> list[str]:
    """What speaks against the table as it was read, in words for people.

    Args:
        sightings: the sightings as read, at least as many as there are errors to fit.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    # Errors that sightings share move all readings alike. Here they count by how they make neighbours alike.
    alone = replace(sightings, slow_errors=())
    given, independent = _log_likelihood(alone, fixed)
    best, text = max((_gain(other, given, fixed), words) for other, words in _readings(alone))
    return [text] if independent * best > _TOLD else []


def _gain(reading: tuple[Sightings, float], given: float, fixed: Mapping[str, float]) -> float:
    sightings, by_derivative = reading
    likelihood, _ = _log_likelihood(sightings, fixed)
    return likelihood + by_derivative - given


def _log_likelihood(sightings: Sightings, fixed: Mapping[str, float]) -> tuple[float, float]:
    """Logarithm of the likelihood of the directions, and the share of the sightings that count as independent."""
    result = fit(sightings, fixed)
    share = min(1.0, max(0.0, (1.0 - result.neighbours) / (1.0 + result.neighbours)))
    return -2.0 * len(sightings.labels) * float(np.log(result.scale)), share


def _readings(sightings: Sightings) -> Iterator[tuple[tuple[Sightings, float], str]]:
    """Other readings of the table, each with what its derivative adds to the likelihood, and with its words."""
    azimuth, elevation = sightings.offsets()
    cosine = np.cos(sightings.elevation)
    cosine = np.where(np.abs(cosine) < _LEAST_COSINE, _LEAST_COSINE, cosine)
    yield (
        (_with_offsets(sightings, azimuth / cosine, elevation), -float(np.sum(np.log(np.abs(cosine))))),
        "azimuth_offset_deg looks as if it were already multiplied by cos E: expected true minus encoder as it is",
    )
    words = "looks as if it had the other sign than {} has: give true minus encoder in both"
    yield (
        (_with_offsets(sightings, -azimuth, elevation), 0.0),
        f"azimuth_offset_deg {words.format('elevation_offset_deg')}",
    )


def _with_offsets(sightings: Sightings, azimuth: FloatArray, elevation: FloatArray) -> Sightings:
    return replace(sightings, direction_d=directions(sightings.azimuth + azimuth, sightings.elevation + elevation))

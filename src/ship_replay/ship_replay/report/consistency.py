"""Consistency of stated sigmas: NEES of errors over the whole run, NIS of innovations minute by minute.

Errors of a filter are correlated over minutes: the NEES band is computed for the equivalent number of independent
errors. Innovations are nearly independent: over a long run, the test would detect even a small error of the stated
sigma. So each minute is tested, like the last minute on the live page, and the result follows from the number of
minutes outside their band.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, chi2, norm

from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.statistics import AttitudeErrors, SourceInnovations
from ship_watch.sources.source_record import (
    BAND_SIGMAS,
    MAX_BAND,
    WINDOW_NS,
    NisWindow,
    consistent_text,
    inconsistent_text,
)
from ship_watch.suite_state import NisConsistency

TOO_FEW_TEXT = "too few"
TOO_FEW_INDEPENDENT_TEXT = "too few independent errors"

_BAND = 0.999
_NEES_DEGREES = 3
_MINUTE_OUTSIDE = 2.0 * float(norm.sf(BAND_SIGMAS))
"""Probability that a minute's ratio is outside its band although the stated sigma is correct."""


@dataclass(frozen=True)
class SigmaFit:
    """Result of the consistency test of one source's sigma.

    Attributes:
        kind: ``NEES`` of errors against the truth, ``NIS`` of innovations.
        name: name of the source.
        mean: mean of the normalised squares; NaN without squares.
        degrees: mean number of degrees of freedom, the expected value of ``mean``.
        count: number of normalised squares.
        independent: equivalent number of independent squares; NaN for innovations, which are nearly independent.
        minutes: number of tested minutes by result: ``as stated``, ``optimistic`` or ``pessimistic``; empty for errors.
        words: text of the result: "σ as stated (1.01)", "σ optimistic by 1.6 in 40 of 60 minutes", "too few" and
            similar.
    """

    kind: str
    name: str
    mean: float
    degrees: float
    count: int
    independent: float
    minutes: dict[str, int]
    words: str

    @property
    def ratio(self) -> float:
        """Ratio of actual to stated sigma over the whole run; NaN if unknown."""
        return math.sqrt(self.mean / self.degrees) if self.degrees > 0.0 and self.mean >= 0.0 else math.nan


def consistency(evaluation: Evaluation) -> list[SigmaFit]:
    """Return a result for each source of errors, then for each source with accepted innovations."""
    fits = [nees_fit(errors) for errors in evaluation.errors]
    return fits + [nis_fit(name, part) for name, part in evaluation.innovations.items() if part.accepted]


def nees_fit(errors: AttitudeErrors) -> SigmaFit:
    """Test a source's mean NEES against its 99.9 % band for the equivalent number of independent errors.

    The sum of N independent NEES of three degrees of freedom follows a χ² distribution with 3 N degrees of freedom.
    """
    nees = errors.nees[np.isfinite(errors.nees)]
    mean = float(np.mean(nees)) if len(nees) else math.nan
    return mean_nees_fit(errors.label, mean, len(nees), errors.independent_count())


def mean_nees_fit(name: str, mean: float, count: int, independent: float) -> SigmaFit:
    """Test a mean NEES against its 99.9 % band.

    Args:
        name: name of the source.
        mean: mean NEES.
        count: number of NEES.
        independent: equivalent number of independent NEES.
    """
    if not count:
        return SigmaFit("NEES", name, math.nan, _NEES_DEGREES, 0, 0.0, {}, "no σ stated")
    low, high = nees_band(independent)
    ratio_square = mean / _NEES_DEGREES
    spread = BAND_SIGMAS / math.sqrt(2.0 * _NEES_DEGREES * independent)
    if not spread <= MAX_BAND or not 0.0 < ratio_square < math.inf:
        words = TOO_FEW_INDEPENDENT_TEXT
    else:
        ratio = math.sqrt(ratio_square)
        words = f"σ {consistent_text(ratio) if low <= mean <= high else inconsistent_text(ratio)}"
    return SigmaFit("NEES", name, mean, _NEES_DEGREES, count, independent, {}, words)


def nees_band(independent: float) -> tuple[float, float]:
    """Return the 99.9 % band of the mean of independent NEES of three degrees of freedom; NaN if their number is zero.

    Args:
        independent: number of independent NEES.
    """
    if not independent:
        return math.nan, math.nan
    low, high = chi2.ppf([0.5 * (1.0 - _BAND), 0.5 * (1.0 + _BAND)], _NEES_DEGREES * independent) / independent
    return float(low), float(high)


def nis_fit(name: str, part: SourceInnovations) -> SigmaFit:
    """Test the NIS of a source's innovations, minute by minute.

    With a correct sigma, one minute in a thousand is outside its band by chance. σ is as stated if the number of such
    minutes does not exceed the 99.9 % quantile of the binomial distribution.
    """
    stamps = np.array(sorted(part.accepted), dtype=np.int64)
    accepted = [part.accepted[stamp] for stamp in stamps.tolist()]
    nis = np.array([one.nis for one in accepted])
    degrees = np.array([int(np.isfinite(one.residual).sum()) for one in accepted])
    number = (stamps - stamps[0]) // WINDOW_NS
    diagnoses: list[NisConsistency] = []
    for minute in np.unique(number):
        window, rows = NisWindow(), np.flatnonzero(number == minute)
        for row in rows:
            window.add(int(stamps[row]), float(nis[row]), int(degrees[row]))
        diagnoses.append(window.consistency(int(stamps[rows[-1]])))
    diagnoses = [verdict for verdict in diagnoses if verdict.text]  # other minutes have too few innovations
    outside = {
        "optimistic": [verdict for verdict in diagnoses if not verdict.is_consistent and verdict.ratio > 1.0],
        "pessimistic": [verdict for verdict in diagnoses if not verdict.is_consistent and verdict.ratio < 1.0],
    }
    minutes = {word: len(found) for word, found in outside.items()}
    minutes_by_result = {"as stated": len(diagnoses) - sum(minutes.values()), **minutes}
    known = np.isfinite(nis) & (degrees > 0)
    mean, freedom = (float(np.mean(values[known])) if known.any() else math.nan for values in (nis, degrees))
    if not diagnoses:
        words = TOO_FEW_TEXT
    elif sum(minutes.values()) <= binom.ppf(_BAND, len(diagnoses), _MINUTE_OUTSIDE):
        words = f"σ {consistent_text(math.sqrt(mean / freedom))}"
    else:
        parts = [f"{inconsistent_text(_combined_ratio(found))} in {len(found)}" for found in outside.values() if found]
        words = f"σ {', '.join(parts)} of {len(diagnoses)} minutes"
    return SigmaFit("NIS", name, mean, freedom, int(known.sum()), math.nan, minutes_by_result, words)


def _combined_ratio(diagnoses: list[NisConsistency]) -> float:
    """Return the ratio of actual to stated sigma over several minutes."""
    degrees = sum(verdict.degrees_of_freedom for verdict in diagnoses)
    return math.sqrt(sum(verdict.ratio**2 * verdict.degrees_of_freedom for verdict in diagnoses) / degrees)

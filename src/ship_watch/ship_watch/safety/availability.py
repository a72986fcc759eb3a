"""Expected availability: fraction of the time for which the angles of a recording are within a limit.

A limit is decisive only while the output is VALID, recent and independently checked. The angles count as within the
limit while the page shows SAFE, hysteresis included. A proposed limit is the lowest round limit that is met for 95 % of
the decisive time.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC
from ship_watch.safety.functions import QUANTITIES
from ship_watch.safety.limits import Limits
from ship_watch.safety.safety import HYSTERESIS_MARGIN, AngleSafety, SafetyHysteresis, safety_by_accuracy
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import AngleState, Safety
from ship_watch.value_texts import without_changing_figures

REQUIRED_SHARE = 0.95
"""Required fraction of the decisive time within a proposed limit."""

START_UP_S = 30.0
"""Ignored time after the first output, s. In this time the filters estimate mountings and INS errors."""

STEP_NS = NS_PER_S // 5
"""Time between two samples of the accuracy, ns."""

_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
_NO_LIMIT_ARCSEC = 360_000.0


@dataclass(frozen=True)
class Availability:
    """Expected availability of one quantity; the decisive time is the time in which the quantity's limit is decisive.

    Attributes:
        quantity: "heading", "tilt" or "pointing".
        limit_arcsec: current limit of the quantity.
        share: fraction of the decisive time within this limit.
        median_arcsec: median of the accuracy (95 %) of the worst angle in the decisive time.
        proposed_arcsec: the lowest round limit that is met for :data:`REQUIRED_SHARE` of the decisive time; if there is
            none, a limit above all accuracies.
        proposed_share: fraction of the decisive time within the proposed limit.
        decisive_share: decisive fraction of the whole time, without the start.
        other: reason why the quantity is not SAFE whatever its limit → fraction of the whole time, without the start.
    """

    quantity: str
    limit_arcsec: float
    share: float
    median_arcsec: float
    proposed_arcsec: float
    proposed_share: float
    decisive_share: float
    other: dict[str, float]


@dataclass(frozen=True)
class _Sample:
    """Angles of a quantity at one time, evaluated without a limit of their accuracy."""

    time_ns: int
    is_start: bool
    angles: tuple[AngleState, ...]

    @property
    def is_limit_decisive(self) -> bool:
        """True if the limit alone determines whether the quantity is SAFE."""
        return not self.is_start and all(angle.safety is Safety.SAFE for angle in self.angles)


class AvailabilityRecord:
    """Accuracies of a recording, sampled at a fixed rate.

    Args:
        limits: limits of the ship.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        no_limit = {f"{quantity}_arcsec": _NO_LIMIT_ARCSEC for quantity in QUANTITIES}
        self._monitor = SuiteMonitor(replace(limits, **no_limit))  # type: ignore[arg-type]
        self._next_sample_ns: int | None = None
        self._samples: dict[str, list[_Sample]] = {quantity: [] for quantity in QUANTITIES}

    def process_message(self, topic: str, message: Any, arrival_ns: int) -> None:
        """Process a message of the recording; messages must come in the order of arrival.

        Args:
            topic: name of the message's topic, relative to the namespace of the suite.
            message: the message, with the fields of its type as attributes.
            arrival_ns: arrival time of the message, ns.
        """
        while self._next_sample_ns is not None and self._next_sample_ns <= arrival_ns:
            self._sample(self._next_sample_ns)
            self._next_sample_ns += STEP_NS
        self._next_sample_ns = self._next_sample_ns or arrival_ns
        self._monitor.process_message(topic, message, arrival_ns)

    def availability(self, quantity: str) -> Availability | None:
        """Return the expected availability of a quantity; None if the limit is never decisive."""
        samples = self._samples[quantity]
        decided = [sample for sample in samples if sample.is_limit_decisive]
        if not decided:
            return None
        accuracies = np.array([max(angle.accuracy_95 for angle in each.angles) for each in decided]) / ARCSEC
        limit_arcsec = float(np.degrees(self._limits.angle_limit(QUANTITIES[quantity][0])) * 3600.0)
        for proposed_arcsec in _round_limits(float(np.min(accuracies))):
            share = self._share(quantity, proposed_arcsec)
            if share >= REQUIRED_SHARE or (1.0 - HYSTERESIS_MARGIN) * proposed_arcsec > np.max(accuracies):
                break
        later = [sample for sample in samples if not sample.is_start]
        reasons = Counter(_reason(sample.angles) for sample in later if not sample.is_limit_decisive)
        return Availability(
            quantity, limit_arcsec, self._share(quantity, limit_arcsec), float(np.median(accuracies)),
            proposed_arcsec, share, len(decided) / len(later),
            {reason: count / len(later) for reason, count in reasons.most_common()},
        )

    def _sample(self, time_ns: int) -> None:
        angles = {
            angle.name: angle for angle in self._monitor.current_state(time_ns).angles if math.isfinite(angle.age_s)
        }
        for quantity, names in QUANTITIES.items():
            if all(name in angles for name in names):
                before = self._samples[quantity]
                is_start = not before or time_ns - before[0].time_ns < START_UP_S * NS_PER_S
                before.append(_Sample(time_ns, is_start, tuple(angles[name] for name in names)))

    def _share(self, quantity: str, limit_arcsec: float) -> float:
        """Return the fraction of the decisive time in which the quantity is SAFE with a limit."""
        filters = [SafetyHysteresis(self._limits.better_after_s) for _ in QUANTITIES[quantity]]
        safe: list[bool] = []
        for sample in self._samples[quantity]:
            for hysteresis, angle in zip(filters, sample.angles, strict=True):
                hysteresis.update(self._angle_safety(angle, limit_arcsec * ARCSEC), sample.time_ns)
            if sample.is_limit_decisive:
                safe.append(all(held.safety is Safety.SAFE for held in filters))
        return sum(safe) / len(safe)

    def _angle_safety(self, angle: AngleState, limit: float) -> AngleSafety:
        """Return the safety of an angle if the limit of its accuracy is ``limit``, rad."""
        by_accuracy, by_margin = safety_by_accuracy(angle.accuracy_95, limit, self._limits.unsafe_factor)
        safety, reason = angle.unheld_safety or (angle.safety, angle.reason)
        return AngleSafety(max(safety, by_accuracy), reason, by_accuracy, by_margin)


def _round_limits(least_arcsec: float) -> Iterator[float]:
    """Yield round limits in rising order, arcsec, starting with the lowest limit not below ``least_arcsec``."""
    exponent = math.floor(math.log10(max(least_arcsec, 0.1)))
    while True:
        for first in _ROUND:
            if (limit := round(first * 10.0**exponent, 3)) >= least_arcsec:
                yield limit
        exponent += 1


def _reason(angles: Sequence[AngleState]) -> str:
    """Return why a quantity is not SAFE whatever its limit, without changing figures."""
    worst = max(angles, key=lambda angle: angle.safety)
    return "hold time" if worst.is_recovering else without_changing_figures(worst.reason)

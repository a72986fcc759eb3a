"""Innovation diagnosis, which tests whether a source is consistent with its stated sigma, alignment and clock.

An innovation is the residual of a measurement against its prediction. If the model is correct, innovations have zero
mean and the predicted covariance, and are independent in time. An :class:`InnovationHistory` keeps the innovations of
each source over the last minute of data. These innovations give the diagnosis of the source:

- If the innovations of most parts (stars, beacons, whole attitudes) are larger or smaller than predicted, the sigma of
  the source is optimistic or conservative. The reported factor applies to the source's own sigma, not to the
  prediction.
- If most parts are as stated, but there are too many outliers, the outliers are misidentifications.
- If the mean is not zero, there is a bias. A constant bias indicates an error of installation or alignment.
- If successive innovations are correlated, an error has a longer correlation time than in the model.

Rejected measurements are included, because otherwise a source whose bad measurements are all rejected would look
perfect. A few outliers are distinguished from many slightly large innovations
(:mod:`ship_estimation.innovations.innovation_statistics`).

Each test has the false alarm probability ``FALSE_DIAGNOSIS_PROBABILITY`` (1e-7) for a source that is as stated. Small
deviations (``TOLERATED_FACTOR``, ``TOLERATED_BIAS``, ``TOLERATED_CORRELATION``) are not reported.
"""

import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ship_estimation.innovations.gates import mean_nees_band
from ship_estimation.innovations.innovation_statistics import (
    FALSE_DIAGNOSIS_PROBABILITY,
    LEAST_COUNT,
    AxisStatistics,
    Innovation,
    InnovationTable,
    PartStatistics,
    axis_statistics,
    innovation_of,
)
from ship_estimation.kalman.kalman_filter import StateModel
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

WINDOW_S = 60.0
"""Duration of the newest data that a diagnosis uses, s."""

CLOCK_SIGMAS = 4.0
"""Deviation of an estimated clock offset from its configured value above which it is reported, configured sigmas."""

_MOST_KEPT = 6000
_MIN_FACTOR = 0.1


class DiagnosisKind(enum.Enum):
    """Kind of a diagnosis."""

    UNKNOWN = "not assessed"
    AS_STATED = "as stated"
    OPTIMISTIC = "sigma optimistic"
    CONSERVATIVE = "sigma conservative"
    MISIDENTIFIED = "misidentified"
    BIASED = "bias"
    CORRELATED = "errors correlated"


@dataclass(frozen=True)
class InnovationDiagnosis:
    """Diagnosis of a source.

    Attributes:
        kind: kind of the diagnosis.
        text: text for users, with values.
        count: number of measurements.
        nis: mean normalised innovation squared per component; NaN with too few measurements.
        nis_band: band of ``nis`` with probability 1 - FALSE_DIAGNOSIS_PROBABILITY if the source is as stated; None with
            too few measurements.
        factor: ratio of true to stated sigma of the source; NaN with too few parts.
        outlier_share: share of the parts that are outliers or were rejected.
        bias_sigma: median of the innovations in their sigmas, for each axis.
        correlation: correlation of successive innovations, for each axis.
    """

    kind: DiagnosisKind
    text: str
    count: int
    nis: float = math.nan
    nis_band: tuple[float, float] | None = None
    factor: float = math.nan
    outlier_share: float = math.nan
    bias_sigma: Mapping[str, float] = field(default_factory=dict)
    correlation: Mapping[str, float] = field(default_factory=dict)


class InnovationHistory:
    """Innovations of the newest data by source, and the diagnosis of each source.

    Example:
        The stated sigma of a sensor is 1″ about each axis; its true sigma is 2″:

        >>> import numpy as np
        >>> from ship_estimation.rejection_rules import Reason
        >>> from ship_geometry.rotations import ARCSEC
        >>> from ship_geometry.tracks.sample_track import VectorSample

        >>> book, rng, stated = InnovationHistory(), np.random.default_rng(1), ARCSEC**2 * np.eye(3)
        >>> for time_ns in range(0, 60 * SECOND_NS, SECOND_NS // 5):
        ...     measured = VectorSample(time_ns, 2.0 * ARCSEC * rng.standard_normal(3))
        ...     decision = MeasurementDecision(measured, Reason.NONE, True, ("forward", "up", "right"), measured.vector,
        ...                         covariance=stated, noise=stated)
        ...     book.add("star.bow", decision)

        >>> print(book.diagnoses()["star.bow"].text)
        sigma optimistic by 1.9: the noise is understated; 300 measurements
    """

    def __init__(self) -> None:
        self._tables: dict[str, InnovationTable] = {}
        self._pending: dict[str, list[Innovation]] = {}
        self._newest_ns = 0

    def clear(self) -> None:
        """Drop all innovations, as after a reset of the estimator."""
        self._tables.clear()
        self._pending.clear()
        self._newest_ns = 0

    def add(self, source: str, decision: MeasurementDecision[Any]) -> None:
        """Add the innovation of a decision, if any; of several with one stamp the last innovation is kept."""
        innovation = innovation_of(decision)
        if innovation is not None:
            self._pending.setdefault(source, []).append(innovation)
            self._newest_ns = max(self._newest_ns, innovation.time_ns)

    def diagnoses(self) -> dict[str, InnovationDiagnosis]:
        """Drop innovations older than :data:`WINDOW_S`, and return the diagnosis of each source, ordered by name."""
        for source, innovations in self._pending.items():
            if source not in self._tables:
                self._tables[source] = InnovationTable()
            self._tables[source].add_all(innovations)
        self._pending.clear()
        until_ns, verdicts = self._newest_ns - round(WINDOW_S * SECOND_NS), {}
        for source, table in sorted(self._tables.items()):
            table.drop_old(until_ns, _MOST_KEPT)
            verdicts[source] = _diagnosis(table)
        return verdicts


def clock_diagnoses(model: StateModel, mean: FloatArray, groups: Mapping[str, str]) -> list[str]:
    """Return one line for each clock whose estimated offset exceeds :data:`CLOCK_SIGMAS` of its configured sigma.

    Args:
        model: state model; states ``<device>.time_offset`` are clock offsets minus their configured values, s.
        mean: states, shape (n,).
        groups: parameter group by first word of a device's name, where the two differ.

    Example:
        >>> import numpy as np
        >>> from ship_estimation.kalman.kalman_filter import block
        >>> model = StateModel([block("ins.time_offset", [0.0015], source="ins_time_offset")], noise_sources=[])
        >>> clock_diagnoses(model, np.array([0.012]), {})
        ['ins clock off by 12 ms, 8 sigma of ins.time_offset_sigma_s']
    """
    texts = []
    for name, block in model.blocks.items():
        device, _, kind = name.rpartition(".")
        sigma_s = float(block.sigma[0])
        if kind != "time_offset" or not sigma_s > 0.0:
            continue
        offset_s = float(mean[model.slices[name]][0])
        if abs(offset_s) > CLOCK_SIGMAS * sigma_s:
            group, dot, id_ = device.partition(".")
            parameter = f"{groups.get(group, group)}{dot}{id_}.time_offset_sigma_s"
            sigmas = abs(offset_s) / sigma_s
            texts.append(f"{device} clock off by {1e3 * offset_s:.3g} ms, {sigmas:.0f} sigma of {parameter}")
    return texts


def _diagnosis(table: InnovationTable) -> InnovationDiagnosis:
    """Return the diagnosis of a source from its innovations."""
    count = len(table)
    if count < LEAST_COUNT:
        return InnovationDiagnosis(DiagnosisKind.UNKNOWN, f"too few measurements: {count} of {LEAST_COUNT}", count)
    parts, axes = PartStatistics(table), axis_statistics(table)
    kind, text = _kind_and_text(table, parts, axes)
    return InnovationDiagnosis(
        kind=kind,
        text=f"{text}; {count} measurements",
        count=count,
        nis=parts.nis,
        nis_band=mean_nees_band(parts.components, 1, 1.0 - FALSE_DIAGNOSIS_PROBABILITY) if parts.components else None,
        factor=parts.factor,
        outlier_share=parts.outlier_share,
        bias_sigma={axis.name: axis.bias_sigma for axis in axes},
        correlation={axis.name: axis.correlation for axis in axes},
    )


def _kind_and_text(
    table: InnovationTable, parts: PartStatistics, axes: Iterable[AxisStatistics]
) -> tuple[DiagnosisKind, str]:
    """Return kind and text of the most important result.

    A bias comes first, because it affects the sigma test; a wrong sigma affects the number of outliers.
    """
    biased = max((axis for axis in axes if axis.is_biased), key=lambda axis: abs(axis.bias_sigma), default=None)
    if biased is not None:
        return DiagnosisKind.BIASED, biased.bias_text(table.on_axis(biased.name)[:, 1])
    if parts.is_optimistic:
        return DiagnosisKind.OPTIMISTIC, f"sigma optimistic by {parts.factor:.1f}: the noise is understated"
    if parts.is_misidentified:
        others = ", the others are as stated" if math.isfinite(parts.factor) else ""
        return DiagnosisKind.MISIDENTIFIED, f"misidentified: {100.0 * parts.outlier_share:.0f} % are outliers{others}"
    if parts.is_conservative:
        times = f"{1.0 / parts.factor:.1f}" if parts.factor > _MIN_FACTOR else f"more than {1.0 / _MIN_FACTOR:.0f}"
        return DiagnosisKind.CONSERVATIVE, f"sigma conservative by {times}: the noise is overstated"
    correlated = [axis for axis in axes if axis.is_correlated]
    if correlated:
        return DiagnosisKind.CORRELATED, max(correlated, key=lambda axis: abs(axis.correlation)).correlation_text
    if math.isnan(parts.factor):
        return DiagnosisKind.UNKNOWN, "sigma not assessed: the prediction is less certain than the measurements"
    return DiagnosisKind.AS_STATED, f"as stated, to a factor of {parts.factor:.2f} in its sigma"

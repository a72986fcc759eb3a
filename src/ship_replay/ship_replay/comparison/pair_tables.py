"""Tables of two recordings side by side: value of A, value of B and their difference.

Configurations are compared line by line as written, and parameter by parameter.
"""

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.stamps import NS_PER_S
from ship_estimation.parameters.schema import flatten
from ship_geometry.rotations import ARCSEC
from ship_replay.comparison.pair import OutputDifference, Pair
from ship_replay.evaluation.evaluate import named_config
from ship_replay.evaluation.statistics import AttitudeErrors
from ship_replay.offline.replay import ADAPTERS
from ship_replay.report.consistency import SigmaFit, consistency
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.tables import (
    estimate_change,
    estimate_texts,
    number,
    rejection_cells,
    rejections_by_key,
    shown_scale,
    utc,
)
from ship_watch.history.history import BudgetPoint, ParameterEstimate
from ship_watch.orientations import channel_name

_NODES = {kind.node_name: kind.config_type for kind in ADAPTERS}

SAME_TIME_NS = 2 * NS_PER_S
"""Maximum time difference of events that count as the same, ns."""

DIFFERENT_SIGMAS = 3.0
"""Difference of two estimates above which the difference is marked, in units of the root sum square of their sigmas."""

_DIGITS = re.compile(r"[\d.]+")
_PART = TypeVar("_PART")


@dataclass(frozen=True)
class ParameterDifference:
    """A parameter that differs between A and B; the value of a run without this device is empty.

    For a node of one run only, the name is empty, and the values are "configured" and "not configured".
    """

    node: str
    name: str
    a: str
    b: str


def text_differences(a: RecordedHistory, b: RecordedHistory) -> dict[str, list[str]]:
    """Return name of an attached configuration → lines of its unified diff from A to B; no lines if both are equal."""
    texts_a, texts_b = a.attached_texts, b.attached_texts
    return {
        name: list(
            difflib.unified_diff(
                texts_a.get(name, "").splitlines(), texts_b.get(name, "").splitlines(),
                f"A {name}" if name in texts_a else "A: not attached",
                f"B {name}" if name in texts_b else "B: not attached", lineterm="",
            )
        )
        for name in sorted(texts_a.keys() | texts_b.keys())
    }


def parameter_differences(a: RecordedHistory, b: RecordedHistory) -> list[ParameterDifference]:
    """Return the parameters that differ, defaults included.

    A parameter does not differ if one file sets it to its default and the other file omits it. A node that only one
    file configures is one row.

    Raises:
        BadInput: a suite file is not valid in this version; the evaluation of the bags checks this first.
    """
    found = []
    for node, kind in _NODES.items():
        values_a, values_b = _parameters(a, node, kind), _parameters(b, node, kind)
        if values_a is None or values_b is None:
            if values_a is not values_b:
                texts = ["not configured" if values is None else "configured" for values in (values_a, values_b)]
                found.append(ParameterDifference(node, "", *texts))
            continue
        for name in dict.fromkeys([*values_a, *values_b]):
            value_a, value_b = values_a.get(name), values_b.get(name)
            if value_a != value_b:
                found.append(ParameterDifference(node, name, _text(value_a), _text(value_b)))
    return found


def _parameters(recording: RecordedHistory, node: str, kind: type) -> dict[str, Any] | None:
    if SUITE_ATTACHMENT not in recording.attachments:
        return None
    config = named_config(recording.attachments[SUITE_ATTACHMENT].decode(errors="replace"), kind, node)
    return None if config is None else flatten(config)


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, (list, tuple)):
        return ", ".join(_text(entry) for entry in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class ErrorRow:
    """Errors of one channel of a source in A and B, arcsec; NaN for a run without these errors.

    Attributes:
        label: name of the source.
        channel: name of the channel in its orientation.
        rms: root mean squares of the errors in A and in B.
        size_95: 95th percentiles of the absolute errors in A and in B.
        samples: numbers of errors in A and in B.
        at_equal_stamps: True if only errors at common stamps are included.
    """

    label: str
    channel: str
    rms: tuple[float, float]
    size_95: tuple[float, float]
    samples: tuple[int, int]
    at_equal_stamps: bool

    @property
    def name(self) -> str:
        """Name of the channel for people."""
        return channel_name(self.channel)

    @property
    def ratio(self) -> float:
        """RMS of B over RMS of A; NaN if the RMS of A is zero or NaN."""
        return self.rms[1] / self.rms[0] if self.rms[0] > 0.0 else math.nan


def error_rows(pair: Pair) -> list[ErrorRow]:
    """Return a row for each source and channel with errors against the truth.

    If a source has errors at stamps common to both runs, only these errors count.
    """
    sides = [{series.label: series for series in report_data.evaluation.errors} for report_data in (pair.a, pair.b)]
    rows = []
    for label in dict.fromkeys([*sides[0], *sides[1]]):
        series = [side.get(label) for side in sides]
        common = _common_stamps(series)
        parts = [one if one is None or common is None else one.select(np.isin(one.time_ns, common), label)
                 for one in series]
        for channel, name in enumerate(next(one for one in parts if one is not None).channels):
            sizes = [np.empty(0) if one is None else np.abs(one.error_arcsec[:, channel]) for one in parts]
            rms = [float(np.sqrt(np.mean(size**2))) if len(size) else math.nan for size in sizes]
            size_95 = [float(np.percentile(size, 95.0)) if len(size) else math.nan for size in sizes]
            rows.append(
                ErrorRow(label, name, (rms[0], rms[1]), (size_95[0], size_95[1]),
                         (len(sizes[0]), len(sizes[1])), common is not None)
            )
    return rows


def difference_rows(differences: Iterable[OutputDifference]) -> list[dict[str, str]]:
    """Return a row for each channel of the outputs: RMS of B minus A, and the largest difference with its time."""
    rows = []
    for found in differences:
        for channel, name in enumerate(found.orientation.channels):
            largest, stamp_ns = found.largest(channel)
            sigma_a, sigma_b = found.sigmas_arcsec(channel)
            rms = found.rms_arcsec(channel)
            equal = found.channels_equal[channel]
            rows.append({
                "topic": found.orientation.topic if channel == 0 else "",
                "channel": channel_name(name),
                "rms": "equal to the last bit" if equal else number(rms),
                "largest": "" if equal else number(largest),
                "when": "" if equal else utc(stamp_ns),
                "over_sigma": "" if equal or not sigma_a > 0.0 else number(rms / sigma_a),
                "sigma_a": number(sigma_a),
                "sigma_b": number(sigma_b),
                "stamps": f"{len(found.time_ns)}" if channel == 0 else "",
            })
    return rows


def budget_tables(pair: Pair) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return topic, columns and rows of each error budget.

    A row has a source of error, and for each angle the square roots of its mean variances in A and in B, arcsec. The
    largest source is first.
    """
    tables = []
    for topic in sorted({topic for recording in pair.recordings for topic in recording.budgets}):
        a, b = (_mean_variances(night.budgets.get(topic, [])) for night in pair.recordings)
        angles = list(dict.fromkeys([*a, *b]))
        weights: dict[str, float] = {}
        for by_source in (*a.values(), *b.values()):
            for name, variance in by_source.items():
                weights[name] = max(variance, weights.get(name, 0.0))
        names = sorted((name for name in weights if weights[name] > 0.0), key=lambda name: -weights[name])
        columns = ["source of error, σ [″]", *(text for angle in angles for text in (f">{angle} A", ">B"))]
        rows = [
            [name, *(_sigma_text(run.get(angle, {}).get(name)) for angle in angles for run in (a, b))] for name in names
        ]
        if rows:
            tables.append((topic, columns, rows))
    return tables


def consistency_rows(pair: Pair) -> list[dict[str, str]]:
    """Return a row for each NEES test, then for each NIS test; `differs` is not empty if more than numbers differ."""
    a, b = (
        {(fit.kind, fit.name): fit for fit in consistency(report_data.evaluation)} for report_data in (pair.a, pair.b)
    )
    return [_consistency_row(a.get(key), b.get(key)) for key in sorted({**a, **b}, key=lambda key: key[0])]


def alignment_tables(pair: Pair) -> list[tuple[str, list[dict[str, str]]]]:
    """Return topic, and a row for each parameter: the last estimates of A and B with their σ, and their difference."""
    a, b = pair.recordings
    tables = []
    for topic in sorted(a.last_estimates.keys() | b.last_estimates.keys()):
        shown_a, shown_b = (
            {shown.name: shown for shown in recording.last_estimates.get(topic, ())} for recording in (a, b)
        )
        either = {**shown_b, **shown_a}
        names = dict.fromkeys([*shown_a, *shown_b])
        rows = [_alignment_row(either[name], shown_a.get(name), shown_b.get(name)) for name in names]
        tables.append((topic, rows))
    return tables


def events_of_one(pair: Pair) -> tuple[list[dict[str, str]], int]:
    """Return the events of one run only, in order of time, and the number of events that both runs have.

    Two events are the same if kind and text agree except for numbers, and the times differ by at most two seconds.
    """
    a, b = ([(event.utc_ns, (event.kind, _DIGITS.sub("#", event.text)), event) for event in recording.events]
            for recording in pair.recordings)
    alone, both = _without_counterpart(a, b)
    return [
        {"when": utc(time_ns), "side": side, "kind": event.kind, "text": event.text} for time_ns, side, event in alone
    ], both


def alerts_of_one(pair: Pair) -> tuple[list[dict[str, str]], int]:
    """Return the alert changes of one run only, in order of time, and the number of changes that both runs have."""
    a, b = (
        [
            (alert_record.utc_ns, (alert_record.alert.id, alert_record.what), alert_record)
            for alert_record in recording.alerts
        ]
        for recording in pair.recordings
    )
    alone, both = _without_counterpart(a, b)
    return [
        {"when": utc(time_ns), "side": side, "priority": alert_record.alert.priority.name, "id": alert_record.alert.id,
         "what": alert_record.what, "text": alert_record.alert.text}
        for time_ns, side, alert_record in alone
    ], both


def rejection_rows_of_both(pair: Pair) -> list[dict[str, str]]:
    """Return a row for each source, place and reason: counts in A and in B. Rejections come before notes."""
    a, b = (rejections_by_key(recording) for recording in pair.recordings)
    rows = []
    for key in sorted(a.keys() | b.keys()):
        of_a, of_b = (sum(one.count for one in of_run.get(key, ())) for of_run in (a, b))
        more = f"{of_b - of_a:+d}".replace("-", "−") if of_b != of_a else ""
        rows.append({**rejection_cells(key), "a": f"{of_a}", "b": f"{of_b}", "more": more})
    return rows


def _common_stamps(series: Sequence[AttitudeErrors | None]) -> np.ndarray | None:
    """Return the common stamps of two series; None if there are no common stamps."""
    a, b = series
    if a is None or b is None:
        return None
    common = np.intersect1d(a.time_ns, b.time_ns)
    return common if len(common) else None


def _mean_variances(points: Sequence[BudgetPoint]) -> dict[str, dict[str, float]]:
    """Return angle → source of error → mean variance, rad².

    A source that is missing or not finite at a time counts as zero at this time.
    """
    sums: dict[str, dict[str, float]] = {}
    known_points = [point for point in points if point.by_angle]
    for point in known_points:
        for angle, by_source in point.by_angle.items():
            totals = sums.setdefault(angle, {})
            for name, variance in by_source.items():
                totals[name] = totals.get(name, 0.0) + (variance if math.isfinite(variance) else 0.0)
    return {
        angle: {name: total / len(known_points) for name, total in totals.items()} for angle, totals in sums.items()
    }


def _sigma_text(variance: float | None) -> str:
    return "–" if variance is None else number(math.sqrt(max(variance, 0.0)) / ARCSEC)


def _consistency_row(a: SigmaFit | None, b: SigmaFit | None) -> dict[str, str]:
    known = [fit for fit in (a, b) if fit is not None]
    row = {"kind": known[0].kind, "name": known[0].name, "degrees": number(known[0].degrees)}
    for side, fit in (("a", a), ("b", b)):
        row[f"mean_{side}"] = "–" if fit is None else number(fit.mean)
        row[f"words_{side}"] = "no data" if fit is None else fit.words
    is_equal = len(known) == 2 and len({_DIGITS.sub("#", fit.words) for fit in known}) == 1
    return {**row, "differs": "" if is_equal else "differs"}


def _alignment_row(
    either: ParameterEstimate, a: ParameterEstimate | None, b: ParameterEstimate | None
) -> dict[str, str]:
    scale, unit = shown_scale(either)
    row = {"name": either.name, "unit": unit, "apart": "", "differs": "", "note": ""}
    for side, shown in (("a", a), ("b", b)):
        row[side], row[f"{side}_sigma"] = ("–", "") if shown is None else estimate_texts(shown, scale)
    if a is not None and b is not None:
        difference = estimate_change(a, b)
        sigma = math.hypot(a.sigma, b.sigma)
        if difference == 0.0:
            row["apart"] = "equal"
        elif sigma > 0.0:
            row["apart"] = f"{difference / sigma:+.2f} σ".replace("-", "−")
            row["differs"] = "differs" if abs(difference) > DIFFERENT_SIGMAS * sigma else ""
        unseen = [letter for letter, shown in (("A", a), ("B", b)) if not shown.is_observable]
        row["note"] = f"not observable in {' and '.join(unseen)}" if unseen else ""
    return row


def _without_counterpart(
    a: Sequence[tuple[int, object, _PART]], b: Sequence[tuple[int, object, _PART]]
) -> tuple[list[tuple[int, str, _PART]], int]:
    """Return the entries without a counterpart of the same key within two seconds, and the number of pairs."""
    waiting: dict[object, list[tuple[int, _PART]]] = {}
    for time_ns, key, part in b:
        waiting.setdefault(key, []).append((time_ns, part))
    unmatched: list[tuple[int, str, _PART]] = []
    both = 0
    for time_ns, key, part in a:
        candidates = waiting.get(key, [])
        near = min(candidates, key=lambda other: abs(other[0] - time_ns), default=None)
        if near is not None and abs(near[0] - time_ns) <= SAME_TIME_NS:
            candidates.remove(near)
            both += 1
        else:
            unmatched.append((time_ns, "A", part))
    unmatched += [(time_ns, "B", part) for candidates in waiting.values() for time_ns, part in candidates]
    return sorted(unmatched, key=lambda entry: entry[:2]), both

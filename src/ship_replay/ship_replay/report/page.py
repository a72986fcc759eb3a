"""The page: what an analyst reads at breakfast, in the order in which it is asked for."""

import importlib.metadata
import math
import platform
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import relative_topics
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.report.drawings import budget_svg, errors_svg, refusals_svg, status_svg
from ship_replay.report.night import Night, read_night
from ship_watch.history import ParameterShown
from ship_watch.limits import Limits
from ship_watch.orientations import ORIENTATIONS
from ship_watch.picture import ANGLES, Safety

SECTIONS = (
    ("verdict", "Verdict"),
    ("status", "Status over time"),
    ("errors", "Errors inside their σ"),
    ("budget", "Error budget over time"),
    ("consistency", "NIS and NEES"),
    ("alignment", "Alignment before and after"),
    ("alerts", "Alerts"),
    ("events", "Events"),
    ("refusals", "Refusals by reason and time"),
    ("inputs", "Inputs"),
    ("configuration", "Configuration"),
    ("provenance", "Versions and hash of the bag"),
)
"""Ids and titles of the sections, in their order."""

_VERSIONS = ("ship_replay", "ship_watch", "ship_attitude_star", "theodolite_calib", "numpy", "scipy", "matplotlib")
_NIS_BAND = 3.3
_TIMES_TOLD = 3


@dataclass(frozen=True)
class Told:
    """A recording and what it was worth: all that a page is made of."""

    night: Night
    evaluation: Evaluation


def read_told(
    path: Path, truth: Path | None = None, limits: Limits | None = None, namespace: str = ""
) -> Told:
    """Read a bag with outputs, and evaluate it.

    Raises:
        BadInput: a bag cannot be read or lacks what is expected of it.
    """
    if truth is not None:
        _check_truth(truth, namespace)
    # Each takes half of the time; neither needs the other. A new process of its own: a copy of this one would take its
    # threads' locks with it.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as beside:
        evaluated = beside.submit(evaluate, path, against=truth, namespace=namespace)
        night = read_night(path, limits, namespace)
        return Told(night, evaluated.result())


def page(told: Told) -> str:
    """The report of one recording as one HTML file that names no other; the same recording gives the same text."""
    night, evaluation = told.night, told.evaluation
    start_ns = night.start_utc_ns
    return render(
        "report.html.j2",
        sections=SECTIONS,
        night=night,
        title=night.path.name,
        date=_utc(start_ns, "%Y-%m-%d"),
        start=_utc(start_ns),
        end=_utc(start_ns + night.end_ns - night.start_ns),
        length=duration((night.end_ns - night.start_ns) / NS_PER_S),
        verdict=verdict(night),
        shares=shares(night),
        evaluation=evaluation,
        errors=[(series, series.statistics()) for series in evaluation.errors],
        consistency=consistency(evaluation),
        status=status_svg(night),
        drawn_errors=errors_svg(evaluation),
        budgets=[(topic, budget_svg(topic, points, start_ns)) for topic, points in sorted(night.budgets.items())],
        alignment=[(topic, before_after(night.before[topic], night.after[topic])) for topic in sorted(night.after)],
        refusals=refusal_rows(night),
        refusal_drawing=refusals_svg(night),
        suite={name: data.decode(errors="replace") for name, data in sorted(night.attachments.items())
               if name.endswith((".yaml", ".yml", ".json"))},
        versions=versions(),
        problems=sorted({*night.problems, *evaluation.problems}),
    )


def render(template: str, **values: Any) -> str:
    """Fill a template of this package."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ship_replay", "report"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )
    environment.filters |= {"utc": _utc, "number": number, "percent": lambda share: f"{100.0 * share:.0f} %"}
    return environment.get_template(template).render(**values)


def verdict(night: Night) -> list[str]:
    """In sentences: how long each word stood per angle, and what failed when."""
    sentences = []
    for name in ANGLES:
        seconds = night.seconds(name)
        if total := sum(seconds.values()):
            parts = [
                f"{word.name} {duration(seconds[word])} ({100.0 * seconds[word] / total:.1f} %)"
                for word in Safety if seconds[word]
            ]
            sentences.append(f"{name.capitalize()}: {', '.join(parts)}.")
    if not sentences:
        return ["No angle was ever told."]
    found = outages(night)
    for source in dict.fromkeys(outage.source for outage in found):
        times = [outage.text for outage in found if outage.source == source]
        more = f" and {len(times) - _TIMES_TOLD} times more" if len(times) > _TIMES_TOLD else ""
        sentences.append(f"{source} was out from {', '.join(times[:_TIMES_TOLD])}{more}.")
    return sentences if found else [*sentences, "No source was out."]


@dataclass(frozen=True)
class Outage:
    """A source that was out: from when to when, UTC in ns, 0 where it never came back; and why, as first told."""

    source: str
    from_ns: int
    to_ns: int
    why: str

    @property
    def text(self) -> str:
        """For a sentence: "12:00:05 to 12:00:20 (silent)"."""
        return f"{_utc(self.from_ns)} to {_utc(self.to_ns) if self.to_ns else 'the end'} ({self.why})"


def outages(night: Night) -> list[Outage]:
    """Which source was out when: one for each time, though its reason may have been told anew meanwhile."""
    found: list[Outage] = []
    last: dict[str, int] = {}
    for event in night.events:
        if event.kind != "source":
            continue
        number, is_out = last.get(event.subject), f"{event.subject} OUT" in event.text
        if is_out and number is None:
            last[event.subject] = len(found)
            found.append(Outage(event.subject, event.utc_ns, 0, event.text.partition(", ")[2]))
        elif not is_out and number is not None:
            found[number] = replace(found[number], to_ns=event.utc_ns)
            del last[event.subject]
    return found


def shares(night: Night) -> list[tuple[str, dict[str, float], Counter[Safety]]]:
    """Angle, share of the time of each word, seconds of each word; only of angles that were told."""
    rows = []
    for name in ANGLES:
        seconds = night.seconds(name)
        if total := sum(seconds.values()):
            rows.append((name, {word.name: seconds[word] / total for word in Safety}, seconds))
    return rows


def consistency(evaluation: Evaluation) -> list[dict[str, str]]:
    """A row for each NEES and NIS: mean, what is expected, and in words whether σ fits.

    The numbers are those of ``evaluate``. Errors against the truth hang together over minutes, so that of NEES only
    the ratio is told and no band; of NIS the share of minutes in their 99.9 % band, as ``evaluate`` counts them.
    """
    rows = []
    for series in evaluation.errors:
        mean = series.statistics()["nees_mean"]
        rows.append(_consistency_row("NEES", series.label, mean, 3.0, len(series.time_ns), None))
    for source, part in evaluation.innovations.items():
        values = part.statistics()
        if "nis_mean" in values:
            rows.append(
                _consistency_row(
                    "NIS", source, values["nis_mean"], values["nis_degrees"], len(part.compared),
                    values.get("nis_windows_in_band"),
                )
            )
    return rows


def _consistency_row(
    kind: str, name: str, mean: float, degrees: float, count: int, in_band: float | None
) -> dict[str, str]:
    ratio = math.sqrt(mean / degrees) if mean >= 0.0 and degrees > 0.0 else math.nan
    band = _NIS_BAND / math.sqrt(2.0 * degrees * count) if degrees > 0.0 and count else math.inf
    if not math.isfinite(ratio) or not band <= 0.5:
        words = "too few to tell"
    elif abs(ratio - 1.0) <= (band if kind == "NIS" else 0.25):
        words = f"σ as stated ({ratio:.2f})"
    else:
        words = f"σ optimistic by {ratio:.2f}" if ratio > 1.0 else f"σ pessimistic by {1.0 / ratio:.2f}"
    return {
        "kind": kind, "name": name, "mean": number(mean), "degrees": number(degrees), "count": f"{count}",
        "in_band": "" if in_band is None else f"{100.0 * in_band:.0f} %", "words": words,
    }


def before_after(before: Sequence[ParameterShown], after: Sequence[ParameterShown]) -> list[dict[str, str]]:
    """A row for each parameter: first and last estimate with their σ, and the change in sigmas of the first."""
    first = {shown.name: shown for shown in before}
    rows = []
    for shown in after:
        start = first.get(shown.name, shown)
        scale, unit = _scale(shown)
        change = float(wrap_pi(shown.value - start.value)) if shown.unit == "rad" else shown.value - start.value
        rows.append({
            "name": shown.name,
            "unit": unit,
            "before": _placed(start.value / scale, start.sigma / scale),
            "before_sigma": number(start.sigma / scale),
            "after": _placed(shown.value / scale, shown.sigma / scale),
            "after_sigma": number(shown.sigma / scale),
            "change": f"{change / start.sigma:+.1f} σ" if start.sigma > 0.0 else "",
            "note": "" if shown.is_observable else "not observable",
        })
    return rows


def refusal_rows(night: Night) -> list[dict[str, str]]:
    """A row for each source, place and reason: how many, first and last time; refusals before notes."""
    counts: Counter[tuple[bool, str, str, str]] = Counter()
    times: dict[tuple[bool, str, str, str], tuple[int, int]] = {}
    for refusal in night.refusals:
        key = refusal.is_note, refusal.source, refusal.by, refusal.reason
        first, last = times.get(key, (refusal.utc_ns, refusal.utc_ns))
        counts[key] += refusal.count
        times[key] = min(first, refusal.utc_ns), max(last, refusal.utc_ns)
    return [
        {
            "source": key[1], "by": key[2], "reason": key[3] + (" (note: used)" if key[0] else ""),
            "count": f"{counts[key]}", "first": _utc(times[key][0]), "last": _utc(times[key][1]),
        }
        for key in sorted(counts)
    ]


def versions() -> list[tuple[str, str]]:
    """Of the suite and of what computes for it, at the time of the report."""
    return [("python", platform.python_version()), *((name, _version(name)) for name in _VERSIONS)]


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name.replace("_", "-"))
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def duration(seconds: float) -> str:
    """A length of time for people: "1 h 02 min", "4 min 05 s", "12 s"."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def number(value: float) -> str:
    """A value with three digits, a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}".replace("-", "−")


def _placed(value: float, sigma: float) -> str:
    """A value with the places that its sigma makes worth telling."""
    if not math.isfinite(value):
        return "–"
    places = 2 if not sigma > 0.0 else int(np.clip(1 - math.floor(math.log10(sigma)), 0, 6))
    return f"{value:.{places}f}".replace("-", "−")


def _scale(shown: ParameterShown) -> tuple[float, str]:
    if shown.unit == "rad":
        large = abs(float(wrap_pi(shown.value))) > math.radians(1.0)
        return (math.pi / 180.0, "deg") if large else (ARCSEC, "arcsec")
    return {"s": (1e-3, "ms"), "m": (1e-3, "mm")}.get(shown.unit, (1.0, shown.unit))


def _utc(time_ns: int, form: str = "%H:%M:%S") -> str:
    return datetime.fromtimestamp(time_ns // NS_PER_S, tz=timezone.utc).strftime(form)


def _check_truth(path: Path, namespace: str) -> None:
    expected = [orientation.truth_topic for orientation in ORIENTATIONS]
    with read_bag(path) as bag:
        if not any(topic in relative_topics(bag.topics, namespace) for topic in expected):
            found = ", ".join(sorted(bag.topics)) or "none"
            raise BadInput(f"no truth: expected topic {' or '.join(expected)}, found {found}", file=path)

"""Texts and lengths of the page's first screen, from the state of a suite.

The page's script only inserts these texts and lengths. Texts from the network stay plain texts and are never markup.
"""

from collections.abc import Iterator
from typing import Any

from ship_geometry.rotations import ARCSEC
from ship_watch import value_texts
from ship_watch.history.history import History, SafetyPoint
from ship_watch.safety.safety import OVER_THE_LIMIT
from ship_watch.suite_state import (
    ANGLES,
    CAUSE_NODE,
    AlertEntry,
    AngleState,
    Presence,
    Safety,
    SourceDetails,
    SuiteState,
)

RIBBON_S = 600
"""Length of the ribbons, s."""

_THEODOLITE_ANGLES = ("azimuth", "elevation")
_TICK_S = 120
_NO_ALERT = {"icon": "", "state": "", "text": "No alerts", "sub": "", "advice": "", "unack": 0, "all": []}
_MAX_BANNERS = 3  # with more banners, the list of sources would have no room
_NS_PER_S = 1_000_000_000
# Alert.state of ship_msgs: icon and text.
_ALERT_STATES = {
    1: ("unack", "not acknowledged"),
    2: ("unack", "silenced, not acknowledged"),
    3: ("ack", "acknowledged"),
    4: ("rectified", "rectified, not acknowledged"),
}


def first_screen(
    suite_state: SuiteState, history: History, label: str, location: str, local: str = ""
) -> dict[str, Any]:
    """Return the content of the first screen, ready for JSON.

    Args:
        suite_state: state of the suite.
        history: history with the safety of the last ten minutes.
        label: label of the source of the state, for example LIVE or SIMULATED.
        location: namespace and domain, or bag, for a page that waits for data.
        local: local time, displayed under UTC; empty if only UTC is displayed.
    """
    has_lights = any(angle.name in _THEODOLITE_ANGLES for angle in suite_state.angles)
    waiting = f"waiting for {suite_state.waiting_for}" if suite_state.waiting_for else ""
    return {
        "label": label,
        "utc": value_texts.utc_clock(suite_state.utc_ns),
        "local": local,
        "is_stale": suite_state.is_old,
        "overall": {"safety": suite_state.overall.safety.name, "text": suite_state.overall.text},
        "waiting": waiting,
        "place": location if waiting else "",
        "alert": _alert_line(suite_state.alerts),
        "angles": {angle.name: _tile(angle) for angle in suite_state.angles},
        "ages": [
            [name, value_texts.age_text(age_s), _finite(age_s)]
            for name, age_s in suite_state.ages_s.items()
            if name != "lights" or has_lights
        ],
        "foot": _ages_footer(suite_state),
        "sources": _sources(suite_state.sources, is_known=not suite_state.is_old),
        "ribbons": _ribbons(history, suite_state),
    }


def _tile(angle: AngleState) -> dict[str, Any]:
    reading = value_texts.angle_reading(angle)
    limit = value_texts.limit_text(angle.limit)
    ratio = angle.accuracy_95 / (2.0 * angle.limit) if angle.limit > 0.0 else float("nan")
    reason = angle.reason or f"limit {limit}"
    if angle.reason == OVER_THE_LIMIT:
        reason += f", {limit}"
    return {
        "number": reading.number,
        "sense": reading.sense or ("theodolite" if angle.name in _THEODOLITE_ANGLES else ""),
        "accuracy": value_texts.accuracy_text(angle),
        # The limit is at the middle of the bar. Without a number there is no bar.
        "bar": min(ratio, 1.0) if ratio >= 0.0 and not angle.is_old else None,
        "reason": reason,
        "is_reason": bool(angle.reason),
        "is_old": angle.is_old,
        "age_s": _finite(angle.age_s),
        "safety": angle.safety.name,
        "tip": _tip(angle),
    }


def _tip(angle: AngleState) -> list[str]:
    """Return lines with all digits, sigma, protection level and stamp."""
    degrees = angle.value / (3600.0 * ARCSEC)
    lines = [
        f"{degrees:.6f}°".replace("-", "−"),
        f"σ {angle.accuracy_95 / 1.96 / ARCSEC:.3f}″",
        f"{value_texts.date_and_clock(angle.stamp_ns)} UTC",
        f"{angle.safety.name} since {value_texts.utc_clock(angle.since_ns)}",
    ]
    if angle.protection_level == angle.protection_level:
        lines.insert(2, f"protection level {value_texts.small_angle(angle.protection_level)}")
    return lines


def _ages_footer(suite_state: SuiteState) -> str:
    """Return the text below the ages: method of the pointing and horizon of the tilt."""
    by = suite_state.pointing_by
    parts = [by if not by or by.startswith("no ") else f"by {by}"]
    parts.append(f"horizon: {suite_state.horizon}" if suite_state.horizon else "")
    return " · ".join(filter(None, parts))


def _alert_line(alerts: tuple[AlertEntry, ...] | None) -> dict[str, Any]:
    if alerts is None:
        return _NO_ALERT | {"text": "No alert node", "sub": "alerts are not evaluated"}
    if not alerts:
        return _NO_ALERT | {"icon": "ok"}
    entries = [_alert(alert) for alert in alerts]
    unack = sum(not alert.is_acknowledged for alert in alerts)
    return {**entries[0], "unack": unack, "all": entries}


def _alert(alert: AlertEntry) -> dict[str, str]:
    state, text = _ALERT_STATES.get(alert.state, ("", ""))
    alert_text = alert.text if alert.source in alert.text else f"{alert.source} {alert.text}"
    return {
        "icon": alert.priority.name.lower(),
        "state": state,
        "text": f"{alert.priority.name} · {alert_text}",
        "sub": f"{value_texts.utc_clock(alert.raised_ns)} · {text}",
        "advice": alert.advice,
    }


def _sources(sources: tuple[SourceDetails, ...], *, is_known: bool) -> dict[str, Any]:
    """Return the banners of sources that are OUT, and all sources; sources not configured are last and not counted.

    A source that is OUT due to another source that is OUT, or due to an overloaded node, has no banner of its own: the
    cause has a banner. Such a source is marked in the list.
    """
    used = [source for source in sources if source.presence is not Presence.OFF]
    out = [source for source in used if source.presence is Presence.OUT]
    names = {source.name for source in sources}
    roots = [source for source in out if not source.because_of or source.because_of == CAUSE_NODE]
    # Sources that are still OUT although the source that caused their outage is no longer OUT.
    roots += [source for source in out if source.because_of in names - {each.name for each in out}]
    below = [source for source in out if source not in roots]
    nodes = {source.because_of: source.reason for source in below if source.because_of not in names}
    banners = [*((source.name, f"{source.name} OUT") for source in roots), *nodes.items()]
    more = banners[_MAX_BANNERS - 1 :] if len(banners) > _MAX_BANNERS else []
    count = f"{len(used) - len(out)} of {len(used)} in" if used else ""
    return {
        "head": count if is_known or not count else f"last: {count}",
        "is_known": is_known,
        "out": [*banners[: _MAX_BANNERS - 1], (more[0][0], f"{len(more)} more OUT")] if more else banners,
        "why": _reason_lines(roots[0]) if len(banners) == len(roots) == 1 else [],
        "rows": [
            _source_row(source, is_because=source in below, is_alone=len(banners) == 1)
            for source in sorted(sources, key=lambda each: each.presence is Presence.OFF)
        ],
    }


def _reason_lines(source: SourceDetails) -> list[str]:
    """Return one or two lines about the only source that is OUT due to its own fault."""
    since = f"since {value_texts.utc_clock(source.out_since_ns)}"
    rejected = f"{source.rejected_in_a_row} rejected" if source.rejected_in_a_row else ""
    if not source.disagreement:
        return [f"{source.reason} {since}"]
    return [source.disagreement, " · ".join(filter(None, (since, rejected)))]


def _source_row(source: SourceDetails, *, is_because: bool, is_alone: bool) -> dict[str, Any]:
    consistency = source.nis_consistency.text if source.nis_consistency is not None else ""
    shift = (
        f"mounting shifted by {value_texts.small_angle(source.mounting_shift)}" if source.mounting_shift > 0.0 else ""
    )
    sub = source.disagreement or shift or consistency
    if source.presence is Presence.OUT:
        # With several banners, details are in the list; with one banner, they are below the banner.
        since = (
            f"{source.reason} since {value_texts.utc_clock(source.out_since_ns)}"
            if source.out_since_ns
            else source.reason
        )
        sub = source.reason if is_alone or is_because else " · ".join(filter(None, (source.disagreement, since)))
    is_used = source.presence is not Presence.OFF
    return {
        "name": source.name,
        "presence": source.presence.value,
        "sub": sub,
        "age": value_texts.age_text(source.age_s) if is_used else "",
        "age_s": _finite(source.age_s) if is_used else None,
        "is_because": is_because,
    }


def _finite(seconds: float) -> float | None:
    """Return an age for JSON, s; None if it is infinite or unknown."""
    return seconds if seconds < float("inf") else None


def _ribbons(history: History, suite_state: SuiteState) -> dict[str, Any]:
    """Return the ticks, the intervals of equal safety of each angle, and a mark for each source that is OUT.

    Times are fractions of the last ten minutes: 0 start, 1 now.
    """
    end_s = suite_state.utc_ns // _NS_PER_S
    start_s = end_s - RIBBON_S
    points = [point for point in history.safety if point.utc_ns // _NS_PER_S >= start_s]
    ticks = range(-(-start_s // _TICK_S) * _TICK_S, end_s + 1, _TICK_S) if end_s else ()
    angle_names = {angle.name for angle in suite_state.angles}
    return {
        "ticks": [[(at_s - start_s) / RIBBON_S, value_texts.utc_clock(at_s * _NS_PER_S)[:5]] for at_s in ticks],
        "rows": [
            [
                [(first_s - start_s) / RIBBON_S, (last_s + 1 - start_s) / RIBBON_S, safety.name]
                for first_s, last_s, safety in _intervals(points, name)
            ]
            for name in ANGLES
            if name in angle_names
        ],
        "marks": [
            (source.out_since_ns / _NS_PER_S - start_s) / RIBBON_S
            for source in suite_state.sources
            if source.presence is Presence.OUT and source.out_since_ns // _NS_PER_S >= start_s
        ],
    }


def _intervals(points: list[SafetyPoint], name: str) -> Iterator[tuple[int, int, Safety]]:
    """Yield first second, last second and safety of each interval; a second without data ends an interval."""
    first_s = last_s = 0
    safety: Safety | None = None
    for point in points:
        now_s, now = point.utc_ns // _NS_PER_S, point.safety.get(name)
        if safety is not None and (now is not safety or now_s > last_s + 1):
            yield first_s, last_s, safety
            safety = None
        if safety is None:
            first_s, safety = now_s, now
        last_s = now_s
    if safety is not None:
        yield first_s, last_s, safety

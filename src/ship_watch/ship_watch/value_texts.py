"""Values and faults as texts for people, the same on page, terminal, report and log.

Minus is "−" (U+2212). Minutes of arc are not used. Words replace signs where possible: "bow up", "port down".
"""

import math
import re
from datetime import datetime, timezone
from typing import NamedTuple
from zoneinfo import ZoneInfo

from ship_geometry.rotations import ARCSEC
from ship_watch.suite_state import AngleState

NO_VALUE = "—"
"""Text for a missing number."""

DASHES_AFTER_S = 60.0
"""Age from which an old value is replaced by dashes, s."""

_CHANGING_FIGURES = re.compile(r" for \d+ s\b|\b\d+ (?=rejected|accepted)|\b[\d.]+ s (?=behind)|, load \d+")
"""Figures of a reason that change while the situation stays the same."""

_RUN = re.compile(r"rejected in a row|accepted again")

_MEMBERS = re.compile(r"(.+): (?=no data$|never received$|rejected\b)")
"""Members of a source at the beginning of its reason, if the reason does not apply to the whole source."""

_FAULT_TEXTS = {
    "no data": "no data from {source}",
    "invalid": "no valid data from {source}",
    "rejected: late": "late data from {source}",
    "no stars": "no stars seen by {source}",
    "no lights": "no lights seen",
}
"""Reason why a source is OUT → text with the name of the source; any other reason is put after the name."""

_SENSES = {"pitch": ("bow up", "bow down"), "roll": ("port up", "port down")}


class Reading(NamedTuple):
    """Number of an angle with the degree sign, and the word for the sense of the angle or for its north reference."""

    number: str
    sense: str


def angle_reading(angle: AngleState) -> Reading:
    """Return an angle in degrees: 034.39° true, 0.1° bow down, 359.88°, +68.74°; a dash if unknown or too old."""
    if not math.isfinite(angle.value) or (angle.is_old and angle.age_s > DASHES_AFTER_S):
        return Reading(NO_VALUE, "true" if angle.name == "heading" else "")
    degrees = math.degrees(angle.value)
    if angle.name in _SENSES:
        tenths = round(abs(degrees), 1)
        up, down = _SENSES[angle.name]
        sense = "level" if tenths == 0.0 else up if degrees > 0.0 else down
        return Reading(f"{tenths:.1f}°", sense)
    if angle.name == "elevation":
        return Reading(f"{degrees:+06.2f}°".replace("-", "−"), "")
    return Reading(f"{round(degrees % 360.0, 2) % 360.0:06.2f}°", "true" if angle.name == "heading" else "")


def small_angle(value: float) -> str:
    """Return the size of a small angle: 4.2″, 120″, 1.3°; a dash if unknown.

    Args:
        value: the angle, rad.
    """
    if not math.isfinite(value):
        return NO_VALUE
    arcsec = abs(value) / ARCSEC
    if arcsec < 99.95:
        return f"{arcsec:.1f}″"
    return f"{arcsec:.0f}″" if arcsec < 3599.5 else f"{math.degrees(abs(value)):.1f}°"


def limit_text(value: float) -> str:
    """Return a limit as text: 5″, 2.5″; a dash if there is no limit. ``value`` is in rad."""
    return f"{abs(value) / ARCSEC:.6g}″" if math.isfinite(value) else NO_VALUE


def accuracy_text(angle: AngleState) -> str:
    """Return the 95 % accuracy of an angle, ±4.2″; for an old value its age, OLD 12 s."""
    if angle.is_old:
        return f"OLD {age_text(angle.age_s)}" if math.isfinite(angle.age_s) else NO_VALUE
    return f"±{small_angle(angle.accuracy_95)}" if math.isfinite(angle.accuracy_95) else NO_VALUE


def age_text(seconds: float) -> str:
    """Return a time span with one unit: 0.5 s, 12 s, 5 min, 3 h, 2 d; "never" if infinite, a dash if unknown."""
    if math.isnan(seconds):
        return NO_VALUE
    if math.isinf(seconds):
        return "never"
    if seconds < 9.95:
        return f"{max(seconds, 0.0):.1f} s"
    for size_s, unit in ((1, "s"), (60, "min"), (3600, "h")):
        if seconds < 99.5 * size_s:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds / 86400:.0f} d"


def without_changing_figures(text: str) -> str:
    """Return a text without changing figures: "rejected" for "81 rejected in a row" and "3 accepted again"."""
    return _RUN.sub("rejected", _CHANGING_FIGURES.sub("", text))


def fault_text(source: str, reason: str) -> str:
    """Return the fault of a source that is OUT, without changing figures.

    Examples: "no data from encoder", "ins rejected: stuck", "a (baselines) rejected: not fixed".

    Args:
        source: name of the source.
        reason: reason why the source is OUT, as in :class:`~ship_watch.suite_state.SourceState`.
    """
    reason = without_changing_figures(reason)
    if members := _MEMBERS.match(reason):
        source, reason = f"{members[1]} ({source})", reason[members.end() :]
    return _FAULT_TEXTS.get(reason, "{source} {reason}").format(source=source, reason=reason)


def utc_clock(utc_ns: int) -> str:
    """Return the time of day, UTC: 12:00:07; dashes for 0. ``utc_ns`` is POSIX time in ns."""
    return f"{datetime.fromtimestamp(utc_ns // 1_000_000_000, timezone.utc):%H:%M:%S}" if utc_ns > 0 else "--:--:--"


def local_clock(utc_ns: int, zone: ZoneInfo | None) -> str:
    """Return the local time of day with the name of its offset: 14:00:07 CEST; empty without a zone, dashes for 0.

    Args:
        utc_ns: POSIX time, ns.
        zone: time zone of the ship or of the watch officer.
    """
    if zone is None:
        return ""
    if utc_ns <= 0:
        return "--:--:--"
    local = datetime.fromtimestamp(utc_ns // 1_000_000_000, zone)
    name = f"{local:%Z}"
    return f"{local:%H:%M:%S} {name if name.isalpha() else f'UTC{name}'}"


def date_and_clock(utc_ns: int) -> str:
    """Return day and time, UTC, to the millisecond: 2026-05-01 12:00:07.250; dashes for 0."""
    if utc_ns <= 0:
        return "--"
    seconds, rest_ns = divmod(utc_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S}.{rest_ns // 1_000_000:03d}"

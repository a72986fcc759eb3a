"""Formatting of numbers and times in reports."""

import math
from datetime import datetime, timezone

import numpy as np

from ship_bags.stamps import NS_PER_S


def duration(seconds: float) -> str:
    """Return a duration for people: "1 h 02 min", "4 min 05 s", "12 s"."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def number(value: float) -> str:
    """Return a value with three significant digits, or from 1000 on in whole numbers; a dash if it is not finite."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return text.replace("-", "−")


def rounded_to_sigma(value: float, sigma: float) -> str:
    """Return a value with as many decimals as its sigma justifies."""
    if not math.isfinite(value):
        return "–"
    places = 2 if not sigma > 0.0 else int(np.clip(1 - math.floor(math.log10(sigma)), 0, 6))
    return f"{value:.{places}f}".replace("-", "−")


def utc(time_ns: int, form: str = "%H:%M:%S") -> str:
    """Return a POSIX time in ns as UTC in whole seconds, by default with hours, minutes and seconds."""
    return datetime.fromtimestamp(time_ns // NS_PER_S, tz=timezone.utc).strftime(form)

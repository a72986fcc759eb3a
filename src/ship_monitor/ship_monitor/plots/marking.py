"""Assignment of names to the marked source, for all panels.

States, alerts and events are named after their source. An error source of a budget is common to all instruments of a
kind: one noise of stars is the noise of all star sensors.
"""

import re

from ship_watch.suite_state import Event
from ship_watch.topics import source_of_name

MARK = "▶ "
"""Prefix of names that belong to the marked source."""

_BUDGET_PREFIXES = {
    "ins": ("ins_", "interpolation"),
    "star": ("star_", "installation"),
    "reference": ("reference_",),
    "lights": ("image",),
    "encoder": ("encoder",),
    "baselines": ("rtk", "drone_attitude", "lever_arms"),
    "ship_attitude": ("ship_attitude", "ship_noise"),
    "gnss": ("ship_position",),
    "weather": ("refraction",),
}
"""Kind of a source → prefixes of its sources of error in a budget. Other sources of error belong to the hull,
the theodolite or the Earth's orientation."""


def belongs_to_source(name: str, source: str) -> bool:
    """True if a state or an alert belongs to a source ("star.bow.azimuth" to "star.bow"); False for source ""."""
    return bool(source) and (name == source or name.startswith(f"{source}.") or source_of_name(name) == source)


def is_event_of_source(event: Event, source: str) -> bool:
    """True if an event concerns a source: if the source is its subject or a word of its text."""
    return belongs_to_source(event.subject, source) or (
        bool(source) and re.search(rf"(?<![\w.]){re.escape(source)}(?!\w|\.\w)", event.text) is not None
    )


def is_budget_part_of(part: str, source: str) -> bool:
    """True if ``part``, an error source of a budget, belongs to the kind of ``source``, a source of the suite."""
    return part.startswith(_BUDGET_PREFIXES.get(source.partition(".")[0], ())) if source else False


def with_mark(name: str, is_marked: bool) -> str:
    """Return a name, with the prefix :data:`MARK` if ``is_marked``."""
    return MARK + name if is_marked else name

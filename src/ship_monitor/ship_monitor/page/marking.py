"""What belongs to the source that somebody has marked: every panel asks it by the names that are told there.

States, alerts and events are called after their source. An error budget tells causes, and those of several instruments
of a kind together: the noise of stars is that of all star sensors.
"""

import re

from ship_watch.picture import Event
from ship_watch.topics import source_of_name

MARK = "▶ "
"""Stands before the name of what belongs to the marked source; its frame has the colour of the text."""

_CAUSES = {
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
"""First word of a source → how the parts of an error budget begin that it brings. What is left over is the hull's, the
theodolite's own, or of what is known of the Earth."""


def is_of(name: str, source: str) -> bool:
    """Whether a state or an alert is one of a source: "star.bow.azimuth" is one of "star.bow"; nothing is of ""."""
    return bool(source) and (name == source or name.startswith(f"{source}.") or source_of_name(name) == source)


def is_about(event: Event, source: str) -> bool:
    """Whether an event tells of a source: by its subject, or by the name as a word of its text."""
    return is_of(event.subject, source) or (
        bool(source) and re.search(rf"(?<![\w.]){re.escape(source)}(?!\w|\.\w)", event.text) is not None
    )


def is_error_of(part: str, source: str) -> bool:
    """Whether a part of an error budget is what a source brings into it."""
    return part.startswith(_CAUSES.get(source.partition(".")[0], ())) if source else False


def with_mark(name: str, is_marked: bool) -> str:
    """A name with the mark before it, or without."""
    return MARK + name if is_marked else name

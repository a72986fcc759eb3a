"""Monitored topics, the source of a topic or of a name in a message, and the limit of the number of stored names.

Names of topics are relative to the namespace of the suite, as in the reference of topics. The network can deliver any
number of names. The first names are kept, so that further names never displace a known source.
"""

import functools
import logging
import re
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

MAX_NAMES = 256
"""Maximum number of names of one kind; a large suite has some tens."""

MAX_NAME_LENGTH = 256
"""Maximum length of a name, characters."""

MESSAGES = "ship_msgs/msg/"

SOURCE_KINDS = ("ins", "star", "reference", "lights", "encoder", "baselines", "ship_attitude", "gnss", "weather")
"""Kinds of sources in the order of display. A kind is the name of a source, or the part of the name before the id."""

_SOURCES_OF_TOPICS = {
    "ins": "ins", "beacon": "baselines", "gnss": "gnss", "met": "weather", "theodolite/encoder": "encoder",
    "ship/attitude": "ship_attitude",
}  # fmt: skip
"""First word of a topic, or whole topic → its source."""

_SOURCES_OF_NAMES = {
    "ins": "ins", "lights": "lights", "light": "lights", "telescope": "lights", "encoder": "encoder",
    "ship": "ship_attitude", "ship_attitude": "ship_attitude", "baseline": "baselines", "drone": "baselines",
    "beacon": "baselines",
}  # fmt: skip
"""First word of a name in an innovation or a list of excluded sources → its source."""

_LINE_PERIOD_S = 600.0
_logged_s: dict[str, float] = {}


def has_room(names: Collection[Any], name: Any, kind: str, max_names: int = MAX_NAMES) -> bool:
    """True if a name is stored already or may be added; otherwise a warning is logged.

    The warning is logged at most once in ten minutes for each ``kind``.

    Args:
        names: stored names.
        name: a text, or a tuple of texts.
        kind: kind of the names, for the warning.
        max_names: maximum number of names.
    """
    if name in names:
        return True
    length = len(name) if isinstance(name, str) else sum(map(len, name))
    if len(names) < max_names and length <= MAX_NAME_LENGTH:
        return True
    now_s = time.monotonic()
    if now_s - _logged_s.get(kind, -_LINE_PERIOD_S) >= _LINE_PERIOD_S:
        _logged_s[kind] = now_s
        why = (
            f"limit of {len(names)} names reached"
            if len(names) >= max_names
            else f"name too long ({length} characters)"
        )
        logging.getLogger(__name__).warning(f"{kind} {str(name)[:60]!r} and others are not shown: {why}")
    return False


@dataclass(frozen=True)
class MonitoredTopic:
    """A monitored topic.

    Attributes:
        pattern: name of the topic; ``<id>`` stands for one word.
        type_name: type of the messages.
        keeps_every_message: True if each message is needed; otherwise the newest message a few times a second is
            enough.
    """

    pattern: str
    type_name: str
    keeps_every_message: bool

    def matches(self, topic: str) -> bool:
        """True if a topic's name matches the pattern."""
        return re.fullmatch(self.pattern.replace("<id>", "[^/]+"), topic) is not None


TOPICS = (
    MonitoredTopic("ship/attitude", MESSAGES + "ShipAttitude", False),
    MonitoredTopic("theodolite/pointing", MESSAGES + "OpticalAxisPointing", False),
    MonitoredTopic("ship/integrity", MESSAGES + "Integrity", True),
    MonitoredTopic("theodolite/integrity", MESSAGES + "Integrity", True),
    MonitoredTopic("ship/innovation", MESSAGES + "Innovation", True),
    MonitoredTopic("theodolite/innovation", MESSAGES + "Innovation", True),
    MonitoredTopic("star/innovation", MESSAGES + "Innovation", True),
    MonitoredTopic("input_health", MESSAGES + "InputHealth", True),
    MonitoredTopic("ship/alerts", MESSAGES + "AlertArray", True),
    MonitoredTopic("ship/error_budget", MESSAGES + "ErrorBudget", True),
    MonitoredTopic("theodolite/error_budget", MESSAGES + "ErrorBudget", True),
    MonitoredTopic("ship/error_arcsec", MESSAGES + "AttitudeErrorArcsec", True),
    MonitoredTopic("theodolite/error_arcsec", MESSAGES + "PointingErrorArcsec", True),
    MonitoredTopic("ship/alignment", MESSAGES + "AlignmentState", False),
    MonitoredTopic("theodolite/calibration", MESSAGES + "TheodoliteCalibration", False),
    MonitoredTopic("star/<id>/solution", MESSAGES + "StarHorizonAttitude", True),
    MonitoredTopic("star/<id>/horizon_attitude", MESSAGES + "StarHorizonAttitude", False),
    MonitoredTopic("star/<id>/observations", MESSAGES + "StarObservationArray", False),
    MonitoredTopic("theodolite/beacons", MESSAGES + "BeaconImage", True),
    MonitoredTopic("gnss/fix", "sensor_msgs/msg/NavSatFix", False),
    MonitoredTopic("truth/attitude", MESSAGES + "ShipAttitude", True),
    MonitoredTopic("truth/pointing", MESSAGES + "OpticalAxisPointing", True),
)
"""All monitored topics. They do not include inputs at a high rate, whose state ``input_health`` reports."""


def monitored_topic(topic: str, type_name: str | None = None) -> MonitoredTopic | None:
    """Return the entry of a topic; None if it is not monitored, or if its messages have another type."""
    for row in TOPICS:
        if row.matches(topic):
            return row if type_name in (None, row.type_name) else None
    return None


def source_of_topic(topic: str) -> str:
    """Return the source of an input topic; empty if the topic has no source."""
    first, _, rest = topic.partition("/")
    if first in ("star", "reference") and "/" in rest:
        name = rest.partition("/")[0]
        return "" if name == "joint" else f"{first}.{name}"
    if topic.startswith("theodolite/beacons"):
        return "lights"
    return _SOURCES_OF_TOPICS.get(topic, _SOURCES_OF_TOPICS.get(first, ""))


def source_of_name(name: str) -> str:
    """Return the source of a name in an innovation or a list of excluded sources; empty if there is none."""
    first, _, rest = name.partition(".")
    if first in ("star", "reference") and rest:
        return "" if rest == "joint" else name  # the joint solution of all sensors is not a source
    if "/" in name:
        return source_of_topic(name) if name != "ship/attitude" else ""  # a failed output is named by its topic
    return _SOURCES_OF_NAMES.get(first, "")


def reading_node(topic: str) -> str:
    """Return the name of the node that reads an input topic, or "a node that reads TOPIC"."""
    if topic.startswith(("theodolite/", "beacon/", "ship/")):
        return "optical_axis"
    if topic.startswith("reference/") or topic.endswith(("/solution", "/horizon_attitude", "/inertial_attitude")):
        return "ship_attitude"
    return f"a node that reads {topic}"


def source_member(name: str) -> str:
    """Return the member of a source in a name or topic: "a" of "baseline.a" and "beacon/a/imu"; empty if not named."""
    if "/" in name:
        words = name.split("/")
        if words[0] == "beacon" and len(words) > 2:
            return words[1]
        return words[1] if words[0] == "met" else ""
    first, _, rest = name.partition(".")
    return rest if first in ("baseline", "drone", "beacon", "light") else ""


@functools.lru_cache(256)
def display_order(source: str) -> tuple[int, str]:
    """Return the sort key of a source in the fixed order of all sources."""
    first = source.partition(".")[0]
    return (SOURCE_KINDS.index(first) if first in SOURCE_KINDS else len(SOURCE_KINDS), source)

"""Which topics are watched, and which source a topic, a refusal or a hypothesis speaks of.

Names of topics are relative to the namespace of the suite, as in the reference of topics.
"""

import functools
import re
from dataclasses import dataclass

MESSAGES = "ship_msgs/msg/"


@dataclass(frozen=True)
class WatchedTopic:
    """A topic that is watched.

    Attributes:
        pattern: its name; ``<id>`` stands for one word.
        type_name: its type.
        every: whether each message counts. Of the others the newest one, a few times a second, says all.
    """

    pattern: str
    type_name: str
    every: bool

    def fits(self, topic: str) -> bool:
        """Whether this is the topic."""
        return re.fullmatch(self.pattern.replace("<id>", "[^/]+"), topic) is not None


TOPICS = (
    WatchedTopic("ship/attitude", MESSAGES + "ShipAttitude", False),
    WatchedTopic("theodolite/pointing", MESSAGES + "OpticalAxisPointing", False),
    WatchedTopic("ship/integrity", MESSAGES + "Integrity", True),
    WatchedTopic("theodolite/integrity", MESSAGES + "Integrity", True),
    WatchedTopic("ship/innovation", MESSAGES + "Innovation", True),
    WatchedTopic("theodolite/innovation", MESSAGES + "Innovation", True),
    WatchedTopic("star/innovation", MESSAGES + "Innovation", True),
    WatchedTopic("input_health", MESSAGES + "InputHealth", True),
    WatchedTopic("ship/alerts", MESSAGES + "AlertArray", True),
    WatchedTopic("ship/error_budget", MESSAGES + "ErrorBudget", True),
    WatchedTopic("theodolite/error_budget", MESSAGES + "ErrorBudget", True),
    WatchedTopic("ship/error_arcsec", MESSAGES + "AttitudeErrorArcsec", True),
    WatchedTopic("theodolite/error_arcsec", MESSAGES + "PointingErrorArcsec", True),
    WatchedTopic("ship/alignment", MESSAGES + "AlignmentState", False),
    WatchedTopic("theodolite/calibration", MESSAGES + "TheodoliteCalibration", False),
    WatchedTopic("star/<id>/solution", MESSAGES + "StarHorizonAttitude", True),
    WatchedTopic("star/<id>/horizon_attitude", MESSAGES + "StarHorizonAttitude", False),
    WatchedTopic("star/<id>/observations", MESSAGES + "StarObservationArray", False),
    WatchedTopic("theodolite/beacons", MESSAGES + "BeaconImage", True),
    WatchedTopic("gnss/fix", "sensor_msgs/msg/NavSatFix", False),
    WatchedTopic("truth/attitude", MESSAGES + "ShipAttitude", True),
    WatchedTopic("truth/pointing", MESSAGES + "OpticalAxisPointing", True),
)
"""All that is watched. Inputs at a high rate are not: ``input_health`` tells how they do."""


def watched_topic(topic: str, type_name: str | None = None) -> WatchedTopic | None:
    """The row of a topic; None where it is not watched, or where its messages are of another type."""
    for row in TOPICS:
        if row.fits(topic):
            return row if type_name in (None, row.type_name) else None
    return None


def source_of_topic(topic: str) -> str:
    """The source that an input topic comes from; empty where it belongs to none."""
    first, _, rest = topic.partition("/")
    if first in ("star", "reference") and "/" in rest:
        name = rest.partition("/")[0]
        return "" if name == "joint" else f"{first}.{name}"
    if topic.startswith("theodolite/beacons"):
        return "lights"
    whole = {"ins": "ins", "beacon": "baselines", "gnss": "gnss", "met": "weather"}
    return whole.get(first, {"theodolite/encoder": "encoder", "ship/attitude": "ship_attitude"}.get(topic, ""))


def source_of_name(name: str) -> str:
    """The source that an innovation or a hypothesis calls by this name; empty where it is none."""
    first, _, rest = name.partition(".")
    if first in ("star", "reference") and rest:
        return "" if rest == "joint" else name  # the sensors together are no instrument
    if "/" in name:
        return source_of_topic(name) if name != "ship/attitude" else ""  # an output that failed bears its topic's name
    whole = {
        "ins": "ins",
        "lights": "lights",
        "light": "lights",
        "telescope": "lights",
        "encoder": "encoder",
        "ship": "ship_attitude",
        "ship_attitude": "ship_attitude",
        "baseline": "baselines",
        "drone": "baselines",
        "beacon": "baselines",
    }
    return whole.get(first, "")


def node_of(topic: str) -> str:
    """The node that reads an input topic, for people; several nodes may read some."""
    if topic.startswith(("theodolite/", "beacon/", "ship/")):
        return "optical_axis"
    if topic.startswith("reference/") or topic.endswith(("/solution", "/horizon_attitude", "/inertial_attitude")):
        return "ship_attitude"
    return f"a node that reads {topic}"


def member_of(name: str) -> str:
    """Which part of a source a name or a topic speaks of: "a" of "baseline.a" and "beacon/a/imu"; empty for all."""
    if "/" in name:
        words = name.split("/")
        if words[0] == "beacon" and len(words) > 2:
            return words[1]
        return words[1] if words[0] == "met" else ""
    first, _, rest = name.partition(".")
    return rest if first in ("baseline", "drone", "beacon", "light") else ""


_PLACES = ("ins", "star", "reference", "lights", "encoder", "baselines", "ship_attitude", "gnss", "weather")


@functools.lru_cache(256)
def place_of(source: str) -> tuple[int, str]:
    """Where a source stands in the fixed order of all."""
    first = source.partition(".")[0]
    return (_PLACES.index(first) if first in _PLACES else len(_PLACES), source)

"""State and alerts of a suite as messages, which the node ``alerts`` publishes and which page and terminal display.

:func:`suite_state_fields` converts a state to the fields of a SuiteState message. :func:`published_state` and
:func:`alerts_from_message` read received messages.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, NamedTuple

from ship_bags.stamps import ns_from_stamp
from ship_watch.suite_state import (
    AlertEntry,
    AngleState,
    NisConsistency,
    Presence,
    Priority,
    Safety,
    SourceDetails,
    SuiteState,
)
from ship_watch.topics import MAX_NAME_LENGTH, MAX_NAMES

STATE_TOPIC = "ship/suite_state"
STATE_TYPE = "ship_msgs/msg/SuiteState"

PERIOD_NS = 500_000_000
"""Time between two messages while nothing changes, ns."""

MAX_AGE_NS = 4 * PERIOD_NS
"""Maximum age of a displayed state, ns. If the last state is older, the node or the network has failed."""

_PRESENCES = tuple(Presence)
_PRIORITIES = {int(priority) for priority in Priority}
_MAX_TEXT_LENGTH = 4 * MAX_NAME_LENGTH


def _text(text: Any) -> str:
    return str(text)[:_MAX_TEXT_LENGTH]


class _Conversion(NamedTuple):
    """Conversion of a value: from the message, to the message; ``ending`` is that of the state's name of the field."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = lambda value: value
    ending: str = ""


_NUMBER, _TEXT = _Conversion(float), _Conversion(_text)
_TIME = _Conversion(ns_from_stamp, lambda time_ns: max(time_ns, 0), "_ns")

_ANGLE_FIELDS = {
    **dict.fromkeys(("name", "reason", "because_of"), _TEXT),
    **dict.fromkeys(("value", "accuracy_95", "limit", "protection_level", "age_s"), _NUMBER),
    **dict.fromkeys(("stamp", "since"), _TIME),
    "safety": _Conversion(Safety, int),
    "is_old": _Conversion(bool),
}
"""Field of a message of one angle → conversion."""

_SOURCE_FIELDS = {
    **dict.fromkeys(("name", "reason", "because_of", "disagreement"), _TEXT),
    **dict.fromkeys(("residual", "age_s", "rate_hz", "mounting_shift"), _NUMBER),
    "out_since": _TIME,
    "presence": _Conversion(_PRESENCES.__getitem__, _PRESENCES.index),
    "rejected_in_a_row": _Conversion(int),
    "topics": _Conversion(lambda topics: tuple(map(_text, islice(topics, MAX_NAMES))), list),
}
"""Field of a message of one source → conversion, without the fields of the NIS consistency."""

_ALERT_FIELDS = {
    **dict.fromkeys(("id", "source", "text", "unit"), _Conversion(str)),
    **dict.fromkeys(("instance", "state"), _Conversion(int)),
    **dict.fromkeys(("value", "limit"), _NUMBER),
    **dict.fromkeys(("raised", "changed"), _TIME),
    "priority": _Conversion(Priority),
}
"""Field of a message of one alert → conversion."""


def suite_state_fields(state: SuiteState) -> dict[str, Any]:
    """Return the fields of a SuiteState message for :meth:`ship_bags.message_factory.MessageFactory.make`."""
    return {
        "header": {"stamp": state.utc_ns, "frame_id": ""},
        "angles": [_message_fields(_ANGLE_FIELDS, angle) for angle in state.angles],
        **{f"{name}_age_s": state.ages_s.get(name, math.inf) for name in ("stars", "lights", "ins")},
        "pointing_by": state.pointing_by,
        "horizon": state.horizon,
        "sources": [_message_fields(_SOURCE_FIELDS, source) | _nis_fields(source) for source in state.sources],
        "waiting_for": state.waiting_for,
    }


def change_key(state: SuiteState) -> tuple[Any, ...]:
    """Return the part of a state whose change is published at once.

    This part is the safety and ``is_old`` of each angle, and the presence and cause of each source.
    """
    angles = tuple((angle.name, angle.safety, angle.is_old) for angle in state.angles)
    return angles, tuple((source.name, source.presence, source.because_of) for source in state.sources)


@dataclass(frozen=True)
class PublishedState:
    """Content of a SuiteState message, with its time of arrival by the caller's clock.

    ``texts`` are the other fields of a suite state.
    """

    angles: tuple[AngleState, ...]
    ages_s: Mapping[str, float]
    sources: tuple[SourceDetails, ...]
    texts: Mapping[str, str]
    arrived_ns: int

    def is_current(self, now_ns: int) -> bool:
        """True if the state is recent enough to be displayed."""
        return now_ns - self.arrived_ns <= MAX_AGE_NS

    def merge_into(self, state: SuiteState, now_ns: int) -> SuiteState:
        """Return ``state`` with the published content; ages grow only if the next message is overdue."""
        overdue_s = max(0, now_ns - self.arrived_ns - PERIOD_NS) * 1e-9
        return replace(
            state,
            angles=tuple(replace(angle, age_s=angle.age_s + overdue_s) for angle in self.angles),
            ages_s={name: age_s + overdue_s for name, age_s in self.ages_s.items()},
            sources=tuple(replace(source, age_s=source.age_s + overdue_s) for source in self.sources),
            **self.texts,  # type: ignore[arg-type]
        )


def published_state(message: Any, arrived_ns: int) -> PublishedState:
    """Return the content of a SuiteState message.

    Raises:
        ValueError: the message contains an undefined safety or presence.
    """
    return PublishedState(
        angles=tuple(AngleState(**_values(_ANGLE_FIELDS, each)) for each in islice(message.angles, MAX_NAMES)),
        ages_s={name: float(getattr(message, f"{name}_age_s")) for name in ("stars", "lights", "ins")},
        sources=tuple(_source(each) for each in islice(message.sources, MAX_NAMES)),
        texts={name: _text(getattr(message, name)) for name in ("pointing_by", "horizon", "waiting_for")},
        arrived_ns=arrived_ns,
    )


def alerts_from_message(message: Any) -> list[AlertEntry]:
    """Return the first MAX_NAMES alerts of an AlertArray in its order, without alerts of an unknown priority."""
    alerts = (alert for alert in message.alerts[:MAX_NAMES] if alert.priority in _PRIORITIES)
    return [AlertEntry(**_values(_ALERT_FIELDS, alert)) for alert in alerts]


def _message_fields(fields: Mapping[str, _Conversion], state: AngleState | SourceDetails) -> dict[str, Any]:
    return {name: each.write(getattr(state, name + each.ending)) for name, each in fields.items()}


def _values(fields: Mapping[str, _Conversion], message: Any) -> dict[str, Any]:
    return {name + each.ending: each.read(getattr(message, name)) for name, each in fields.items()}


def _nis_fields(source: SourceDetails) -> dict[str, Any]:
    consistency = source.nis_consistency or NisConsistency(math.nan, -1, "", False)
    return {
        "nis_degrees": consistency.degrees_of_freedom,
        "nis_ratio": consistency.ratio,
        "nis_text": consistency.text,
        "is_as_stated": consistency.is_consistent,
    }


def _source(message: Any) -> SourceDetails:
    consistency = NisConsistency(
        float(message.nis_ratio), int(message.nis_degrees), _text(message.nis_text), bool(message.is_as_stated)
    )
    if not 0 <= message.presence < len(_PRESENCES):
        raise ValueError(f"presence {message.presence} of source '{_text(message.name)}' does not exist")
    return SourceDetails(
        **_values(_SOURCE_FIELDS, message), nis_consistency=consistency if message.nis_degrees >= 0 else None
    )

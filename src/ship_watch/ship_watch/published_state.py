"""State of a suite as a message, which the node ``alerts`` publishes and which page and terminal display.

:func:`suite_state_fields` converts a state to the fields of a SuiteState message, and :func:`published_state` reads a
received message.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_watch.suite_state import AngleState, NisConsistency, Presence, Safety, SourceDetails, SuiteState
from ship_watch.topics import MAX_NAME_LENGTH, MAX_NAMES

STATE_TOPIC = "ship/suite_state"
STATE_TYPE = "ship_msgs/msg/SuiteState"

PERIOD_NS = 500_000_000
"""Time between two messages while nothing changes, ns."""

MAX_AGE_NS = 4 * PERIOD_NS
"""Maximum age of a displayed state, ns. If the last state is older, the node or the network has failed."""

_PRESENCES = tuple(Presence)
_MAX_TEXT_LENGTH = 4 * MAX_NAME_LENGTH


def suite_state_fields(state: SuiteState) -> dict[str, Any]:
    """Return the fields of a SuiteState message for :meth:`ship_bags.message_factory.MessageFactory.make`."""
    return {
        "header": {"stamp": state.utc_ns, "frame_id": ""},
        "angles": [_angle_fields(angle) for angle in state.angles],
        **{f"{name}_age_s": state.ages_s.get(name, math.inf) for name in ("stars", "lights", "ins")},
        "pointing_by": state.pointing_by,
        "horizon": state.horizon,
        "sources": [_source_fields(source) for source in state.sources],
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
    """Content of a SuiteState message, with its time of arrival by the caller's clock."""

    angles: tuple[AngleState, ...]
    ages_s: Mapping[str, float]
    sources: tuple[SourceDetails, ...]
    pointing_by: str
    horizon: str
    waiting_for: str
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
            pointing_by=self.pointing_by, horizon=self.horizon, waiting_for=self.waiting_for,
        )


def published_state(message: Any, arrived_ns: int) -> PublishedState:
    """Return the content of a SuiteState message.

    Raises:
        ValueError: the message contains an undefined safety or presence.
    """
    return PublishedState(
        angles=tuple(_angle(each) for each in islice(message.angles, MAX_NAMES)),
        ages_s={name: float(getattr(message, f"{name}_age_s")) for name in ("stars", "lights", "ins")},
        sources=tuple(_source(each) for each in islice(message.sources, MAX_NAMES)),
        pointing_by=_text(message.pointing_by),
        horizon=_text(message.horizon),
        waiting_for=_text(message.waiting_for),
        arrived_ns=arrived_ns,
    )


def _angle_fields(angle: AngleState) -> dict[str, Any]:
    return {
        "name": angle.name,
        "value": angle.value,
        "accuracy_95": angle.accuracy_95,
        "limit": angle.limit,
        "protection_level": angle.protection_level,
        "safety": int(angle.safety),
        "reason": angle.reason,
        "because_of": angle.because_of,
        "age_s": angle.age_s,
        "is_old": angle.is_old,
        "stamp": max(angle.stamp_ns, 0),
        "since": max(angle.since_ns, 0),
    }


def _angle(message: Any) -> AngleState:
    return AngleState(
        name=_text(message.name),
        value=float(message.value),
        accuracy_95=float(message.accuracy_95),
        limit=float(message.limit),
        protection_level=float(message.protection_level),
        safety=Safety(message.safety),
        reason=_text(message.reason),
        age_s=float(message.age_s),
        is_old=bool(message.is_old),
        stamp_ns=ns_from_stamp(message.stamp),
        since_ns=ns_from_stamp(message.since),
        because_of=_text(message.because_of),
    )


def _source_fields(source: SourceDetails) -> dict[str, Any]:
    consistency = source.nis_consistency or NisConsistency(math.nan, -1, "", False)
    return {
        "name": source.name,
        "presence": _PRESENCES.index(source.presence),
        "reason": source.reason,
        "because_of": source.because_of,
        "disagreement": source.disagreement,
        "residual": source.residual,
        "out_since": max(source.out_since_ns, 0),
        "nis_degrees": consistency.degrees_of_freedom,
        "nis_ratio": consistency.ratio,
        "nis_text": consistency.text,
        "is_as_stated": consistency.is_consistent,
        "age_s": source.age_s,
        "rate_hz": source.rate_hz,
        "rejected_in_a_row": source.rejected_in_a_row,
        "topics": list(source.topics),
        "mounting_shift": source.mounting_shift,
    }


def _source(message: Any) -> SourceDetails:
    consistency = NisConsistency(
        float(message.nis_ratio), int(message.nis_degrees), _text(message.nis_text), bool(message.is_as_stated)
    )
    if not 0 <= message.presence < len(_PRESENCES):
        raise ValueError(f"presence {message.presence} of source '{_text(message.name)}' does not exist")
    return SourceDetails(
        name=_text(message.name),
        presence=_PRESENCES[message.presence],
        reason=_text(message.reason),
        disagreement=_text(message.disagreement),
        residual=float(message.residual),
        out_since_ns=ns_from_stamp(message.out_since),
        because_of=_text(message.because_of),
        nis_consistency=consistency if message.nis_degrees >= 0 else None,
        age_s=float(message.age_s),
        rate_hz=float(message.rate_hz),
        rejected_in_a_row=int(message.rejected_in_a_row),
        topics=tuple(_text(topic) for topic in islice(message.topics, MAX_NAMES)),
        mounting_shift=float(message.mounting_shift),
    )


def _text(text: Any) -> str:
    return str(text)[:_MAX_TEXT_LENGTH]

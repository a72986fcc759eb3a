"""Messages that every node gives of itself: why an input was not used, and how the node does."""

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_estimation.refusals import Reason, shortened

DIAGNOSTICS_TOPIC = "/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


class Level(enum.IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class DiagnosticStatus:
    """How one thing does.

    Attributes:
        name: the thing, as ``"input ins/imu"``.
        level: how bad it is.
        message: one line for people.
        values: further figures by name.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def diagnostic_array(
    factory: MessageFactory, now_ns: int, hardware_id: str, statuses: Iterable[DiagnosticStatus]
) -> Any:
    """A diagnostic_msgs/DiagnosticArray.

    Args:
        factory: makes the messages.
        now_ns: time of the report.
        hardware_id: name of the node; each status is named ``"<hardware_id>: <name>"``.
        statuses: what there is to say.
    """
    return factory.make(
        DIAGNOSTICS_TYPE,
        header=make_header(factory, now_ns),
        status=[_diagnostic_status(factory, hardware_id, status) for status in statuses],
    )


def _diagnostic_status(factory: MessageFactory, hardware_id: str, status: DiagnosticStatus) -> Any:
    return factory.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=int(status.level),
        name=f"{hardware_id}: {status.name}",
        message=status.message,
        hardware_id=hardware_id,
        values=[
            factory.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in status.values.items()
        ],
    )


def refusal_message(factory: MessageFactory, source: str, time_ns: int, reason: Reason, text: str) -> Any:
    """ship_msgs/Innovation of an input that was refused before it was compared."""
    source = shortened(source)
    return factory.make(
        "ship_msgs/msg/Innovation",
        header=make_header(factory, time_ns, source),
        source=source,
        components=[],
        residual=np.empty(0),
        sigma=np.empty(0),
        nis=float("nan"),
        gate=float("nan"),
        accepted=False,
        reason=int(reason),
        reason_text=shortened(text),
    )

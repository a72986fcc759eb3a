"""What is collected while a session runs: what became of the messages, and how the angles came about."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import FloatArray

_ALIGNMENT_TOPIC = "ship/alignment"
_IMPROBABLE = "gate", "attitude_conflict"
"""Reasons of refusal that an installation further off than its sigma leads to."""


@dataclass(frozen=True)
class InputCount:
    """What became of a device's messages.

    Attributes:
        used: messages that the filter used.
        refused: messages that it did not use.
        reasons: why not, or what is to be noted of those used (single stars refused, for example) → how often.
    """

    used: int
    refused: int
    reasons: dict[str, int]

    @property
    def improbable(self) -> int:
        """Messages too improbable to use."""
        return min(self.refused, sum(self.reasons.get(reason, 0) for reason in _IMPROBABLE))

    @property
    def words(self) -> str:
        """Reasons with their counts."""
        return ", ".join(f"{reason} {count}" for reason, count in self.reasons.items()) or "no message came"


@dataclass
class Course:
    """Takes a replay's outputs and keeps how the alignment came about."""

    times_ns: list[int] = field(default_factory=list)
    names: tuple[str, ...] = ()
    values: list[FloatArray] = field(default_factory=list)
    sigmas: list[FloatArray] = field(default_factory=list)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take an output."""
        if topic == _ALIGNMENT_TOPIC:
            covariance = np.reshape(message.covariance, (len(message.names), len(message.names)))
            self.add(log_time_ns, tuple(message.names), np.array(message.values), covariance)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """The truth is not for a calibration."""

    def add(self, time_ns: int, names: tuple[str, ...], values: FloatArray, covariance: FloatArray) -> None:
        """Take an alignment."""
        self.names = names
        self.times_ns.append(time_ns)
        self.values.append(values)
        self.sigmas.append(np.sqrt(np.diagonal(covariance)))

    @property
    def times_s(self) -> FloatArray:
        """Moments, seconds after the first, shape (n,)."""
        times_ns = np.array(self.times_ns, dtype=np.int64)
        return (times_ns - times_ns[:1]) / NS_PER_S

    def installations(self) -> dict[str, FloatArray]:
        """Name of an installation angle → values and sigmas, rad, shape (n, 2)."""
        angles = "azimuth", "elevation", "roll"
        wanted = [n for n, name in enumerate(self.names) if name.startswith("star.") and name.endswith(angles)]
        both = np.stack([np.array(self.values), np.array(self.sigmas)], axis=-1)
        return {self.names[n]: both[:, n] for n in wanted}


def input_counts(adapter: ShipAttitudeAdapter, now_ns: int) -> dict[str, InputCount]:
    """What became of the messages of each star sensor and reference."""
    config = adapter.core.config
    topics = {f"star/{id_}/{star.input}": f"star.{id_}" for id_, star in config.star_sensors.items()}
    topics |= {f"reference/{name}/imu": f"reference.{name}" for name in config.references}
    counts = {}
    for message in adapter.health.messages(RosbagsFactory(), now_ns):
        if message.topic in topics:
            reasons = dict(zip(message.reasons, map(int, message.reason_counts), strict=True))
            counts[topics[message.topic]] = InputCount(int(message.accepted), int(message.rejected), reasons)
    return counts

"""What a voyage with faults put out, against the truth: was each fault told, who was named, and what was claimed then.

The judge reads outputs alone: statuses, errors against ``truth/*``, innovations, and the protection levels and
exclusions of ``ship/integrity`` and ``theodolite/integrity`` where they are published. What the same voyage says
without faults is no sign of one, so that it is taken off.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.refusals import Reason
from ship_replay.evaluation.sources import Truth
from ship_replay.offline.orientations import ORIENTATIONS, Orientation
from ship_simulation.scenario.fault import Fault

_INNOVATIONS = ("ship/innovation", "theodolite/innovation")
_INTEGRITY = {"ship/attitude": "ship/integrity", "theodolite/pointing": "theodolite/integrity"}
_VALID = 0

SETTLING_S = 3.0
"""What a fault leaves behind is told within this after its end."""

_BESIDE_NS = NS_PER_S // 2
"""So near to a moment at which the voyage without faults was not VALID either, a status is no sign of a fault."""

_LEAST_REFUSALS = 2
BEYOND = 5.0
"""An error beyond so many sigmas is a wrong claim."""

_PERIOD_S = 0.1
"""From one moment of the truth to the next."""


@dataclass
class Told:
    """What a voyage put out.

    Attributes:
        claims: of each VALID output at a moment of the truth: (topic, stamp, log time, largest error in sigmas, largest
            error over its protection level; NaN where there is none).
        not_valid: (topic, stamp, log time, status) of the other outputs.
        signs: (source, log time, stamp, reason) of each refusal, and of each exclusion at its beginning.
        failures: refusals because the software failed.
        outputs: number of statuses.
    """

    claims: list[tuple[str, int, int, float, float]] = field(default_factory=list)
    not_valid: list[tuple[str, int, int, int]] = field(default_factory=list)
    signs: list[tuple[str, int, int, str]] = field(default_factory=list)
    failures: int = 0
    outputs: int = 0


@dataclass
class Passage:
    """One voyage through the nodes.

    Attributes:
        told: what it put out.
        arrivals_ns: input topic → when its messages arrived, in order.
        start_ns: beginning of the bag.
        end_ns: its end.
    """

    told: Told
    arrivals_ns: dict[str, np.ndarray]
    start_ns: int
    end_ns: int

    @property
    def length_s(self) -> float:
        """How long the bag is."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    def hits(self, fault: Fault) -> np.ndarray:
        """When the messages arrive, ns, that a fault of this voyage hits; by arrivals, for want of their stamps."""
        times_ns = self.arrivals_ns.get(fault.topic, np.zeros(0, dtype=np.int64))
        since_s = (times_ns - self.start_ns) / NS_PER_S
        found: np.ndarray = times_ns[(since_s >= fault.start_s) & (since_s < fault.end_s)]
        return found

    def alert_limit_s(self, fault: Fault) -> float:
        """Within this a large step must be told: a second, or three measurements of the source."""
        periods_ns = np.diff(self.arrivals_ns[fault.topic])
        return max(1.0, 3.0 * float(np.median(periods_ns)) / NS_PER_S) if periods_ns.size else 1.0


EXCLUSION = "excluded from the estimate"


class VoyageSink:
    """Takes what a replay gives, and keeps what is judged.

    Args:
        truths: topic of an orientation → its truth.
    """

    def __init__(self, truths: Mapping[str, Truth]) -> None:
        self.told = Told()
        self._truths = truths
        self._orientations = {known.topic: known for known in ORIENTATIONS}
        self._levels: dict[str, np.ndarray] = {}
        self._excluded: dict[str, set[str]] = {}

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take the truth, which is known."""

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take an output."""
        if topic in _INNOVATIONS:
            self._innovation(message, log_time_ns)
        elif topic in _INTEGRITY.values():
            self._integrity(topic, message, log_time_ns)
        elif topic in self._orientations:
            self._claim(self._orientations[topic], message, log_time_ns)

    def _innovation(self, message: Any, log_time_ns: int) -> None:
        reason = Reason(message.reason)
        if reason is Reason.FAILED:
            self.told.failures += 1
        if not message.accepted and reason not in (Reason.NONE, Reason.REVISED):
            self.told.signs.append((message.source, log_time_ns, ns_from_stamp(message.header.stamp), reason.word))

    def _integrity(self, topic: str, message: Any, log_time_ns: int) -> None:
        self._levels[topic] = np.array(message.protection_level, dtype=float)
        now = set(message.excluded)
        for source in sorted(now - self._excluded.get(topic, set())):
            self.told.signs.append((source, log_time_ns, ns_from_stamp(message.header.stamp), EXCLUSION))
        self._excluded[topic] = now

    def _claim(self, orientation: Orientation, message: Any, log_time_ns: int) -> None:
        stamp_ns, status = ns_from_stamp(message.header.stamp), int(message.status)
        self.told.outputs += 1
        if status != _VALID:
            self.told.not_valid.append((orientation.topic, stamp_ns, log_time_ns, status))
            return
        truth = self._truths.get(orientation.topic)
        truth_nd = None if truth is None else truth.exactly_at(stamp_ns)
        if truth_nd is None:
            return
        angles = orientation.angles_of(message)
        error = np.abs(orientation.errors_arcsec(angles, truth_nd)) * np.pi / 648_000.0
        sigma = orientation.scale(angles) * np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(3, 3)))
        level = self._levels.get(_INTEGRITY[orientation.topic], np.full(3, np.nan))
        over_level = error / level if np.all(np.isfinite(level)) else np.full(3, np.nan)
        # An error that is no number is a wrong claim, too.
        sigmas = float(np.max(np.nan_to_num(error / sigma, nan=np.inf)))
        self.told.claims.append((orientation.topic, stamp_ns, log_time_ns, sigmas, float(np.max(over_level))))


@dataclass(frozen=True)
class FaultVerdict:
    """What became of one fault.

    Attributes:
        detected: a status left VALID, or the faulty source was named.
        attributed: the source named is the faulty one.
        alert_s: from the first message that the fault hit to the first sign; NaN without one.
        named: source → signs of it.
        worst_sigmas: largest error of an output that was VALID, in sigmas, until the next fault.
        worst_over_level: the same over its protection level; NaN where there was none.
        beyond_s: for how long outputs were VALID with errors beyond five sigmas, in all.
        longest_beyond_s: and without a break.
    """

    detected: bool
    attributed: bool
    alert_s: float
    named: dict[str, int]
    worst_sigmas: float
    worst_over_level: float
    beyond_s: float
    longest_beyond_s: float


def judged(fault: Fault, told: Told, clean: Passage, until_s: float) -> FaultVerdict:
    """What became of a fault.

    Args:
        fault: what went wrong.
        told: by the voyage.
        clean: the same voyage without faults; the fault hits some of its messages.
        until_s: beginning of the next fault, or the end of the voyage.
    """
    start_ns, first_hit_ns = clean.start_ns, int(clean.hits(fault)[0])
    begin_ns = start_ns + round(fault.start_s * NS_PER_S)
    end_ns = start_ns + round(min(fault.end_s + SETTLING_S, until_s) * NS_PER_S)
    known = {(source, stamp_ns) for source, _, stamp_ns, _ in clean.told.signs}
    signs = [
        sign for sign in told.signs if begin_ns <= sign[1] < end_ns and (sign[0], sign[2]) not in known
    ]
    left_ns = _first_left(told, clean.told, begin_ns, end_ns)
    named = Counter(source for source, *_ in signs)
    own = [log_ns for source, log_ns, *_ in signs if is_source(source, fault.topic)]
    alerts_ns = [*own[:1], *([] if left_ns is None else [left_ns])]
    after = [claim for claim in told.claims if begin_ns <= claim[1] < start_ns + round(until_s * NS_PER_S)]
    beyond_s, longest_s = _beyond(after)
    levels = [claim[4] for claim in after if np.isfinite(claim[4])]
    return FaultVerdict(
        detected=bool(alerts_ns),
        attributed=_attributed(fault, signs, named),
        alert_s=max((min(alerts_ns) - first_hit_ns) / NS_PER_S, 0.0) if alerts_ns else float("nan"),
        named=dict(named),
        worst_sigmas=max((claim[3] for claim in after), default=0.0),
        worst_over_level=max(levels, default=float("nan")),
        beyond_s=beyond_s,
        longest_beyond_s=longest_s,
    )


def is_source(name: str, topic: str) -> bool:
    """Whether a source by the name that nodes give it is the device behind a topic."""
    kind, _, rest = topic.partition("/")
    id_ = rest.partition("/")[0]
    if kind == "star":
        return name == f"star.{id_}"
    if kind == "reference":
        return name == f"reference.{id_}"
    if kind == "beacon":
        return name in (f"beacon.{id_}", f"baseline.{id_}", f"drone.{id_}", f"light.{id_}")
    if topic == "theodolite/beacons":
        return name in ("lights", "telescope") or name.startswith("light.")
    names = {"ins/imu": ("ins",), "ship/attitude": ("ship", "ship_attitude"), "theodolite/encoder": ("encoder",)}
    return name in (topic, *names.get(topic, ()))


def _attributed(fault: Fault, signs: list[tuple[str, int, int, str]], named: Counter[str]) -> bool:
    """Whether who is excluded is the faulty one alone; or, without exclusions, who was refused first and repeatedly."""
    excluded = {source for source, _, _, reason in signs if reason == EXCLUSION}
    if excluded:
        return all(is_source(source, fault.topic) for source in excluded)
    candidates = [source for source, *_ in signs if named[source] >= _LEAST_REFUSALS] or [sign[0] for sign in signs]
    return bool(candidates) and is_source(candidates[0], fault.topic)


def _first_left(told: Told, clean: Told, begin_ns: int, end_ns: int) -> int | None:
    """Log time of the first output that is not VALID, where the voyage without faults was."""
    for topic in _INTEGRITY:
        usual = np.array(sorted(stamp for name, stamp, *_ in clean.not_valid if name == topic))
        for name, stamp_ns, log_ns, _ in told.not_valid:
            if name == topic and begin_ns <= log_ns < end_ns:
                place = int(np.searchsorted(usual, stamp_ns - _BESIDE_NS))
                if place == len(usual) or usual[place] > stamp_ns + _BESIDE_NS:
                    return log_ns
    return None


def _beyond(claims: list[tuple[str, int, int, float, float]]) -> tuple[float, float]:
    """How long VALID claims were beyond five sigmas, in all and without a break, s; the worse of the outputs."""
    total, longest = 0, 0
    for topic in _INTEGRITY:
        run = count = 0
        for claim in (claim for claim in claims if claim[0] == topic):
            run = run + 1 if not claim[3] <= BEYOND else 0
            count += not claim[3] <= BEYOND
            longest = max(longest, run)
        total = max(total, count)
    return total * _PERIOD_S, longest * _PERIOD_S

"""Evaluation of the faults of a voyage: detection, named source, and errors of the outputs published meanwhile.

Only outputs are evaluated (:mod:`ship_testing.trials.voyage_outputs`). Indications that also occur in the same voyage
without faults are ignored. A fault begins with the first message that it affects.

**The named source** is the first source reported to a watch officer:

1. An excluded source, or a source that is repeatedly rejected for its own form, stamps or sequence of values, whichever
is first. If an exclusion is first, all excluded sources must be faulty. If a rejection is first, later exclusions of
other sources do not matter.
2. Without such a source, the first source that is repeatedly rejected in comparison with other sources.
3. Without repeated rejections, the source of the first indication.

Rejections in comparison with other sources count only if no source is excluded: correct lights or stars are also
rejected if encoders or position are wrong.

A name is correct if it refers to the faulty source (:func:`is_faulty_source`). The names of sources are those of
:mod:`ship_estimation.integrity.protection_levels`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_replay.offline.replay_summary import INTEGRITY_TOPICS
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import ENCODER_TOPIC, FUSED_TOPIC, IMAGE_TOPIC
from ship_testing.trials.fault_free_replay import FaultFreeReplay
from ship_testing.trials.voyage_outputs import EXCLUSION, FaultIndication, ValidOutput, VoyageOutputs

SETTLING_S = 3.0
"""Time after the end of a fault within which indications still count for this fault, s."""

_SAME_TIME_NS = NS_PER_S // 2
"""A status is ignored if the fault-free voyage has an equal or worse status within this time, ns."""

_LEAST_REFUSALS = 2
EXCEEDANCE_SIGMAS = 5.0
"""Error of a VALID output, in sigmas, above which the output counts as wrong."""

_PERIOD_S = 0.1
"""Period of the truth, s."""

_ONE_LIGHT_KINDS = ("swap", "false_lights", "hide", "wrong_id")


@dataclass(frozen=True)
class FaultOutcome:
    """Outcome of one fault.

    Attributes:
        changed: number of messages that the fault changed, dropped, delayed or multiplied.
        detected: True if an output left VALID, an indication refers to the faulty source, or any source was excluded; a
            status caused by an earlier fault does not count.
        attributed: True if the named source is the faulty source.
        alert_s: time from the first affected message to the first indication of the faulty source or non-VALID output;
            NaN if there is neither.
        named: source → number of indications.
        worst_sigmas: largest error of a VALID output until the next fault, in sigmas.
        worst_over_level: largest ratio of an error of a VALID output to its protection level; NaN without level.
        beyond_s: total time with VALID outputs whose errors exceed five sigmas.
        longest_beyond_s: longest uninterrupted time with such outputs.
    """

    changed: int
    detected: bool
    attributed: bool
    alert_s: float
    named: dict[str, int]
    worst_sigmas: float
    worst_over_level: float
    beyond_s: float
    longest_beyond_s: float


def evaluate_fault(
    fault: Fault, changed_ns: np.ndarray, outputs: VoyageOutputs, fault_free: FaultFreeReplay, until_s: float
) -> FaultOutcome:
    """Evaluate a fault.

    Args:
        fault: the fault.
        changed_ns: original arrival times (without faults) of the messages that the fault affects, in order; at least
            one.
        outputs: outputs of the voyage.
        fault_free: replay of the same voyage without faults.
        until_s: beginning of the next fault, or the end of the voyage.
    """
    start_ns, first_ns = fault_free.start_ns, int(changed_ns[0])
    begin_ns, until_ns = start_ns + round(fault.start_s * NS_PER_S), start_ns + round(until_s * NS_PER_S)
    end_ns = min(start_ns + round((fault.end_s + SETTLING_S) * NS_PER_S), until_ns)
    known = {(sign.source, sign.stamp_ns) for sign in fault_free.outputs.indications}
    indications = [
        sign
        for sign in outputs.indications
        if first_ns <= sign.log_ns < end_ns and (sign.source, sign.stamp_ns) not in known
    ]  # fmt: skip
    not_valid_ns, is_new = _first_not_valid(outputs, fault_free.outputs, first_ns, end_ns)
    own = [sign.log_ns for sign in indications if is_faulty_source(sign.source, fault)]
    alerts_ns = [*own[:1], *([] if not_valid_ns is None else [not_valid_ns])]
    after = [claim for claim in outputs.valid_outputs if begin_ns <= claim.stamp_ns < until_ns]
    beyond_s, longest_s = exceedance_durations(after)
    levels = [claim.level_ratio for claim in after if np.isfinite(claim.level_ratio)]
    names = first_named_sources(indications)
    return FaultOutcome(
        changed=len(changed_ns),
        detected=bool(own) or is_new or any(sign.reason == EXCLUSION for sign in indications),
        attributed=bool(names) and all(is_faulty_source(name, fault) for name in names),
        alert_s=(min(alerts_ns) - first_ns) / NS_PER_S if alerts_ns else float("nan"),
        named=dict(Counter(sign.source for sign in indications)),
        worst_sigmas=max((claim.sigmas for claim in after), default=0.0),
        worst_over_level=max(levels, default=float("nan")),
        beyond_s=beyond_s,
        longest_beyond_s=longest_s,
    )


def first_named_sources(indications: Sequence[FaultIndication]) -> set[str]:
    """Return the sources named first, by the rule of this module; empty without indications.

    Args:
        indications: indications in order of time.
    """
    times = Counter(sign.source for sign in indications if sign.is_own_fault)
    for sign in indications:
        if sign.reason == EXCLUSION:
            return {other.source for other in indications if other.reason == EXCLUSION}
        if sign.is_own_fault and times[sign.source] >= _LEAST_REFUSALS:
            return {sign.source}
    times = Counter(sign.source for sign in indications)
    repeated = [sign.source for sign in indications if times[sign.source] >= _LEAST_REFUSALS]
    return set(repeated[:1] or [sign.source for sign in indications[:1]])


def is_faulty_source(name: str, fault: Fault) -> bool:
    """True if a name in the outputs refers to the source with the fault.

    A name is a topic, or a source of a topic. ``beacon.a``, ``baseline.a``, ``drone.a`` and ``light.a`` refer to the
    baseline and the attitude of drone a. Such names of any drone also refer to a fault of a single light in the image,
    but not to a rotated telescope. ``ship`` and ``ship_attitude`` refer to the ship's attitude in the theodolite's
    filter, and therefore also to faults of the INS.
    """
    topic = fault.topic
    kind, _, rest = topic.partition("/")
    id_ = rest.partition("/")[0]
    if name == topic:
        return True
    if kind in ("star", "reference"):
        return name == f"{kind}.{id_}"
    if kind == "beacon":
        return name in _drone_names(id_)
    if topic == IMAGE_TOPIC:
        is_one_light = fault.kind in _ONE_LIGHT_KINDS or fault.field.startswith("beacons[")
        return name in ("lights", "telescope") or (is_one_light and name.startswith(_drone_names("")))
    ship = ("ship", "ship_attitude", FUSED_TOPIC)
    names = {"ins/imu": ("ins", *ship), FUSED_TOPIC: ship, ENCODER_TOPIC: ("encoder",)}
    return name in names.get(topic, ())


def _drone_names(id_: str) -> tuple[str, ...]:
    return tuple(f"{kind}.{id_}" for kind in ("beacon", "baseline", "drone", "light"))


def _first_not_valid(
    outputs: VoyageOutputs, fault_free: VoyageOutputs, begin_ns: int, end_ns: int
) -> tuple[int | None, bool]:
    """Return the log time of the first output that is worse than VALID and worse than in the fault-free voyage.

    The second value is True if this output, or a later one, is not the remaining effect of an earlier fault.
    """
    fault_free_stamps_ns: dict[tuple[str, int], np.ndarray] = {}
    last_worse_ns: dict[str, int] = {}
    first_ns, is_new = None, False
    for name, stamp_ns, log_ns, status in outputs.not_valid:
        if name not in INTEGRITY_TOPICS or log_ns >= end_ns:
            continue
        if (name, status) not in fault_free_stamps_ns:
            stamps = sorted(stamp for other, stamp, _, bad in fault_free.not_valid if other == name and bad >= status)
            fault_free_stamps_ns[name, status] = np.array(stamps)
        stamps_ns = fault_free_stamps_ns[name, status]
        place = int(np.searchsorted(stamps_ns, stamp_ns - _SAME_TIME_NS))
        if place < len(stamps_ns) and stamps_ns[place] <= stamp_ns + _SAME_TIME_NS:
            continue
        if log_ns >= begin_ns:
            first_ns = log_ns if first_ns is None else first_ns
            is_new = is_new or log_ns - last_worse_ns.get(name, 0) > _SAME_TIME_NS
        last_worse_ns[name] = log_ns
    return first_ns, is_new


def exceedance_durations(valid_outputs: Sequence[ValidOutput]) -> tuple[float, float]:
    """Return total and longest uninterrupted time with VALID outputs whose errors exceed five sigmas, s.

    Each value is the larger of the values for attitude and pointing. An output that is not VALID interrupts the time.
    """
    total, longest, most_ns = 0, 0, round(1.5 * _PERIOD_S * NS_PER_S)
    for topic in INTEGRITY_TOPICS:
        run, last_ns = 0, 0
        wrong = sorted(
            claim.stamp_ns for claim in valid_outputs if claim.topic == topic and not claim.sigmas <= EXCEEDANCE_SIGMAS
        )
        for stamp_ns in wrong:
            run = run + 1 if run and stamp_ns - last_ns <= most_ns else 1
            longest, last_ns = max(longest, run), stamp_ns
        total = max(total, len(wrong))
    return total * _PERIOD_S, longest * _PERIOD_S

"""Detailed report on one fault: errors and statuses over time, and the sources that nodes reported."""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_replay.offline.replay_summary import STATUS_NAMES
from ship_simulation.inject_command import Injection
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.scenario_file import load_faults
from ship_testing.trials.fault_evaluation import evaluate_fault, is_faulty_source
from ship_testing.trials.fault_voyage import input_topics, replay_fault_free, replay_injection
from ship_testing.trials.voyage_outputs import VoyageOutputs

_MOST_LINES = 40


def one_fault_lines(path: Path, words: str, seed: int = 1) -> list[str]:
    """Return a report on one fault in a bag, line by line.

    Args:
        path: bag without faults.
        words: text of the fault, such as ``topic: ins/imu, kind: bias, start_s: 20, up_arcsec: 30``.
        seed: seed of the fault.

    Raises:
        BadInput: the text does not describe a fault, the fault changes no message, or the bag cannot be used.
    """
    with read_bag(path) as bag:
        faults = load_faults(f"faults: {{one: {{{words}}}}}", input_topics(bag), "an input of the nodes")
    fault, injection = faults["one"], Injection(path, faults, seed)
    changed_ns = np.array(injection.effect("one").times_ns)
    if not changed_ns.size:
        raise BadInput(f"the fault changes no message of {fault.topic}", file=path)
    fault_free, outputs = replay_fault_free(path), replay_injection(injection)
    start_ns, until_s = fault_free.start_ns, fault_free.length_s
    outcome = evaluate_fault(fault, changed_ns, outputs, fault_free, until_s)
    undetectable = fault_free.undetectable_case(fault, int(changed_ns[0]))
    worst = f"worst error {outcome.worst_sigmas:.1f} σ, {outcome.worst_over_level:.2f} of its protection level"
    beyond = f"beyond 5σ for {outcome.beyond_s:.1f} s, longest {outcome.longest_beyond_s:.1f} s"
    return [
        f"{path.name}: {fault.kind} on {fault.topic} from {fault.start_s:g} s to {min(fault.end_s, until_s):g} s",
        f"changed {outcome.changed} messages, the first at {_seconds(int(changed_ns[0]), start_ns).strip()}",
        *([f"undetectable: {undetectable}"] if undetectable else []),
        f"detected {outcome.detected} after {outcome.alert_s:.2f} s, attributed {outcome.attributed}",
        f"while VALID: {worst}; {beyond}; failures {outputs.failure_count}",
        *_worst_by_time(outputs, start_ns),
        *_statuses(outputs, start_ns),
        *_indication_lines(outputs, fault, start_ns),
    ]


def _seconds(time_ns: int, start_ns: int) -> str:
    return f"{(time_ns - start_ns) / NS_PER_S:8.2f} s"


def _worst_by_time(outputs: VoyageOutputs, start_ns: int) -> Iterator[str]:
    """Yield lines with the largest error of the VALID outputs in each ten seconds."""
    for topic in sorted({claim.topic for claim in outputs.valid_outputs}):
        yield f"worst error of {topic} while VALID, in each ten seconds (σ; share of the level):"
        claims = sorted(
            (claim for claim in outputs.valid_outputs if claim.topic == topic), key=lambda claim: claim.stamp_ns
        )
        spans = groupby(claims, key=lambda claim: (claim.stamp_ns - start_ns) // (10 * NS_PER_S))
        texts = []
        for span, group in spans:
            kept = list(group)
            texts.append(f"{10 * span}s {max(c.sigmas for c in kept):.1f};{max(c.level_ratio for c in kept):.2f}")
        yield "  " + "  ".join(texts)


def _statuses(outputs: VoyageOutputs, start_ns: int) -> Iterator[str]:
    """Yield the spans in which an output was not VALID."""
    for topic in sorted({entry[0] for entry in outputs.not_valid}):
        yield f"{topic} not VALID (by stamps):"
        entries = sorted(entry for entry in outputs.not_valid if entry[0] == topic)
        spans: list[list[int]] = []
        for _, stamp_ns, _, status in entries:
            if spans and spans[-1][2] == status and stamp_ns - spans[-1][1] < NS_PER_S // 2:
                spans[-1][1] = stamp_ns
            else:
                spans.append([stamp_ns, stamp_ns, status])
        for first_ns, last_ns, status in spans[:_MOST_LINES]:
            yield f"  {_seconds(first_ns, start_ns)} to {_seconds(last_ns, start_ns)}  {STATUS_NAMES[status]}"


def _indication_lines(outputs: VoyageOutputs, fault: Fault, start_ns: int) -> Iterator[str]:
    """Yield the named sources with reason, first and last time, and count."""
    yield "named sources (log time of the first and the last indication):"
    kinds: dict[tuple[str, str], list[int]] = {}
    for source, log_ns, _, reason in outputs.indications:
        kinds.setdefault((source, reason), []).append(log_ns)
    for (source, reason), times in sorted(kinds.items(), key=lambda item: item[1][0])[:_MOST_LINES]:
        own = "  <- the faulty one" if is_faulty_source(source, fault) else ""
        yield (
            f"  {_seconds(times[0], start_ns)} to {_seconds(times[-1], start_ns)}  "
            f"{source}: {reason}, {len(times)} times{own}"
        )

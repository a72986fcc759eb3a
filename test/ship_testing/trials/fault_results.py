"""Tables of the results of voyages with faults, and the bounds that these results must meet."""

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from ship_testing.trials.fault_evaluation import EXCEEDANCE_SIGMAS
from ship_testing.trials.fault_free_replay import MEASUREMENTS, UNDETECTABLE_CASES, UNREPORTED_CASES
from ship_testing.trials.results_file import Result, ResultsFile
from ship_testing.trials.threats import DATA_LIKE, OVERLAPPING, SINGLE

Row = tuple[str, ...]

_LARGE_STEP = 8.0
"""Size of a step, in sigmas of one measurement, from which on it must be detected in time."""

_IN_TIME, _NAMED = 0.99, 0.95
"""Required shares of large steps detected in time, and of detected single faults attributed to the right source."""

_LONGEST_BEYOND_S = 2.0
"""Maximum time for which an output may be VALID with an error above five sigmas under overlapping faults, s."""

THREAT_HEAD = (
    "threat", "count", "detected", "attributed", "alert s: median", "99 %", "worst σ", "beyond 5σ", "longest s",
    "worst/level", "level exceeded",
)  # fmt: skip
PAIR_HEAD = ("pair", "count", "longest beyond 5σ, s", "worst σ", "worst/level")
_LEVEL = "worst_over_level"
_PAIR_VALUES = ("longest_beyond_s", "worst_sigmas", _LEVEL)
_DATA_LIKE = {threat.label for threat in DATA_LIKE} | set(UNDETECTABLE_CASES)


def results_file(path: Path, fresh: bool = False) -> ResultsFile:
    """Return the file of results of voyages with faults.

    Raises:
        BadInput: a complete line is not a result, or is a result of another evaluation.
    """
    return ResultsFile(path, _key, fresh)


def _key(result: Result) -> tuple[int, str, str]:
    if not result["exception"]:
        result["longest_beyond_s"], [fault["changed"] for fault in result["faults"]]
    return result["voyage"], result["bag"], result["mode"]


def threat_rows(results: Sequence[Result]) -> list[Row]:
    """Return one row per threat, and one row for all threats."""
    by_threat: dict[str, list[Result]] = defaultdict(list)
    for fault in _evaluated_faults(results):
        by_threat[fault["threat"]].append(fault)
    rows = [_threat_row(threat, by_threat[threat]) for threat in sorted(by_threat)]
    everything = [fault for faults in by_threat.values() for fault in faults]
    return [*rows, _threat_row("all", everything)] if rows else []


def _threat_row(threat: str, faults: Sequence[Result]) -> Row:
    detected = [fault for fault in faults if fault["detected"]]
    alerts_s = [fault["alert_s"] for fault in detected if fault["alert_s"] is not None]
    levels = [level for fault in faults if (level := fault["worst_over_level"]) is not None]
    return (
        threat,
        str(len(faults)),
        str(len(detected)),
        str(sum(fault["attributed"] for fault in detected)),
        _number(np.median(alerts_s)) if alerts_s else "-",
        _number(np.quantile(alerts_s, 0.99)) if alerts_s else "-",
        _number(max(fault["worst_sigmas"] for fault in faults)),
        str(sum(fault["worst_sigmas"] > EXCEEDANCE_SIGMAS for fault in faults)),
        _number(max(fault["longest_beyond_s"] for fault in faults)),
        _number(max(levels)) if levels else "-",
        str(sum(level > 1.0 for level in levels)),
    )


def pair_rows(results: Sequence[Result]) -> list[Row]:
    """Return one row per pair of threats present at the same time in a voyage with overlapping faults."""
    pairs: dict[tuple[str, str], list[Result]] = defaultdict(list)
    for result in results:
        faults = _evaluated_faults([result]) if result["mode"] == OVERLAPPING else []
        for first, second in combinations(faults, 2):
            if max(first["start_s"], second["start_s"]) < min(first["end_s"], second["end_s"]):
                key = tuple(sorted((first["threat"], second["threat"])))
                # The later fault counts for the pair, because both faults are present when it begins.
                pairs[key[0], key[1]].append(max(first, second, key=lambda fault: float(fault["start_s"])))
    rows = [
        (f"{pair[0]} + {pair[1]}", len(faults), [_maximum(faults, name) for name in _PAIR_VALUES])
        for pair, faults in pairs.items()
    ]
    # Pairs are sorted by the longest wrong output, then by the largest error; NaN is last.
    rows.sort(key=lambda row: (*(1.0 if math.isnan(value) else -value for value in row[2]), row[0]))
    return [(pair, str(count), *map(_number, values)) for pair, count, values in rows]


@dataclass(frozen=True)
class Totals:
    """Result of all voyages together.

    Attributes:
        lines: each bound and its result, for people.
        all_met: True if all bounds are met.
    """

    lines: list[str]
    all_met: bool


def totals(results: Sequence[Result]) -> Totals:
    """Return each bound on all voyages and its result; a bound without a case is met."""
    raised = [result for result in results if result["exception"] or result["failures"]]
    overlapping = [result for result in results if result["mode"] == OVERLAPPING and "longest_beyond_s" in result]
    longest_s = max((result["longest_beyond_s"] for result in overlapping), default=0.0)
    single = [fault for fault in _evaluated_faults(results) if fault["mode"] == SINGLE]
    bounds = [
        (not raised, f"{len(results)} voyages: {len(raised)} with exceptions; bound 0"),
        *_single_bounds(single),
        (
            longest_s <= _LONGEST_BEYOND_S,
            (
                f"overlapping faults, {len(overlapping)} voyages: the longest VALID beyond 5σ {_number(longest_s)} s; "
                f"bound {_LONGEST_BEYOND_S:g} s"
            ),
        ),
    ]
    lines = [f"{'met' if met else 'NOT MET':7}  {text}" for met, text in bounds]
    lines += [f"voyage {one['voyage']} ({one['bag']}): {_failure_text(one)}" for one in raised]
    pairs = [fault for fault in _evaluated_faults(results) if fault["mode"] == OVERLAPPING]
    over, worst, level = (
        _count_above(pairs, "worst_sigmas", EXCEEDANCE_SIGMAS),
        _maximum(pairs, "worst_sigmas"),
        _maximum(pairs, _LEVEL),
    )
    lines.append(
        f"         overlapping faults: {over} of {len(pairs)} beyond 5σ; worst {_number(worst)} σ, "
        f"{_number(level)} of the level"
    )
    return Totals(lines, all(met for met, _ in bounds))


def _single_bounds(single: Sequence[Result]) -> list[tuple[bool, str]]:
    """Return each bound on single faults: True if the bound is met, and a text."""
    undetectable = [fault for fault in single if fault["threat"] in UNDETECTABLE_CASES]
    detectable = [fault for fault in single if fault["threat"] not in UNDETECTABLE_CASES]
    exceeded, exceeding = _count_above(single, _LEVEL, 1.0), _count_above(detectable, "worst_sigmas", EXCEEDANCE_SIGMAS)
    all_large = [fault for fault in single if (fault["sigmas"] or 0.0) >= _LARGE_STEP]
    large = [fault for fault in all_large if fault["threat"] not in UNREPORTED_CASES]
    # A step with fewer changed measurements ended before it had to be detected.
    steps = [fault for fault in large if fault["changed"] >= MEASUREMENTS]
    detected = [fault for fault in single if fault["detected"]]
    data_like = [fault for fault in detected if fault["threat"] in _DATA_LIKE]
    in_time, named = sum(map(_is_in_time, steps)), sum(map(_is_attributed, detected))
    return [
        (not exceeded, f"single faults, {len(single)}: {exceeded} VALID beyond the protection level; bound 0"),
        (
            not exceeding,
            (
                f"  VALID beyond 5σ: {exceeding}; bound 0, without the {len(undetectable)} undetectable ones "
                f"({_count_above(undetectable, 'worst_sigmas', EXCEEDANCE_SIGMAS)} beyond)"
            ),
        ),
        (
            in_time >= _IN_TIME * len(steps),
            (
                f"  of {len(steps)} steps ≥ {_LARGE_STEP:g}σ detected within 1 s or {MEASUREMENTS} measurements: "
                f"{_share(steps, _is_in_time)}, at any time {_share(steps, _is_reported)}; bound {_IN_TIME:.0%}; "
                f"{len(large) - len(steps)} more ended before, {len(all_large) - len(large)} undetectable"
            ),
        ),
        (
            named >= _NAMED * len(detected),
            (
                f"  of {len(detected)} detected, attributed to the right source: {_share(detected, _is_attributed)}; "
                f"bound {_NAMED:.0%}; of the {len(data_like)} that look like data {_share(data_like, _is_attributed)}"
            ),
        ),
    ]


def _evaluated_faults(results: Sequence[Result]) -> list[Result]:
    """Return the faults of completed voyages, with the mode of their voyage."""
    return [
        {**fault, "mode": result["mode"]} for result in results for fault in result["faults"] if "detected" in fault
    ]


def _count_above(faults: Sequence[Result], name: str, limit: float) -> int:
    return sum(fault[name] is not None and fault[name] > limit for fault in faults)


def _maximum(faults: Sequence[Result], name: str) -> float:
    return max((fault[name] for fault in faults if fault[name] is not None), default=math.nan)


def _share(faults: Sequence[Result], holds: Callable[[Result], bool]) -> str:
    return f"{sum(map(holds, faults)) / len(faults):.1%}" if faults else "-"


def _is_reported(fault: Result) -> bool:
    return fault["alert_s"] is not None


def _is_attributed(fault: Result) -> bool:
    return bool(fault["attributed"])


def _is_in_time(fault: Result) -> bool:
    return fault["alert_s"] is not None and fault["alert_s"] <= fault["alert_limit_s"]


def _failure_text(result: Result) -> str:
    if not result["exception"]:
        return f"{result['failures']} messages on which the software failed"
    return str(result["exception"]).strip().splitlines()[-1]


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}" if value < 100.0 else f"{value:.3g}"

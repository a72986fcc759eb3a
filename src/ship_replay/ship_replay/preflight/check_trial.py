"""Trial of a configuration: its nodes process a bag, to find wrong sigmas and inputs that are hardly used."""

from collections.abc import Iterator, Sequence
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_estimation.rejection_rules import LONGEST_TEXT, Reason, shorten
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.replay_run import ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_replay.offline.sinks import NullSink
from ship_replay.offline.status_history import low_use_text, most_frequent_rejection
from ship_replay.preflight.check_config import BagCheck, CheckedNode
from ship_replay.preflight.check_sigmas import check_sigmas

TRIAL_S = 600.0
"""Length of the part of a bag that is replayed, s: ten minutes of data take half a minute."""

_FEWEST = 10
_CONFIGURATION_REASONS = (
    Reason.ATTITUDE_CONFLICT,
    Reason.BAD_QUATERNION,
    Reason.EXCLUDED,
    Reason.FRAME,
    Reason.GATE,
    Reason.LIGHT_CONFLICT,
    Reason.UNITS,
    Reason.UNKNOWN_SENSOR,
)
"""Rejection reasons that indicate a wrong configuration if they affect a whole input."""

_WEATHER_REASONS = (Reason.TOO_FEW_STARS, Reason.BELOW_HORIZON, Reason.DUPLICATE, Reason.OFF)
"""Rejection reasons that indicate no fault even if they affect most of an input."""

_ADVICE = {
    Reason.FUTURE: "set the device's clock to UTC (GPS time is 18 s ahead), or let its driver use the computer's clock",
    Reason.LATE: "set the device's clock, or raise lag_s to its delay",
    Reason.GAP: "samples of ins/imu around it are missing or rejected: check ins/imu first",
    Reason.NO_FIX: "provide position fixes on gnss/fix at least every sky.fix_max_age_s, stamped in UTC",
    Reason.UNIDENTIFIED: "check the camera's focal length, the installation angles, gnss/fix and the stamps (UTC)",
    Reason.JUMP: "such jumps are impossible on a ship: check the receiver or instrument first",
    Reason.NOT_FIXED: "the receiver has no fixed solution: check its corrections, or set least_fix",
}
"""Advice by rejection reason."""


def check_trial(check: BagCheck) -> None:
    """Replay the beginning of a bag through the nodes; report wrong sigmas and inputs that are hardly used.

    Sigmas are checked only if no error was found before. The nodes cannot be used afterwards.
    """
    bag = check.bag
    chain = AdapterChain([node.adapter for node in check.nodes])
    names = {check.topic_names[topic.topic]: topic.topic for topic in chain.inputs if topic.topic in check.topic_names}
    run = ReplayRun(chain, NullSink(), ReplaySummary(), truth_topics=())
    is_cut, until_ns = False, (bag.start_ns or 0) + round(TRIAL_S * NS_PER_S)
    try:
        for record in bag.records(names) if names else ():
            if record.log_time_ns > until_ns:
                is_cut = True
                break
            run.process_message(names[record.topic], record)
        run.finish()
    except BadInput as problem:
        check.findings.errors.append(f"{bag.path}: {problem}")
        return
    span = f"in the first {TRIAL_S:.0f} s: " if is_cut else ""
    for node in check.nodes:
        _check_use(check, node, run.last_time_ns or 0, span)
    if not check.findings.errors:
        check_sigmas(check, until_ns)


def _check_use(check: BagCheck, node: CheckedNode, last_ns: int, span: str) -> None:
    """Report inputs of which a node used at most half, and inputs with two publishers."""
    for text in node.adapter.health.first_duplicate_publishers.values():
        check.report(False, f"{check.bag.path}: {span}{text}; outputs based on both are not VALID")
    records, factory = node.adapter.health.records, RosbagsFactory()
    for health in node.adapter.health.messages(factory, last_ns):
        line = low_use_text(health) if health.received >= _FEWEST else ""
        if not line:
            continue
        word = most_frequent_rejection(health)[0]
        line_text = f"{check.bag.path}: {span}{node.adapter.node_name}: {line}"
        if not health.accepted and word in _reason_names(_CONFIGURATION_REASONS):
            check.findings.errors.append(line_text)
        elif 2 * health.rejected <= health.received or word in _reason_names(_WEATHER_REASONS):
            check.findings.warnings.append(line_text)
        else:
            share = f" ({100.0 * health.rejected / health.received:.0f} % not used)"
            check.findings.unused_inputs.append(
                line_text + share + _reason_and_advice(records[health.topic].last_rejection, word)
            )


def _reason_names(reasons: Sequence[Reason]) -> Iterator[str]:
    return (reason.word for reason in reasons)


def _reason_and_advice(last: Any, word: str) -> str:
    """Return the advice for a reason, after the text of the last rejection if it has this reason."""
    node_text = f": {shorten(last.text, LONGEST_TEXT)}" if last is not None and last.reason.word == word else ""
    advice = next((advice for reason, advice in _ADVICE.items() if reason.word == word), "")
    return f"{node_text}; {advice}" if advice else node_text

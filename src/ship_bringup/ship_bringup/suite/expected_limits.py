"""Expected availability at a suite's limits, from a recording that is replayed through the nodes of the suite."""

import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag, with_bag_progress
from ship_bags.topic_names import TRUTH_PREFIX
from ship_replay.offline.replay import ADAPTERS, replay
from ship_watch.safety.availability import REQUIRED_SHARE, START_UP_S, Availability, AvailabilityRecord
from ship_watch.safety.functions import QUANTITIES
from ship_watch.safety.limits import Limits
from ship_watch.topics import monitored_topic


def expected_limits(suite_file: Path | None, bag: Path, namespace: str, limits: Limits) -> list[str]:
    """Return lines of text: expected availability for each limit, proposed limits, and how to adopt them.

    Args:
        suite_file: path of the suite file; None for the file attached to the bag.
        bag: recording of the suite's inputs.
        namespace: namespace of the ship in the bag.
        limits: limits of the ship.

    Raises:
        BadInput: bag or suite file cannot be used, or the outputs are not sufficient to propose a limit.
    """
    record = AvailabilityRecord(limits)
    with tempfile.TemporaryDirectory(prefix="ship_limits_") as folder:
        outputs = Path(folder) / "outputs.mcap"
        summary = replay(bag, outputs, ADAPTERS, suite_file, namespace, with_bag_progress)
        with read_bag(outputs) as replayed:
            topics = {
                name
                for name, kind in replayed.topics.items()
                if monitored_topic(name, kind) and not name.startswith(TRUTH_PREFIX)
            }
            for each in with_bag_progress(replayed.records(topics), replayed):
                record.process_message(each.topic, each.decode(), each.log_time_ns)
    found = [one for one in map(record.availability, QUANTITIES) if one is not None]
    if not found:
        reason = f"no limit can be proposed: after the first {START_UP_S:.0f} s no quantity is SAFE with any limit"
        raise BadInput(reason, file=bag)
    return [
        f"{summary.duration_s:.0f} s of {bag} through the nodes of this suite, without the first {START_UP_S:.0f} s:",
        "",
        *_table(found),
        "",
        *_explanation(found),
        "",
        "Nothing is adopted. To adopt proposed limits, or those of your task, write them into a file for --limits:",
        "",
        *(f"{one.quantity}_arcsec: {one.proposed_arcsec}" for one in found),
    ]


def _table(found: Sequence[Availability]) -> Iterator[str]:
    yield f"{'':10}{'±95 %, median':>14}{'limit':>9}{'SAFE':>9}{'proposed':>11}{'SAFE':>9}"
    for one in found:
        limit, proposed = f"{one.limit_arcsec:g}″", f"{one.proposed_arcsec:g}″"
        shares = (f"{_percent(share):>9}" for share in (one.share, one.proposed_share))
        yield f"{one.quantity:10}{one.median_arcsec:13.1f}″{limit:>9}{next(shares)}{proposed:>11}{next(shares)}"


def _explanation(found: Sequence[Availability]) -> Iterator[str]:
    yield "SAFE: share of time in which the quantity is SAFE. Only the time counts in which the limit alone decides."
    yield f"proposed: the lowest round limit with which this is SAFE for {_percent(REQUIRED_SHARE)} of that time."
    for one in found:
        if one.other:
            first, share = next(iter(one.other.items()))
            yield (
                f"{one.quantity}: not SAFE for {_percent(1.0 - one.decisive_share)} of the time, whatever the limit. "
                f"Most frequent reason ({_percent(share)} of the time): {first}."
            )
    yield "The accuracies are those that the filters publish. In another sea, sky or suite they differ."


def _percent(share: float) -> str:
    """Return a share in percent, rounded down, so that 100 % means always."""
    return f"{math.floor(share * 100.0 + 1e-9)} %"

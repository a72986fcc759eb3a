"""A suite in a bag or a black box: its monitored messages from any time on."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.command_line import launcher
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT
from ship_bags.topic_names import TRUTH_PREFIX, relative_topics
from ship_watch.topics import monitored_topic

OUTPUTS = ("ship/attitude", "theodolite/pointing")
LATCHED_TOPICS = ("ship/alerts", "ship/alignment", "theodolite/calibration")
"""Topics whose last message stays valid until the next message."""

_NOMINAL_TOPICS = LATCHED_TOPICS[1:]
"""Topics whose first message in the bag gives the nominal values, with which later values are compared."""

THINNING_PERIOD_NS = 100_000_000
"""Period in which one message of a topic is decoded, ns, if the topic's newest message is enough.

The monitor evaluates the suite with the same period."""


@dataclass(frozen=True)
class RecordedMessage:
    """One monitored message: its relative topic, the decoded message, and its log time, ns."""

    topic: str
    message: Any
    log_time_ns: int


class RecordedSuite:
    """An open bag of one suite. Several readers may use it at the same time.

    Attributes:
        path: path of the bag.
        start_ns: log time of the first message.
        end_ns: log time of the last message.
        is_simulated: True if the bag contains the truth or a scenario, unlike a recording of a ship.
        notes: lines about missing data and the consequence of each.

    Args:
        path: an MCAP file or a rosbag2 folder.
        namespace: namespace of the suite in the bag, with or without slashes; empty if the bag contains only one suite.

    Raises:
        BadInput: the bag cannot be read, contains several suites and no namespace is given, or does not contain the
            given suite.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self.path = path
        self._bag = read_bag(path)
        names = relative_topics(self._bag.topics, namespace or self._only_namespace())
        if namespace and not names:
            raise BadInput(f"there is no topic in the namespace /{namespace.strip('/')}", file=path)
        usable = {
            relative: name for relative, name in names.items() if monitored_topic(relative, self._bag.topics[name])
        }
        self._topics = {name: (relative, monitored_topic(relative)) for relative, name in usable.items()}
        self.start_ns, self.end_ns = self._bag.start_ns or 0, self._bag.end_ns or 0
        has_truth = any(relative.startswith(TRUTH_PREFIX) for relative in names)
        self.is_simulated = has_truth or SCENARIO_ATTACHMENT in self._bag.attachments
        self.notes = self._missing_data_notes(set(usable), has_truth)
        self._reported_topics: set[str] = set()
        self._latched = {name: usable[name] for name in LATCHED_TOPICS if name in usable}
        self._first_nominal = [
            next(self._bag.records({usable[name]}), None) for name in _NOMINAL_TOPICS if name in usable
        ]

    def messages(self, since_ns: int) -> Iterator[RecordedMessage]:
        """Yield the alerts, alignment and calibration valid at a log time, then the monitored messages from then on.

        The first alignment and calibration of the bag precede these messages, because they give the nominal values.
        Messages that cannot be decoded are skipped.

        Args:
            since_ns: the log time, ns; messages before it are yielded with this log time.
        """
        last = [self._bag.last_before(topic, since_ns) for topic in self._latched.values()]
        first = [record for record in self._first_nominal if record is not None and record.log_time_ns < since_ns]
        for record in (*first, *last):
            if record is not None:
                yield from self._decode(record, since_ns)
        taken_ns: dict[str, int] = {}
        for record in self._bag.records(self._topics, since_ns):
            row = self._topics[record.topic][1]
            if row is not None and not row.keeps_every_message:
                step = record.log_time_ns // THINNING_PERIOD_NS
                if taken_ns.get(record.topic) == step:
                    continue
                taken_ns[record.topic] = step
            yield from self._decode(record, record.log_time_ns)

    def close(self) -> None:
        """Close the bag."""
        self._bag.close()

    def _decode(self, record: BagRecord, log_time_ns: int) -> Iterator[RecordedMessage]:
        try:
            yield RecordedMessage(self._topics[record.topic][0], record.decode(), log_time_ns)
        except BadInput as problem:
            if record.topic not in self._reported_topics:
                print(f"monitor: message skipped: {problem}", file=sys.stderr, flush=True)
            self._reported_topics.add(record.topic)

    def _only_namespace(self) -> str:
        """Return the namespace of the monitored topics; empty if no topic is monitored."""
        found = {space for name, kind in self._bag.topics.items() if (space := _namespace_of(name, kind)) is not None}
        if len(found) > 1:
            named = ", ".join(f"/{space}" for space in sorted(found))
            raise BadInput(f"the bag contains suites in {named}: select one with --namespace", file=self.path)
        return found.pop() if found else ""

    def _missing_data_notes(self, usable: set[str], has_truth: bool) -> tuple[str, ...]:
        """Return lines about missing data and their consequence."""
        name = self.path.name
        if usable.isdisjoint(OUTPUTS):
            outputs = f"no {OUTPUTS[0]} and no {OUTPUTS[1]}"
            remedy = f"make them with '{launcher()} ship_replay replay {self.path} --out OUT.mcap', then open OUT.mcap"
            return (f"{name} contains {outputs}, only inputs: {remedy}",)
        lines = [] if has_truth else [f"{name} contains no truth: innovations are shown, errors are not"]
        if OUTPUTS[0] not in usable:
            lines.append(f"{name} contains no {OUTPUTS[0]}: heading, pitch and roll are unknown")
        return tuple(lines)


def _namespace_of(name: str, type_name: str) -> str | None:
    """Return the namespace of a monitored topic of a bag; None if the topic is not monitored in any namespace."""
    words = name.strip("/").split("/")
    for length in range(len(words)):
        if monitored_topic("/".join(words[length:]), type_name) is not None:
            return "/".join(words[:length])
    return None

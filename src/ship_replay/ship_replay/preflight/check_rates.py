"""Says before the voyage which inputs of a bag come too seldom for a suite configuration."""

from collections.abc import Sequence
from pathlib import Path

from ship_bags.mcap.bag_reader import Bag
from ship_bags.topic_names import relative_topics
from ship_replay.offline.gaps import MessageTimes, exceeded
from ship_replay.preflight.check_config import CheckedNode, Findings


def check_rates(path: Path, nodes: Sequence[CheckedNode], bag: Bag, namespace: str, findings: Findings) -> None:
    """Compare the gaps between the messages of a bag with what the parameters allow.

    Args:
        path: file of the configuration.
        nodes: what it is about.
        bag: a bag recorded with the sensors of the voyage.
        namespace: namespace of the ship in the bag.
        findings: takes what is found.
    """
    found = relative_topics(bag.topics, namespace)
    taken = {topic.topic for node in nodes for topic in node.adapter.inputs} & found.keys()
    times = {topic: MessageTimes() for topic in taken}
    relative_names = {found[topic]: topic for topic in taken}
    for record in bag.records(relative_names) if taken else ():
        times[relative_names[record.topic]].add(record)
    for node in nodes:
        for excess in exceeded(node.config, times, str(bag.path)):
            line = node.file.line_of(excess.limit.parameter)
            text = f"{path}:{line}: {excess.text}" if line else f"{path}: {excess.text}"
            where = findings.errors if excess.mostly else findings.warnings
            # Two nodes may have the parameter by default.
            if text not in where:
                where.append(text)

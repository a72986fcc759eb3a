"""Says before the voyage what the nodes of a suite configuration would refuse of a bag: its beginning, tried out."""

from collections.abc import Sequence

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import relative_topics
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.status_course import hardly_used, most_frequent_refusal
from ship_replay.preflight.check_config import CheckedNode, Findings

TRIAL_S = 20.0
_FEWEST = 10
_OF_THE_CONFIGURATION = frozenset(
    ("attitude_conflict", "bad_quaternion", "frame", "gate", "light_conflict", "units", "unknown_sensor")
)
"""Where these refuse all of an input, no change of the weather will mend it."""



def check_trial(nodes: Sequence[CheckedNode], bag: Bag, namespace: str, findings: Findings) -> None:
    """Give the beginning of a bag to the nodes and name the inputs of which they used hardly anything.

    Args:
        nodes: of the configuration; they are used up.
        bag: a bag recorded with the sensors of the voyage.
        namespace: namespace of the ship in the bag.
        findings: takes what is found.
    """
    chain = AdapterChain([node.adapter for node in nodes])
    found = relative_topics(bag.topics, namespace)
    names = {found[topic.topic]: topic.topic for topic in chain.inputs if topic.topic in found}
    last_ns = 0
    for record in bag.records(names) if names else ():
        if record.log_time_ns > (bag.start_ns or 0) + TRIAL_S * NS_PER_S:
            break
        last_ns = record.log_time_ns
        try:
            chain.handle(names[record.topic], record.decode(), last_ns)
        except BadInput as problem:
            findings.errors.append(f"{bag.path}: {problem}")
            return
    for node in nodes:
        for message in node.adapter.health.messages(RosbagsFactory(), last_ns):
            line = hardly_used(message) if message.received >= _FEWEST else ""
            if line:
                wrong = not message.accepted and most_frequent_refusal(message)[0] in _OF_THE_CONFIGURATION
                where = findings.errors if wrong else findings.warnings
                where.append(f"{bag.path}: in the first {TRIAL_S:.0f} s: {node.adapter.node_name}: {line}")

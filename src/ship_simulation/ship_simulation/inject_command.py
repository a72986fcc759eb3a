"""``inject``: add faults to an existing bag, of any ship with any devices."""

import argparse
import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag, with_bag_progress
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter, TypeDefinition
from ship_bags.output_files import add_force_option, check_file
from ship_bags.stamps import ns_from_stamp
from ship_bags.topic_names import TRUTH_PREFIX, add_bag_name_options, relative_topics
from ship_simulation.faults.device_geometry import SuiteOptics, optics_of_suite
from ship_simulation.faults.faults import Delivery, apply_faults
from ship_simulation.scenario.fault import Fault, kind_rows
from ship_simulation.scenario.scenario_file import load_faults
from ship_simulation.simulate_command import parse_seed

FAULTS_ATTACHMENT = "faults.yaml"
"""Name of the attachment that contains the file of faults."""

_BAG_RECORD = "rosbag2"
"""Name of the metadata record in which rosbag2 describes the file. This record is not valid in another file."""

_DESCRIPTION = """\
Adds faults to a bag: a simulated one, or a recording (.mcap file or rosbag2 folder). The fault file contains a group
`faults` as a scenario does: by name, each with topic, kind, start_s, end_s and the sizes of its kind, with units in the
names. Times start at the bag's first message. Unaffected messages stay unchanged, to the byte; the truth (truth/*) is
never changed; attachments are copied. The same bag, faults and seed give the same bytes.
"""


def injectable_topics(bag: Bag, namespace: str = "") -> dict[str, str]:
    """Return relative topic → type of the topics that faults may affect: all but the truth."""
    topics = relative_topics(bag.topics, namespace)
    return {name: bag.topics[full] for name, full in topics.items() if not name.startswith(TRUTH_PREFIX)}


def optics_of_bag(bag: Bag, faults: Mapping[str, Fault], namespace: str = "") -> SuiteOptics:
    """Return the cameras of the devices that the attached suite file describes.

    Raises:
        BadInput: the suite file is invalid, or a fault needs a camera that is not described.
    """
    text = bag.attachments.get(SUITE_ATTACHMENT, b"").decode("utf-8", errors="replace")
    optics = optics_of_suite(text) if text else SuiteOptics()
    topics = injectable_topics(bag, namespace)
    for name, fault in faults.items():
        missing = optics.missing_camera_reason(fault, topics[fault.topic])
        if missing:
            reason = f"fault '{name}' of kind {fault.kind}: {missing}; add it to the bag's {SUITE_ATTACHMENT}"
            raise BadInput(reason, file=bag.path)
    return optics


@dataclass(frozen=True)
class FaultEffect:
    """Effect of one fault by itself on the messages of its topic.

    Attributes:
        times_ns: original arrival times of the affected messages, in order.
        dropped: number of messages that do not arrive.
        added: number of additional messages.
        changed: number of messages with changed bytes.
        delayed: number of messages with unchanged bytes and another arrival time.
    """

    times_ns: list[int]
    dropped: int
    added: int
    changed: int
    delayed: int

    @property
    def text(self) -> str:
        """The counts that are not zero, as text."""
        counts = {name: getattr(self, name) for name in ("changed", "dropped", "delayed", "added")}
        return ", ".join(f"{count} messages {name}" for name, count in counts.items() if count) or "no message affected"


@dataclass(frozen=True)
class Injection:
    """A bag with faults.

    Attributes:
        path: path of the bag.
        faults: name → fault; checked against :func:`injectable_topics`.
        seed: seed of the faults' draws.
        namespace: namespace of the ship in the bag.
    """

    path: Path
    faults: Mapping[str, Fault]
    seed: int
    namespace: str = ""

    def records(self, bag: Bag) -> Iterator[BagRecord]:
        """Yield all messages in order of arrival; the bytes of unaffected messages are unchanged.

        Args:
            bag: the open bag.

        Raises:
            BadInput: a fault needs a camera that the bag does not describe.
        """
        optics = optics_of_bag(bag, self.faults, self.namespace)
        names = relative_topics(bag.topics, self.namespace)
        affected_topics = {names[fault.topic] for fault in self.faults.values()}
        with ExitStack() as stack:
            streams = [_unaffected_records(bag, affected_topics)]
            # Each topic with faults is read separately, so that its delayed messages do not block other topics.
            for name in sorted(affected_topics):
                other = stack.enter_context(read_bag(self.path))
                streams.append(self._faulty_records(other, name, _deliveries(other, name), optics))
            for _, _, record in heapq.merge(*streams, key=lambda entry: entry[:2]):
                yield record

    def effect(self, name: str) -> FaultEffect:
        """Return the effect of a fault by itself; a fault may affect no message, for example without a light in view.

        Args:
            name: name of the fault.

        Raises:
            BadInput: the fault needs a camera that the bag does not describe.
        """
        alone = Injection(self.path, {name: self.faults[name]}, self.seed, self.namespace)
        with read_bag(self.path) as bag:
            optics = optics_of_bag(bag, alone.faults, self.namespace)
            topic = relative_topics(bag.topics, self.namespace)[self.faults[name].topic]
            given: dict[int, tuple[int, bytes | None]] = {}
            found: dict[int, list[tuple[int, bytes | None]]] = {}

            def record_inputs() -> Iterator[Delivery]:
                for delivery in _deliveries(bag, topic):
                    given[delivery.order] = delivery.log_time_ns, delivery.data
                    yield delivery

            for at_ns, order, record in alone._faulty_records(bag, topic, record_inputs(), optics):
                found.setdefault(order, []).append((at_ns, record.data))
        pairs = [(given[order], found.get(order, [])) for order in sorted(given)]
        affected = [(message, others) for message, others in pairs if others != [message]]
        replaced = [(message, others[0]) for message, others in affected if others and message not in others]
        return FaultEffect(
            times_ns=[message[0] for message, _ in affected],
            dropped=sum(not others for _, others in affected),
            added=sum(len(others) - 1 for _, others in affected if others),
            changed=sum(first[1] != message[1] for message, first in replaced),
            delayed=sum(first[1] == message[1] for message, first in replaced),
        )

    def _faulty_records(
        self, bag: Bag, name: str, deliveries: Iterator[Delivery], optics: SuiteOptics
    ) -> Iterator[tuple[int, int, BagRecord]]:
        faults = {
            key: fault
            for key, fault in self.faults.items()
            if relative_topics([name], self.namespace).get(fault.topic) == name
        }
        type_name, store = bag.topics[name], bag.store
        for delivery in apply_faults(deliveries, type_name, faults, bag.start_ns, self.seed, optics):
            data = delivery.data
            if data is None:
                data = bytes(store.serialize_cdr(delivery.message, type_name, little_endian=True))
            at_ns = delivery.log_time_ns
            record = BagRecord(name, type_name, at_ns, data, store, sequence=0, publish_time_ns=at_ns)
            yield at_ns, delivery.order, record


def _unaffected_records(bag: Bag, hit: set[str]) -> Iterator[tuple[int, int, BagRecord]]:
    for order, record in enumerate(bag.records()):
        if record.topic not in hit:
            yield record.log_time_ns, order, record


def _deliveries(bag: Bag, name: str) -> Iterator[Delivery]:
    """Yield the messages of a topic of a bag; a message that cannot be decoded passes unchanged."""
    for order, record in enumerate(bag.records()):
        if record.topic == name:
            try:
                message = record.decode()
                stamp_ns = ns_from_stamp(message.header.stamp) if hasattr(message, "header") else None
            except BadInput:
                message, stamp_ns = None, None
            yield Delivery(message, record.log_time_ns, stamp_ns, order, record.data)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    kinds = "\n".join(kind_rows())
    parser = CommandParser(
        package="ship_simulation",
        prog="inject",
        example="bags/demo.mcap --faults bags/faults/demo.yaml --out faulty.mcap",
        description=_DESCRIPTION,
        epilog=f"kinds of faults:\n{kinds}\n\nexit code: 0 written; 2 bad input or usage; 130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument("--faults", type=Path, required=True, metavar="FILE", help="faults to add (YAML)")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.mcap", help="bag to write")
    parser.add_argument("--seed", type=parse_seed, default=1, metavar="N", help="seed of the faults' random draws (1)")
    add_bag_name_options(parser)
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    if options.out.resolve() == options.bag.resolve():
        raise BadInput("the output would overwrite the input", file=options.out)
    with read_bag(options.bag) as bag:
        faults = load_faults(options.faults, injectable_topics(bag, options.namespace), "in the bag")
        optics_of_bag(bag, faults, options.namespace)
        injection = Injection(options.bag, faults, options.seed, options.namespace)
        count = _write(bag, injection, options.out, options.faults.read_bytes())
        for problem in bag.problems:
            print(f"warning: {problem}")
    print(f"{options.out}: {count} messages, {len(faults)} faults, seed {options.seed}")
    for name, fault in faults.items():
        print(f"{name}: {fault.kind} of {fault.topic}, {fault.window_text}: {injection.effect(name).text}")
    return EXIT_DONE


def _write(bag: Bag, injection: Injection, path: Path, text: bytes) -> int:
    """Write the bag with its faults; return the number of its messages."""

    def define(type_name: str) -> TypeDefinition:
        return TypeDefinition(bag.store.generate_msgdef(type_name, ros_version=2)[0], bag.store.hash_rihs01(type_name))

    names = relative_topics(bag.topics, injection.namespace)
    affected_topics = {names[fault.topic] for fault in injection.faults.values()}
    with BagWriter(path, define=define) as writer:
        for name, content in bag.attachments.items():
            writer.add_attachment(name, content)
        writer.add_attachment(FAULTS_ATTACHMENT, text)
        for name, entries in bag.metadata.items():
            if name != _BAG_RECORD:
                writer.add_metadata(name, entries)
        writer.add_metadata("injection", {"seed": str(injection.seed)})
        for topic, type_name in bag.topics.items():
            writer.add_topic(topic, type_name, topic in bag.latched_topics)
        for record in with_bag_progress(injection.records(bag), bag):
            sequence = None if record.topic in affected_topics else record.sequence
            writer.write_raw(
                record.topic, record.type_name, record.data, record.log_time_ns, record.publish_time_ns, sequence
            )
        return writer.message_count

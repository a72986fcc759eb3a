"""``inject``: add faults to a bag of any ship."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, read_bag, with_bag_progress
from ship_bags.mcap.bag_writer import BagWriter, TypeDefinition
from ship_bags.output_files import add_force_option, check_file
from ship_bags.renamed_topics import add_bag_name_options
from ship_bags.topic_names import relative_topics
from ship_simulation.faults.injection import Injection, injectable_topics, optics_of_bag
from ship_simulation.scenario.fault import kind_rows
from ship_simulation.scenario.fault_file import load_faults
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

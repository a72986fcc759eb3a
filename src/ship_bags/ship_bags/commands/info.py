"""``info``: content of a bag, and the suite file attached to it.

The messages are counted one by one, so that the counts are right for a damaged bag, too.
"""

import argparse
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command, with_progress
from ship_bags.errors import BadInput, one_line
from ship_bags.mcap.bag_file import BagFile
from ship_bags.mcap.bag_reader import Bag, open_files
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT
from ship_bags.mcap.folder import MessageCount
from ship_bags.output_files import add_force_option, check_file, write_atomically
from ship_bags.stamps import NS_PER_S, utc_text
from ship_bags.topic_names import add_remap_option

_DESCRIPTION = """\
Lists the content of a bag: size, start, end and duration; topics with type, number of messages, mean rate in Hz and
seconds from the start to their first and last message; attachments; problems. The whole bag is read and counted. With
--suite it only writes the attached configuration of the suite.
"""
_EPILOG = "exit code: 0 printed or written, also for a damaged bag; 2 bad input or usage, with one line of reason"
_STDOUT = "-"
_LONGEST_ENTRY = 200
"""Maximum length of a metadata entry that is shown; rosbag2 puts a description of its file into one entry."""

_ROLES = {SUITE_ATTACHMENT: "the suite's configuration", SCENARIO_ATTACHMENT: "the scenario of a simulated bag"}


@dataclass
class TopicContent(MessageCount):
    """Topic: its type, and the number and times of its messages."""

    type_name: str

    @property
    def rate_hz(self) -> float | None:
        """Mean rate from the first to the last message; None without two messages at different times."""
        if self.start_ns is None or self.end_ns is None or self.end_ns == self.start_ns:
            return None
        return (self.message_count - 1) * NS_PER_S / (self.end_ns - self.start_ns)


@dataclass
class BagContent:
    """Content of a bag.

    Attributes:
        files: name → size, bytes.
        topics: name → content, sorted by name.
        attachments: name → content.
        metadata: name → entries.
        problems: one line per problem; if empty, footer, index and checksums are valid.
    """

    files: dict[str, int]
    topics: dict[str, TopicContent]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    problems: list[str]

    @property
    def start_ns(self) -> int | None:
        """Log time of the first message."""
        return min((topic.start_ns for topic in self.topics.values() if topic.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Log time of the last message."""
        return max((topic.end_ns for topic in self.topics.values() if topic.end_ns is not None), default=None)

    @property
    def message_count(self) -> int:
        """Number of readable messages, including the copies of latched messages in later files of a folder."""
        return sum(topic.message_count for topic in self.topics.values())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``info`` and return the exit code."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="info",
        example="bags/demo.mcap",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="bag to read: .mcap file or rosbag2 folder")
    add_remap_option(parser)
    outputs = parser.add_mutually_exclusive_group()
    outputs.add_argument("--json", action="store_true", help="print JSON; times are nanoseconds since 1970, UTC")
    outputs.add_argument(
        "--suite",
        nargs="?",
        const=_STDOUT,
        metavar="FILE",
        help="write the attached suite file to FILE, or to stdout without FILE",
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.suite is not None:
        _write_suite_file(options.bag, options.suite, options.force)
        return EXIT_DONE
    content = bag_content(options.bag)
    if options.json:
        print(json.dumps(_json_content(content), indent=2))
    else:
        for line in _lines(options.bag, content):
            print(line)
    return EXIT_DONE


def _write_suite_file(bag: Path, target: str, force: bool) -> None:
    if target != _STDOUT:
        check_file(Path(target), force)
    text = attached_suite(bag)
    if target != _STDOUT:
        write_atomically(Path(target), text)
        return
    sys.stdout.flush()
    sys.stdout.buffer.write(text)
    sys.stdout.buffer.flush()


def bag_content(path: Path) -> BagContent:
    """Read a whole bag and count its messages.

    Raises:
        BadInput: the bag cannot be opened; see :func:`ship_bags.mcap.bag_reader.open_files`.
    """
    files = open_files(path)
    topics: dict[str, TopicContent] = {}
    with Bag(path, files) as bag:
        for file in files:
            _count(topics, file)
        sizes = {file.path.name: file.size_bytes for file in files}
        return BagContent(sizes, dict(sorted(topics.items())), bag.attachments, bag.metadata, bag.problems)


def attached_suite(path: Path) -> bytes:
    """Return the suite file attached to a bag, or the last one if several are attached.

    Raises:
        BadInput: no suite file is attached, or the bag cannot be opened.
    """
    files = open_files(path)
    for file in files:
        file.close()
    attached = {known: data for file in files for known, data in file.attachments.items()}
    if SUITE_ATTACHMENT not in attached:
        only = f", only {', '.join(sorted(attached))}" if attached else ""
        problems = "".join(f"; {problem}" for file in files for problem in file.problems)
        raise BadInput(
            f"no suite file ({SUITE_ATTACHMENT}) is attached to it{only}: take the file with which the nodes ran, and "
            f"give it to replay by --config{problems}",
            file=path,
        )
    return attached[SUITE_ATTACHMENT]


def _count(counts: dict[str, TopicContent], file: BagFile) -> None:
    for channel in file.channels.values():
        schema = file.schemas.get(channel.schema_id)
        counts.setdefault(channel.topic, TopicContent("unknown" if schema is None else schema.name))
    topics = {number: counts[channel.topic] for number, channel in file.channels.items()}
    start_ns = min((place.start_ns for place in file.chunks), default=0)
    end_ns = max((place.end_ns for place in file.chunks), default=0)
    messages = itertools.chain.from_iterable(map(file.messages, file.chunks))
    for message in with_progress(messages, file.path.name, start_ns, end_ns, lambda message: message.log_time):
        if message.channel_id in topics:
            topics[message.channel_id].add(message.log_time)


def _lines(path: Path, content: BagContent) -> Iterator[str]:
    files = f" in {len(content.files)} files" if len(content.files) > 1 else ""
    yield one_line(f"{path}: {sum(content.files.values())} bytes{files}, {content.message_count} messages")
    if content.start_ns is not None and content.end_ns is not None:
        length_s = (content.end_ns - content.start_ns) / NS_PER_S
        yield f"{utc_text(content.start_ns)} to {utc_text(content.end_ns)}, {length_s:.3f} s"
    yield ""
    yield from _topic_table(content)
    yield ""
    for name, data in sorted(content.attachments.items()):
        role = f", {_ROLES[name]}" if name in _ROLES else ""
        yield one_line(f"attached: {name}, {len(data)} bytes{role}")
    for name, entries in sorted(content.metadata.items()):
        yield one_line(f"metadata: {name}: {', '.join(f'{key}={_entry(value)}' for key, value in entries.items())}")
    for problem in content.problems:
        yield one_line(f"problem: {problem}")
    if not content.problems:
        yield "complete: footer, index and checksums are valid"


def _entry(value: str) -> str:
    return value if len(value) <= _LONGEST_ENTRY else f"({len(value)} characters)"


def _topic_table(content: BagContent) -> Iterator[str]:
    rows = [("topic", "type", "messages", "rate Hz", "first s", "last s")]
    start_ns = content.start_ns
    rows += [
        (one_line(name), one_line(topic.type_name), str(topic.message_count), *_times(topic, start_ns))
        for name, topic in content.topics.items()
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        names = [cell.ljust(width) for cell, width in zip(row[:2], widths[:2], strict=True)]
        numbers = [cell.rjust(width) for cell, width in zip(row[2:], widths[2:], strict=True)]
        yield "  ".join(names + numbers)


def _times(topic: TopicContent, start_ns: int | None) -> tuple[str, str, str]:
    rate = "-" if topic.rate_hz is None else f"{topic.rate_hz:.3g}"
    if start_ns is None or topic.start_ns is None or topic.end_ns is None:
        return rate, "-", "-"
    return rate, f"{(topic.start_ns - start_ns) / NS_PER_S:.3f}", f"{(topic.end_ns - start_ns) / NS_PER_S:.3f}"


def _json_content(content: BagContent) -> dict[str, Any]:
    return {
        "files": [{"name": name, "bytes": size} for name, size in content.files.items()],
        "start_ns": content.start_ns,
        "end_ns": content.end_ns,
        "message_count": content.message_count,
        "topics": [
            {
                "name": name,
                "type": topic.type_name,
                "message_count": topic.message_count,
                "rate_hz": topic.rate_hz,
                "first_ns": topic.start_ns,
                "last_ns": topic.end_ns,
            }
            for name, topic in content.topics.items()
        ],
        "attachments": [{"name": name, "bytes": len(data)} for name, data in sorted(content.attachments.items())],
        "metadata": content.metadata,
        "problems": content.problems,
    }


if __name__ == "__main__":
    raise SystemExit(main())

"""Content of a bag, counted message by message, so that the counts are right for a damaged bag, too."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Message

from ship_bags.command_line import with_progress
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_file import BagFile
from ship_bags.mcap.bag_reader import Bag, open_files
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.stamps import NS_PER_S


@dataclass
class TopicContent:
    """Topic: type, number of messages, and log times of the first and the last message (None without messages)."""

    type_name: str
    message_count: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def add(self, log_time_ns: int) -> None:
        """Count a message."""
        self.message_count += 1
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        self.last_ns = log_time_ns if self.last_ns is None else max(self.last_ns, log_time_ns)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate from the first to the last message; None without two messages at different times."""
        if self.first_ns is None or self.last_ns is None or self.last_ns == self.first_ns:
            return None
        return (self.message_count - 1) * NS_PER_S / (self.last_ns - self.first_ns)


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
    topics: dict[str, TopicContent] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def start_ns(self) -> int | None:
        """Log time of the first message."""
        return min((topic.first_ns for topic in self.topics.values() if topic.first_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Log time of the last message."""
        return max((topic.last_ns for topic in self.topics.values() if topic.last_ns is not None), default=None)

    @property
    def message_count(self) -> int:
        """Number of readable messages, including the copies of latched messages in later files of a folder."""
        return sum(topic.message_count for topic in self.topics.values())


def bag_content(path: Path) -> BagContent:
    """Read a whole bag and count its messages.

    Raises:
        BadInput: the bag cannot be opened; see :func:`ship_bags.mcap.bag_reader.open_files`.
    """
    files = open_files(path)
    try:
        content = BagContent({file.path.name: file.size_bytes for file in files})
        for file in files:
            content.attachments |= file.attachments
            content.metadata |= file.metadata
            _count(content, file)
        content.topics = dict(sorted(content.topics.items()))
        content.problems = Bag(path, files).problems
        return content
    finally:
        for file in files:
            file.close()


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


def _count(content: BagContent, file: BagFile) -> None:
    for channel in file.channels.values():
        schema = file.schemas.get(channel.schema_id)
        content.topics.setdefault(channel.topic, TopicContent("unknown" if schema is None else schema.name))
    topics = {number: content.topics[channel.topic] for number, channel in file.channels.items()}
    start_ns = min((place.start_ns for place in file.chunks), default=0)
    end_ns = max((place.end_ns for place in file.chunks), default=0)
    for message in with_progress(_messages(file), file.path.name, start_ns, end_ns, lambda message: message.log_time):
        if message.channel_id in topics:
            topics[message.channel_id].add(message.log_time)


def _messages(file: BagFile) -> Iterator[Message]:
    for place in file.chunks:
        yield from file.messages(place)


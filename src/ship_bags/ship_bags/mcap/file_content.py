"""Content of one file of a bag, independent of its storage."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema

from ship_bags.mcap.records import ChunkPlace


@dataclass
class BagFile(ABC):
    """Content of a file of a bag besides its messages, and the places of the messages.

    Attributes:
        path: path of the file, or of the folder if its files are read as one file.
        chunks: places of the messages, in file order.
        recorded_names: topic → its name in the file, for renamed topics.
        side_records: attachments and metadata, in file order.
        problems: one line per problem known so far.
    """

    path: Path
    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    recorded_names: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    side_records: list[Attachment | Metadata] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    @abstractmethod
    def size_bytes(self) -> int:
        """Size on the disk, bytes."""

    @abstractmethod
    def messages(self, place: ChunkPlace) -> list[Message]:
        """Return the messages of one place, in file order; a damaged place gives none, and adds a problem."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def add_problem(self, problem: str) -> None:
        """Add a line to ``problems`` only once, because a place may be read repeatedly."""
        if problem not in self.problems:
            self.problems.append(problem)

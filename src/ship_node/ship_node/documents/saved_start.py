"""The saved document that a node starts from, and what people are told of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from ship_bags.errors import BadInput
from ship_node.documents.saved_document import Files, SavedFormat


class Dated(Protocol):
    """What a node starts from: an alignment, a calibration."""

    @property
    def time_ns(self) -> int:
        """Stamp of the newest data in it, ns; 0 where there is none."""
        ...


Prior = TypeVar("Prior", bound=Dated)


class SavedStart(Generic[Prior]):
    """The saved document that a node starts from: read when the node is made, used as soon as there is a time.

    Args:
        kind: the format.
        path: of the file; empty for none.
        files: where it is read and written.
        start_from: gives the core a content at a time in ns, and returns remarks for the operator.
        to_save: what the core has to save; None where it has nothing yet.
        nothing: why it has nothing, for people.

    Attributes:
        notices: what a log should tell, until somebody has taken it.
        messages: what the core said of the content that it started from.
        is_due: whether a content was read and the core has not been given it yet.

    Raises:
        BadInput: the file is there and cannot be read.
    """

    def __init__(
        self,
        kind: SavedFormat[Prior],
        path: str,
        files: Files,
        start_from: Callable[[Prior, int], list[str]],
        to_save: Callable[[], Prior | None],
        nothing: str,
    ) -> None:
        self._kind, self._path, self._files = kind, path, files
        self._start_from, self._to_save, self._nothing = start_from, to_save, nothing
        self.notices: list[str] = []
        self.messages: list[str] = []
        self._read = kind.load_if_there(Path(path), files) if path else None
        self.is_due = self._read is not None
        if path and not self.is_due:
            self.notices.append(f"no {kind.what} at {path} yet: the filter starts as configured")

    def start(self, now_ns: int) -> None:
        """Give the core what was read when the node was made; its age is judged by the time now, ns."""
        read, self._read, self.is_due = self._read, None, False
        if read is not None:
            self._give(read, now_ns)

    def save(self) -> str:
        """Write what the core has; returns what was done.

        Raises:
            BadInput: there is nothing to save or no file is named, or it cannot be written.
        """
        path, content = self._file(), self._to_save()
        if content is None:
            raise BadInput(self._nothing)
        self._kind.save(path, content, self._files)
        return f"{self._kind.what} saved to {path}"

    def load(self, now_ns: int) -> str:
        """Read the file anew and start from it; returns what was done.

        Raises:
            BadInput: no file is named, or it cannot be read.
        """
        path = self._file()
        self._give(self._kind.load(path, self._files), now_ns)
        return "; ".join([f"{self._kind.what} loaded from {path}", *self.messages])

    def _give(self, content: Prior, now_ns: int) -> None:
        self.messages = self._start_from(content, now_ns)
        told = f"{self._kind.what} {self._path}, {age_words(content.time_ns, now_ns)}"
        self.notices.append("; ".join([told, *self.messages]))

    def _file(self) -> Path:
        if not self._path:
            raise BadInput(f"parameter '{self._kind.what}_file' is empty: set it to the path of the file to use")
        return Path(self._path)


def age_words(time_ns: int, now_ns: int) -> str:
    """How old the data of a saved document are, by the node's clock."""
    if time_ns <= 0:
        return "of unknown age"
    age_s = (now_ns - time_ns) * 1e-9
    if age_s < 0.0:
        return f"from {-age_s:.0f} s in the future"
    return f"{age_s / 86400.0:.1f} d old" if age_s >= 8640.0 else f"{age_s / 60.0:.0f} min old"

"""Saved document that a node starts from, with remarks about the document for the user."""

import errno
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from ship_bags.errors import BadInput
from ship_node.saved_files.saved_document import Files, SavedFormat

_MAX_SIGMA_RATIO = 1.1
"""Ratio of a new sigma to the saved sigma above which the new sigma is worse; lower ratios are due to other stars."""

_FATAL_ERRORS = (
    *(errno.EISDIR, errno.ESPIPE),  # the path is wrong
    *(errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EINTR),  # lack of resources, maybe temporary
)
"""Error numbers for which a node does not start; while the node runs, these errors only prevent automatic saving."""

_CONTENT_ERRORS = (errno.EFBIG, errno.ELOOP)
"""Error numbers for which a file is set aside, like a file with bad content. After other errors a file may be good."""

_NEVER_NS = 1 << 62
"""Time that is never reached, ns."""


class SavedContent(Protocol):
    """Content that a node starts from: an alignment, a calibration."""

    @property
    def time_ns(self) -> int:
        """Stamp of the newest data in the content, ns; 0 if unknown."""
        ...

    def sigmas(self) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return the standard deviations of each quantity, in its units, by a name that contains the device."""
        ...


Prior = TypeVar("Prior", bound=SavedContent)


class SavedStart(Generic[Prior]):
    """Saved document that a node starts from; it is read at construction and used as soon as the node has a time.

    Args:
        kind: the format.
        path: path of the file; empty if the node has no such file.
        files: file operations.
        start_from: starts the core from a content at a time in ns; returns remarks for the operator.
        content_to_save: returns the content to save; None if there is no content yet.
        nothing_text: text for the user about why there is no content yet.

    Attributes:
        notices: log lines that have not been taken yet.
        messages: remarks of the core on the content that it started from.
        autosave_problem: why automatic saving fails at present; empty if it works.
        unreadable_reason: why the file was set aside or cannot be read; empty after a file was saved or read.
        is_pending: True if a content was read and not yet passed to the core.

    Raises:
        BadInput: the path is a folder, a pipe or a device; or the computer has no file descriptors or memory.
    """

    def __init__(
        self,
        kind: SavedFormat[Prior],
        path: str,
        files: Files,
        start_from: Callable[[Prior, int], list[str]],
        content_to_save: Callable[[], Prior | None],
        nothing_text: str,
    ) -> None:
        self._kind, self._path, self._files = kind, path, files
        self._start_from, self._content_to_save, self._nothing_text = start_from, content_to_save, nothing_text
        self.notices: list[str] = []
        self.messages: list[str] = []
        self.autosave_problem = self.unreadable_reason = ""
        self._is_file_kept = False
        # Bytes of the file from which the core's state has developed; None if there is no such file.
        self._origin: bytes | None = None
        self._saved_ns = 0
        self._last_autosave_ns: int | None = None
        self._read, self._content = self._read_usable(Path(path)) if path else (None, None)
        self.is_pending = self._content is not None
        if path and not self.is_pending and not self.unreadable_reason:
            self.notices.append(f"no {kind.kind_name} at {path} yet: the filter starts as configured")

    def start(self, now_ns: int) -> None:
        """Pass the content that was read to the core; ``now_ns`` is the current time, for the age of the content."""
        content, self._content, self.is_pending = self._content, None, False
        if content is not None:
            self._start_core(content, now_ns)

    def note_core_reset(self) -> None:
        """Record that the core was reset, so that the file may now contain more than the core."""
        self._origin, self._saved_ns, self._last_autosave_ns = None, 0, None

    def save(self) -> str:
        """Write the core's content; return a text about the result.

        Raises:
            BadInput: there is no content or no file is named, or the file cannot be written.
        """
        path, content = self._file(), self._content_to_save()
        if content is None:
            raise BadInput(self._nothing_text)
        self._write(path, content)
        return f"{self._kind.kind_name} saved to {path}"

    def next_autosave_ns(self, period_s: float) -> int:
        """Return the timeout-clock time before which :meth:`is_autosave_time` is False."""
        if not self._path or not period_s:
            return _NEVER_NS
        return 0 if self._last_autosave_ns is None else self._last_autosave_ns + round(period_s * 1e9)

    def is_autosave_time(self, waiting_ns: int, period_s: float) -> bool:
        """Return True if the node should save automatically now: once a period, never with period 0.

        The first call begins the first period and returns False. Each True begins the next period.
        """
        if waiting_ns < self.next_autosave_ns(period_s):
            return False
        is_first, self._last_autosave_ns = self._last_autosave_ns is None, waiting_ns
        return not is_first

    def autosave(self) -> None:
        """Write the core's content if its stamp has changed since the last save or start, unless it would be worse.

        The content is worse if a sigma is clearly larger than in the file (:func:`less_certain_quantity`).

        A reason not to save becomes :attr:`autosave_problem`, and a notice when the reason changes.
        """
        try:
            problem = self._save_unless_worse(self._file())
        except BadInput as error:
            problem = str(error)
        if problem != self.autosave_problem:
            self.notices.append(problem or f"{self._kind.kind_name} is saved automatically again to {self._path}")
        self.autosave_problem = problem

    def load(self, now_ns: int) -> str:
        """Read the file again and start from it; return a text about the result.

        Raises:
            BadInput: no file is named, or the file cannot be read or used. The file stays in place.
        """
        path = self._file()
        self._read = self._kind.read_bytes(path, self._files)
        self._start_core(self._kind.parse(path, self._read), now_ns)
        self.unreadable_reason = ""
        return "; ".join([f"{self._kind.kind_name} loaded from {path}", *self.messages])

    def _save_unless_worse(self, path: Path) -> str:
        content = self._content_to_save()
        if content is None or content.time_ns == self._saved_ns:
            return ""
        unreadable_before = self.unreadable_reason
        existing, known = self._read_usable(path)
        if self._is_file_kept:
            return self.unreadable_reason
        if self.unreadable_reason != unreadable_before:
            self.notices.append(self.unreadable_reason)
        # The core's state cannot be worse than the file from which it has developed.
        if known is not None and existing != self._origin:
            worse = less_certain_quantity(content, known)
            if worse:
                return (
                    f"{self._kind.kind_name} not saved automatically: {path} has {worse}; ~/save_alignment replaces it"
                )
        self._write(path, content)
        return ""

    def _read_usable(self, path: Path) -> tuple[bytes | None, Prior | None]:
        """Return the file's bytes and its content, or None twice.

        A file with an unusable content is set aside. A file that cannot be read stays in place.

        Raises:
            BadInput: see the class.
        """
        self._is_file_kept = False
        try:
            written = self._kind.read_if_present(path, self._files)
            if written is None:
                return None, None
            content = self._kind.parse(path, written)
            self.unreadable_reason = ""
            return written, content
        except BadInput as error:
            number = error.__cause__.errno if isinstance(error.__cause__, OSError) else None
            if number in _FATAL_ERRORS:
                raise
            reason = str(error)
            if number is not None and number not in _CONTENT_ERRORS:
                self._is_file_kept = True
                advice = "not saved automatically until readable; ~/save_alignment replaces it"
                self.unreadable_reason = f"{reason}; {advice}"
                return None, None
        try:
            self.unreadable_reason = f"{reason}; set aside as {self._files.set_aside(path)}"
        except OSError as error:
            self._is_file_kept = True
            advice = "remove the file, so that a new one can be saved"
            self.unreadable_reason = f"{reason}; it cannot be renamed ({error.strerror}): {advice}"
        return None, None

    def _write(self, path: Path, content: Prior) -> None:
        self._origin, self._saved_ns = self._kind.save(path, content, self._files), content.time_ns
        self.unreadable_reason = ""

    def _start_core(self, content: Prior, now_ns: int) -> None:
        self.messages = self._start_from(content, now_ns)
        # If there are remarks, only a part of the content was used, or its covariance was inflated.
        self._origin, self._saved_ns = None if self.messages else self._read, content.time_ns
        remark = f"{self._kind.kind_name} {self._path}, {age_text(content.time_ns, now_ns)}"
        self.notices.append("; ".join([remark, *self.messages]))

    def _file(self) -> Path:
        if not self._path:
            raise BadInput(f"parameter '{self._kind.kind_name}_file' is empty: set it to the path of the file to use")
        return Path(self._path)


def less_certain_quantity(content: SavedContent, other: SavedContent) -> str:
    """Return a text about the first quantity whose sigma is clearly smaller in ``other``; empty if there is none.

    A quantity that ``content`` lacks counts as less certain. If a sigma of ``content`` is not finite, the text is about
    this.
    """
    own = content.sigmas()
    if not all(np.all(np.isfinite(sigma)) for sigma in own.values()):
        return "finite numbers, unlike the current state"
    for name, known in other.sigmas().items():
        if name not in own:
            return f"{name}, which is not configured here"
        measured = known > 0.0
        if not np.all(own[name][measured] <= _MAX_SIGMA_RATIO * known[measured]):
            return f"a smaller sigma of {name}"
    return ""


def age_text(time_ns: int, now_ns: int) -> str:
    """Return the age of a saved document's data as text, by the node's clock."""
    if time_ns <= 0:
        return "of unknown age"
    age_s = (now_ns - time_ns) * 1e-9
    if age_s < 0.0:
        return f"from {-age_s:.0f} s in the future"
    return f"{age_s / 86400.0:.1f} d old" if age_s >= 8640.0 else f"{age_s / 60.0:.0f} min old"

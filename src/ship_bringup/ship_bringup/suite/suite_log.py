"""Lines of a suite: on stdout, and in a file of bounded size while stdout does not accept them.

The suite must continue if the reader of stdout has ended or does not read, or if the disk of stdout is full.
"""

import contextlib
import errno
import os
import select
from pathlib import Path

LARGEST_FILE_BYTES = 5_000_000
"""Maximum size of the file; a larger file is renamed to ``NAME.log.1``."""

_WRITE_TIMEOUT_MS = 200


class SuiteLog:
    """Writes lines; it neither raises nor blocks for longer than a fraction of a second.

    Args:
        path: path of the file for lines that stdout does not accept.
        descriptor: file descriptor of stdout; that of stderr for the log of warnings.
    """

    def __init__(self, path: Path, descriptor: int = 1) -> None:
        self._path, self._descriptor = path, descriptor
        self._missed_count = 0

    def write(self, line: str) -> None:
        """Write a line, given without a newline, to stdout or else to the file."""
        try:
            if self._missed_count:
                self._write_to_stdout(
                    f"[suite] {self._missed_count} lines that were not accepted here are in {self._path}"
                )
                self._missed_count = 0
            self._write_to_stdout(line)
        except OSError as problem:
            if not self._missed_count:
                reason = os.strerror(problem.errno or errno.EIO)
                self._append_to_file(f"[suite] lines continue here, because stdout does not accept them: {reason}")
            self._missed_count += 1
            self._append_to_file(line)

    def _write_to_stdout(self, line: str) -> None:
        """Write a line to stdout.

        Raises:
            OSError: stdout does not accept the line.
        """
        data = _bytes(line)
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        while data:
            # A pipe with room accepts PIPE_BUF bytes at once; writing more bytes could wait for the reader.
            if not poll.poll(0 if self._missed_count else _WRITE_TIMEOUT_MS):
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
            data = data[os.write(self._descriptor, data[: select.PIPE_BUF]) :]

    def _append_to_file(self, line: str) -> None:
        """Append a line to the file, which the logs of stdout and stderr may share; on failure the line is lost."""
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        with contextlib.suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self._path, flags, 0o644)
            try:
                os.write(file, _bytes(line))
                is_full = os.fstat(file).st_size > LARGEST_FILE_BYTES
            finally:
                os.close(file)
            if is_full:
                self._path.replace(f"{self._path}.1")


def log_path(namespace: str) -> Path:
    """Return the path of a suite's own log, in the folder of ROS's logs."""
    home = os.environ.get("ROS_HOME") or "~/.ros"
    folder = Path(os.environ.get("ROS_LOG_DIR") or f"{home}/log").expanduser()
    return folder / f"{'_'.join(['suite', *namespace.split('/')] if namespace else ['suite'])}.log"


def _bytes(line: str) -> bytes:
    return f"{line}\n".encode("utf-8", errors="replace")

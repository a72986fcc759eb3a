"""Brings what was written to a file onto the disk, in a thread of its own.

What was handed to the system survives the end of the process, however it ends; only a power cut needs the disk. A busy
disk takes hundreds of milliseconds for it, in which the writer must go on.
"""

import os
from concurrent.futures import Future, ThreadPoolExecutor


class DiskSync:
    """Syncs one file, one request at a time.

    Args:
        number: file descriptor; it must stay open until :meth:`finish`.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="disk sync")
        self._running: Future[None] | None = None

    def request(self) -> None:
        """Begin a sync; nothing where the last one still runs: the next request makes up for it.

        Raises:
            OSError: the last one failed.
        """
        if self._running is not None:
            if not self._running.done():
                return
            self._running.result()
        self._running = self._thread.submit(os.fsync, self._number)

    def finish(self) -> None:
        """Wait for the last sync, whatever came of it; no request may follow."""
        self._thread.shutdown(wait=True)

"""Results of voyages: one line of JSON per voyage, in a file that survives a kill."""

import json
import os
from collections.abc import Callable, Hashable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from ship_bags.command_line import with_count
from ship_bags.errors import BadInput

Result = dict[str, Any]
"""Result of a voyage as plain data; the entry ``voyage`` is the number of the voyage."""


class ResultsFile:
    """A file of results; each result is appended when its voyage is completed.

    Args:
        path: path of the file; an incomplete last line of a killed run is removed.
        key: function that returns the key of a result, and raises KeyError or TypeError for other data.
        fresh: True to discard existing results.

    Raises:
        BadInput: a complete line is not a result.
    """

    def __init__(self, path: Path, key: Callable[[Result], Hashable], fresh: bool = False) -> None:
        self.path, self._key = path, key
        path.parent.mkdir(parents=True, exist_ok=True)
        if fresh:
            path.unlink(missing_ok=True)
        self._results = self._read() if path.exists() else []
        self._known = {self._key(result) for result in self._results}

    def contains(self, key: Hashable) -> bool:
        """True if there is a result with this key."""
        return key in self._known

    def results(self) -> list[Result]:
        """Return the results, sorted by the number of the voyage."""
        return sorted(self._results, key=lambda result: int(result["voyage"]))

    def add(self, result: Result) -> None:
        """Append a result, and return when the result is on the disk."""
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self._results.append(result)
        self._known.add(self._key(result))

    def _read(self) -> list[Result]:
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            os.truncate(self.path, len(whole))
        results = []
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                result = json.loads(line)
                self._key(result)
            except (ValueError, KeyError, TypeError) as problem:
                raise BadInput("no result of a voyage", file=self.path, line=number) from problem
            results.append(result)
        return results


def run_and_record(results: ResultsFile, processes: int, submit: Callable[[Executor], list[Future[Result]]]) -> None:
    """Run voyages in worker processes and append each result, with progress on stderr.

    Args:
        results: file of the results.
        processes: number of workers.
        submit: function that submits the voyages to the workers; an interruption cancels voyages not yet started.
    """
    with ProcessPoolExecutor(processes) as pool:
        try:
            futures = submit(pool)
            for done in with_count(as_completed(futures), "voyages", len(futures)):
                results.add(done.result())
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise

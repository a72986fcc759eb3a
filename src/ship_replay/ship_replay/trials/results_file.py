"""Results of voyages: a line of JSON a voyage, in a file that outlives a kill."""

import json
import os
from collections.abc import Callable, Hashable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.progress import with_count

Result = dict[str, Any]
"""What became of a voyage, as plain data; ``voyage`` is its number."""


class ResultsFile:
    """A file of results, to which each voyage is added as soon as it is made.

    Args:
        path: of the file; what a killed run left of its last line is cut off.
        key: what tells the voyage of a result from others; raises KeyError or TypeError on what is no result.
        fresh: forget what is there.

    Raises:
        BadInput: a line before the last is no result.
    """

    def __init__(self, path: Path, key: Callable[[Result], Hashable], fresh: bool = False) -> None:
        self.path, self._key = path, key
        path.parent.mkdir(parents=True, exist_ok=True)
        if fresh:
            path.unlink(missing_ok=True)
        self._results = self._read() if path.exists() else []
        self._known = {self._key(result) for result in self._results}

    def holds(self, key: Hashable) -> bool:
        """Whether a voyage was made."""
        return key in self._known

    def all(self) -> list[Result]:
        """The results, by the numbers of their voyages."""
        return sorted(self._results, key=lambda result: int(result["voyage"]))

    def add(self, result: Result) -> None:
        """Write a result; it is on the disk when this returns."""
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


def add_as_made(results: ResultsFile, processes: int, submit: Callable[[Executor], list[Future[Result]]]) -> None:
    """Make voyages in worker processes, each result written when it is there, with progress on stderr.

    Args:
        results: to which they are added.
        processes: how many workers.
        submit: gives the workers what is to be made; an interruption takes back what has not begun.
    """
    with ProcessPoolExecutor(processes) as pool:
        try:
            made = submit(pool)
            for done in with_count(as_completed(made), "voyages", len(made)):
                results.add(done.result())
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise

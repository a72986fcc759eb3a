"""Run of a campaign's items by worker processes of this machine, or by the workers of a Dask cluster.

On this machine each item runs in a new process: if a process is killed, only its item is repeated.
``ProcessPoolExecutor`` fails completely if one of its processes is killed. Only this module imports the optional
dask.distributed, and only when a cluster is used.
"""

import json
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.forkserver import ensure_running
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ship_bags.command_line import start_worker_process
from ship_bags.errors import BadInput
from ship_studies.campaign.items import Item, Result, failed_result

MAX_WORKER_FAILURES = 3
"""Number of worker failures after which an item counts as failed."""

Make = Callable[[Item, Path], Result]

_ONE_AT_A_TIME = threading.Lock()
"""Lock by which a worker runs one item at a time; parallel threads of one interpreter would not be faster."""


def run_in_processes(make: Make, items: Sequence[Item], workers: int) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result on completion.

    Args:
        make: module-level function that runs an item in an empty folder.
        items: items in any order.
        workers: number of parallel processes.
    """
    # Matrices are small: BLAS threads would only slow each other down. The fork server inherits this setting.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Modules are imported once, in the fork server, which has no threads that a fork would break.
    context = get_context("forkserver")
    context.set_forkserver_preload(["__main__", make.__module__])
    _start_server()
    waiting, failure_counts = deque(items), dict.fromkeys((item.key for item in items), 0)
    running: dict[Any, _Worker] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                worker = _Worker(context, make, waiting.popleft())
                running[worker.connection] = worker
            for connection in wait(list(running)):
                worker = running.pop(connection)
                item, result = worker.item, worker.result()
                if result is None:
                    failure_counts[item.key] += 1
                    if failure_counts[item.key] < MAX_WORKER_FAILURES:
                        waiting.append(item)
                        continue
                    result = failed_result(
                        f"its worker died {MAX_WORKER_FAILURES} times, the last time with {worker.exit_text}"
                    )
                yield item, result
    finally:
        for worker in running.values():
            worker.end()


def _start_server() -> None:
    """Start the fork server with SIGINT ignored; its processes inherit this setting.

    Ctrl-C is handled by the command. A process interrupted before start_worker_process() would print a traceback.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        ensure_running()
    finally:
        signal.signal(signal.SIGINT, before)


class _Worker:
    """A process that runs one item."""

    def __init__(self, context: Any, make: Make, item: Item) -> None:
        self.item = item
        self._folder = TemporaryDirectory(prefix="campaign-")
        self.connection, write_end = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve, args=(make, item, Path(self._folder.name), write_end), daemon=True
        )
        self._process.start()
        # The write end is closed here, so that the read end reports EOF if the process dies.
        write_end.close()

    def result(self) -> Result | None:
        """Wait for the result, remove the folder, and return the result; None if the process died before sending it."""
        try:
            result_or_none: Result | None = json.loads(self.connection.recv_bytes())
        except (EOFError, OSError):  # OSError: the process was killed while it sent the result
            result_or_none = None
        self._process.join()
        self._clean_up()
        return result_or_none

    @property
    def exit_text(self) -> str:
        """Exit code or signal of the process, as text."""
        code = self._process.exitcode or 0
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def end(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.join()
        self._clean_up()

    def _clean_up(self) -> None:
        self.connection.close()
        self._folder.cleanup()


def _serve(make: Make, item: Item, folder: Path, connection: Connection) -> None:
    start_worker_process()
    connection.send_bytes(json.dumps(make(item, folder)).encode())


def run_in_cluster(make: Make, items: Sequence[Item], address: str) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result on completion; the cluster repeats the items of a worker that died.

    Args:
        make: function that runs an item in an empty folder; the workers import its module.
        items: items whose files have the same paths on the machines of the workers as here.
        address: address of the scheduler, tcp://host:port.

    Raises:
        BadInput: dask.distributed is not installed.
        OSError: no scheduler answers at the address.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as problem:
        raise BadInput("--scheduler needs dask.distributed: install it with pip install distributed") from problem
    with Client(address) as client:
        futures = {client.submit(_run_item, make, item, pure=False): item for item in items}
        try:
            for future in as_completed(list(futures)):
                error = future.exception()
                yield futures.pop(future), failed_result(str(error)) if error is not None else future.result()
        finally:
            client.cancel(list(futures))


def _run_item(make: Make, item: Item) -> Result:
    with _ONE_AT_A_TIME, TemporaryDirectory(prefix="campaign-") as folder:
        return make(item, Path(folder))

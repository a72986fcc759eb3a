"""Data of a report: a recording read once and evaluated once."""

import contextlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path

from ship_bags.command_line import start_worker_process
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.renamed_topics import current_names
from ship_bags.topic_names import relative_topics
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.report.recording import RecordedHistory, read_recording
from ship_watch.orientations import ORIENTATIONS
from ship_watch.safety.limits import Limits

SHORT_BYTES = 8_000_000
"""Size up to which a bag is read in less time than another process needs to start, bytes."""

_TRUTH_TOPICS = [orientation.truth_topic for orientation in ORIENTATIONS]


@dataclass(frozen=True)
class ReportData:
    """A recording and its evaluation: all data of a report page."""

    recording: RecordedHistory
    evaluation: Evaluation


def read_report_data(
    path: Path, truth: Path | None = None, limits: Limits | None = None, namespace: str = ""
) -> ReportData:
    """Read and evaluate a bag with outputs.

    Raises:
        BadInput: a bag cannot be read or lacks a required topic.
    """
    check_truth(truth, namespace)
    if is_short(path):
        return ReportData(read_recording(path, limits, namespace), evaluate(path, against=truth, namespace=namespace))
    # Reading and evaluation take equally long and are independent.
    with process_pool(1) as others:
        evaluated = others.submit(evaluate, path, against=truth, namespace=namespace)
        recording = read_recording(path, limits, namespace)
        return ReportData(recording, evaluated.result())


@contextlib.contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Start a pool of processes that are terminated if this process fails or is interrupted.

    The processes are spawned: a fork would copy locks held by threads. The processes of the pool must not start other
    processes, which would not be terminated.
    """
    known = {process.pid for process in active_children()}
    context, begin = get_context("spawn"), partial(start_worker_process, current_names())
    with ProcessPoolExecutor(count, mp_context=context, initializer=begin) as executor:
        try:
            yield executor
        except BaseException:
            for process in active_children():
                if process.pid not in known:
                    process.terminate()
            raise


def is_short(path: Path) -> bool:
    """True if a bag is so short that a second process would not save time."""
    return path.is_file() and path.stat().st_size <= SHORT_BYTES


def check_truth(path: Path | None, namespace: str) -> None:
    """Raise an error if a bag given for its truth has no truth topic.

    Raises:
        BadInput: the bag has no truth topic, or cannot be read.
    """
    if path is not None and not has_truth(path, namespace):
        raise BadInput(f"no truth: expected topic {' or '.join(_TRUTH_TOPICS)}", file=path)


def has_truth(path: Path, namespace: str) -> bool:
    """True if a bag contains a truth topic of an orientation.

    Raises:
        BadInput: the bag cannot be read.
    """
    with read_bag(path) as bag:
        topics = relative_topics(bag.topics, namespace)
        return any(topic in topics for topic in _TRUTH_TOPICS)

"""What a report tells: a recording read once as a night, and evaluated once."""

import contextlib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path

from ship_bags.command_line import serve_a_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.renamed_topics import current_names
from ship_bags.topic_names import relative_topics
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.report.night import Night, read_night
from ship_watch.limits import Limits
from ship_watch.orientations import ORIENTATIONS

SHORT_BYTES = 8_000_000
"""Bags up to this size are read sooner than another process would have begun."""

_TRUTH_TOPICS = [orientation.truth_topic for orientation in ORIENTATIONS]


@dataclass(frozen=True)
class ToldNight:
    """A recording and what it was worth: all that a page is made of."""

    night: Night
    evaluation: Evaluation


def read_told(
    path: Path, truth: Path | None = None, limits: Limits | None = None, namespace: str = ""
) -> ToldNight:
    """Read a bag with outputs, and evaluate it.

    Raises:
        BadInput: a bag cannot be read or lacks what is expected of it.
    """
    check_truth(truth, namespace)
    if is_short(path):
        return ToldNight(read_night(path, limits, namespace), evaluate(path, against=truth, namespace=namespace))
    # Each takes half of the time; neither needs the other.
    with other_processes(1) as others:
        evaluated = others.submit(evaluate, path, against=truth, namespace=namespace)
        night = read_night(path, limits, namespace)
        return ToldNight(night, evaluated.result())


@contextlib.contextmanager
def other_processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that work beside this one, and end where it fails or is interrupted, whatever they were at.

    They are new ones: a copy of this one would take its threads' locks with it. What they do must not begin processes
    of its own, which nobody would end.
    """
    known = {process.pid for process in active_children()}
    context, begin = get_context("spawn"), partial(serve_a_command, current_names())
    with ProcessPoolExecutor(count, mp_context=context, initializer=begin) as executor:
        try:
            yield executor
        except BaseException:
            for process in active_children():
                if process.pid not in known:
                    process.terminate()
            raise


def is_short(path: Path) -> bool:
    """Whether a bag is read so soon that no other process needs to help."""
    return path.is_file() and path.stat().st_size <= SHORT_BYTES


def check_truth(path: Path | None, namespace: str) -> None:
    """Refuse what was named as a bag with truth and has none.

    Raises:
        BadInput: it has none, or cannot be read.
    """
    if path is not None and not has_truth(path, namespace):
        raise BadInput(f"no truth: expected topic {' or '.join(_TRUTH_TOPICS)}", file=path)


def has_truth(path: Path, namespace: str) -> bool:
    """Whether a bag holds a truth that something can be held against.

    Raises:
        BadInput: it cannot be read.
    """
    with read_bag(path) as bag:
        topics = relative_topics(bag.topics, namespace)
        return any(topic in topics for topic in _TRUTH_TOPICS)

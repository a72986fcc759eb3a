"""Way of one message through the code: the functions called and the files visited while a node processes it.

Replays a bag in this process, one message at a time, until a node has processed the nth message of a topic, and records
the calls of the functions in ``src/``. Functions of ``ship_kernels`` are compiled: their calls are not recorded.

Example:
    python tools/walk_message.py bags/demo.mcap ins/imu --list
"""

import argparse
import contextlib
import sys
import tempfile
from collections import Counter
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple
from unittest import mock

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_node.adapters.node_adapter import NodeAdapter
from ship_replay.offline.replay import ADAPTERS, replay

ENTRY = "process"
"""Method of an adapter that processes a batch of messages."""
DEFAULT_NTH = 200
_SOURCES = "/src/"
_GEOMETRY = "ship_geometry/"


class Stop(NamedTuple):
    """A call: the file, relative to ``src/``, and the name of the function."""

    path: str
    function: str


class _Processed(Exception):
    """The message is processed: the replay can end."""


def is_only_message(arguments: tuple[Any, ...], topic: str) -> bool:
    """Return True if a call of :data:`ENTRY` with these arguments processes one message, of this topic."""
    (batch,) = arguments
    return [arrival.topic for arrival in batch.arrivals if not arrival.is_empty] == [topic]


def walk(bag: Path, topic: str, nth: int = DEFAULT_NTH) -> list[Stop]:
    """Return the calls with which a node processes the nth message of a topic; empty if the bag has fewer messages.

    If several nodes receive the topic, the calls are those of the first node.
    """
    stops: list[Stop] = []
    counts: Counter[str] = Counter()
    process = getattr(NodeAdapter, ENTRY)

    def record(frame: FrameType, event: str, _argument: object) -> None:
        _, found, path = frame.f_code.co_filename.rpartition(_SOURCES)
        if event == "call" and found:
            stops.append(Stop(path, frame.f_code.co_name))

    def entry(adapter: NodeAdapter, *arguments: Any) -> Any:
        if is_only_message(arguments, topic):
            counts[adapter.node_name] += 1
            if counts[adapter.node_name] == nth:
                sys.setprofile(record)
                try:
                    process(adapter, *arguments)
                finally:
                    sys.setprofile(None)
                raise _Processed
        return process(adapter, *arguments)

    replacement = mock.patch.object(NodeAdapter, ENTRY, entry)
    with tempfile.TemporaryDirectory() as folder, replacement, contextlib.suppress(_Processed):
        replay(bag, Path(folder) / "replayed.mcap", ADAPTERS, one_by_one=True)
    return stops


def main() -> int:
    """Print the way of one message; return the exit code, 2 if there is no such message."""
    parser = CommandParser(prog="walk_message", description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("topic", help="as the node names it, for example ins/imu")
    parser.add_argument("--nth", type=int, default=DEFAULT_NTH, help=f"number of the message ({DEFAULT_NTH})")
    parser.add_argument("--list", action="store_true", help="print each visit of a file, with the function called")
    return run_command(parser, _print_way, None)


def _print_way(options: argparse.Namespace) -> int:
    stops = walk(options.bag, options.topic, options.nth)
    if not stops:
        raise BadInput(f"no node received message {options.nth} of {options.topic}", file=options.bag)
    visits = [next(visit) for _, visit in groupby(stops, key=lambda stop: stop.path)]
    if options.list:
        print("\n".join(f"  {stop.path}: {stop.function}" for stop in visits))
    files = {stop.path for stop in stops}
    outside = sum(not path.startswith(_GEOMETRY) for path in files)
    print(
        f"{options.topic}: {len(stops)} calls, {len(files)} files ({outside} outside ship_geometry), "
        f"{len(visits) - 1} moves between files"
    )
    return EXIT_DONE


if __name__ == "__main__":
    raise SystemExit(main())

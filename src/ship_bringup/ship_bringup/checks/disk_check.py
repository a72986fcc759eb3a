"""Whether the disk takes the night: a record of everything and a black box of each node.

Bytes an hour = 3600 s × (sum of the inputs from outside, and for each node: what it gives; with boxes also what it
takes and gives once more). An input takes rate × (message + 31), the message as it was heard, else as is usual; a node
gives at most twice what it takes, and :data:`REPORTS_BYTES_PER_S` of reports. Nothing counts on compression, which
saves a quarter to two thirds.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_look import HeardTopic
from ship_node.edge.adapter import Adapter
from ship_watch.limits import Limits

ENTRY_BYTES = 31
"""What a message costs in MCAP beside its bytes: opcode, length, channel, sequence, two times."""

REPORTS_BYTES_PER_S = 8000.0
"""Diagnostics, health, alignment, budget and integrity of one node: 5.6 and 7.2 kB/s in the suites of bags/."""

_TICKS_BYTES_PER_S = 10 * 120.0
_GIVEN_SHARE = 2.0
_CHECK = "disk"
_SECONDS_PER_HOUR = 3600.0
_GB = 1e9

_USUAL = {
    "ins": (100.0, 316),
    "reference": (100.0, 316),
    "ship": (100.0, 310),
    "star": (5.0, 1500),
    "theodolite": (50.0, 90),
    "beacon": (10.0, 324),
    "gnss": (1.0, 125),
    "met": (1.0, 36),
}
"""First word of a topic → rate in Hz and length of a message, as in the suites of bags/; stars: twenty of them."""
_UNKNOWN = (10.0, 500)


@dataclass(frozen=True)
class NightBytes:
    """What a suite writes, bytes a second: a record of all topics, and the black boxes of its nodes."""

    record: float
    boxes: float


@dataclass(frozen=True)
class DiskState:
    """A folder's disk.

    Attributes:
        folder: that was asked for.
        device: number of the disk; None where it could not be asked.
        free_bytes: what is free on it; None where it could not be asked.
        asked: the folder that answered: the nearest one above, where `folder` is not there.
    """

    folder: Path
    device: int | None
    free_bytes: int | None
    asked: Path | None = None


def night_bytes(adapters: Sequence[Adapter], heard: Sequence[HeardTopic]) -> NightBytes:
    """What a suite writes.

    Args:
        adapters: of its nodes.
        heard: inputs as they were heard; of those that were not, what is usual counts.
    """
    streams = {each.input.topic: (each.rate_hz, each.message_bytes) for each in heard if each.rate_hz > 0.0}
    given_inside = {topic.topic for adapter in adapters for topic in adapter.outputs}
    outside = {topic.topic for adapter in adapters for topic in adapter.inputs} - given_inside
    taken = [sum(_stream_bytes(topic.topic, streams) for topic in adapter.inputs) for adapter in adapters]
    given = [_GIVEN_SHARE * each + REPORTS_BYTES_PER_S for each in taken]
    boxes = sum(taken) + sum(given) + _TICKS_BYTES_PER_S * len(adapters)
    return NightBytes(sum(_stream_bytes(topic, streams) for topic in outside) + sum(given), boxes)


def look_at_disk(folder: Path) -> DiskState:
    """The disk of a folder, or of the nearest one above it that is there."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return DiskState(folder, place.stat().st_dev, shutil.disk_usage(place).free, place)
    except OSError:
        return DiskState(folder, None, None)


def judge_disk(
    state: DiskState, needs_bytes_per_s: float, hours: float, limits: Limits, must_be_there: str = ""
) -> Iterator[CheckLine]:
    """Whether what is free is enough for so many hours.

    Args:
        state: of the disk.
        needs_bytes_per_s: what is written to it.
        hours: how long.
        limits: of the ship.
        must_be_there: the setting that names this folder; empty for one that is still to be made.
    """
    need_gb = needs_bytes_per_s * _SECONDS_PER_HOUR * hours / _GB
    needs = f"{hours:g} h need {need_gb:.1f} GB"
    advice = "free some, or record elsewhere"
    if state.free_bytes is None:
        yield CheckLine(_CHECK, Result.FAIL, f"{state.folder}: cannot be asked how much is free; {needs}", "mount it")
        return
    free_gb = state.free_bytes / _GB
    found = f"{state.folder}: {free_gb:.1f} GB free, {needs}"
    if state.asked is not None and state.asked != state.folder.absolute():
        if must_be_there:
            # The disk above it is another one where this one is only not mounted.
            found = f"{state.folder}, named by {must_be_there}, is not there; {needs}"
            yield CheckLine(_CHECK, Result.FAIL, found, f"mount the disk, or set right {must_be_there}")
            return
        found = f"{state.folder} is not there yet: {free_gb:.1f} GB free in {state.asked}, {needs}"
    if not free_gb >= need_gb:
        yield CheckLine(_CHECK, Result.FAIL, found, advice)
    elif not free_gb - need_gb >= limits.machine.disk_free_gb:
        left = f"{found}: less than machine.disk_free_gb, {limits.machine.disk_free_gb:g}, would be left"
        yield CheckLine(_CHECK, Result.WARN, left, advice)
    else:
        yield CheckLine(_CHECK, Result.OK, found)


def _stream_bytes(topic: str, streams: Mapping[str, tuple[float, float]]) -> float:
    rate_hz, message_bytes = streams.get(topic) or _USUAL.get(topic.partition("/")[0], _UNKNOWN)
    return rate_hz * (message_bytes + ENTRY_BYTES)

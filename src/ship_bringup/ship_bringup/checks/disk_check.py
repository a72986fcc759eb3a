"""Check of the disk space for a voyage: a record of all topics and a black box of each node.

The record contains the inputs from outside and the outputs of all nodes. A black box contains the inputs, outputs and
ticks of its node. An input has rate × (message length + 31) bytes/s. Rate and length are those of the received
messages, or typical values if none were received. The outputs of a node are assumed to be twice its inputs, plus
:data:`REPORTS_BYTES_PER_S` of reports. Compression, which saves a quarter to two thirds, is not assumed.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_state import ObservedTopic
from ship_node.adapters.adapter import Adapter
from ship_watch.safety.limits import Limits

ENTRY_BYTES = 31
"""Overhead of a message in MCAP: opcode, length, channel, sequence, two times."""

REPORTS_BYTES_PER_S = 8000.0
"""Assumed bytes/s of diagnostics, health, alignment, budget and integrity of a node.

The nodes in the suites of bags/ write 5600 and 7200 bytes/s.
"""

_TICKS_BYTES_PER_S = 10 * 120.0
_OUTPUT_RATIO = 2.0
_CHECK = "disk"
_SECONDS_PER_HOUR = 3600.0
_GB = 1e9

_TYPICAL_STREAMS = {
    "ins": (100.0, 316),
    "reference": (100.0, 316),
    "ship": (100.0, 310),
    "star": (5.0, 1500),
    "theodolite": (50.0, 90),
    "beacon": (10.0, 324),
    "gnss": (1.0, 125),
    "met": (1.0, 36),
}
"""First word of a topic → rate, Hz, and message length, bytes, as in the suites of bags/ (twenty stars per message)."""
_DEFAULT_STREAM = (10.0, 500)


@dataclass(frozen=True)
class WriteRates:
    """Write rates of a suite, bytes/s: a record of all topics, and the black boxes of its nodes."""

    record: float
    boxes: float


@dataclass(frozen=True)
class DiskState:
    """The disk of a folder.

    Attributes:
        folder: the requested folder.
        device: number of the disk; None if it cannot be read.
        free_bytes: free space on the disk; None if it cannot be read.
        measured_folder: the folder that was measured: the nearest existing parent, if `folder` does not exist.
    """

    folder: Path
    device: int | None
    free_bytes: int | None
    measured_folder: Path | None = None


def estimate_write_rates(adapters: Sequence[Adapter], observed: Sequence[ObservedTopic]) -> WriteRates:
    """Return the write rates of a suite.

    Args:
        adapters: adapters of the nodes of the suite.
        observed: inputs as received; for other inputs, typical values are used.
    """
    streams = {each.input.topic: (each.rate_hz, each.message_bytes) for each in observed if each.rate_hz > 0.0}
    own_outputs = {topic.topic for adapter in adapters for topic in adapter.outputs}
    external_inputs = {topic.topic for adapter in adapters for topic in adapter.inputs} - own_outputs
    input_bytes_per_s = [sum(_stream_bytes(topic.topic, streams) for topic in adapter.inputs) for adapter in adapters]
    output_bytes_per_s = [_OUTPUT_RATIO * each + REPORTS_BYTES_PER_S for each in input_bytes_per_s]
    boxes = sum(input_bytes_per_s) + sum(output_bytes_per_s) + _TICKS_BYTES_PER_S * len(adapters)
    return WriteRates(sum(_stream_bytes(topic, streams) for topic in external_inputs) + sum(output_bytes_per_s), boxes)


def read_disk_state(folder: Path) -> DiskState:
    """Return the disk of a folder, or of its nearest existing parent."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return DiskState(folder, place.stat().st_dev, shutil.disk_usage(place).free, place)
    except OSError:
        return DiskState(folder, None, None)


def check_disk(
    state: DiskState, needs_bytes_per_s: float, hours: float, limits: Limits, required_by: str = ""
) -> Iterator[CheckLine]:
    """Check that the free space is sufficient for a number of hours.

    Args:
        state: state of the disk.
        needs_bytes_per_s: rate of writing to the disk.
        hours: duration of the writing, h.
        limits: limits of the ship.
        required_by: the setting that names this folder; empty for a folder that will be created.
    """
    need_gb = needs_bytes_per_s * _SECONDS_PER_HOUR * hours / _GB
    needs = f"{hours:g} h need {need_gb:.1f} GB"
    advice = "free some space, or record elsewhere"
    if state.free_bytes is None:
        yield CheckLine(_CHECK, Result.FAIL, f"{state.folder}: the free space cannot be read; {needs}", "mount it")
        return
    free_gb = state.free_bytes / _GB
    found = f"{state.folder}: {free_gb:.1f} GB free, {needs}"
    if state.measured_folder is not None and state.measured_folder != state.folder.absolute():
        if required_by:
            # If the disk is not mounted, the parent folder is on another disk.
            found = f"{state.folder}, named by {required_by}, is not there; {needs}"
            yield CheckLine(_CHECK, Result.FAIL, found, f"mount the disk, or correct {required_by}")
            return
        found = f"{state.folder} is not there yet: {free_gb:.1f} GB free in {state.measured_folder}, {needs}"
    if not free_gb >= need_gb:
        yield CheckLine(_CHECK, Result.FAIL, found, advice)
    elif not free_gb - need_gb >= limits.machine.disk_free_gb:
        left = f"{found}: less than machine.disk_free_gb, {limits.machine.disk_free_gb:g}, would be left"
        yield CheckLine(_CHECK, Result.WARN, left, advice)
    else:
        yield CheckLine(_CHECK, Result.OK, found)


def _stream_bytes(topic: str, streams: Mapping[str, tuple[float, float]]) -> float:
    rate_hz, message_bytes = streams.get(topic) or _TYPICAL_STREAMS.get(topic.partition("/")[0], _DEFAULT_STREAM)
    return rate_hz * (message_bytes + ENTRY_BYTES)

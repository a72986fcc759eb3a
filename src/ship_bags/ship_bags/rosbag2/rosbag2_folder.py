"""The information file (metadata.yaml) of a rosbag2 folder, as ROS 2 Jazzy writes it."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput
from ship_bags.part_file import write_whole
from ship_bags.yaml_text import plain_data

INFORMATION_FILE = "metadata.yaml"
_VERSION = 9
_ROS_DISTRO = "jazzy"


@dataclass
class FileInformation:
    """What the information file says of one file; times are None before its first message."""

    name: str
    start_ns: int | None = None
    end_ns: int | None = None
    message_count: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count one message."""
        self.message_count += 1
        self.start_ns = log_time_ns if self.start_ns is None else min(self.start_ns, log_time_ns)
        self.end_ns = log_time_ns if self.end_ns is None else max(self.end_ns, log_time_ns)


@dataclass
class TopicInformation:
    """What the information file says of one topic; `qos_profiles` is the text that its channels carry."""

    name: str
    type_name: str
    qos_profiles: str
    type_hash: str
    message_count: int = 0


def write_information(folder: Path, files: Sequence[FileInformation], topics: Sequence[TopicInformation]) -> None:
    """Write metadata.yaml; whenever the power fails, the folder has the former one or this one, whole.

    Raises:
        OSError: it cannot be written; the former one stays.
    """
    write_whole(folder / INFORMATION_FILE, yaml.safe_dump(_information(files, topics), sort_keys=False))
    _sync_folder(folder)


def _sync_folder(folder: Path) -> None:
    """Bring the names in a folder onto the disk."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def _information(files: Sequence[FileInformation], topics: Sequence[TopicInformation]) -> dict[str, Any]:
    start_ns = min((file.start_ns for file in files if file.start_ns is not None), default=None)
    end_ns = max((file.end_ns for file in files if file.end_ns is not None), default=None)
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        **_span(start_ns, end_ns),
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _offers(topic.qos_profiles),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {"path": file.name, **_span(file.start_ns, file.end_ns), "message_count": file.message_count}
            for file in files
        ],
        "custom_data": None,
        "ros_distro": _ROS_DISTRO,
    }
    return {"rosbag2_bagfile_information": information}


def _offers(text: str) -> list[Any]:
    """The quality of service that a channel notes; none where a damaged bag notes something else."""
    try:
        offers = plain_data("offered_qos_profiles", text)
    except BadInput:
        return []
    return offers if isinstance(offers, list) else []


def _span(start_ns: int | None, end_ns: int | None) -> dict[str, dict[str, int]]:
    start, end = (0, 0) if start_ns is None or end_ns is None else (start_ns, end_ns)
    return {"duration": {"nanoseconds": end - start}, "starting_time": {"nanoseconds_since_epoch": start}}

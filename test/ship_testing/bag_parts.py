"""Write parts of a bag as separate bags."""

from collections.abc import Callable
from pathlib import Path

from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import NS_PER_S


def write_beginning(whole_path: Path, path: Path, length_s: float) -> Path:
    """Write the first seconds of a bag, with its attachments."""
    with read_bag(whole_path) as bag:
        end_ns = bag.start_ns + round(length_s * NS_PER_S)
    return write_part(whole_path, path, lambda record: record.log_time_ns <= end_ns)


def write_part(whole_path: Path, path: Path, is_kept: Callable[[BagRecord], bool]) -> Path:
    """Write the selected records of a bag, with its attachments and metadata."""
    with read_bag(whole_path) as whole, BagWriter(path) as writer:
        for attachment, data in whole.attachments.items():
            writer.add_attachment(attachment, data)
        for name, entries in whole.metadata.items():
            writer.add_metadata(name, entries)
        for record in filter(is_kept, whole.records()):
            writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    return path

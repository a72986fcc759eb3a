"""Writes bags without a ROS installation: messages made or decoded here go in as objects."""

from pathlib import Path
from typing import Any

from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT as SUITE_ATTACHMENT
from ship_bags.mcap.bag_writer import CdrBagWriter, TypeDefinition
from ship_bags.mcap.bag_writer import qos_text as qos_text
from ship_bags.message_store import definition, serialize, type_hash

SCENARIO_ATTACHMENT = "scenario.yaml"
"""Name of the attachment that holds the scenario of a simulated bag."""


class BagWriter(CdrBagWriter):
    """One MCAP file being written; see :class:`ship_bags.mcap.bag_writer.CdrBagWriter`.

    Args:
        path: file to write, ending in .mcap.
        atomic: write beside it and rename at the end; a recorder, whose file must survive a crash, says False.

    Raises:
        BadInput: the file cannot be made.
    """

    def __init__(self, path: Path | str, atomic: bool = True) -> None:
        # The name in the head of the file stays: the same scenario and seed give the same bytes as ever.
        super().__init__(path, lambda name: TypeDefinition(definition(name), type_hash(name)), "ship_replay", atomic)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message made by :class:`ship_bags.message_store.RosbagsFactory` or decoded from a bag.

        Raises:
            BadInput: the topic already carries another type.
        """
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

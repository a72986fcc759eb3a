"""What a comparison of a replay with recorded outputs came to."""

from collections import Counter
from dataclasses import dataclass, field

from ship_node.edge.messages_out import DIAGNOSTICS_TYPE
from ship_replay.offline.message_difference import Difference

ASIDE = DIAGNOSTICS_TYPE, "ship_msgs/msg/InputHealth"
"""Types of messages that also tell of the middleware, which no replay knows: not compared."""


@dataclass
class Verification:
    """What was compared.

    Attributes:
        used: input topic or kind of event → how many the adapter was given.
        equal: output topic → messages that are the same to the last bit.
        difference: the first difference; None where there is none.
        notes: what else is to be said, one line each.
        unverified: why not all of the bag could be compared; empty where all was.
        cut: whether that is nothing but the file's sudden end.
    """

    used: Counter[str] = field(default_factory=Counter)
    equal: Counter[str] = field(default_factory=Counter)
    difference: Difference | None = None
    notes: list[str] = field(default_factory=list)
    unverified: str = ""
    cut: bool = False

    @property
    def holds(self) -> bool:
        """Whether all outputs are the same, up to a cut at most."""
        return self.difference is None and (self.cut or not self.unverified)

"""A node that cannot keep up with its inputs: what is known of that, and its words."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Overload:
    """A change of how a node keeps up: messages were cut because they waited too long, or it keeps up again.

    Attributes:
        behind_s: waiting time of the oldest message, s; 0 where the node keeps up again.
        cores: processor cores that the node may use.
        load: mean number of processes that were running, or ready to run, in the last minute.
        cut: topic → number of messages that were cut since the last change.
    """

    behind_s: float
    cores: int
    load: float
    cut: Mapping[str, int] = field(default_factory=dict)

    def text(self, node: str) -> str:
        """Return the words for people.

        Example:
            >>> Overload(3.24, 2, 12.3).text("ship_attitude")
            'ship_attitude is 3.2 s behind: the computer is too slow (2 cores, load 12)'
        """
        cores = f"{self.cores} core{'s' if self.cores > 1 else ''}"
        return f"{node} is {self.behind_s:.1f} s behind: the computer is too slow ({cores}, load {self.load:.0f})"

"""Overload state of a node that cannot keep up with its inputs."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Overload:
    """Change of the overload state: messages were dropped because they waited too long, or the node keeps up again.

    Attributes:
        behind_s: time that the oldest message has waited, s; 0 if the node keeps up again.
        cores: number of processor cores that the node may use.
        load: mean number of runnable processes in the last minute.
        cut: topic → number of messages dropped since the last report to the adapter.
    """

    behind_s: float
    cores: int
    load: float
    cut: Mapping[str, int] = field(default_factory=dict)

    def text(self, node: str) -> str:
        """Return the text for the user.

        Example:
            >>> Overload(3.24, 2, 12.3).text("ship_attitude")
            'ship_attitude is 3.2 s behind: the computer is too slow (2 cores, load 12)'
        """
        cores = f"{self.cores} core{'s' if self.cores > 1 else ''}"
        return f"{node} is {self.behind_s:.1f} s behind: the computer is too slow ({cores}, load {self.load:.0f})"

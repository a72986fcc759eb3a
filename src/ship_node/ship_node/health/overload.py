"""Overload state of a node that cannot keep up with its inputs."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ship_geometry.earth.time_scales import SECOND_NS
from ship_node.messages.common_messages import DiagnosticStatus, Level


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


class OverloadReport:
    """Report of the overload of a node, once a second.

    Args:
        node: name of the node.

    Attributes:
        behind: overload state; None if the node keeps up.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self.behind: Overload | None = None
        self._next_ns = 0

    def change(self, change: Overload, waiting_ns: int) -> str:
        """Set the overload state; return the reason for which messages were dropped."""
        reason = (change if change.behind_s else self.behind or change).text(self._node)
        self.behind = change if change.behind_s else None
        self._next_ns = waiting_ns
        return reason

    def text_due(self, waiting_ns: int) -> str:
        """Return, once a second while the node is behind, the text for the user; otherwise an empty text."""
        if self.behind is None or waiting_ns < self._next_ns:
            return ""
        self._next_ns = waiting_ns + SECOND_NS
        return self.behind.text(self._node)

    def status(self) -> DiagnosticStatus:
        """Return the diagnostic status of the overload."""
        if self.behind is None:
            return DiagnosticStatus("overload", Level.OK, "keeps up with its inputs")
        values = {
            "behind [s]": f"{self.behind.behind_s:.1f}",
            "cores": str(self.behind.cores),
            "load": f"{self.behind.load:.1f}",
        }
        return DiagnosticStatus("overload", Level.ERROR, self.behind.text(self._node), values)

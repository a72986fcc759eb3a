"""The adapter of a node whose outputs are put out together: offline each is computed when somebody asks for it.

The core says what is due as its inputs come, and its inputs have their turn one by one. What comes of it is what comes
of putting each out at once, to the last bit.
"""

from typing import Any, Protocol

from ship_estimation.refusals import Refusal
from ship_node.edge.block_adapter import BlockAdapter
from ship_node.edge.blocks import BlockPart
from ship_node.edge.topics import Published


class DeferringCore(Protocol):
    """What a core has for outputs that are computed together.

    Attributes:
        due: what the outputs rest on, each with its stamp ``time_ns``; None where each is put out at once.
    """

    due: list[Any] | None

    def estimates_due(self) -> list[tuple[slice, Any | Refusal]]:
        """Numbers of the outputs that are due, and these, or why they could not be computed; then none is due."""
        ...


class DeferringAdapter(BlockAdapter):
    """An adapter that puts its outputs out together, too; see :class:`BlockAdapter`."""

    def defer(self) -> None:
        """From now on what messages lead to lacks the outputs: :meth:`take_parts` gives them."""
        self.core.due = []
        self._parts_made: list[BlockPart] = []
        self._made = 0

    @property
    def promised(self) -> int:
        """How many outputs were due since :meth:`defer` or :meth:`take_parts`."""
        return self._made + len(self.core.due)

    def take_parts(self) -> list[BlockPart]:
        """All outputs that were due, by their numbers among these, with what is published before some of them."""
        self._make_due()
        parts, self._parts_made, self._made = self._parts_made, [], 0
        return parts

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """See :class:`ship_node.edge.adapter.Adapter`. What is told once a period is told of the last output."""
        if (now_ns if waiting_ns is None else waiting_ns) >= self.quiet_until_ns:
            self._make_due()
        return super().tick(now_ns, waiting_ns)

    def published(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[Published]:
        """See :class:`ReportingAdapter`. An output that is put out at once comes after all that are due."""
        if outcome.estimates:
            self._make_due()
        return super().published(outcome, now_ns, waiting_ns)

    def _make_due(self) -> None:
        if not self.core.due:
            return
        times_ns = [due.time_ns for due in self.core.due]
        for some, found in self.core.estimates_due():
            parts = self.parts(some, found, times_ns)
            self._parts_made += [part._replace(place=self._made + part.place) for part in parts]
        self._made += len(times_ns)

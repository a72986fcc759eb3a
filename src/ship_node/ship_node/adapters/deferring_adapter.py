"""Adapter of a node whose outputs can be computed together offline.

The core collects pending outputs while its inputs are processed one by one. Outputs that are computed together equal
bit for bit outputs that are published at once.
"""

from typing import Any, Protocol

from ship_estimation.rejections import Rejection
from ship_node.adapters.batch_adapter import BatchAdapter
from ship_node.messages.batches import BatchOutput
from ship_node.messages.topics import OutputMessage


class DeferringCore(Protocol):
    """Core that computes several outputs together.

    Attributes:
        pending: data of each pending output, with its stamp ``time_ns``; None if each output is published at once.
    """

    pending: list[Any] | None

    def compute_pending(self) -> list[tuple[slice, Any | Rejection]]:
        """Compute all pending outputs; return slices of ``pending``, each with its outputs or its rejection."""
        ...


class DeferringAdapter(BatchAdapter):
    """Adapter that can also publish its outputs together; see :class:`BatchAdapter`."""

    def defer_outputs(self) -> None:
        """Collect the outputs from now on; :meth:`take_outputs` returns them."""
        self.core.pending = []
        self._computed_outputs: list[BatchOutput] = []
        self._computed_count = 0

    @property
    def pending_count(self) -> int:
        """Number of outputs that :meth:`take_outputs` would return, whether they are computed yet or not."""
        return self._computed_count + len(self.core.pending)

    def take_outputs(self) -> list[BatchOutput]:
        """Compute and return all pending outputs, with the messages that are published before some of them."""
        self._compute_pending()
        parts, self._computed_outputs, self._computed_count = self._computed_outputs, [], 0
        return parts

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.adapter.Adapter`; periodic messages describe the last output."""
        if (now_ns if waiting_ns is None else waiting_ns) >= self.idle_until_ns:
            self._compute_pending()
        return super().tick(now_ns, waiting_ns)

    def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`ReportingAdapter`; pending outputs are computed before an output that is published at once."""
        if outcome.estimates:
            self._compute_pending()
        return super().report_outcome(outcome, now_ns, waiting_ns)

    def _compute_pending(self) -> None:
        if not self.core.pending:
            return
        times_ns = [pending.time_ns for pending in self.core.pending]
        for some, found in self.core.compute_pending():
            parts = self.batch_outputs(some, found, times_ns)
            self._computed_outputs += [part._replace(place=self._computed_count + part.place) for part in parts]
        self._computed_count += len(times_ns)

"""Overloaded nodes, which cannot keep up with their inputs, and the sources that are OUT due to an overload.

An overloaded node drops waiting messages. Measurements of good sources then lack their counterparts, in that node and
in the nodes that read its output. These sources are not faulty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ship_watch.suite_state import Presence, SourceState

REPORT_TIMEOUT_NS = 5_000_000_000
"""Maximum age of an overload report with which its node counts as overloaded, ns. A node reports once a second, and
less often if it hardly runs."""

_NEW_OVERLOAD_NS = 2 * REPORT_TIMEOUT_NS
"""Time without a report after which the next report starts a new overload, ns."""

_ONSET_NS = REPORT_TIMEOUT_NS
"""Time before the first report within which a source that goes OUT is attributed to the overload, ns."""

_NODES = ("ship_attitude", "star_attitude", "optical_axis")
"""Nodes that report an overload, in the order in which their texts are preferred."""

_ATTITUDE_NODES = _NODES[:2]


@dataclass
class _Overload:
    text: str
    since_ns: int
    reported_ns: int


class OverloadedNodes:
    """Overloaded nodes, from innovations with the reason BEHIND."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Overload] = {}
        self._out_since_ns: dict[str, int] = {}
        self._causes: dict[str, str] = {}

    def record_report(self, message: Any, now_ns: int) -> None:
        """Record an Innovation with the reason BEHIND if its source is a node, not the source of a dropped message."""
        node = str(message.source)
        if node not in _NODES:
            return
        known = self._nodes.get(node)
        since_ns = now_ns if known is None or now_ns - known.reported_ns > _NEW_OVERLOAD_NS else known.since_ns
        self._nodes[node] = _Overload(str(message.reason_text), since_ns, now_ns)

    def overload_text(self, now_ns: int, is_pointing: bool, by_attitude: bool) -> str:
        """Return the overload text of the first overloaded node on which an output depends; empty if there is none.

        Args:
            now_ns: caller's time, ns.
            is_pointing: True for the pointing, False for the attitude.
            by_attitude: True if the pointing uses the attitude that the suite publishes.
        """
        own = ("optical_axis",) if is_pointing else ()
        nodes = (*own, *(_ATTITUDE_NODES if by_attitude or not is_pointing else ()))
        return next((self._nodes[node].text for node in nodes if self._is_overloaded(node, now_ns)), "")

    def with_causes(self, sources: Sequence[SourceState], now_ns: int) -> list[SourceState]:
        """Return the sources; a source that went OUT during an overload or just before has the node as its cause.

        The cause stays until the source is IN again.

        Args:
            sources: states from the measurements.
            now_ns: caller's time, ns.
        """
        node = next((node for node in _NODES if self._is_overloaded(node, now_ns)), "")
        return [self._with_cause(source, node, now_ns) for source in sources]

    def _with_cause(self, source: SourceState, node: str, now_ns: int) -> SourceState:
        name = source.name
        if source.presence is not Presence.OUT:
            self._out_since_ns.pop(name, None)
            self._causes.pop(name, None)
        elif not source.because_of:
            since_ns = self._out_since_ns.setdefault(name, now_ns)
            if node and since_ns >= self._nodes[node].since_ns - _ONSET_NS:
                self._causes[name] = node
            if name in self._causes:
                node = self._causes[name]
                return replace(source, reason=f"{node} is behind", disagreement="", because_of=node)
        return source

    def _is_overloaded(self, node: str, now_ns: int) -> bool:
        known = self._nodes.get(node)
        return known is not None and now_ns - known.reported_ns <= REPORT_TIMEOUT_NS

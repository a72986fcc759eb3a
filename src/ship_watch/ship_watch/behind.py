"""Nodes that cannot keep up with their inputs: what they publish of it, and which sources are out because of it.

A node that is behind cuts what waits for it. Measurements of good sources then lack what they are compared with, there
and in the nodes after it: none of these sources is at fault.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ship_watch.picture import Presence, SourceStanding

FRESH_NS = 5_000_000_000
"""Age of the last report of a node that is behind, ns: an older one says nothing of now. Reports come once a second,
and less often where the node hardly runs."""

_APART_NS = 2 * FRESH_NS
"""Time without a report after which a node that is behind is newly behind, ns."""

_BEFORE_NS = FRESH_NS
"""Time before the first report of a node in which sources may have gone out because it was nearly behind, ns."""

_NODES = ("ship_attitude", "star_attitude", "optical_axis")
"""The nodes that report it, in the order in which their texts are preferred."""

_ATTITUDE_NODES = _NODES[:2]


@dataclass
class _Behind:
    text: str
    since_ns: int
    reported_ns: int


class BehindBook:
    """The nodes that are behind, by the refusals with the reason BEHIND."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Behind] = {}
        self._out_since_ns: dict[str, int] = {}
        self._causes: dict[str, str] = {}

    def note(self, message: Any, now_ns: int) -> None:
        """Take an Innovation with the reason BEHIND: of a node, or of messages that it cut, which adds nothing."""
        node = str(message.source)
        if node not in _NODES:
            return
        known = self._nodes.get(node)
        since_ns = now_ns if known is None or now_ns - known.reported_ns > _APART_NS else known.since_ns
        self._nodes[node] = _Behind(str(message.reason_text), since_ns, now_ns)

    def text(self, now_ns: int, is_pointing: bool, by_attitude: bool) -> str:
        """Return why an output is worse than it could be, where a node that it rests on is behind.

        Args:
            now_ns: the caller's time.
            is_pointing: True for the pointing, False for the attitude.
            by_attitude: True where the pointing rests on the attitude that the suite publishes.
        """
        own = ("optical_axis",) if is_pointing else ()
        nodes = (*own, *(_ATTITUDE_NODES if by_attitude or not is_pointing else ()))
        return next((self._nodes[node].text for node in nodes if self._is_behind(node, now_ns)), "")

    def attributed(self, sources: Sequence[SourceStanding], now_ns: int) -> list[SourceStanding]:
        """Return how the sources stand; those that went out since a node is behind are out because of that node.

        A source stays so until it is in again: it must be accepted some times for that.

        Args:
            sources: as their measurements say.
            now_ns: the caller's time.
        """
        node = next((node for node in _NODES if self._is_behind(node, now_ns)), "")
        return [self._with_cause(source, node, now_ns) for source in sources]

    def _with_cause(self, source: SourceStanding, node: str, now_ns: int) -> SourceStanding:
        name = source.name
        if source.presence is not Presence.OUT:
            self._out_since_ns.pop(name, None)
            self._causes.pop(name, None)
        elif not source.because_of:
            since_ns = self._out_since_ns.setdefault(name, now_ns)
            if node and since_ns >= self._nodes[node].since_ns - _BEFORE_NS:
                self._causes[name] = node
            if name in self._causes:
                node = self._causes[name]
                return replace(source, reason=f"{node} is behind", disagreement="", because_of=node)
        return source

    def _is_behind(self, node: str, now_ns: int) -> bool:
        known = self._nodes.get(node)
        return known is not None and now_ns - known.reported_ns <= FRESH_NS

"""Images of targets on their way to a direction: each waits until the pointing at both its sides was put out.

An image touches nothing else: the pointings, and all that they rest on, are to the last bit what they are without it.
"""

from collections import deque

from ship_estimation.refusals import Contradictions, Refusal, same_stamp
from theodolite_calib.measured.samples import TargetSample

MOST_WAITING = 1000
"""Images that wait at a time; of a flood the oldest are refused."""

_MOST_ANSWERED = 5000
"""Answered images that are remembered, so that the same one again is told; a second of data has fewer."""

_Key = tuple[int, str]


class WaitingTargets:
    """The images of one run that wait, and those that were answered not long ago.

    Args:
        contradictions: of their source.
    """

    def __init__(self, contradictions: Contradictions) -> None:
        self._waiting: dict[_Key, tuple[TargetSample, int]] = {}
        self._answered: dict[_Key, TargetSample] = {}
        self._order: deque[_Key] = deque()
        self._contradictions = contradictions

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, sample: TargetSample, waiting_ns: int) -> Refusal | None:
        """Take an image that came at a time of waiting; what is refused of it, or of the one whose place it takes."""
        key = sample.time_ns, sample.target_id
        waits = self._waiting.get(key)
        known = waits[0] if waits is not None else self._answered.get(key)
        if known is not None:
            takes_its_place, refusal = same_stamp(known, sample)
            self._contradictions.note(sample.source, sample.time_ns, refusal)
            if takes_its_place and waits is not None:
                self._waiting[key] = sample, waits[1]
            return refusal
        self._waiting[key] = sample, waiting_ns
        return None

    def overflowing(self) -> list[TargetSample]:
        """The oldest images, where too many wait: they wait no longer."""
        keys = sorted(self._waiting)[: max(len(self._waiting) - MOST_WAITING, 0)]
        return [self._waiting.pop(key)[0] for key in keys]

    def waiting(self) -> list[tuple[TargetSample, int]]:
        """The images that wait, in the order of their stamps, each with the time of waiting at which it came."""
        return [self._waiting[key] for key in sorted(self._waiting)]

    def answered(self, sample: TargetSample) -> None:
        """An image got its direction, or was refused, and waits no longer."""
        key = sample.time_ns, sample.target_id
        del self._waiting[key]
        self._answered[key] = sample
        self._order.append(key)
        if len(self._order) > _MOST_ANSWERED:
            del self._answered[self._order.popleft()]

    def doubt(self, time_ns: int) -> str:
        """Why images of a moment are in doubt: their source has said different things of one; empty where it has not.

        Of all targets alike, for names come from outside and could be any number.
        """
        return self._contradictions.text(self._contradictions.at(time_ns))

"""Pending images of targets: each waits until the pointings before and after it have been published.

Images of targets do not affect the pointings, which are equal to the last bit with and without the images.
"""

from collections import deque

from ship_estimation.rejection_rules import Rejection, StampConflicts, resolve_same_stamp
from theodolite_calib.samples.samples import TargetSample

MAX_WAITING = 1000
"""Maximum number of pending images; beyond it the oldest are rejected."""

_MAX_ANSWERED = 5000
"""Maximum number of answered images stored to detect repetitions, enough for more than one second of data."""

_Key = tuple[int, str]


class PendingTargets:
    """Pending images of one run, and recently answered images.

    An image is answered by a direction or a rejection.

    Args:
        stamp_conflicts: stamp conflicts of the source of the images.
    """

    def __init__(self, stamp_conflicts: StampConflicts) -> None:
        self._waiting: dict[_Key, tuple[TargetSample, int]] = {}
        self._answered: dict[_Key, TargetSample] = {}
        self._order: deque[_Key] = deque()
        self._stamp_conflicts = stamp_conflicts

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, sample: TargetSample, waiting_ns: int) -> Rejection | None:
        """Add an image; return the rejection of this or the replaced image, None if the stamp is new for the target."""
        key = sample.time_ns, sample.target_id
        waits = self._waiting.get(key)
        known = waits[0] if waits is not None else self._answered.get(key)
        if known is not None:
            takes_its_place, rejection = resolve_same_stamp(known, sample)
            self._stamp_conflicts.record(sample.source, sample.time_ns, rejection)
            if takes_its_place and waits is not None:
                self._waiting[key] = sample, waits[1]
            return rejection
        self._waiting[key] = sample, waiting_ns
        return None

    def remove_overflow(self) -> list[TargetSample]:
        """Remove and return the oldest images if too many are pending."""
        keys = sorted(self._waiting)[: max(len(self._waiting) - MAX_WAITING, 0)]
        return [self._waiting.pop(key)[0] for key in keys]

    def pending_images(self) -> list[tuple[TargetSample, int]]:
        """Return the pending images in the order of their stamps, each with its time of reception."""
        return [self._waiting[key] for key in sorted(self._waiting)]

    def mark_answered(self, sample: TargetSample) -> None:
        """Mark an image as answered."""
        key = sample.time_ns, sample.target_id
        del self._waiting[key]
        self._answered[key] = sample
        self._order.append(key)
        if len(self._order) > _MAX_ANSWERED:
            del self._answered[self._order.popleft()]

    def conflict_text(self, time_ns: int) -> str:
        """Return the text about recently received conflicting images at a time; empty without conflicts.

        All targets share one text, because there is no limit to the number of target names that a source may send.
        """
        return self._stamp_conflicts.text(self._stamp_conflicts.active_at(time_ns))

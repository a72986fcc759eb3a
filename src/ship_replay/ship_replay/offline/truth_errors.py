"""Errors of published outputs against the truth of a simulated bag.

A replay writes the errors to ``ship/error_arcsec`` and similar topics; an estimator never receives the truth.
"""

from collections import deque
from typing import Any

from ship_bags.stamps import ns_from_stamp, stamps_of_rows
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_node.messages.batch import OutputBlock
from ship_watch.orientations import Orientation

_TRUTH_GAP_NS = 1_000_000_000
_MAX_TRUTH_DELAY_NS = 2_000_000_000
"""Maximum delay of the truth after an output, ns; after this time an error message is written without errors."""


class TruthErrors:
    """Buffer of error messages until the truth at their stamps is known.

    Messages arrive in order of log time; completed messages keep their own log time.
    """

    def __init__(self, orientation: Orientation) -> None:
        self.orientation = orientation
        self._truth = AttitudeTrack(_TRUTH_GAP_NS)
        self._attitudes: dict[int, FloatArray] = {}
        self._pending: deque[tuple[int, Any]] = deque()

    def add_truth(self, sample: AttitudeSample | None) -> None:
        """Add a sample of the truth; None, from a message without an orientation, is ignored."""
        if sample is not None:
            self._truth.insert(sample)

    def add_attitude(self, message: Any) -> None:
        """Add a published message of the orientation."""
        self._attitudes[ns_from_stamp(message.header.stamp)] = self.orientation.angles_of(message)

    def add_block(self, block: OutputBlock) -> None:
        """Add published messages; messages on other topics are ignored."""
        if block.topic == self.orientation.topic:
            numbers = block.messages.numbers
            stamps_ns, angles = stamps_of_rows(numbers), self.orientation.angles_of_rows(numbers)
            self._attitudes.update(zip(stamps_ns.tolist(), angles, strict=True))

    @property
    def has_pending(self) -> bool:
        """True if an error message waits for the truth."""
        return bool(self._pending)

    def is_ready(self, now_ns: int | None) -> bool:
        """True if the oldest error message is ready: the truth is known, or the message has waited long enough."""
        if not self.has_pending:
            return False
        log_time_ns, message = self._pending[0]
        may_wait = now_ns is not None and now_ns - log_time_ns < _MAX_TRUTH_DELAY_NS
        return not may_wait or self._truth.at(ns_from_stamp(message.header.stamp)) is not None

    def add_error(self, message: Any, log_time_ns: int) -> None:
        """Add a published error message, whose errors are still empty."""
        self._pending.append((log_time_ns, message))

    def pop_ready(self, now_ns: int | None) -> list[tuple[int, Any]]:
        """Return (log time, message) of the error messages ready at ``now_ns`` (None: no more truth will come)."""
        ready: list[tuple[int, Any]] = []
        while self.is_ready(now_ns):
            log_time_ns, message = self._pending.popleft()
            stamp_ns = ns_from_stamp(message.header.stamp)
            truth, attitude = self._truth.at(stamp_ns), self._attitudes.get(stamp_ns)
            if truth is not None and attitude is not None:
                errors_arcsec = self.orientation.errors_arcsec(attitude, truth.rotation_nd)
                for channel, error in zip(self.orientation.channels, errors_arcsec.tolist(), strict=True):
                    setattr(message, f"error_{channel}", error)
            ready.append((log_time_ns, message))
            self._drop_before(stamp_ns)
        return ready

    def _drop_before(self, stamp_ns: int) -> None:
        self._truth.drop_before(stamp_ns)
        self._attitudes = {time: value for time, value in self._attitudes.items() if time >= stamp_ns}

"""Check for frozen sources, which repeat one value while other sources show a rotation of the ship.

A frozen sensor repeats one value to the last bit, and so does a healthy sensor with coarse resolution while there is
little motion. Other sources, the motion references, distinguish the two sensors by the rotation of the ship
(:class:`MotionCheck`). A healthy sensor repeats a value only while the rotation is below its estimated resolution.
"""

import math
from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import FloatArray, log_rotation
from ship_kernels import compiled_checks

_HISTORY_NS = 2_000_000_000
"""Maximum age of the recent attitudes of a reference that are compared with the current attitude, ns.

The first attitude is always compared. It is also the longest time after which a returning value counts as stuck."""
_SPACING_NS = 250_000_000
"""Spacing of the attitudes in a history, ns."""
_SIGMAS = 5.0
_REPEATS = 2
ROUNDING_SPREAD = 1.8
"""Bound of the error of a difference due to rounding to unit steps in three axes, a little more than sqrt(3)."""
_LEAST_NS = 500_000_000
"""Least time for which a value is repeated before it counts as frozen, ns; drivers occasionally repeat values."""
_UNKNOWN_RESOLUTION = np.deg2rad(0.1)
"""Resolution assumed before the value has changed, rad."""
_STEPS = 64
"""Number of the last changes of the value; the smallest of them is the resolution."""


class StuckValue(NamedTuple):
    """Value of a measurement that varies while the ship rotates.

    Attributes:
        value: an attitude, shape (3, 3), or directions, shape (k, 3) or (3,); empty for an exposure without stars.
        sigma_rad: largest standard deviation of the noise of the value.
        description: text for a rejection.
        is_attitude: True for an attitude relative to the horizon, which is a motion reference for other sources.
    """

    value: FloatArray
    sigma_rad: float
    description: str
    is_attitude: bool = False


def largest_sigma(covariance: FloatArray) -> float:
    """Return the largest standard deviation of a covariance's axes.

    Example:
        >>> largest_sigma(np.diag([1.0, 4.0, 9.0]))
        3.0
    """
    return math.sqrt(max(covariance.diagonal().tolist()))


class MotionReference(NamedTuple):
    """The ship's attitude by another source.

    Attributes:
        time_ns: time of the attitude.
        rotation: attitude relative to any constant frame, shape (3, 3).
        sigma_rad: standard deviation of the attitude noise about the worst axis.
        drift_rad_per_s: bound of the attitude drift, for example of integrated rates.
    """

    time_ns: int
    rotation: FloatArray
    sigma_rad: float
    drift_rad_per_s: float = 0.0


class StuckCheck:
    """Detects a source that repeats one value while other sources show motion.

    A source is stuck if a value has been repeated for half a second and a motion reference has rotated meanwhile by
    more than five sigma (of both sources) beyond the resolution of the source. The next different value is accepted. If
    exactly the stuck value returns within two seconds, the source is still stuck.

    Attributes:
        is_repeated: True if the last value is equal to the value before.
        coarseness_rad: resolution of the source's values, rad; zero if every value is new.

    >>> guard = StuckCheck()
    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> references = [MotionReference(n * 300_000_000, turned if n else np.eye(3), 1e-5) for n in range(3)]

    >>> [guard.observe(one.time_ns, np.eye(3), 1e-5, {"another": one}) for one in references]
    [False, False, True]
    """

    def __init__(self) -> None:
        self._current: _RepeatedValue | None = None
        self._former: _RepeatedValue | None = None
        self._left_ns = 0
        self._steps: deque[float] = deque(maxlen=_STEPS)
        self._repeated: deque[bool] = deque(maxlen=_STEPS)
        self._resolution_rad = self.coarseness_rad = float(_UNKNOWN_RESOLUTION)
        self.is_repeated = False

    def is_frozen(self, value: FloatArray) -> bool:
        """True if the source is stuck at this value."""
        return self._current is not None and self._current.is_stuck and _is_equal(value, self._current.value)

    def observe(
        self, time_ns: int, value: FloatArray, sigma_rad: float, motion_references: Mapping[str, MotionReference]
    ) -> bool:
        """Check the next value of the source; return True if the source is stuck.

        Args:
            time_ns: stamp of the value.
            value: an attitude, shape (3, 3), directions of stars, shape (k, 3), or angles, shape (2,).
            sigma_rad: noise of the value about its worst axis.
            motion_references: attitude by each other source at about the time of the value, by name of the source.
        """
        current = self._current
        if current is not None and _is_equal(value, current.value):
            current.repeats += 1
        else:
            current = self._start_value(time_ns, value, motion_references)
        self.is_repeated = current.repeats > 0
        if self.is_repeated:
            if current.motion_check is None:
                current.motion_check = MotionCheck(current.since_ns, current.first_references)
            turned = current.motion_check.has_turned(
                motion_references, sigma_rad, ROUNDING_SPREAD * self._resolution_rad
            )
            current.is_stuck = current.is_stuck or (turned and time_ns - current.since_ns >= _LEAST_NS)
        return current.is_stuck

    def count_new_values(self, first_ns: int, values: FloatArray) -> int:
        """Return the number of leading values that need no check, because no value is a repetition.

        Args:
            first_ns: stamp of the first value.
            values: attitudes as in :meth:`observe`, shape (N, 3, 3).
        """
        current = self._current
        if current is None or current.is_stuck or current.repeats or not self._steps or any(self._repeated):
            return 0
        if self._former is not None and first_ns - self._left_ns <= _HISTORY_NS:
            return 0
        new = (np.diff(values, axis=0, prepend=current.value[None]) != 0.0).any(axis=(1, 2))
        return len(new) if new.all() else int(np.argmin(new))

    def accept_new_values(
        self, time_ns: int, values: FloatArray, motion_references: Mapping[str, MotionReference]
    ) -> None:
        """Accept values without repetition, as counted by :meth:`count_new_values`.

        Args:
            time_ns: stamp of the last value.
            values: attitudes, shape (N, 3, 3), N at least 1.
            motion_references: as in :meth:`observe`, at the last value.
        """
        assert self._current is not None
        newest = values[-_STEPS:]
        before = values[-_STEPS - 1] if len(values) > _STEPS else self._current.value
        self._learn(before, newest)
        self._repeated.extend([False] * min(len(values), _STEPS))
        self.coarseness_rad, self.is_repeated = 0.0, False
        self._current = _RepeatedValue(values[-1], time_ns, dict(motion_references))

    def _start_value(
        self, time_ns: int, value: FloatArray, motion_references: Mapping[str, MotionReference]
    ) -> "_RepeatedValue":
        """Start a value that differs from the value before, either a new value or the frozen value again."""
        before, former = self._current, self._former
        if former is not None and time_ns - self._left_ns <= _HISTORY_NS and _is_equal(value, former.value):
            self._current, self._former = former, None
            return former
        if before is not None:
            if before.is_stuck:
                self._former, self._left_ns = before, time_ns
            else:
                self._repeated.append(before.repeats > 0)
                if before.value.shape == value.shape:
                    self._learn(np.atleast_2d(before.value), value.reshape(1, -1, value.shape[-1]))
                self.coarseness_rad = self._resolution_rad if any(self._repeated) or not self._steps else 0.0
        self._current = _RepeatedValue(value, time_ns, dict(motion_references))
        return self._current

    def _learn(self, before: FloatArray, values: FloatArray) -> None:
        """Estimate the resolution from changes of values, shape (N, k, l), after the value ``before``, shape (k, l)."""
        # The change of a rotation is the largest change of an axis. The change of directions is the largest change of a
        # star.
        self._steps.extend(filter(math.isfinite, compiled_checks.changes(before, values)))
        if self._steps:
            self._resolution_rad = min(self._steps)


class StuckChecks:
    """Stuck checks of several sources, each by comparison with all others.

    Attributes:
        motion_references: by source, the last attitude that passed the check or was accepted; used to check other
            sources.
    """

    def __init__(self) -> None:
        self.motion_references: dict[str, MotionReference] = {}
        self._checks: defaultdict[str, StuckCheck] = defaultdict(StuckCheck)
        self._latest_ns: dict[str, int] = {}

    def check(
        self, source: str, time_ns: int, measured: StuckValue, by_ins: Mapping[str, MotionReference]
    ) -> Rejection | None:
        """Return the rejection of a measurement that is constant while other sources rotate; None for any other.

        An attitude that passes becomes a motion reference. A measurement is checked only if it is newer than the last
        measurement of the same source that passed.

        Args:
            source: source of the measurement.
            time_ns: stamp of the measurement.
            measured: value of the measurement.
            by_ins: motion references by the INS (:meth:`InsCheck.motion_references`).
        """
        if time_ns <= self._latest_ns.get(source, time_ns - 1):
            return None
        value, sigma_rad, description, is_attitude = measured
        # Exposures without stars may repeat, also on a moving ship.
        if len(value) > 0:
            references = {name: reference for name, reference in self.motion_references.items() if name != source}
            if self._checks[source].observe(time_ns, value, sigma_rad, {**references, **by_ins}):
                return Rejection(Reason.STUCK, f"{description} while other sources rotate")
            if is_attitude:
                self.motion_references[source] = MotionReference(time_ns, value, sigma_rad)
        self._latest_ns[source] = time_ns
        return None


class MotionCheck:
    """Detects that a motion reference has rotated while a source repeated its value.

    Args:
        since_ns: stamp since which the value is repeated; earlier reference attitudes are ignored.
        first_references: reference attitudes when the value first appeared, by name.

    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> watch = MotionCheck(0, {"another": MotionReference(0, np.eye(3), sigma_rad=1e-5)})
    >>> [watch.has_turned({"another": MotionReference(time_ns, turned, 1e-5)}, 1e-5, 0.0) for time_ns in (1, 2)]
    [False, True]
    """

    def __init__(self, since_ns: int, first_references: Mapping[str, MotionReference]) -> None:
        self._since_ns = since_ns
        self._records: dict[str, _ReferenceHistory] = {}
        self.has_turned(first_references, 0.0, 0.0)

    def has_turned(
        self, motion_references: Mapping[str, MotionReference], sigma_rad: float, resolution_rad: float
    ) -> bool:
        """True if two successive attitudes of a reference show a rotation that would change a healthy source's value.

        Args:
            motion_references: current reference attitudes, by name.
            sigma_rad: standard deviation of the noise of the repeated value about the worst axis.
            resolution_rad: largest rotation that the value cannot resolve.
        """
        turned = False
        for name, now in motion_references.items():
            if now.time_ns < self._since_ns:
                continue
            if name not in self._records:
                self._records[name] = _ReferenceHistory(now)
            turned = self._records[name].add(now, sigma_rad, resolution_rad) or turned
        return turned


class _ReferenceHistory:
    """Attitudes of one reference while a value is repeated.

    Args:
        first: the first attitude of the reference.
    """

    def __init__(self, first: MotionReference) -> None:
        self._first = self._last = first
        self._recent: deque[MotionReference] = deque([first])
        self._turn_count = 0

    def add(self, now: MotionReference, sigma_rad: float, resolution_rad: float) -> bool:
        """Add the current attitude; return True if two successive attitudes show a rotation.

        A rotation exceeds five sigma of all noise plus the drift of the reference and the resolution of the value. Two
        successive attitudes are required, because over hours single attitudes exceed five sigma. An attitude that is
        not later than the last attitude is ignored.
        """
        if now.time_ns > self._last.time_ns:
            moved = any(_has_turned(then, now, sigma_rad, resolution_rad) for then in (self._first, *self._recent))
            self._turn_count = self._turn_count + 1 if moved else 0
            self._last = now
            if now.time_ns - self._recent[-1].time_ns >= _SPACING_NS:
                self._recent.append(now)
            while now.time_ns - self._recent[0].time_ns > _HISTORY_NS:
                self._recent.popleft()
        return self._turn_count >= _REPEATS


def _has_turned(then: MotionReference, now: MotionReference, sigma_rad: float, resolution_rad: float) -> bool:
    noise_rad = np.hypot(sigma_rad, np.hypot(then.sigma_rad, now.sigma_rad))
    drift_rad = now.drift_rad_per_s * (now.time_ns - then.time_ns) * 1e-9
    bound_rad = _SIGMAS * noise_rad + drift_rad + resolution_rad
    return bool(np.linalg.norm(log_rotation(then.rotation.T @ now.rotation)) > bound_rad)


@dataclass
class _RepeatedValue:
    """A value, the stamp since which the source repeats it, and the motion references at that stamp."""

    value: FloatArray
    since_ns: int
    first_references: Mapping[str, MotionReference]
    repeats: int = 0
    is_stuck: bool = False
    motion_check: MotionCheck | None = None


def _is_equal(value: FloatArray, other: FloatArray) -> bool:
    """True if two values, not empty, are equal to the bit; the first numbers are compared first, for speed."""
    return bool(value.item(0) == other.item(0)) and np.array_equal(value, other)

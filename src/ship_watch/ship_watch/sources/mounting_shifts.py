"""Mounting shifts: change of a device's installation angles between its exclusion and its reinstatement."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance
from ship_geometry.rotations import FloatArray, log_rotation
from ship_watch.sources.decision_history import angle_text
from ship_watch.suite_state import Presence, SourceState
from ship_watch.topics import MAX_NAMES, has_room

DISPLAY_TIME_NS = 600 * NS_PER_S
"""Time for which a shift is shown after the reinstatement, ns."""

_ANGLES = {"star": ("azimuth", "elevation", "roll"), "reference": ("heading", "pitch", "roll")}
"""Kind of a device → names of its installation angles in ``ship/alignment``, azimuth first."""

_THRESHOLD = 16.27
"""Threshold of the squared shift normalised by its covariance: χ² of three degrees of freedom, 99.9 %."""

_PERIOD_NS = NS_PER_S
_KEPT = 10
_BEFORE_NS = 2 * NS_PER_S
"""Minimum time from the estimate of the mounting before a fault to the first rejection, ns. Later estimates may contain
the fault."""


@dataclass(frozen=True)
class MountingEstimate:
    """Estimated installation angles of a device at one time: azimuth, elevation, roll, rad, and covariance, rad²."""

    utc_ns: int
    angles: FloatArray
    covariance: FloatArray


class MountingShifts:
    """Mounting shifts of all devices, from ``ship/alignment`` and the presence of the sources."""

    def __init__(self) -> None:
        self._estimates: dict[str, deque[MountingEstimate]] = {}
        self._before: dict[str, MountingEstimate] = {}
        self._reinstated_ns: dict[str, int] = {}
        self._shifts: dict[str, tuple[float, int]] = {}

    def record_alignment(self, message: Any) -> None:
        """Record the installation angles in an AlignmentState, at most once a second."""
        count = len(message.names)
        covariance = np.asarray(message.covariance, dtype=float)
        if count > MAX_NAMES or covariance.size != count**2:
            return
        covariance, utc_ns = covariance.reshape(count, count), ns_from_stamp(message.header.stamp)
        places = {str(name): place for place, name in enumerate(message.names)}
        devices = {name.rpartition(".")[0] for name in places}
        for device in devices:
            wanted = [places.get(f"{device}.{angle}") for angle in _ANGLES.get(device.partition(".")[0], ())]
            rows = [place for place in wanted if place is not None and place < len(message.values)]
            if len(rows) == 3 and has_room(self._estimates, device, "device"):
                kept = self._estimates.setdefault(device, deque(maxlen=_KEPT))
                angles = np.array([float(message.values[row]) for row in rows])
                if not kept or utc_ns - kept[-1].utc_ns >= _PERIOD_NS:
                    kept.append(MountingEstimate(utc_ns, angles, covariance[np.ix_(rows, rows)]))

    def record_sources(self, sources: Iterable[SourceState], utc_ns: int) -> list[tuple[str, str]]:
        """Record the presence of the sources; return name and text of each device reinstated with a shifted mounting.

        The shift of a reinstated device is computed from the first alignment estimated after its reinstatement.
        """
        for source in sources:
            name, kept = source.name, self._estimates.get(source.name)
            if source.presence is Presence.OUT and not source.because_of and kept:
                self._reinstated_ns.pop(name, None)
                latest_ns = source.out_since_ns - _BEFORE_NS
                estimate = next((each for each in reversed(kept) if each.utc_ns <= latest_ns), kept[0])
                self._before.setdefault(name, estimate)
            elif source.presence is Presence.IN and name in self._before:
                self._reinstated_ns.setdefault(name, utc_ns)
        found = []
        for name, since_ns in list(self._reinstated_ns.items()):
            if self._estimates[name][-1].utc_ns > since_ns:
                del self._reinstated_ns[name]
                shift = significant_shift(self._before.pop(name), self._estimates[name][-1])
                if shift > 0.0:
                    self._shifts[name] = shift, utc_ns
                    found.append((name, f"{name} reinstated, mounting shifted by {angle_text(shift)}"))
        return found

    def shift_of(self, name: str, utc_ns: int) -> float:
        """Return the shift of a device that was reinstated within the last ten minutes, rad; NaN if there is none."""
        shift, since_ns = self._shifts.get(name, (math.nan, 0))
        return shift if utc_ns - since_ns <= DISPLAY_TIME_NS else math.nan


def significant_shift(before: MountingEstimate, after: MountingEstimate) -> float:
    """Return the angle between two mountings, rad; 0 if it is not significant, or a covariance is unknown."""
    rotation = rotation_from_angles(*after.angles.tolist()) @ rotation_from_angles(*before.angles.tolist()).T
    shift_v = log_rotation(rotation)
    covariance = sum(rotation_vector_covariance(each.covariance, *each.angles[:2].tolist()) for each in (before, after))
    try:
        squared = float(shift_v @ np.linalg.solve(np.asarray(covariance), shift_v))
    except np.linalg.LinAlgError:
        return 0.0
    return float(np.linalg.norm(shift_v)) if squared > _THRESHOLD else 0.0

"""Histories of a source: decisions on its last measurements, with the rejected residuals, and its mounting shifts.

A mounting shift is the change of a device's installation angles between its exclusion and its reinstatement.
"""

import math
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_watch.suite_state import Presence, SourceState
from ship_watch.topics import MAX_NAMES, has_room

_REJECTIONS_KEPT = 5
"""Number of rejected messages from which the disagreement of a source is computed."""

MIN_DISPLAY_NS = 2_000_000_000
"""Minimum time for which a fault is displayed after its last report, ns."""

_DECISIONS_KEPT = 24
"""Minimum number of stored decisions, which later messages may revise."""

_IN_A_ROW_PERIODS = 1.5
"""Interval between two rejections, in periods, above which unreported acceptances between the two are assumed."""

_DEGREE_FROM_ARCSEC = 3600.0
_REASONS = {int(reason) for reason in Reason}

_ROTATION_SENSES = {
    "forward": ("clockwise", "counterclockwise"), "up": ("to the left", "to the right"), "right": ("high", "low")
}
"""Axis of a device → words for a positive and a negative rotation about this axis, looking forward."""

_DIRECTION_SENSES = {
    "up": ("stars", "high", "low"),
    "right": ("stars", "to the right", "to the left"),
    "x": ("lights", "to the left", "to the right"),
    "z": ("lights", "low", "high"),
}
"""Axis of a direction → measured objects, and words for a positive and a negative residual. The image with the axes x
and z is inverted."""

DISPLAY_TIME_NS = 600 * NS_PER_S
"""Time for which a shift is shown after the reinstatement, ns."""

_ANGLES = {"star": ("azimuth", "elevation", "roll"), "reference": ("heading", "pitch", "roll")}
"""Kind of a device → names of its installation angles in ``ship/alignment``, azimuth first."""

_SHIFT_THRESHOLD = 16.27
"""Threshold of the squared shift normalised by its covariance: χ² of three degrees of freedom, 99.9 %."""

_SHIFT_PERIOD_NS = NS_PER_S
_SHIFTS_KEPT = 10
_SHIFT_BEFORE_NS = 2 * NS_PER_S
"""Minimum time from the estimate of the mounting before a fault to the first rejection, ns. Later estimates may contain
the fault."""


@dataclass(frozen=True)
class Disagreement:
    """Largest offset of a source: text for people ("reads 49″ high"), and mean of residual over sigma."""

    text: str
    sigmas: float


NO_DISAGREEMENT = Disagreement("", math.nan)


class DecisionHistory:
    """Measurement decisions on one source at one node, in the order of their messages.

    For star sensors and lights each measurement is reported, for INS and encoders only rejected measurements.

    Args:
        rejections_until_out: number of rejections in a row after which the source is OUT.
        acceptances_until_in: number of acceptances in a row after which the source is IN again.

    Attributes:
        is_out: True after enough rejections in a row, until enough acceptances in a row.
        rejected_in_a_row: current number of rejections in a row.
        out_since_ns: stamp of the first of the rejections due to which the source is OUT; 0 if it is IN.
        last_rejection_ns: arrival of the last rejection; None before the first rejection.
        reason: reason of the last rejection.
        has_acceptances: True if accepted measurements are reported too.
    """

    def __init__(self, rejections_until_out: int, acceptances_until_in: int) -> None:
        self._out_after, self._in_after = rejections_until_out, acceptances_until_in
        self._kept = max(_DECISIONS_KEPT, acceptances_until_in)
        self._decisions: list[tuple[int, bool]] = []
        self._rejected_messages: deque[Any] = deque(maxlen=_REJECTIONS_KEPT)
        self.is_out, self.rejected_in_a_row, self.out_since_ns = False, 0, 0
        self.last_rejection_ns: int | None = None
        self.reason = Reason.NONE
        self.has_acceptances = False

    def record(self, stamp_ns: int, message: Any, now_ns: int, period_ns: float) -> None:
        """Record an Innovation; ``period_ns`` is the usual time between measurements, NaN if unknown."""
        accepted, revised = bool(message.accepted), message.reason == Reason.REVISED
        self.has_acceptances = self.has_acceptances or accepted
        if not accepted:
            self.last_rejection_ns = now_ns
            if not revised:
                self.reason = Reason(message.reason) if message.reason in _REASONS else Reason.NONE
            # The estimate adapts to an excluded source, so that the residuals of this source become small. Its offset
            # is therefore computed only from rejections by the gate.
            if len(message.residual) and not message.nis <= message.gate:
                self._rejected_messages.append(message)
        self._add_decision(stamp_ns, accepted, revised, period_ns)
        self._update_presence()

    def record_exposure(self, stamp_ns: int, is_used: bool, now_ns: int) -> None:
        """Record the decision on a whole exposure, after rejections of single stars or lights in it."""
        self.has_acceptances = self.has_acceptances or is_used
        if not is_used:
            self.last_rejection_ns, self.reason = now_ns, Reason.TOO_FEW_STARS
        self._add_decision(stamp_ns, is_used, False, math.nan)
        self._update_presence()

    def reinstate_if_used(self, now_ns: int, period_ns: float, used_since: int) -> None:
        """Reinstate a source without reported acceptances after enough time without rejection and enough use.

        Args:
            now_ns: caller's time, ns.
            period_ns: usual time between measurements, ns; NaN if unknown.
            used_since: number of measurements used since the last rejection.
        """
        if self.has_acceptances or self.last_rejection_ns is None:
            return
        least_ns = MIN_DISPLAY_NS if math.isnan(period_ns) else max(MIN_DISPLAY_NS, self._in_after * period_ns)
        if now_ns - self.last_rejection_ns >= least_ns and used_since >= self._in_after:
            self._decisions.clear()
            self._reinstate()
            self.rejected_in_a_row = 0

    @property
    def accepted_in_a_row(self) -> int:
        """Current number of acceptances in a row."""
        return self._run_length(True)

    @property
    def disagreement(self) -> Disagreement:
        """Largest offset in the last rejected residuals."""
        return disagreement(self._rejected_messages) if self._rejected_messages else NO_DISAGREEMENT

    def _add_decision(self, stamp_ns: int, accepted: bool, revised: bool, period_ns: float) -> None:
        """Append a decision, in the order of arrival, or revise the decision with the same stamp."""
        decisions = self._decisions
        index = next((place for place in range(len(decisions) - 1, -1, -1) if decisions[place][0] == stamp_ns), None)
        if index is not None:
            self._revise_decision(index, accepted, revised)
            return
        if revised:
            return
        if accepted:
            self.rejected_in_a_row = 0
        else:
            # If the period is unknown (NaN), all rejections count as one run.
            is_separate = (
                decisions and stamp_ns - decisions[-1][0] > _IN_A_ROW_PERIODS * period_ns and not self.has_acceptances
            )
            self.rejected_in_a_row = 1 if is_separate else self.rejected_in_a_row + 1
            if is_separate:
                decisions.clear()
        decisions.append((stamp_ns, accepted))
        if len(decisions) > self._kept:
            del decisions[0]

    def _revise_decision(self, index: int, accepted: bool, revised: bool) -> None:
        """Update a decision: a measurement is accepted if any of its parts is, unless the message is a revision."""
        decisions = self._decisions
        stamp_ns, was_accepted = decisions[index]
        decisions[index] = (stamp_ns, accepted if revised else accepted or was_accepted)
        run = self._run_length(False)
        self.rejected_in_a_row = max(run, self.rejected_in_a_row) if run == len(decisions) else run

    def _update_presence(self) -> None:
        if self.rejected_in_a_row >= self._out_after and not self.is_out:
            self.is_out = True
            self.out_since_ns = self._decisions[-min(self.rejected_in_a_row, len(self._decisions))][0]
        elif self.is_out and self.accepted_in_a_row >= self._in_after:
            self._reinstate()

    def _reinstate(self) -> None:
        self.is_out, self.out_since_ns = False, 0
        self._rejected_messages.clear()

    def _run_length(self, accepted: bool) -> int:
        run = 0
        for _, decision in reversed(self._decisions):
            if decision is not accepted:
                break
            run += 1
        return run


def disagreement(messages: "deque[Any]") -> Disagreement:
    """Return the axis or the component with the largest mean of residual over sigma.

    The last word of a component's name is the axis; the words before the axis name a star or a light. Similar residuals
    of all stars along an axis show a rotation of the device, and their mean is returned. Otherwise the star or light
    with the largest offset is returned.

    Args:
        messages: innovations with residuals and sigmas, rad.
    """
    parts: dict[str, list[tuple[float, float]]] = {}
    for message in messages:
        for name, residual, sigma in zip(message.components, message.residual, message.sigma, strict=False):
            if math.isfinite(residual) and sigma > 0.0:
                parts.setdefault(name, []).append((float(residual), float(residual / sigma)))
    axes: dict[str, list[tuple[float, float]]] = {}
    for name, values in parts.items():
        axes.setdefault(name.rpartition(" ")[2], []).extend(values)
    best = max(((name, *np.mean(values, axis=0)) for name, values in axes.items()), key=_size_in_sigmas, default=None)
    worst = max(((name, *np.mean(values, axis=0)) for name, values in parts.items()), key=_size_in_sigmas, default=None)
    if best is None or worst is None:
        return NO_DISAGREEMENT
    name, residual, sigmas = best if _size_in_sigmas(best) >= max(1.0, 0.3 * _size_in_sigmas(worst)) else worst
    return Disagreement(_offset_text(name, float(residual), parts), float(sigmas))


def _offset_text(name: str, residual: float, components: Collection[str]) -> str:
    """Return the offset of a component, or of an axis: "reads 49″ high", "HIP 85355 reads 90″ to the left".

    Args:
        name: name of a component, or of an axis that several components share.
        residual: measured minus predicted value, rad.
        components: names of all components; the name of a component of an attitude is only the axis of rotation.
    """
    thing, _, axis = name.rpartition(" ")
    size, is_negative = angle_text(residual), residual < 0.0
    if axis in components:
        return f"reads {size} {_ROTATION_SENSES.get(axis, (f'in {axis}',) * 2)[is_negative]}"
    all_things, *senses = _DIRECTION_SENSES.get(axis, ("all", f"in {axis}", f"in {axis}"))
    things = {component.rpartition(" ")[0] for component in components}
    subject = f"{thing or things.pop()} reads" if thing or len(things) == 1 else f"{all_things} read"
    return f"{subject} {size} {senses[is_negative]}"


def angle_text(angle: float) -> str:
    """Return the size of an angle, rad, as text: in seconds of arc below one degree, else in degrees."""
    size = abs(angle / ARCSEC)
    return f"{size / _DEGREE_FROM_ARCSEC:.1f}°" if size >= _DEGREE_FROM_ARCSEC else f"{size:.0f}″"


def _size_in_sigmas(entry: tuple[str, float, float]) -> float:
    return abs(entry[2])


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
                kept = self._estimates.setdefault(device, deque(maxlen=_SHIFTS_KEPT))
                angles = np.array([float(message.values[row]) for row in rows])
                if not kept or utc_ns - kept[-1].utc_ns >= _SHIFT_PERIOD_NS:
                    kept.append(MountingEstimate(utc_ns, angles, covariance[np.ix_(rows, rows)]))

    def record_sources(self, sources: Iterable[SourceState], utc_ns: int) -> list[tuple[str, str]]:
        """Record the presence of the sources; return name and text of each device reinstated with a shifted mounting.

        The shift of a reinstated device is computed from the first alignment estimated after its reinstatement.
        """
        for source in sources:
            name, kept = source.name, self._estimates.get(source.name)
            if source.presence is Presence.OUT and not source.because_of and kept:
                self._reinstated_ns.pop(name, None)
                latest_ns = source.out_since_ns - _SHIFT_BEFORE_NS
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
    return float(np.linalg.norm(shift_v)) if squared > _SHIFT_THRESHOLD else 0.0

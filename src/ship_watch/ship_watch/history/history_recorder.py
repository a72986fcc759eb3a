"""Recorder of the plot buffers: innovations, budgets, errors, safety, detected stars and lights.

An error budget contains covariances of a small rotation vector about East, North and Up. The recorder converts each
covariance to variances of heading, pitch and roll, or of azimuth and elevation of a line of sight.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, horizon_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_watch.history.history import (
    BeaconDetections,
    BudgetPoint,
    ErrorPoint,
    History,
    InnovationPoint,
    ParameterEstimate,
    SafetyPoint,
    StarExposures,
    append,
    append_point,
    replace_or_append,
)
from ship_watch.orientations import POINTING, SHIP_ATTITUDE, Orientation
from ship_watch.suite_state import ANGLES, Safety
from ship_watch.topics import MAX_NAME_LENGTH, MAX_NAMES, has_room, source_of_name, source_of_topic

_TRUTH_GAP_NS = NS_PER_S
_ERROR_PERIOD_NS = NS_PER_S // 2
"""Minimum interval between errors against truth, ns."""

_MAX_PENDING = 20
"""Maximum number of outputs that wait for the truth at their stamps; the oldest are dropped."""

_INSTALLED = ("star.", "reference.", "focal_length", "telescope_")
"""Prefixes of names of estimated states whose nominal value is not zero."""

_ERRORS = ".time_offset", ".focal_length", ".principal_u", ".principal_v", ".distortion_k1"
"""Endings of names of states that are nominally zero in spite of a prefix of :data:`_INSTALLED`."""


class ErrorsAgainstTruth:
    """Errors of an output, from its error topic or computed against the truth topic.

    A live estimator does not receive the truth, so its error topic contains NaN. The outputs are then compared with the
    truth topic, interpolated to their stamps.
    """

    def __init__(self, orientation: Orientation, history: History) -> None:
        self._orientation, self._history = orientation, history
        self._truth = AttitudeTrack(_TRUTH_GAP_NS)
        self._pending: deque[tuple[int, FloatArray, FloatArray]] = deque(maxlen=_MAX_PENDING)
        self._last_ns = 0
        self._has_published_errors = False

    def record_published_error(self, message: Any) -> None:
        """Record a message of the output's error topic. A message without errors is ignored if the truth is known."""
        channels = self._orientation.channels
        error = {name: float(getattr(message, f"error_{name}")) for name in channels}
        has_values = any(math.isfinite(value) for value in error.values())
        self._has_published_errors = self._has_published_errors or has_values
        if has_values or len(self._truth) == 0:
            sigma = {name: float(getattr(message, f"sigma_{name}")) for name in channels}
            self._append(ErrorPoint(ns_from_stamp(message.header.stamp), error, sigma))

    def record_output(self, message: Any, stamp_ns: int) -> None:
        """Record an output for the comparison with the truth."""
        if self._has_published_errors or len(self._truth) == 0 or message.status == Status.INVALID:
            return
        if stamp_ns - self._last_ns >= _ERROR_PERIOD_NS:
            self._last_ns = stamp_ns
            variances = np.array([message.covariance[0], message.covariance[4], message.covariance[8]])
            angles = self._orientation.angles_of(message)
            if np.all(np.isfinite(angles)):
                self._pending.append((stamp_ns, angles, variances))

    def record_truth(self, message: Any) -> None:
        """Record a sample of the truth, and add the errors of the outputs up to its time."""
        sample = self._orientation.sample(message)
        if sample is not None:
            self._truth.insert(sample)
        newest = self._truth.newest
        while self._pending and newest is not None and self._pending[0][0] <= newest.time_ns:
            stamp_ns, angles, variances = self._pending.popleft()
            truth = self._truth.at(stamp_ns)
            if truth is not None:
                errors = self._orientation.errors_arcsec(angles, truth.rotation_nd)
                given = np.where(variances > 0.0, variances, np.nan)
                sigmas = np.sqrt(given) * np.abs(self._orientation.scale(angles)) / ARCSEC
                self._append(ErrorPoint(stamp_ns, self._by_channel(errors), self._by_channel(sigmas)))
        if newest is not None:
            self._truth.drop_before(newest.time_ns - 2 * _TRUTH_GAP_NS)

    def _by_channel(self, values: FloatArray) -> Mapping[str, float]:
        return dict(zip(self._orientation.channels, values.tolist(), strict=True))

    def _append(self, point: ErrorPoint) -> None:
        append(self._history.errors, self._orientation.error_topic, point)


class HistoryRecorder:
    """Records the messages for the plots.

    Attributes:
        history: the recorded data.
    """

    def __init__(self) -> None:
        self.history = History()
        self._errors = {
            orientation.topic: ErrorsAgainstTruth(orientation, self.history)
            for orientation in (SHIP_ATTITUDE, POINTING)
        }
        self._stars, self._lights = StarExposures(self.history), BeaconDetections(self.history)
        self._directions: dict[str, tuple[float, float]] = {}
        self._nominal: dict[str, float] = {}
        self._second = 0
        self._safety: dict[str, Safety | None] = {}

    def record_output(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Record a ShipAttitude or an OpticalAxisPointing."""
        if message.status != Status.INVALID:
            is_ship = topic == SHIP_ATTITUDE.topic
            fields = ("heading", "pitch") if is_ship else ("azimuth", "elevation")
            self._directions[topic] = float(getattr(message, fields[0])), float(getattr(message, fields[1]))
        self._errors[topic].record_output(message, stamp_ns)

    def record_truth(self, topic: str, message: Any) -> None:
        """Record a message of truth/attitude or truth/pointing."""
        orientation = SHIP_ATTITUDE if topic == SHIP_ATTITUDE.truth_topic else POINTING
        self._errors[orientation.topic].record_truth(message)

    def record_error(self, topic: str, message: Any) -> None:
        """Record a message of ship/error_arcsec or theodolite/error_arcsec."""
        orientation = SHIP_ATTITUDE if topic == SHIP_ATTITUDE.error_topic else POINTING
        self._errors[orientation.topic].record_published_error(message)

    def record_innovation(self, source: str, message: Any, now_ns: int) -> None:
        """Record an Innovation of a source; innovations without components are not plotted."""
        if not len(message.components):
            return
        point = innovation_point(message)
        if message.reason == Reason.REVISED:
            replace_or_append(self.history.innovations, source, point)
        else:
            append(self.history.innovations, source, point)
        if source.startswith("star."):
            self._stars.add_innovation(source, message)
        elif source_of_name(str(message.source)) == "lights":
            self._lights.add_innovation(message, now_ns)

    def record_input(self, topic: str, message: Any, now_ns: int) -> None:
        """Record stars, a star solution, lights or a GNSS fix."""
        source = source_of_topic(topic)
        if topic == "theodolite/beacons":
            self._lights.add_image(message, now_ns)
        elif topic == "gnss/fix":
            if math.isfinite(message.latitude) and math.isfinite(message.longitude):
                self.history.position = math.radians(message.latitude), math.radians(message.longitude)
        elif topic.endswith("/observations"):
            self._stars.add_exposure(source, message)
        else:
            self._stars.add_solution(source, message)

    def record_budget(self, topic: str, message: Any) -> None:
        """Record an ErrorBudget."""
        if len(message.sources) > MAX_NAMES:
            return
        names = [str(name)[:MAX_NAME_LENGTH] for name in message.sources]
        parts = np.asarray(message.covariances, dtype=float)
        if parts.size != 9 * len(names):
            return
        parts = parts.reshape(-1, 3, 3)
        covariances = dict(zip(names, parts, strict=False))
        output = SHIP_ATTITUDE.topic if topic.startswith("ship/") else POINTING.topic
        is_ship, by_angle = output == SHIP_ATTITUDE.topic, {}
        if direction := self._directions.get(output):
            by_angle = angle_variances(covariances, *direction, is_deck=is_ship)
        append(self.history.budgets, topic, BudgetPoint(ns_from_stamp(message.header.stamp), by_angle))

    def record_parameters(self, topic: str, message: Any) -> None:
        """Record an AlignmentState or a TheodoliteCalibration."""
        if len(message.names) > MAX_NAMES:
            return
        unobservable = {
            name for combination in getattr(message, "unobservable", ()) for name in str(combination).split()
        }
        names, count = [str(name) for name in message.names], len(message.names)
        covariance = np.asarray(message.covariance, dtype=float)
        variances = covariance.reshape(count, count).diagonal() if covariance.size == count**2 else [math.nan] * count
        estimates = []
        for name, value, variance, unit in zip(names, message.values, variances, message.units, strict=False):
            sigma = math.sqrt(variance) if variance >= 0.0 else math.nan
            is_observable = name not in unobservable and math.isfinite(value) and math.isfinite(sigma)
            nominal = self._nominal_of(name, float(value))
            estimates.append(ParameterEstimate(name, float(value), sigma, str(unit), is_observable, nominal))
        if topic == "ship/alignment":
            self.history.alignment = tuple(estimates)
        else:
            self.history.calibration = tuple(estimates)

    def record_safety(self, utc_ns: int, safety: Mapping[str, Safety | None]) -> None:
        """Record the safety of each angle; the worst safety of each second is added at the end of the second."""
        second = utc_ns // NS_PER_S
        if second != self._second:
            if self._safety and second > self._second:
                append_point(self.history.safety, SafetyPoint(self._second * NS_PER_S, self._safety))
            self._second, self._safety = second, dict.fromkeys(ANGLES)
        for name, angle_safety in safety.items():
            known = self._safety.get(name)
            if angle_safety is not None and (known is None or angle_safety > known):
                self._safety[name] = angle_safety

    def _nominal_of(self, name: str, value: float) -> float:
        """Return the nominal value of a state: zero for an error, else the first received value."""
        if not name.startswith(_INSTALLED) or name.endswith(_ERRORS):
            return 0.0
        if math.isnan(value):
            return self._nominal.get(name, math.nan)
        return self._nominal.setdefault(name, value) if has_room(self._nominal, name, "state") else value


def angle_variances(
    covariances: Mapping[str, FloatArray], azimuth: float, elevation: float, is_deck: bool
) -> dict[str, dict[str, float]]:
    """Return the variance of each displayed angle by source of error.

    Args:
        covariances: source of error → covariance of a small rotation vector about (East, North, Up), rad²,
            shape (3, 3).
        azimuth: azimuth of the line of sight, or heading of the deck, rad.
        elevation: elevation of the line of sight, or pitch of the deck, rad.
        is_deck: True for heading, pitch and roll, False for azimuth and elevation.

    Returns:
        Angle → source → variance, rad². The variance of the azimuth is multiplied by the squared cosine of the
        elevation. The variance is NaN if the budget is unknown, or if the line of sight points to the zenith.

    Example:
        A tilt about North by 1 mrad is pitch if the heading is East, and roll if the heading is North:

        >>> about_north = {"ins": np.diag([0.0, 1e-6, 0.0])}
        >>> east = angle_variances(about_north, np.pi / 2, 0.0, is_deck=True)
        >>> {angle: round(by_source["ins"] * 1e6, 6) for angle, by_source in east.items()}
        {'heading': 0.0, 'pitch': 1.0, 'roll': 0.0}
    """
    names = ("heading", "pitch", "roll") if is_deck else ("azimuth", "elevation")
    transport = angle_errors_from_rotation_vector(np.asarray(azimuth), np.asarray(elevation))
    if not is_deck:
        transport = transport * [[np.cos(elevation)], [1.0], [1.0]]
    found: dict[str, dict[str, float]] = {name: {} for name in names}
    for source, covariance in covariances.items():
        of_angles = transport @ horizon_covariance(covariance) @ transport.T
        for index, name in enumerate(names):
            found[name][source] = float(of_angles[index, index])
    return found


def innovation_point(message: Any) -> InnovationPoint:
    """Return the plot point of an Innovation.

    The last word of a component's name is the axis; the words before the axis name a star or a light.
    """
    split = [str(name).rpartition(" ") for name in message.components]
    axes = tuple(dict.fromkeys(axis for _, _, axis in split))
    names = tuple(dict.fromkeys(part for part, _, _ in split))
    parts, sigmas = np.full((len(names), len(axes)), math.nan), np.full((len(names), len(axes)), math.nan)
    for (part, _, axis), residual, sigma in zip(split, message.residual, message.sigma, strict=False):
        place = names.index(part), axes.index(axis)
        parts[place], sigmas[place] = residual, sigma
    return InnovationPoint(
        utc_ns=ns_from_stamp(message.header.stamp),
        axes=axes,
        mean=_mean(parts),
        sigma=np.sqrt(_mean(sigmas**2)),
        is_accepted=bool(message.accepted),
    )


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean of the finite values of each column; NaN for a column without finite values."""
    finite = np.isfinite(values)
    if len(values) == 1:
        return np.where(finite[0], values[0], math.nan)
    sums, counts = np.where(finite, values, 0.0).sum(axis=0), finite.sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), math.nan)

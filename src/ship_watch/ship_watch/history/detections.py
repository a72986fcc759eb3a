"""Detected stars and lights, joined with their innovations.

The detections arrive in one message, decision and residuals in another message with the same stamp. Either message may
arrive first.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import FloatArray
from ship_watch.history.history import BeaconPoint, ExposurePoint, History, append

_PENDING_MESSAGES = 8
"""Maximum number of exposures of a sensor, and of innovations, that wait for their counterpart."""

_INNOVATION_TIMEOUT_NS = 3_000_000_000
"""Time without an innovation after which lights are shown without residuals, ns."""

_NO_VALUES = np.empty(0)


class StarExposures:
    """Last exposure of each star sensor, stored in ``History.star_exposures`` by source."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._exposures: dict[str, deque[Any]] = {}
        self._innovations: dict[str, deque[Any]] = {}
        self._solutions: dict[str, Any] = {}

    def add_exposure(self, source: str, message: Any) -> None:
        """Add a StarObservationArray."""
        self._exposures.setdefault(source, deque(maxlen=_PENDING_MESSAGES)).append(message)
        self._join(source)

    def add_solution(self, source: str, message: Any) -> None:
        """Add a StarHorizonAttitude."""
        self._solutions[source] = message

    def add_innovation(self, source: str, message: Any) -> None:
        """Add the Innovation of a measurement of a star sensor."""
        self._innovations.setdefault(source, deque(maxlen=_PENDING_MESSAGES)).append(message)
        self._join(source)

    def _join(self, source: str) -> None:
        """Store the newest exposure that has an innovation, or the newest innovation of a sensor without exposures."""
        innovations, exposures = self._innovations.get(source, ()), self._exposures.get(source)
        if not innovations:
            return
        if exposures is None:
            self._store(source, innovations[-1], None)
            return
        by_stamp = {ns_from_stamp(innovation.header.stamp): innovation for innovation in innovations}
        for exposure in reversed(exposures):
            if verdict := by_stamp.get(ns_from_stamp(exposure.header.stamp)):
                self._store(source, verdict, exposure)
                return

    def _store(self, source: str, innovation: Any, exposure: Any) -> None:
        utc_ns, solution = ns_from_stamp(innovation.header.stamp), self._solutions.get(source)
        known = self._history.star_exposures.get(source)
        if known is not None and known.utc_ns > utc_ns:
            return
        stars = exposure.stars if exposure is not None else ()
        names = [f"HIP {star.catalogue_id}" for star in stars]
        residuals = _residuals_by_object(innovation)
        used = sum(1 for name in residuals if name)
        if not used and solution is not None:
            used = int(solution.star_count)
        excluded = len(names) - used if names else int(solution.rejected_count) if solution is not None else 0
        self._history.star_exposures[source] = ExposurePoint(
            utc_ns=utc_ns,
            u=np.array([star.u for star in stars], dtype=float),
            v=np.array([star.v for star in stars], dtype=float),
            is_accepted=bool(innovation.accepted),
            star_count=used,
            rejected_count=max(excluded, 0),
            azimuth=float(solution.azimuth) if solution is not None else math.nan,
            elevation=float(solution.elevation) if solution is not None else math.nan,
            residual_right=_star_residuals(names, residuals, "right"),
            residual_up=_star_residuals(names, residuals, "up"),
        )


class BeaconDetections:
    """Lights of each image on the detector, stored in :attr:`ship_watch.history.history.History.beacons` by beacon."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._images: deque[tuple[int, int, Any]] = deque()
        self._innovations: deque[tuple[int, Any]] = deque(maxlen=_PENDING_MESSAGES)

    def add_image(self, message: Any, now_ns: int) -> None:
        """Add a BeaconImage."""
        self._images.append((ns_from_stamp(message.header.stamp), now_ns, message))
        self._join(now_ns)

    def add_innovation(self, message: Any, now_ns: int) -> None:
        """Add the Innovation of the lights of an image."""
        self._innovations.append((ns_from_stamp(message.header.stamp), message))
        self._join(now_ns)

    def _join(self, now_ns: int) -> None:
        by_stamp = dict(self._innovations)
        while self._images:
            utc_ns, came_ns, image = self._images[0]
            innovation = by_stamp.get(utc_ns)
            later = any(verdict_ns > utc_ns for verdict_ns in by_stamp)
            if innovation is None and not later and now_ns - came_ns < _INNOVATION_TIMEOUT_NS:
                return
            self._images.popleft()
            residuals = _residuals_by_object(innovation) if innovation is not None else {}
            for light in image.beacons:
                name = str(light.beacon_id)
                known = residuals.get(name, {})
                point = BeaconPoint(
                    utc_ns,
                    float(light.x),
                    float(light.z),
                    known.get("x", math.nan),
                    known.get("z", math.nan),
                    bool(known) and innovation is not None and bool(innovation.accepted),
                )
                append(self._history.beacons, name, point)


def _residuals_by_object(innovation: Any) -> Mapping[str, dict[str, float]]:
    """Return star or light → axis → residual, rad; the last word of a component's name is its axis."""
    found: dict[str, dict[str, float]] = {}
    for name, residual in zip(innovation.components, innovation.residual, strict=False):
        part, _, axis = str(name).rpartition(" ")
        found.setdefault(part, {})[axis] = float(residual)
    return found


def _star_residuals(names: list[str], residuals: Mapping[str, dict[str, float]], axis: str) -> FloatArray:
    """Return the residuals of stars along an axis, rad: NaN for a star without residual, empty if all are without."""
    if not any(name in residuals for name in names):
        return _NO_VALUES
    return np.array([residuals.get(name, {}).get(axis, math.nan) for name in names])

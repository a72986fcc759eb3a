"""Plausibility checks of all input streams, in the order of their stamps, by comparison with other sources.

The checks of one stream alone are in :mod:`ship_estimation.plausibility`.
"""

from typing import Protocol

from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.plausibility.stuck_check import MotionReference, StuckCheck, StuckValue, largest_sigma
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_stars.attitude_samples import AttitudeMeasurement


class CheckedMeasurement(Measurement, Protocol):
    """A measurement with a value that must not stay constant."""

    @property
    def stuck_value(self) -> StuckValue:
        """Value that varies while the ship rotates; see :data:`StuckValue`."""
        ...


class PlausibilityChecks:
    """Plausibility checks of inputs by comparison with other sources.

    Args:
        config: parameters of the INS.

    Attributes:
        ins: check of the INS samples.
        motion_references: by source, the last attitude that passed the check or was accepted; used to check other
            sources.
    """

    def __init__(self, config: CheckedInsConfig) -> None:
        self.ins = InsCheck(config)
        self.motion_references: dict[str, MotionReference] = {}
        self._stuck: dict[str, StuckCheck] = {}
        self._latest_ns: dict[str, int] = {}

    def check(self, measurement: CheckedMeasurement, track: AttitudeTrack) -> Rejection | None:
        """Return the rejection of a measurement that is constant while other sources rotate; None for any other.

        An :class:`AttitudeMeasurement` that passes becomes a motion reference. A measurement is checked only if it is
        newer than the last measurement of the same source that passed.

        Args:
            measurement: measurement of any kind.
            track: INS samples used so far.
        """
        source, time_ns = measurement.source, measurement.time_ns
        if time_ns <= self._latest_ns.get(source, time_ns - 1):
            return None
        value, sigma_rad, description = measurement.stuck_value
        # Exposures without stars may repeat, also on a moving ship.
        if len(value) > 0:
            references = {name: reference for name, reference in self.motion_references.items() if name != source}
            ins, by_rates = track.last_before(time_ns), self.ins.by_rates
            if ins is not None:
                references["ins"] = MotionReference(ins.time_ns, ins.rotation_nd, self.ins.noise_rad)
            if by_rates is not None and by_rates.time_ns <= time_ns:
                references["rate"] = by_rates
            if source not in self._stuck:
                self._stuck[source] = StuckCheck()
            if self._stuck[source].observe(time_ns, value, sigma_rad, references):
                return Rejection(Reason.STUCK, f"{description} while other sources rotate")
            if isinstance(measurement, AttitudeMeasurement):
                self.motion_references[source] = MotionReference(time_ns, value, sigma_rad)
        self._latest_ns[source] = time_ns
        return None

    def add_motion_reference(self, attitude: AttitudeMeasurement) -> None:
        """Add an accepted attitude as motion reference for the other checks."""
        sigma_rad = largest_sigma(attitude.noise_v)
        self.motion_references[attitude.source] = MotionReference(attitude.time_ns, attitude.rotation_nv, sigma_rad)

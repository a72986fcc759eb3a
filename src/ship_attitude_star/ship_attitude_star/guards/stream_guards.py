"""The guards that watch the streams of all inputs of one run, in the order of their stamps."""

import math

from ship_attitude_star.measurements.baseline import BaselineMeasurement
from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.stars.exposure import StarExposure
from ship_estimation.ins import GuardedInsConfig
from ship_estimation.ins_guard import InsGuard
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.value_guards import StuckGuard
from ship_estimation.witnesses import Witness
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.rotations import FloatArray


class StreamGuards:
    """Refuses inputs that are well formed but cannot be true, each source judged by what the others say.

    Args:
        config: the INS.

    Attributes:
        ins: the guard of the INS's samples.
        witnesses: by source, its last attitude that was used: how the ship moves, for the guards of the others.
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self.ins = InsGuard(config)
        self.witnesses: dict[str, Witness] = {}
        self._stuck: dict[str, StuckGuard] = {}
        self._latest_ns: dict[str, int] = {}

    def check(self, measurement: Measurement, track: AttitudeTrack) -> Refusal | None:
        """The refusal of a measurement that stands still while other sources move; None where nothing is wrong with it.

        A measurement that comes after a later one of its source is not watched: guards follow a stream in its order.

        Args:
            measurement: of any kind.
            track: the INS's samples used so far.
        """
        source, time_ns = measurement.source, measurement.time_ns
        if time_ns <= self._latest_ns.get(source, time_ns - 1):
            return None
        watched = _watched(measurement)
        if watched is None:
            return None
        value, sigma_rad, stands_still = watched
        # An exposure that shows no star may be followed by another one, also on a moving ship.
        if len(value) > 0:
            witnesses = {name: witness for name, witness in self.witnesses.items() if name != source}
            ins, by_rates = track.last_before(time_ns), self.ins.by_rates
            if ins is not None:
                witnesses["ins"] = Witness(ins.time_ns, ins.rotation_nd, self.ins.noise_rad)
            if by_rates is not None and by_rates.time_ns <= time_ns:
                witnesses["rate"] = by_rates
            if source not in self._stuck:
                self._stuck[source] = StuckGuard()
            if self._stuck[source].observe(time_ns, value, sigma_rad, witnesses):
                return Refusal(Reason.STUCK, f"{stands_still} while other sources move")
            if isinstance(measurement, AttitudeMeasurement):
                self.witnesses[source] = Witness(time_ns, value, sigma_rad)
        self._latest_ns[source] = time_ns
        return None

    def used(self, attitude: AttitudeMeasurement) -> None:
        """Take an attitude that was not refused: from now on it tells the other guards how the ship moves."""
        sigma_rad = _sigma_rad(attitude.noise_v)
        self.witnesses[attitude.source] = Witness(attitude.time_ns, attitude.rotation_nv, sigma_rad)


def _watched(measurement: Measurement) -> tuple[FloatArray, float, str] | None:
    """What must not stand still on a moving ship, the noise of its worst part in rad, and what is said where it does.

    None where a measurement is of a kind that may stand still.
    """
    if isinstance(measurement, StarExposure):
        sigma_rad = float(measurement.sigma.max(initial=0.0))
        return measurement.directions_s, sigma_rad, "stars stand still on the detector"
    if isinstance(measurement, InertialAttitude):
        # Against the stars even a ship at rest turns.
        return measurement.rotation_cs, _sigma_rad(measurement.noise_s), "attitude against the stars stands still"
    if isinstance(measurement, BaselineMeasurement):
        sigma_rad = _sigma_rad(measurement.noise_n) / measurement.length_m
        return measurement.direction_n, sigma_rad, "baseline stands still"
    if isinstance(measurement, AttitudeMeasurement):
        return measurement.rotation_nv, _sigma_rad(measurement.noise_v), "attitude stands still"
    return None


def _sigma_rad(covariance: FloatArray) -> float:
    """Standard deviation about the worst axis."""
    return math.sqrt(max(covariance.diagonal().tolist()))

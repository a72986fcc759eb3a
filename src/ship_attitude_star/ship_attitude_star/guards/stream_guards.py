"""The guards that watch the streams of all inputs of one run, in the order of their stamps."""

import numpy as np

from ship_attitude_star.measurements.inertial_attitude import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_estimation.ins_config import GuardedInsConfig
from ship_estimation.ins_guard import InsGuard, JudgedIns
from ship_estimation.outcome import Measurement
from ship_estimation.rate_guard import Rates
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.rotations import ARCSEC, FloatArray


class StreamGuards:
    """Refuses inputs that are well formed but cannot be true, each source judged by what the others say.

    Args:
        config: the INS.
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self._ins = InsGuard(config.white_sigma_arcsec * ARCSEC, config.jump_samples)
        self._stuck: dict[str, StuckGuard] = {}
        self._witnesses: dict[str, Witness] = {}
        self._latest_ns: dict[str, int] = {}

    def reconfigure(self, config: GuardedInsConfig) -> None:
        """Go on with another noise."""
        self._ins.reconfigure(config.white_sigma_arcsec * ARCSEC, config.jump_samples)

    @property
    def rates(self) -> Rates:
        """What the INS's rates are worth."""
        return self._ins.rates

    def check_ins(self, sample: AttitudeSample, track: AttitudeTrack) -> JudgedIns:
        """Judge an INS sample; the guards watch the stream in order, what comes late is judged by its neighbour.

        Args:
            sample: the sample.
            track: those taken so far.
        """
        if self._ins.watched(sample.time_ns):
            return self._ins.check_late(sample, track.last_before(sample.time_ns - 1))
        return self._ins.check(sample, self._witnesses)

    def check(self, measurement: Measurement, ins: AttitudeSample | None) -> Refusal | None:
        """The refusal of a measurement that cannot be true; one that is not refused witnesses from now on.

        A measurement that comes after a later one of its source is not watched: guards follow a stream in its order.

        Args:
            measurement: of any kind.
            ins: the last sample of the INS before it.
        """
        if measurement.time_ns <= self._latest_ns.get(measurement.source, measurement.time_ns - 1):
            return None
        if isinstance(measurement, StarExposure):
            refusal = self.check_exposure(measurement, ins)
        elif isinstance(measurement, InertialAttitude):
            refusal = self.check_inertial(measurement, ins)
        else:
            assert isinstance(measurement, AttitudeMeasurement)
            refusal = self.check_measurement(measurement, ins)
        if refusal is None:
            self._latest_ns[measurement.source] = measurement.time_ns
            if isinstance(measurement, AttitudeMeasurement):
                self.used(measurement)
        return refusal

    def check_measurement(
        self, measurement: AttitudeMeasurement, ins: AttitudeSample | None
    ) -> Refusal | None:
        """The refusal of a device's measurement later than all before of it; None where nothing is wrong with it."""
        sigma_rad = _worst_sigma_rad(measurement)
        if self._stands_still(measurement, measurement.rotation_nv, sigma_rad, ins):
            return Refusal(Reason.STUCK, "attitude stands still while other sources move")
        return None

    def check_exposure(self, exposure: StarExposure, ins: AttitudeSample | None) -> Refusal | None:
        """The same of an exposure. No star in it, again and again, is no sign of anything."""
        if len(exposure) == 0:
            return None
        sigma_rad = float(np.max(exposure.sigma))
        if self._stands_still(exposure, exposure.directions_s, sigma_rad, ins):
            return Refusal(Reason.STUCK, "stars stand still on the detector while other sources move")
        return None

    def check_inertial(self, inertial: InertialAttitude, ins: AttitudeSample | None) -> Refusal | None:
        """The same of an attitude against the ICRS, which even a ship at rest does not keep."""
        sigma_rad = float(np.sqrt(np.max(np.diagonal(inertial.noise_s))))
        if self._stands_still(inertial, inertial.rotation_cs, sigma_rad, ins):
            return Refusal(Reason.STUCK, "attitude against the stars stands still while other sources move")
        return None

    def _stands_still(
        self, measurement: Measurement, value: FloatArray, sigma_rad: float, ins: AttitudeSample | None
    ) -> bool:
        source = measurement.source
        guard = self._stuck.setdefault(source, StuckGuard(sigma_rad))
        guard.sigma_rad = sigma_rad
        witnesses = {name: witness for name, witness in self._witnesses.items() if name != source}
        if ins is not None:
            witnesses["ins"] = Witness(ins.time_ns, ins.rotation_nd, self._ins.sigma_rad)
        by_rates = self._ins.witness()
        if by_rates is not None and by_rates.time_ns <= measurement.time_ns:
            witnesses["rate"] = by_rates
        return guard.observe(measurement.time_ns, value, witnesses)

    def used(self, measurement: AttitudeMeasurement) -> None:
        """A measurement was not refused: from now on it tells how the ship moves."""
        self._witnesses[measurement.source] = Witness(
            measurement.time_ns, measurement.rotation_nv, _worst_sigma_rad(measurement)
        )


def _worst_sigma_rad(measurement: AttitudeMeasurement) -> float:
    return float(np.sqrt(np.max(np.diagonal(measurement.noise_v))))

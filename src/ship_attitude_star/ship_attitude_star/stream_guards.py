"""The guards that watch the streams of all inputs of one run, in the order of their stamps."""

import numpy as np

from ship_attitude_star.inertial_attitude import InertialAttitude
from ship_attitude_star.rate_guard import RateIntegrator, RateUnitsGuard
from ship_attitude_star.samples import AttitudeMeasurement
from ship_attitude_star.star_exposure import StarExposure
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC, FloatArray


class StreamGuards:
    """Refuses inputs that are well formed but cannot be true, each source judged by what the others say.

    Args:
        ins_sigma_rad: noise of an INS attitude; an arcsecond where it is less.
    """

    def __init__(self, ins_sigma_rad: float) -> None:
        self._ins_sigma_rad = max(ins_sigma_rad, ARCSEC)
        self._rates = RateIntegrator()
        self._units = RateUnitsGuard()
        self._stuck = {"ins": StuckGuard(self._ins_sigma_rad)}
        self._witnesses: dict[str, Witness] = {}

    @property
    def rates_wrong(self) -> bool:
        """True while the INS's rates and attitudes contradict one another by a wrong unit."""
        return self._units.wrong

    def check_ins(self, sample: AttitudeSample) -> Refusal | None:
        """The refusal of an INS sample later than all before; None where nothing is wrong with it."""
        witnesses = dict(self._witnesses)
        if sample.rate_d is not None:
            if not self._rates.advance(sample.time_ns, sample.rate_d):
                self._units.restart(sample.time_ns, sample.rotation_nd, self._rates.rotation)
            witnesses["rate"] = Witness(self._rates.rotation, sigma_rad=0.0)
            if self._units.observe(sample.time_ns, sample.rotation_nd, self._rates.rotation):
                text = (
                    f"angular velocity turns {self._units.slope:.3g} times as fast as the orientation: "
                    "degrees for radians? ins/imu must be in rad/s"
                )
                return Refusal(Reason.UNITS, text)
        if self._stuck["ins"].observe(sample.rotation_nd, witnesses):
            return Refusal(Reason.STUCK, "orientation stands still while other sources move")
        return None

    def check_measurement(
        self, measurement: AttitudeMeasurement, newest_ins: AttitudeSample | None
    ) -> Refusal | None:
        """The refusal of a device's measurement later than all before of it; None where nothing is wrong with it."""
        sigma_rad = _worst_sigma_rad(measurement)
        if self._stands_still(measurement.source, measurement.rotation_nv, sigma_rad, newest_ins):
            return Refusal(Reason.STUCK, "attitude stands still while other sources move")
        return None

    def check_exposure(self, exposure: StarExposure, newest_ins: AttitudeSample | None) -> Refusal | None:
        """The same of an exposure. No star in it, again and again, is no sign of anything."""
        if len(exposure) == 0:
            return None
        sigma_rad = float(np.max(exposure.sigma))
        if self._stands_still(exposure.source, exposure.directions_s, sigma_rad, newest_ins):
            return Refusal(Reason.STUCK, "stars stand still on the detector while other sources move")
        return None

    def check_inertial(self, inertial: InertialAttitude, newest_ins: AttitudeSample | None) -> Refusal | None:
        """The same of an attitude against the ICRS, which even a ship at rest does not keep."""
        sigma_rad = float(np.sqrt(np.max(np.diagonal(inertial.noise_s))))
        if self._stands_still(inertial.source, inertial.rotation_cs, sigma_rad, newest_ins):
            return Refusal(Reason.STUCK, "attitude against the stars stands still while other sources move")
        return None

    def _stands_still(
        self, source: str, value: FloatArray, sigma_rad: float, newest_ins: AttitudeSample | None
    ) -> bool:
        if source not in self._stuck:
            self._stuck[source] = StuckGuard(sigma_rad)
        witnesses = {name: witness for name, witness in self._witnesses.items() if name != source}
        if newest_ins is not None:
            witnesses["ins"] = Witness(newest_ins.rotation_nd, self._ins_sigma_rad)
        return self._stuck[source].observe(value, witnesses)

    def used(self, measurement: AttitudeMeasurement) -> None:
        """A measurement was not refused: from now on it tells how the ship moves."""
        self._witnesses[measurement.source] = Witness(measurement.rotation_nv, _worst_sigma_rad(measurement))


def _worst_sigma_rad(measurement: AttitudeMeasurement) -> float:
    return float(np.sqrt(np.max(np.diagonal(measurement.noise_v))))

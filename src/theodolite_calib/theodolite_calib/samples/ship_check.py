"""Check of the ship's attitude.

Attitudes and the rates in the same messages are checked against each other, both with the INS alone and with
``ship/attitude``. With the INS alone the rates have no other use, because the pointing uses only the attitudes.
"""

import math

from ship_estimation.fault_detection.unconfirmed_step import UnconfirmedStep
from ship_estimation.parameters.ins import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.rejection_rules import resolve_same_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.samples import ShipSample

_STATED_STEP_SIGMAS = 5.0
"""Possible step of a source's attitude, in multiples of the square root of the change of its stated variance."""


class ShipCheck:
    """Check of the ship's attitudes of one run, in the order of their stamps.

    An attitude with a stated covariance may step as far as the change of this covariance allows. For example, a
    correction of the fused attitude by stars reduces the covariance.

    Args:
        config: parameters of the node.
        shift_ns: offset of the time of validity from the stamps, ns.
    """

    def __init__(self, config: OpticalAxisConfig, shift_ns: int) -> None:
        self._source = "the INS" if config.ship.source == "ins/imu" else "the ship's attitude"
        check_config = _check_config(config)
        self._ins_check, self._shift_ns = InsCheck(check_config), shift_ns
        # Accepted samples with their rates, for the check of samples that come out of order.
        self._accepted = AttitudeTrack(round(check_config.max_gap_s * SECOND_NS))
        self._stated_covariance_n: FloatArray | None = None
        self._unconfirmed: UnconfirmedStep | None = None

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply a changed noise."""
        self._ins_check.reconfigure(_check_config(config))

    def check(self, sample: ShipSample, oldest_ns: int) -> CheckedInsSample:
        """Check a sample; later samples will not be older than ``oldest_ns``."""
        self._accepted.drop_before(oldest_ns)
        reported_step_rad = _stated_step_rad(sample.correlated_covariance_n, self._stated_covariance_n)
        result = self._ins_check.check(sample, self._accepted, {}, reported_step_rad)
        if result.rates_wrong_after_ns is not None:
            self._accepted.drop_rates(result.rates_wrong_after_ns)
        if result.jumps:
            since_ns = result.jumps[-1].time_ns + self._shift_ns
            self._unconfirmed = UnconfirmedStep(since_ns, f"{self._source} has jumped", "lights")
        if result.rejection is None:
            if self._accepted.newest is None or sample.time_ns > self._accepted.newest.time_ns:
                self._stated_covariance_n = sample.correlated_covariance_n
            known = self._accepted.get(sample.time_ns)
            if known is None or resolve_same_stamp(known, result.sample)[0]:
                self._accepted.insert(result.sample)
        return result

    def confirm(self, time_ns: int) -> None:
        """Record that beacons were consistent with the attitude at a time."""
        if self._unconfirmed is not None:
            self._unconfirmed = self._unconfirmed.with_confirmation(time_ns)

    def unconfirmed_reason(self, time_ns: int) -> str:
        """Return the reason why the attitude at a time is unconfirmed; empty if it is confirmed."""
        step = self._unconfirmed
        return step.text if step is not None and time_ns > step.since_ns else ""


def _stated_step_rad(covariance_n: FloatArray | None, before_n: FloatArray | None) -> float:
    """Return the possible step of a source's attitude at a change of the stated covariance, rad."""
    if covariance_n is None or before_n is None:
        return 0.0
    return _STATED_STEP_SIGMAS * math.sqrt(abs(float((covariance_n - before_n).trace())))


def _check_config(config: OpticalAxisConfig) -> CheckedInsConfig:
    """Return the configuration of the check, for the INS or for the fused attitude."""
    if config.ship.source == "ins/imu":
        return config.ins
    return CheckedInsConfig(white_sigma_arcsec=config.ship.white_sigma_arcsec, max_gap_s=config.ship.max_gap_s)

"""What is looked at when an input arrives, before it is compared with anything: its age, and whether it can be true."""

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.measurements.inertial_attitude import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement, Measurement
from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.ins_guard import JudgedIns
from ship_estimation.rate_guard import Rates
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack

_SECOND_NS = 1_000_000_000


class Arrivals:
    """The inputs of one run as they come.

    Args:
        config: the node's parameters.

    Attributes:
        newest_ns: latest stamp of all data.
        latest_ns: by source, the latest stamp of its measurements.
    """

    def __init__(self, config: ShipAttitudeConfig) -> None:
        self._lag_s = config.lag_s
        self._lag_ns = round(config.lag_s * _SECOND_NS)
        self._guards = StreamGuards(config.ins)
        self.newest_ns = 0
        self.latest_ns: dict[str, int] = {}

    @property
    def oldest_ns(self) -> int:
        """What is older than this comes too late."""
        return self.newest_ns - self._lag_ns

    @property
    def window_ns(self) -> tuple[int, int]:
        """The oldest and the newest stamp that can still be applied, ns."""
        return self.oldest_ns, self.newest_ns

    @property
    def rates(self) -> Rates:
        """What the INS's rates are worth."""
        return self._guards.rates

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """Go on with other noise."""
        self._guards.reconfigure(config.ins)

    def judge_ins(self, sample: AttitudeSample, track: AttitudeTrack) -> JudgedIns:
        """What is to be done with an INS sample; ``track`` holds those used before."""
        if sample.time_ns < self.oldest_ns:
            return JudgedIns(sample, self._late(sample.time_ns))
        return self._guards.check_ins(sample, track)

    def measurement_refusal(self, measurement: Measurement, track: AttitudeTrack) -> Refusal | None:
        """Why a measurement is not used; ``track`` holds the INS's samples."""
        if measurement.time_ns < self.oldest_ns:
            return self._late(measurement.time_ns)
        if not self._is_latest(measurement):
            return None
        ins = track.last_before(measurement.time_ns)
        if isinstance(measurement, StarExposure):
            return self._guards.check_exposure(measurement, ins)
        if isinstance(measurement, InertialAttitude):
            return self._guards.check_inertial(measurement, ins)
        assert isinstance(measurement, AttitudeMeasurement)
        return self._guards.check_measurement(measurement, ins)

    def used(self, measurement: Measurement) -> None:
        """A measurement was not refused."""
        if not self._is_latest(measurement):
            return
        self.latest_ns[measurement.source] = measurement.time_ns
        if isinstance(measurement, AttitudeMeasurement):
            self._guards.used(measurement)

    def _is_latest(self, measurement: Measurement) -> bool:
        return measurement.time_ns > self.latest_ns.get(measurement.source, measurement.time_ns - 1)

    def _late(self, time_ns: int) -> Refusal:
        late_s = (self.newest_ns - time_ns) / _SECOND_NS
        return Refusal(Reason.LATE, f"{late_s:.3f} s behind the newest data: more than lag_s = {self._lag_s:g}")

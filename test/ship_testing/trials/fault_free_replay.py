"""Replay of a voyage without faults, as reference for the same voyage with faults, and cases of undetectable faults.

The undetectable cases are those of ``docs/explanation/integrity.md``. Their limits are documented there, with
measurements on both sides of each limit.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import ENCODER_TOPIC, IMAGE_TOPIC
from ship_testing.trials.voyage_outputs import VoyageOutputs

MEASUREMENTS = 3
"""Number of measurements within which a large step is detected, if these measurements take longer than a second."""

_DETECTABLE_SHIFT_ARCSEC = 13.0
"""Minimum mounting shift of the telescope that the next lights detect, arcsec: three times the scatter of one light."""

_DETECTABLE_SLIP_SIGMAS = 13.0
"""Minimum encoder slip, in sigmas of a reading, that is detected from the readings themselves
(:mod:`theodolite_calib.samples.encoder_check`)."""

_INS_DRIFT_ARCSEC_PER_MIN, _STAR_DRIFT_ARCSEC_PER_MIN, _AZIMUTH_DRIFT_ARCSEC_PER_MIN = 60.0, 4.0, 100.0
"""Drift rates of INS, star sensor and encoder azimuth, arcsec/min; a slower drift is detected before the error of an
output exceeds five sigmas."""

_SMALL_STEP_SIGMAS = 11.0
"""INS step, in sigmas of a sample, below which several samples may be needed for detection
(:mod:`ship_estimation.plausibility.ins_step_detector`)."""

_MIN_SENSORS_TO_ISOLATE = 3
"""Minimum number of star sensors to isolate a faulty sensor or a faulty INS."""

_STARS, _INS = "star/", "ins/imu"


@dataclass
class FaultFreeReplay:
    """Replay of one voyage without faults, and properties of its bag needed for the evaluation.

    Attributes:
        outputs: outputs of the nodes.
        arrivals_ns: input topic → arrival times of its messages, in order.
        beacon_times_ns: arrival times of the images with a light, in order.
        encoder_sigma_arcsec: noise of a reading of the theodolite's encoders; NaN without ``optical_axis``.
        ins_sigma_arcsec: noise of a sample of the INS; NaN without ``ship_attitude``.
        start_ns: beginning of the bag.
        end_ns: end of the bag.
    """

    outputs: VoyageOutputs
    arrivals_ns: dict[str, np.ndarray]
    beacon_times_ns: np.ndarray
    encoder_sigma_arcsec: float
    ins_sigma_arcsec: float
    start_ns: int
    end_ns: int

    @property
    def length_s(self) -> float:
        """Length of the bag, s."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    def alert_limit_s(self, fault: Fault) -> float:
        """Return the maximum time to detection of a large step: a second or three measurements, whichever is longer."""
        return max(1.0, MEASUREMENTS * self._period_s(fault.topic))

    def undetectable_case(self, fault: Fault, first_ns: int) -> str:
        """Return the undetectable case that a fault belongs to; empty if the fault is detectable.

        Args:
            fault: fault that affects at least one message.
            first_ns: original arrival time of the first affected message.
        """
        return next((row for row, holds in _UNDETECTABLE.items() if holds(self, fault, first_ns)), "")

    def _is_slip_without_lights(self, fault: Fault, first_ns: int) -> bool:
        """True for an encoder slip too small to be detected from the readings, while no light is in view."""
        if fault.kind != "slip":
            return False
        size_arcsec = max(abs(fault.azimuth_arcsec), abs(fault.elevation_arcsec))
        end_ns = first_ns + round(self.alert_limit_s(fault) * NS_PER_S)
        in_view = (self.beacon_times_ns >= first_ns) & (self.beacon_times_ns < end_ns)
        return not in_view.any() and size_arcsec < _DETECTABLE_SLIP_SIGMAS * self.encoder_sigma_arcsec

    def _is_encoder_drift(self, fault: Fault, first_ns: int) -> bool:
        """True for a fast encoder drift in azimuth.

        The filter ascribes the drift to lights and axis errors until the subfilters separate.
        """
        is_drift = fault.kind == "drift" and fault.topic == ENCODER_TOPIC
        return is_drift and abs(fault.azimuth_arcsec_per_min) > _AZIMUTH_DRIFT_ARCSEC_PER_MIN

    def _is_ins_drift(self, fault: Fault, first_ns: int) -> bool:
        """True for a fast INS drift with fewer than three star sensors.

        The drift is ascribed to the correlated error of the INS until the INS rates or the subfilters contradict this
        attribution.
        """
        return fault.topic == _INS and self._is_drift_with_two_sensors(fault, _INS_DRIFT_ARCSEC_PER_MIN)

    def _is_star_drift(self, fault: Fault, first_ns: int) -> bool:
        """True for a fast drift of a star sensor if there are fewer than three star sensors.

        The drift is nearly consistent with the INS, and about one axis the sensor is the most accurate source.
        """
        return fault.topic.startswith(_STARS) and self._is_drift_with_two_sensors(fault, _STAR_DRIFT_ARCSEC_PER_MIN)

    def _is_drift_with_two_sensors(self, fault: Fault, arcsec_per_min: float) -> bool:
        """True if a fault is a drift about an axis faster than a limit, and there are fewer than three star sensors."""
        if fault.kind != "drift":
            return False
        rates = fault.forward_arcsec_per_min, fault.up_arcsec_per_min, fault.right_arcsec_per_min
        sensors = {topic.split("/")[1] for topic in self.arrivals_ns if topic.startswith(_STARS)}
        return max(map(abs, rates)) > arcsec_per_min and len(sensors) < _MIN_SENSORS_TO_ISOLATE

    def _is_small_ins_step(self, fault: Fault, first_ns: int) -> bool:
        """True for an INS step too small to be detected in a single sample."""
        size_arcsec = max(abs(fault.north_arcsec), abs(fault.up_arcsec), abs(fault.east_arcsec))
        return fault.kind == "bias" and fault.topic == _INS and size_arcsec < _SMALL_STEP_SIGMAS * self.ins_sigma_arcsec

    def _is_small_telescope_shift(self, fault: Fault, first_ns: int) -> bool:
        """True for a telescope shift within the scatter of its lights."""
        size_arcsec = max(abs(fault.forward_arcsec), abs(fault.up_arcsec), abs(fault.right_arcsec))
        return fault.kind == "knock" and fault.topic == IMAGE_TOPIC and size_arcsec < _DETECTABLE_SHIFT_ARCSEC

    def _is_star_shift_without_stars(self, fault: Fault, first_ns: int) -> bool:
        """True for a shift of a star sensor after a time without stars, in which the INS may have drifted as much."""
        if fault.kind != "knock" or not fault.topic.startswith(_STARS):
            return False
        by_stars = [arrivals_ns for topic, arrivals_ns in self.arrivals_ns.items() if topic.startswith(_STARS)]
        stars_ns = np.concatenate(by_stars)
        return not ((stars_ns >= first_ns - MAX_MEASUREMENT_AGE_NS) & (stars_ns < first_ns)).any()

    def _period_s(self, topic: str) -> float:
        """Return the median period of a topic, s."""
        periods_ns = np.diff(self.arrivals_ns.get(topic, np.zeros(0)))
        return float(np.median(periods_ns)) / NS_PER_S if periods_ns.size else 0.0


_UNDETECTABLE: dict[str, Callable[[FaultFreeReplay, Fault, int], bool]] = {
    "encoder slip, no lights": FaultFreeReplay._is_slip_without_lights,
    "encoder drift, detected late": FaultFreeReplay._is_encoder_drift,
    "ins drift, detected late": FaultFreeReplay._is_ins_drift,
    "ins step, small": FaultFreeReplay._is_small_ins_step,
    "star drift, detected late": FaultFreeReplay._is_star_drift,
    "telescope knock, small": FaultFreeReplay._is_small_telescope_shift,
    "star knock, no stars": FaultFreeReplay._is_star_shift_without_stars,
}

UNDETECTABLE_CASES = tuple(_UNDETECTABLE)
"""Undetectable cases, as listed in ``docs/explanation/integrity.md``; each has its own row in the table of threats."""

UNREPORTED_CASES = ("encoder slip, no lights", "telescope knock, small", "star knock, no stars")
"""Undetectable cases that need not be reported. In the other cases an output may be VALID and wrong until detection."""

"""A voyage without faults: what a fault on it is compared with, and which faults on it no data can tell.

The rows of what no data can tell are those of ``docs/explanation/integrity.md``. Where one has a limit, the page says
it in the same words, and what was measured on both sides of it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_estimation.exclusion import HEARD_NS
from ship_replay.trials.voyage_told import Told
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import ENCODER_TOPIC, IMAGE_TOPIC

MEASUREMENTS = 3
"""A step is told within so many measurements of its source, or within a second."""

_KNOCK_SEEN_ARCSEC = 13.0
"""A knock on the telescope by more is told by the next lights: three times what one sighting of them scatters."""

_SLIP_SEEN_SIGMAS = 13.0
"""A slip of more sigmas of a reading shows in the readings themselves
(:mod:`theodolite_calib.measured.encoder_steps`)."""

_INS_CREEPS_ARCSEC_PER_MIN, _STARS_CREEP_ARCSEC_PER_MIN, _AZIMUTH_CREEPS_ARCSEC_PER_MIN = 60.0, 4.0, 100.0
"""What creeps by less is found before an output is beyond five sigmas."""

_SMALL_STEP_SIGMAS = 11.0
"""A step of the INS by fewer sigmas of a sample may need some samples until it is seen
(:mod:`ship_estimation.integrated_rates`)."""

_CHECK_EACH_OTHER = 3
"""So many star sensors tell which of them, or the INS, is wrong."""

_STARS, _INS = "star/", "ins/imu"


@dataclass
class Passage:
    """One voyage through the nodes without faults, and what of its bag the judge has to know.

    Attributes:
        told: what it put out.
        arrivals_ns: input topic → when its messages arrived, in order.
        lights_ns: when the images arrived that show a light, in order.
        encoder_sigma_arcsec: noise of a reading of the theodolite's encoders; NaN without one.
        ins_sigma_arcsec: noise of a sample of the INS; NaN without ``ship_attitude``.
        start_ns: beginning of the bag.
        end_ns: its end.
    """

    told: Told
    arrivals_ns: dict[str, np.ndarray]
    lights_ns: np.ndarray
    encoder_sigma_arcsec: float
    ins_sigma_arcsec: float
    start_ns: int
    end_ns: int

    @property
    def length_s(self) -> float:
        """How long the bag is."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    def alert_limit_s(self, fault: Fault) -> float:
        """Within this a large step must be told: a second, or three measurements of the source."""
        return max(1.0, MEASUREMENTS * self._period_s(fault.topic))

    def unseen(self, fault: Fault, first_ns: int) -> str:
        """The row of what no data can tell that a fault belongs to; empty where the data can tell it.

        Args:
            fault: it changed a message.
            first_ns: when the first of these arrived.
        """
        return next((row for row, holds in _UNSEEN.items() if holds(self, fault, first_ns)), "")

    def _slips_without_lights(self, fault: Fault, first_ns: int) -> bool:
        """Encoders that slip by less than their own readings tell, while no light is in view."""
        if fault.kind != "slip":
            return False
        size_arcsec = max(abs(fault.azimuth_arcsec), abs(fault.elevation_arcsec))
        end_ns = first_ns + round(self.alert_limit_s(fault) * NS_PER_S)
        in_view = (self.lights_ns >= first_ns) & (self.lights_ns < end_ns)
        return not in_view.any() and size_arcsec < _SLIP_SEEN_SIGMAS * self.encoder_sigma_arcsec

    def _encoders_creep(self, fault: Fault, first_ns: int) -> bool:
        """Encoders that creep in azimuth: lights and axis errors take it up until the rows tell."""
        is_drift = fault.kind == "drift" and fault.topic == ENCODER_TOPIC
        return is_drift and abs(fault.azimuth_arcsec_per_min) > _AZIMUTH_CREEPS_ARCSEC_PER_MIN

    def _ins_creeps(self, fault: Fault, first_ns: int) -> bool:
        """An INS that creeps, with two star sensors: its slow error takes it up until its rates, or the rows, tell."""
        return fault.topic == _INS and self._creeps_beside_two(fault, _INS_CREEPS_ARCSEC_PER_MIN)

    def _stars_creep(self, fault: Fault, first_ns: int) -> bool:
        """One of two star sensors that creeps: the INS nearly explains it, and about one axis none knows better."""
        return fault.topic.startswith(_STARS) and self._creeps_beside_two(fault, _STARS_CREEP_ARCSEC_PER_MIN)

    def _creeps_beside_two(self, fault: Fault, arcsec_per_min: float) -> bool:
        """Whether a fault is a drift by more than that about an axis, beside two star sensors."""
        if fault.kind != "drift":
            return False
        rates = fault.forward_arcsec_per_min, fault.up_arcsec_per_min, fault.right_arcsec_per_min
        sensors = {topic.split("/")[1] for topic in self.arrivals_ns if topic.startswith(_STARS)}
        return max(map(abs, rates)) > arcsec_per_min and len(sensors) < _CHECK_EACH_OTHER

    def _ins_steps_a_little(self, fault: Fault, first_ns: int) -> bool:
        """An INS that steps by less than a sample of it tells."""
        size_arcsec = max(abs(fault.north_arcsec), abs(fault.up_arcsec), abs(fault.east_arcsec))
        return fault.kind == "bias" and fault.topic == _INS and size_arcsec < _SMALL_STEP_SIGMAS * self.ins_sigma_arcsec

    def _knocks_within_scatter(self, fault: Fault, first_ns: int) -> bool:
        """A telescope turned by no more than its lights scatter."""
        size_arcsec = max(abs(fault.forward_arcsec), abs(fault.up_arcsec), abs(fault.right_arcsec))
        return fault.kind == "knock" and fault.topic == IMAGE_TOPIC and size_arcsec < _KNOCK_SEEN_ARCSEC

    def _knocked_unseen(self, fault: Fault, first_ns: int) -> bool:
        """A star sensor knocked while no star was seen: what the INS has done meanwhile is as unknown."""
        if fault.kind != "knock" or not fault.topic.startswith(_STARS):
            return False
        by_stars = [arrivals_ns for topic, arrivals_ns in self.arrivals_ns.items() if topic.startswith(_STARS)]
        stars_ns = np.concatenate(by_stars)
        return not ((stars_ns >= first_ns - HEARD_NS) & (stars_ns < first_ns)).any()

    def _period_s(self, topic: str) -> float:
        """From one message of a topic to the next."""
        periods_ns = np.diff(self.arrivals_ns.get(topic, np.zeros(0)))
        return float(np.median(periods_ns)) / NS_PER_S if periods_ns.size else 0.0


_UNSEEN: dict[str, Callable[[Passage, Fault, int], bool]] = {
    "encoder slip, no lights": Passage._slips_without_lights,
    "encoder drift, told late": Passage._encoders_creep,
    "ins drift, told late": Passage._ins_creeps,
    "ins step, small": Passage._ins_steps_a_little,
    "star drift, told late": Passage._stars_creep,
    "telescope knock, small": Passage._knocks_within_scatter,
    "star knock, no stars": Passage._knocked_unseen,
}

UNSEEN_ROWS = tuple(_UNSEEN)
"""What no data can tell, as ``docs/explanation/integrity.md`` lists it; each has a row of its own in the table."""

UNTOLD_ROWS = ("encoder slip, no lights", "telescope knock, small", "star knock, no stars")
"""Those of them that nothing has to tell; the others are told, but an output may be VALID and wrong before."""

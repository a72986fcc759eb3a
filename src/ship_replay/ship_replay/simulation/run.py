"""One simulated voyage as arrays: what the devices say, when it arrives, and the truth. No ROS, no files."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_replay.simulation.attitude_device import DeviceSamples, DeviceTruth, simulate_reference, simulate_star_sensor
from ship_replay.simulation.carriers import carrier_of
from ship_replay.simulation.ins import InsSamples, InsTruth, simulate_ins
from ship_replay.simulation.noise import SECOND_NS
from ship_replay.simulation.scenario import Scenario
from ship_replay.simulation.start_time import start_of

TRUTH_RATE_HZ = 10.0


@dataclass(frozen=True)
class Truth:
    """What the devices should have said.

    Attributes:
        ins_index: the samples of the INS at whose stamps the true attitude is given: each first one of a tenth of
            a second, and the last, shape (m,).
        rotation_nd: true attitude at those stamps, shape (m, 3, 3).
        rate_d: true angular velocity there, rad/s, shape (m, 3).
        ins: errors of the INS.
        stars: mounting and timing of each star sensor.
        references: the same of each other attitude system.
    """

    ins_index: np.ndarray
    rotation_nd: FloatArray
    rate_d: FloatArray
    ins: InsTruth
    stars: dict[str, DeviceTruth]
    references: dict[str, DeviceTruth]


@dataclass(frozen=True)
class SimulatedRun:
    """A scenario with one draw of its random parts."""

    scenario: Scenario
    seed: int
    start_ns: int
    ins: InsSamples
    stars: dict[str, DeviceSamples]
    references: dict[str, DeviceSamples]
    truth: Truth

    def arrivals(self) -> list[tuple[int, str, int]]:
        """(log time, ``ins`` | ``star.<id>`` | ``reference.<name>``, index of the sample), in order of arrival.

        What arrives at the same nanosecond comes in the order INS, stars, references, then by stamp.
        """
        devices = {f"star.{key}": s for key, s in self.stars.items()}
        devices |= {f"reference.{key}": s for key, s in self.references.items()}
        sources = {"ins": self.ins, **devices}
        arrivals = [
            (int(log_time_ns), source, index)
            for source, samples in sources.items()
            for index, log_time_ns in enumerate(samples.log_time_ns)
        ]
        # A stable sort keeps the order of the sources and of the stamps.
        return sorted(arrivals, key=lambda arrival: arrival[0])


def simulate(scenario: Scenario, seed: int) -> SimulatedRun:
    """Draw a voyage. The same scenario and seed give the same numbers.

    Each random component has its own stream, named after it, so a further sensor changes nothing in the others.

    Raises:
        BadInput: the recorded motion cannot be used.
    """
    start_ns = start_of(scenario.start_utc)
    carrier = carrier_of(scenario.carrier, seed)
    ins, ins_truth = simulate_ins(scenario, carrier, start_ns, seed)
    stars = {key: simulate_star_sensor(key, scenario, carrier, start_ns, seed) for key in scenario.star_sensors}
    references = {
        key: simulate_reference(key, scenario, carrier, ins_truth.time_offset_s, start_ns, seed)
        for key in scenario.references
    }
    index = _truth_index(ins.time_ns, start_ns)
    since_start_s = (ins.time_ns[index] - start_ns) / SECOND_NS
    truth = Truth(
        ins_index=index,
        rotation_nd=carrier.attitude(since_start_s),
        rate_d=carrier.body_rate(since_start_s),
        ins=ins_truth,
        stars={key: device_truth for key, (_, device_truth) in stars.items()},
        references={key: device_truth for key, (_, device_truth) in references.items()},
    )
    return SimulatedRun(
        scenario=scenario,
        seed=seed,
        start_ns=start_ns,
        ins=ins,
        stars={key: samples for key, (samples, _) in stars.items()},
        references={key: samples for key, (samples, _) in references.items()},
        truth=truth,
    )


def _truth_index(ins_time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    """The first INS sample in each tenth of a second, and the last of all, shape (m,)."""
    tenth = (ins_time_ns - start_ns) // round(SECOND_NS / TRUTH_RATE_HZ)
    first = np.flatnonzero(np.diff(tenth, prepend=-1))
    return np.union1d(first, ins_time_ns.size - 1)

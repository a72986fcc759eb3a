"""Is the filter honest? Simulated runs through the core, and its error at the end of each against its covariance.

One sample a seed: errors within one run are correlated, those of different seeds are not.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.config import ShipAttitudeConfig
from ship_attitude_star.samples import AttitudeEstimate, AttitudeMeasurement
from ship_attitude_star.ship_core import ShipAttitudeCore
from ship_estimation.consistency import normalized_error_squared
from ship_estimation.parameters import build
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import FloatArray, log_rotation
from ship_replay.simulation.run import SimulatedRun, simulate
from ship_replay.simulation.scenario import Scenario
from ship_replay.simulation.suite import suite_configuration


@dataclass(frozen=True)
class FinalError:
    """Error of the fused attitude at the end of one run.

    Attributes:
        seed: of the run.
        angles: error of heading, pitch, roll (true minus estimate), rad, shape (3,).
        sigma: predicted standard deviations of the same, rad, shape (3,).
        nees: normalised error squared, three degrees of freedom.
        refused: measurements that were not used.
    """

    seed: int
    angles: FloatArray
    sigma: FloatArray
    nees: float
    refused: int


def final_error(scenario: Scenario, seed: int) -> FinalError:
    """Simulate, filter, compare at the last INS sample."""
    run = simulate(scenario, seed)
    core = ShipAttitudeCore(build(ShipAttitudeConfig, suite_configuration(scenario)))
    estimate, refused = feed(core, run)
    rotation_true = run.truth.rotation_nd[-1]
    error_n = log_rotation(rotation_true @ estimate.rotation_nd.T)
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    to_angles = angle_errors_from_rotation_vector(heading, pitch)
    covariance = estimate.covariance_n
    sigma = np.sqrt(np.diagonal(to_angles @ covariance @ to_angles.T))
    nees = float(normalized_error_squared(error_n, covariance))
    return FinalError(seed, to_angles @ error_n, sigma, nees, refused)


def feed(core: ShipAttitudeCore, run: SimulatedRun) -> tuple[AttitudeEstimate, int]:
    """A whole run into a core, in order of arrival; the last estimate and the number of measurements refused."""
    devices = {f"star.{id_}": star for id_, star in run.stars.items()}
    devices |= {f"reference.{name}": reference for name, reference in run.references.items()}
    last_ins = len(run.ins.time_ns) - 1
    estimate, refused = None, 0
    for _, source, index in run.arrivals():
        if source == "ins":
            sample = AttitudeSample(
                int(run.ins.time_ns[index]), run.ins.rotation_nd[index], run.ins.rate_d[index]
            )
            outcome = core.add_ins(sample, estimate=index == last_ins)
        else:
            device = devices[source]
            outcome = core.add_measurement(
                AttitudeMeasurement(
                    source,
                    int(device.time_ns[index]),
                    device.rotation_nv[index],
                    device.noise_v,
                    device.common_n,
                )
            )
        refused += (outcome.refusal is not None) + sum(not decision.accepted for decision in outcome.decisions)
        if outcome.estimates:
            estimate = outcome.estimates[-1]
    if estimate is None:
        raise ValueError("the run holds no INS sample that the core used")
    return estimate, refused

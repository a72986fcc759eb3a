"""Is the filter honest? Simulated runs through the core, and its error at the end of each against its covariance.

One sample a seed: errors within one run are correlated, those of different seeds are not.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.measurements.readings import AirReading, InertialAttitude, PositionFix, SkyInput
from ship_attitude_star.measurements.samples import AttitudeEstimate, AttitudeMeasurement
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.sky.sky_watch import installed_sky
from ship_attitude_star.stars.exposure import ExposureLength, StarExposure
from ship_estimation.consistency import normalized_error_squared
from ship_estimation.outcome import Measurement
from ship_estimation.parameters import build
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import FloatArray, log_rotation
from ship_simulation.run import SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings
from ship_simulation.suite.suite import suite_configuration


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
    estimate, refused = feed(core_for(scenario), run)
    rotation_true = run.truth.rotation_nd[-1]
    error_n = log_rotation(rotation_true @ estimate.rotation_nd.T)
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    to_angles = angle_errors_from_rotation_vector(heading, pitch)
    covariance = estimate.covariance_n
    sigma = np.sqrt(np.diagonal(to_angles @ covariance @ to_angles.T))
    nees = float(normalized_error_squared(error_n, covariance))
    return FinalError(seed, to_angles @ error_n, sigma, nees, refused)


def core_for(scenario: Scenario) -> ShipAttitudeCore:
    """A core with the configuration that fits a scenario, and with the sky where a sensor looks at it."""
    config = build(ShipAttitudeConfig, suite_configuration(scenario))
    return ShipAttitudeCore(config, installed_sky(config.sky) if scenario.needs_sky else None)


def feed(core: ShipAttitudeCore, run: SimulatedRun) -> tuple[AttitudeEstimate, int]:
    """A whole run into a core, in order of arrival; the last estimate and the number of measurements refused."""
    last_ins = len(run.ins.time_ns) - 1
    estimate, refused = None, 0
    for _, source, index in run.arrivals():
        if source == "ins":
            sample = AttitudeSample(
                int(run.ins.time_ns[index]), run.ins.rotation_nd[index], run.ins.rate_d[index]
            )
            outcome = core.add_ins(sample, estimate=index == last_ins)
        elif source in SKY_SOURCES:
            outcome = core.add_sky_input(sky_input(run, source, index))
        else:
            outcome = core.add_measurement(_measurement(run, source, index))
        refused += (outcome.refusal is not None) + sum(not decision.accepted for decision in outcome.decisions)
        if outcome.estimates:
            estimate = outcome.estimates[-1]
    if estimate is None:
        raise ValueError("the run holds no INS sample that the core used")
    return estimate, refused


def sky_input(run: SimulatedRun, source: str, index: int) -> SkyInput:
    """A fix, or a reading of the weather station."""
    if source == "fix":
        fixes = run.fixes
        return PositionFix(int(fixes.time_ns[index]), fixes.position(index), fixes.covariance_m2)
    told = run.scenario.weather
    values = {
        "pressure": told.pressure_hpa,
        "temperature": told.temperature_c,
        "humidity": 0.01 * told.humidity_percent,
    }
    return AirReading(source, int(run.weather_ns[index]), values[source], None)


def _measurement(run: SimulatedRun, source: str, index: int) -> Measurement:
    kind, _, name = source.partition(".")
    device = run.stars[name] if kind == "star" else run.references[name]
    if isinstance(device, StarSightings):
        return star_exposure(run, name, index)
    time_ns = int(device.time_ns[index])
    if isinstance(device, InertialSamples):
        return InertialAttitude(source, time_ns, device.rotation_cv[index], device.noise_v)
    return AttitudeMeasurement(source, time_ns, device.rotation_nv[index], device.noise_v, device.common_n)


def star_exposure(run: SimulatedRun, sensor_id: str, index: int) -> StarExposure:
    """One exposure of a sensor that gives single stars, as the estimator takes it."""
    sightings, config = run.stars[sensor_id], run.scenario.star_sensors[sensor_id]
    source, exposure_s = f"star.{sensor_id}", float(np.float32(config.exposure_s))
    length = None
    if exposure_s:
        length = ExposureLength(exposure_s, config.camera.camera(source), config.camera.psf_sigma_px)
    stars = sightings.stars[sightings.rows(index)]
    return StarExposure(source, int(sightings.time_ns[index]), **vars(stars), length=length)

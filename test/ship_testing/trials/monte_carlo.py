"""Monte Carlo consistency of the filters: their cores process simulated runs; errors are compared with covariances.

For ``ship_attitude`` the error at the end of each run counts, for ``optical_axis`` the errors of a whole session.
Errors within one run are correlated; errors of runs with different seeds are not.
"""

from collections.abc import Container, Iterator
from dataclasses import dataclass

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.ins_input import InsBatch
from ship_attitude_star.ship_attitude.measurements.devices import BaselineMeasurement
from ship_estimation.innovations.gates import normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, SampleBlock
from ship_simulation.run import BASELINE_SOURCE, DEFLECTION_SOURCE, SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario, StarImaging
from ship_simulation.ship.attitude_device import FusedSamples
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings
from ship_simulation.suite_file import optical_axis_configuration, suite_configuration
from ship_simulation.theodolite.run import TheodoliteRun
from ship_stars.attitude_from_stars.exposure import ExposureLength, StarExposure
from ship_stars.attitude_samples import (
    AirReading,
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeOutcome,
    CheckedMeasurement,
    DeflectionReading,
    InertialAttitude,
    PositionFix,
    SkyInput,
)
from ship_stars.sky.sky_model import load_sky_model
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.samples.samples import (
    BaselineSample,
    DetectedBeacon,
    EncoderSample,
    Exposure,
    Mode,
    PointingEstimate,
    PointingOutcome,
    ShipSample,
)

_MAX_BATCH = 256
"""Maximum number of INS samples per batch."""


@dataclass(frozen=True)
class FinalError:
    """Error of the fused attitude at the end of one run.

    Attributes:
        seed: seed of the run.
        angles: error of heading, pitch, roll (true minus estimate), rad, shape (3,).
        sigma: predicted standard deviations of these angles, rad, shape (3,).
        nees: normalised error squared, three degrees of freedom.
        rejected_count: number of inputs and measurements that were not used.
    """

    seed: int
    angles: FloatArray
    sigma: FloatArray
    nees: float
    rejected_count: int


def final_error(scenario: Scenario, seed: int) -> FinalError:
    """Simulate a run, filter it, and return the error at the last INS sample."""
    run = simulate(scenario, seed)
    estimate, rejected_count = feed_attitude(core_for(scenario), run)
    return error_at_end(run, seed, estimate.rotation_nd, estimate.covariance_n, rejected_count)


def error_at_end(
    run: SimulatedRun, seed: int, rotation_nd: FloatArray, covariance_n: FloatArray, rejected_count: int = 0
) -> FinalError:
    """Return the error of an attitude at the last INS sample of a run.

    Args:
        run: simulated run with its truth.
        seed: seed of the run.
        rotation_nd: estimated rotation horizon from deck, shape (3, 3).
        covariance_n: predicted covariance of the attitude error, rad², shape (3, 3).
        rejected_count: number of inputs and measurements that were not used.
    """
    error_n = log_rotation(run.truth.rotation_nd[-1] @ rotation_nd.T)
    heading, pitch, _ = angles_from_rotation(rotation_nd)
    to_angles = angle_errors_from_rotation_vector(heading, pitch)
    sigma = np.sqrt(np.diagonal(to_angles @ covariance_n @ to_angles.T))
    nees = float(normalized_error_squared(error_n, covariance_n))
    return FinalError(seed, to_angles @ error_n, sigma, nees, rejected_count)


def core_for(scenario: Scenario) -> ShipAttitudeCore:
    """Return a core with the configuration of a scenario, and with a sky model if a sensor needs it."""
    config = build(ShipAttitudeConfig, suite_configuration(scenario))
    return ShipAttitudeCore(config, load_sky_model(config.sky) if scenario.needs_sky else None)


def feed_attitude(core: ShipAttitudeCore, run: SimulatedRun) -> tuple[AttitudeEstimate, int]:
    """Process a run with a core, in order of arrival; return the last estimate and the number of rejections."""
    estimate, rejected_count = None, 0
    for outcome in attitude_outcomes(core, run, {int(run.ins.time_ns[-1])}):
        rejected_count += (outcome.rejection is not None) + sum(not decision.accepted for decision in outcome.decisions)
        if outcome.estimates:
            estimate = outcome.estimates[-1]
    if estimate is None:
        raise ValueError("the core used no INS sample of the run")
    return estimate, rejected_count


def attitude_outcomes(
    core: ShipAttitudeCore, run: SimulatedRun, wanted_ns: Container[int]
) -> Iterator[AttitudeOutcome]:
    """Process the arrivals of a run and yield the outcomes.

    Attitudes are requested at the wanted stamps of INS samples, and come too at a sample that ends a batch by a fault.
    """
    ins = _InsBatches(core, run, wanted_ns)
    for _, source, index in run.arrivals():
        if source == "ins":
            yield from ins.add_sample(index)
            continue
        yield from ins.commit()
        if source in SKY_SOURCES:
            yield core.add_surroundings(sky_input(run, source, index))
        elif source == DEFLECTION_SOURCE:
            yield core.add_surroundings(deflection_reading(run, index))
        elif source == BASELINE_SOURCE:
            yield core.add_measurement(baseline_measurement(run, index))
        else:
            yield core.add_measurement(measurement_of(run, source, index))


class _InsBatches:
    """INS samples, checked in batches as in a replay; a batch ends before the next wanted stamp.

    Args:
        core: core that processes the samples.
        run: simulated run.
        wanted_ns: stamps at which an attitude is requested.
    """

    def __init__(self, core: ShipAttitudeCore, run: SimulatedRun, wanted_ns: Container[int]) -> None:
        ins = run.ins
        self._core, self._block = core, SampleBlock(ins.time_ns, ins.rotation_nd, ins.rate_d)
        wanted = [row for row, time_ns in enumerate(ins.time_ns.tolist()) if time_ns in wanted_ns]
        self._wanted = np.array([*wanted, ins.time_ns.size])
        self._in_order = bool(np.all(np.diff(ins.log_time_ns) >= 0))
        self._batch: InsBatch | None = None
        self._arrived = 0

    def add_sample(self, index: int) -> Iterator[AttitudeOutcome]:
        """Add a sample that arrived."""
        if self._batch is None:
            next_wanted = int(self._wanted[np.searchsorted(self._wanted, index)])
            block = self._block.subset(slice(index, min(next_wanted, index + _MAX_BATCH)))
            if self._in_order and len(block.times_ns):
                self._batch, self._arrived = self._core.ins.evaluate_block(block, block.times_ns), 0
            if self._batch is None:
                yield self._core.ins.add(self._block.sample(index), estimate=index == next_wanted)
                return
        self._arrived += 1
        if self._arrived == self._batch.checked.count:
            yield from self.commit()
            last, self._batch = self._core.ins.finish_block(self._batch), None
            if last is not None:
                yield last

    def commit(self) -> Iterator[AttitudeOutcome]:
        """Commit the samples that have arrived."""
        if self._batch is not None:
            self._core.ins.commit_block(self._batch, min(self._arrived, self._batch.checked.accepted_count))
            yield from (outcome for _, outcome in self._batch.pending_outcomes)
            self._batch.pending_outcomes.clear()


def deflection_reading(run: SimulatedRun, index: int) -> DeflectionReading:
    """Return a reading of the deflection of the vertical."""
    deflections = run.deflections
    assert deflections is not None
    covariance = deflections.covariance if deflections.covariance.any() else None
    return DeflectionReading(int(deflections.time_ns[index]), deflections.deflection[index], covariance)


def baseline_measurement(run: SimulatedRun, index: int) -> BaselineMeasurement:
    """Return a satellite baseline between the two antennas on board."""
    baselines = run.ship_baseline
    assert baselines is not None
    return BaselineMeasurement(
        int(baselines.time_ns[index]), baselines.baseline_n[index], baselines.covariance_n[index]
    )


def sky_input(run: SimulatedRun, source: str, index: int) -> SkyInput:
    """Return a fix, or a reading of the weather station."""
    if source == "fix":
        fixes = run.fixes
        return PositionFix(int(fixes.time_ns[index]), fixes.position(index), fixes.covariance_m2)
    weather = run.scenario.weather
    values = {
        "pressure": weather.pressure_hpa,
        "temperature": weather.temperature_c,
        "humidity": 0.01 * weather.humidity_percent,
    }
    return AirReading(source, int(run.weather_ns[index]), values[source], None)


def measurement_of(run: SimulatedRun, source: str, index: int) -> CheckedMeasurement:
    """Return a measurement of a star sensor or another attitude system in the estimator's form."""
    kind, _, name = source.partition(".")
    device = run.stars[name] if kind == "star" else run.references[name]
    if isinstance(device, StarSightings):
        return star_exposure(run, name, index)
    time_ns = int(device.time_ns[index])
    if isinstance(device, InertialSamples):
        return InertialAttitude(source, time_ns, device.rotation_cv[index], device.noise_v)
    return AttitudeMeasurement(source, time_ns, device.rotation_nv[index], device.noise_v, device.common_n)


def star_exposure(run: SimulatedRun, sensor_id: str, index: int) -> StarExposure:
    """Return one exposure of a sensor with single stars in the estimator's form."""
    sightings = run.stars[sensor_id]
    assert isinstance(sightings, StarSightings)
    return _exposure_of(f"star.{sensor_id}", run.scenario.star_sensors[sensor_id], sightings, index)


def _exposure_of(source: str, config: StarImaging, sightings: StarSightings, index: int) -> StarExposure:
    exposure_s, camera, length = float(np.float32(config.exposure_s)), config.camera.camera(source), None
    if exposure_s:
        length = ExposureLength(exposure_s, camera, config.camera.psf_sigma_px)
    stars, time_ns = sightings.stars[sightings.rows(index)], int(sightings.time_ns[index])
    return StarExposure(
        source,
        time_ns,
        **vars(stars),
        length=length,
        masks=config.sight_masks,
        optics=config.camera.optics_errors(camera),
        spatial=config.camera.spatial_errors(camera),
    )


@dataclass(frozen=True)
class PointingErrors:
    """Errors of one session at the stamps of the truth for which there is a pointing that is not INVALID.

    Attributes:
        time_s: time after the start, shape (k,).
        error_n: rotation vectors, R_true = exp(error) R_estimate, rad, shape (k, 3).
        covariance_n: predicted covariance of the errors, rad², shape (k, 3, 3).
        axis_n: true direction of the main axis, shape (k, 3).
        mode: pointing mode, shape (k,).
        ins_encoder: error of the axis computed from INS, encoders and configured axis errors alone, rad, shape (k,).
        sightings: number of exposures with lights or stars that were used.
        rejected_count: number of inputs and exposures that were not used.
    """

    time_s: FloatArray
    error_n: FloatArray
    covariance_n: FloatArray
    axis_n: FloatArray
    mode: np.ndarray
    ins_encoder: FloatArray
    sightings: int
    rejected_count: int

    @property
    def error_on_sky(self) -> FloatArray:
        """Error of the axis, an angle on the sky, rad, shape (k,)."""
        angle: FloatArray = np.linalg.norm(np.cross(self.error_n, self.axis_n), axis=-1)
        return angle

    @property
    def sigma_on_sky(self) -> FloatArray:
        """Predicted root mean square of the error on the sky, of both components together, rad, shape (k,)."""
        along = np.einsum("ki,kij,kj->k", self.axis_n, self.covariance_n, self.axis_n)
        sigma: FloatArray = np.sqrt(np.trace(self.covariance_n, axis1=-2, axis2=-1) - along)
        return sigma


def pointing_errors(scenario: Scenario, seed: int) -> PointingErrors:
    """Simulate a session, filter it, and return the errors of pointings that are not INVALID."""
    run = simulate(scenario, seed)
    core = pointing_core_for(scenario)
    estimates, sightings, rejected_count = feed_pointing(core, run)
    theodolite, start_ns = theodolite_of(run), run.start_ns
    truth = theodolite.truth
    rows = {int(stamp): row for row, stamp in enumerate(theodolite.encoder.time_ns[truth.encoder_index])}
    kept = [found for found in estimates if found.time_ns in rows and found.status is not Status.INVALID]
    kept_rows = [rows[found.time_ns] for found in kept]
    true_nm = truth.mount.rotation_nm[kept_rows]
    estimate_nm = np.array([found.rotation_nm for found in kept])
    return PointingErrors(
        time_s=np.array([(found.time_ns - start_ns) * 1e-9 for found in kept]),
        error_n=log_rotation(true_nm @ np.swapaxes(estimate_nm, -1, -2)),
        covariance_n=np.array([found.covariance_n for found in kept]),
        axis_n=true_nm[:, :, 0],
        mode=np.array([found.mode for found in kept], dtype=Mode),
        ins_encoder=_ins_encoder_errors(run)[kept_rows],
        sightings=sightings,
        rejected_count=rejected_count,
    )


def pointing_core_for(scenario: Scenario) -> OpticalAxisCore:
    """Return a core with the configuration of a scenario, and with a sky model if there is a star camera."""
    config = build(OpticalAxisConfig, optical_axis_configuration(scenario))
    return OpticalAxisCore(config, load_sky_model(config.sky) if config.telescopes else None)


def theodolite_of(run: SimulatedRun) -> TheodoliteRun:
    """Return the theodolite's part of a run.

    Raises:
        ValueError: the scenario has no theodolite.
    """
    if run.theodolite is None:
        raise ValueError("the scenario has no theodolite")
    return run.theodolite


def _ins_encoder_errors(run: SimulatedRun) -> FloatArray:
    """Return the error of the axis from INS and encoders alone, rad, at the stamps of the truth, without INS noise."""
    theodolite, ins = theodolite_of(run), run.truth.ins
    index, mount = theodolite.truth.encoder_index, theodolite.truth.mount
    time_ns = theodolite.encoder.time_ns[index]
    since_s, times_s = (run.ins.time_ns - run.start_ns) * 1e-9, (time_ns - run.start_ns) * 1e-9
    slow_n = np.stack([np.interp(times_s, since_s, column) for column in ins.attitude_error_n.T], axis=-1)
    known = AxisErrors.from_vector(run.scenario.theodolite.axes.values)
    rotation_dm = main_axis_rotation(known, theodolite.encoder.azimuth[index], theodolite.encoder.elevation[index])
    axis_n = (exp_rotation(-slow_n) @ mount.rotation_nd @ rotation_dm)[:, :, 0]
    return angle_between(axis_n, mount.rotation_nm[:, :, 0])


def feed_pointing(core: OpticalAxisCore, run: SimulatedRun) -> tuple[list[PointingEstimate], int, int]:
    """Process a run with a core, in order of arrival; return pointings, exposures used, and number of rejections."""
    estimates: list[PointingEstimate] = []
    sightings = rejected_count = 0
    for outcome in pointing_outcomes(core, run):
        accepted = sum(decision.accepted for decision in outcome.decisions)
        sightings += accepted
        rejected_count += (outcome.rejection is not None) + len(outcome.decisions) - accepted
        estimates += outcome.estimates
    return estimates, sightings, rejected_count


def pointing_outcomes(core: OpticalAxisCore, run: SimulatedRun) -> Iterator[PointingOutcome]:
    """Yield the outcome of each arrival of a run."""
    for _, source, index in run.pointing_arrivals():
        yield feed_arrival(core, run, source, index)


def feed_arrival(core: OpticalAxisCore, run: SimulatedRun, source: str, index: int) -> PointingOutcome:
    """Process one arrival of a run, named as in :meth:`SimulatedRun.pointing_arrivals`."""
    kind, _, name = source.partition(".")
    if kind == "fused" and run.fused is not None:
        return core.pointings.add_ship(_ship_sample(run, run.fused, index))
    theodolite = theodolite_of(run)
    if kind == "encoder":
        readings = theodolite.encoder
        angles = np.array([readings.azimuth[index], readings.elevation[index]])
        return core.pointings.add_encoder(EncoderSample(int(readings.time_ns[index]), angles, readings.sigma))
    if kind == "drone":
        drone = theodolite.drones[name]
        sample = AttitudeSample(int(drone.time_ns[index]), drone.rotation_nb[index], drone.rate_b[index])
        return core.streams.add_drone_attitude(name, sample)
    if kind == "baseline":
        found = theodolite.baselines[name]
        baseline = BaselineSample(int(found.time_ns[index]), found.baseline_n[index], found.covariance_n[index])
        return core.streams.add_baseline(name, baseline)
    if kind == "image":
        images = theodolite.images
        lights = tuple(DetectedBeacon(key, point_m, images.sigma_m) for key, point_m in images.sightings(index))
        exposure = Exposure(int(images.time_ns[index]), lights, run.scenario.theodolite.telescope.exposure_s)
        return core.add_exposure(exposure) if lights else PointingOutcome()
    if kind == "star":
        return core.add_exposure(_exposure_of(source, run.scenario.telescopes[name], theodolite.stars[name], index))
    if kind in SKY_SOURCES:
        return core.add_surroundings(sky_input(run, source, index))
    # The INS is contained in the fused attitude; the direction of a target changes no pointing.
    return PointingOutcome()


def _ship_sample(run: SimulatedRun, fused: FusedSamples, index: int) -> ShipSample:
    white = run.scenario.fused_attitude.white_sigma_arcsec * ARCSEC
    slow_covariance_n = fused.covariance_n - white**2 * np.eye(3)
    return ShipSample(int(fused.time_ns[index]), fused.rotation_nd[index], fused.rate_d[index], slow_covariance_n)

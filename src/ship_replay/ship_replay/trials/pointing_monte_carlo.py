"""Is the pointing honest? Simulated sessions through the core of ``optical_axis``, each against the truth.

Errors within one session are correlated, those of different seeds are not.
"""

from dataclasses import dataclass

import numpy as np

from ship_estimation.outcome import Status
from ship_estimation.parameters import build
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.suite.suite import optical_axis_configuration
from ship_simulation.theodolite.scene import axis_errors_of
from theodolite_calib.chain.axes import AxisErrors, main_axis_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.measured.samples import (
    BaselineSample,
    EncoderSample,
    Exposure,
    Mode,
    PointingEstimate,
    PointingOutcome,
    SeenLight,
    ShipSample,
)
from theodolite_calib.optical_axis.core import OpticalAxisCore


@dataclass(frozen=True)
class PointingErrors:
    """Errors of one session at the stamps of the truth where a pointing is claimed.

    Attributes:
        time_s: after the start, shape (k,).
        error_n: rotation vectors, R_true = exp(error) R_estimate, rad, shape (k, 3).
        covariance_n: as claimed, rad², shape (k, 3, 3).
        axis_n: where the main axis truly points, shape (k, 3).
        mode: how each was found, shape (k,).
        ins_encoder: error of the axis by INS and encoders alone, axis errors as configured, rad, shape (k,).
        sightings: exposures with lights that were used.
        refused: inputs and exposures that were not.
    """

    time_s: FloatArray
    error_n: FloatArray
    covariance_n: FloatArray
    axis_n: FloatArray
    mode: np.ndarray
    ins_encoder: FloatArray
    sightings: int
    refused: int

    @property
    def on_sky(self) -> FloatArray:
        """Error of the axis, an angle on the sky, rad, shape (k,)."""
        return np.linalg.norm(np.cross(self.error_n, self.axis_n), axis=-1)

    @property
    def sigma_on_sky(self) -> FloatArray:
        """What it is claimed to be (RMS), rad, shape (k,)."""
        along = np.einsum("ki,kij,kj->k", self.axis_n, self.covariance_n, self.axis_n)
        return np.sqrt(np.trace(self.covariance_n, axis1=-2, axis2=-1) - along)


def pointing_errors(scenario: Scenario, seed: int) -> PointingErrors:
    """Simulate, filter, compare."""
    run = simulate(scenario, seed)
    core = OpticalAxisCore(build(OpticalAxisConfig, optical_axis_configuration(scenario)))
    estimates, sightings, refused = feed(core, run)
    truth, start_ns = run.theodolite.truth, run.start_ns
    rows = {int(stamp): row for row, stamp in enumerate(run.theodolite.encoder.time_ns[truth.encoder_index])}
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
        ins_encoder=_ins_encoder(run)[kept_rows],
        sightings=sightings,
        refused=refused,
    )


def _ins_encoder(run: SimulatedRun) -> FloatArray:
    """Error of the axis by INS and encoders alone at the stamps of the truth, rad; noise of the INS left out."""
    theodolite, ins = run.theodolite, run.truth.ins
    index, mount = theodolite.truth.encoder_index, theodolite.truth.mount
    time_ns = theodolite.encoder.time_ns[index]
    since_s, moments_s = (run.ins.time_ns - run.start_ns) * 1e-9, (time_ns - run.start_ns) * 1e-9
    slow_n = np.stack([np.interp(moments_s, since_s, column) for column in ins.attitude_error_n.T], axis=-1)
    known = AxisErrors.from_vector(axis_errors_of(run.scenario.theodolite.axes)[0])
    rotation_dm = main_axis_rotation(known, theodolite.encoder.azimuth[index], theodolite.encoder.elevation[index])
    axis_n = (exp_rotation(-slow_n) @ mount.rotation_nd @ rotation_dm)[:, :, 0]
    return angle_between(axis_n, mount.rotation_nm[:, :, 0])


def feed(core: OpticalAxisCore, run: SimulatedRun) -> tuple[list[PointingEstimate], int, int]:
    """A whole run into a core, in order of arrival; all pointings, exposures used, and what was refused."""
    estimates: list[PointingEstimate] = []
    sightings = refused = 0
    for _, source, index in run.pointing_arrivals():
        outcome = _give(core, run, source, index)
        accepted = sum(decision.accepted for decision in outcome.decisions)
        sightings += accepted
        refused += (outcome.refusal is not None) + len(outcome.decisions) - accepted
        estimates += outcome.estimates
    return estimates, sightings, refused


def _give(core: OpticalAxisCore, run: SimulatedRun, source: str, index: int) -> PointingOutcome:
    kind, _, name = source.partition(".")
    theodolite = run.theodolite
    if kind == "fused":
        return core.add_ship(_ship_sample(run, index))
    if kind == "encoder":
        readings = theodolite.encoder
        angles = np.array([readings.azimuth[index], readings.elevation[index]])
        return core.add_encoder(EncoderSample(int(readings.time_ns[index]), angles, readings.sigma))
    if kind == "drone":
        drone = theodolite.drones[name]
        sample = AttitudeSample(int(drone.time_ns[index]), drone.rotation_nb[index], drone.rate_b[index])
        return core.add_drone_attitude(name, sample)
    if kind == "baseline":
        found = theodolite.baselines[name]
        baseline = BaselineSample(int(found.time_ns[index]), found.baseline_n[index], found.covariance_n[index])
        return core.add_baseline(name, baseline)
    if kind == "image":
        images = theodolite.images
        lights = tuple(SeenLight(key, point_m, images.sigma_m) for key, point_m in images.sightings(index))
        exposure = Exposure(int(images.time_ns[index]), lights, run.scenario.theodolite.telescope.exposure_s)
        return core.add_exposure(exposure) if lights else PointingOutcome()
    # ins: the fused attitude holds what it says.
    return PointingOutcome()


def _ship_sample(run: SimulatedRun, index: int) -> ShipSample:
    fused = run.fused
    white = run.scenario.fused_attitude.white_sigma_arcsec * ARCSEC
    slow_covariance_n = fused.covariance_n - white**2 * np.eye(3)
    return ShipSample(int(fused.time_ns[index]), fused.rotation_nd[index], fused.rate_d[index], slow_covariance_n)

"""Sessions of the theodolite in which one device is faulty: outputs of the core compared with the truth.

The session is that of ``bags/theodolite.mcap`` with both lights all the time. The faults are applied to the arrays of
device measurements before they are given to the core.
"""

import copy
import dataclasses
import functools
from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np

import ship_testing.copies  # noqa: F401
from ship_estimation.parameters.schema import build, flatten, nest
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.suite_file import optical_axis_configuration
from ship_testing.theodolite_scenes import bag_scenario, replace_nested, with_beacons, with_theodolite
from ship_testing.trials.monte_carlo import feed_arrival
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.samples.samples import PointingEstimate, PointingOutcome

FAULT_S, DURATION_S = 40.0, 85.0


@functools.cache
def fault_free_session(seed: int, beacons_leave_s: float = 1e4, duration_s: float = DURATION_S) -> SimulatedRun:
    """Return the session without a fault, at low rates."""
    scenario = with_beacons(bag_scenario(duration_s=duration_s), leaves_s=beacons_leave_s, hidden={})
    scenario = with_theodolite(scenario, encoder__rate_hz=20.0)
    return simulate(dataclasses.replace(scenario, ins=replace_nested(scenario.ins, rate_hz=1.0)), seed)


def turn_ship_attitude(run: SimulatedRun, arcsec_n: tuple[float, ...], until_s: float = np.inf) -> SimulatedRun:
    """Rotate ``ship/attitude`` about North, Up and East from FAULT_S on."""
    fused = run.fused
    rotation_nd, is_faulty = fused.rotation_nd.copy(), _is_faulty(run, fused.time_ns, until_s)
    rotation_nd[is_faulty] = exp_rotation(ARCSEC * np.array(arcsec_n)) @ rotation_nd[is_faulty]
    return replace(run, fused=replace(fused, rotation_nd=rotation_nd))


def move_baseline(run: SimulatedRun, beacon: str, moved_n: tuple[float, ...], until_s: float = np.inf) -> SimulatedRun:
    """Move the baseline to a drone (North, Up, East), m, from FAULT_S on; the baseline's status remains FIXED."""
    found = run.theodolite.baselines[beacon]
    moved = found.baseline_n + _is_faulty(run, found.time_ns, until_s)[:, None] * np.array(moved_n)
    baselines = {**run.theodolite.baselines, beacon: replace(found, baseline_n=moved)}
    return replace(run, theodolite=replace(run.theodolite, baselines=baselines))


def offset_encoders(
    run: SimulatedRun, azimuth_arcsec: float, elevation_arcsec: float, until_s: float = np.inf
) -> SimulatedRun:
    """Offset the encoders from FAULT_S on."""
    readings = run.theodolite.encoder
    offset = ARCSEC * _is_faulty(run, readings.time_ns, until_s)
    azimuth, elevation = readings.azimuth + azimuth_arcsec * offset, readings.elevation + elevation_arcsec * offset
    slipped = replace(readings, azimuth=azimuth, elevation=elevation)
    return replace(run, theodolite=replace(run.theodolite, encoder=slipped))


def freeze_encoders(run: SimulatedRun, until_s: float = np.inf) -> SimulatedRun:
    """Freeze the encoders at their reading of FAULT_S."""
    readings = run.theodolite.encoder
    faulty = _is_faulty(run, readings.time_ns, until_s)
    first = int(np.argmax(faulty))
    azimuth = np.where(faulty, readings.azimuth[first], readings.azimuth)
    elevation = np.where(faulty, readings.elevation[first], readings.elevation)
    frozen = replace(readings, azimuth=azimuth, elevation=elevation)
    return replace(run, theodolite=replace(run.theodolite, encoder=frozen))


def duplicate_encoder_readings(run: SimulatedRun, azimuth_arcsec: float, until_s: float = np.inf) -> SimulatedRun:
    """Repeat each reading from FAULT_S on with its stamp, a millisecond later and with another azimuth."""
    readings = run.theodolite.encoder
    again = np.flatnonzero(_is_faulty(run, readings.time_ns, until_s))
    both = replace(
        readings,
        time_ns=np.append(readings.time_ns, readings.time_ns[again]),
        log_time_ns=np.append(readings.log_time_ns, readings.log_time_ns[again] + 1_000_000),
        azimuth=np.append(readings.azimuth, readings.azimuth[again] + azimuth_arcsec * ARCSEC),
        elevation=np.append(readings.elevation, readings.elevation[again]),
    )
    return replace(run, theodolite=replace(run.theodolite, encoder=both))


def shift_encoder_stamps(run: SimulatedRun, delay_s: float, until_s: float = np.inf) -> SimulatedRun:
    """Delay or advance the stamps of the readings from FAULT_S on."""
    readings = run.theodolite.encoder
    late_ns = round(delay_s * 1e9) * _is_faulty(run, readings.time_ns, until_s)
    late = replace(readings, time_ns=readings.time_ns + late_ns)
    return replace(run, theodolite=replace(run.theodolite, encoder=late))


def drift_encoders(run: SimulatedRun, azimuth_arcsec_per_s: float, until_s: float = np.inf) -> SimulatedRun:
    """Let the encoders' azimuth drift from FAULT_S on."""
    readings = run.theodolite.encoder
    drift = azimuth_arcsec_per_s * ARCSEC * _fault_duration_s(run, readings.time_ns, until_s)
    return replace(run, theodolite=replace(run.theodolite, encoder=replace(readings, azimuth=readings.azimuth + drift)))


def drift_ship_attitude(run: SimulatedRun, arcsec_n_per_s: tuple[float, ...], until_s: float = np.inf) -> SimulatedRun:
    """Let ``ship/attitude`` drift about North, Up and East from FAULT_S on; its rates do not contain the drift."""
    fused, turning_n = run.fused, ARCSEC * np.array(arcsec_n_per_s)
    rotation_nd = exp_rotation(_fault_duration_s(run, fused.time_ns, until_s)[:, None] * turning_n) @ fused.rotation_nd
    return replace(run, fused=replace(fused, rotation_nd=rotation_nd))


def shift_telescope(
    run: SimulatedRun, right_arcsec: float, up_arcsec: float, until_s: float = np.inf
) -> SimulatedRun:
    """Displace the lights on the detector from FAULT_S on."""
    images, focal_length_m = run.theodolite.images, run.scenario.theodolite.telescope.focal_length_m
    is_faulty = np.repeat(_is_faulty(run, images.time_ns, until_s), np.diff(images.first))
    moved_m = focal_length_m * ARCSEC * np.array([right_arcsec, up_arcsec])
    shifted = replace(images, point_m=images.point_m + is_faulty[:, None] * moved_m)
    return replace(run, theodolite=replace(run.theodolite, images=shifted))


def shift_beacon_stamps(run: SimulatedRun, delay_s: float, until_s: float = np.inf) -> SimulatedRun:
    """Delay or advance stamps and arrivals of the images from FAULT_S on."""
    images = run.theodolite.images
    late_ns = round(delay_s * 1e9) * _is_faulty(run, images.time_ns, until_s)
    late = replace(images, time_ns=images.time_ns + late_ns, log_time_ns=images.log_time_ns + late_ns)
    return replace(run, theodolite=replace(run.theodolite, images=late))


def _is_faulty(run: SimulatedRun, time_ns: np.ndarray, until_s: float) -> np.ndarray:
    since_s = (time_ns - run.start_ns) * 1e-9
    is_faulty: np.ndarray = (since_s >= FAULT_S) & (since_s < until_s)
    return is_faulty


def _fault_duration_s(run: SimulatedRun, time_ns: np.ndarray, until_s: float) -> np.ndarray:
    """Return the time since the beginning of the fault, s; 0 before it."""
    since_s: np.ndarray = (time_ns - run.start_ns) * 1e-9 - FAULT_S
    return since_s * _is_faulty(run, time_ns, until_s)


@dataclass(frozen=True)
class PointingErrors:
    """The k outputs of the core at stamps of the truth that are not INVALID.

    Attributes:
        time_s: time after the start, s, shape (k,).
        status: status of each output, shape (k,).
        sigmas: largest error of azimuth·cosE, elevation and image rotation in their sigmas, shape (k,).
        errors: errors of these three, rad, shape (k, 3).
        levels: their protection levels, rad, shape (k, 3); NaN where there is none.
        estimates: the outputs.
        core: core after the session.
        rejected_count: number of rejected inputs and of rejected measurement decisions.
        start_ns: start of the session.
        excluded_sources: sources that were ever excluded.
    """

    time_s: FloatArray
    status: np.ndarray
    sigmas: FloatArray
    errors: FloatArray
    levels: FloatArray
    estimates: list[PointingEstimate]
    core: OpticalAxisCore
    rejected_count: int
    start_ns: int
    excluded_sources: set[str]

    def worst(self, *statuses: Status, from_s: float = FAULT_S) -> float:
        """Return the largest error in sigmas of outputs with one of these statuses; 0 without such outputs."""
        chosen = np.isin(self.status, statuses) & (self.time_s >= from_s)
        return float(np.max(self.sigmas[chosen], initial=0.0))

    def worst_of_level(self, from_s: float = FAULT_S) -> float:
        """Return the largest ratio of an error to its protection level while VALID; 0 without a level."""
        chosen = (self.status == Status.VALID) & (self.time_s >= from_s) & np.all(np.isfinite(self.levels), axis=1)
        return float(np.max(np.abs(self.errors[chosen]) / self.levels[chosen], initial=0.0))

    def duration_s(self, status: Status, from_s: float = FAULT_S, beyond: float = 0.0) -> float:
        """Return the duration of outputs with a status and an error beyond this many sigmas, s."""
        chosen = (self.status == status) & (self.time_s >= from_s) & (self.sigmas >= beyond)
        return float(np.count_nonzero(chosen) * np.median(np.diff(self.time_s)))


class CoreRun:
    """A core, and its outputs for the arrivals so far.

    Attributes:
        core: the core.
        outcomes: outcome of each arrival.
        levels: protection levels by stamp of the truth, rad.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.core = OpticalAxisCore(config)
        self.outcomes: list[PointingOutcome] = []
        self.levels: dict[int, FloatArray] = {}

    def process(self, run: SimulatedRun, arrivals: list[tuple[int, str, int]], stamps: Container[int]) -> None:
        for _, source, index in arrivals:
            outcome = feed_arrival(self.core, run, source, index)
            self.outcomes.append(outcome)
            known = [estimate for estimate in outcome.estimates if estimate.time_ns in stamps]
            self.levels |= {estimate.time_ns: self.core.integrity(estimate).level for estimate in known}

    def clone(self) -> "CoreRun":
        """Return a copy that continues from here."""
        other = copy.copy(self)
        other.core, other.outcomes, other.levels = copy.deepcopy(self.core), self.outcomes[:], self.levels.copy()
        return other


_BEFORE_FAULTS: dict[tuple[int, str], CoreRun] = {}
"""Core runs until FAULT_S by truth and configuration; all faults of a session share them.

Only the newest _MAX_CACHED are kept, because each has tens of megabytes.
"""
_MAX_CACHED = 3


def run_core(run: SimulatedRun, stamps_of: SimulatedRun | None = None, **changes: object) -> PointingErrors:
    """Feed a session into a core, with dotted parameters changed (``__`` for the dot), and compare with the truth.

    Args:
        run: the session.
        stamps_of: the same session with correct encoder stamps, if those of ``run`` are wrong.
        changes: changed parameters.
    """
    config = build(OpticalAxisConfig, optical_axis_configuration(run.scenario))
    if changes:
        values = {**flatten(config), **{name.replace("__", "."): value for name, value in changes.items()}}
        config = build(OpticalAxisConfig, nest(values))
    truth = run.theodolite.truth
    stamps_ns = (stamps_of or run).theodolite.encoder.time_ns
    rows = {int(stamp): row for row, stamp in enumerate(stamps_ns[truth.encoder_index])}
    arrivals, fault_ns = run.pointing_arrivals(), run.start_ns + round(FAULT_S * 1e9)
    before = sum(log_ns < fault_ns for log_ns, _, _ in arrivals)
    key = id(truth), repr(config)
    if key not in _BEFORE_FAULTS:
        if len(_BEFORE_FAULTS) >= _MAX_CACHED:
            del _BEFORE_FAULTS[next(iter(_BEFORE_FAULTS))]
        _BEFORE_FAULTS[key] = CoreRun(config)
        _BEFORE_FAULTS[key].process(run, arrivals[:before], rows)
    core_run = _BEFORE_FAULTS[key].clone()
    core_run.process(run, arrivals[before:], rows)
    core, outcomes, levels = core_run.core, core_run.outcomes, core_run.levels
    decisions = [decision for outcome in outcomes for decision in outcome.decisions]
    rejected_count = sum(outcome.rejection is not None for outcome in outcomes)
    rejected_count += sum(not decision.accepted for decision in decisions)
    estimates = [found for outcome in outcomes for found in outcome.estimates]
    valid_estimates = [found for found in estimates if found.time_ns in rows and found.status is not Status.INVALID]
    compared = [_errors(found, truth.mount.rotation_nm[rows[found.time_ns]]) for found in valid_estimates]
    errors, sigma = (np.array(column) for column in zip(*compared, strict=True))
    return PointingErrors(
        time_s=np.array([(found.time_ns - run.start_ns) * 1e-9 for found in valid_estimates]),
        status=np.array([found.status for found in valid_estimates]),
        sigmas=np.max(np.abs(errors) / sigma, axis=1),
        errors=errors,
        levels=np.array([levels[found.time_ns] for found in valid_estimates]),
        estimates=valid_estimates,
        core=core,
        rejected_count=rejected_count,
        start_ns=run.start_ns,
        excluded_sources={source for decision in decisions for source in decision.excluded_sources},
    )


def _errors(found: PointingEstimate, true_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return errors of azimuth·cosE, elevation and image rotation, and their sigmas, rad, shape (3,) each."""
    azimuth, elevation, _ = angles_from_rotation(found.rotation_nm)
    to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
    to_angles[0] *= np.cos(elevation)
    covariance = to_angles @ found.covariance_n @ to_angles.T
    return to_angles @ log_rotation(true_nm @ found.rotation_nm.T), np.sqrt(np.diagonal(covariance))

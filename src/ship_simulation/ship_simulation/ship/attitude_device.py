"""Attitude devices mounted on the ship: samples with errors from the true motion.

The devices are the INS, star sensors that solve for the horizon attitude, other attitude systems, and the attitude
fused from INS and stars.
"""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.parameters.ship_devices import SCHULER
from ship_geometry.earth.geodetic import EARTH_RATE_RAD_PER_S
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_simulation.random_draws import (
    Draws,
    ExposureTimes,
    Stretch,
    arrival_times,
    exposure_times,
    is_outside,
    random_stream,
)
from ship_simulation.scenario.scenario import Reference, Scenario, StarSensor
from ship_simulation.ship.motion import Carrier
from ship_simulation.ship.schuler import SchulerError
from ship_simulation.ship.ship_track import Deflection


@dataclass(frozen=True)
class InsSamples:
    """The samples of the INS.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        rotation_nd: horizon from deck as measured, shape (n, 3, 3).
        rate_d: angular velocity as measured, (bow, up, starboard), rad/s, shape (n, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nd: FloatArray
    rate_d: FloatArray


@dataclass(frozen=True)
class InsTruth:
    """The errors of the INS that are correlated from sample to sample.

    Attributes:
        attitude_error_n: correlated error a at each sample (north, up, east), including the deflection of the vertical,
            rad, shape (n, 3).
        time_offset_s: time of validity of a sample minus its stamp.
    """

    attitude_error_n: FloatArray
    time_offset_s: float


def simulate_ins(
    scenario: Scenario, carrier: Carrier, stretch: Stretch, draws: Draws, deflection: Deflection
) -> tuple[InsSamples, InsTruth]:
    """Return INS samples R_ins(s), where R_true(s + tau) = exp(a) exp(w) R_ins(s), and their true errors.

    The error a is correlated, the error w is white. The angular rate is the true rate at s + tau, plus errors.
    """
    config = scenario.ins
    time_ns = stretch.stamps(config.rate_hz, 0.0)
    truth = InsTruth(
        attitude_error_n=_correlated_ins_error(scenario, stretch, draws, deflection),
        time_offset_s=config.time_offset_s
        + config.time_offset_sigma_s * random_stream(draws.seed, "ins.time_offset").standard_normal(),
    )
    valid_s = (time_ns - stretch.start_ns) / SECOND_NS + truth.time_offset_s
    white_n = draws.stream("ins.white").standard_normal((time_ns.size, 3)) * config.white_sigma_arcsec * ARCSEC
    true_nd = carrier.attitude(valid_s)
    samples = InsSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, draws.stream("ins.arrival")),
        rotation_nd=exp_rotation(-white_n) @ exp_rotation(-truth.attitude_error_n) @ true_nd,
        rate_d=carrier.body_rate(valid_s) + _rate_errors(scenario, true_nd, draws),
    )
    return samples, truth


def _correlated_ins_error(scenario: Scenario, stretch: Stretch, draws: Draws, deflection: Deflection) -> FloatArray:
    """Return the correlated error of the INS, plus the effect of the deflection, because the INS levels on gravity."""
    config, gravity = scenario.ins, None if scenario.gravity.is_level else deflection
    time_ns = stretch.stamps(config.rate_hz, 0.0)
    since_start_s = (time_ns - stretch.start_ns) / SECOND_NS
    sigma = ARCSEC * np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec])
    if config.model == SCHULER:
        make = functools.partial(SchulerError, scenario=scenario, sigma=sigma, deflection=gravity)
        return draws.persistent_draw("ins.schuler", make).errors_at(since_start_s)
    time_s = np.array([config.tilt_time_s, config.heading_time_s, config.tilt_time_s])
    slow_n = draws.gauss_markov("ins.attitude_error", time_ns.size, 1.0 / config.rate_hz, sigma, time_s)
    return slow_n if gravity is None else slow_n + gravity.horizon_rotation_n(since_start_s)


def _rate_errors(scenario: Scenario, true_nd: FloatArray, draws: Draws) -> FloatArray:
    """Return measured minus true angular rate of the INS, rad/s, shape (n, 3); true rates are relative to the horizon.

    The errors are noise, a correlated error of the gyroscopes, and the Earth rate if the INS does not remove it.

    Args:
        scenario: the INS, and the latitude.
        true_nd: true attitude of the deck at each sample, shape (n, 3, 3).
        draws: random draws of the run.
    """
    config, count = scenario.ins, len(true_nd)
    noise = draws.stream("ins.rate").standard_normal((count, 3))
    errors: FloatArray = config.rate_sigma_arcsec_per_s * ARCSEC * noise
    if config.rate_bias_sigma_arcsec_per_s:
        errors += draws.gauss_markov(
            "ins.rate_bias",
            count,
            1.0 / config.rate_hz,
            sigma=np.full(3, config.rate_bias_sigma_arcsec_per_s * ARCSEC),
            time_s=np.full(3, config.rate_bias_time_s),
        )
    if config.rate_has_earth_rate:
        latitude = math.radians(scenario.position.latitude_deg)
        earth_n = EARTH_RATE_RAD_PER_S * np.array([math.cos(latitude), math.sin(latitude), 0.0])
        errors += earth_n @ true_nd
    return errors


@dataclass(frozen=True)
class DeviceSamples:
    """The attitudes that a device measures.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, in any order, shape (n,).
        rotation_nv: horizon from device (forward, up, right) as measured, shape (n, 3, 3).
        noise_v: covariance of the white noise, in the device frame, rad², shape (3, 3).
        common_n: covariance of a star sensor's common error about the horizon's axes, rad², shape (3, 3); 0 otherwise.
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nv: FloatArray
    noise_v: FloatArray
    common_n: FloatArray


@dataclass(frozen=True)
class DeviceTruth:
    """True mounting and time offset of a device.

    Attributes:
        installation_error_v: rotation vector m in the device frame, rad, shape (3,).
        rotation_dv: deck from device, its installation error included, shape (3, 3).
        time_offset_s: for a star sensor, time of validity of a sample minus its stamp; for a reference, stamp of the
            reference minus stamp of the INS for the same attitude.
    """

    installation_error_v: FloatArray
    rotation_dv: FloatArray
    time_offset_s: float


@dataclass(frozen=True)
class DeviceExposures:
    """The exposures of a device that observes stars, and the true attitude of the device at each exposure.

    Attributes:
        time_ns: stamps, shape (n,).
        since_start_s: stamps in seconds after the start, shape (n,).
        valid_ns: times of validity: the stamps plus the sensor's time offset, shape (n,).
        rotation_nv: horizon from sensor, shape (n, 3, 3).
        times: quadrature nodes of each exposure.
        exposure_nv: horizon from sensor at these nodes, shape (m, n, 3, 3); ``rotation_nv[None]`` for exposure time 0.
    """

    time_ns: np.ndarray
    since_start_s: FloatArray
    valid_ns: np.ndarray
    rotation_nv: FloatArray
    times: ExposureTimes
    exposure_nv: FloatArray


@dataclass(frozen=True)
class StarSensorMotion(DeviceExposures):
    """A star sensor's exposures.

    Attributes:
        truth: mounting and time offset.
    """

    truth: DeviceTruth


def star_sensor_motion(
    sensor_id: str, scenario: Scenario, carrier: Carrier, stretch: Stretch, draws: Draws
) -> StarSensorMotion:
    """Return the exposures of a star sensor, with its attitude R_star(t) = exp(c) R_true(t + offset) exp(f) R0 exp(m).

    The rotation vectors are the common error c, the flexure f and the installation error m; R0 is the nominal mounting.
    """
    config, name = scenario.star_sensors[sensor_id], f"star.{sensor_id}"
    truth = _draw_truth(name, draws.seed, config.rotation_ds, config.installation_sigma_s, config)
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    since_start_s = (time_ns - stretch.start_ns) / SECOND_NS
    flexure_d = _correlated_error(
        name + ".flexure", draws, time_ns.size, config.rate_hz, config.flexure_sigma_arcsec, config.flexure_time_s
    )
    common_n = _correlated_error(
        name + ".common", draws, time_ns.size, config.rate_hz, config.common_sigma_arcsec, config.common_time_s
    )
    valid_s = since_start_s + truth.time_offset_s
    times = exposure_times(config.exposure_s)

    def rotation_nv(true_nd: FloatArray) -> FloatArray:
        return exp_rotation(common_n) @ true_nd @ exp_rotation(flexure_d) @ truth.rotation_dv

    middle_nv = rotation_nv(carrier.attitude(valid_s))
    moves = config.exposure_s > 0.0
    return StarSensorMotion(
        time_ns=time_ns,
        since_start_s=since_start_s,
        valid_ns=time_ns + round(truth.time_offset_s * SECOND_NS),
        rotation_nv=middle_nv,
        times=times,
        exposure_nv=rotation_nv(carrier.attitude(valid_s + times.since_middle_s[:, None]))
        if moves
        else middle_nv[None],
        truth=truth,
    )


def simulate_star_sensor(sensor_id: str, scenario: Scenario, motion: StarSensorMotion, draws: Draws) -> DeviceSamples:
    """Return the measured horizon attitudes R_star(t) exp(n), with white noise n, outside the outages."""
    config = scenario.star_sensors[sensor_id]
    common_sigma = config.common_sigma_arcsec * ARCSEC
    samples = _samples(
        f"star.{sensor_id}", draws, motion.time_ns, motion.rotation_nv, config.noise_sigma_s, common_sigma, config
    )
    keep = is_outside(motion.since_start_s, config.outages)
    return replace(
        samples,
        time_ns=samples.time_ns[keep],
        log_time_ns=samples.log_time_ns[keep],
        rotation_nv=samples.rotation_nv[keep],
    )


def simulate_reference(
    name: str,
    scenario: Scenario,
    carrier: Carrier,
    ins_time_offset_s: float,
    stretch: Stretch,
    draws: Draws,
    deflection: Deflection,
) -> tuple[DeviceSamples, DeviceTruth]:
    """Return the samples R_ref(t) = R_true(t - offset + tau) C exp(n) of another attitude system, and their truth.

    C is the mounting of the reference system relative to the INS, tau the time offset of the INS, and n white noise.
    The reference system levels itself on gravity, so R_true is relative to the horizon of gravity.
    """
    config = scenario.references[name]
    truth = _draw_truth(
        f"reference.{name}", draws.seed, config.rotation_dr, config.installation_sigma_r, config
    )
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    valid_s = (time_ns - stretch.start_ns) / SECOND_NS - truth.time_offset_s + ins_time_offset_s
    true_nv = carrier.attitude(valid_s) @ truth.rotation_dv
    if not scenario.gravity.is_level:
        true_nv = exp_rotation(-deflection.horizon_rotation_n(np.maximum(valid_s, 0.0))) @ true_nv
    return _samples(f"reference.{name}", draws, time_ns, true_nv, config.noise_sigma_r, 0.0, config), truth


def _draw_truth(
    name: str, seed: int, nominal_dv: FloatArray, sigma_v: FloatArray, config: StarSensor | Reference
) -> DeviceTruth:
    error_v = sigma_v * random_stream(seed, name + ".installation").standard_normal(3)
    offset = random_stream(seed, name + ".time_offset").standard_normal()
    return DeviceTruth(
        installation_error_v=error_v,
        rotation_dv=nominal_dv @ exp_rotation(error_v),
        time_offset_s=config.time_offset_s + config.time_offset_sigma_s * offset,
    )


def _correlated_error(
    name: str, draws: Draws, count: int, rate_hz: float, sigma_arcsec: float, time_s: float
) -> FloatArray:
    """Return a Gauss–Markov rotation vector, whose axes have the same sigma, rad, shape (count, 3)."""
    sigma = np.full(3, sigma_arcsec * ARCSEC)
    return draws.gauss_markov(name, count, 1.0 / rate_hz, sigma, np.full(3, time_s))


def _samples(
    name: str,
    draws: Draws,
    time_ns: np.ndarray,
    true_nv: FloatArray,
    sigma_v: FloatArray,
    common_sigma: float,
    config: StarSensor | Reference,
) -> DeviceSamples:
    """Return samples of true attitudes, with the white noise of the device added."""
    noise_v = sigma_v * draws.stream(name + ".white").standard_normal((time_ns.size, 3))
    arrival = draws.stream(name + ".arrival")
    return DeviceSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        rotation_nv=true_nv @ exp_rotation(noise_v),
        noise_v=np.diag(sigma_v**2),
        common_n=common_sigma**2 * np.eye(3),
    )


@dataclass(frozen=True)
class FusedSamples(InsSamples):
    """The samples of ``ship/attitude``: attitude and angular velocity as estimated, in the fields of the INS's samples.

    Attributes:
        covariance_n: covariance of the total error as a rotation vector (North, Up, East), rad², shape (3, 3).
    """

    covariance_n: FloatArray


def simulate_fused_attitude(scenario: Scenario, carrier: Carrier, stretch: Stretch, draws: Draws) -> FusedSamples:
    """Return samples R_fused(t), where R_true(t) = exp(e) exp(w) R_fused(t); e is Gauss–Markov, w is white."""
    config = scenario.fused_attitude
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    since_start_s = (time_ns - stretch.start_ns) / SECOND_NS
    sigma = ARCSEC * np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec])
    error = draws.correlated_error("fused.error", scenario.duration_s, sigma, config.time_s)
    white_sigma = config.white_sigma_arcsec * ARCSEC
    white_n = white_sigma * draws.stream("fused.white").standard_normal((time_ns.size, 3))
    arrival = draws.stream("fused.arrival")
    return FusedSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        rotation_nd=exp_rotation(-white_n)
        @ exp_rotation(-error.values_at(since_start_s))
        @ carrier.attitude(since_start_s),
        rate_d=carrier.body_rate(since_start_s),
        covariance_n=np.diag(sigma**2 + white_sigma**2),
    )

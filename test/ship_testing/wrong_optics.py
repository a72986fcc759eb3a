"""Simulated runs whose cameras have another focal length than configured, and the attitudes of the filter."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import log_rotation
from ship_simulation.run import SimulatedRun
from ship_simulation.scenario.scenario import Scenario
from ship_stars.attitude_samples import AttitudeEstimate
from ship_testing.solved_voyages import core_with_solutions, outcomes_with_solutions
from ship_testing.trials.monte_carlo import attitude_outcomes, core_for

_EXACT_SIGMA_M = 1e-12


def with_exact_focal_length(scenario: Scenario) -> Scenario:
    """Return the scenario whose true focal lengths are the configured ones."""
    sensors = {
        id_: replace(sensor, camera=replace(sensor.camera, focal_length_sigma_m=_EXACT_SIGMA_M))
        for id_, sensor in scenario.star_sensors.items()
    }
    return replace(scenario, star_sensors=sensors)


def with_wrong_configured_focal_length(run: SimulatedRun, sensor_ids: Sequence[str], scale: float) -> SimulatedRun:
    """Return the run with configured focal lengths that are shorter than the true ones (longer if ``scale`` < 0).

    Args:
        run: simulated with exact focal lengths.
        sensor_ids: sensors with a wrong focal length; all sensors get the default sigma of the focal length again.
        scale: relative difference.
    """
    sensors, stars = dict(run.scenario.star_sensors), dict(run.stars)
    for id_, sensor in sensors.items():
        true_m = sensor.camera.focal_length_m
        configured_m = true_m / (1.0 + scale) if id_ in sensor_ids else true_m
        configured = replace(sensor.camera, focal_length_m=configured_m, focal_length_sigma_m=0.0)
        sensors[id_] = replace(sensor, camera=configured)
        seen = stars[id_]
        directions_s = configured.camera(id_).directions(seen.pixel)
        stars[id_] = replace(seen, stars=replace(seen.stars, directions_s=directions_s))
    return replace(run, scenario=replace(run.scenario, star_sensors=sensors), stars=stars)


def change_focal_length(run: SimulatedRun, scale: float, from_s: float, until_s: float) -> SimulatedRun:
    """Return the run with all true focal lengths longer by the ratio ``scale`` in a time span.

    ``from_s`` and ``until_s`` count from each sensor's first exposure.
    """
    stars = dict(run.stars)
    for id_, seen in stars.items():
        configured = run.scenario.star_sensors[id_].camera
        principal = np.array([configured.principal_u_px, configured.principal_v_px])
        since_s = (seen.time_ns - seen.time_ns[0]) * 1e-9
        is_changed = np.repeat((since_s >= from_s) & (since_s < until_s), np.diff(seen.first))
        pixel = principal + (seen.pixel - principal) * (1.0 + scale * is_changed[:, None])
        directions_s = configured.camera(id_).directions(pixel)
        stars[id_] = replace(seen, pixel=pixel, stars=replace(seen.stars, directions_s=directions_s))
    return replace(run, stars=stars)


@dataclass
class OpticsErrorStatistics:
    """Attitudes of runs compared with the truth.

    Attributes:
        valid_count: VALID attitudes.
        count: all attitudes.
        last_invalid_s: time of the last attitude that is not VALID, after the first stamp of the truth.
        worst_sigmas: largest error of a VALID attitude about an axis, in standard deviations of the attitude.
        worst_over_level: largest ratio of an error of a VALID attitude to its protection level.
        texts: why measurements were rejected.
    """

    valid_count: int = 0
    count: int = 0
    last_invalid_s: float = 0.0
    worst_sigmas: float = 0.0
    worst_over_level: float = 0.0
    texts: set[str] = field(default_factory=set)

    def add_run(self, run: SimulatedRun, by_solutions: bool) -> None:
        """Add the attitudes of a run at the stamps of its truth."""
        core = core_with_solutions(run) if by_solutions else core_for(run.scenario)
        wanted = run.truth.ins_index
        if by_solutions:
            outcomes = outcomes_with_solutions(core, run, set(wanted.tolist()))
        else:
            outcomes = attitude_outcomes(core, run, set(run.ins.time_ns[wanted].tolist()))
        for outcome in outcomes:
            self.texts |= {decision.text for decision in outcome.decisions if not decision.accepted}
            for estimate in outcome.estimates:
                self._add_attitude(core, run, estimate)

    def _add_attitude(self, core: ShipAttitudeCore, run: SimulatedRun, estimate: AttitudeEstimate) -> None:
        self.count += 1
        if estimate.status is not Status.VALID:
            first_ns = int(run.ins.time_ns[run.truth.ins_index[0]])
            self.last_invalid_s = max(self.last_invalid_s, (estimate.time_ns - first_ns) * 1e-9)
            return
        self.valid_count += 1
        row = np.searchsorted(run.ins.time_ns[run.truth.ins_index], estimate.time_ns)
        error_n = log_rotation(run.truth.rotation_nd[row] @ estimate.rotation_nd.T)
        sigmas = np.abs(error_n) / np.sqrt(estimate.covariance_n.diagonal())
        heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
        error = np.abs(angle_errors_from_rotation_vector(heading, pitch) @ error_n)
        over_level = np.nan_to_num(error / core.integrity(estimate).level)
        self.worst_sigmas = max(self.worst_sigmas, float(sigmas.max()))
        self.worst_over_level = max(self.worst_over_level, float(over_level.max()))

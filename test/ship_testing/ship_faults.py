"""Voyages of the reference case with a faulty INS or faulty stars: outputs of the core compared with the truth.

The faults are applied to the arrays of device measurements before they are given to the core.
"""

import functools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.integrity.protection_levels import IntegrityReport, IntegrityState
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import (
    angle_errors_from_rotation_vector,
    angles_from_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.ship.motion import make_carrier
from ship_stars.attitude_samples import AttitudeMeasurement
from ship_testing.trials.monte_carlo import core_for

PAPER = Path(__file__).parents[2] / "bags" / "scenarios" / "paper.yaml"


class AttitudeError(NamedTuple):
    """A published attitude.

    Attributes:
        time_s: after the start.
        status: status of the attitude.
        sigmas: largest of the errors about North, Up and East, each in its estimated standard deviations.
        sources: sources that the attitude uses.
        level_ratio: largest ratio of a heading, pitch or roll error to its protection level; 0 without levels.
        excluded: the sources that are excluded.
        error: angle between the attitude and the true one, rad.
    """

    time_s: float
    status: Status
    sigmas: float
    sources: tuple[str, ...] = ()
    level_ratio: float = 0.0
    excluded: tuple[str, ...] = ()
    error: float = 0.0


class AttitudeErrors(NamedTuple):
    """All attitudes of a voyage.

    Attributes:
        attitudes: in order.
        core: after the voyage.
    """

    attitudes: list[AttitudeError]
    core: ShipAttitudeCore

    def worst_in_sigmas(self, from_s: float = 0.0, until_s: float = np.inf) -> float:
        """Return the largest error in standard deviations while VALID."""
        valid = [claim.sigmas for claim in self._errors_between(from_s, until_s) if claim.status is Status.VALID]
        return float(np.max(valid, initial=0.0))  # NaN if one is NaN

    def worst_level_ratio(self) -> float:
        """Return the largest ratio of an error to its protection level while VALID."""
        valid = [claim.level_ratio for claim in self.attitudes if claim.status is Status.VALID]
        return float(np.max(valid, initial=0.0))  # NaN if one is NaN

    def excluded_sources(self) -> set[str]:
        """Return all sources that were excluded at some time."""
        return {name for claim in self.attitudes for name in claim.excluded}

    def statuses(self, from_s: float, until_s: float = np.inf) -> set[Status]:
        """Return the statuses of a time span."""
        return {claim.status for claim in self._errors_between(from_s, until_s)}

    def largest_error(self, from_s: float, until_s: float) -> float:
        """Return the largest error of a time span, with any status, rad."""
        return max(claim.error for claim in self._errors_between(from_s, until_s))

    @property
    def not_valid_until_s(self) -> float:
        """Return the time of the last attitude that was not VALID."""
        return max((claim.time_s for claim in self.attitudes if claim.status is not Status.VALID), default=0.0)

    def _errors_between(self, from_s: float, until_s: float) -> list[AttitudeError]:
        return [claim for claim in self.attitudes if from_s <= claim.time_s < until_s]


@functools.cache
def voyage(duration_s: float, rate_hz: float, seed: int = 2, **ins: float) -> SimulatedRun:
    """Return the reference case without a fault, with an INS of another rate and other errors."""
    whole = load_scenario(PAPER)
    return simulate(replace(whole, duration_s=duration_s, ins=replace(whole.ins, rate_hz=rate_hz, **ins)), seed)


def turn_ins(run: SimulatedRun, turn_n: FloatArray, from_s: float, until_s: float = np.inf) -> SimulatedRun:
    """Rotate the INS's attitude about North, Up and East by a rotation vector, rad; its rates are unchanged."""
    rotation_nd, faulty = run.ins.rotation_nd.copy(), _faulty(run, run.ins.time_ns, from_s, until_s)
    rotation_nd[faulty] = exp_rotation(turn_n) @ rotation_nd[faulty]
    return replace(run, ins=replace(run.ins, rotation_nd=rotation_nd))


def round_ins(run: SimulatedRun, digits: int, from_s: float, until_s: float = np.inf) -> SimulatedRun:
    """Round the INS's quaternions to some decimals."""
    rotation_nd = run.ins.rotation_nd.copy()
    for index in np.flatnonzero(_faulty(run, run.ins.time_ns, from_s, until_s)):
        rotation_nd[index] = rotation_from_quaternion(np.round(quaternion_from_rotation(rotation_nd[index]), digits))
    return replace(run, ins=replace(run.ins, rotation_nd=rotation_nd))


def delay_ins_stamps(
    run: SimulatedRun, max_delay_s: float, from_s: float, until_s: float = np.inf, seed: int = 1
) -> SimulatedRun:
    """Delay the INS's stamps by random times, uniform between 0 and ``max_delay_s``."""
    faulty, rng = _faulty(run, run.ins.time_ns, from_s, until_s), np.random.default_rng(seed)
    late_ns = np.where(faulty, np.round(rng.uniform(0.0, max_delay_s * 1e9, len(faulty))), 0.0).astype(np.int64)
    return replace(run, ins=replace(run.ins, time_ns=run.ins.time_ns + late_ns))


def turn_stars(run: SimulatedRun, turn_n: FloatArray, from_s: float, until_s: float) -> SimulatedRun:
    """Rotate all star attitudes about North, Up and East by a rotation vector, rad."""
    stars = {}
    for id_, star in run.stars.items():
        rotation_nv, faulty = star.rotation_nv.copy(), _faulty(run, star.time_ns, from_s, until_s)
        rotation_nv[faulty] = exp_rotation(turn_n) @ rotation_nv[faulty]
        stars[id_] = replace(star, rotation_nv=rotation_nv)
    return replace(run, stars=stars)


def run_core(
    run: SimulatedRun, exchanged_s: tuple[float, float] = (0.0, 0.0), from_s: float = 0.0, levels: bool = False
) -> AttitudeErrors:
    """Give a voyage to a core; return its outputs.

    Args:
        run: the voyage.
        exchanged_s: begin and end of an exchange of the cables of two star sensors.
        from_s: time of the first attitude that is computed.
        levels: True to compare errors with their protection levels.
    """
    core, carrier, found = core_for(run.scenario), make_carrier(run.scenario.carrier, run.seed), []
    for log_ns, source, index in run.arrivals():
        if source == "ins":
            time_ns = int(run.ins.time_ns[index])
            sample = AttitudeSample(time_ns, run.ins.rotation_nd[index], run.ins.rate_d[index])
            outcome = core.ins.add(sample, estimate=(time_ns - run.start_ns) * 1e-9 >= from_s)
        elif source.startswith("star."):
            star = run.stars[source.removeprefix("star.")]
            values = int(star.time_ns[index]), star.rotation_nv[index], star.noise_v, star.common_n
            if exchanged_s[0] <= (log_ns - run.start_ns) * 1e-9 < exchanged_s[1]:
                source = _OTHER[source]
            outcome = core.add_measurement(AttitudeMeasurement(source, *values))
        else:
            continue
        for estimate in outcome.estimates:
            since_s = (estimate.time_ns - run.start_ns) * 1e-9
            error_n = log_rotation(carrier.attitude(np.array(since_s)) @ estimate.rotation_nd.T)
            sigmas = float(np.max(np.abs(error_n) / np.sqrt(np.diagonal(estimate.covariance_n))))
            of_level = _level_ratio(core.integrity(estimate), estimate.rotation_nd, error_n) if levels else 0.0
            excluded = tuple(core.state.excluded)
            error = float(np.linalg.norm(error_n))
            found.append(AttitudeError(since_s, estimate.status, sigmas, estimate.sources, of_level, excluded, error))
    return AttitudeErrors(found, core)


def _level_ratio(report: IntegrityReport, rotation_nd: FloatArray, error_n: FloatArray) -> float:
    """Return the largest ratio of an angle's error to its protection level; 0 without a level."""
    if report.state is IntegrityState.UNAVAILABLE:
        return 0.0
    heading, pitch, _ = angles_from_rotation(rotation_nd)
    error = angle_errors_from_rotation_vector(heading, pitch) @ error_n
    return float(np.max(np.abs(error) / report.level))


_OTHER: Mapping[str, str] = {"star.fore": "star.starboard", "star.starboard": "star.fore"}


def up(arcsec: float) -> FloatArray:
    """Return a rotation vector about Up, rad."""
    return np.array([0.0, arcsec * ARCSEC, 0.0])


def _faulty(run: SimulatedRun, time_ns: np.ndarray, from_s: float, until_s: float) -> np.ndarray:
    since_s = (time_ns - run.start_ns) * 1e-9
    faulty: np.ndarray = (since_s >= from_s) & (since_s < until_s)
    return faulty

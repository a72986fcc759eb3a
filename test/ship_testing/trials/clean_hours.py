"""Hours without faults: exclusions, availability, protection levels and consistency of the covariances.

A voyage is simulated and passed to the core of ``ship_attitude`` or ``optical_axis`` in this process, without messages
and files, so that a hundred hours of voyage take about one hour. One output a second is compared with the truth.
Exclusions, and unresolved faults of a ship, are recorded after every measurement.
"""

import dataclasses
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ship_estimation.innovations.gates import normalized_error_squared
from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_stars.attitude_samples import AttitudeEstimate
from ship_testing.trials.monte_carlo import (
    attitude_outcomes,
    core_for,
    pointing_core_for,
    pointing_outcomes,
    theodolite_of,
)
from ship_testing.trials.results_file import Result
from theodolite_calib.samples.samples import PointingEstimate

TWO, THREE, THEODOLITE = "two sensors", "three sensors", "theodolite"
ALERT_LIMIT_ARCSEC = {TWO: 30.0, THREE: 12.0}
"""Kind of voyage → alert limit within which its attitude must be available."""
SETTLED_S = 600.0
"""Time after which availability, changes to DEGRADED, RMS and largest level are evaluated, s.

By then, the correlated error of the INS is estimated.
"""
BEYOND_SIGMAS = 5.0

_SLOW_INS_HZ = 20.0
_AZIMUTHS_DEG = {"fore": 0.0, "starboard": 120.0, "port": 240.0}
_KINDS_PERIOD = 10
"""Number of voyages in one round: eight ships, one ship with the INS's full rate, one theodolite.

Ships with two and with three sensors change places in the next round.
"""


@dataclass(frozen=True)
class CleanVoyage:
    """A voyage without faults.

    Attributes:
        number: number of the voyage, and seed of its errors.
        kind: TWO, THREE or THEODOLITE.
        full_rate: True if the INS of a ship keeps the rate of the scenario, False for 20 Hz. A theodolite voyage always
            keeps the rate of the scenario.
    """

    number: int
    kind: str
    full_rate: bool


def clean_voyages(count: int) -> list[CleanVoyage]:
    """Return voyages of all kinds in turn."""
    found = []
    for number in range(count):
        turn, place = divmod(number, _KINDS_PERIOD)
        kind = THEODOLITE if place == _KINDS_PERIOD - 1 else (TWO, THREE)[(place + turn) % 2]
        found.append(CleanVoyage(number, kind, full_rate=place == _KINDS_PERIOD - 2))
    return found


def scenario_of(voyage: CleanVoyage, folder: Path, length_s: float) -> Scenario:
    """Return the scenario of a voyage: two sensors, or three at 120 degrees, or the theodolite's.

    Args:
        voyage: the voyage.
        folder: folder of the scenarios.
        length_s: length of the voyage.
    """
    name = "theodolite" if voyage.kind == THEODOLITE else "paper"
    scenario = dataclasses.replace(load_scenario(folder / f"{name}.yaml"), duration_s=length_s)
    if not voyage.full_rate and voyage.kind != THEODOLITE:
        scenario = dataclasses.replace(scenario, ins=dataclasses.replace(scenario.ins, rate_hz=_SLOW_INS_HZ))
    if voyage.kind == THREE:
        one = scenario.star_sensors["fore"]
        stars = {id_: dataclasses.replace(one, azimuth_deg=deg) for id_, deg in _AZIMUTHS_DEG.items()}
        scenario = dataclasses.replace(scenario, star_sensors=stars)
    return scenario


@dataclass
class VoyageStatistics:
    """Statistics of a voyage.

    Attributes:
        limit: alert limit of the protection levels, rad; infinite without limit.
        exclusions: time (s) and source of each exclusion.
        degradations: time (s) and reason of each change to DEGRADED after settling.
        seconds: number of outputs, one a second.
        settled: number of outputs after settling.
        available: number of outputs after settling that are VALID with every level within the limit.
        beyond_sigmas: number of VALID outputs with an error above five sigmas.
        beyond_level: number of VALID outputs with an error above the protection level.
        worst_over_level: largest ratio of an error of a VALID output to its protection level.
        worst_level: largest level of a settled output, rad.
        squares: sum of the squared errors of the settled outputs, rad², shape (3,).
        nees: NEES of the last output.
    """

    limit: float
    exclusions: list[tuple[float, str]] = field(default_factory=list)
    degradations: list[tuple[float, str]] = field(default_factory=list)
    seconds: int = 0
    settled: int = 0
    available: int = 0
    beyond_sigmas: int = 0
    beyond_level: int = 0
    worst_over_level: float = 0.0
    worst_level: float = 0.0
    squares: FloatArray = field(default_factory=lambda: np.zeros(3))
    nees: float = float("nan")
    _excluded: frozenset[str] = frozenset()
    _is_degraded: bool = False

    def record_exclusions(self, since_s: float, excluded: frozenset[str]) -> None:
        """Record the excluded sources after a measurement."""
        self.exclusions += [(since_s, name) for name in sorted(excluded - self._excluded)]
        self._excluded = excluded

    def record_status(self, since_s: float, status: Status, text: str) -> None:
        """Record a change to DEGRADED after settling."""
        if status is Status.DEGRADED and not self._is_degraded and since_s >= SETTLED_S:
            self.degradations.append((since_s, text))
        self._is_degraded = status is Status.DEGRADED

    def record_output(
        self, since_s: float, status: Status, report: IntegrityReport, error: FloatArray, covariance: FloatArray
    ) -> None:
        """Record an output by the error of its angles, rad, shape (3,), and their covariance, rad², shape (3, 3)."""
        self.seconds += 1
        self.nees = float(normalized_error_squared(error, covariance))
        valid, level = status is Status.VALID, report.level
        if since_s >= SETTLED_S:
            self.settled += 1
            self.available += valid and bool(np.all(level <= self.limit))
            self.squares += error**2
            self.worst_level = max(self.worst_level, *np.nan_to_num(level).tolist())
        if valid:
            sigma = np.sqrt(np.diagonal(covariance))
            # An error of NaN counts as beyond five sigmas and beyond the protection level.
            self.beyond_sigmas += not np.all(np.abs(error) <= BEYOND_SIGMAS * sigma)
            if np.all(np.isfinite(level)):
                over = float(np.max(np.abs(error) / level))
                self.beyond_level += not over <= 1.0
                self.worst_over_level = max(self.worst_over_level, over)


def run_clean_voyage(voyage: CleanVoyage, folder: Path, length_s: float) -> Result:
    """Run a voyage; return its statistics as plain data, with angles in arcsec."""
    start_s, result = time.process_time(), dataclasses.asdict(voyage)
    result["voyage"] = result.pop("number")
    result |= {"length_s": length_s, "exception": ""}
    try:
        run = simulate(scenario_of(voyage, folder, length_s), voyage.number)
        statistics = VoyageStatistics(ALERT_LIMIT_ARCSEC.get(voyage.kind, np.inf) * ARCSEC)
        (_run_theodolite if voyage.kind == THEODOLITE else _run_ship)(run, statistics)
        fields = {name: value for name, value in vars(statistics).items() if name[0] != "_" and name != "limit"}
        result |= fields | {
            "squares": (statistics.squares / ARCSEC**2).tolist(),
            "worst_level": statistics.worst_level / ARCSEC,
        }
    except Exception:
        # A software defect is recorded, and the other voyages continue.
        result["exception"] = traceback.format_exc(limit=-4)
    return result | {"cpu_s": round(time.process_time() - start_s, 2)}


def _run_ship(run: SimulatedRun, statistics: VoyageStatistics) -> None:
    core = core_for(run.scenario)
    rows = {int(run.ins.time_ns[index]): row for row, index in enumerate(run.truth.ins_index)}
    for outcome in attitude_outcomes(core, run, _stamps_each_second(run, rows)):
        if outcome.decisions:
            since_s = (outcome.decisions[-1].measurement.time_ns - run.start_ns) / SECOND_NS
            statistics.record_exclusions(since_s, frozenset(core.state.excluded))
            if core.state.unresolved_fault is not None:
                statistics.record_status(since_s, Status.DEGRADED, core.state.unresolved_fault.text)
        for estimate in outcome.estimates:
            truth_nd = run.truth.rotation_nd[rows[estimate.time_ns]]
            _record_output(
                statistics, run, estimate, core.integrity(estimate), estimate.rotation_nd, truth_nd, cos_elevation=False
            )


def _stamps_each_second(run: SimulatedRun, rows: dict[int, int]) -> set[int]:
    """Return the stamps (of INS samples or encoder readings) of the outputs to evaluate: the first of each second."""
    first: dict[int, int] = {}
    for time_ns in sorted(rows):
        first.setdefault((time_ns - run.start_ns) // SECOND_NS, time_ns)
    return set(first.values())


def _run_theodolite(run: SimulatedRun, statistics: VoyageStatistics) -> None:
    core = pointing_core_for(run.scenario)
    theodolite = theodolite_of(run)
    truth, encoder_ns = theodolite.truth, theodolite.encoder.time_ns
    rows = {int(encoder_ns[index]): row for row, index in enumerate(truth.encoder_index)}
    wanted = _stamps_each_second(run, rows)
    for outcome in pointing_outcomes(core, run):
        if outcome.decisions:
            since_s = (outcome.decisions[-1].measurement.time_ns - run.start_ns) / SECOND_NS
            statistics.record_exclusions(since_s, frozenset(core.state.fault_state.excluded))
        for estimate in outcome.estimates:
            if estimate.time_ns in wanted and estimate.status is not Status.INVALID:
                truth_nm = truth.mount.rotation_nm[rows[estimate.time_ns]]
                report = core.integrity(estimate)
                _record_output(statistics, run, estimate, report, estimate.rotation_nm, truth_nm, cos_elevation=True)


def _record_output(
    statistics: VoyageStatistics,
    run: SimulatedRun,
    estimate: AttitudeEstimate | PointingEstimate,
    report: IntegrityReport,
    rotation: FloatArray,
    truth: FloatArray,
    cos_elevation: bool,
) -> None:
    """Compare an output with the truth, in the angles to which the protection levels refer."""
    since_s = (estimate.time_ns - run.start_ns) / SECOND_NS
    first, second, _ = angles_from_rotation(rotation)
    to_angles = angle_errors_from_rotation_vector(first, second)
    if cos_elevation:
        to_angles[0] *= np.cos(second)
    error = to_angles @ log_rotation(truth @ rotation.T)
    statistics.record_status(since_s, estimate.status, estimate.text)
    statistics.record_output(since_s, estimate.status, report, error, to_angles @ estimate.covariance_n @ to_angles.T)


def by_kind(results: list[Result]) -> Iterator[tuple[str, list[Result]]]:
    """Yield each kind that has results, with these results."""
    for kind in (TWO, THREE, THEODOLITE):
        if found := [result for result in results if result["kind"] == kind]:
            yield kind, found

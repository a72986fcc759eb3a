"""Simulated records of stars and an INS, as input of ``identify_noise``, without a bag."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.parameters.schema import build
from ship_geometry.rotations import ARCSEC
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion
from ship_simulation.scenario.scenario import Ins, Position, Scenario, StarSensor
from ship_simulation.suite_file import suite_configuration
from ship_studies.ins_noise.session import NoiseSession, StarComparisons, noise_session, session_config
from ship_testing.trials.monte_carlo import attitude_outcomes

STILL = CarrierMotion(
    kind="sinusoids", heading=AngleMotion(mean_deg=5.0), pitch=AngleMotion(mean_deg=0.5), roll=AngleMotion(mean_deg=2.0)
)


def scenario(duration_s: float, rate_hz: float = 0.1, star: dict[str, Any] | None = None, **ins: Any) -> Scenario:
    """Return a scenario: two star sensors 90° apart in azimuth, a constant attitude, all devices at one rate."""
    mounted = {"elevation_deg": 45.0, "rate_hz": rate_hz} | (star or {})
    return Scenario(
        carrier=STILL,
        start_utc="2026-01-15T20:00:00Z",
        duration_s=duration_s,
        ins=Ins(**({"rate_hz": rate_hz, "time_offset_sigma_s": 0.0} | ins)),
        star_sensors={
            "fore": StarSensor(azimuth_deg=0.0, **mounted),
            "starboard": StarSensor(azimuth_deg=90.0, **mounted),
        },
        position=Position(latitude_deg=40.0, longitude_deg=-40.0, speed_m_per_s=8.0, course_deg=5.0, rate_hz=rate_hz),
    )


class _WithFixes:
    """Run with position fixes although its suite does not need them."""

    def __init__(self, run: SimulatedRun) -> None:
        self._run = run

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def arrivals(self) -> list[tuple[int, str, int]]:
        others = [arrival for arrival in self._run.arrivals() if arrival[1] != "fix"]
        fixes = [(int(time_ns), "fix", row) for row, time_ns in enumerate(self._run.fixes.log_time_ns)]
        return sorted([*others, *fixes], key=lambda arrival: arrival[0])


def simulated_noise_session(
    of: Scenario, seed: int, ins_changes: dict[str, Any] | None = None, with_fixes: bool = True
) -> NoiseSession:
    """Return the session of a simulated voyage.

    Args:
        of: scenario of the voyage.
        seed: seed of the random numbers.
        ins_changes: changed parameters of ``ins`` in the suite.
        with_fixes: True to use position fixes although the suite does not need them.
    """
    suite = suite_configuration(of)
    thin = {"max_gap_s": 1.5 / of.ins.rate_hz, "silence_s": 20.0}
    config = build(ShipAttitudeConfig, {**suite, "ins": {**suite["ins"], **thin, **(ins_changes or {})}})
    core, pairs, run = ShipAttitudeCore(session_config(config)), StarComparisons(), simulate(of, seed)
    source: Any = _WithFixes(run) if with_fixes else run
    for outcome in attitude_outcomes(core, source, set()):
        for decision in outcome.decisions:
            pairs.add_decision(core, decision)
    return noise_session("voyage", config, core, pairs, [])


class GaussMarkovProcess(NamedTuple):
    """Gauss-Markov INS: sigmas in arcseconds, correlation times in seconds."""

    tilt_arcsec: float
    tilt_s: float
    heading_arcsec: float
    heading_s: float
    white_arcsec: float


def draw_session(session: NoiseSession, seed: int, process: GaussMarkovProcess) -> NoiseSession:
    """Return the session with new values drawn by its model: a Gauss-Markov INS, installations, noise."""
    rng = np.random.default_rng(seed)
    model = session.model
    steady = np.array([process.tilt_arcsec, process.heading_arcsec, process.tilt_arcsec]) * ARCSEC
    time_s = np.array([process.tilt_s, process.heading_s, process.tilt_s])
    installed = {id_: rng.standard_normal(3) for id_ in ("star.fore", "star.starboard")}
    slow, white, last_ns, pairs = steady * rng.standard_normal(3), np.zeros(3), None, []
    for pair in session.comparisons:
        if pair.time_ns != last_ns:
            decay = np.exp(-((pair.time_ns - (last_ns or pair.time_ns)) * 1e-9) / time_s)
            slow = decay * slow + steady * np.sqrt(1.0 - decay**2) * rng.standard_normal(3)
            white, last_ns = process.white_arcsec * ARCSEC * rng.standard_normal(3), pair.time_ns
        state = np.zeros(model.size)
        state[model.slices["ins.attitude"]], state[model.slices["ins.noise"]] = slow, white
        name = f"{pair.source}.installation"
        state[model.slices[name]] = installed[pair.source] * model.blocks[name].sigma
        noise = np.linalg.cholesky(pair.noise) @ rng.standard_normal(3)
        pairs.append(pair._replace(value=pair.jacobian @ state + noise))
    return replace(session, comparisons=pairs)

"""Share of exposures with attitude errors below a limit: joint solution and the methods that [P15] replaces.

Exposures of the scenario ``paper_stars``: two sensors 90° apart in azimuth under the real sky, each centroid with 3″ of
noise, the ship at any roll and heading, in any night of 2014. Errors of mounting, air, UT1, place, catalogue and INS
are drawn for each exposure. Every method gets the same stars.

Clouds are a Gaussian random field over the sky, with correlation exp(-θ²/2ℓ²) at an angle θ. A star is hidden where
the field is below its quantile of the cover, so with a probability equal to the cover for any ℓ. With ℓ = 0 stars
vanish independently, with ℓ as large as a field of view (10°) they vanish in patches.
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone

import numpy as np
from scipy.stats import chi2, norm

from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import solve_deck, solve_exposure
from ship_estimation.innovations.gates import normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_geometry.air.refraction import Weather
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation, wrap_pi
from ship_simulation.run import SKY_SOURCES, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import star_attitude_configuration
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.attitude_from_stars.solution import SolutionStatus, StarSolution
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_testing import pan_peers
from ship_testing.pan_peers import ErfaSky, SensorView
from ship_testing.paper_stars import PAPER_STARS, with_exact_optics
from ship_testing.trials.monte_carlo import sky_input, star_exposure

LIMIT_ARCSEC = 5.0
"""Limit of the errors of heading, pitch and roll of an available attitude."""

BEYOND_PROBABILITY = 1e-3
"""Probability of an error beyond a consistent covariance: normalised error squared 16.3, three degrees of freedom."""

CLEAR_STARS = 8
COUNTS = (*((n, n) for n in range(1, CLEAR_STARS + 1)), (2, 1), (5, 3), (8, 2))
"""Stars of the first sensor and of the second; 5 and 3 are those of [P15]'s exposure."""

COVERS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9)
PATCHES_DEG = (0.0, 10.0)

_FIRST_SEED = 15_000
_INS_SIGMA = np.array([10.0, 72.0, 10.0]) * ARCSEC
"""Standard deviations of the INS about North, Up, East: models.md §2."""
_FAINT = 7.0
"""Magnitude limit with which every field of the sky has eight stars."""

STARS_VALID, WITH_INS, ANY = "star vectors, VALID", "star vectors with INS, VALID", "star vectors, any"
BORESIGHTS, ITERATED, ONE = "two boresights [6]", "[5] and [6]", "[5], one sensor"
BORESIGHTS_OF_TWO = "two boresights, 2 stars suffice"
METHODS = (ANY, STARS_VALID, WITH_INS, BORESIGHTS, ITERATED, ONE, BORESIGHTS_OF_TWO)


@dataclass(frozen=True)
class Scene:
    """One exposure of all sensors.

    Attributes:
        exposures: by sensor, eight stars each.
        config: of ``star_attitude``.
        sky_model: sky model of the configuration.
        erfa_sky: sky by ERFA from the ship's input of time, place and air.
        rotation_nd: true attitude, shape (3, 3).
        ins: attitude of the deck by the INS.
        order: random order of each sensor's stars, for cases with only the first of them.
        clouds: one standard normal number per star, sensor by sensor.
    """

    exposures: dict[str, StarExposure]
    config: StarAttitudeConfig
    sky_model: SkyModel
    erfa_sky: ErfaSky
    rotation_nd: FloatArray
    ins: StarPrior
    order: dict[str, np.ndarray]
    clouds: FloatArray


@dataclass(frozen=True)
class Attitude:
    """Result of a method: horizon from deck, and its covariance if the method has one."""

    rotation_nd: FloatArray
    covariance_n: FloatArray | None = None


Method = Callable[[Scene, Mapping[str, np.ndarray]], Attitude | None]
Results = dict[tuple[str, str], FloatArray]
"""(case, method) → worst of the three angles' errors in arcsec, NaN without an attitude, and normalised error squared.

The shape is (exposures, 2).
"""


def draw_scene(seed: int) -> Scene:
    """Return the exposure of a seed."""
    rng = np.random.default_rng(seed)
    scenario = _scenario(rng)
    run = simulate(scenario, seed)
    config = build(StarAttitudeConfig, star_attitude_configuration(scenario))
    sky_model = load_sky_model(config.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            sky_model.surroundings.insert(sky_input(run, source, index))
    exposures = {id_: star_exposure(run, id_, 0) for id_ in run.stars}
    if any(len(exposure) < CLEAR_STARS for exposure in exposures.values()):
        raise ValueError(f"seed {seed}: a field with fewer than {CLEAR_STARS} stars")
    air = scenario.weather
    weather = Weather(air.pressure_hpa, air.temperature_c, 0.01 * air.humidity_percent)
    rotation_nd = run.truth.rotation_nd[0]
    ins_nd = exp_rotation(-_INS_SIGMA * rng.standard_normal(3)) @ rotation_nd
    return Scene(
        exposures=exposures,
        config=config,
        sky_model=sky_model,
        erfa_sky=ErfaSky(run.start_ns, run.fixes.position(0), weather),
        rotation_nd=rotation_nd,
        ins=StarPrior(ins_nd, np.diag(_INS_SIGMA**2)),
        order={id_: rng.permutation(len(exposure)) for id_, exposure in exposures.items()},
        clouds=rng.standard_normal(sum(map(len, exposures.values()))),
    )


def _scenario(rng: np.random.Generator) -> Scenario:
    """Return ``paper_stars`` for a second of a random night, at a random heading, with one exposure of each sensor."""
    whole = _whole_scenario()
    midnight = datetime(2014, 1, 1, 16, tzinfo=timezone.utc) + timedelta(days=int(rng.integers(365)))
    start = midnight + timedelta(seconds=float(rng.uniform(-7200.0, 7200.0)))
    carrier = whole.carrier
    heading = replace(carrier.heading, mean_deg=float(rng.uniform(0.0, 360.0)))
    moved = {name: with_random_phase(getattr(carrier, name), rng) for name in ("pitch", "roll")}
    sensors = {
        id_: replace(sensor, rate_hz=1.0, magnitude_limit=_FAINT, most_stars=CLEAR_STARS)
        for id_, sensor in whole.star_sensors.items()
    }
    return replace(
        whole,
        start_utc=start.isoformat(timespec="seconds").replace("+00:00", "Z"),
        duration_s=1.0,
        carrier=replace(carrier, heading=heading, **moved),
        ins=replace(whole.ins, rate_hz=1.0),
        star_sensors=sensors,
    )


def with_random_phase(motion, rng: np.random.Generator):
    phase_rad = float(rng.uniform(-np.pi, np.pi))
    return replace(motion, waves={name: replace(wave, phase_rad=phase_rad) for name, wave in motion.waves.items()})


@functools.cache
def _whole_scenario() -> Scenario:
    return with_exact_optics(load_scenario(PAPER_STARS))


# -- which stars are seen -------------------------------------------------------------------------------------


def some_stars(scene: Scene, counts: Sequence[int]) -> dict[str, np.ndarray]:
    """Return for each sensor the indices of a given number of stars, the first in the scene's random order."""
    return {id_: np.sort(scene.order[id_][:count]) for id_, count in zip(scene.exposures, counts, strict=True)}


def stars_in_gaps(scene: Scene, cover: float, patch_deg: float) -> dict[str, np.ndarray]:
    """Return the indices of the stars that no cloud hides, by sensor."""
    directions_d = np.concatenate(
        [one.directions_s @ scene.config.star_sensors[id_].rotation_ds.T for id_, one in scene.exposures.items()]
    )
    hidden = norm.cdf(_correlated_numbers(scene.clouds, directions_d, np.deg2rad(patch_deg))) < cover
    seen, first = {}, 0
    for id_, exposure in scene.exposures.items():
        seen[id_] = np.flatnonzero(~hidden[first : first + len(exposure)])
        first += len(exposure)
    return seen


def _correlated_numbers(white: FloatArray, directions: FloatArray, length: float) -> FloatArray:
    """Return standard normal numbers correlated by the places of the stars; ``white`` if the length is 0."""
    if not length:
        return white
    cosine = np.clip(directions @ directions.T, -1.0, 1.0)
    # The correlation uses the chord instead of the angle, so that it is positive definite on a sphere. At 10° the two
    # differ by 0.1 %.
    correlation = np.exp(-(1.0 - cosine) / length**2)
    values, vectors = np.linalg.eigh(correlation)
    return vectors @ (np.sqrt(np.maximum(values, 0.0)) * white)


# -- methods ---------------------------------------------------------------------------------------------------


def joint_solution(scene: Scene, rows: Mapping[str, np.ndarray], with_ins: bool) -> StarSolution:
    """Return the solution of these stars that ``star_attitude`` publishes as ``star/joint/solution``."""
    sensors, group = scene.config.star_sensors, []
    for id_, exposure in scene.exposures.items():
        prior = None
        if with_ins:
            rotation_ns = scene.ins.rotation_nb @ sensors[id_].rotation_ds
            mounting_n = rotation_ns * sensors[id_].installation_sigma_s
            prior = StarPrior(rotation_ns, scene.ins.covariance_n + mounting_n @ mounting_n.T)
        placed, _ = solve_exposure(exposure[rows[id_]], (), prior, scene.sky_model)
        group.append(replace(placed, rotation_ds=sensors[id_].rotation_ds))
    at_once = np.zeros((len(group), 3, len(group), 3))
    return solve_deck(group[0].time_ns, group, at_once, sensors, scene.ins if with_ins else None).solution


def _star_vectors(with_ins: bool, accepted_statuses: Sequence[SolutionStatus]) -> Method:
    def method(scene: Scene, rows: Mapping[str, np.ndarray]) -> Attitude | None:
        solution = joint_solution(scene, rows, with_ins)
        return Attitude(solution.rotation_nb, solution.covariance_n) if solution.status in accepted_statuses else None

    return method


def views(scene: Scene, rows: Mapping[str, np.ndarray]) -> list[SensorView]:
    """Return the same stars as input of the peers."""
    found = []
    for id_, exposure in scene.exposures.items():
        kept = exposure[rows[id_]]
        found.append(SensorView(kept.directions_s, kept.positions, scene.config.star_sensors[id_].rotation_ds))
    return found


def _peer(solve: Callable[[list[SensorView], ErfaSky], FloatArray | None]) -> Method:
    def method(scene: Scene, rows: Mapping[str, np.ndarray]) -> Attitude | None:
        rotation_nd = solve(views(scene, rows), scene.erfa_sky)
        return None if rotation_nd is None else Attitude(rotation_nd)

    return method


def _one_sensor(seen: list[SensorView], sky: ErfaSky) -> FloatArray | None:
    """Return horizon from deck by the attitude of the first sensor alone."""
    found = pan_peers.refraction_on_observed(seen[0], sky)
    return None if found is None else found[0] @ seen[0].rotation_ds.T


def _boresights_of_two(seen: list[SensorView], sky: ErfaSky) -> FloatArray | None:
    return pan_peers.two_boresights(seen, sky, fewest=pan_peers.MIN_STARS_BY_GEOMETRY)


_SOLVED = (SolutionStatus.VALID, SolutionStatus.UNVERIFIED)
_BY_NAME: dict[str, Method] = {
    ANY: _star_vectors(False, _SOLVED),
    STARS_VALID: _star_vectors(False, _SOLVED[:1]),
    WITH_INS: _star_vectors(True, _SOLVED[:1]),
    BORESIGHTS: _peer(pan_peers.two_boresights),
    ITERATED: _peer(pan_peers.two_boresights_by_iteration),
    ONE: _peer(_one_sensor),
    BORESIGHTS_OF_TWO: _peer(_boresights_of_two),
}


# -- the study -------------------------------------------------------------------------------------------------


def count_case(counts: Sequence[int]) -> str:
    """Return the name of the case with this many stars in each sensor."""
    return " + ".join(map(str, counts))


def cloud_case(cover: float, patch_deg: float) -> str:
    """Return the name of the case with this cloud cover, in patches of that size."""
    return f"{cover:.0%} cloud, " + (f"patches of {patch_deg:g}°" if patch_deg else "star by star")


def study(exposures: Iterable[int]) -> Results:
    """Run all methods in all cases, for the exposures of these numbers."""
    collected: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for number in exposures:
        scene = draw_scene(_FIRST_SEED + number)
        cases = {count_case(counts): some_stars(scene, counts) for counts in COUNTS}
        cases |= {
            cloud_case(cover, patch): stars_in_gaps(scene, cover, patch) for patch in PATCHES_DEG for cover in COVERS
        }
        for case, rows in cases.items():
            for name, method in _BY_NAME.items():
                collected.setdefault((case, name), []).append(error_and_nees(scene, method(scene, rows)))
    return {key: np.array(values) for key, values in collected.items()}


def error_and_nees(scene: Scene, found: Attitude | None) -> tuple[float, float]:
    if found is None:
        return float("nan"), float("nan")
    differences = wrap_pi(angles_from_rotation(found.rotation_nd) - angles_from_rotation(scene.rotation_nd))
    worst_arcsec = float(np.max(np.abs(differences))) / ARCSEC
    if found.covariance_n is None:
        return worst_arcsec, float("nan")
    error_n = log_rotation(scene.rotation_nd @ found.rotation_nd.T)
    return worst_arcsec, float(normalized_error_squared(error_n, found.covariance_n))


def solved_share(results: FloatArray) -> float:
    """Return the share of the exposures with an attitude."""
    return float(np.mean(np.isfinite(results[:, 0])))


def availability(results: FloatArray, limit_arcsec: float = LIMIT_ARCSEC) -> float:
    """Return the share of the exposures with an attitude better than the limit."""
    return float(np.mean(results[:, 0] < limit_arcsec))


def count_beyond_covariance(results: FloatArray) -> int:
    """Return the number of attitudes with an error beyond their covariance, one in a thousand if it is consistent."""
    return int(np.sum(results[:, 1] > chi2.isf(BEYOND_PROBABILITY, 3)))

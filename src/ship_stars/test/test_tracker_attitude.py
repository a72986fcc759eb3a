"""A star tracker that computes its attitude through the air, with real stars and ERFA's own refraction."""

from dataclasses import replace

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.time_scales import julian_date, tt_julian_date
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_stars.attitude_samples import AttitudeMeasurement, FieldOfView, InertialAttitude
from ship_stars.sky.tracker_attitude import to_horizon_attitude
from ship_testing.star_sky import POSITION, TIME_NS, configuration, ins_track, sky_at_anchor

FIELD = FieldOfView(np.deg2rad(10.0))
POINT = FieldOfView()
NOISE_S = np.diag((np.array([15.0, 2.0, 2.0]) * ARCSEC) ** 2)
SCENES = 300
SECOND_NS = 1_000_000_000

CONFIG = configuration(sky={"pressure_hpa": 1008.3, "temperature_c": 18.2, "relative_humidity": 0.6})


@pytest.fixture(scope="module", name="sky_model")
def _sky_model():
    return sky_at_anchor(CONFIG)


@pytest.fixture(scope="module", name="sky")
def _sky(sky_model):
    """Return apparent directions from the ship, and catalogue directions without and with aberration, (k, 3) each.

    The stars are brighter than 5.2. Apparent directions are by ERFA's ``atco13``, catalogue directions by ``pmpx``,
    aberration by ``ab``.
    """
    catalogue = sky_model.catalogue
    stars = catalogue.at_j2000[catalogue.rows_brighter_than(5.2)]
    orientation = earth_orientation_table().at(TIME_NS)
    utc, tt, air = julian_date(TIME_NS), tt_julian_date(TIME_NS), CONFIG.sky
    azimuth, zenith_distance, *_ = erfa.atco13(
        stars.right_ascension, stars.declination, stars.pm_right_ascension, stars.pm_declination,
        stars.parallax_arcsec, 0.0, *utc, orientation.ut1_minus_utc_s,
        POSITION.longitude, POSITION.latitude, POSITION.height_m, orientation.pole_x, orientation.pole_y,
        air.pressure_hpa, air.temperature_c, air.relative_humidity, air.wavelength_um,
    )  # fmt: skip
    horizontal = np.sin(zenith_distance)
    seen_n = np.stack([np.cos(azimuth) * horizontal, np.cos(zenith_distance), np.sin(azimuth) * horizontal], axis=-1)
    heliocentric, barycentric = erfa.epv00(*tt)
    natural_c = erfa.pmpx(
        stars.right_ascension, stars.declination, stars.pm_right_ascension, stars.pm_declination,
        stars.parallax_arcsec, 0.0, (tt[0] - 2451545.0 + tt[1]) / 365.25, barycentric["p"],
    )  # fmt: skip
    beta = barycentric["v"] * (149597870700.0 / 86400.0 / 299792458.0)
    distance = np.linalg.norm(heliocentric["p"])
    proper_c = erfa.ab(natural_c, beta, distance, np.sqrt(1.0 - beta @ beta))
    return seen_n, natural_c, proper_c


def scenes(elevations_deg: tuple[float, float], count: int = SCENES):
    """Yield attitudes of the tracker, horizon from sensor, each with a generator for its noise."""
    for seed in range(count):
        rng = np.random.default_rng([28, seed])
        angles_deg = rng.uniform(0.0, 360.0), rng.uniform(*elevations_deg), rng.uniform(-180.0, 180.0)
        yield rotation_from_angles(*np.deg2rad(angles_deg)), rng


def solve_attitude(
    seen_n: FloatArray, catalogue_c: FloatArray, rotation_ns: FloatArray, most: int
) -> FloatArray | None:
    """Return "ICRS from sensor" as a tracker computes it from the first stars in its field."""
    seen_s = seen_n @ rotation_ns
    inside = np.flatnonzero(seen_s[:, 0] > np.cos(FIELD.radius))[:most]
    if len(inside) < 3:
        return None
    return Rotation.align_vectors(catalogue_c[inside], seen_s[inside])[0].as_matrix()


def nees(
    sky_model, sky, elevations_deg, field: FieldOfView, most: int = 5, aberration_removed: bool = True
) -> list[float]:
    seen_n, natural_c, proper_c = sky
    field = replace(field, aberration_removed=aberration_removed)
    found = []
    for rotation_ns, rng in scenes(elevations_deg):
        # Random stars, not always the brightest.
        order = rng.permutation(len(seen_n))
        catalogue_c = proper_c if aberration_removed else natural_c
        rotation_cs = solve_attitude(seen_n[order], catalogue_c[order], rotation_ns, most)
        if rotation_cs is None:
            continue
        noisy_cs = rotation_cs @ exp_rotation(np.sqrt(np.diagonal(NOISE_S)) * rng.standard_normal(3))
        attitude = to_horizon_attitude(
            InertialAttitude("star.fore", TIME_NS, noisy_cs, NOISE_S, field=field), sky_model
        )
        assert isinstance(attitude, AttitudeMeasurement)
        error_n = log_rotation(rotation_ns @ attitude.rotation_nv.T)
        noise_n = rotation_ns @ NOISE_S @ rotation_ns.T
        found.append(float(normalized_error_squared(error_n, noise_n + attitude.common_n)))
    assert len(found) > 0.7 * SCENES
    return found


@pytest.mark.parametrize("elevations_deg", [(25.0, 45.0), (45.0, 80.0)])
@pytest.mark.parametrize("aberration_removed", [True, False])
def test_refraction_over_the_field_is_in_the_covariance(sky_model, sky, elevations_deg, aberration_removed) -> None:
    values = nees(sky_model, sky, elevations_deg, FIELD, aberration_removed=aberration_removed)
    low, high = mean_nees_band(len(values), 3)
    print(f"elevation {elevations_deg}: mean NEES {np.mean(values):.2f} in [{low:.2f}, {high:.2f}]")
    assert low < np.mean(values) < high


def test_without_the_field_the_covariance_is_too_small(sky_model, sky) -> None:
    values = nees(sky_model, sky, (25.0, 45.0), POINT)
    print(f"mean NEES {np.mean(values):.2f}")
    assert np.mean(values) > 2.0 * mean_nees_band(len(values), 3)[1]


def test_with_more_stars_the_covariance_is_conservative(sky_model, sky) -> None:
    assert np.mean(nees(sky_model, sky, (30.0, 60.0), FIELD, most=20)) < 3.0


def test_uncorrected_aberration_is_corrected_once(sky_model, sky) -> None:
    """Only the lift by refraction and the shift by aberration at the boresight remain with very many stars."""
    seen_n, natural_c, proper_c = sky
    off = {}
    for removed, catalogue_c in ((True, proper_c), (False, natural_c)):
        for stated in (True, False):
            errors = []
            for rotation_ns, _ in scenes((60.0, 85.0), 20):
                rotation_cs = solve_attitude(seen_n, catalogue_c, rotation_ns, 1000)
                inertial = InertialAttitude(
                    "star.fore", TIME_NS, rotation_cs, NOISE_S, field=replace(FIELD, aberration_removed=stated)
                )
                attitude = to_horizon_attitude(inertial, sky_model)
                errors.append(np.linalg.norm(log_rotation(rotation_ns @ attitude.rotation_nv.T)[:3]))
            off[removed, stated] = np.median(errors) / ARCSEC
    assert max(off[True, True], off[False, False]) < 5.0
    assert min(off[True, False], off[False, True]) > 8.0


def test_the_filter_models_it_as_a_correlated_error(sky_model) -> None:
    """The residual of refraction in repeated attitudes of the tracker does not average."""
    config = configuration()
    exact = {f"installation_sigma_{axis}_arcsec": 0.0 for axis in ("forward", "up", "right")}
    sensors = {id_: replace(sensor, input="inertial_attitude", **exact) for id_, sensor in config.star_sensors.items()}
    ship_filter = ShipFilter(replace(config, star_sensors=sensors))
    rotation_ns = ins_track().at(TIME_NS).rotation_nd @ ship_filter.devices["star.fore"].rotation_dv0
    sigmas = {}
    for field in (FIELD, POINT):
        state = ship_filter.initial_state()
        for second in range(1, 40):
            time_ns = TIME_NS + second * SECOND_NS
            bare_cs = sky_model.sky_at(time_ns).rotation_horizon_from_icrs().T @ rotation_ns
            inertial = InertialAttitude("star.fore", time_ns, bare_cs, NOISE_S, field=field)
            lifted_ns = to_horizon_attitude(inertial, sky_model).rotation_nv
            inertial = replace(inertial, rotation_cs=bare_cs @ lifted_ns.T @ rotation_ns)
            state, decision = ship_filter.step(state, inertial, ins_track(time_ns), sky_model)
            assert decision.accepted
        rows = ship_filter.model.state_indices("ins.attitude")
        sigmas[field] = np.sqrt(np.trace(state.covariance[np.ix_(rows, rows)])) / ARCSEC
    attitude = to_horizon_attitude(replace(inertial, field=FIELD), sky_model)
    assert sigmas[FIELD] > 0.7 * np.sqrt(np.trace(attitude.common_n)) / ARCSEC
    assert sigmas[FIELD] > 2.0 * sigmas[POINT]


@pytest.mark.parametrize("elevation_deg", [88.0, 89.999, 90.0])
def test_the_field_covariance_is_regular_at_the_zenith(sky_model, elevation_deg: float) -> None:
    rotation_ns = rotation_from_angles(0.3, np.deg2rad(elevation_deg), 0.2)
    rotation_cs = sky_model.sky_at(TIME_NS).rotation_horizon_from_icrs().T @ rotation_ns
    attitude = to_horizon_attitude(InertialAttitude("star.fore", TIME_NS, rotation_cs, NOISE_S, field=FIELD), sky_model)
    common_s = rotation_ns.T @ attitude.common_n @ rotation_ns
    # Refraction at the zenith is an isotropic compression without rotation: 57″ per radian times 10°/(2 √5).
    assert np.sqrt(np.diagonal(common_s)[1:]) / ARCSEC == pytest.approx([2.2, 2.2], abs=0.15)
    assert np.sqrt(max(common_s[0, 0], 0.0)) < 0.1 * ARCSEC

"""Single stars and inertial attitudes of a simulated voyage: selection, position on the detector, identity."""

import dataclasses

import erfa
import numpy as np
import pytest
from scipy.stats import binom, chi2

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.air.refraction import refraction
from ship_geometry.earth.time_scales import SECOND_NS, julian_date
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, angle_between, exp_rotation, log_rotation
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.ship.motion import make_carrier
from ship_stars.sky.deck_masks import MaskConfig
from ship_testing.consistency import sigma_ratio_band
from ship_testing.paper_stars import paper_stars, with_position, with_sensor

MAS = 1e-3 * ARCSEC
FORE = "fore"
QUIET = {"centroid_sigma_px": 1e-6}
DISTORTED = {"distortion_k1": -0.4, "distortion_k2": 2.0, "distortion_p1": 1e-3, "distortion_p2": -2e-3}


def sightings_of(scenario, seed=1):
    """Return (sightings, truth, sky) of the only sensor."""
    run = simulate(scenario, seed)
    return run.stars[FORE], run.truth.sightings[FORE], run.truth.sky


def assert_sigma(values, sigma):
    low, high = sigma_ratio_band(np.size(values))
    assert low < np.sqrt(np.mean(np.square(values))) / sigma < high


def share_band(count, share):
    """Return the 99.9 % band of the number of hits."""
    return binom.ppf([0.0005, 0.9995], count, share)


def by_atco13(sky, rows, time_ns):
    """Return observed star directions (N, U, E) with refraction, at one time or at one time per star."""
    stars, orientation, place = sky.positions[rows], sky.orientation(time_ns), sky.track.position_at(time_ns)
    air = sky.weather
    azimuth, zenith_distance, *_ = erfa.atco13(
        *(getattr(stars, name) for name in vars(stars)),
        0.0,
        *julian_date(time_ns),
        orientation.ut1_minus_utc_s,
        *(place.longitude, place.latitude, place.height_m),
        *(orientation.pole_x, orientation.pole_y),
        *(air.pressure_hpa, air.temperature_c, air.relative_humidity, 0.55),
    )
    sine = np.sin(zenith_distance)
    return np.stack([np.cos(azimuth) * sine, np.cos(zenith_distance), np.sin(azimuth) * sine], axis=-1)


def stars_by_exposure(sightings, truth):
    return [set(truth.hip[sightings.rows(number)].tolist()) for number in range(sightings.time_ns.size)]


@pytest.mark.parametrize("most_stars", [1000, 5])
def test_a_star_behind_a_mask_is_not_seen_and_the_next_brightest_is(most_stars):
    """The stars are those of the same voyage without the mast, except the stars in the mast's rectangle."""
    mast = MaskConfig(azimuths_deg=(340.0, 361.0, 361.0, 340.0), elevations_deg=(-5.0, -5.0, 47.0, 47.0))
    free = with_sensor(paper_stars(), most_stars=1000, camera=QUIET)
    sightings, truth, sky = sightings_of(free)
    masked = dataclasses.replace(free.star_sensors[FORE], most_stars=most_stars, masks={"mast": mast})
    masked_sightings, masked_truth, _ = sightings_of(dataclasses.replace(free, star_sensors={FORE: masked}))
    rotation_ds = rotation_from_angles(0.0, np.deg2rad(45.0), 0.0)
    bow, up, starboard = (truth.direction_s @ rotation_ds.T).T
    azimuth_deg = np.rad2deg(np.arctan2(starboard, bow))
    elevation_deg = np.rad2deg(np.arctan2(up, np.hypot(bow, starboard)))
    hidden = (azimuth_deg > -20.0) & (azimuth_deg < 1.0) & (elevation_deg < 47.0)
    assert 0.1 < hidden.mean() < 0.9
    magnitude = sky.catalogue.magnitude[sky.catalogue.rows(truth.hip)]
    for number, found in enumerate(stars_by_exposure(masked_sightings, masked_truth)):
        rows = np.arange(truth.hip.size)[sightings.rows(number)]
        seen = rows[~hidden[rows]]
        brightest = seen[np.argsort(magnitude[seen], kind="stable")][:most_stars]
        assert found == set(truth.hip[brightest].tolist())


def test_each_star_is_imaged_according_to_attitude_and_erfa():
    scenario = with_sensor(
        paper_stars(),
        time_offset_s=0.3,
        flexure_sigma_arcsec=50.0,
        installation_sigma_forward_arcsec=2000.0,
        camera={**QUIET, **DISTORTED},
    )
    run = simulate(scenario, seed=3)
    sightings, truth, sky = run.stars[FORE], run.truth.sightings[FORE], run.truth.sky
    mounted = run.truth.stars[FORE]
    nominal = rotation_from_angles(0.0, np.deg2rad(45.0), 0.0)
    np.testing.assert_allclose(mounted.rotation_dv, nominal @ exp_rotation(mounted.installation_error_v))
    times_s = (sightings.time_ns - run.start_ns) / SECOND_NS + 0.3
    stiff = make_carrier(scenario.carrier, 3).attitude(times_s) @ mounted.rotation_dv
    bend = log_rotation(np.swapaxes(truth.rotation_nv, -1, -2) @ stiff)
    assert 10.0 < np.sqrt(np.mean(bend**2)) / ARCSEC < 250.0
    exposure = np.repeat(np.arange(sightings.time_ns.size), np.diff(sightings.first))
    valid_ns = sightings.time_ns[exposure] + 300_000_000
    expected_n = by_atco13(sky, sky.catalogue.rows(truth.hip), valid_ns)
    # The centroid noise of a millionth of a pixel is 0.02 mas.
    seen_n = (truth.rotation_nv[exposure] @ sightings.stars.directions_s[..., None])[..., 0]
    assert np.max(angle_between(seen_n, expected_n)) < 0.3 * MAS
    assert len(sightings.stars) == 8 * sightings.time_ns.size


@pytest.mark.slow
def test_all_catalogue_stars_on_the_detector_are_present_and_no_others():
    scenario = with_sensor(paper_stars(duration_s=20.0), magnitude_limit=7.0, most_stars=1000, camera=QUIET)
    sightings, truth, sky = sightings_of(scenario)
    bright = np.flatnonzero(sky.catalogue.magnitude <= 7.0)
    assert 13_000 < bright.size < 15_000
    for index in (0, 37, 100):
        seen_n = by_atco13(sky, bright, sightings.time_ns[index])
        forward, up, right = (seen_n @ truth.rotation_nv[index]).T
        # 2048 pixels of 5.5 µm about the axis at 50 mm: a square of ±0.11264.
        half = 1024.0 * 5.5e-6 / 0.05
        inside = (forward > 0.0) & (np.abs(up) < half * forward) & (np.abs(right) < half * forward)
        expected = sky.catalogue.hip[bright[inside]]
        assert expected.size > 20
        assert sorted(truth.hip[sightings.rows(index)]) == sorted(expected)


def test_the_brightest_stars_are_selected():
    many, many_truth, sky = sightings_of(with_sensor(paper_stars(), most_stars=1000))
    few, few_truth, _ = sightings_of(with_sensor(paper_stars(), most_stars=5))
    magnitude = dict(zip(sky.catalogue.hip.tolist(), sky.catalogue.magnitude.tolist(), strict=True))
    for index in range(few.time_ns.size):
        by_brightness = sorted(many_truth.hip[many.rows(index)].tolist(), key=magnitude.get)
        assert set(few_truth.hip[few.rows(index)].tolist()) == set(by_brightness[:5])


def test_centroids_scatter_by_their_sigma_and_magnitudes_too():
    sightings, truth, sky = sightings_of(paper_stars_one(duration_s=60.0, camera=DISTORTED))
    camera = paper_stars_one(camera=DISTORTED).star_sensors[FORE].camera.camera("camera")
    error_px = sightings.pixel - camera.pixels(truth.direction_s)
    assert_sigma(error_px[:, 0], 0.13222)
    assert_sigma(error_px[:, 1], 0.13222)
    # The stated sigma is 3″ on the sky; the directions scatter by it, with two degrees of freedom each.
    assert sightings.stars.sigma == pytest.approx(np.full(len(sightings.stars), 3.0 * ARCSEC), rel=0.05)
    angle = angle_between(sightings.stars.directions_s, truth.direction_s)
    low, high = mean_nees_band(angle.size, 2)
    assert low < np.mean((angle / sightings.stars.sigma) ** 2) < high
    assert_sigma(sightings.stars.magnitude - sky.catalogue.magnitude[sky.catalogue.rows(truth.hip)], 0.2)


def paths_of(scenario, sightings, truth, count=200):
    """Return the true pixels of each star at ``count`` times of its exposure, shape (count, k, 2)."""
    sensor, carrier = scenario.star_sensors[FORE], make_carrier(scenario.carrier, 1)
    camera, first_ns = sensor.camera.camera("camera"), sightings.time_ns[0]
    exposure = np.repeat(np.arange(sightings.time_ns.size), np.diff(sightings.first))
    middle_s = (sightings.time_ns - first_ns)[exposure] / SECOND_NS
    mounting = carrier.attitude(np.zeros(1))[0].T @ truth.rotation_nv[0]
    place_n = (carrier.attitude(middle_s) @ mounting @ truth.direction_s[..., None])[..., 0]
    since_s = sensor.exposure_s * ((np.arange(count) + 0.5) / count - 0.5)
    seen = [np.einsum("kji,kj->ki", carrier.attitude(middle_s + t) @ mounting, place_n) for t in since_s]
    return camera.pixels(np.array(seen))


@pytest.mark.parametrize("exposure_s", [0.1, 2.0])
def test_a_simulated_centroid_is_the_mean_of_the_star_s_true_path(exposure_s):
    scenario = paper_stars_one(exposure_s=exposure_s, camera={**QUIET, **DISTORTED})
    sightings, truth, _ = sightings_of(scenario)
    way = paths_of(scenario, sightings, truth)
    off = np.abs(way.mean(axis=0) - way[100]).max()
    np.testing.assert_allclose(sightings.pixel, way.mean(axis=0), atol=max(2e-3, 1e-4 * off))
    # The points differ from those of an exposure time of zero.
    still, _, _ = sightings_of(paper_stars_one(camera={**QUIET, **DISTORTED}))
    assert np.max(np.abs(sightings.pixel - still.pixel)) > 0.05


def test_a_simulated_centroid_scatters_more_along_its_streak():
    scenario = paper_stars_one(duration_s=60.0, exposure_s=0.05)
    sightings, truth, _ = sightings_of(scenario)
    way = paths_of(scenario, sightings, truth, 20)
    streak = (way[-1] - way[0]) * 20.0 / 19.0
    length = np.linalg.norm(streak, axis=-1)
    along = streak / length[:, None]
    error_px = sightings.pixel - way.mean(axis=0)
    assert length.min() < 2.0 < 10.0 < length.max()
    assert_sigma(np.sum(error_px * along, axis=-1) / np.sqrt(1.0 + length**2 / (12.0 * 0.8**2)), 0.13222)
    assert_sigma(error_px[:, 0] * along[:, 1] - error_px[:, 1] * along[:, 0], 0.13222)


def paper_stars_one(duration_s=10.0, **changes):
    return with_sensor(paper_stars(duration_s=duration_s), **changes)


def test_identified_stars_have_their_number_and_catalogue_position():
    sightings, truth, sky = sightings_of(paper_stars_one())
    np.testing.assert_array_equal(sightings.stars.hip, truth.hip)
    rows = sky.catalogue.rows(sightings.stars.hip)
    np.testing.assert_array_equal(sightings.stars.positions.declination, sky.catalogue.at_j2000.declination[rows])
    np.testing.assert_allclose(
        sightings.stars.position_sigma, sky.catalogue.position_sigma_at(rows, 2014.52), rtol=1e-3
    )
    one = sightings.stars[sightings.rows(7)]
    assert len(one) == 8
    np.testing.assert_array_equal(one.directions_s, sightings.stars.directions_s[sightings.rows(7)])


def test_stars_may_be_identified_by_their_directions_or_not_at_all():
    by_direction, truth, sky = sightings_of(paper_stars_one(direction_given=True))
    assert not by_direction.stars.hip.any()
    known = sky.catalogue.at_j2000[sky.catalogue.rows(truth.hip)]
    published = by_direction.stars.positions
    separation = erfa.seps(known.right_ascension, known.declination, published.right_ascension, published.declination)
    # The reported direction contains the proper motion of fourteen years.
    assert np.all(separation < 40.0 * ARCSEC)
    assert np.max(separation) > 0.1 * ARCSEC
    assert not np.any(published.pm_declination)
    nameless, _, _ = sightings_of(paper_stars_one(identified=False))
    assert not nameless.stars.hip.any()
    assert not np.isfinite(nameless.stars.positions.right_ascension).any()
    np.testing.assert_array_equal(nameless.pixel, by_direction.pixel)


def test_false_stars_are_poisson_uniform_in_the_field_with_any_identity():
    scenario = paper_stars_one(duration_s=400.0, rate_hz=5.0, false_stars=2.0, most_stars=1)
    sightings, truth, sky = sightings_of(scenario)
    false = truth.hip == 0
    exposure = np.repeat(np.arange(sightings.time_ns.size), np.diff(sightings.first))
    counts = np.bincount(exposure[false], minlength=sightings.time_ns.size)
    # Variance and mean of a Poisson count are equal: both in their bands, 2001 exposures.
    assert abs(counts.mean() - 2.0) < 3.3 * np.sqrt(2.0 / counts.size)
    low, high = chi2.ppf([0.0005, 0.9995], counts.size - 1)
    assert low < np.sum((counts - counts.mean()) ** 2) / 2.0 < high
    cells = np.histogram2d(*sightings.pixel[false].T, bins=8, range=[[-0.5, 2047.5]] * 2)[0]
    expected = false.sum() / 64.0
    assert np.sum((cells - expected) ** 2) / expected < chi2.ppf(0.9995, 63)
    assert cells.sum() == false.sum()
    # False identities do not depend on the position: they are distributed as the catalogue's stars.
    rows = sky.catalogue.rows(sightings.stars.hip[false])
    bright = sky.catalogue.rows_brighter_than(6.0)
    north = np.mean(sky.catalogue.at_j2000.declination[bright] > 0.0)
    low, high = share_band(rows.size, north)
    assert low <= np.count_nonzero(sky.catalogue.at_j2000.declination[rows] > 0.0) <= high
    assert np.isin(rows, bright).all()
    assert np.unique(rows).size > 0.9 * bright.size * (1.0 - np.exp(-rows.size / bright.size))
    assert np.isnan(truth.direction_s[false]).all()


def test_false_stars_are_mixed_with_unchanged_true_ones():
    clean, clean_truth, _ = sightings_of(paper_stars_one())
    mixed, truth, _ = sightings_of(paper_stars_one(false_stars=3.0))
    true = truth.hip != 0
    np.testing.assert_array_equal(mixed.pixel[true], clean.pixel)
    np.testing.assert_array_equal(mixed.stars.magnitude[true], clean.stars.magnitude)
    np.testing.assert_array_equal(truth.hip[true], clean_truth.hip)
    exposure = np.repeat(np.arange(mixed.time_ns.size), np.diff(mixed.first))
    order = np.lexsort((mixed.pixel[:, 1], exposure))
    np.testing.assert_array_equal(order, np.arange(len(order)))


def test_swapped_identities_are_exchanged_within_their_exposure():
    sightings, truth, _ = sightings_of(paper_stars_one(duration_s=200.0, swapped_probability=0.3))
    swapped_exposures = 0
    for index in range(sightings.time_ns.size):
        rows = sightings.rows(index)
        wrong = sightings.stars.hip[rows] != truth.hip[rows]
        np.testing.assert_array_equal(wrong, truth.is_swapped[rows])
        assert wrong.sum() in (0, 2)
        assert sorted(sightings.stars.hip[rows]) == sorted(truth.hip[rows])
        swapped_exposures += bool(wrong.any())
    low, high = share_band(sightings.time_ns.size, 0.3)
    assert low <= swapped_exposures <= high


def test_two_sensors_see_one_sky_and_have_errors_of_their_own():
    run = simulate(paper_stars(), seed=1)
    alone = simulate(with_sensor(paper_stars()), seed=1)
    np.testing.assert_array_equal(alone.stars[FORE].pixel, run.stars[FORE].pixel)
    fore, starboard = run.truth.sightings[FORE], run.truth.sightings["starboard"]
    between = np.sum(fore.rotation_nv[:, :, 0] * starboard.rotation_nv[:, :, 0], axis=1)
    # Two axes 45° up, 90° apart in azimuth: cos = 1/2.
    np.testing.assert_allclose(between, 0.5, atol=1e-4)
    assert not set(fore.hip.tolist()) & set(starboard.hip.tolist())


def test_the_reference_case_shows_eight_stars_in_each_exposure():
    scenario = paper_stars(duration_s=600.0)
    seldom = {key: dataclasses.replace(sensor, rate_hz=0.7) for key, sensor in scenario.star_sensors.items()}
    run = simulate(dataclasses.replace(scenario, star_sensors=seldom), seed=1)
    for sightings in run.stars.values():
        assert set(np.diff(sightings.first).tolist()) == {8}


def test_clouds_and_daylight_leave_exposures_empty():
    cloudy, _, _ = sightings_of(paper_stars_one(outages={"cloud": Outage(2.0, 4.0)}, false_stars=1.0))
    since_start_s = (cloudy.time_ns - cloudy.time_ns[0]) / SECOND_NS
    inside = (since_start_s >= 2.0) & (since_start_s < 4.0)
    counts = np.diff(cloudy.first)
    assert not counts[inside].any()
    assert counts[~inside].min() >= 8
    # At dawn, exposures are empty from the time when the Sun reaches the limit.
    dawn = dataclasses.replace(paper_stars(duration_s=1200.0), start_utc="2014-07-09T20:10:00Z")
    sightings, _, sky = sightings_of(with_sensor(dawn, rate_hz=0.2, sun_limit_deg=-8.0))
    too_light = np.rad2deg(sky.sun_elevation(sightings.time_ns)) >= -8.0
    np.testing.assert_array_equal(np.diff(sightings.first) == 0, too_light)
    assert 20 < too_light.sum() < 220


def test_stars_below_the_models_lowest_elevation_are_not_seen():
    low_looking = with_sensor(paper_stars(), elevation_deg=10.0, magnitude_limit=7.5, most_stars=1000)
    elevation = {}
    for model in ("erfa", "almanac"):
        weather = dataclasses.replace(low_looking.weather, refraction_model=model)
        sightings, truth, _ = sightings_of(dataclasses.replace(low_looking, weather=weather))
        exposure = np.repeat(np.arange(sightings.time_ns.size), np.diff(sightings.first))
        up = (truth.rotation_nv[exposure] @ truth.direction_s[..., None])[:, 1, 0]
        elevation[model] = np.rad2deg(np.arcsin(up))
    # The limits are 5° and 14° without air; refraction there is 0.16° and 0.06°.
    assert 5.1 < elevation["erfa"].min() < 5.5
    assert 14.0 < elevation["almanac"].min() < 14.4


def test_the_same_seed_gives_the_same_stars_and_another_seed_others():
    scenario = paper_stars_one(false_stars=1.0, swapped_probability=0.5)
    first, again, other = (sightings_of(scenario, seed)[0] for seed in (5, 5, 6))
    assert first.pixel.tobytes() == again.pixel.tobytes()
    assert first.stars.positions.declination.tobytes() == again.stars.positions.declination.tobytes()
    for name in ("hip", "directions_s", "sigma", "position_sigma", "magnitude"):
        assert getattr(first.stars, name).tobytes() == getattr(again.stars, name).tobytes()
    assert first.pixel.shape != other.pixel.shape or np.any(first.pixel != other.pixel)


def test_the_boresight_of_an_inertial_attitude_is_without_aberration_and_with_refraction():
    scenario = inertial(sigma_forward_arcsec=0.0, sigma_up_arcsec=0.0, sigma_right_arcsec=0.0)
    scenario = with_position(scenario, speed_m_per_s=15.0)
    run = simulate(scenario, seed=2)
    sightings, sky = run.stars[FORE], run.truth.sky
    true_nv = make_carrier(scenario.carrier, 2).attitude((sightings.time_ns - run.start_ns) / SECOND_NS)
    true_nv = true_nv @ run.truth.stars[FORE].rotation_dv
    rotation_nc = sky.rotation_horizon_from_icrs(sightings.time_ns)
    bare_nv = rotation_nc @ sightings.rotation_cv
    elevation = np.arcsin(bare_nv[:, 1, 0])
    lifted = np.arcsin(true_nv[:, 1, 0]) - elevation
    np.testing.assert_allclose(lifted, refraction("erfa", elevation, sky.weather).angle, rtol=0.0, atol=0.1 * MAS)
    # The difference is only a rotation about the horizontal axis perpendicular to the boresight.
    turn_n = log_rotation(true_nv @ np.swapaxes(bare_nv, -1, -2))
    np.testing.assert_allclose(turn_n[:, 1], 0.0, atol=0.1 * MAS)
    np.testing.assert_allclose(np.sum(turn_n * true_nv[:, :, 0], axis=1), 0.0, atol=0.1 * MAS)


def test_noise_of_inertial_attitudes_belongs_to_their_axes():
    noisy, quiet = (
        simulate(inertial(120.0, sigma_forward_arcsec=f, sigma_up_arcsec=u, sigma_right_arcsec=r), seed=1).stars[FORE]
        for f, u, r in ((60.0, 4.0, 2.0), (0.0, 0.0, 0.0))
    )
    noise_v = log_rotation(np.swapaxes(quiet.rotation_cv, -1, -2) @ noisy.rotation_cv)
    for axis, sigma_arcsec in enumerate([60.0, 4.0, 2.0]):
        assert_sigma(noise_v[:, axis], sigma_arcsec * ARCSEC)
    np.testing.assert_allclose(noisy.noise_v, np.diag((np.array([60.0, 4.0, 2.0]) * ARCSEC) ** 2))


def test_clouds_daylight_and_the_horizon_leave_no_inertial_attitude():
    whole = simulate(inertial(), seed=1).stars[FORE]
    cloudy = simulate(inertial(outages={"cloud": Outage(2.0, 4.0)}), seed=1).stars[FORE]
    kept = np.isin(whole.time_ns, cloudy.time_ns)
    assert kept.sum() == kept.size - 10
    np.testing.assert_array_equal(cloudy.rotation_cv, whole.rotation_cv[kept])
    assert simulate(inertial(sun_limit_deg=-20.0), seed=1).stars[FORE].time_ns.size == 0
    # The ship's pitch moves a boresight of 5° elevation below the limit and back.
    low = simulate(with_sensor(inertial(20.0), elevation_deg=5.0), seed=1).stars[FORE]
    assert 10 < low.time_ns.size < 95


def inertial(duration_s=10.0, **changes):
    return with_sensor(paper_stars(duration_s=duration_s), output="inertial_attitude", **changes)

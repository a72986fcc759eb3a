"""Stars in cameras on the theodolite: images according to the true main axis and the true sky."""

import dataclasses

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.theodolite.run import draw_parallelism
from ship_testing.consistency import sigma_ratio_band
from ship_testing.paper_stars import with_exact_optics
from ship_testing.theodolite_scenes import SCENARIOS, replace_nested

STARS = "theodolite/night/stars"
FOCAL_LENGTH_M, PIXEL_PITCH_M, MIDDLE_PX = 0.1, 6.5e-6, 1100.0


def short_run(duration_s=4.0, **changes):
    """Return the night scenario without beacons and targets; ``changes`` replace nested fields of its star camera."""
    scenario = with_exact_optics(load_scenario(SCENARIOS / "theodolite_night.yaml"))
    camera = replace_nested(scenario.telescopes["night"], **changes)
    return dataclasses.replace(scenario, duration_s=duration_s, beacons={}, targets={}, telescopes={"night": camera})


def stars_of(run):
    return [message for topic, message, _ in generate_messages([run], RosbagsFactory()) if topic == STARS]


@pytest.mark.parametrize("exposure_s", [0.0, 0.8])
def test_stars_are_imaged_according_to_main_axis_mounting_and_sky(exposure_s):
    # The expected image is the mean of the star's path, by the trapezoidal rule; the mount sweeps 12' in the longer
    # exposure. The simulation holds the sky constant during an exposure. The remaining difference is a twelfth of the
    # sky's rotation, 12", times the image's rotation, 2°: 0.03" or 0.002 px.
    settings = {"identified": True, "false_stars": 0.0, "camera__centroid_sigma_px": 1e-6}
    run = simulate(short_run(exposure_s=exposure_s, **settings), seed=1)
    truth, sky, found = run.theodolite.truth, run.truth.sky, stars_of(run)
    assert len(found) == 20
    rows = {int(number): row for row, number in enumerate(sky.catalogue.hip)}
    since_middle_s = np.linspace(-0.5, 0.5, 41) * exposure_s
    weight = np.r_[0.5, np.ones(39), 0.5] / 40.0
    per_px, seen = PIXEL_PITCH_M / FOCAL_LENGTH_M, 0
    for index, message in enumerate(found):
        time_ns = run.theodolite.stars["night"].time_ns[index]
        mount = truth.scene.mount((time_ns - run.start_ns) * 1e-9 + since_middle_s)
        rotation_ns = mount.rotation_nm @ rotation_from_angles(*truth.star_parallelism["night"]).T
        times_ns = time_ns + np.rint(since_middle_s * 1e9).astype(np.int64)
        for star in message.stars:
            place_n = sky.directions(sky.positions[np.array([rows[star.catalogue_id]])], times_ns)
            forward, up, right = (place_n[:, None] @ rotation_ns)[:, 0].T
            way_px = MIDDLE_PX + np.stack([right, -up], axis=-1) / forward[:, None] / per_px
            np.testing.assert_allclose([star.u, star.v], weight @ way_px, atol=4e-3)
            seen += 1
        assert (message.sensor_id, message.header.frame_id) == ("night", "theodolite_night")
        assert message.exposure_s == np.float32(exposure_s)
    assert seen > 150


def test_errors_of_the_sensor_are_those_of_a_star_sensor():
    clean = stars_of(simulate(short_run(false_stars=0.0), seed=1))
    swapped = stars_of(simulate(short_run(identified=True, swapped_probability=1.0, false_stars=0.0), seed=1))
    named = stars_of(simulate(short_run(identified=True, false_stars=0.0), seed=1))
    false = stars_of(simulate(short_run(false_stars=3.0), seed=1))
    assert {star.catalogue_id for message in clean for star in message.stars} == {0}
    changed = [
        sum(one.catalogue_id != other.catalogue_id for one, other in zip(a.stars, b.stars, strict=True))
        for a, b in zip(named, swapped, strict=True)
    ]
    assert set(changed) == {2}
    assert sum(len(message.stars) for message in false) > sum(len(message.stars) for message in clean) + 20


def test_no_stars_in_an_outage_and_by_day():
    clouded = stars_of(simulate(short_run(outages={"x": Outage(1.0, 2.0)}, false_stars=0.0), seed=1))
    assert [bool(message.stars) for message in clouded] == [True] * 5 + [False] * 5 + [True] * 10
    scenario = dataclasses.replace(short_run(false_stars=0.0), start_utc="2014-07-09T04:00:00Z")
    assert not any(message.stars for message in stars_of(simulate(scenario, seed=1)))


def test_parallelism_is_drawn_with_its_sigma_and_published_as_truth():
    scenario = short_run(azimuth_sigma_arcsec=2.0, elevation_sigma_arcsec=3.0, roll_sigma_arcsec=40.0)
    config = scenario.telescopes["night"]
    known = np.deg2rad([config.azimuth_deg, config.elevation_deg, config.roll_deg])
    drawn = np.array([draw_parallelism("night", config, seed) - known for seed in range(400)])
    low, high = sigma_ratio_band(400, 0.999)
    for column, sigma in zip(drawn.T, np.array([2.0, 3.0, 40.0]) * ARCSEC, strict=True):
        assert low < np.sqrt(np.mean(column**2)) / sigma < high
    run = simulate(scenario, seed=5)
    truths = [
        message for topic, message, _ in generate_messages([run], RosbagsFactory()) if topic == "truth/calibration"
    ][-1]
    values = dict(zip(truths.names, truths.values, strict=True))
    of_camera = [values[f"telescopes.night.{angle}"] for angle in ("azimuth", "elevation", "roll")]
    np.testing.assert_array_equal(of_camera, known + drawn[5])


def test_a_further_camera_changes_nothing_else():
    alone, scenario = short_run(), short_run()
    other = replace_nested(scenario.telescopes["night"], azimuth_deg=-2.0)
    both = dataclasses.replace(scenario, telescopes={**scenario.telescopes, "second": other})
    runs = [simulate(one, seed=1) for one in (alone, both)]
    first, second = (run.theodolite.stars["night"].pixel for run in runs)
    np.testing.assert_array_equal(first, second)
    assert set(runs[1].theodolite.stars) == {"night", "second"}


def test_a_start_beyond_the_table_of_the_earth_is_refused(tmp_path):
    text = (SCENARIOS / "theodolite_night.yaml").read_text(encoding="utf-8").replace("2014-07-09", "2199-07-09")
    path = tmp_path / "far.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(Exception, match="no sky can be computed"):
        load_scenario(path)


def test_detector_errors_are_drawn_for_this_camera_too():
    settings = {"identified": True, "false_stars": 0.0, "exposure_s": 0.0}
    plain, spatial = (
        simulate(short_run(duration_s=20.0, camera__field_spatial_sigma_px=sigma_px, **settings), seed=1)
        for sigma_px in (0.0, 0.5)
    )
    off_px = spatial.theodolite.stars["night"].pixel - plain.theodolite.stars["night"].pixel
    # Few positions on the detector have independent errors, so the RMS is checked only to a factor of two.
    assert 0.25 < np.sqrt(np.mean(off_px**2)) < 1.0

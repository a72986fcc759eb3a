"""Errors of the optical axis against the truth: by hand, in an evaluation, in a figure, and filled in by a replay."""

import dataclasses

import numpy as np
import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import enu_covariance, rotation_vector_covariance
from ship_geometry.rotations import ARCSEC
from ship_replay.commands.evaluate import main
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.evaluation.figures import attitude_error_figure
from ship_replay.offline.outputs import TruthErrors
from ship_simulation.messages.theodolite_messages import true_pointings
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import Ins
from ship_simulation.simulate_command import write_bag
from ship_testing.hand_made_bags import FACTORY, START_NS, innovation, ship_attitude
from ship_testing.theodolite_scenes import bag_scenario, with_beacons, without_errors
from ship_watch.orientations import POINTING

SECOND_NS = 1_000_000_000
SIGMA_ARCSEC = np.array([6.0, 3.0, 40.0])
"""Standard deviations of azimuth (not times the cosine), elevation, image rotation."""


def pointing(stamp_ns, azimuth, elevation, rotation=0.0, mode=0, status=0, covariance_enu=None):
    return FACTORY.make(
        "ship_msgs/msg/OpticalAxisPointing",
        header=make_header(FACTORY, stamp_ns, "main"),
        azimuth=azimuth % (2.0 * np.pi),
        elevation=elevation,
        image_rotation=rotation,
        covariance=np.zeros(9),
        rotation_covariance=np.zeros(9) if covariance_enu is None else np.ravel(covariance_enu),
        telescope_azimuth=float("nan"),
        telescope_elevation=float("nan"),
        telescope_rotation=float("nan"),
        mode=mode,
        status=status,
        light_count=0,
    )


def error_message(stamp_ns):
    names = [f"{what}_{channel}" for what in ("sigma", "error") for channel in POINTING.channels]
    header = make_header(FACTORY, stamp_ns, "main")
    return FACTORY.make("ship_msgs/msg/PointingErrorArcsec", header=header, **dict.fromkeys(names, float("nan")))


def write_run(path, errors_arcsec, modes):
    """Write pointings 1 s apart towards North at 60° elevation, with errors of azimuth, elevation and rotation."""
    elevation = np.deg2rad(60.0)
    covariance_n = rotation_vector_covariance(np.diag((SIGMA_ARCSEC * ARCSEC) ** 2), 0.0, elevation)
    with BagWriter(path) as bag:
        for number, (errors, mode) in enumerate(zip(errors_arcsec, modes, strict=True)):
            stamp_ns = START_NS + number * SECOND_NS
            azimuth, up, rotation = np.array(errors) * ARCSEC
            bag.write("truth/pointing", pointing(stamp_ns, 0.0, elevation), stamp_ns)
            published = pointing(stamp_ns, azimuth, elevation + up, rotation, mode, 0, enu_covariance(covariance_n))
            bag.write("theodolite/pointing", published, stamp_ns)
    return path


def test_errors_of_all_and_by_mode_by_hand(tmp_path):
    # At 60° the azimuth counts half. Two lights: -4, 2, then encoder: 8 and 6 (azimuth), across North.
    errors = [(-8.0, 1.0, 20.0), (4.0, -1.0, -20.0), (16.0, 5.0, 0.0), (12.0, 5.0, 0.0)]
    values = evaluate(write_run(tmp_path / "a.mcap", errors, [0, 0, 2, 2])).quantities()
    expected = {
        "pointing.samples": 4,
        "pointing.invalid": 0,
        "pointing.azimuth_cos_elevation.rms_arcsec": np.sqrt((16.0 + 4.0 + 64.0 + 36.0) / 4.0),
        "pointing.azimuth_cos_elevation.sigma_arcsec": 3.0,
        "pointing.elevation.bias_arcsec": 2.5,
        "pointing.image_rotation.sigma_arcsec": 40.0,
        "pointing.two_lights.samples": 2,
        "pointing.two_lights.azimuth_cos_elevation.rms_arcsec": np.sqrt(10.0),
        "pointing.two_lights.elevation.rms_over_sigma": 1.0 / 3.0,
        "pointing.two_lights.image_rotation.rms_over_sigma": 0.5,
        "pointing.encoder.azimuth_cos_elevation.bias_arcsec": 7.0,
        "pointing.encoder.elevation.rms_arcsec": 5.0,
        # (8/6)² + (1/3)² + (20/40)², (4/6)² + ...: the angles' covariance is diagonal.
        "pointing.two_lights.nees_mean": 0.5 * (64 / 36 + 1 / 9 + 1 / 4 + 16 / 36 + 1 / 9 + 1 / 4),
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected, rel=1e-4)
    assert not any(name.startswith(("fused.", "pointing.one_light.")) for name in values)


def test_pointings_by_stars_stand_by_themselves(tmp_path):
    errors = [(0.0, 1.0, 0.0), (0.0, 2.0, 0.0), (0.0, 3.0, 0.0)]
    values = evaluate(write_run(tmp_path / "a.mcap", errors, [3, 4, 4])).quantities()
    assert values["pointing.stars.elevation.rms_arcsec"] == pytest.approx(1.0, rel=1e-4)
    assert values["pointing.stars_and_lights.samples"] == 2


def test_what_claims_nothing_is_counted_and_left_out(tmp_path):
    path = write_run(tmp_path / "a.mcap", [(0.0, 1.0, 0.0)] * 2, [0, 0])
    with BagWriter(tmp_path / "b.mcap") as bag:
        for number in range(2):
            stamp_ns = START_NS + number * SECOND_NS
            bag.write("theodolite/pointing", pointing(stamp_ns, np.nan, np.nan, status=3 * number), stamp_ns)
    values = evaluate(tmp_path / "b.mcap", against=path).quantities()
    assert values["pointing.invalid"] == 1
    assert values["pointing.samples"] == 1


def test_ship_and_pointing_stand_in_one_table_and_one_figure(tmp_path, capsys):
    path = write_run(tmp_path / "a.mcap", [(2.0, 1.0, 3.0)] * 3, [0, 0, 2])
    with BagWriter(tmp_path / "b.mcap") as bag:
        for number in range(3):
            stamp_ns = START_NS + number * SECOND_NS
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            covariance_enu = np.eye(3) * ARCSEC**2
            bag.write("ship/attitude", ship_attitude(stamp_ns, ARCSEC, covariance_enu=covariance_enu), stamp_ns)
            bag.write("theodolite/pointing", pointing(stamp_ns, 2.0 * ARCSEC, 1.0, mode=2), stamp_ns)
    figure_path = tmp_path / "errors.png"
    assert main([str(tmp_path / "b.mcap"), "--against", str(path), "--figure", str(figure_path)]) == 0
    printed = capsys.readouterr().out
    assert "azimuth_cos_elevation" in printed
    assert "heading" in printed
    assert "pointing.encoder" in printed
    assert figure_path.stat().st_size > 10_000
    figure = attitude_error_figure(evaluate(tmp_path / "b.mcap", against=path).errors, "both")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert len(labels) == 6
    assert "heading\nerror [arcsec]" in labels
    assert "azimuth · cos E\nerror [arcsec]" in labels


def test_errors_are_filled_in_at_stamps_and_between_them():
    run = simulate(bag_scenario(duration_s=6.0), seed=1)
    found = list(true_pointings(run.theodolite, RosbagsFactory()))
    scene, start_ns = run.theodolite.truth.scene, run.start_ns
    filler = TruthErrors(POINTING)
    # At a stamp of the truth, between two, and where no truth comes any more.
    stamps_ns = [start_ns + 2_000_000_000, start_ns + 3_050_000_000, start_ns + 60_000_000_000]
    truths = [scene.mount(np.array([seconds])).rotation_nm[0] for seconds in (2.0, 3.05)]
    for stamp_ns, truth in zip(stamps_ns, [*truths, truths[1]], strict=True):
        azimuth, elevation = np.arctan2(truth[2, 0], truth[0, 0]), np.arcsin(truth[1, 0])
        rotation = np.arctan2(-truth[1, 2], truth[1, 1])
        shifted = pointing(stamp_ns, azimuth + 10.0 * ARCSEC, elevation - 4.0 * ARCSEC, rotation + 7.0 * ARCSEC)
        filler.add_attitude(shifted)
        filler.add_error(error_message(stamp_ns), stamp_ns)
    assert filler.pop_ready(stamps_ns[0]) == []
    for _, message in found:
        filler.add_truth(POINTING.sample(message))
    ready = [message for _, message in filler.pop_ready(None)]
    values = np.array([[getattr(message, f"error_{channel}") for channel in POINTING.channels] for message in ready])
    cosines = np.array([np.cos(np.arcsin(truth[1, 0])) for truth in truths])
    expected = np.stack([10.0 * cosines, [-4.0, -4.0], [7.0, 7.0]], axis=-1)
    np.testing.assert_allclose(values[0], expected[0], atol=1e-3)
    # The tolerance is for interpolation, and for the deformation between stamps: a random walk of 0.26" in 0.05 s.
    np.testing.assert_allclose(values[1], expected[1], atol=2.0)
    assert np.isnan(values[2]).all()


def evaluate_scenario(scenario, path):
    write_bag(scenario, 1, path, b"")
    return evaluate(path).quantities()


def test_encoder_and_ins_alone_are_held_against_the_truth_too(tmp_path):
    exact = with_beacons(without_errors(bag_scenario(duration_s=20.0)), rtk__sigma_m=0.001)
    quiet = Ins(
        rate_hz=20.0, tilt_sigma_arcsec=0.0, heading_sigma_arcsec=0.0, white_sigma_arcsec=0.0, time_offset_sigma_s=0.0
    )
    values = evaluate_scenario(dataclasses.replace(exact, ins=quiet), tmp_path / "exact.mcap")
    assert values["ins_encoder.samples"] == 201
    for channel in POINTING.channels:
        # Axis errors are known; only the interpolation between INS samples remains.
        assert values[f"ins_encoder.{channel}.rms_arcsec"] < 0.3
    # On the sky the heading error is multiplied by the cosine of the elevation, here 10° to 20°.
    turned = dataclasses.replace(quiet, heading_sigma_arcsec=72.0, heading_time_s=1e6)
    values = evaluate_scenario(dataclasses.replace(exact, ins=turned), tmp_path / "turned.mcap")
    heading, across = values["ins.heading.rms_arcsec"], values["ins_encoder.azimuth_cos_elevation.rms_arcsec"]
    assert heading > 10.0
    assert 0.9 * heading < across < 0.99 * heading
    # Unknown axis errors, and the hull's deformation.
    values = evaluate_scenario(bag_scenario(duration_s=20.0), tmp_path / "usual.mcap")
    assert 10.0 < values["ins_encoder.elevation.rms_arcsec"] < 120.0


def test_the_last_calibration_and_the_lights_residuals_are_evaluated(tmp_path, capsys):
    stamp_ns = START_NS
    names, units = ["c", "focal_length"], ["rad", "m"]
    with BagWriter(tmp_path / "a.mcap") as bag:
        for c_arcsec in (9.0, -4.0):
            calibration = FACTORY.make(
                "ship_msgs/msg/TheodoliteCalibration",
                header=make_header(FACTORY, stamp_ns, "base"),
                names=names,
                values=np.array([c_arcsec * ARCSEC, 0.1001]),
                covariance=np.diag([(2.0 * ARCSEC) ** 2, 1e-10]).ravel(),
                units=units,
                unobservable=[],
                sighting_count=3,
                residual_rms=0.0,
            )
            bag.write("theodolite/calibration", calibration, stamp_ns)
        for number in range(2):
            residual = [3.0 * ARCSEC, 1.0 * ARCSEC, -3.0 * ARCSEC, 1.0 * ARCSEC]
            components = ("a x", "a z", "b x", "b z")
            found = innovation(stamp_ns + number, "lights", residual, [2.0 * ARCSEC] * 4, 5.0, components=components)
            bag.write("theodolite/innovation", found, stamp_ns)
    assert main([str(tmp_path / "a.mcap")]) == 0
    assert "Calibration at the end" in capsys.readouterr().out
    values = evaluate(tmp_path / "a.mcap").quantities()
    expected = {
        "calibration.c_arcsec": -4.0,
        "calibration.c_sigma_arcsec": 2.0,
        "calibration.focal_length_m": 0.1001,
        "calibration.focal_length_sigma_m": 1e-5,
        # Both lights together, axis by axis.
        "innovation.lights.x.std_arcsec": 3.0,
        "innovation.lights.z.mean_arcsec": 1.0,
        "innovation.lights.accepted": 2,
        "innovation.lights.nis_degrees": 4.0,
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected)

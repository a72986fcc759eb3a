"""Statistics of a run against numbers worked out by hand."""

import json

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import make_header
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_node.pages.console_tables import table_console
from ship_replay.commands.evaluate import main
from ship_replay.evaluation.evaluate import alignment_values, evaluate
from ship_replay.evaluation.tables import estimate_table, innovation_table
from ship_testing.hand_made_bags import FACTORY, START_NS, imu, innovation, ship_attitude, star_message

SECOND_NS = 1_000_000_000
SUITE = """\
ship_attitude:
  ros__parameters:
    star_sensors:
      fore: {azimuth_deg: 30.0, elevation_deg: 40.0, roll_deg: 5.0}
"""
# Covariance about (East, North, Up): pitch error is about East, roll about North, heading about Up for a ship that
# heads North.
COVARIANCE_ENU = np.diag([2.0, 3.0, 4.0]) ** 2 * ARCSEC**2


def write_run(path, errors_arcsec, headings=None, suite=None, ins_heading_arcsec=None):
    """Write attitudes 1 s apart with given errors of (heading, pitch, roll), and the truth at the same stamps."""
    headings = np.zeros(len(errors_arcsec)) if headings is None else headings
    with BagWriter(path) as bag:
        if suite:
            bag.add_attachment("suite.yaml", suite)
        for number, ((heading, pitch, roll), true_heading) in enumerate(zip(errors_arcsec, headings, strict=True)):
            stamp_ns = START_NS + number * SECOND_NS
            estimate = ((true_heading + heading * ARCSEC) % (2 * np.pi), pitch * ARCSEC, roll * ARCSEC)
            bag.write("truth/attitude", ship_attitude(stamp_ns, true_heading), stamp_ns)
            bag.write("ship/attitude", ship_attitude(stamp_ns, *estimate, covariance_enu=COVARIANCE_ENU), stamp_ns)
            if ins_heading_arcsec is not None:
                covariance = (np.diag([10.0, 10.0, 72.0]) ** 2 * ARCSEC**2).ravel()
                bag.write(
                    "ins/imu", imu(stamp_ns, heading=ins_heading_arcsec * ARCSEC, covariance=covariance), stamp_ns
                )
    return path


def test_errors_by_hand(tmp_path):
    # Heading ±4 about +1, pitch 2, roll −3 and 3: by hand.
    errors = [(5.0, 2.0, -3.0), (-3.0, 2.0, 3.0), (5.0, 2.0, -3.0), (-3.0, 2.0, 3.0)]
    values = evaluate(write_run(tmp_path / "a.mcap", errors)).quantities()
    expected = {
        "fused.samples": 4,
        "fused.invalid": 0,
        "fused.heading.rms_arcsec": np.sqrt(17.0),
        "fused.heading.bias_arcsec": 1.0,
        "fused.heading.sigma_arcsec": 4.0,
        "fused.heading.rms_over_sigma": np.sqrt(17.0) / 4.0,
        "fused.pitch.rms_arcsec": 2.0,
        "fused.pitch.bias_arcsec": 2.0,
        "fused.pitch.sigma_arcsec": 2.0,
        "fused.pitch.rms_over_sigma": 1.0,
        "fused.roll.rms_arcsec": 3.0,
        "fused.roll.bias_arcsec": 0.0,
        "fused.roll.sigma_arcsec": 3.0,
        "fused.roll.rms_over_sigma": 1.0,
        # Heading contributes 17/16 on average, pitch 1, roll 1; products of errors of 5 arcsec matter in the fifth
        # digit.
        "fused.nees_mean": pytest.approx(17.0 / 16.0 + 2.0, abs=1e-4),
    }
    assert values.keys() == expected.keys()
    for name, value in expected.items():
        assert values[name] == (value if name == "fused.nees_mean" else pytest.approx(value, abs=1e-6)), name


def test_heading_errors_are_wrapped_at_north(tmp_path):
    headings = np.array([0.0, 0.0, 2 * np.pi - 1e-6])
    run = write_run(tmp_path / "a.mcap", [(-5.0, 0.0, 0.0), (5.0, 0.0, 0.0), (3.0, 0.0, 0.0)], headings)
    assert evaluate(run).quantities()["fused.heading.rms_arcsec"] == pytest.approx(np.sqrt(59.0 / 3.0), abs=1e-6)


def test_covariance_turns_with_the_heading(tmp_path):
    """If the heading is East, pitch is about North, with the second sigma."""
    values = evaluate(write_run(tmp_path / "a.mcap", [(0.0, 3.0, 2.0)] * 2, [np.pi / 2] * 2)).quantities()
    assert values["fused.pitch.sigma_arcsec"] == pytest.approx(3.0)
    assert values["fused.roll.sigma_arcsec"] == pytest.approx(2.0)
    assert values["fused.nees_mean"] == pytest.approx(2.0, abs=1e-6)


def test_only_equal_stamps_and_claimed_attitudes_count(tmp_path):
    path = tmp_path / "a.mcap"
    with BagWriter(path) as bag:
        for number in range(4):
            stamp_ns = START_NS + number * SECOND_NS
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            bag.write("ship/attitude", ship_attitude(stamp_ns, status=3 if number == 0 else 0), stamp_ns)
            bag.write("ship/attitude", ship_attitude(stamp_ns + 1, heading=1.0), stamp_ns + 1)
    values = evaluate(path).quantities()
    assert values["fused.samples"] == 3
    assert values["fused.invalid"] == 1
    assert values["fused.heading.rms_arcsec"] == 0.0


def test_ins_alone(tmp_path):
    values = evaluate(write_run(tmp_path / "a.mcap", [(0.0, 0.0, 0.0)] * 3, ins_heading_arcsec=36.0)).quantities()
    assert values["ins.heading.rms_arcsec"] == pytest.approx(36.0)
    assert values["ins.heading.sigma_arcsec"] == pytest.approx(72.0)
    assert values["ins.nees_mean"] == pytest.approx(0.25)


def test_a_star_sensor_alone_is_rotated_to_the_deck_by_its_nominal_installation(tmp_path):
    path = tmp_path / "a.mcap"
    rotation_dv = rotation_from_angles(*np.deg2rad([30.0, 40.0, 5.0]))
    rotation_nd = rotation_from_angles(1.0, 0.0, 0.0)
    # The sensor reports a heading 7 arcsec too large.
    reported_nd = rotation_from_angles(1.0 + 7.0 * ARCSEC, 0.0, 0.0)
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", SUITE)
        for number in range(4):
            stamp_ns = START_NS + number * 100_000_000
            truth = ship_attitude(stamp_ns, *(float(angle) for angle in angles_from_rotation(rotation_nd)))
            bag.write("truth/attitude", truth, stamp_ns)
        # Between two stamps of the truth.
        stamp_ns = START_NS + 50_000_000
        message = star_message(stamp_ns, reported_nd @ rotation_dv, np.eye(3) * ARCSEC**2)
        bag.write("star/fore/horizon_attitude", message, stamp_ns)
    values = evaluate(path).quantities()
    assert values["star.fore.samples"] == 1
    assert values["star.fore.heading.bias_arcsec"] == pytest.approx(7.0, abs=1e-6)
    assert values["star.fore.pitch.rms_arcsec"] == pytest.approx(0.0, abs=1e-6)
    # Installation: 20, 1, 1 arcsec about forward, up, right; the boresight is 40° up. The variance about the vertical
    # axis is 20² sin²40° + 1² cos²40° (sigmas about up and right are equal), and 1 for the noise. The ship is level, so
    # heading is about Up.
    vertical = 400.0 * np.sin(np.deg2rad(40.0)) ** 2 + np.cos(np.deg2rad(40.0)) ** 2 + 1.0
    assert values["star.fore.heading.sigma_arcsec"] == pytest.approx(np.sqrt(vertical))


STAR_SUITE = """\
star_attitude:
  ros__parameters:
    star_sensors:
      fore:
        azimuth_deg: 30.0
        elevation_deg: 40.0
        roll_deg: 5.0
        camera: {focal_length_m: 0.05, pixel_pitch_m: 5.5e-6}
"""


def write_solutions(path, error_arcsec, truth=True):
    """Write three solutions of the sensor fore and of all sensors, with a heading error; the second has no attitude."""
    rotation_dv = rotation_from_angles(*np.deg2rad([30.0, 40.0, 5.0]))
    reported_nd = rotation_from_angles(1.0 + error_arcsec * ARCSEC, 0.0, 0.0)
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", STAR_SUITE)
        for number in range(3):
            stamp_ns = START_NS + number * 100_000_000
            if truth:
                bag.write("truth/attitude", ship_attitude(stamp_ns, 1.0), stamp_ns)
            hidden = np.nan if number == 1 else 1.0
            for sensor_id, rotation_nb in (("fore", reported_nd @ rotation_dv), ("joint", reported_nd)):
                message = star_message(stamp_ns, rotation_nb, np.diag([2.0, 3.0, 4.0]) ** 2 * ARCSEC**2, sensor_id)
                message.azimuth *= hidden
                message.rotation_covariance = message.rotation_covariance * hidden
                message.status = 3 if number == 1 else 0
                bag.write(f"star/{sensor_id}/solution", message, stamp_ns)
    return path


def test_solutions_of_the_stars(tmp_path):
    values = evaluate(write_solutions(tmp_path / "a.mcap", 7.0)).quantities()
    for source in ("star.fore", "star.joint"):
        assert values[f"{source}.samples"] == 2
        assert values[f"{source}.heading.bias_arcsec"] == pytest.approx(7.0, abs=1e-6)
    # The sigma about Up is that of the message; for a single sensor the installation is added, as computed above.
    installation = (20.0 * np.sin(np.deg2rad(40.0))) ** 2 + np.cos(np.deg2rad(40.0)) ** 2
    assert values["star.joint.heading.sigma_arcsec"] == pytest.approx(4.0)
    assert values["star.fore.heading.sigma_arcsec"] == pytest.approx(np.sqrt(16.0 + installation))
    assert values["star.joint.nees_mean"] == pytest.approx(49.0 / 16.0, abs=1e-4)


def test_solutions_of_the_run_come_before_those_of_another_bag(tmp_path):
    recorded = write_solutions(tmp_path / "recorded.mcap", 5.0)
    replayed = write_solutions(tmp_path / "replayed.mcap", 2.0, truth=False)
    values = evaluate(replayed, against=recorded).quantities()
    assert values["star.fore.heading.bias_arcsec"] == pytest.approx(2.0, abs=1e-6)
    assert values["star.joint.heading.bias_arcsec"] == pytest.approx(2.0, abs=1e-6)


def test_truth_and_inputs_from_another_bag(tmp_path):
    truth = write_run(tmp_path / "truth.mcap", [(0.0, 0.0, 0.0)] * 3, ins_heading_arcsec=36.0)
    out = tmp_path / "out.mcap"
    with BagWriter(out) as bag:
        for number in range(3):
            stamp_ns = START_NS + number * SECOND_NS
            bag.write("ship/attitude", ship_attitude(stamp_ns, heading=2.0 * ARCSEC), stamp_ns)
    values = evaluate(out, against=truth).quantities()
    assert values["fused.heading.bias_arcsec"] == pytest.approx(2.0)
    assert values["ins.heading.bias_arcsec"] == pytest.approx(36.0)
    assert values["ins.samples"] == 3
    with pytest.raises(BadInput, match="nothing to evaluate"):
        evaluate(out)


def test_the_start_can_be_left_out(tmp_path):
    run = write_run(tmp_path / "a.mcap", [(100.0, 0.0, 0.0)] * 2 + [(1.0, 0.0, 0.0)] * 3)
    assert evaluate(run, skip_s=2.0).quantities()["fused.heading.rms_arcsec"] == pytest.approx(1.0)
    assert evaluate(run, skip_s=2.0).quantities()["fused.samples"] == 3


def write_innovations(path):
    with BagWriter(path) as bag:
        rng = np.random.default_rng(5)
        for number in range(240):
            stamp_ns = START_NS + number * SECOND_NS
            # In the second half the errors are twice the stated sigma.
            residual = rng.normal(size=3) * np.array([1.0, 2.0, 3.0]) * (1.0 if number < 120 else 2.0)
            nis = float(np.sum((residual / [1.0, 2.0, 3.0]) ** 2))
            sigma = np.array([1.0, 2.0, 3.0]) * ARCSEC
            bag.write("ship/innovation", innovation(stamp_ns, "reference.b", residual * ARCSEC, sigma, nis), stamp_ns)
        rejected = innovation(stamp_ns + SECOND_NS, "reference.b", [1.0] * 3, [1e-3] * 3, 1e6, False, reason=19)
        bag.write("ship/innovation", rejected, stamp_ns + SECOND_NS)
        late = innovation(stamp_ns + SECOND_NS, "star.fore", [], [], float("nan"), False, reason=8, components=())
        bag.write("ship/innovation", late, stamp_ns + SECOND_NS)
        bag.write("ship/alignment", alignment(stamp_ns), stamp_ns)
    return path


def alignment(stamp_ns):
    return FACTORY.make(
        "ship_msgs/msg/AlignmentState",
        header=make_header(FACTORY, stamp_ns, "deck"),
        names=["ins.up", "reference.b.heading", "ins.time_offset"],
        values=np.array([10.0 * ARCSEC, np.deg2rad(359.177), 0.012]),
        covariance=np.diag([ARCSEC**2, np.deg2rad(0.002) ** 2, 0.001**2]).ravel(),
        units=["rad", "rad", "s"],
    )


def test_innovations_and_alignment_without_truth(tmp_path):
    values = evaluate(write_innovations(tmp_path / "a.mcap")).quantities()
    assert values["innovation.reference.b.accepted"] == 240
    assert values["innovation.reference.b.refused"] == 1
    assert values["innovation.star.fore.accepted"] == 0
    assert values["innovation.star.fore.refused"] == 1
    assert values["innovation.reference.b.pitch.sigma_arcsec"] == pytest.approx(2.0)
    # 120 with σ = 2 and 120 with σ = 4: √10; 240 samples: ± 4.6 % (one sigma of a sigma).
    assert values["innovation.reference.b.pitch.std_arcsec"] == pytest.approx(np.sqrt(10.0), rel=0.15)
    assert values["innovation.reference.b.nis_mean"] == pytest.approx(7.5, rel=0.2)
    # Two of four minutes have NIS four times too large.
    assert values["innovation.reference.b.nis_windows_in_band"] == 0.5
    assert values["alignment.ins.up_arcsec"] == pytest.approx(10.0)
    assert values["alignment.ins.up_sigma_arcsec"] == pytest.approx(1.0)
    assert values["alignment.reference.b.heading_deg"] == pytest.approx(-0.823)
    assert values["alignment.reference.b.heading_sigma_deg"] == pytest.approx(0.002)
    assert values["alignment.ins.time_offset_s"] == pytest.approx(0.012)


def test_a_measurement_with_two_decisions_counts_once(tmp_path):
    path = tmp_path / "a.mcap"
    with BagWriter(path) as bag:
        for residual, accepted, reason in ((1.0, True, 0), (3.0, True, 20)):
            message = innovation(START_NS, "star.fore", [residual], [1.0], residual**2, accepted, reason, ("up",))
            bag.write("ship/innovation", message, START_NS)
        for accepted in (True, False):
            message = innovation(
                START_NS + 1, "star.fore", [9.0], [1.0], 81.0, accepted, 0 if accepted else 19, ("up",)
            )
            bag.write("ship/innovation", message, START_NS + 1)
    values = evaluate(path).quantities()
    assert values["innovation.star.fore.accepted"] == 1
    assert values["innovation.star.fore.nis_mean"] == pytest.approx(9.0)


def test_a_configured_sensor_without_attitudes_is_named(tmp_path):
    path = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5, suite=SUITE)
    assert evaluate(path).problems == [
        "star.fore not evaluated: no attitude on star/fore/horizon_attitude while the truth is known"
    ]


class TestCommand:
    def run(self, *arguments):
        return main([str(argument) for argument in arguments])

    @pytest.mark.parametrize("skip", ["4.1", "1e300", "nan", "-1"])
    def test_a_skip_beyond_the_end_is_an_error(self, skip, tmp_path, capsys):
        bag = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5)
        assert self.run(bag, "--skip", "4.0") == 0
        assert self.run(bag, f"--skip={skip}") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "s to skip: expected from 0 to 4.0 s" in line

    def test_tables_json_figure(self, tmp_path, capsys):
        bag = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5, ins_heading_arcsec=36.0)
        assert self.run(bag, "--json", tmp_path / "a.json", "--figure", tmp_path / "a.png") == 0
        printed = capsys.readouterr().out
        assert "RMS/σ" in printed
        assert "fused" in printed
        assert json.loads((tmp_path / "a.json").read_text())["fused.heading.rms_arcsec"] == pytest.approx(1.0)
        assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")

    def test_the_table_names_its_counts(self, tmp_path):
        """One exposure that is used without two of its stars: one measurement, two stars."""
        bag = tmp_path / "a.mcap"
        with BagWriter(bag) as writer:
            exposure = innovation(START_NS, "star.fore", [ARCSEC] * 3, [ARCSEC] * 3, 3.0)
            star = innovation(START_NS, "star.fore", [ARCSEC] * 2, [ARCSEC] * 2, 2.0, False, 14, ("up", "right"))
            for message in (exposure, star, star):
                writer.write("ship/innovation", message, START_NS)
        table = innovation_table(evaluate(bag))
        counts = {str(column.header): next(iter(column.cells)) for column in table.columns[-2:]}
        assert counts["accepted (measurements)"] == "1"
        assert counts["rejected (messages, stars)"] == "2 (misidentified 2)"

    def test_the_figure_is_the_same_each_time(self, tmp_path):
        bag = write_innovations(tmp_path / "a.mcap")
        for name in ("1.png", "2.png"):
            assert self.run(bag, "--figure", tmp_path / name) == 0
        assert (tmp_path / "1.png").read_bytes() == (tmp_path / "2.png").read_bytes()

    def test_undefined_values_are_null(self, tmp_path):
        path = tmp_path / "a.mcap"
        with BagWriter(path) as bag:
            bag.write("truth/attitude", ship_attitude(START_NS), START_NS)
            bag.write("ins/imu", imu(START_NS), START_NS)
        assert self.run(path, "--json", tmp_path / "a.json") == 0
        # The INS gave no covariance.
        assert json.loads((tmp_path / "a.json").read_text())["ins.nees_mean"] is None

    @pytest.mark.parametrize(
        ("bound", "code", "line"),
        [
            ("{max: 1.5}", 0, "met: fused.heading.rms_arcsec = 1, bound <= 1.5"),
            ("{max: 0.5}", 1, "NOT MET: fused.heading.rms_arcsec = 1, bound <= 0.5"),
            ("{min: 2, max: 3}", 1, "NOT MET: fused.heading.rms_arcsec = 1, bound >= 2 and <= 3"),
        ],
    )
    def test_bounds(self, tmp_path, capsys, bound, code, line):
        bag = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5)
        bounds = tmp_path / "a.expected.yaml"
        bounds.write_text(f"fused.heading.rms_arcsec: {bound}\n")
        assert self.run(bag, "--bounds", bounds) == code
        assert line in capsys.readouterr().out.splitlines()

    def test_bounds_may_leave_out_the_start(self, tmp_path):
        bag = write_run(tmp_path / "a.mcap", [(100.0, 0.0, 0.0)] * 2 + [(1.0, 0.0, 0.0)] * 3)
        bounds = tmp_path / "a.expected.yaml"
        bounds.write_text("skip_s: 2\nfused.heading.rms_arcsec: {max: 1.5}\n")
        assert self.run(bag, "--bounds", bounds) == 0

    def test_an_undefined_value_meets_no_bound(self, tmp_path):
        path = tmp_path / "a.mcap"
        with BagWriter(path) as bag:
            bag.write("truth/attitude", ship_attitude(START_NS), START_NS)
            bag.write("ins/imu", imu(START_NS), START_NS)
        bounds = tmp_path / "a.expected.yaml"
        bounds.write_text("ins.nees_mean: {min: 0.0, max: 100.0}\n")
        assert self.run(path, "--bounds", bounds) == 1

    @pytest.mark.parametrize(
        ("text", "complaint"),
        [
            ("\nfused.nees_mean: 3\n", "a.expected.yaml:2: 'fused.nees_mean': expected {min: NUMBER, max: NUMBER}"),
            ("fused.nees_mean: {max: big}\n", "a.expected.yaml:1: 'fused.nees_mean': expected a number, got 'big'"),
            ("fused.nees_mean: {min: 2, max: 1}\n", "min 2 is above max 1"),
            (
                "fused.nees_mean: {max: 1}\nfused.nees_mean: {max: 2}\n",
                "a.expected.yaml:2: 'fused.nees_mean' is",
            ),
            ("fused.neess: {max: 1}\n", "no such quantity: fused.neess"),
            ("- 1\n", "expected lines such as"),
            ("a: [\n", "not YAML"),
        ],
    )
    def test_bad_bounds_are_one_line_and_two(self, tmp_path, capsys, text, complaint):
        bag = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5)
        bounds = tmp_path / "a.expected.yaml"
        bounds.write_text(text)
        assert self.run(bag, "--bounds", bounds) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert complaint in line

    def test_a_figure_of_an_unknown_kind(self, tmp_path, capsys):
        bag = write_run(tmp_path / "a.mcap", [(1.0, 2.0, 3.0)] * 5)
        assert self.run(bag, "--figure", tmp_path / "a.xyz") == 2
        assert "the figure cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("angles", "covariance_enu", "text"),
    [
        ((np.inf, 0.0, 0.0), np.zeros(9), "heading, pitch, roll is infinite"),
        ((0.0, -np.inf, 0.0), np.zeros(9), "heading, pitch, roll is infinite"),
        ((0.0, 0.0, 0.0), np.full(9, np.inf), "rotation_covariance is infinite"),
    ],
)
def test_a_claimed_attitude_that_is_infinite_is_left_out_by_name(tmp_path, angles, covariance_enu, text):
    run = write_run(tmp_path / "run.mcap", [(4.0, 2.0, -3.0)] * 3)
    without = evaluate(run)
    stamp_ns = START_NS + 3 * SECOND_NS
    bad = ship_attitude(stamp_ns, covariance_enu=covariance_enu)
    bad.heading, bad.pitch, bad.roll = angles
    with BagWriter(tmp_path / "with.mcap") as bag:
        for number in range(3):
            at_ns = START_NS + number * SECOND_NS
            estimate = np.array([4.0, 2.0, -3.0]) * ARCSEC
            bag.write("truth/attitude", ship_attitude(at_ns), at_ns)
            bag.write("ship/attitude", ship_attitude(at_ns, *estimate, covariance_enu=COVARIANCE_ENU), at_ns)
        bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
        bag.write("ship/attitude", bad, stamp_ns)
    found = evaluate(tmp_path / "with.mcap")
    assert found.quantities() == without.quantities()
    assert found.problems == [f"topic 'ship/attitude': messages excluded: 1, the first because non_finite: {text}"]


def test_the_table_of_an_alignment_contains_all_units_of_its_states(capsys):
    """Units of ship_attitude.alignment and of the theodolite's states; the values are chosen for exact texts."""
    units = {"heading": "rad", "clock": "s", "lever": "m", "principal_u": "px", "focal_length": "1"}
    message = FACTORY.make(
        "ship_msgs/msg/AlignmentState",
        header=make_header(FACTORY, START_NS),
        names=list(units),
        units=list(units.values()),
        values=[ARCSEC, 0.002, 0.003, 1.25, 1e-4],
        covariance=np.diag(np.array([ARCSEC, 0.001, 0.001, 0.25, 2e-5]) ** 2).ravel(),
    )
    table_console().print(estimate_table("alignment", alignment_values(message)))
    rows = [line.replace("│", " ").split() for line in capsys.readouterr().out.splitlines()]
    assert [row for row in rows if row and row[0] in units] == [
        ["heading", "1.00", "1.00", "arcsec"],
        ["clock", "2.000", "1.000", "ms"],
        ["lever", "3.0000", "1.0000", "mm"],
        ["principal_u", "1.250", "0.250", "px"],
        ["focal_length", "0.0100", "0.0020", "%"],
    ]

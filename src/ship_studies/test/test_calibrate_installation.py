"""The command calibrate_installation on simulated bags: the file that a node loads, the texts, bad input."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.message_store import RosbagsFactory
from ship_estimation.parameters.schema import build
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, log_rotation, wrap_pi
from ship_simulation.run import SimulatedRun
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_configuration
from ship_studies.installation.calibrate_installation_command import main
from ship_testing.calibration_sessions import HEELING, STILL, TURN, session, write_session
from ship_testing.usage_errors import usage_error

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"


@dataclass
class Calibrated:
    """A session, the files of the command and its output."""

    run: SimulatedRun
    alignment: Path
    report: Path
    printed: str

    @property
    def values(self) -> dict:
        return json.loads((self.report / "installation.json").read_text(encoding="utf-8"))

    @property
    def lines(self) -> list[str]:
        return [" ".join(line.split()) for line in self.printed.splitlines()]


def calibrate(folder: Path, capsys: pytest.CaptureFixture[str], scenario=None, arguments=(), **bag) -> Calibrated:
    run = write_session(folder / "session.mcap", session(STILL) if scenario is None else scenario, **bag)
    out, report = folder / "alignment.yaml", folder / "report"
    assert main([str(folder / "session.mcap"), "--out", str(out), "--report", str(report), *arguments]) == 0
    return Calibrated(run, out, report, capsys.readouterr().out)


def observability(calibrated: Calibrated) -> dict[str, str]:
    return {entry["what"].split(" (")[0]: entry["observed"] for entry in calibrated.values["combinations"].values()}


AZIMUTH, PITCH, ROLL = (f"all sensors rotated together in {angle}" for angle in ("azimuth", "pitch", "roll"))


def test_at_constant_heading_the_common_turns_are_named(tmp_path, capsys):
    result = calibrate(tmp_path, capsys)
    assert observability(result) == {ROLL: "no", AZIMUTH: "no", PITCH: "no"}
    # Two installations with sigmas of 20" and an INS heading with a sigma of 72": 1 / sqrt(2 / 20² + 1 / 72²) = 13.88".
    text = " ".join(result.lines)
    assert f"(2) not observed, 13.88″ of 13.88″: {AZIMUTH} (about the deck's up axis); add a reference" in text
    assert "turn the ship by 180 deg or more, or add a reference of known installation" in text
    assert result.values["angles"]["star.fore.azimuth"]["open_in"] == ["2"]
    # The sensors are compared: one measures its roll to 100" in each of 61 exposures, the other measures this rotation
    # precisely, across its line of sight.
    assert result.values["angles"]["star.fore.roll"]["sigma_arcsec"] < 0.6 * 28.28


@pytest.mark.slow
def test_a_turn_makes_tilt_observable_and_not_azimuth(tmp_path, capsys):
    result = calibrate(tmp_path, capsys, session(TURN))
    assert observability(result) == {ROLL: "yes", AZIMUTH: "no", PITCH: "yes"}
    text = " ".join(result.lines)
    assert "turning the ship in calm water does not help: the INS's heading error turns with it" in text


def test_a_turn_in_a_swell_makes_all_observable(tmp_path, capsys):
    result = calibrate(tmp_path, capsys, session(HEELING))
    assert observability(result) == {ROLL: "yes", AZIMUTH: "yes", PITCH: "yes"}
    assert "all combinations of the installation angles were observed" in result.lines


def test_with_a_reference_the_node_starts_from_the_true_angles(tmp_path, capsys):
    result = calibrate(tmp_path, capsys, session(STILL, reference=True))
    assert set(observability(result).values()) == {"yes"}
    assert set(ALIGNMENT_FILE.load(result.alignment).names) == {
        "ins.time_offset", "star.fore.installation", "star.starboard.installation", "reference.plate.installation",
        "reference.plate.time_offset",
    }  # fmt: skip
    configuration = suite_configuration(session(STILL))
    configured, primed = (
        ShipAttitudeAdapter(build(ShipAttitudeConfig, {**configuration, **file}), RosbagsFactory())
        for file in ({}, {"alignment_file": str(result.alignment)})
    )
    for adapter in (configured, primed):
        adapter.tick(result.run.start_ns)
    alignment, before = (
        current_alignment(each.core.filter, each.core.config, each.core.state) for each in (primed, configured)
    )
    sigma, sigma_before = (np.sqrt(np.diagonal(a.covariance)) for a in (alignment, before))
    for id_, truth in result.run.truth.stars.items():
        true = angles_from_rotation(truth.rotation_dv)
        for angle, value in zip(("azimuth", "elevation", "roll"), true, strict=True):
            name = f"star.{id_}.{angle}"
            index, stated = alignment.names.index(name), result.values["angles"][name]
            # The file, the report and the truth agree.
            assert np.rad2deg(wrap_pi(alignment.values[index])) == pytest.approx(stated["installed_deg"], abs=1e-9)
            assert sigma[index] / ARCSEC == pytest.approx(stated["sigma_arcsec"], rel=1e-4)
            assert abs(wrap_pi(alignment.values[index] - value)) < 4.0 * sigma[index] < 2.0 * sigma_before[index]
    figure = result.report / "installation.png"
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert result.lines[-1] == f"report: {figure}, {result.report / 'installation.json'}"


def test_table_and_report_are_equal(tmp_path, capsys):
    result = calibrate(tmp_path, capsys, session(TURN))
    values = result.values
    row = next(line.strip("│ ").split(" │ ") for line in result.lines if "starboard │ azimuth" in line)
    stated = values["angles"]["star.starboard.azimuth"]
    assert row[2] == f"{stated['configured_deg']:.5f}" == "90.00000"
    assert row[3] == f"{stated['installed_deg']:.5f}"
    assert row[4] == f"{stated['correction_arcsec']:+.2f}"
    assert row[5:7] == [f"{stated['sigma_before_arcsec']:.2f}", f"{stated['sigma_arcsec']:.2f}"]
    assert row[7:9] == [stated["observed"], *stated["open_in"]] == ["partly", "2"]
    degrees = stated["installed_deg"] - stated["configured_deg"]
    assert stated["correction_arcsec"] == pytest.approx(3600.0 * degrees, abs=1e-6)
    covariance = np.array(values["covariance_rad2"])
    sigma_arcsec = [entry["sigma_arcsec"] for entry in values["angles"].values()]
    assert np.sqrt(np.diagonal(covariance)) / ARCSEC == pytest.approx(sigma_arcsec)
    for entry in values["combinations"].values():
        assert sum(entry["variance_shares"].values()) == pytest.approx(1.0)


def test_a_sensor_at_the_zenith_has_no_azimuth_of_its_own(tmp_path, capsys):
    scenario = session(STILL, reference=True)
    sensors = {**scenario.star_sensors, "fore": replace(scenario.star_sensors["fore"], elevation_deg=90.0)}
    result = calibrate(tmp_path, capsys, replace(scenario, star_sensors=sensors))
    stated = {angle: result.values["angles"][f"star.fore.{angle}"] for angle in ("azimuth", "elevation", "roll")}
    assert stated["azimuth"]["sigma_arcsec"] is stated["roll"]["sigma_arcsec"] is stated["azimuth"]["observed"] is None
    assert set(observability(result).values()) == {"yes"}
    assert result.report.joinpath("installation.png").exists()
    saved = ALIGNMENT_FILE.load(result.alignment)
    true_dv = result.run.truth.stars["fore"].rotation_dv
    # 100" about the boresight in 61 exposures, fractions of an arcsecond across it.
    assert np.linalg.norm(log_rotation(saved.rotations_dv["star.fore"].T @ true_dv)) < 4.0 * 12.8 * ARCSEC


@pytest.mark.slow
def test_an_installation_far_from_the_configured_one_needs_a_wider_prior(tmp_path, capsys):
    """An installation 600″ off with a configured sigma of 20″ is rejected, and found with --prior-sigma."""
    far = session(STILL, sigma_arcsec=600.0)

    def with_small_sigmas(text: str) -> str:
        suite = yaml.safe_load(text)
        for sensor in suite["/**/ship_attitude"]["ros__parameters"]["star_sensors"].values():
            sensor |= {f"installation_sigma_{axis}_arcsec": 20.0 for axis in ("forward", "up", "right")}
        return yaml.safe_dump(suite)

    bag = tmp_path / "session.mcap"
    write_session(bag, far, suite=with_small_sigmas)
    line = usage_error(main, capsys, bag, "--out", tmp_path / "alignment.yaml")
    assert "no message of star.fore was used" in line
    assert "its installation error exceeds its sigma: use --prior-sigma" in line
    assert not (tmp_path / "alignment.yaml").exists()
    result = calibrate(tmp_path, capsys, far, ["--prior-sigma", "600"], suite=with_small_sigmas)
    for id_, truth in result.run.truth.stars.items():
        stated = result.values["angles"][f"star.{id_}.elevation"]
        true_deg = np.rad2deg(angles_from_rotation(truth.rotation_dv))[1]
        assert abs(stated["installed_deg"] - true_deg) * 3600.0 < 4.0 * stated["sigma_arcsec"] < 60.0
    assert observability(result)[AZIMUTH] == "no"


@pytest.mark.slow
def test_a_saved_alignment_does_not_count_again(tmp_path, capsys):
    """A configuration that names the file of an earlier session does not reduce the sigmas of the result."""
    scenario = session(STILL, reference=True)
    first = calibrate(tmp_path, capsys, scenario)

    def with_file(text: str) -> str:
        suite = yaml.safe_load(text)
        suite["/**/ship_attitude"]["ros__parameters"]["alignment_file"] = str(first.alignment)
        return yaml.safe_dump(suite)

    (tmp_path / "again").mkdir()
    again = calibrate(tmp_path / "again", capsys, scenario, suite=with_file)
    assert again.values == first.values


@pytest.mark.slow
@pytest.mark.parametrize("source", ["observations", "solution", "inertial_attitude"])
def test_every_input_of_a_star_sensor_serves(tmp_path, capsys, source):
    """Each input of the first sensor calibrates with stars of the real sky; the second sensor gives single stars."""
    stars = load_scenario(SCENARIOS / "paper_stars.yaml")
    sensors = {id_: replace(sensor, rate_hz=1.0) for id_, sensor in stars.star_sensors.items()}
    if source == "inertial_attitude":
        sensors["fore"] = replace(sensors["fore"], output="inertial_attitude")

    def by_solution(text: str) -> str:
        suite = yaml.safe_load(text)
        suite["/**/ship_attitude"]["ros__parameters"]["star_sensors"]["fore"]["input"] = "solution"
        return yaml.safe_dump(suite)

    scenario = replace(stars, duration_s=15.0, ins=replace(stars.ins, rate_hz=20.0), star_sensors=sensors)
    suite = {"suite": by_solution} if source == "solution" else {}
    result = calibrate(tmp_path, capsys, scenario, **suite)
    assert result.values["used"]["star.fore"] >= 14
    assert result.values["warnings"] == []
    for id_, truth in result.run.truth.stars.items():
        roll = result.values["angles"][f"star.{id_}.roll"]
        true_arcsec = np.rad2deg(wrap_pi(angles_from_rotation(truth.rotation_dv)[2])) * 3600.0
        # The sigma is 20" beforehand; the worst sensor measures to 100" / sqrt 15.
        assert abs(true_arcsec - roll["correction_arcsec"]) < 4.0 * roll["sigma_arcsec"] < 4.0 * 16.5


# -- bad input --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("leave_out", "text"),
    [
        (
            ("star/fore/horizon_attitude", "star/starboard/horizon_attitude"),
            "topic 'star/fore/horizon_attitude' of star sensor 'fore' is missing; found no star data",
        ),
        (
            ("star/starboard/horizon_attitude",),
            "topic 'star/starboard/horizon_attitude' of star sensor 'starboard' is missing; found star/fore/horizon",
        ),
        (("ins/imu",), "required topics ins/imu are missing; found"),
    ],
)
def test_a_bag_without_data_is_refused(tmp_path, capsys, leave_out, text):
    bag = tmp_path / "session.mcap"
    write_session(bag, session(STILL, duration_s=3.0), leave_out=leave_out)
    assert text in usage_error(main, capsys, bag, "--out", tmp_path / "alignment.yaml")
    assert list(tmp_path.iterdir()) == [bag]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"frame_id": "elsewhere"}, "no message of star.fore was used: frame "),
        ({"installation_sigma_up_arcsec": 0.0}, "'star_sensors.fore.installation_sigma_up_arcsec' = 0 keeps the inst"),
        ({"elevation_deg": 95.0}, "parameter 'star_sensors.fore.elevation_deg' = 95.0 deg is out of its range"),
    ],
)
def test_a_configuration_that_does_not_serve_is_refused(tmp_path, capsys, change, text):
    bag, config = tmp_path / "session.mcap", tmp_path / "suite.yaml"
    write_session(bag, session(STILL, duration_s=3.0), suite=None)
    configuration = suite_configuration(session(STILL))
    configuration["star_sensors"]["fore"] |= change
    config.write_text(yaml.safe_dump({"/**/ship_attitude": {"ros__parameters": configuration}}))
    assert text in usage_error(main, capsys, bag, "--out", tmp_path / "alignment.yaml", "--config", config)


def test_a_configuration_without_star_sensors_is_refused(tmp_path, capsys):
    bag, config = tmp_path / "session.mcap", tmp_path / "suite.yaml"
    write_session(bag, session(STILL, duration_s=3.0))
    config.write_text("/**/ship_attitude: {ros__parameters: {ins: {frame_id: ins}}}")
    line = usage_error(main, capsys, bag, "--out", tmp_path / "alignment.yaml", "--config", config)
    assert "the configuration has no star_sensors: there is nothing to calibrate" in line


def test_a_bag_without_configuration_is_refused(tmp_path, capsys):
    bag = tmp_path / "session.mcap"
    write_session(bag, session(STILL, duration_s=3.0), suite=None)
    line = usage_error(main, capsys, bag, "--out", tmp_path / "alignment.yaml")
    assert "no configuration suite.yaml is attached to the bag: give one by --config" in line


def test_absent_bag_and_output_over_it(tmp_path, capsys):
    absent = tmp_path / "absent.mcap"
    assert usage_error(main, capsys, absent, "--out", tmp_path / "a.yaml") == (
        f"calibrate_installation: {absent}: no such file or folder\n"
    )
    assert "the output would overwrite the input" in usage_error(main, capsys, absent, "--out", absent)


@pytest.mark.parametrize("text", ["0", "-3", "4000", "nan", "wide"])
def test_a_prior_that_is_none_is_refused(capsys, text):
    with pytest.raises(SystemExit) as caught:
        main(["session.mcap", "--out", "a.yaml", f"--prior-sigma={text}"])
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert f"'{text}' is not a sigma: expected 0.001 to 3600 arcsec" in captured.err
    assert captured.err.count("\n") == 1


def test_help_names_units(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "--prior-sigma ARCSEC" in text
    assert "Angles in degrees, corrections and sigmas (1 sigma) in arcseconds" in text

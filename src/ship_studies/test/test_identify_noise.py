"""The command ``identify_noise`` on simulated bags: the file that the suite loads, the texts, the exit codes."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_node.parameters.parameter_file import load_config
from ship_studies.ins_noise.identify_noise_command import main
from ship_testing.calibration_sessions import write_session
from ship_testing.noise_sessions import scenario
from ship_testing.usage_errors import usage_error

SHORT = scenario(600.0)
SHORT = replace(SHORT, ins=replace(SHORT.ins, rate_hz=2.5))
"""An INS with samples close enough for interpolation with the default configuration."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("noise") / "night.mcap"
    write_session(path, SHORT)
    return path


@pytest.mark.slow
def test_the_file_is_one_that_the_suite_loads(bag, tmp_path, capsys):
    out = tmp_path / "noise.yaml"
    assert main([str(bag), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    text = out.read_text(encoding="utf-8")
    config = load_config(ShipAttitudeConfig, out, "/ship_attitude")
    assert config.ins.model == "gauss_markov"
    written = yaml.safe_load(text)["/**/ship_attitude"]["ros__parameters"]["ins"]
    assert set(written) == {
        *("model", "white_sigma_arcsec", "tilt_sigma_arcsec", "tilt_time_s", "heading_sigma_arcsec", "heading_time_s")
    }
    assert config.ins.tilt_sigma_arcsec == written["tilt_sigma_arcsec"] > 0.0
    values = [line for line in text.splitlines() if line.startswith("      ") and "model" not in line]
    assert all(", 1 sigma [" in line for line in values)
    # Warnings about parameters that are not determined are in the file too.
    assert "# gauss_markov, tilt: 0.17 h are " in text
    assert "warning: gauss_markov, tilt: 0.17 h are " in printed
    assert "warning: gravity.deflection is none: the deflection of the vertical is part of the error" in printed
    assert "night.mcap: 122 star measurements, 61 epochs used over 0.17 h" in printed
    # The suite of this voyage requires no position fixes, but the bag contains them.
    assert "gauss_markov fits" in printed
    assert "parameters against" in printed


@pytest.mark.slow
def test_without_out_nothing_is_written(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([str(bag)]) == 0
    assert list(tmp_path.iterdir()) == []
    assert "parameters:" not in capsys.readouterr().out


def test_bad_input_is_reported_in_one_line(bag, tmp_path, capsys):
    write_session(tmp_path / "few.mcap", replace(SHORT, duration_s=100.0))
    line = usage_error(main, capsys, tmp_path / "few.mcap")
    assert "few.mcap: 11 epochs of stars: expected at least 50, better hours of them" in line
    write_session(
        tmp_path / "dark.mcap",
        replace(SHORT, duration_s=60.0),
        leave_out=("star/fore/horizon_attitude", "star/starboard/horizon_attitude"),
    )
    line = usage_error(main, capsys, tmp_path / "dark.mcap")
    assert "no star measurement was used (none received): the INS error is not observable" in line
    (tmp_path / "blind.yaml").write_text("ship_attitude: {ros__parameters: {ins: {frame_id: ins}}}\n")
    line = usage_error(main, capsys, bag, "--config", tmp_path / "blind.yaml")
    assert "the configuration has no star_sensors of ship_attitude" in line
    assert "the output would overwrite the input" in usage_error(main, capsys, bag, "--out", bag)

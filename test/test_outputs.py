"""Output paths of every command: checked first, and no existing file is overwritten."""

import os
from pathlib import Path

import pytest
import yaml

from ship_bags.commands import import_nmea as import_nmea_command
from ship_bags.commands import record as record_command
from ship_replay.commands import evaluate as evaluate_command
from ship_replay.commands import replay as replay_command
from ship_simulation import simulate_command
from ship_studies.axis_fit import axis_sightings_command, fit_axes_command
from ship_studies.ins_noise import identify_noise_command
from ship_studies.installation import calibrate_installation_command
from ship_studies.layout import layout_study_command

SCENARIO = {
    "start_utc": "2014-07-09T12:00:00Z",
    "duration_s": 3.0,
    "carrier": {"kind": "sinusoids"},
    "star_sensors": {},
}

# Case → command, arguments that name a missing input, option of the output, name of the output file.
FILES = {
    "simulate": (simulate_command.main, ["absent"], "--out", "out.mcap"),
    "replay": (replay_command.main, ["absent"], "--out", "out.mcap"),
    "replay --verify": (replay_command.main, ["absent", "--verify"], "--out", "out.mcap"),
    "import_nmea": (import_nmea_command.main, ["--ins", "absent"], "--out", "out.mcap"),
    "axis_sightings": (axis_sightings_command.main, ["absent"], "--out", "out.csv"),
    "calibrate_installation": (calibrate_installation_command.main, ["absent"], "--out", "out.yaml"),
    "identify_noise": (identify_noise_command.main, ["absent"], "--out", "out.yaml"),
    "evaluate --json": (evaluate_command.main, ["absent"], "--json", "out.json"),
    "evaluate --figure": (evaluate_command.main, ["absent"], "--figure", "out.png"),
    "record": (record_command.main, [], "--out", "out.mcap"),
    "record --recover": (record_command.main, ["--recover", "absent"], "--out", "out.mcap"),
}
FOLDERS = {
    "layout_study": (layout_study_command.main, [], "--out", "layout_study.html"),
    "fit_axes": (fit_axes_command.main, ["absent"], "--out", "axes.yaml"),
    "replay --report": (replay_command.main, ["absent", "--out", "result.mcap"], "--report", "result.html"),
    "calibrate_installation --report": (
        calibrate_installation_command.main,
        ["absent", "--out", "result.yaml"],
        "--report",
        "installation.json",
    ),
}


def link_to_device(path: Path) -> None:
    path.symlink_to("/dev/full")


def link_to_nothing(path: Path) -> None:
    path.symlink_to("nothing")


def file(path: Path) -> None:
    path.write_text("precious")


TAKEN = {
    file: "already exists: use --force to overwrite",
    Path.mkdir: "is a folder: expected a file",
    os.mkfifo: "is a pipe: expected a file",
    link_to_device: "is a device: expected a file",
    link_to_nothing: "is a link to nothing: expected a file",
}


def refusal(capsys: pytest.CaptureFixture[str], main, arguments: list[str]) -> str:
    """Return the one-line error of a command, which ends with exit code 2."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    paths = sorted(folder.rglob("*"))
    return {str(p): (p.lstat().st_mode, p.read_bytes() if p.is_file() else b"") for p in paths}


@pytest.mark.parametrize("take", TAKEN, ids=lambda take: take.__name__)
@pytest.mark.parametrize("case", FILES)
def test_an_existing_output_is_refused_before_the_input_is_read(
    case, take, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    main, arguments, option, name = FILES[case]
    take(tmp_path / name)
    before = state(tmp_path)
    line = refusal(capsys, main, [*arguments, option, name])
    assert line.endswith(f": {name}: {TAKEN[take]}\n")
    if take is not file:
        # With --force the error is the same.
        assert refusal(capsys, main, [*arguments, option, name, "--force"]) == line
    assert state(tmp_path) == before


@pytest.mark.parametrize("case", FILES)
def test_a_missing_folder_is_named(case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main, arguments, option, name = FILES[case]
    line = refusal(capsys, main, [*arguments, option, f"none/deeper/{name}"])
    assert line.endswith(f": none/deeper/{name}: cannot be written: there is no folder none/deeper\n")
    file(tmp_path / "taken")
    line = refusal(capsys, main, [*arguments, option, f"taken/{name}"])
    assert line.endswith(f": taken/{name}: cannot be written: there is no folder taken\n")


@pytest.mark.parametrize("take", TAKEN, ids=lambda take: take.__name__)
@pytest.mark.parametrize("case", FOLDERS)
def test_a_file_in_a_folder_is_not_overwritten(case, take, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main, arguments, option, name = FOLDERS[case]
    (tmp_path / "folder").mkdir()
    take(tmp_path / "folder" / name)
    before = state(tmp_path)
    assert refusal(capsys, main, [*arguments, option, "folder"]).endswith(f": folder/{name}: {TAKEN[take]}\n")
    assert state(tmp_path) == before


@pytest.mark.parametrize("case", FOLDERS)
def test_an_output_folder_that_is_a_file_is_refused(case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main, arguments, option, _ = FOLDERS[case]
    file(tmp_path / "taken")
    line = refusal(capsys, main, [*arguments, option, "taken/deeper"])
    assert line.endswith(": taken: is a file: expected a folder\n")
    line = refusal(capsys, main, [*arguments, option, "/dev/full", "--force"])
    assert line.endswith(": /dev/full: is a device: expected a folder\n")


def test_force_overwrites_a_file_only_when_the_work_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO))
    (tmp_path / "broken.yaml").write_text("duration_s: x\n")
    file(tmp_path / "out.mcap")
    refusal(capsys, simulate_command.main, ["broken.yaml", "--out", "out.mcap", "--force"])
    assert (tmp_path / "out.mcap").read_text() == "precious"
    assert simulate_command.main(["scenario.yaml", "--out", "out.mcap", "--force"]) == 0
    assert (tmp_path / "out.mcap").read_bytes().startswith(b"\x89MCAP0")
    # A link is replaced, and what it points to stays.
    file(tmp_path / "precious")
    (tmp_path / "link.mcap").symlink_to("precious")
    assert simulate_command.main(["scenario.yaml", "--out", "link.mcap", "--force"]) == 0
    assert (tmp_path / "precious").read_text() == "precious"
    assert (tmp_path / "link.mcap").read_bytes() == (tmp_path / "out.mcap").read_bytes()

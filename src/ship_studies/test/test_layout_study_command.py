"""The executable ``layout_study``: its output, and its errors for bad input."""

import csv
import re
from pathlib import Path

import pytest

from ship_estimation.parameters.schema import describe
from ship_studies.layout import layout_study_command
from ship_studies.layout.config import LayoutStudyConfig, study_config
from ship_studies.layout.layout_study_command import main

pytestmark = pytest.mark.slow  # the shared fixture is slow

THREE_SENSORS = """\
ship_roll_deg: 5.0
sensors:
  port: {azimuth_deg: -60.0, elevation_deg: 40.0}
  starboard: {azimuth_deg: 60.0, elevation_deg: 40.0, sigma_forward_arcsec: 50.0}
  aft: {azimuth_deg: 180.0, elevation_deg: 30.0}
common: {refraction_sigma_arcsec: 0.5}
"""


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "new" / "folder"
    assert main(["--out", str(folder)]) == 0
    return folder


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_everything_is_written(study_folder: Path) -> None:
    names = {path.name for path in study_folder.iterdir()}
    assert names == {
        "layout_study.html", "layout.csv", "error_budget.csv", "error_map.csv", "azimuth_scan.csv",
        "sources_at_operating_point.csv", "figures_1_to_6.csv", "layout.png", "azimuth.png", "map_fore.png",
        "map_starboard.png", *(f"figure_{number}.png" for number in range(1, 7)),
    }  # fmt: skip
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in study_folder.glob("*.png"))


def test_page_is_self_contained(study_folder: Path) -> None:
    page = (study_folder / "layout_study.html").read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert len(sources) == 10
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "http" not in page
    assert "$" not in re.sub(r"base64,[^\"]*", "", page)


def test_page_and_tables_agree(study_folder: Path) -> None:
    page = (study_folder / "layout_study.html").read_text(encoding="utf-8")
    joint = [row for row in read_rows(study_folder / "layout.csv") if row["sensor"] == "joint"]
    assert [row["layout"] for row in joint] == ["given", "recommended"]
    for row in joint:
        assert f'<td class="r">{float(row["heading_sigma_arcsec"]):.2f}</td>' in page
    assert "<b>119°</b>" in page
    assert "physical: R(A0, E0, γ0)" in page
    assert "as computed in [Z14]: R(A0, E0, γ0)" in page


def test_sources_at_the_operating_point(study_folder: Path) -> None:
    """models.md §3, physical: Δγs = 100″ gives 35.01, 49.75, 61.64″ at A0 = 0 and 141.42, 0, 100″ at A0 = 90."""
    found = {
        (row["reading"], row["installation_azimuth_deg"], row["source"]): [
            abs(float(row[f"{angle}_arcsec"])) for angle in ("heading", "pitch", "roll")
        ]
        for row in read_rows(study_folder / "sources_at_operating_point.csv")
    }
    assert found["physical", "0.00000", "Δγs"] == pytest.approx([35.01, 49.75, 61.64], abs=0.005)
    assert found["physical", "90.00000", "Δγs"] == pytest.approx([141.42, 0.0, 100.0], abs=0.005)
    assert found["paper", "90.00000", "Δγ0"] == pytest.approx([0.0, 0.0, 20.0], abs=1e-4)
    assert len(found) == 2 * 4 * 6


def test_any_number_of_sensors_in_the_order_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = tmp_path / "three.yaml"
    layout.write_text(THREE_SENSORS)
    assert main([str(layout), "--out", str(tmp_path / "out")]) == 0
    assert "recommended azimuths [deg from the bow]: port 300, starboard" in capsys.readouterr().out
    names = [row["sensor"] for row in read_rows(tmp_path / "out" / "layout.csv")][:4]
    assert names == ["port alone", "starboard alone", "aft alone", "joint"]
    assert (tmp_path / "out" / "map_aft.png").exists()


def test_one_sensor_has_no_recommended_azimuth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = tmp_path / "one.yaml"
    layout.write_text("sensors:\n  lone: {azimuth_deg: 0.0, elevation_deg: 90.0}\n")
    assert main([str(layout), "--out", str(tmp_path)]) == 0
    assert "recommended" not in capsys.readouterr().out
    assert "add a second" in (tmp_path / "layout_study.html").read_text(encoding="utf-8")


SENSOR = "sensors:\n  a: {azimuth_deg: 0.0, elevation_deg: 35.0}\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("sensors:\n  a:\n    azimuth_deg: 0.0\n", ":3: parameter 'sensors.a.elevation_deg'"),
        (
            "sensors:\n  a: {azimuth_deg: 0.0,\n      elevation_deg: 91.0}\n",
            "bad.yaml:3: .*91.0 deg is out of its range",
        ),
        ("sensors:\n  a: {azimuth_deg: 0.0, elevation_deg: .nan}\n", ":2: .*must be finite"),
        (SENSOR + "common:\n  heading: 1.0\n", ":4: parameter 'common.heading' is unknown: expected one of"),
        ("sensors:\n  a/b: {azimuth_deg: 0.0, elevation_deg: 35.0}\n", ":2: .*letters, digits"),
        ("sensors: 3\n", "must be a group"),
        (SENSOR + "ship_pitch_deg: -40.0\n", "-5.0 deg above the horizon, expected at least 5 deg"),
        (SENSOR + "figures: {error_roll_arcsec: fast}\n", ":3: .*must be of type float, got 'fast'"),
        ("sensors: [\n", "bad.yaml"),
        ("", "bad.yaml:1: expected 'name: value'"),
    ],
)
def test_bad_layout_is_one_line(text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = tmp_path / "bad.yaml"
    layout.write_text(text)
    assert main([str(layout), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"layout_study: {layout}")
    assert re.search(reason, error)
    assert not (tmp_path / "out").exists()


def test_existing_output_files_are_refused_before_the_study(study_folder: Path, tmp_path: Path) -> None:
    assert {path.name for path in study_folder.iterdir()} == set(layout_study_command.output_names(study_config({})))
    before = {path: path.read_bytes() for path in study_folder.iterdir()}
    assert main(["--out", str(study_folder)]) == 2
    assert {path: path.read_bytes() for path in study_folder.iterdir()} == before
    (tmp_path / "figure_3.png").write_bytes(b"precious")
    assert main(["--out", str(tmp_path)]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["figure_3.png"]


def test_files_that_cannot_be_used_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "absent.yaml"), "--out", str(tmp_path)]) == 2
    assert "absent.yaml: cannot be read" in capsys.readouterr().err
    (tmp_path / "taken").touch()
    assert main(["--out", str(tmp_path / "taken")]) == 2
    assert capsys.readouterr().err == f"layout_study: {tmp_path / 'taken'}: is a file: expected a folder\n"


def test_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main([])
    assert left.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(SystemExit) as left:
        main(["--help"])
    assert left.value.code == 0
    shown = capsys.readouterr().out
    for key in describe(LayoutStudyConfig):
        assert f" {key.name} " in shown
    assert "exit code: 0" in shown

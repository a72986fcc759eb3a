"""Executable ``fit_axes``: its files, and its messages for bad input."""

import csv
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_studies.axis_fit.fit_axes_command import OUTPUT_NAMES, main
from ship_studies.axis_fit.sightings import COLUMNS, azimuth_and_elevation, read_sightings
from ship_testing.axis_sightings import ERRORS, random_angles, simulate_sightings
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.optical_axis.calibration import SAVED_NAMES

HEADER = "observation,encoder_azimuth_deg,encoder_elevation_deg,azimuth_offset_deg,elevation_offset_deg"
COUNT = 40
OUTLIER = 11


def table_rows() -> list[list[float]]:
    """Return forty sightings with 5″ per component, one of them displaced by 2′."""
    rng = np.random.default_rng(1)
    sightings = simulate_sightings(rng, ERRORS, random_angles(rng, COUNT, (10.0, 85.0)), 5.0)
    azimuth, elevation = azimuth_and_elevation(sightings.direction_d)
    elevation[OUTLIER] += 120.0 * ARCSEC
    offsets = wrap_pi(azimuth - sightings.azimuth), elevation - sightings.elevation
    return np.rad2deg([sightings.azimuth, sightings.elevation, *offsets]).T.tolist()


def write_table(path: Path, rows: list[list[float]] | None = None, header: str = HEADER) -> Path:
    lines = [f"S{number}," + ",".join(map(repr, row)) for number, row in enumerate(rows or table_rows())]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fit")
    assert main([str(write_table(folder / "sightings.csv")), "--out", str(folder / "new" / "out")]) == 0
    return folder / "new" / "out"


def test_everything_is_written(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "axes.yaml", "axes.csv", "correlation.csv", "residuals.csv", "residuals.png", "over_angles.png", "sky.png",
        "terms.png", "calibration.yaml",
    }  # fmt: skip
    assert names == set(OUTPUT_NAMES)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in folder.glob("*.png"))


def test_tables_are_consistent(folder: Path) -> None:
    document = yaml.safe_load((folder / "axes.yaml").read_text(encoding="utf-8"))
    terms = {row["term"]: row for row in rows_of(folder / "axes.csv")}
    assert tuple(terms) == NAMES
    assert document["covariance_of"] == [name for name in NAMES if terms[name]["fitted"] == "yes"] == list(NAMES[:-1])
    sigmas = np.sqrt(np.diagonal(document["covariance_rad2"])) / ARCSEC
    for name, sigma in zip(NAMES[:-1], sigmas, strict=True):
        assert float(terms[name]["value_arcsec"]) == pytest.approx(document["values_arcsec"][name], abs=1e-5)
        assert float(terms[name]["sigma_arcsec"]) == pytest.approx(document["sigma_arcsec"][name], abs=1e-5)
        assert document["sigma_arcsec"][name] == pytest.approx(sigma)
        assert abs(document["values_arcsec"][name] - getattr(ERRORS, name) / ARCSEC) < 4.0 * sigma
    assert terms["flexure"]["sigma_arcsec"] == ""
    assert [float(row[row["term"]]) for row in rows_of(folder / "correlation.csv")] == pytest.approx([1.0] * 6)

    residuals = rows_of(folder / "residuals.csv")
    assert [row["observation"] for row in residuals if row["outlier"] == "yes"] == document["outliers"]
    assert f"S{OUTLIER}" in document["outliers"]
    sizes = np.array([float(row["after_arcsec"]) for row in residuals])
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(document["rms_after_arcsec"], abs=1e-4)
    left_out = np.array([[float(row[f"left_out_{side}_arcsec"]) for side in ("right", "up")] for row in residuals])
    assert np.sqrt(np.mean(np.sum(left_out**2, axis=1))) == pytest.approx(document["rms_left_out_arcsec"], abs=1e-4)
    assert document["sighting_count"] == COUNT


def test_the_same_sightings_give_the_same_files(folder: Path, tmp_path: Path) -> None:
    assert main([str(write_table(tmp_path / "again.csv")), "--out", str(tmp_path)]) == 0
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


def test_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [row for row in table_rows() if row[1] < 40.0]
    table = write_table(tmp_path / "low.csv", rows)
    assert main([str(table), "--out", str(tmp_path / "out"), "--fix", "beta_x=-2.5"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^beta_x +-2\.50 +fixed   tilt of the vertical axis", shown, re.MULTILINE)
    assert re.search(r"^without a model +\d", shown, re.MULTILINE)
    assert "poorly separated: g, c, I: g +" in shown
    assert f"{len(rows)} sightings, 0 of them plunged; elevations " in shown
    one_place = [[10.0 + 1e-7 * number, 40.0, 0.01, 0.01] for number in range(6)]
    assert main([str(write_table(tmp_path / "one.csv", one_place)), "--out", str(tmp_path)]) == 0
    assert "not observable: 4 combinations of g, h, c, I, beta_x, beta_y" in capsys.readouterr().out


def test_zero_points_may_be_degrees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = [[row[0] + 137.0, row[1] - 10.0, row[2] - 137.0, row[3] + 10.0] for row in table_rows()]
    outcomes = []
    for name, rows in (("near", table_rows()), ("far", moved)):
        assert main([str(write_table(tmp_path / f"{name}.csv", rows)), "--out", str(tmp_path / name)]) == 0
        outcomes.append(yaml.safe_load((tmp_path / name / "axes.yaml").read_text(encoding="utf-8")))
    near, far = (np.array(list(outcome["values_arcsec"].values())) for outcome in outcomes)
    np.testing.assert_allclose(far - near, [137.0 * 3600.0, -36000.0, 0.0, 0.0, 0.0, 0.0, 0.0], rtol=0.0, atol=1e-3)
    assert (tmp_path / "far" / "terms.png").read_bytes() != (tmp_path / "near" / "terms.png").read_bytes()
    assert "RMS" in capsys.readouterr().out


@pytest.mark.slow
def test_flexure_is_fitted_if_requested(tmp_path: Path) -> None:
    table = write_table(tmp_path / "s.csv")
    assert main([str(table), "--out", str(tmp_path), "--flexure", "--fix", "c", "--fix", "I=-25"]) == 0
    document = yaml.safe_load((tmp_path / "axes.yaml").read_text(encoding="utf-8"))
    assert document["covariance_of"] == ["g", "h", "beta_x", "beta_y", "flexure"]
    assert document["values_arcsec"]["c"] == 0.0
    assert document["values_arcsec"]["I"] == pytest.approx(-25.0)


def test_yaml_and_csv_are_equal(tmp_path: Path) -> None:
    rows = table_rows()
    rows[0][0] += 360.0
    entries = [{"observation": f"S{number}", **dict(zip(COLUMNS, row, strict=True))} for number, row in enumerate(rows)]
    listed = tmp_path / "sightings.yaml"
    listed.write_text(yaml.safe_dump({"sightings": entries}))
    first, second = read_sightings(listed), read_sightings(write_table(tmp_path / "sightings.csv", rows))
    assert first.labels == second.labels == tuple(f"S{number}" for number in range(COUNT))
    np.testing.assert_array_equal(first.azimuth, second.azimuth)
    np.testing.assert_array_equal(first.direction_d, second.direction_d)


def test_rows_without_numbers_are_counted_and_other_columns_ignored(tmp_path: Path) -> None:
    table = tmp_path / "s.csv"
    names = ["elevation_offset_deg", "jd_utc", *list(COLUMNS)[:3]]
    rows = "".join(f"0.1, 2457652.5, {azimuth}, 40.0, -0.2\n\n" for azimuth in (350.0, 351.0))
    table.write_text("\ufeff" + ", ".join(names) + "\n" + rows)
    read = read_sightings(table)
    assert read.labels == ("1", "2")
    assert np.rad2deg(np.stack(azimuth_and_elevation(read.direction_d))[:, 0]) == pytest.approx([349.8, 40.1])


ROW = "S{},{},{},0.01,0.01\n"
GOOD = "".join(ROW.format(number, 10.0 * number, 2.0 * number) for number in range(1, 11))


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("s.csv", "", "columns missing: encoder_azimuth_deg, .*found: nothing"),
        ("s.csv", HEADER + "\n", "no sightings"),
        ("s.csv", HEADER.replace("_deg", "_rad") + "\n" + GOOD, "columns missing: .*degrees.*found: .*azimuth_rad"),
        ("s.csv", HEADER + "\n" + GOOD + "S11,20.0,nan,0.01,0.01\n", ":12: encoder_elevation_deg is 'nan'"),
        ("s.csv", HEADER + "\n" + GOOD + "S11,20.0,30.0,,0.01\n", ":12: azimuth_offset_deg is ''"),
        ("s.csv", HEADER + "\n" + GOOD + "S11,20.0,30.0,fast,0.01\n", ":12: azimuth_offset_deg is 'fast'"),
        (
            "s.csv",
            HEADER + "\n" + GOOD + "S11,20.0,300.0,0.01,0.01\n",
            r":12: .* = 300 is out of its range \[-90, 270\]",
        ),
        ("s.csv", HEADER + "\n" + GOOD + "S11,20.0,30.0\n", ":12: expected 5 values"),
        ("s.csv", HEADER + "\n" + GOOD + "S11,20.0,30.0,1,2,3\n", ":12: expected 5 values"),
        ("s.csv", HEADER + "\n" + GOOD + 'S11,"20.0,30.0\n', ":12: unexpected end of data"),
        ("s.csv", HEADER + "\n" + GOOD[: GOOD.index("S6")], "5 sightings for 6 terms: expected at least 6"),
        ("s.csv", HEADER + "\n" + "".join(ROW.format(k, 0.6 * k, 0.1 * k) for k in range(9)), "look like radians"),
        (
            "s.csv",
            HEADER
            + "\n"
            + "".join(f"{k},{9 * k},{8 * k},{30 + (-1) ** k * 9},{(-1) ** k * 7}\n" for k in range(1, 11)),
            "scatter by [0-9.]+ deg about any axis errors: expected offsets",
        ),
        ("s.yaml", "sightings: [\n", "not YAML"),
        ("s.yaml", "rows: []\n", "expected 'sightings:' with a list"),
        ("s.yaml", "sightings: [3]\n", "sighting 1: expected encoder_azimuth_deg, .* got 3"),
        ("s.yml", "sightings: [{encoder_azimuth_deg: 3.0}]\n", "sighting 1: columns missing: encoder_elevation_deg"),
        ("s.mcap", "", "sightings are read from .csv, .yaml or .yml"),
    ],
)
def test_bad_table_is_one_line(
    name: str, text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / name
    table.write_text(text)
    assert main([str(table), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"fit_axes: {table}")
    assert re.search(reason, error.strip()), error
    assert not (tmp_path / "out").exists()


def test_yaml_numbers_must_be_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "s.yaml"
    for wrong in (True, None, [1.0], float("inf")):
        table.write_text(yaml.safe_dump({"sightings": [dict.fromkeys(COLUMNS, wrong)]}))
        assert main([str(table), "--out", str(tmp_path)]) == 2
        assert "sighting 1: encoder_azimuth_deg is " in capsys.readouterr().err


def test_files_that_cannot_be_used_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "absent.csv"), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"fit_axes: {tmp_path / 'absent.csv'}: No such file or directory\n"
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    assert main([str(tmp_path / "binary.csv"), "--out", str(tmp_path)]) == 2
    assert "binary.csv: not a text in UTF-8" in capsys.readouterr().err
    (tmp_path / "taken").touch()
    assert main([str(write_table(tmp_path / "s.csv")), "--out", str(tmp_path / "taken")]) == 2
    assert capsys.readouterr().err == f"fit_axes: {tmp_path / 'taken'}: is a file: expected a folder\n"


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--fix", "K"], "'K' is not a term: expected one of g, h, c, I, beta_x, beta_y, flexure"),
        (["--fix", "c=wide"], "'wide' is not a value of 'c'"),
        (["--fix", "c="], "'' is not a value of 'c'"),
        (["--fix", "c=nan"], "expected a finite number of arcsec"),
    ],
)
def test_bad_options_are_one_line(options: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["s.csv", "--out", "out", *options])
    assert left.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error


def test_options_that_contradict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = str(write_table(tmp_path / "s.csv"))
    assert main([table, "--out", str(tmp_path), "--flexure", "--fix", "flexure=3"]) == 2
    assert "contradict each other" in capsys.readouterr().err
    every = [argument for name in NAMES for argument in ("--fix", name)]
    assert main([table, "--out", str(tmp_path), *every]) == 2
    assert "no term to fit" in capsys.readouterr().err


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["--help"])
    assert left.value.code == 0
    shown = capsys.readouterr().out
    for word in (*COLUMNS, *NAMES, "[arcsec", "[deg]", "exit code: 0"):
        assert word in shown


def test_shared_errors_are_in_the_calibration_file(tmp_path: Path) -> None:
    """The saved tilt has a sigma of 20″ if the rows share a base rotation error of 20″, and below 3″ without it."""
    rows = table_rows()
    header = f"{HEADER},time_s,group,group_sigma_arcsec"
    lines = [
        f"S{number}," + ",".join(map(repr, row)) + f",{1.4e9 + number},night,20.0" for number, row in enumerate(rows)
    ]
    table = tmp_path / "grouped.csv"
    table.write_text("\n".join([header, *lines]) + "\n")
    assert main([str(table), "--out", str(tmp_path / "grouped"), "--serial", "T7"]) == 0
    assert main([str(write_table(tmp_path / "plain.csv")), "--out", str(tmp_path / "plain")]) == 0
    grouped, plain = (CALIBRATION_FILE.load(tmp_path / name / "calibration.yaml") for name in ("grouped", "plain"))
    rows_of_tilt = [SAVED_NAMES.index(name) for name in ("beta_x", "beta_y")]
    tilt_arcsec = [np.sqrt(np.diagonal(prior.covariance))[rows_of_tilt] / ARCSEC for prior in (grouped, plain)]
    assert tilt_arcsec[0] == pytest.approx([20.0, 20.0], abs=1.0)
    assert np.all(tilt_arcsec[1] < 3.0)
    assert (grouped.serial, grouped.time_ns) == ("T7", round((1.4e9 + COUNT - 1) * 1e9))
    # Without times in the table, the age of the calibration is unknown.
    assert plain.time_ns == 0
    fitted = yaml.safe_load((tmp_path / "grouped" / "axes.yaml").read_text(encoding="utf-8"))
    np.testing.assert_allclose(grouped.covariance[:6, :6], fitted["covariance_rad2"], rtol=1e-12)
    np.testing.assert_array_equal(grouped.covariance[6:], 0.0)


def test_no_sigma_with_unstated_shared_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    rows = np.array(table_rows() * 3)
    rows[:, 0] += np.repeat([0.0, 0.01, 0.02], COUNT)
    # The elevations contain a random walk of the base with 6″ per row.
    rows[:, 3] += np.cumsum(rng.normal(0.0, 6.0, len(rows))) / 3600.0
    out = tmp_path / "out"
    out.mkdir()
    (out / "calibration.yaml").write_text("of an earlier table")
    assert main([str(write_table(tmp_path / "s.csv", rows.tolist())), "--out", str(out), "--force"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^beta_x +-?[0-9.]+ +unknown", shown, re.MULTILINE)
    assert "no sigma: the residuals of neighbouring sightings are correlated" in shown
    assert "not written: calibration.yaml, because no sigma is known" in shown
    assert not (out / "calibration.yaml").exists()
    document = yaml.safe_load((out / "axes.yaml").read_text(encoding="utf-8"))
    assert document["sigma_arcsec"] is None
    assert document["covariance_rad2"] is None
    assert {row["sigma_arcsec"] for row in rows_of(out / "axes.csv")} == {""}


def test_repeated_rows_count_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, rows in (("once", table_rows()), ("twice", [*table_rows(), *table_rows()[:7]])):
        assert main([str(write_table(tmp_path / f"{name}.csv", rows)), "--out", str(tmp_path / name)]) == 0
    shown = capsys.readouterr().out
    assert "repeated, counted once: observation S40 (as S0)" in shown
    once, twice = (yaml.safe_load((tmp_path / name / "axes.yaml").read_text()) for name in ("once", "twice"))
    assert once.pop("repeated") == []
    assert len(twice.pop("repeated")) == 7
    assert once == twice


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "text"),
    [
        (lambda row: row, None),
        (lambda row: [*row[:2], row[2] * math.cos(math.radians(row[1])), row[3]], "already multiplied by cos E"),
        (lambda row: [*row[:2], -row[2], row[3]], "the opposite sign of elevation_offset_deg"),
        (lambda row: [*row[:3], -row[3]], "the opposite sign of elevation_offset_deg"),
    ],
)
def test_wrong_offset_conventions_are_reported(
    changed: Callable[[list[float]], list[float]], text: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(tmp_path / "s.csv", [changed(row) for row in table_rows()])
    assert main([str(table), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    # No sighting shows whether both signs are wrong, so the direction of the first sighting is printed for a check.
    assert "observation S0 has the true direction" in shown
    assert ("warning: " in shown) == (text is not None)
    assert (tmp_path / "out" / "calibration.yaml").exists() == (text is None)
    if text is not None:
        assert text in shown


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("slow_right_arcsec:hull:600", "1.0", "slow error 'hull:600': expected columns slow_right_arcsec:NAME:T"),
        ("slow_right_arcsec:hull:long,slow_up_arcsec:hull:long", "1.0,1.0", "correlation time 'long': expected sec"),
        ("slow_right_arcsec:hull:nan,slow_up_arcsec:hull:nan", "1.0,1.0", "correlation time 'nan': expected seconds"),
        ("slow_right_arcsec:hull:600,slow_up_arcsec:hull:600", "1.0,1.0", "columns missing: time_s"),
        ("slow_right_arcsec:hull:inf,slow_up_arcsec:hull:inf", "nan,1.0", "is 'nan': expected a finite number of arc"),
        ("group", "a", "columns missing: group, group_sigma_arcsec belong together"),
    ],
)
def test_unreadable_columns_of_shared_errors(
    column: str, value: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "s.csv"
    rows = [",".join(map(repr, row)) for row in table_rows()]
    table.write_text("\n".join([f"{HEADER},{column}", *(f"S{n},{row},{value}" for n, row in enumerate(rows))]) + "\n")
    assert main([str(table), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error

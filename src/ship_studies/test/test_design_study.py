"""Executable ``design_study``: its numbers, its files, and its messages for bad input."""

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_studies.design.config import W18, study_config
from ship_studies.design.design_study_command import main, output_names
from ship_studies.design.study import DesignStudy, compute_study

LIGHTS = {"a": {"right_deg": 2.0, "up_deg": 1.0, "distance_m": 1000.0}}
DRONE = {"rtk": {"sigma_m": 0.02}}
ONE_DRONE: dict[str, Any] = {
    "optical_axis": {"telescope": {"telescope_id": "t", "focal_length_m": 0.1}, "beacons": {"a": DRONE}},
    "lights": LIGHTS,
}


@pytest.fixture(scope="module", name="paper")
def _paper() -> DesignStudy:
    return compute_study(study_config(W18))


def test_the_papers_design(paper: DesignStudy) -> None:
    """models.md §5: bound for one epoch 2.25" in azimuth · cos E, 2.64" in elevation, 3.47" in all."""
    assert paper.given_arcsec == pytest.approx([2.25, 2.64, 3.47], rel=0.015)
    assert 0.88 <= paper.advised_arcsec[2] / paper.given_arcsec[2] <= 0.95
    assert paper.unaided_arcsec > 1000.0
    assert paper.meets_requirement


def test_sources_add_up_to_the_error(paper: DesignStudy) -> None:
    for which in ("given_arcsec", "advised_arcsec"):
        squares = sum(getattr(source, which) ** 2 for source in paper.budget)
        assert np.sqrt(squares) == pytest.approx(getattr(paper, which), rel=1e-9)


def test_sweeps_pass_through_the_design(paper: DesignStudy) -> None:
    sweeps = {sweep.name: sweep for sweep in paper.sweeps}
    assert list(sweeps) == ["distance", "separation", "focal_length", "pixel", "lever", "rtk", "principal_point"]
    for name, sweep in sweeps.items():
        if sweep.given > 0.0:
            at_design = np.interp(np.log(sweep.given), np.log(sweep.values), sweep.sigma_arcsec)
            assert at_design == pytest.approx(paper.given_arcsec[2], rel=1e-3), name
        both = np.isfinite(sweep.best_arcsec)
        assert both.any() == (name != "separation")
        # The given positions are within the limits, so they are never better than the best positions.
        assert np.all(sweep.best_arcsec[both] <= 1.001 * sweep.sigma_arcsec[both]), name
    # The RTK error falls with the distance and the refraction error rises: the best distance is in between.
    assert 0 < np.argmin(sweeps["distance"].sigma_arcsec) < len(sweeps["distance"].values) - 1
    for growing in ("pixel", "lever", "rtk", "principal_point"):
        assert np.all(np.diff(sweeps[growing].sigma_arcsec) > 0.0), growing
    for falling in ("separation", "focal_length"):
        assert np.all(np.diff(sweeps[falling].sigma_arcsec) < 0.0), falling


def test_error_of_the_principal_point_is_that_of_a_shift(paper: DesignStudy) -> None:
    """No residual shows the shift: a sigma s per axis adds √2 s / 2 km to the pointing error, independent of the
    rest."""
    telescope = paper.config.optical_axis.telescope
    shifted = replace(telescope, lens=replace(telescope.lens, sigma_m=0.1))
    config = replace(paper.config, optical_axis=replace(paper.config.optical_axis, telescope=shifted))
    shift_arcsec = np.sqrt(2.0) * np.rad2deg(0.1 / 2000.0) * 3600.0
    expected_arcsec = np.hypot(paper.given_arcsec[2], shift_arcsec)
    assert compute_study(config).given_arcsec[2] == pytest.approx(expected_arcsec, rel=0.01)


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "new"
    assert main(["--out", str(folder)]) == 0
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_everything_is_written_and_looked_for_before(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == set(output_names())
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in folder.glob("*.png"))
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main(["--out", str(folder)]) == 2
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_page_contains_the_tables(folder: Path, paper: DesignStudy) -> None:
    page = (folder / "design_study.html").read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', page)
    assert len(sources) == 2
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "$" not in re.sub(r"base64,[^\"]*", "", page)
    sums = [row for row in rows_of(folder / "error_budget.csv") if row["source"] == "root sum of squares"]
    assert [row["places"] for row in sums] == ["given", "best"]
    for row in sums:
        assert f"<b>{float(row['on_sky_arcsec']):.2f}″</b>" in page
    places = rows_of(folder / "places.csv")
    assert [row["beacon"] for row in places] == ["a", "b", "a", "b"]
    assert float(places[0]["distance_m"]) == 2000.0
    # The ship heads North and the theodolite points abeam, ten degrees up.
    assert float(places[2]["east_m"]) > 10.0 * abs(float(places[2]["north_m"]))


def write(path: Path, values: Any) -> Path:
    path.write_text(values if isinstance(values, str) else yaml.safe_dump(values))
    return path


@pytest.mark.slow
def test_a_requirement_that_is_not_met_is_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = ONE_DRONE | {"required_arcsec": 0.5}
    values["optical_axis"] = values["optical_axis"] | {"escort": {"elevation_min_deg": 40.0}}
    assert main([str(write(tmp_path / "one.yaml", values)), "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert "required 0.5 arcsec" in printed
    assert "limits reached: elevation_min_deg" in printed
    page = (tmp_path / "out" / "design_study.html").read_text(encoding="utf-8")
    assert "is <b>not</b> met" in page
    assert "No position of the drones is within the limits: elevation_min_deg leaves none" in page


def one_drone_with(**values: Any) -> dict[str, Any]:
    return ONE_DRONE | values


OPTICS = {"telescope_id": "t", "focal_length_m": 0.1}


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (one_drone_with(lights={}), r"'optical_axis.beacons.a': expected 'a' under lights too"),
        (
            one_drone_with(lights=LIGHTS | {"b": LIGHTS["a"]}),
            r":\d+: parameter 'lights.b': expected 'b' under optical_axis",
        ),
        (
            one_drone_with(lights={"a": LIGHTS["a"] | {"up_deg": 9.0}}),
            r"'lights.a': it is 9.21 deg from the telescope's axis",
        ),
        (
            one_drone_with(lights={"a": LIGHTS["a"] | {"distance_m": float("nan")}}),
            r"'lights.a.distance_m' must be finite",
        ),
        (
            one_drone_with(optical_axis={"telescope": OPTICS}, lights={}),
            "'optical_axis.beacons': expected at least one drone",
        ),
        (one_drone_with(optical_axis={"beacons": {"a": DRONE}}), r"'optical_axis.telescope"),
        (one_drone_with(optical_axis={"telescope": OPTICS | {"sigma_m": 1e-6}, "beacons": {"a": DRONE}}), "remove it"),
        (
            one_drone_with(
                optical_axis={"telescope": OPTICS, "beacons": {"a": DRONE}, "escort": {"range_min_m": 9000.0}}
            ),
            r":\d+: under 'optical_axis': parameter 'escort.range_min_m' = 9000 m: expected at most",
        ),
        (
            one_drone_with(pixel_pitch_m=1e-7, centroid_sigma_px=1e-3),
            r"'centroid_sigma_px' = 0.001: times pixel_pitch_m",
        ),
        (one_drone_with(elevation_deg=95.0), r"'elevation_deg'.*95"),
        (one_drone_with(colour="red"), r"'colour' is unknown"),
        ("lights: [\n", "bad.yaml"),
    ],
)
def test_bad_designs_are_one_line(values: Any, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    design = write(tmp_path / "bad.yaml", values)
    assert main([str(design), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"design_study: {design}")
    assert re.search(reason, error)
    assert not (tmp_path / "out").exists()

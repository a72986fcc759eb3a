"""Layouts evaluated by a requirement: random errors, search compared with a grid, maximum errors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ship_bags.parameter_yaml import read_nested_parameters
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.layout.config import study_config
from ship_studies.layout.error_budget import Layout, allocate_errors, requirement_use
from ship_studies.layout.field_of_view import Obstructions
from ship_studies.layout.layout_study_command import main, output_names
from ship_studies.layout.requirement import ALL_MOVED, AS_GIVEN, Candidate, RequirementResult
from ship_studies.layout.study import compute_study

EXAMPLE = Path(__file__).parents[3] / "examples" / "studies" / "layout.yaml"
SENSORS = {
    "fore": {"azimuth_deg": 0.0, "elevation_deg": 35.0},
    "starboard": {"azimuth_deg": 80.0, "elevation_deg": 40.0, "sigma_forward_arcsec": 60.0},
}
COMMON = {"heading_sigma_arcsec": 1.5, "tilt_sigma_arcsec": 1.0, "refraction_sigma_arcsec": 2.5}


def required_of(**values: Any) -> RequirementResult:
    required = compute_study(study_config({"sensors": SENSORS, **values})).requirement_result
    assert required is not None
    return required


def drawn_sigmas(layout: Layout, draws: int) -> FloatArray:
    """Return sigma of heading, pitch, roll of the best linear combination of drawn attitudes, arcsec.

    The weights come from the covariance of the draws, not from a model.
    """
    rng = np.random.default_rng(20)
    ship = rotation_from_angles(*layout.ship_angles)
    common = rng.standard_normal((draws, 4)) * layout.common_sigmas
    errors = []
    for angles, noise, mounting in zip(layout.angles, layout.noise_sigmas, layout.installation_sigmas, strict=True):
        installed = rotation_from_angles(*angles)
        true = ship @ installed
        # Refraction rotates the attitude about the horizontal axis across the boresight, by its size times cot E.
        level = np.cross(true[:, 0], [0.0, 1.0, 0.0])
        lift = level / np.linalg.norm(level) / np.tan(np.arcsin(true[1, 0]))
        horizon = Rotation.from_rotvec(common[:, :3] + common[:, 3:] * lift)
        own = Rotation.from_rotvec(rng.standard_normal((draws, 3)) * mounting)
        own = own * Rotation.from_rotvec(rng.standard_normal((draws, 3)) * noise)
        measured = horizon * Rotation.from_matrix(true) * own * Rotation.from_matrix(installed.T)
        errors.append((measured * Rotation.from_matrix(ship.T)).as_rotvec())
    stacked = np.concatenate(errors, axis=1)
    weights = np.linalg.solve(np.cov(stacked.T), np.tile(np.eye(3), (len(errors), 1)))
    joint = stacked @ weights @ np.linalg.inv(weights.reshape(len(errors), 3, 3).sum(axis=0))
    turned = Rotation.from_rotvec(joint) * Rotation.from_matrix(ship)
    found = np.array([[np.arctan2(r[2, 0], r[0, 0]), np.arcsin(r[1, 0]), np.arctan2(-r[1, 2], r[1, 1])]
                      for r in turned.as_matrix()])  # fmt: skip
    return (found - layout.ship_angles).std(axis=0) / ARCSEC


@pytest.mark.statistics
def test_a_layout_meets_a_requirement_if_errors_drawn_do() -> None:
    """Variances of 8000 draws are in the 99.9 % band; a limit 5 % above the drawn sigmas is met, 5 % below is not."""
    values = {"common": COMMON, "ship_roll_deg": 6.0, "ship_pitch_deg": 3.0}
    layout = Layout.from_config(study_config({"sensors": SENSORS, **values}))
    drawn = drawn_sigmas(layout, 8000)
    low, high = chi2.ppf([0.0005, 0.9995], 8000 - 3) / 8000
    ratio = (drawn / layout.sigmas_arcsec()) ** 2
    assert np.all((ratio > low) & (ratio < high))
    for factor, admissible in ((1.05, True), (0.95, False)):
        requirement = dict(zip(("heading_arcsec", "pitch_arcsec", "roll_arcsec"), factor * drawn, strict=True))
        required = required_of(requirement={key: float(value) for key, value in requirement.items()}, **values)
        assert required.given_layout.is_admissible is admissible


def test_only_required_angles_count() -> None:
    required = required_of(requirement={"pitch_arcsec": 2.0})
    assert required.given_layout.requirement_use == pytest.approx(required.given_layout.sigmas_arcsec[1] / 2.0)
    assert compute_study(study_config({"sensors": SENSORS})).requirement_result is None


def test_unknown_sigmas_are_not_admissible() -> None:
    limits = np.array([3.0, 3.0, np.inf])
    assert np.isnan(requirement_use(np.array([np.nan, 1.0, 1.0]), limits))
    assert requirement_use(np.array([1.0, 1.5, np.nan]), limits) == 0.5
    layout = Layout.from_config(study_config({"sensors": SENSORS}))
    assert not Candidate("a", layout, np.full(3, np.nan), float("nan"), ()).is_admissible
    low = {"alternatives": {"low": {"sensors": {"fore": {"azimuth_deg": 270.0, "elevation_deg": 6.0}}}}}
    required = required_of(requirement={"heading_arcsec": 1e4}, ship_roll_deg=-8.0, **low)
    poor = next(one for one in required.ranking if one.name == "low")
    assert np.isnan(poor.requirement_use)
    assert not poor.is_admissible
    assert required.ranking[-1] is poor


@pytest.mark.slow
@pytest.mark.parametrize(
    ("requirement", "masks"),
    [
        ({"heading_arcsec": 3.0, "pitch_arcsec": 3.0, "roll_arcsec": 3.0}, {}),
        ({"heading_arcsec": 5.0, "pitch_arcsec": 4.0, "roll_arcsec": 2.0}, {}),
        (
            {"heading_arcsec": 2.0, "pitch_arcsec": 5.0, "roll_arcsec": 3.0},
            {"house": {"azimuths_deg": [100.0, 290.0, 290.0, 100.0], "elevations_deg": [0.0, 0.0, 45.0, 45.0]}},
        ),
    ],
)
def test_the_search_finds_the_best_of_all_directions(requirement: dict[str, float], masks: dict[str, Any]) -> None:
    """The search is at most half a percent worse than the best pair of directions on a grid of 10 degrees."""
    config = study_config({"sensors": SENSORS, "common": COMMON, "masks": masks, "requirement": requirement})
    required = compute_study(config).requirement_result
    assert required is not None
    layout, sights = Layout.from_config(config), Obstructions.from_config(config)
    azimuths, elevations = np.deg2rad(np.arange(0.0, 360.0, 10.0)), np.deg2rad(np.arange(5.0, 86.0, 10.0))
    places = np.array([[azimuth, elevation, 0.0] for azimuth in azimuths for elevation in elevations])
    first, second = places[sights.is_unobstructed(0, places)], places[sights.is_unobstructed(1, places)]
    angles = np.stack([np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))], axis=1)
    limits = config.requirement.limits_arcsec()
    best = np.min(np.max(layout.sigmas_arcsec(angles) / limits, axis=-1))
    found = next(one for one in required.ranking if one.name == ALL_MOVED)
    assert found.requirement_use <= 1.005 * best
    assert not found.obstacles


def test_the_admissible_map_equals_single_evaluations() -> None:
    config = study_config(read_nested_parameters(EXAMPLE).values)
    computed = compute_study(config)
    assert computed.requirement_result is not None
    allowed, moved = computed.requirement_result.maps[1], computed.maps[1]
    limits = config.requirement.limits_arcsec()
    rng = np.random.default_rng(4)
    good = np.argwhere(allowed.is_admissible())
    anywhere = rng.integers([0, 0], allowed.requirement_use.shape, (60, 2))
    for row, column in [*rng.choice(good, 20), *anywhere]:
        angles = computed.layout.angles.copy()
        angles[1, :2] = np.deg2rad([moved.azimuths_deg[column], moved.elevations_deg[row]])
        met = np.all(replace(computed.layout, angles=angles).sigmas_arcsec() <= limits)
        free = computed.obstructions.is_unobstructed(1, angles[1][None])[0]
        assert allowed.is_admissible()[row, column] == (met and free)


def test_maximum_errors_just_meet_the_requirement() -> None:
    limits = np.array([4.5, 4.0, 4.2])
    layout = Layout.from_config(study_config({"sensors": SENSORS, "common": COMMON}))
    use = float(np.max(layout.sigmas_arcsec() / limits))
    assert use < 1.0
    rows = {row.key: row for row in allocate_errors(layout, limits)}
    assert len(rows) == 2 * 6 + 3
    assert sum(row.share for row in rows.values()) == pytest.approx(1.0)
    for key, row in rows.items():
        group, *name, leaf = key.split(".")
        changed: dict[str, Any] = {"sensors": {one: dict(of) for one, of in SENSORS.items()}, "common": dict(COMMON)}
        target = changed["common"] if group == "common" else changed["sensors"][name[0]]
        target[leaf] = min(row.alone_arcsec, 36_000.0)
        with_error = float(np.max(Layout.from_config(study_config(changed)).sigmas_arcsec() / limits))
        assert with_error == pytest.approx(1.0, abs=1e-6) if np.isfinite(row.alone_arcsec) else with_error < 1.0
        assert row.together_arcsec == pytest.approx(row.sigma_arcsec / use)
    together = {
        "sensors": {
            name: {
                **SENSORS[name],
                **{key.split(".")[2]: rows[key].together_arcsec for key in rows if f".{name}." in key},
            }
            for name in SENSORS
        },
        "common": {key.split(".")[1]: row.together_arcsec for key, row in rows.items() if key.startswith("common.")},
    }
    scaled = Layout.from_config(study_config(together))
    assert np.max(scaled.sigmas_arcsec() / limits) == pytest.approx(1.0)


def test_an_unreachable_requirement_has_no_error_size() -> None:
    layout = Layout.from_config(study_config({"sensors": SENSORS}))
    rows = {row.key: row for row in allocate_errors(layout, np.array([0.5, np.inf, np.inf]))}
    assert np.isnan(rows["sensors.fore.sigma_up_arcsec"].alone_arcsec)
    assert np.isnan(rows["common.refraction_sigma_arcsec"].alone_arcsec)


@pytest.mark.slow
def test_over_elevation_refraction_falls_with_the_cotangent() -> None:
    """Refraction with one sensor ahead causes a pitch error: the size at 45 degrees times cot E."""
    one = {"sensors": {"a": {"azimuth_deg": 0.0, "elevation_deg": 45.0}}, "common": {"refraction_sigma_arcsec": 0.6}}
    # Only the direction ahead is clear; all other azimuths are masked.
    wall = {"azimuths_deg": [12.0, 348.0, 348.0, 12.0], "elevations_deg": [-90.0, -90.0, 90.0, 90.0]}
    values = {**one, "masks": {"wall": wall}, "field_of_view_deg": 1.0, "horizon": {"roll_deg": 10.0, "pitch_deg": 8.0}}
    required = compute_study(
        study_config({**values, "requirement": {"heading_arcsec": 200.0, "pitch_arcsec": 20.0}})
    ).requirement_result
    assert required is not None
    for traded in required.trade:
        if np.rad2deg(traded.candidate.layout.angles[0, 0]) == 0.0:
            expected = 0.6 / np.tan(np.deg2rad(traded.elevation_deg))
            assert traded.refraction_arcsec[1] == pytest.approx(expected, rel=1e-6)
    # The lower edge of the field is half a degree down, and the bow pitches down by 8 degrees.
    ahead = [t for t in required.trade if np.rad2deg(t.candidate.layout.angles[0, 0]) == 0.0]
    assert len(ahead) > 10
    assert all(bool(t.candidate.obstacles) == (t.elevation_deg < 8.5) for t in ahead if t.elevation_deg < 60.0)


class AnyFigure(dict[str, Path]):
    """Replaces the figures, which take longer than everything else."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._path = folder / "any.png"
        self._path.write_bytes(b"")

    def __missing__(self, name: str) -> Path:
        return self._path


@pytest.mark.slow
def test_a_requirement_out_of_reach_ends_with_1_and_the_nearest_miss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ship_node.pages.figure_files.write_figures", lambda _, folder: AnyFigure(folder))
    text = EXAMPLE.read_text(encoding="utf-8").replace("heading_arcsec: 3.2", "heading_arcsec: 2.0")
    layout = tmp_path / "layout.yaml"
    layout.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    assert main([str(layout), "--out", str(out)]) == 1
    printed = capsys.readouterr().out
    assert "no layout meets the requirement; nearest miss: 'all sensors moved'" in printed
    assert "of 2 arcsec" in printed
    page = (out / "layout_study.html").read_text(encoding="utf-8")
    assert "No layout is admissible." in page
    tables = {
        name for name in output_names(study_config(read_nested_parameters(layout).values)) if name.endswith(".csv")
    }
    assert {path.name for path in out.glob("*.csv")} == tables


def test_a_blocking_horizon_is_in_the_nearest_miss() -> None:
    values = {"horizon": {"clearance_deg": 45.0}, "field_of_view_deg": 100.0}
    sensors = {"a": {"azimuth_deg": 0.0, "elevation_deg": 60.0}}
    required = compute_study(
        study_config({**values, "sensors": sensors, "requirement": {"roll_arcsec": 500.0}})
    ).requirement_result
    assert required is not None
    assert not required.is_met
    assert "too near to the horizon" in "".join(required.ranking[0].obstacles)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"alternatives": {"b": {"sensors": {}}}}, "alternatives.b': there is no requirement for its evaluation"),
        (
            {
                "requirement": {"roll_arcsec": 3.0},
                "alternatives": {"b": {"sensors": {"aft": {"azimuth_deg": 0.0, "elevation_deg": 35.0}}}},
            },
            "alternatives.b.sensors.aft': there is no sensor 'aft': expected one of fore, starboard",
        ),
        ({"requirement": {"roll_arcsec": float("nan")}}, "requirement.roll_arcsec' must be finite"),
    ],
)
def test_bad_requirements_are_named(values: dict[str, Any], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        study_config({"sensors": SENSORS, **values})


@pytest.mark.slow
def test_the_example_has_an_admissible_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The layout as given exceeds the pitch limit by 1 %; another layout meets the requirement."""
    assert main([str(EXAMPLE), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "  1 all sensors moved       meets it" in printed
    assert f"  5 {AS_GIVEN:24}does not: pitch uses 101.1 %" in printed
    assert {path.name for path in tmp_path.iterdir()} == set(
        output_names(study_config(read_nested_parameters(EXAMPLE).values))
    )
    page = (tmp_path / "layout_study.html").read_text(encoding="utf-8")
    for words in ("Requirement", "Effect of elevation", "Maximum size of each error", "bridge_wings"):
        assert words in page

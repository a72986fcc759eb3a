"""Noise from optics: comparison of Liebe's formulas, the study's covariance, scipy's attitudes and the real sky."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.wahba import solve
from ship_stars.sky.catalogue import hipparcos
from ship_studies.layout.config import Optics, study_config
from ship_studies.layout.field_of_view import attitude_sigmas, liebe_sigmas, sky_statistics
from ship_studies.layout.layout_study_command import main
from ship_studies.layout.study import compute_study

OPTICS = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "width_px": 2048, "height_px": 2048, "magnitude_limit": 6.0}


def drawn_stars(optics: Optics, count: int, rng: np.random.Generator) -> FloatArray:
    places = rng.uniform(-1.0, 1.0, (count, 2)) * optics.half_field()
    vectors = np.column_stack([np.ones(count), places[:, 1], places[:, 0]])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_with_many_stars_liebe_equals_the_covariance_except_for_the_mean_distance() -> None:
    """The distance from the middle of a uniform square is 0.3826 sides in the mean and 1/√6 sides RMS."""
    optics = Optics(**OPTICS)
    rng = np.random.default_rng(1)
    ours = np.mean([attitude_sigmas(drawn_stars(optics, 400, rng), optics.star_sigma()) for _ in range(50)], axis=0)
    ratio = ours / liebe_sigmas(optics, 400)
    # Field of 12.85 deg: tangent and angle differ by 0.4 % at its edge, and stars off the axis have weight cos².
    np.testing.assert_allclose(ratio[1:], 1.0, atol=0.01)
    assert ratio[0] == pytest.approx(0.3825 * np.sqrt(6.0), rel=0.01)


def test_with_eight_stars_the_covariance_is_larger() -> None:
    """N stars have N - 1 independent distances from their mean: sigma is at least √(8/7) larger, more in the mean."""
    optics = Optics(**OPTICS)
    rng = np.random.default_rng(2)
    ours = np.mean([attitude_sigmas(drawn_stars(optics, 8, rng), optics.star_sigma()) for _ in range(400)], axis=0)
    ratio = ours / liebe_sigmas(optics, 8)
    assert 0.3825 * np.sqrt(6.0 * 8.0 / 7.0) < ratio[0] < 1.10
    assert 1.03 < ratio[1] < 1.12


@pytest.mark.parametrize("count", [2, 5, 20])
def test_the_covariance_is_that_of_attitudes_solved_by_scipy(count: int) -> None:
    """Squared errors of 2000 attitudes, in sigmas, are in the 99.9 % band of chi-square; the suite's solver agrees."""
    optics = Optics(**OPTICS)
    rng = np.random.default_rng(3)
    stars = drawn_stars(optics, count, rng)
    sigma = optics.star_sigma()
    expected = attitude_sigmas(stars, sigma)
    errors = []
    for _ in range(2000):
        noisy = stars + sigma * rng.standard_normal(stars.shape)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        errors.append(Rotation.align_vectors(stars, noisy)[0].as_rotvec())
    squares = np.sum((np.array(errors) / expected) ** 2, axis=0)
    low, high = chi2.ppf([0.0005, 0.9995], 2000)
    assert np.all((squares > low) & (squares < high))
    own = np.sqrt(np.diagonal(solve(stars, stars, sigma).covariance_n))
    np.testing.assert_allclose(own, expected, rtol=1e-6)


def test_the_mean_number_of_stars_is_that_of_the_whole_sky() -> None:
    """The mean number is the number of stars to magnitude 6.0, times the field's share of the sphere.

    Liebe's 6.57 exp(1.08 m) is for V magnitudes and is within a tenth of the number by Hp magnitudes.
    """
    optics = Optics(**OPTICS)
    found = sky_statistics(optics)
    count = len(hipparcos().rows_brighter_than(6.0))
    assert count == pytest.approx(6.57 * np.exp(1.08 * 6.0), rel=0.1)
    half = np.arctan(optics.half_field())
    share = np.arcsin(np.sin(half[0]) * np.sin(half[1])) / np.pi
    # Counts scatter more than Poisson, because stars are concentrated along the Milky Way.
    scatter = found.stars.std() / np.sqrt(found.stars.size)
    assert abs(found.stars.mean() - count * share) < 3.3 * scatter
    # The quantile is the smallest sigma that is not exceeded in 95 % of the sky.
    assert np.all(np.mean(found.sigmas_arcsec <= found.quantile_arcsec, axis=0) >= 0.95)
    assert np.all(np.mean(found.sigmas_arcsec < found.quantile_arcsec, axis=0) <= 0.95)
    assert found.star_sigma_arcsec == pytest.approx(0.1 * 5.5e-6 / 0.05 / ARCSEC)


@pytest.mark.slow
def test_the_study_takes_the_noise_of_the_optics(tmp_path: Path) -> None:
    layout = tmp_path / "layout.yaml"
    keys = ", ".join(f"{key}: {value}" for key, value in OPTICS.items()).replace("5.5e-06", "0.0000055")
    layout.write_text(f"sensors:\n  a: {{azimuth_deg: 0.0, elevation_deg: 35.0}}\noptics:\n  a: {{{keys}}}\n")
    assert main([str(layout), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "optics.csv").open(encoding="utf-8", newline="") as file:
        row = next(csv.DictReader(file))
    held = sky_statistics(Optics(**OPTICS)).quantile_arcsec
    assert float(row["sigma_forward_arcsec"]) == pytest.approx(held[0], abs=1e-4)
    computed = compute_study(
        study_config({"sensors": {"a": {"azimuth_deg": 0.0, "elevation_deg": 35.0}}, "optics": {"a": OPTICS}})
    )
    np.testing.assert_allclose(computed.layout.noise_sigmas[0] / ARCSEC, held)
    page = (tmp_path / "out" / "layout_study.html").read_text(encoding="utf-8")
    assert f"{held[0]:.2f} / {held[1]:.2f}" in page


def lines(sensor: str, optics: str) -> str:
    sensors = f"sensors:\n  a: {{azimuth_deg: 0.0, elevation_deg: 35.0{sensor}}}\n"
    return (
        f"{sensors}optics:\n  {optics}, pixel_pitch_m: 0.0000055, width_px: 64, height_px: 64, magnitude_limit: 2.0}}\n"
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (lines("", "b: {focal_length_m: 0.1"), ":4: parameter 'optics.b': there is no sensor 'b'"),
        (lines(", sigma_up_arcsec: 3.0", "a: {focal_length_m: 0.1"), ":2: parameter 'sensors.a.sigma_up_arcsec'"),
        (lines("", "a: {focal_length_m: 0.1"), ":4: parameter 'optics.a.magnitude_limit': in 100 % of the sky"),
    ],
)
def test_optics_that_cannot_be_used(text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = tmp_path / "bad.yaml"
    layout.write_text(text)
    assert main([str(layout), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error

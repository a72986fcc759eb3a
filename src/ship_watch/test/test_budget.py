"""Variances of angles by source, against angles of attitudes rotated by random errors."""

import numpy as np
import pytest

from ship_geometry.frames import angles_from_rotation, horizon_covariance, rotation_from_angles
from ship_geometry.rotations import exp_rotation
from ship_watch.history.history_recorder import angle_variances

DRAWS = 20_000


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg", "is_deck"), [(34.0, 3.0, True), (250.0, 62.0, False)])
def test_variances_equal_those_of_rotated_attitudes(azimuth_deg: float, elevation_deg: float, is_deck: bool) -> None:
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    root = 1e-5 * np.random.default_rng(12).normal(size=(3, 3))
    covariance_enu = root @ root.T
    covariance_n = horizon_covariance(covariance_enu)
    errors = np.random.default_rng(13).multivariate_normal(np.zeros(3), covariance_n, size=DRAWS)
    turned = np.array([exp_rotation(error) for error in errors]) @ rotation_from_angles(azimuth, elevation, 0.02)
    angles = angles_from_rotation(turned)
    scale = 1.0 if is_deck else np.cos(elevation)
    drawn = np.var(angles * [scale, 1.0, 1.0], axis=0)
    computed = angle_variances({"all": covariance_enu}, azimuth, elevation, is_deck=is_deck)
    # A variance of n draws has the relative sigma √(2/n) = 1 %; 3.3 sigma cover 99.9 %.
    in_order = [by_source["all"] for by_source in computed.values()]
    assert in_order == pytest.approx(drawn[: len(computed)], rel=3.3 * np.sqrt(2.0 / DRAWS))


def test_variances_add_up_and_nan_stays_nan() -> None:
    parts = {"noise": np.diag([1e-10, 2e-10, 3e-10]), "drift": np.diag([5e-10, 1e-10, 4e-10])}
    together = angle_variances({"all": parts["noise"] + parts["drift"]}, 1.0, 0.1, is_deck=True)
    computed = angle_variances({**parts, "new": np.full((3, 3), np.nan)}, 1.0, 0.1, is_deck=True)
    for angle, by_source in computed.items():
        assert by_source["noise"] + by_source["drift"] == pytest.approx(together[angle]["all"])
        assert np.isnan(by_source["new"])

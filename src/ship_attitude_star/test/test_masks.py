"""Obstruction masks: which fields of view they reach, by points of the field, and what the study says."""

import numpy as np
import pytest

from ship_attitude_star.layout.config import Mask, study_config
from ship_attitude_star.layout.masks import Obstructions, _holds
from ship_attitude_star.layout.study import study
from ship_estimation.parameters import ParameterError
from ship_geometry.frames import rotation_from_angles

FUNNEL = {"azimuths_deg": [150.0, 210.0, 210.0, 150.0], "elevations_deg": [0.0, 0.0, 50.0, 50.0]}
ACROSS_BOW = {"azimuths_deg": [350.0, 370.0, 360.0], "elevations_deg": [0.0, 0.0, 60.0]}


@pytest.mark.parametrize("roll_deg", [0.0, 40.0])
def test_a_mask_reaches_a_field_if_a_point_of_the_field_lies_in_it(roll_deg: float) -> None:
    """Against the field filled with a grid of 81 x 81 directions, each looked up in the rectangle of the funnel."""
    half = np.tan(np.deg2rad(8.0))
    obstructions = Obstructions.from_masks({"funnel": Mask(**FUNNEL)}, np.array([[half, half]]))
    side = np.linspace(-half, half, 81)
    field_s = np.array([[1.0, up, right] for up in side for right in side])
    rng = np.random.default_rng(5)
    answers = []
    for azimuth_deg, elevation_deg in rng.uniform([120.0, 5.0], [240.0, 75.0], (300, 2)):
        angles = np.deg2rad([azimuth_deg, elevation_deg, roll_deg])
        seen = field_s @ rotation_from_angles(*angles).T
        azimuths = np.rad2deg(np.arctan2(seen[:, 2], seen[:, 0])) % 360.0
        elevations = np.rad2deg(np.arctan2(seen[:, 1], np.hypot(seen[:, 0], seen[:, 2])))
        inside = (azimuths >= 150.0) & (azimuths <= 210.0) & (elevations >= 0.0) & (elevations <= 50.0)
        answers.append((bool(inside.any()), bool(obstructions.in_view(0, angles))))
    # The grids of both differ at a grazing corner alone.
    assert sum(grid != ours for grid, ours in answers) <= 3
    assert 50 < sum(grid for grid, _ in answers) < 250


def test_a_mask_across_the_bow_holds_both_sides() -> None:
    corners = Mask(**ACROSS_BOW).corners_deg()
    assert [_holds(corners, np.array([azimuth, 10.0])) for azimuth in (-5.0, 0.0, 5.0, 355.0, 15.0, 180.0)] == [
        True, True, True, True, False, False,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("masks", "reason"),
    [
        ({"mast": ACROSS_BOW}, "sensors.a.azimuth_deg': mast stands in the field of view: the nearest clear azimuth"),
        (
            {"tarpaulin": {"azimuths_deg": [0.0, 360.0, 360.0, 0.0], "elevations_deg": [-90.0, -90.0, 90.0, 90.0]}},
            "the masks tarpaulin leave no azimuth at this elevation clear",
        ),
        ({"flag": {"azimuths_deg": [0.0, 1.0], "elevations_deg": [0.0, 1.0]}}, "masks.flag': 2 azimuths and 2 elev"),
    ],
)
def test_masks_in_the_way_are_named(masks: dict[str, object], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        study(study_config({"sensors": {"a": {"azimuth_deg": 0.0, "elevation_deg": 35.0}}, "masks": masks}))


def test_recommended_azimuths_are_clear_of_masks() -> None:
    """Without masks 119 deg is recommended; a crane from 100 to 140 deg moves it to the nearest clear edge."""
    crane = {"azimuths_deg": [100.0, 140.0, 140.0, 100.0], "elevations_deg": [0.0, 0.0, 60.0, 60.0]}
    sensors = {name: {"azimuth_deg": azimuth, "elevation_deg": 35.0} for name, azimuth in (("a", 0.0), ("b", 70.0))}
    free = study(study_config({"sensors": sensors}))
    masked = study(study_config({"sensors": sensors, "masks": {"crane": crane}}))
    assert np.rad2deg(free.best.angles[1, 0]) == pytest.approx(119.0)
    azimuth_deg = np.rad2deg(masked.best.angles[1, 0]) % 360.0
    assert np.isfinite(masked.best_arcsec).all()
    # A field of 20 deg at 35 deg elevation is 24 deg of azimuth wide in its middle, more at its upper edge.
    assert azimuth_deg < 100.0 - 10.0 or azimuth_deg > 140.0 + 10.0
    hidden = np.isnan(masked.scans[0].sigmas_arcsec[:, 0])
    assert hidden[100:141].all()
    assert not hidden[round(azimuth_deg)]

"""Masks and horizon of a layout study: errors for sensors with obstructed fields, and recommended azimuths."""

import numpy as np
import pytest

from ship_estimation.parameters.schema import ParameterError
from ship_geometry.frames import rotation_from_angles
from ship_studies.layout.config import study_config
from ship_studies.layout.field_of_view import Obstructions
from ship_studies.layout.study import compute_study

ACROSS_BOW = {"azimuths_deg": [350.0, 370.0, 360.0], "elevations_deg": [0.0, 0.0, 60.0]}


@pytest.mark.parametrize(
    ("masks", "reason"),
    [
        ({"mast": ACROSS_BOW}, "sensors.a.azimuth_deg': mast is in the field of view: the nearest clear azimuth"),
        (
            {"tarpaulin": {"azimuths_deg": [0.0, 360.0, 360.0, 0.0], "elevations_deg": [-90.0, -90.0, 90.0, 90.0]}},
            "the masks tarpaulin leave no clear azimuth at this elevation",
        ),
        ({"flag": {"azimuths_deg": [0.0, 1.0], "elevations_deg": [0.0, 1.0]}}, "masks.flag': 2 azimuths and 2 elev"),
        (
            {"rail": {"azimuths_deg": [-10.0, 360.0, 0.0], "elevations_deg": [0.0, 0.0, 5.0]}},
            "masks.rail.azimuths_deg': from -10 to 360 deg spans more than a full circle",
        ),
    ],
)
def test_masks_in_the_way_are_named(masks: dict[str, object], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        compute_study(study_config({"sensors": {"a": {"azimuth_deg": 0.0, "elevation_deg": 35.0}}, "masks": masks}))


def test_recommended_azimuths_are_clear_of_masks() -> None:
    """Without masks 119 deg is recommended; with a crane from 100 to 140 deg, an azimuth clear of the crane."""
    crane = {"azimuths_deg": [100.0, 140.0, 140.0, 100.0], "elevations_deg": [0.0, 0.0, 60.0, 60.0]}
    sensors = {name: {"azimuth_deg": azimuth, "elevation_deg": 35.0} for name, azimuth in (("a", 0.0), ("b", 70.0))}
    free = compute_study(study_config({"sensors": sensors}))
    masked = compute_study(study_config({"sensors": sensors, "masks": {"crane": crane}}))
    assert np.rad2deg(free.best.angles[1, 0]) == pytest.approx(119.0)
    azimuth_deg = np.rad2deg(masked.best.angles[1, 0]) % 360.0
    assert np.isfinite(masked.best_arcsec).all()
    # A field of 20 deg at 35 deg elevation is 24 deg of azimuth wide in its middle, more at its upper edge.
    assert azimuth_deg < 100.0 - 10.0 or azimuth_deg > 140.0 + 10.0
    hidden = np.isnan(masked.scans[0].sigmas_arcsec[:, 0])
    assert hidden[100:141].all()
    assert not hidden[round(azimuth_deg)]


def test_a_field_stays_over_the_horizon_as_the_ship_moves() -> None:
    """The horizon margin is compared with a field of 31 x 31 directions, rotated by roll and pitch on a fine grid."""
    sensors = {"a": {"azimuth_deg": 50.0, "elevation_deg": 40.0, "roll_deg": 20.0}}
    moving = {"roll_deg": 12.0, "pitch_deg": 4.0, "clearance_deg": 3.0}
    config = study_config({"sensors": sensors, "horizon": moving, "ship_roll_deg": 2.0, "field_of_view_deg": 16.0})
    side = np.tan(np.deg2rad(8.0)) * np.linspace(-1.0, 1.0, 31)
    field_s = np.array([[1.0, up, right] for up in side for right in side])
    field_s /= np.linalg.norm(field_s, axis=1, keepdims=True)
    field_d = field_s @ rotation_from_angles(*np.deg2rad([50.0, 40.0, 20.0])).T
    lowest = min(
        np.rad2deg(np.arcsin((field_d @ rotation_from_angles(0.0, *np.deg2rad([pitch, roll])).T)[:, 1])).min()
        for pitch in np.linspace(-4.0, 4.0, 9)
        for roll in np.linspace(-10.0, 14.0, 13)
    )
    over = Obstructions.from_config(config).horizon_margin(0, np.deg2rad([[50.0, 40.0, 20.0]]))
    assert np.rad2deg(over[0]) == pytest.approx(lowest - 3.0, abs=0.02)
    assert 10.0 < lowest < 25.0

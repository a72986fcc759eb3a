"""Masks of a star sensor: detections inside, stars behind them, and masks that cover the whole field."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_estimation.parameters.schema import ParameterError, build, flatten
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_from_stars.exposure import StarExposure, identify_stars
from ship_stars.attitude_from_stars.identification import find_candidates
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.sky.deck_masks import MaskConfig, SensorMasks, deck_masks
from ship_stars.sky.sky_model import SkyModel
from ship_testing.star_sky import ROTATION_ND, TIME_NS, configuration, exposure_of, sky_at_anchor, without_identity

CONFIG = configuration()
ROTATION_DS = CONFIG.star_sensors["fore"].rotation_ds
ROTATION_NS = ROTATION_ND @ ROTATION_DS


@pytest.fixture(scope="module")
def sky_model() -> SkyModel:
    return sky_at_anchor(CONFIG)


def deck_places_deg(directions_s: FloatArray) -> FloatArray:
    """Return azimuth in (-180, 180] and elevation above the deck, shape (k, 2)."""
    bow, up, starboard = (directions_s @ ROTATION_DS.T).T
    return np.rad2deg(np.stack([np.arctan2(starboard, bow), np.arctan2(up, np.hypot(bow, starboard))], axis=-1))


def to_port_of(azimuth_deg: float, name: str = "mast") -> SensorMasks:
    """Return a mask from 60° to port to an azimuth near the bow; its corners exceed 360°."""
    mask = MaskConfig(
        azimuths_deg=(300.0, 360.0 + azimuth_deg, 360.0 + azimuth_deg, 300.0), elevations_deg=(-10.0, -10.0, 89.0, 89.0)
    )
    masks = deck_masks({name: mask}, "masks")
    assert masks is not None
    return SensorMasks(masks, ROTATION_DS)


def prior_of(sigma_arcsec: float) -> StarPrior:
    return StarPrior(ROTATION_NS, np.diag(np.full(3, (sigma_arcsec * ARCSEC) ** 2)))


def median_split(exposure: StarExposure) -> float:
    """Return an azimuth with half of the stars to port of it."""
    azimuths = np.sort(deck_places_deg(exposure.directions_s)[:, 0])
    middle = len(azimuths) // 2
    return float(azimuths[middle - 1 : middle + 1].mean())


def test_detections_in_a_mask_are_no_stars_and_the_others_keep_their_identities(sky_model: SkyModel) -> None:
    exposure = exposure_of(sky_model, "fore", 8)
    edge_deg = median_split(exposure)
    hidden = deck_places_deg(exposure.directions_s)[:, 0] < edge_deg
    masked = replace(without_identity(exposure), masks=to_port_of(edge_deg))
    named, reasons = identify_stars(masked, prior_of(30.0), sky_model.sky_at(TIME_NS))
    assert named.hip.tolist() == np.where(hidden, 0, exposure.hip).tolist()
    assert sorted(reasons) == np.flatnonzero(hidden).tolist()
    assert {reason.text for reason in reasons.values()} == {"not a star: inside the mask mast"}
    without, none = identify_stars(without_identity(exposure), prior_of(30.0), sky_model.sky_at(TIME_NS))
    assert without.hip.tolist() == exposure.hip.tolist()
    assert not none


def test_a_lamp_behind_a_mask_matches_no_star(sky_model: SkyModel) -> None:
    """A star at the edge and a lamp next to it, both within the gate: without the mask neither gets the identity."""
    exposure = exposure_of(sky_model, "fore", 4)
    at_edge = int(np.argmin(deck_places_deg(exposure.directions_s)[:, 0]))
    star_deg = deck_places_deg(exposure.directions_s)[at_edge, 0]
    lamp_s = exposure.directions_s[at_edge] + ROTATION_DS.T @ np.array([0.0, 0.0, -40.0 * ARCSEC])
    lamp_s /= np.linalg.norm(lamp_s)
    rows = [*range(4), at_edge]
    both = without_identity(exposure[rows])
    both = replace(both, directions_s=np.vstack([exposure.directions_s, lamp_s]))
    free, _ = identify_stars(both, prior_of(30.0), sky_model.sky_at(TIME_NS))
    assert free.hip[at_edge] == free.hip[4] == 0
    # The edge of the mask is midway between star and lamp.
    masked = replace(both, masks=to_port_of(0.5 * (star_deg + deck_places_deg(lamp_s[None])[0, 0])))
    named, reasons = identify_stars(masked, prior_of(30.0), sky_model.sky_at(TIME_NS))
    assert named.hip.tolist() == [*exposure.hip.tolist(), 0]
    assert "mask" in reasons[4].text


@pytest.mark.parametrize("sigma_arcsec", [10.0, 600.0])
def test_a_star_behind_a_mask_is_no_candidate_except_within_the_prior_error(
    sky_model: SkyModel, sigma_arcsec: float
) -> None:
    """Stars further than five sigmas plus 0.26° to port of the edge are no candidates; all other stars within five are.
    """
    exposure, sky = without_identity(exposure_of(sky_model, "fore", 8)), sky_model.sky_at(TIME_NS)
    edge_deg, prior = median_split(exposure), prior_of(sigma_arcsec)

    def stars(masks: SensorMasks | None) -> set[int]:
        magnitude = np.full(len(exposure), np.nan)
        found = find_candidates(exposure.directions_s, exposure.sigma, magnitude, None, prior, sky, masks)
        return set(found.rows.tolist())

    everywhere, unmasked = stars(None), stars(to_port_of(edge_deg))
    rows = np.array(sorted(everywhere))
    direction_s = sky.apparent_stars(sky_model.catalogue.at_j2000[rows]).direction_n @ ROTATION_NS
    places_deg = deck_places_deg(direction_s)
    # Distance to the meridian of the edge.
    deep_deg = np.rad2deg(
        np.arcsin(np.cos(np.deg2rad(places_deg[:, 1])) * np.sin(np.deg2rad(edge_deg - places_deg[:, 0])))
    )
    margin_deg = np.rad2deg(5.0 * np.sqrt(3.0) * sigma_arcsec * ARCSEC)
    surely_out = set(rows[deep_deg > margin_deg + 0.26].tolist())
    surely_in = set(rows[deep_deg < margin_deg].tolist())
    assert unmasked <= everywhere
    assert not unmasked & surely_out
    assert surely_in <= unmasked
    assert surely_out


CAMERA = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "principal_u_px": 1023.5, "principal_v_px": 1023.5}
WALL = {"azimuths_deg": [340.0, 380.0, 380.0, 340.0], "elevations_deg": [20.0, 20.0, 70.0, 70.0]}
LEFT = {"azimuths_deg": [340.0, 360.0, 360.0, 340.0], "elevations_deg": [20.0, 20.0, 70.0, 70.0]}
RIGHT = {"azimuths_deg": [0.0, 20.0, 20.0, 0.0], "elevations_deg": [20.0, 20.0, 70.0, 70.0]}


def sensor_with(masks: dict[str, Any], **camera: float) -> dict[str, Any]:
    fore = {"azimuth_deg": 0.0, "elevation_deg": 45.0, "camera": {**CAMERA, **camera}, "masks": masks}
    return {"star_sensors": {"fore": fore}}


@pytest.mark.parametrize("kind", [ShipAttitudeConfig, StarAttitudeConfig])
@pytest.mark.parametrize(
    ("masks", "reason"),
    [
        ({"wall": WALL}, "parameter 'star_sensors.fore.masks': wall cover the whole field of view"),
        ({"left": LEFT, "right": RIGHT}, "left, right cover the whole field of view, so that no star is visible"),
        ({"a": {**WALL, "elevations_deg": [1.0, 2.0]}}, "'star_sensors.fore.masks.a': 4 azimuths and 2 elevations"),
        ({"a": {**WALL, "azimuths_deg": [0.0, 400.0, 9.0, 9.0]}}, "masks.a.azimuths_deg': from 0 to 400 deg spans"),
        ({"a": {**WALL, "azimuths_deg": [0.0, float("nan"), 9.0, 9.0]}}, r"masks.a.azimuths_deg\[1\]' must be finite"),
    ],
)
def test_invalid_masks_are_named(kind: type, masks: dict[str, Any], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        build(kind, sensor_with(masks))


@pytest.mark.parametrize("kind", [ShipAttitudeConfig, StarAttitudeConfig])
def test_masks_that_leave_a_part_free_are_accepted(kind: type) -> None:
    config = build(kind, sensor_with({"left": LEFT}))
    masks = config.star_sensors["fore"].sensor_masks
    assert masks.is_hidden(np.array([[1.0, 0.0, -0.05], [1.0, 0.0, 0.05]])).tolist() == [True, False]
    assert flatten(config)["star_sensors.fore.masks.left.azimuths_deg"] == LEFT["azimuths_deg"]
    # Pixels relative to the boresight do not define the size of the field.
    build(kind, sensor_with({"wall": WALL}, principal_u_px=0.0))
    assert build(kind, sensor_with({})).star_sensors["fore"].sensor_masks is None

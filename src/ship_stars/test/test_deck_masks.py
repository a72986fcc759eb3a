"""Deck masks against matplotlib's paths, against fields filled with directions, and against small circles."""

import numpy as np
import pytest
from matplotlib.path import Path

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_stars.sky.deck_masks import DeckMasks, field_directions

FUNNEL = [[150.0, 0.0], [210.0, 0.0], [210.0, 50.0], [150.0, 50.0]]
ACROSS_BOW = [[350.0, 0.0], [370.0, 0.0], [360.0, 60.0]]


def masks_of(*polygons_deg: list[list[float]] | FloatArray) -> DeckMasks:
    names = tuple(f"mask_{number}" for number in range(len(polygons_deg)))
    return DeckMasks(names, tuple(np.deg2rad(np.asarray(polygon, dtype=float)) for polygon in polygons_deg))


def directions(places_deg: FloatArray) -> FloatArray:
    """Unit vectors (bow, up, starboard) of azimuth and elevation, deg, shape (..., 2)."""
    azimuth, elevation = np.moveaxis(np.deg2rad(places_deg), -1, 0)
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)], axis=-1)


def drawn_polygon(rng: np.random.Generator) -> FloatArray:
    """Return a polygon with corners at sorted bearings from its middle, anywhere around the ship."""
    count = int(rng.integers(3, 9))
    bearing = np.sort(rng.uniform(0.0, 2.0 * np.pi, count))
    sizes = rng.uniform(5.0, 70.0, count)
    middle = rng.uniform([-150.0, 10.0], [500.0, 60.0])
    return middle + sizes[:, None] * np.stack([np.cos(bearing), 0.4 * np.sin(bearing)], axis=-1)


def test_hidden_directions_equal_those_of_matplotlib() -> None:
    rng = np.random.default_rng(11)
    hidden_share = []
    for _ in range(40):
        polygon = drawn_polygon(rng)
        places = rng.uniform([0.0, -60.0], [360.0, 90.0], (1000, 2))
        path = Path(np.vstack([polygon, polygon[:1]]), closed=True)
        turned = [path.contains_points(places + np.array([turn, 0.0])) for turn in (-720.0, -360.0, 0.0, 360.0, 720.0)]
        expected = np.any(turned, axis=0)
        np.testing.assert_array_equal(masks_of(polygon).is_hidden(directions(places)), expected)
        hidden_share.append(expected.mean())
    assert 0.005 < np.mean(hidden_share) < 0.5


def test_a_mask_across_the_bow_hides_both_sides() -> None:
    azimuths = np.array([-5.0, 0.0, 5.0, 355.0, 15.0, 180.0])
    places = np.stack([azimuths, np.full(6, 10.0)], axis=-1)
    for turn_deg in (0.0, -360.0):
        hidden = masks_of(np.array(ACROSS_BOW) + np.array([turn_deg, 0.0])).is_hidden(directions(places))
        assert hidden.tolist() == [True, True, True, True, False, False]


def test_a_mask_all_round_hides_all_azimuths_below_its_edge() -> None:
    round_ship = [[0.0, -90.0], [360.0, -90.0], [360.0, 12.0], [0.0, 12.0]]
    azimuths = np.arange(0.0, 360.0, 7.5)
    assert masks_of(round_ship).is_hidden(directions(np.stack([azimuths, np.full(48, 11.9)], axis=-1))).all()
    assert not masks_of(round_ship).is_hidden(directions(np.stack([azimuths, np.full(48, 12.1)], axis=-1))).any()


def test_nan_direction_is_hidden() -> None:
    nowhere = np.array([[np.nan, 0.0, 1.0], [0.0, np.nan, 0.0]])
    assert masks_of(FUNNEL).is_hidden(nowhere).all()
    assert masks_of(FUNNEL).is_hidden(nowhere, margin=0.1).all()


def test_with_a_margin_all_of_a_small_circle_is_hidden() -> None:
    rng = np.random.default_rng(12)
    masks, margin = masks_of(FUNNEL, ACROSS_BOW), np.deg2rad(3.0)
    middle = directions(rng.uniform([0.0, 0.0], [360.0, 70.0], (3000, 2)))
    side = np.cross(middle, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    other = np.cross(middle, side)

    def circle_hidden(radius: float) -> FloatArray:
        bearing = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        around = np.cos(bearing)[:, None, None] * side + np.sin(bearing)[:, None, None] * other
        points = np.cos(radius) * middle + np.sin(radius) * around
        return masks.is_hidden(points.reshape(-1, 3)).reshape(72, -1).all(axis=0)

    hidden = masks.is_hidden(middle, margin)
    # The margin is exact to half the spacing of the edge points. A corner may also lie between two points of the
    # circle.
    assert not np.any(hidden & ~circle_hidden(margin))
    assert not np.any(~hidden & circle_hidden(margin + np.deg2rad(0.6)))
    assert 50 < np.count_nonzero(hidden) < np.count_nonzero(masks.is_hidden(middle))


@pytest.mark.slow
@pytest.mark.parametrize("roll_deg", [0.0, 40.0])
def test_a_mask_reaches_a_field_if_a_point_of_the_field_lies_in_it(roll_deg: float) -> None:
    """The expected result is that of a grid of 81 x 81 directions of the field, each compared with the funnel."""
    half = np.tan(np.deg2rad(8.0))
    side = np.linspace(-half, half, 81)
    field_s = np.array([[1.0, up, right] for up in side for right in side])
    rng = np.random.default_rng(5)
    places = rng.uniform([120.0, 5.0], [240.0, 75.0], (300, 2))
    rotations = np.array([rotation_from_angles(*np.deg2rad([*place, roll_deg])) for place in places])
    ours = masks_of(FUNNEL).masks_in_field(rotations, np.array([half, half]))[0]
    seen = field_s @ np.swapaxes(rotations, -1, -2)
    azimuths = np.rad2deg(np.arctan2(seen[..., 2], seen[..., 0])) % 360.0
    elevations = np.rad2deg(np.arctan2(seen[..., 1], np.hypot(seen[..., 0], seen[..., 2])))
    inside = (azimuths >= 150.0) & (azimuths <= 210.0) & (elevations >= 0.0) & (elevations <= 50.0)
    # The two grids differ only at a grazing corner.
    assert np.count_nonzero(ours != inside.any(axis=1)) <= 3
    assert 50 < np.count_nonzero(ours) < 250


def test_masks_that_cover_a_field_together_are_named() -> None:
    left = [[150.0, 0.0], [180.0, 0.0], [180.0, 60.0], [150.0, 60.0]]
    right = [[180.0, 0.0], [210.0, 0.0], [210.0, 60.0], [180.0, 60.0]]
    ahead = [[0.0, 0.0], [20.0, 0.0], [20.0, 60.0]]
    half = np.tan(np.deg2rad([5.0, 5.0]))
    field_d = field_directions(half) @ rotation_from_angles(*np.deg2rad([180.0, 30.0, 0.0])).T
    assert masks_of(left, right, ahead).covering_masks(field_d) == ["mask_0", "mask_1"]
    assert masks_of(left, ahead).covering_masks(field_d) == []
    assert DeckMasks((), ()).covering_masks(field_d) == []

"""Random scenes of star sensors aboard, for tests: attitude, stars and errors are drawn; identities can be false."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars

FIELD_RADIUS_DEG = 6.0
"""Radius of the round field of view, chosen here: models.md §2, the source of the error terms, states none."""
SIGMA = 3.0 * ARCSEC
INSTALLATION_SIGMA = np.array([20.0, 1.0, 1.0]) * ARCSEC
UT1_SIGMA_S, POSITION_SIGMA_M, REFRACTION_SIGMA = 0.01, 5.0, 0.01
LATITUDE = np.deg2rad(31.945213)
SENSORS_DEG = ((0.0, 45.0), (90.0, 45.0))


@dataclass(frozen=True)
class Scene:
    """Matched stars, the true attitude (horizon from deck), and flags of correct identities."""

    stars: MatchedStars
    rotation_nd: FloatArray
    is_true: np.ndarray


def draw_scene(
    rng: np.random.Generator,
    counts: tuple[int, ...],
    false_stars: int = 0,
    swapped_pairs: int = 0,
    neighbours: int = 0,
    heading_deg: float | None = None,
    tilt_deg: float = 5.0,
) -> Scene:
    """Return a scene with ``counts`` true stars in each sensor, all common errors drawn.

    Args:
        rng: source of all random numbers.
        counts: true stars of each sensor.
        false_stars: stars whose place and identity are drawn independently, uniform in the field.
        swapped_pairs: pairs of further stars of one sensor with each other's identity.
        neighbours: further stars with the identity of a neighbour within 120".
        heading_deg: heading of the ship; None for a drawn heading.
        tilt_deg: largest pitch and roll.
    """
    heading = rng.uniform(0.0, 360.0) if heading_deg is None else heading_deg
    tilts = rng.uniform(-tilt_deg, tilt_deg, 2)
    rotation_nd = rotation_from_angles(*np.deg2rad([heading, *tilts]))
    mountings = [rotation_from_angles(*np.deg2rad([*angles, 0.0])) for angles in SENSORS_DEG[: len(counts)]]
    errors = [exp_rotation(INSTALLATION_SIGMA * rng.standard_normal(3)) for _ in mountings]
    sensor, kinds = [], []
    for index, count in enumerate(counts):
        sensor += [index] * count
        kinds += ["true"] * count
    for kind, extra in (("false", false_stars), ("neighbour", neighbours)):
        sensor += rng.integers(len(counts), size=extra).tolist()
        kinds += [kind] * extra
    for _ in range(swapped_pairs):
        sensor += [int(rng.integers(len(counts)))] * 2
        kinds += ["swap", "swapped"]
    sensor = np.array(sensor, dtype=int)
    seen_s, named_s = _in_field(rng, len(sensor)), None
    named_s = seen_s.copy()
    for row, kind in enumerate(kinds):
        if kind == "false":
            named_s[row] = _in_field(rng, 1)[0]
        elif kind == "neighbour":
            named_s[row] = _offset_direction(
                seen_s[row], 120.0 * ARCSEC * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
            )
        elif kind == "swap":
            named_s[[row, row + 1]] = seen_s[[row + 1, row]]
    truth_ns = np.array([rotation_nd @ m @ e for m, e in zip(mountings, errors, strict=True)])[sensor]
    apparent_n = np.einsum("kij,kj->ki", truth_ns, named_s)
    shared_n = shared_columns(apparent_n)
    # The directions computed from the catalogue are the apparent directions minus the shared errors.
    reference_n = _unit(apparent_n - shared_n @ rng.standard_normal(shared_n.shape[-1]))
    noise = SIGMA * rng.standard_normal(seen_s.shape)
    measured_s = _unit(seen_s + noise)
    measured_d = np.einsum("kij,kj->ki", np.array(mountings)[sensor], measured_s)
    mounting_d = np.array([m * INSTALLATION_SIGMA for m in mountings])
    stars = MatchedStars(
        measured_d, reference_n, np.full(len(sensor), SIGMA), np.zeros(len(sensor)), shared_n, sensor, mounting_d
    )
    return Scene(stars, rotation_nd, np.array([kind == "true" for kind in kinds]))


def shared_columns(direction_n: FloatArray) -> FloatArray:
    """Return displacements by one sigma of refraction (1 %), UT1, position north and east, (k, 3, 4); models.md §2."""
    horizontal = np.hypot(direction_n[:, 0], direction_n[:, 2])
    upward = direction_n * (-direction_n[:, 1] / horizontal)[:, None]
    upward[:, 1] = horizontal
    # Refraction is 59" at 45 degrees, and proportional to the tangent of the zenith distance.
    bent = REFRACTION_SIGMA * 59.0 * ARCSEC * horizontal / np.maximum(direction_n[:, 1], 0.1)
    turns = np.array(
        [
            15.041 * ARCSEC * UT1_SIGMA_S * np.array([np.cos(LATITUDE), np.sin(LATITUDE), 0.0]),
            POSITION_SIGMA_M / 6.371e6 * np.array([0.0, 0.0, 1.0]),
            -POSITION_SIGMA_M / 6.371e6 * np.array([1.0, np.tan(LATITUDE), 0.0]),
        ]
    )
    columns = [upward * bent[:, None], *(np.cross(turn, direction_n) for turn in turns)]
    return np.stack(columns, axis=-1)


def attitude_error(scene: Scene, rotation_nd: FloatArray) -> FloatArray:
    """Return delta with R_true = exp(delta) R, small, shape (3,)."""
    turn = scene.rotation_nd @ rotation_nd.T
    return 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def _in_field(rng: np.random.Generator, count: int) -> FloatArray:
    radius = np.deg2rad(FIELD_RADIUS_DEG) * np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([np.cos(radius), np.sin(radius) * np.cos(turn), np.sin(radius) * np.sin(turn)], axis=-1)


def _offset_direction(direction: FloatArray, angle: float, position_angle: float) -> FloatArray:
    across = np.cross(direction, [0.0, 1.0, 0.0])
    across = exp_rotation(direction * position_angle) @ (across / np.linalg.norm(across))
    return direction * np.cos(angle) + across * np.sin(angle)


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

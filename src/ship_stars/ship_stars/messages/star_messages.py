"""Reader of star observation messages: checks, directions and identities; shared by all adapters of cameras.

Only attributes of messages are read, so any message class can be used. For a message that cannot be used the reader
raises :class:`ship_node.messages.field_checks.MessageRejected`. A star that cannot be used is rejected with its reason,
and the other stars of the message are used.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.star_directions import StarPositions, fixed_stars
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S
from ship_node.messages.field_checks import ReadMessage, check_device_id, check_frame, exposure_length_s, stamp_ns
from ship_stars.attitude_from_stars.exposure import ExposureLength, StarExposure
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.config import CameraConfig
from ship_stars.sky.catalogue import UNKNOWN, StarCatalogue, julian_year
from ship_stars.sky.deck_masks import SensorMasks

MAX_STARS = 100
"""Maximum number of stars of an exposure; further stars are ignored, so that no message can block the node."""

_GIVEN_DIRECTION_SIGMA = 0.05 * ARCSEC
"""Standard deviation of a direction given in a message, rad per axis, as for a catalogue star with known motion."""

_MIN_FORWARD = math.cos(math.radians(60.0))
"""Cosine of the largest angle between a star and the boresight."""

_MAX_PIXEL = 1e6
_MIN_SIGMA_PX, _MAX_SIGMA_PX = 1e-4, 100.0
_ANGLE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class _StarColumns:
    """Fields of k stars of a message.

    Attributes:
        pixels: centroids (u, v), px, shape (k, 2).
        sigma_px: standard deviation of the centroids, each axis, px, shape (k,); as configured if the message has none.
        sigma_known: True if the message has a sigma for every star.
        right_ascension: ICRS, rad, shape (k,); NaN if not given.
        declination: ICRS, rad, shape (k,); NaN if not given.
        hip: catalogue numbers, shape (k,); 0 if not given.
        magnitude: magnitudes, shape (k,); NaN if not given.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    sigma_known: bool
    right_ascension: FloatArray
    declination: FloatArray
    hip: NDArray[np.int64]
    magnitude: FloatArray


class ExposingSensor(NamedTuple):
    """Star sensor of a topic.

    Attributes:
        sensor_id: name of the sensor.
        frame_id: required frame_id of its messages; empty for any.
        camera: its camera.
        camera_config: parameters of the camera, with centroid errors and the width of a star image.
        masks: obstructions of the field of view on deck; None without obstructions.
    """

    sensor_id: str
    frame_id: str
    camera: StarCamera
    camera_config: CameraConfig
    masks: SensorMasks | None = None


def star_exposure(
    message: Any, receive_ns: int, sensor: ExposingSensor, catalogue: StarCatalogue, named_by_number: bool = False
) -> ReadMessage[StarExposure]:
    """Read ``star/<sensor>/observations``: directions in the sensor frame, and identities of the stars.

    The position of a star with a catalogue number is taken from the catalogue, otherwise from the message. A star with
    neither number nor position is identified later.

    Args:
        message: StarObservationArray.
        receive_ns: arrival time.
        sensor: sensor of the topic.
        catalogue: star catalogue for the numbers.
        named_by_number: True to name a rejected star by its catalogue number if it has one; other rejected stars are
            named by their index in the message.

    Returns:
        The exposure with the usable stars; the other stars of the message are rejected.

    Raises:
        MessageRejected: the whole message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_device_id("sensor_id", message.sensor_id, sensor.sensor_id)
    check_frame(message.header.frame_id, sensor.frame_id)
    exposure_s = exposure_length_s(message.exposure_s, LONGEST_EXPOSURE_S)
    camera, camera_config = sensor.camera, sensor.camera_config
    columns = _star_columns(message.stars[:MAX_STARS], camera_config.centroid_sigma_px)
    # Squares of the largest doubles would overflow.
    directions_s, direction_sigma = camera.measured_directions(
        np.where(np.abs(columns.pixels) < _MAX_PIXEL, columns.pixels, np.nan),
        np.where(np.abs(columns.sigma_px) <= _MAX_SIGMA_PX, columns.sigma_px, np.nan),
    )
    rows, given = catalogue.rows(columns.hip), fixed_stars(columns.right_ascension, columns.declination)
    # Values of stars without a row are not used.
    any_rows = np.maximum(rows, 0)
    listed_sigma = catalogue.position_sigma_at(any_rows, julian_year(time_ns))
    rejections = _rejections(columns, directions_s, rows, catalogue)
    kept = np.flatnonzero([rejection is None for rejection in rejections])
    listed = columns.hip != 0
    exposure = StarExposure(
        source=f"star.{sensor.sensor_id}",
        time_ns=time_ns,
        hip=columns.hip[kept],
        directions_s=directions_s[kept],
        sigma=direction_sigma[kept],
        positions=_positions(listed, catalogue.at_j2000[any_rows], given, kept),
        position_sigma=np.where(listed, listed_sigma, _GIVEN_DIRECTION_SIGMA)[kept],
        magnitude=columns.magnitude[kept],
        length=ExposureLength(exposure_s, camera, camera_config.psf_sigma_px) if exposure_s > 0.0 else None,
        masks=sensor.masks,
        optics=camera_config.optics_errors(camera),
        spatial=camera_config.spatial_errors(camera),
    )
    unused_stars = _unused_stars(message.stars, rejections, named_by_number)
    return ReadMessage(exposure, columns.sigma_known, unused_stars, is_empty=not message.stars)


def _star_columns(stars: Sequence[Any], centroid_sigma_px: float) -> _StarColumns:
    """Return the fields of the stars of a message; ``centroid_sigma_px`` is used for stars without sigma."""
    rows = [[star.u, star.v, star.sigma_px, star.right_ascension, star.declination, star.magnitude] for star in stars]
    u, v, sigma_px, right_ascension, declination, magnitude = np.array(rows, dtype=float).reshape(-1, 6).T
    not_given = ~(sigma_px > 0.0) & ~(sigma_px < 0.0)
    return _StarColumns(
        pixels=np.stack([u, v], axis=-1),
        sigma_px=np.where(not_given, centroid_sigma_px, sigma_px),
        sigma_known=not not_given.any(),
        right_ascension=right_ascension,
        declination=declination,
        hip=np.array([star.catalogue_id for star in stars], dtype=np.int64),
        magnitude=magnitude,
    )


def _rejections(
    columns: _StarColumns, directions_s: FloatArray, rows: NDArray[np.int64], catalogue: StarCatalogue
) -> list[Rejection | None]:
    """Return the rejection of each star; None for a usable star."""
    first_pixels: dict[Hashable, list[float]] = {}
    measured = columns.pixels, directions_s[:, 0], columns.sigma_px
    identity = columns.hip, rows, columns.right_ascension, columns.declination
    return [
        _measurement_rejection(pixel, forward, sigma_px)
        or _identity_rejection(hip, row, right_ascension, declination, catalogue)
        or _duplicate_rejection(_identity(hip, right_ascension, declination), pixel, first_pixels)
        for pixel, forward, sigma_px, hip, row, right_ascension, declination in zip(
            *(column.tolist() for column in (*measured, *identity)), strict=True
        )
    ]


def _unused_stars(
    stars: Sequence[Any], rejections: Sequence[Rejection | None], named_by_number: bool
) -> tuple[tuple[str, Rejection], ...]:
    """Return the rejected stars by name. All stars beyond ``MAX_STARS`` are reported by one entry."""
    rows = [(row, rejection) for row, rejection in enumerate(rejections) if rejection is not None]
    if len(stars) > MAX_STARS:
        text = f"{len(stars)} stars in one exposure: only the first {MAX_STARS} are used"
        rows.append((MAX_STARS, Rejection(Reason.OVERFLOW, text)))
    numbers = {row: stars[row].catalogue_id for row, _ in rows if named_by_number}
    return tuple(
        (f"HIP {numbers[row]}" if numbers.get(row) else f"star {row + 1} of the message", rejection)
        for row, rejection in rows
    )


def _measurement_rejection(pixel: list[float], forward: float, sigma_px: float) -> Rejection | None:
    """Return the rejection of a star with a bad centroid; None for other stars."""
    is_finite = math.isfinite(pixel[0]) and math.isfinite(pixel[1])
    if not (is_finite and forward > _MIN_FORWARD):
        where = f"pixel ({pixel[0]:.6g}, {pixel[1]:.6g})"
        text = "is outside this camera's field of view: expected pixels counted from the corner of the detector"
        return Rejection(Reason.UNITS, f"{where} {text}") if is_finite else Rejection(Reason.NON_FINITE, where)
    if not _MIN_SIGMA_PX <= sigma_px <= _MAX_SIGMA_PX:
        text = f"sigma_px {sigma_px:.3g}: expected {_MIN_SIGMA_PX:g} to {_MAX_SIGMA_PX:g} px"
        return Rejection(Reason.BAD_COVARIANCE, text)
    return None


def _identity_rejection(
    hip: int, row: int, right_ascension: float, declination: float, catalogue: StarCatalogue
) -> Rejection | None:
    """Return the rejection of a star with an unknown number, or a bad position and no number; None for other stars."""
    if hip != 0 and row == UNKNOWN:
        listed = f"{len(catalogue.hip)} stars, HIP {catalogue.hip[0]} to {catalogue.hip[-1]}"
        return Rejection(Reason.UNKNOWN_STAR, f"HIP {hip} is not in Hipparcos-2 ({listed})")
    if hip != 0 or (math.isnan(right_ascension) and math.isnan(declination)):
        return None
    where = f"right ascension {right_ascension:.6g}, declination {declination:.6g}"
    if not math.isfinite(right_ascension) or not math.isfinite(declination):
        return Rejection(Reason.NON_FINITE, f"{where}: expected both, or NaN for both")
    if abs(right_ascension) > 2 * np.pi + _ANGLE_TOLERANCE or abs(declination) > np.pi / 2 + _ANGLE_TOLERANCE:
        return Rejection(Reason.UNITS, f"{where} cannot be radians: degrees?")
    return None


def _identity(hip: int, right_ascension: float, declination: float) -> Hashable:
    """Return the identity of a star, equal for the same star; None if the star is not identified yet."""
    if hip != 0:
        return hip
    return None if math.isnan(right_ascension) else (right_ascension, declination)


def _duplicate_rejection(
    identity: Hashable, pixel: list[float], first_pixels: dict[Hashable, list[float]]
) -> Rejection | None:
    """Return the rejection of a star with the identity of an earlier star of the message; None for other stars."""
    first = pixel if identity is None else first_pixels.setdefault(identity, pixel)
    if first is pixel:
        return None
    text = f"the same star twice in one exposure, first at pixel ({first[0]:.6g}, {first[1]:.6g})"
    return Rejection(Reason.DUPLICATE if first == pixel else Reason.CONFLICT, text)


def _positions(
    listed: NDArray[np.bool_], of_catalogue: StarPositions, given: StarPositions, kept: NDArray[np.intp]
) -> StarPositions:
    """Return the positions of the usable stars, from the catalogue if listed there, else from the message."""
    if listed.all():
        return of_catalogue[kept]
    columns = [
        np.where(listed, getattr(of_catalogue, name), getattr(given, name))[kept]
        for name in StarPositions.__dataclass_fields__
    ]
    return StarPositions(*columns)

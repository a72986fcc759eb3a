"""Stars of one exposure: directions at mid-exposure, identities and catalogue positions.

A ship rotates while a star sensor exposes. The centroid of a streak is the mean of the star's pixels over the exposure.
The centroid differs from the pixel at mid-exposure because of the angular and the centripetal acceleration. This
difference is computed from the rotation of the sensor, which the INS measures. The light of an image at rest has the
variance s², and along a streak of L pixels s² + L²/12. The variance σ² of the centroid grows by the same factor along
the streak, to σ² (1 + L²/(12 s²)), and is unchanged across the streak (docs/explanation/star_camera.md).

The gate of a detection without an identity is centred on the direction that the predicted attitude of the sensor gives.
The detection is identified if exactly one catalogue star is within the gate, and no other detection matches this star
or already has its identity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_estimation.plausibility.stuck_check import StuckValue
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.star_directions import StarPositions
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.exposure_mean import Nodes, exposure_nodes
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars
from ship_stars.attitude_from_stars.identification import MAGNITUDE_TOLERANCE, MAX_PRIOR_SIGMA, find_candidates
from ship_stars.attitude_from_stars.selection import LINEAR_RANGE, WRONG_IDENTITY_RATIO, StarPrior
from ship_stars.camera.camera import StarCamera, equivalent_sigma
from ship_stars.camera.errors import (
    FIELD_MODES,
    OPTICS_MODES,
    SOURCE_FIELD,
    SOURCE_OPTICS,
    OpticsErrors,
    PixelDwell,
    SpatialErrors,
)
from ship_stars.sky.catalogue import julian_year
from ship_stars.sky.deck_masks import SensorMasks
from ship_stars.sky.sky_model import LocalSky, SkyModel

_PRIOR_TOO_WIDE = f"the attitude is not known to {np.rad2deg(MAX_PRIOR_SIGMA):.0f}°: too many catalogue stars match"

_ONE_SENSOR: FloatArray = np.empty((0, 3, 3))
"""Empty array of mounting errors, for stars that are compared in the frame of their sensor."""

_OUT_OF_VIEW_VARIANCE = 1.0
"""Variance of a star whose streak leaves the range of the camera model, rad²; the star has practically no weight."""


@dataclass(frozen=True)
class ExposureLength:
    """Length of an exposure, and the camera parameters that determine streaks.

    Attributes:
        exposure_s: length of the exposure, above 0.
        camera: geometry of the sensor.
        psf_sigma_px: standard deviation of the image of a star at rest, each axis.
    """

    exposure_s: float
    camera: StarCamera
    psf_sigma_px: float

    @cached_property
    def nodes(self) -> Nodes:
        """Quadrature nodes at which the motion is evaluated for the mean over the exposure."""
        return exposure_nodes(self.exposure_s)

    @property
    def coverage_rejection(self) -> Rejection:
        """Rejection of an exposure for which the INS has no samples over its full length."""
        return Rejection(Reason.GAP, f"no INS samples over the whole exposure of {self.exposure_s:g} s")

    def unmeasured_turn_variance(self, acceleration: float) -> float:
        """Return the variance of the mean attitude minus the attitude at mid-exposure, each axis, rad².

        This difference is unknown without an INS.

        Args:
            acceleration: standard deviation of the sensor's angular acceleration, each axis, rad/s².
        """
        return (acceleration * self.exposure_s**2 / 24.0) ** 2


@dataclass(frozen=True)
class StarExposure:
    """The k stars of one exposure of one sensor.

    Attributes:
        source: name of the sensor, ``star.<id>``.
        time_ns: middle of the exposure, stamp of the sensor.
        hip: HIP number of each star, shape (k,); 0 if the message gives a direction in the ICRS, or the star is
            unidentified.
        directions_s: unit vectors in the sensor frame (forward, up, right), shape (k, 3).
        sigma: standard deviation of each direction, rad per axis, shape (k,).
        positions: positions of the stars, J2000.0; NaN for an unidentified star.
        position_sigma: standard deviation of each star's position, rad per axis, shape (k,).
        magnitude: measured magnitudes, shape (k,); NaN where unknown.
        length: length of the exposure, with its camera; None if the message does not state the length.
        smear_s: covariance that the motion during the exposure adds to a direction, in the sensor frame, rad², shape
            (k, 3, 3); None before :func:`reduce_to_mid_exposure`.
        streak_length: length of each star's streak, rad, shape (k,); None before :func:`reduce_to_mid_exposure`.
        masks: deck masks in the sensor's view; None if there are none.
        optics: errors of the camera's optics parameters; None for exact parameters.
        spatial: errors that depend on the position on the detector; None if there are none.
        pixel_dwell: pixel dwell of the stars; None before :meth:`with_pixel_dwell`, or without pixel-spatial errors.
    """

    source: str
    time_ns: int
    hip: NDArray[np.int64]
    directions_s: FloatArray
    sigma: FloatArray
    positions: StarPositions
    position_sigma: FloatArray
    magnitude: FloatArray
    length: ExposureLength | None = None
    smear_s: FloatArray | None = None
    streak_length: FloatArray | None = None
    masks: SensorMasks | None = None
    optics: OpticsErrors | None = None
    spatial: SpatialErrors | None = None
    pixel_dwell: PixelDwell | None = None
    covariance_known = True  # a centroid without a sigma in the message has the configured sigma

    @property
    def reach_ns(self) -> int:
        """Time before and after the middle for which the sensor's motion is needed; 0 if no length was given."""
        return 0 if self.length is None else self.length.nodes.reach_ns

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant while the ship rotates."""
        sigma_rad = float(self.sigma.max(initial=0.0))
        return StuckValue(self.directions_s, sigma_rad, "stars do not move on the detector")

    @property
    def is_identified(self) -> NDArray[np.bool_]:
        """True for each identified star, shape (k,)."""
        return np.isfinite(self.positions.right_ascension)

    def name(self, row: int) -> str:
        """Return a star's name for texts: HIP number, else position in the ICRS, else direction in the sensor frame."""
        hip = int(self.hip[row])
        if hip:
            return f"HIP {hip}"
        alpha, delta = self.positions.right_ascension[row], self.positions.declination[row]
        if np.isfinite(alpha):
            return f"star at right ascension {np.rad2deg(alpha):.4f}°, declination {np.rad2deg(delta):+.4f}°"
        _, up, right = self.directions_s[row]
        return f"star {np.rad2deg(up):+.2f}° up, {np.rad2deg(right):+.2f}° right of the boresight"

    def __len__(self) -> int:
        return len(self.hip)

    def __getitem__(self, rows: Any) -> StarExposure:
        """Return the exposure with some of its stars."""
        return replace(
            self,
            hip=self.hip[rows],
            directions_s=self.directions_s[rows],
            sigma=self.sigma[rows],
            positions=self.positions[rows],
            position_sigma=self.position_sigma[rows],
            magnitude=self.magnitude[rows],
            smear_s=None if self.smear_s is None else self.smear_s[rows],
            streak_length=None if self.streak_length is None else self.streak_length[rows],
        )

    def with_pixel_dwell(self, before: PixelDwell | None) -> StarExposure:
        """Return the exposure with its pixel dwell; unchanged if the sensor has no pixel-spatial errors.

        Args:
            before: pixel dwell of the sensor's previous exposure; None if there is none.
        """
        if self.spatial is None or self.spatial.pixel_sigma_px <= 0.0:
            return self
        return replace(self, pixel_dwell=self.spatial.pixel_dwell(self.directions_s, self.sigma, before))

    @property
    def single_star_sigma(self) -> FloatArray:
        """Standard deviation of each direction, errors of optics and detector included, rad per axis, shape (k,)."""
        field_s = self.field_modes
        of_field = 0.0 if field_s is None else 0.5 * np.sum(field_s**2, axis=(-2, -1))
        of_pixels = 0.0 if self.pixel_sigma is None else self.pixel_sigma**2
        sigma: FloatArray = np.sqrt(self.sigma**2 + of_field + of_pixels)
        return sigma

    @cached_property
    def field_modes(self) -> FloatArray | None:
        """Displacement of the directions by one sigma of each of f correlated camera errors, rad, shape (k, 3, f).

        The errors of the optics are the first columns, the field-spatial errors follow. None without such errors.
        """
        of_optics = None if self.optics is None else self.optics.modes(self.directions_s)
        of_field = None if self.spatial is None else self.spatial.field_modes(self.directions_s)
        if of_optics is None or of_field is None:
            return of_field if of_optics is None else of_optics
        return np.concatenate([of_optics, of_field], axis=-1)

    @property
    def field_sources(self) -> tuple[str, ...]:
        """Error source of each column of :attr:`field_modes`."""
        of_field = self.spatial is not None and self.spatial.field_sigma_px > 0.0
        of_optics = self.optics is not None
        return (SOURCE_OPTICS,) * (OPTICS_MODES * of_optics) + (SOURCE_FIELD,) * (FIELD_MODES * of_field)

    @cached_property
    def pixel_sigma(self) -> FloatArray | None:
        """Standard deviation of each direction's pixel-spatial error, rad per axis, shape (k,); None if unmodelled."""
        if self.spatial is None or self.spatial.pixel_sigma_px <= 0.0:
            return None
        sigma = self.spatial.pixel_sigma(self.directions_s)
        if self.streak_length is None:
            return sigma
        return sigma * np.sqrt(self.spatial.streak_variance_ratio(self.streak_length))

    def content(self) -> bytes:
        """Return the values of the message as bytes, to recognise a repetition and to sort messages with one stamp."""
        places = self.positions.right_ascension, self.positions.declination
        arrays = (self.hip, self.directions_s, self.sigma, *places, self.magnitude)
        length = b"" if self.length is None else np.float64(self.length.exposure_s).tobytes()
        return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays) + length


def reduce_to_mid_exposure(exposure: StarExposure, turns: FloatArray) -> StarExposure:
    """Return the stars with their directions at mid-exposure and the errors that their streaks add.

    A star whose streak leaves the range of the camera model keeps its direction, but has practically no weight.

    Args:
        exposure: exposure with a known length.
        turns: rotations "sensor at the node from sensor at mid-exposure" at the nodes of the exposure, shape (m, 3, 3).
    """
    length = exposure.length
    assert length is not None
    camera, seen_s = length.camera, exposure.directions_s
    nodes, passed_s = length.nodes, seen_s @ np.swapaxes(turns, -1, -2)
    pixels, middle = camera.pixels(passed_s), camera.pixels(seen_s)
    directions_s = camera.directions(middle - (nodes.mean(pixels) - middle))
    blur = equivalent_sigma(camera.direction_covariance(middle, length.psf_sigma_px))
    spread_s = _perpendicular_part(seen_s, nodes.covariance(passed_s))
    smear_s: FloatArray = spread_s * ((exposure.sigma / blur) ** 2)[:, None, None]
    streak = np.sqrt(12.0 * np.trace(spread_s, axis1=-2, axis2=-1))
    lost = ~np.all(np.isfinite(directions_s), axis=-1)
    directions_s[lost] = seen_s[lost]
    smear_s[lost] = _perpendicular_part(seen_s[lost], _OUT_OF_VIEW_VARIANCE * np.eye(3))
    return replace(exposure, directions_s=directions_s, smear_s=smear_s, streak_length=streak)


def _perpendicular_part(directions_s: FloatArray, covariance_s: FloatArray) -> FloatArray:
    """Return the part of covariances across the lines of sight, shape (k, 3, 3)."""
    keep = np.eye(3) - directions_s[:, :, None] * directions_s[:, None, :]
    across: FloatArray = keep @ covariance_s @ keep
    return across


def visible_stars(
    exposure: StarExposure, sky_model: SkyModel, prior: StarPrior | None
) -> tuple[StarExposure, MatchedStars, list[tuple[str, Rejection]]] | Rejection:
    """Identify the stars of an exposure, and return those that have a direction in the sky model.

    Args:
        exposure: the stars as the sensor measured them.
        sky_model: the sky model.
        prior: attitude of the sensor, used to identify stars; None to reject all unidentified stars.

    Returns:
        The exposure with the usable stars.
        The usable stars with their sky directions, in the sensor frame.
        The names of the other stars, each with its rejection.
        Instead of these three, one rejection if the sky model gives no directions at the time of the exposure.
    """
    rejected: list[tuple[str, Rejection]] = []
    known = named = exposure.is_identified
    detections = len(exposure)
    local_sky = sky_model.sky_at(exposure.time_ns)
    if isinstance(local_sky, Rejection):
        return local_sky
    if not known.all():
        reasons: dict[int, Rejection] = {}
        if prior is not None:
            exposure, reasons = identify_stars(exposure, prior, local_sky)
            known = exposure.is_identified
        text = "the message contains no identity, and no attitude predicts the star"
        unidentified = Rejection(Reason.UNIDENTIFIED, text)
        rejected += [(exposure.name(row), reasons.get(row, unidentified)) for row in np.flatnonzero(~known).tolist()]
        exposure, named = exposure[known], named[known]
    apparent = local_sky.apparent_stars(exposure.positions)
    direction_n, shared_n, is_visible = apparent.direction_n, apparent.shared_n, apparent.visible
    if not is_visible.all():
        for row in np.flatnonzero(~is_visible).tolist():
            rejected.append((exposure.name(row), local_sky.low_elevation_rejection(float(apparent.elevation[row]))))
        exposure, named = exposure[is_visible], named[is_visible]
        direction_n, shared_n = direction_n[is_visible], shared_n[is_visible]
    false_match_density = None
    # With a narrow prior, a wrong identity of a named star is very improbable.
    if prior is not None and (np.trace(prior.covariance_n) > LINEAR_RANGE**2 or not named.all()):
        false_match_density = detections * local_sky.bright.density(exposure.magnitude, MAGNITUDE_TOLERANCE)
        false_match_density *= np.where(named, WRONG_IDENTITY_RATIO, 1.0)
    stars = MatchedStars(
        measured_b=exposure.directions_s,
        reference_n=direction_n,
        sigma=exposure.sigma,
        position_sigma=exposure.position_sigma,
        shared_n=shared_n,
        sensor=np.zeros(len(direction_n), dtype=np.intp),
        mounting_b=_ONE_SENSOR,
        smear_b=exposure.smear_s,
        false_match_density=false_match_density,
        pixel_sigma=exposure.pixel_sigma,
        field_b=exposure.field_modes,
        field_sources=exposure.field_sources,
    )
    return exposure, stars, rejected


def identify_stars(
    exposure: StarExposure, prior: StarPrior, local_sky: LocalSky
) -> tuple[StarExposure, dict[int, Rejection]]:
    """Identify the stars of an exposure that have no identity, where possible.

    Args:
        exposure: the stars as the sensor measured them.
        prior: attitude of the sensor.
        local_sky: the sky at the exposure; it also defines which catalogue stars are bright enough.

    Returns:
        The exposure with more identities, and the rejection of each row that is still unidentified.
    """
    rows = np.flatnonzero(~exposure.is_identified)
    if np.trace(prior.covariance_n) > MAX_PRIOR_SIGMA**2:
        return exposure, dict.fromkeys(rows.tolist(), Rejection(Reason.UNIDENTIFIED, _PRIOR_TOO_WIDE))
    smear_s = None if exposure.smear_s is None else exposure.smear_s[rows]
    found = find_candidates(
        exposure.directions_s[rows],
        exposure.single_star_sigma[rows],
        exposure.magnitude[rows],
        smear_s,
        prior,
        local_sky,
        exposure.masks,
    )
    # A catalogue star that matches two detections is assigned to neither. A catalogue star whose number is already in
    # the exposure is not assigned again.
    hip = local_sky.bright.catalogue.hip[found.rows]
    claimed_once = (np.count_nonzero(found.is_match, axis=0) == 1) & ~np.isin(hip, exposure.hip)
    chosen = np.full(len(rows), -1)
    reasons: dict[int, Rejection] = {}
    for number, row in enumerate(rows.tolist()):
        fitting = np.flatnonzero(found.is_match[number])
        if len(fitting) == 1 and claimed_once[fitting[0]]:
            chosen[number] = found.rows[fitting[0]]
        else:
            masks = exposure.masks.hiding_names(exposure.directions_s[row]) if exposure.masks is not None else ""
            reasons[row] = _identification_rejection(float(found.nearest[number]), len(fitting), masks)
    taken = chosen >= 0
    return _with_identities(exposure, rows[taken], chosen[taken], local_sky), reasons


def _identification_rejection(nearest: float, fitting: int, masks: str) -> Rejection:
    """Return the rejection of a detection that was not identified.

    Args:
        nearest: angle to the nearest catalogue star, rad; infinite if there is none.
        fitting: number of catalogue stars within the gate.
        masks: names of the masks that cover the detection; empty if there is none.
    """
    text = "no catalogue star in the field"
    if masks:
        text = f"not a star: inside the mask {masks}"
    elif fitting:
        text = f"ambiguous: {fitting} catalogue stars within the gate, or one matched by two detections"
    elif np.isfinite(nearest):
        text = f'no catalogue star within the gate, the nearest is {nearest / ARCSEC:.0f}" away'
    return Rejection(Reason.UNIDENTIFIED, text)


def _with_identities(
    exposure: StarExposure, rows: NDArray[np.intp], chosen: NDArray[np.intp], local_sky: LocalSky
) -> StarExposure:
    """Return the exposure with its rows ``rows`` identified as the catalogue stars ``chosen``."""
    catalogue = local_sky.bright.catalogue
    hip, position_sigma = exposure.hip.copy(), exposure.position_sigma.copy()
    hip[rows] = catalogue.hip[chosen]
    position_sigma[rows] = catalogue.position_sigma_at(chosen, julian_year(exposure.time_ns))
    positions = {}
    for name in StarPositions.__dataclass_fields__:
        column = getattr(exposure.positions, name).copy()
        column[rows] = getattr(catalogue.at_j2000, name)[chosen]
        positions[name] = column
    return replace(exposure, hip=hip, positions=StarPositions(**positions), position_sigma=position_sigma)

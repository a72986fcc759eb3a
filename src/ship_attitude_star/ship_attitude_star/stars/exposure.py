"""The stars of one exposure of a star sensor: where they stood at its middle, which stars they are, and their places.

A ship turns while a star sensor exposes. The centroid of a streak is the mean of the star's pixels over the exposure.
The INS tells how the sensor turned, and so by how much that mean is off the pixel at the middle: by the angular
acceleration and its centripetal part. A streak of L pixels spreads the light along itself by L²/12 more than the image
of a star at rest, s², so that along the streak the centroid's variance is σ² (1 + L²/(12 s²)). Across the streak
nothing changes (docs/explanation/stars.md).

A detection without an identity is identified by the attitude that is predicted for its sensor. It is the nearest
catalogue star within the gate; where a second star could be meant too, it stays without an identity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.sky.catalogue import julian_year
from ship_attitude_star.sky.sky_watch import SkyMoment, SkyWatch
from ship_attitude_star.stars.camera import StarCamera, equivalent_sigma
from ship_attitude_star.stars.chance import WRONG_NAMES
from ship_attitude_star.stars.fit import SightedStars
from ship_attitude_star.stars.identification import MAGNITUDE_TOLERANCE, WIDEST, candidates
from ship_attitude_star.stars.optics_errors import OPTICS_MODES, SOURCE_OPTICS, OpticsErrors
from ship_attitude_star.stars.selection import LINEAR_RANGE, StarPrior
from ship_attitude_star.stars.spatial_errors import FIELD_MODES, SOURCE_FIELD, PixelStay, SpatialErrors
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.deck_masks import SensorMasks
from ship_geometry.exposure_mean import Nodes, exposure_nodes
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.star_directions import StarPositions

_PRIOR_TOO_WIDE = f"the attitude is not known to {np.rad2deg(WIDEST):.0f}°: too many catalogue stars fit"

_ONE_SENSOR: FloatArray = np.empty((0, 3, 3))
"""Mounting errors of stars that are compared in their sensor's own frame: none."""

_OUT_OF_SIGHT = 1.0
"""Variance of a star that leaves the camera's sight during the exposure, rad²: so large that the star has no weight."""


@dataclass(frozen=True)
class ExposureLength:
    """How long an exposure lasted, and how the camera shows a star that moves meanwhile.

    Attributes:
        exposure_s: length, above 0.
        camera: geometry of the sensor.
        psf_sigma_px: standard deviation of the image of a star at rest, each axis.
    """

    exposure_s: float
    camera: StarCamera
    psf_sigma_px: float

    @cached_property
    def nodes(self) -> Nodes:
        """Moments at which the motion is asked for, to find the mean over the exposure."""
        return exposure_nodes(self.exposure_s)

    @property
    def not_covered(self) -> Refusal:
        """Refusal of an exposure that is compared with an INS which has no samples over the whole of it."""
        return Refusal(Reason.GAP, f"no INS samples over its whole exposure of {self.exposure_s:g} s")

    def untold_turn_variance(self, acceleration: float) -> float:
        """Variance of the turn from the mean of the exposure to its middle where no INS tells it, each axis, rad².

        Args:
            acceleration: angular acceleration that the sensor may have, standard deviation of each axis, rad/s².
        """
        return (acceleration * self.exposure_s**2 / 24.0) ** 2


@dataclass(frozen=True)
class StarExposure:
    """The stars of one exposure of one sensor; arrays have one entry a star.

    Attributes:
        source: ``star.<id>``.
        time_ns: middle of the exposure, stamp of the sensor.
        hip: HIP numbers; 0 where the star has none, because its direction in the ICRS was given or it is unidentified.
        directions_s: unit vectors in the sensor frame (forward, up, right), shape (k, 3).
        sigma: error of a direction, rad per axis across it, shape (k,).
        positions: of the stars, J2000.0; NaN where a star is not identified yet.
        position_sigma: error of the star's position, rad per axis, shape (k,).
        magnitude: as measured, shape (k,); NaN where unknown.
        length: how long the exposure lasted, and of which camera it is; None where the message does not tell.
        smear_s: what the motion during the exposure adds to the error of a direction, covariance in the sensor frame,
            rad², shape (k, 3, 3); None before :func:`at_middle`.
        streak: how far each star went on the detector meanwhile, rad, shape (k,); None before :func:`at_middle`.
        masks: what stands on deck in the sensor's way; None where nothing does.
        optics: errors of the parameters of its camera's optics; None where they are exact.
        spatial: errors that stay with a star's place on the detector; None where there are none.
        stay: how long the stars have kept their pixels; None before :meth:`after`, and where nothing depends on it.
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
    streak: FloatArray | None = None
    masks: SensorMasks | None = None
    optics: OpticsErrors | None = None
    spatial: SpatialErrors | None = None
    stay: PixelStay | None = None
    covariance_known = True  # a star whose message gives no error of its centroid has the configured one

    @property
    def reach_ns(self) -> int:
        """How far from the middle the motion of the sensor must be known; 0 where no length was given."""
        return 0 if self.length is None else self.length.nodes.reach_ns

    @property
    def identified(self) -> NDArray[np.bool_]:
        """True where it is known which star it is, shape (k,)."""
        return np.isfinite(self.positions.right_ascension)

    def name(self, row: int) -> str:
        """A star for people: its number, else its place in the ICRS, else where the sensor saw it."""
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
        """The same exposure with some of its stars."""
        return StarExposure(
            self.source,
            self.time_ns,
            self.hip[rows],
            self.directions_s[rows],
            self.sigma[rows],
            self.positions[rows],
            self.position_sigma[rows],
            self.magnitude[rows],
            self.length,
            None if self.smear_s is None else self.smear_s[rows],
            None if self.streak is None else self.streak[rows],
            self.masks,
            self.optics,
            self.spatial,
            self.stay,
        )

    def after(self, before: PixelStay | None) -> StarExposure:
        """The same exposure as it counts after those before it of its sensor; None for none."""
        if self.spatial is None or self.spatial.pixel_sigma_px <= 0.0:
            return self
        return replace(self, stay=self.spatial.stay(self.directions_s, self.sigma, before))

    @property
    def lone_sigma(self) -> FloatArray:
        """Error of a direction taken by itself, those of optics and place included, rad per axis, shape (k,)."""
        field_s = self.field_modes
        of_field = 0.0 if field_s is None else 0.5 * np.sum(field_s**2, axis=(-2, -1))
        of_pixels = 0.0 if self.pixel_sigma is None else self.pixel_sigma**2
        sigma: FloatArray = np.sqrt(self.sigma**2 + of_field + of_pixels)
        return sigma

    @cached_property
    def field_modes(self) -> FloatArray | None:
        """Displacement of the directions by one sigma of each of f lasting errors of the camera, rad, shape (k, 3, f).

        The errors are those of the optics, then the field-spatial ones; None where there are none.
        """
        of_optics = None if self.optics is None else self.optics.modes(self.directions_s)
        of_field = None if self.spatial is None else self.spatial.field_modes(self.directions_s)
        if of_optics is None or of_field is None:
            return of_field if of_optics is None else of_optics
        return np.concatenate([of_optics, of_field], axis=-1)

    @property
    def field_sources(self) -> tuple[str, ...]:
        """Source of each of these errors."""
        of_field = self.spatial is not None and self.spatial.field_sigma_px > 0.0
        of_optics = self.optics is not None
        return (SOURCE_OPTICS,) * (OPTICS_MODES * of_optics) + (SOURCE_FIELD,) * (FIELD_MODES * of_field)

    @cached_property
    def pixel_sigma(self) -> FloatArray | None:
        """Pixel-spatial error of each direction, rad per axis, shape (k,); None where there is none."""
        if self.spatial is None or self.spatial.pixel_sigma_px <= 0.0:
            return None
        sigma = self.spatial.pixel_sigma(self.directions_s)
        return sigma if self.streak is None else sigma * np.sqrt(self.spatial.streak_share(self.streak))

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        positions = self.positions
        arrays = (
            self.hip,
            self.directions_s,
            self.sigma,
            positions.right_ascension,
            positions.declination,
            self.magnitude,
        )
        length = b"" if self.length is None else np.float64(self.length.exposure_s).tobytes()
        return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays) + length


def at_middle(exposure: StarExposure, turns: FloatArray) -> StarExposure:
    """The stars where they stood at the middle of the exposure, with what their streaks add to their errors.

    Args:
        exposure: of a known length.
        turns: of the sensor, rotations "sensor at the node from sensor at the middle" at the nodes of the length, shape
            (m, 3, 3).
    """
    length = exposure.length
    assert length is not None
    camera, seen_s = length.camera, exposure.directions_s
    nodes, passed_s = length.nodes, seen_s @ np.swapaxes(turns, -1, -2)
    pixels, middle = camera.pixels(passed_s), camera.pixels(seen_s)
    directions_s = camera.directions(middle - (nodes.mean(pixels) - middle))
    blur = equivalent_sigma(camera.direction_covariance(middle, length.psf_sigma_px))
    spread_s = _across(seen_s, nodes.spread(passed_s))
    smear_s: FloatArray = spread_s * ((exposure.sigma / blur) ** 2)[:, None, None]
    streak = np.sqrt(12.0 * np.trace(spread_s, axis1=-2, axis2=-1))
    lost = ~np.all(np.isfinite(directions_s), axis=-1)
    directions_s[lost], smear_s[lost] = seen_s[lost], _across(seen_s[lost], _OUT_OF_SIGHT * np.eye(3))
    return replace(exposure, directions_s=directions_s, smear_s=smear_s, streak=streak)


def _across(directions_s: FloatArray, covariance_s: FloatArray) -> FloatArray:
    """The part of covariances that lies across the lines of sight, shape (k, 3, 3)."""
    keep = np.eye(3) - directions_s[:, :, None] * directions_s[:, None, :]
    across: FloatArray = keep @ covariance_s @ keep
    return across


def visible_stars(
    exposure: StarExposure, watch: SkyWatch, prior: StarPrior | None
) -> tuple[StarExposure, SightedStars, list[tuple[str, Refusal]]] | Refusal:
    """The stars of an exposure that have a place in the sky.

    Args:
        exposure: the stars as the sensor saw them.
        watch: the sky.
        prior: attitude of the sensor, by which stars without an identity are identified; None leaves them out.

    Returns:
        The exposure with the stars that can be used; the same stars with their places, in the sensor frame; and the
        names of the other stars, each with its refusal. Or one refusal, where no star can be placed in the sky at the
        moment of the exposure.
    """
    refused: list[tuple[str, Refusal]] = []
    known = named = exposure.identified
    detections = len(exposure)
    moment = watch.at(exposure.time_ns)
    if isinstance(moment, Refusal):
        return moment
    if not known.all():
        reasons: dict[int, Refusal] = {}
        if prior is not None:
            exposure, reasons = identified(exposure, prior, moment)
            known = exposure.identified
        nobody = Refusal(Reason.UNIDENTIFIED, "no identity, and no attitude to identify it by")
        refused += [(exposure.name(row), reasons.get(row, nobody)) for row in np.flatnonzero(~known).tolist()]
        exposure, named = exposure[known], named[known]
    apparent = moment.apparent(exposure.positions)
    direction_n, shared_n, seen = apparent.direction_n, apparent.shared_n, apparent.visible
    if not seen.all():
        for row in np.flatnonzero(~seen).tolist():
            refused.append((exposure.name(row), moment.too_low(float(apparent.elevation[row]))))
        exposure, direction_n, shared_n, named = exposure[seen], direction_n[seen], shared_n[seen], named[seen]
    rivals = None
    # By a prior that is not wide a star with a name is hardly ever another one.
    if prior is not None and (np.trace(prior.covariance_n) > LINEAR_RANGE**2 or not named.all()):
        rivals = detections * moment.bright.density(exposure.magnitude, MAGNITUDE_TOLERANCE)
        rivals *= np.where(named, WRONG_NAMES, 1.0)
    stars = SightedStars(
        measured_b=exposure.directions_s,
        reference_n=direction_n,
        sigma=exposure.sigma,
        position_sigma=exposure.position_sigma,
        shared_n=shared_n,
        sensor=np.zeros(len(direction_n), dtype=np.intp),
        mounting_b=_ONE_SENSOR,
        smear_b=exposure.smear_s,
        rivals=rivals,
        pixel_sigma=exposure.pixel_sigma,
        field_b=exposure.field_modes,
        field_sources=exposure.field_sources,
    )
    return exposure, stars, refused


def identified(
    exposure: StarExposure, prior: StarPrior, moment: SkyMoment
) -> tuple[StarExposure, dict[int, Refusal]]:
    """The exposure with identities for those of its stars that had none, where one can be found.

    Args:
        exposure: the stars as the sensor saw them.
        prior: attitude of the sensor.
        moment: the sky at the exposure; it also says which catalogue stars are bright enough.

    Returns:
        The exposure, and for each row that is still without an identity the reason.
    """
    rows = np.flatnonzero(~exposure.identified)
    if np.trace(prior.covariance_n) > WIDEST**2:
        return exposure, dict.fromkeys(rows.tolist(), Refusal(Reason.UNIDENTIFIED, _PRIOR_TOO_WIDE))
    smear_s = None if exposure.smear_s is None else exposure.smear_s[rows]
    found = candidates(
        exposure.directions_s[rows],
        exposure.lone_sigma[rows],
        exposure.magnitude[rows],
        smear_s,
        prior,
        moment,
        exposure.masks,
    )
    # No catalogue star counts twice: one that two detections could be is given to neither. A catalogue star
    # already assigned by its number is not assigned to another detection.
    hip = moment.bright.catalogue.hip[found.rows]
    claimed_once = (np.count_nonzero(found.fitting, axis=0) == 1) & ~np.isin(hip, exposure.hip)
    chosen = np.full(len(rows), -1)
    reasons: dict[int, Refusal] = {}
    for number, row in enumerate(rows.tolist()):
        fitting = np.flatnonzero(found.fitting[number])
        if len(fitting) == 1 and claimed_once[fitting[0]]:
            chosen[number] = found.rows[fitting[0]]
        else:
            behind = exposure.masks.names(exposure.directions_s[row]) if exposure.masks is not None else ""
            reasons[row] = _why_not(float(found.nearest[number]), len(fitting), behind)
    taken = chosen >= 0
    return _filled(exposure, rows[taken], chosen[taken], moment), reasons


def _why_not(nearest: float, fitting: int, behind: str) -> Refusal:
    """The refusal of a detection for which so many catalogue stars lay within the gate, the nearest at this angle.

    Args:
        nearest: rad; infinite where there is none.
        fitting: number of stars.
        behind: the masks that the detection lies in; empty for none.
    """
    if behind:
        return Refusal(Reason.UNIDENTIFIED, f"no star: it lies in the mask {behind}")
    if fitting:
        text = f"{fitting} catalogue stars within the gate, or one claimed twice: left out"
        return Refusal(Reason.UNIDENTIFIED, text)
    if not np.isfinite(nearest):
        return Refusal(Reason.UNIDENTIFIED, "no catalogue star in the field")
    text = f'no catalogue star within the gate, the nearest is {nearest / ARCSEC:.0f}" away'
    return Refusal(Reason.UNIDENTIFIED, text)


def _filled(
    exposure: StarExposure, rows: NDArray[np.intp], chosen: NDArray[np.intp], moment: SkyMoment
) -> StarExposure:
    """The exposure with the catalogue's stars ``chosen`` in its rows ``rows``."""
    catalogue = moment.bright.catalogue
    hip, position_sigma = exposure.hip.copy(), exposure.position_sigma.copy()
    hip[rows] = catalogue.hip[chosen]
    position_sigma[rows] = catalogue.sigma(chosen, julian_year(exposure.time_ns))
    positions = {}
    for name in StarPositions.__dataclass_fields__:
        column = getattr(exposure.positions, name).copy()
        column[rows] = getattr(catalogue.at_j2000, name)[chosen]
        positions[name] = column
    return replace(exposure, hip=hip, positions=StarPositions(**positions), position_sigma=position_sigma)

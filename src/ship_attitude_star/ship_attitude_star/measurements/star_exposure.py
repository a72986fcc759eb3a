"""What one exposure of a star sensor shows: directions in the sensor frame, and which stars they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.stars.camera import StarCamera
from ship_geometry.exposure_mean import Nodes, exposure_nodes
from ship_geometry.rotations import FloatArray
from ship_geometry.star_directions import StarPositions


@dataclass(frozen=True)
class ExposureLength:
    """How long an exposure lasted, and what a camera makes of a star that moves meanwhile.

    Attributes:
        exposure_s: above 0.
        camera: geometry of the sensor.
        psf_sigma_px: standard deviation of the image of a star at rest, each axis.
    """

    exposure_s: float
    camera: StarCamera
    psf_sigma_px: float

    @cached_property
    def nodes(self) -> Nodes:
        """Moments by which the mean over it is found."""
        return exposure_nodes(self.exposure_s)

    def untold_turn_variance(self, acceleration: float) -> float:
        """Variance of the turn from the mean of the exposure to its middle, each axis, where nothing tells it, rad².

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
        hip: HIP numbers; 0 where the direction was given, or nothing was.
        directions_s: unit vectors in the sensor frame (forward, up, right), shape (k, 3).
        sigma: error of a direction, rad per axis across it, shape (k,).
        positions: of the stars, J2000.0; NaN where nobody has said yet which star it is.
        position_sigma: error of the catalogue's position, rad per axis, shape (k,).
        magnitude: as measured, shape (k,); NaN unknown.
        length: how long it lasted, and of which camera; None where nobody said so.
        smear_s: what the motion meanwhile added to the error of a direction, covariance in the sensor frame, rad²,
            shape (k, 3, 3); None where nothing is known of it.
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

    @property
    def covariance_known(self) -> bool:
        """A centroid's error is the sensor's own business: stars without one carry the configured sigma."""
        return True

    @property
    def reach_ns(self) -> int:
        """How far from the middle it must be known how the sensor turned; 0 where no length was given."""
        return 0 if self.length is None else self.length.nodes.reach_ns

    @property
    def identified(self) -> NDArray[np.bool_]:
        """Whether it is known which star it is, shape (k,)."""
        return np.isfinite(self.positions.right_ascension)

    def name(self, row: int) -> str:
        """A star for people: its number, else its direction, else where it was seen."""
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
        )

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

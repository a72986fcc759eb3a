"""Telescope and lights move while an image is exposed: where the lights stood at the middle, and how well it is known.

A found point is the mean of the light's way over the detector. Encoders, ship and baselines tell that way, and so by
how much its mean is off the point at the middle. Along a streak of length L the light is spread by L²/12 more than the
image s² of a light at rest, and the point is known by as much worse: σ² (1 + L²/(12 s²)) (docs/optical_axis.md).
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.exposure_mean import Nodes
from ship_geometry.rotations import FloatArray
from theodolite_calib.lights.image import Camera
from theodolite_calib.lights.light_points import Image


@dataclass(frozen=True)
class LightStreaks:
    """N lights as found on the detector, and how telescope and lights moved over the exposure.

    Attributes:
        image: as found.
        camera: geometry of the telescope.
        psf_sigma_m: spread of the image of a light at rest, each axis.
        nodes: m moments of the exposure.
        rotation_nt: horizon from telescope at these, shape (m, 3, 3).
        middle_nt: the same at the middle, shape (3, 3).
        path_n: from the telescope to the lights at the middle, m, shape (N, 3).
        moved_n: these paths at the nodes minus those at the middle, m, shape (m, N, 3).
    """

    image: Image
    camera: Camera
    psf_sigma_m: float
    nodes: Nodes
    rotation_nt: FloatArray
    middle_nt: FloatArray
    path_n: FloatArray
    moved_n: FloatArray

    def at_middle(self) -> Image:
        """The lights where they stood at the middle, with what their streaks add to their errors."""
        image, distance_m = self.image, np.linalg.norm(self.path_n, axis=-1, keepdims=True)
        # A light is where it is seen; how it moves, its path tells.
        seen_n = distance_m * (self.camera.directions(image.point_m) @ self.middle_nt.T)
        way_m = self.camera.points((seen_n + self.moved_n) @ self.rotation_nt)
        off_m = self.nodes.mean(way_m) - image.point_m
        smear_m2 = self.nodes.spread(way_m) * ((image.sigma_m / self.psf_sigma_m) ** 2)[:, None, None]
        return Image(image.point_m - off_m, image.sigma_m, smear_m2)

    def chosen(self, rows: list[int], seen_rows: list[int]) -> "LightStreaks":
        """Some lights only, or with names exchanged: light ``rows[i]`` is seen as ``seen_rows[i]``."""
        return replace(
            self, image=self.image.chosen(seen_rows), path_n=self.path_n[rows], moved_n=self.moved_n[:, rows]
        )

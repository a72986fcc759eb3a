"""The mean of what a turning camera sees over an exposure, from samples of how its body turned.

A centroid is the mean of the image's positions p(t) over the exposure T, and so off the position at the middle by

    mean of p - p(0) = p̈ T²/24 + p⁗ T⁴/1920 + ...          spread of p about its mean = ṗ ṗᵀ T²/12 + ...

Both follow from p at a few nodes: two beside the middle for a short exposure, Simpson's rule for a long one. The nodes
stay a tenth of a second off the middle where the exposure is shorter: p̈ from closer ones would be noise of the samples.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.rotations import FloatArray
from ship_geometry.sample_track import SECOND_NS

LONGEST_EXPOSURE_S = 10.0
"""Nothing that moves is exposed for longer."""

_STEP_S = 0.1


@dataclass(frozen=True)
class Nodes:
    """Moments whose weighted mean is the mean over an exposure.

    Attributes:
        offset_ns: from the middle of the exposure, increasing, the middle among them, shape (m,).
        weight: their sum is 1, none is negative, shape (m,).
    """

    offset_ns: tuple[int, ...]
    weight: FloatArray

    @property
    def reach_ns(self) -> int:
        """How far from the middle the outermost are."""
        return self.offset_ns[-1]

    def mean(self, values: FloatArray) -> FloatArray:
        """Mean of values at the nodes, shape (m, ...)."""
        mean: FloatArray = np.tensordot(self.weight, values, axes=1)
        return mean

    def spread(self, values: FloatArray) -> FloatArray:
        """Covariance of values at the nodes about their mean, shape (m, ..., n) → (..., n, n)."""
        off = values - self.mean(values)
        spread: FloatArray = np.einsum("m,m...i,m...j->...ij", self.weight, off, off)
        return spread


def exposure_nodes(exposure_s: float) -> Nodes:
    """The nodes of an exposure of a length above 0 and up to :data:`LONGEST_EXPOSURE_S`."""
    pairs = math.ceil(exposure_s / (2.0 * _STEP_S))
    if pairs <= 1:
        beside = (exposure_s / _STEP_S) ** 2 / 24.0
        weight, half_s = np.array([beside, 1.0 - 2.0 * beside, beside]), _STEP_S
    else:
        # Simpson's rule, which has a node at the middle whatever the number of its pairs of steps.
        weight = np.full(2 * pairs + 1, 2.0)
        weight[1::2], weight[[0, -1]] = 4.0, 1.0
        weight, half_s = weight / weight.sum(), 0.5 * exposure_s
    offset_s = np.linspace(-half_s, half_s, len(weight))
    return Nodes(tuple(np.rint(offset_s * SECOND_NS).astype(int).tolist()), weight)


@dataclass(frozen=True)
class Turning:
    """How a body turned over an exposure.

    Attributes:
        nodes: of the exposure.
        turns: the body at each node from the body at the middle, shape (m, 3, 3).
        noise_gain: variance of the mean attitude over the exposure per variance of the samples' independent noise.
        correction_gain: the same of the mean attitude against the one at the middle.
    """

    nodes: Nodes
    turns: FloatArray
    noise_gain: float
    correction_gain: float

    def mounted(self, rotation_ds: FloatArray) -> "Turning":
        """The same of a device: ``rotation_ds`` is the body from the device, shape (3, 3)."""
        return Turning(self.nodes, rotation_ds.T @ self.turns @ rotation_ds, self.noise_gain, self.correction_gain)


def turning_over(track: AttitudeTrack, time_ns: int, nodes: Nodes) -> Turning | None:
    """How the body of a track turned about the middle of an exposure; None where the track does not tell."""
    middle = track.at(time_ns)
    around = [track.at(time_ns + offset_ns) for offset_ns in nodes.offset_ns]
    attitudes = [attitude.rotation_nd for attitude in around if attitude is not None]
    if middle is None or len(attitudes) < len(around):
        return None
    moments = [(time_ns + offset_ns, float(w)) for offset_ns, w in zip(nodes.offset_ns, nodes.weight, strict=True)]
    return Turning(
        nodes,
        np.swapaxes(np.array(attitudes), -1, -2) @ middle.rotation_nd,
        track.noise_gain_of_mean(moments),
        track.noise_gain_of_mean([*moments, (time_ns, -1.0)]),
    )

"""Mean over an exposure of a rotating camera, from attitudes of the body that carries the camera.

The image of a star moves over the detector during the exposure. The measured centroid is the mean of the positions
p(t) over the exposure T. The mean differs from the position p(0) at the middle, and the light is spread along the path:

    mean of p - p(0) = p̈ T²/24 + p⁗ T⁴/1920 + ...          spread of p about its mean = ṗ ṗᵀ T²/12 + ...

Mean and spread are computed from p at a few times, the nodes. A short exposure (up to 0.2 s) has the middle and two
outer nodes; a longer exposure has the nodes of Simpson's rule. The outer nodes of a short exposure are 0.1 s from the
middle, whatever the length of the exposure, because with closer nodes the noise of the samples would dominate p̈.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeTrack

LONGEST_EXPOSURE_S = 10.0
"""Longest exposure that is corrected for motion, s."""

_STEP_S = 0.1


@dataclass(frozen=True)
class Nodes:
    """Quadrature nodes of an exposure: the mean of a quantity over the exposure is its weighted mean over the nodes.

    Attributes:
        offset_ns: time of each node relative to the middle of the exposure, increasing, shape (m,); one time is 0.
        weight: weight of each node, not negative, shape (m,); the sum of the weights is 1.
    """

    offset_ns: tuple[int, ...]
    weight: FloatArray

    @property
    def reach_ns(self) -> int:
        """Time from the middle of the exposure to the last node."""
        return self.offset_ns[-1]

    def times_and_weights(self, middle_ns: int) -> list[tuple[int, float]]:
        """Return time (ns) and weight of each node of an exposure whose middle is at ``middle_ns``."""
        offsets = zip(self.offset_ns, self.weight.tolist(), strict=True)
        return [(middle_ns + offset_ns, weight) for offset_ns, weight in offsets]

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the weighted mean, shape (...), of values at the nodes, shape (m, ...)."""
        mean: FloatArray = np.tensordot(self.weight, values, axes=1)
        return mean

    def covariance(self, values: FloatArray) -> FloatArray:
        """Return the covariance, shape (..., n, n), of values at the nodes, shape (m, ..., n), about their mean."""
        off = values - self.mean(values)
        covariance: FloatArray = np.einsum("m,m...i,m...j->...ij", self.weight, off, off)
        return covariance


def exposure_nodes(exposure_s: float) -> Nodes:
    """Return the nodes of an exposure.

    Args:
        exposure_s: length of the exposure, s, above 0 and up to :data:`LONGEST_EXPOSURE_S`.

    Example:
        An exposure of 0.1 s uses the attitudes at its middle and 0.1 s before and after it:

        >>> nodes = exposure_nodes(0.1)
        >>> print(nodes.offset_ns, nodes.weight.round(4))
        (-100000000, 0, 100000000) [0.0417 0.9167 0.0417]
    """
    pairs = math.ceil(exposure_s / (2.0 * _STEP_S))
    if pairs <= 1:
        outer_weight = (exposure_s / _STEP_S) ** 2 / 24.0
        weight, half_s = np.array([outer_weight, 1.0 - 2.0 * outer_weight, outer_weight]), _STEP_S
    else:
        # Simpson's rule has the weights 1 4 2 4 ... 4 1. The number of steps is even, so one node is at the middle.
        weight = np.full(2 * pairs + 1, 2.0)
        odd_nodes, end_nodes = slice(1, None, 2), [0, -1]
        weight[odd_nodes], weight[end_nodes] = 4.0, 1.0
        weight, half_s = weight / weight.sum(), 0.5 * exposure_s
    offset_s = np.linspace(-half_s, half_s, len(weight))
    return Nodes(tuple(np.rint(offset_s * SECOND_NS).astype(int).tolist()), weight)


@dataclass(frozen=True)
class ExposureMotion:
    """Rotation of a body over an exposure.

    Attributes:
        nodes: nodes of the exposure.
        turns: rotations "body at the node from body at the middle", shape (m, 3, 3).
        rate: mean angular velocity between the outermost nodes about the body's axes at the middle, rad/s, shape (3,).
        noise_gain: variance of the mean attitude due to the white noise of the samples, divided by the noise variance.
        correction_gain: likewise for the difference mean attitude - attitude at the middle.
        error_covariance: covariance of the interpolation error of the mean attitude, rotation vector in the body's
            frame, rad², shape (3, 3).
        correction_error: variance of the interpolation error of the difference mean attitude - attitude at the middle,
            sum over the three axes, rad².
    """

    nodes: Nodes
    turns: FloatArray
    rate: FloatArray
    noise_gain: float
    correction_gain: float
    error_covariance: FloatArray
    correction_error: float

    def in_device_frame(self, rotation_ds: FloatArray) -> "ExposureMotion":
        """Return the same rotation about the axes of a device on the body.

        Args:
            rotation_ds: orientation of the device (body from device), shape (3, 3).
        """
        return replace(
            self,
            turns=rotation_ds.T @ self.turns @ rotation_ds,
            rate=rotation_ds.T @ self.rate,
            error_covariance=rotation_ds.T @ self.error_covariance @ rotation_ds,
        )


def exposure_motion(track: AttitudeTrack, time_ns: int, nodes: Nodes) -> ExposureMotion | None:
    """Return the rotation of a body over an exposure; None if the track has no attitude at one of the nodes.

    Args:
        track: attitudes of the body.
        time_ns: middle of the exposure, in the track's own stamps.
        nodes: nodes of the exposure.

    Example:
        >>> from ship_geometry.tracks.attitude_track import AttitudeSample
        >>> track, still = AttitudeTrack(max_gap_ns=SECOND_NS), np.zeros(3)
        >>> for tenth in range(5):
        ...     _ = track.insert(AttitudeSample(tenth * SECOND_NS // 10, np.eye(3), still))
        >>> turning = exposure_motion(track, SECOND_NS // 5, exposure_nodes(0.05))
        >>> print(turning.turns.shape, turning.correction_error)  # at rest nothing turns
        (3, 3, 3) 0.0
    """
    middle, moments = track.at(time_ns), nodes.times_and_weights(time_ns)
    around = [found for found in (track.at(moment_ns) for moment_ns, _ in moments) if found is not None]
    if middle is None or len(around) < len(moments):
        return None
    # The interpolation errors at the nodes are not independent. The mean of their covariances is an upper bound of the
    # covariance of their mean. For the difference mean - middle, the assumption that the errors at the middle and at
    # the outer nodes have opposite signs gives an upper bound too.
    errors = np.array([found.error_covariance_d for found in around])
    outer_weights = np.where(np.array(nodes.offset_ns) == 0, 0.0, nodes.weight)
    share, variances = float(outer_weights.sum()), np.trace(errors, axis1=-2, axis2=-1)
    turns = np.swapaxes(np.array([found.rotation_nd for found in around]), -1, -2) @ middle.rotation_nd
    to_first, to_last = log_rotation(turns[[0, -1]])
    return ExposureMotion(
        nodes,
        turns,
        (to_first - to_last) * (SECOND_NS / (nodes.offset_ns[-1] - nodes.offset_ns[0])),
        track.noise_gain_of_mean(moments),
        track.noise_gain_of_mean([*moments, (time_ns, -1.0)]),
        nodes.mean(errors),
        2.0 * share * float(outer_weights @ variances + share * np.trace(middle.error_covariance_d)),
    )

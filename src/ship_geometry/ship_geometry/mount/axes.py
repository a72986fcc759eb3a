"""Exact mount model of a theodolite: direction of the main axis from encoder angles and axis errors, and the inverse.

In the deck frame the model is the exact form of [W18] (1)(2). The main frame m is (optical axis, up, right), the deck d
is (bow, up, starboard):

    rotation_dm = T · Ry(A - g) · Rx(I) · Rz(-(E - h + f cos E)) · Ry(-c),   T = Ry(Am) · Rz(βm) · Ry(-Am)

T is the tilt of the vertical axis by βm towards the azimuth Am. The rotation vector of T is (βy, 0, -βx), with
βx = βm cos Am and βy = βm sin Am. βx and βy are used because Am is undefined for βm = 0. The main frame in the horizon
includes the error a of the ship's attitude and the deformation e, which are rotation vectors:

    rotation_nm = exp(a) R_ship · exp(e) · rotation_dm

The attitude of the main frame also gives the attitude of the calibration telescope t (:func:`telescope_rotation`):

    rotation_nm = rotation_nt · R(ΔA, ΔE, Δω)

The parallelism (ΔA, ΔE, Δω) is the attitude of the main frame in the telescope's frame. [W18] (24) is the first-order
form of this equation, with a misprint.

Encoder angles and errors are floats or arrays (rad) that broadcast with each other. The common shape of angles and
errors becomes the leading axes of the results.
"""

import math
from dataclasses import astuple, dataclass, fields
from functools import cached_property

import numpy as np

from ship_geometry.frames import rotation_from_angles, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, skew, wrap_two_pi
from ship_kernels import compiled_pointing

Angle = float | FloatArray

# The error of the initial elevation is at most the flexure. A Newton step reduces an error e to about flexure · e² / 2
# or less, so that three steps reduce the error of a flexure of 0.1 rad to about 1e-17 rad.
_FLEXURE_STEPS = 3

_AZIMUTH, _ELEVATION = range(2)

SHIP, DEFORMATION, AXES, SHIP_TIME = slice(0, 3), slice(3, 6), slice(6, 13), slice(13, 14)
"""Slices of the vector of all errors.

- SHIP: rotation vector a of the error of the ship's attitude in n, rad.
- DEFORMATION: rotation vector e of the deformation in d, rad.
- AXES: the axis errors in the order of :data:`NAMES`, rad.
- SHIP_TIME: true minus assumed time of the samples of the ship's attitude, s.
"""


@dataclass(frozen=True)
class AxisErrors:
    """The errors of the axes, rad; 0 means no error.

    Attributes:
        g: zero point of the azimuth encoder; the axis points at A - g.
        h: zero point of the elevation encoder; the axis points at E - h.
        c: collimation: angle of the optical axis to the left of the normal to the horizontal axis.
        I: non-perpendicularity: tilt of the horizontal axis against the normal to the vertical axis, positive with the
            right end up.
        beta_x: tilt of the vertical axis towards the bow, βm cos Am; it lowers an optical axis that points to the bow.
        beta_y: tilt of the vertical axis towards starboard, βm sin Am.
        flexure: bending of the tube; it raises the optical axis by flexure · cos E.
    """

    g: Angle = 0.0
    h: Angle = 0.0
    c: Angle = 0.0
    I: Angle = 0.0  # noqa: E741  its name in [W18]
    beta_x: Angle = 0.0
    beta_y: Angle = 0.0
    flexure: Angle = 0.0

    @classmethod
    def from_vector(cls, vector: FloatArray) -> "AxisErrors":
        """Return the errors from a vector in the order of :data:`NAMES`, shape (..., 7)."""
        vector = np.asarray(vector, dtype=float)
        return cls(*(vector.tolist() if vector.ndim == 1 else np.moveaxis(vector, -1, 0)))

    def vector(self) -> FloatArray:
        """Return the errors in the order of :data:`NAMES`, shape (..., 7)."""
        return np.stack(np.broadcast_arrays(*astuple(self)), axis=-1)

    @cached_property
    def tilt_rotation(self) -> FloatArray:
        """Rotation T of the vertical axis, shape (..., 3, 3)."""
        return exp_rotation(_tilt_vector(self))

    @cached_property
    def by_tilt(self) -> FloatArray:
        """Small rotation of the main frame, in d, per change of the tilt's rotation vector, shape (..., 3, 3)."""
        return left_jacobian(_tilt_vector(self))


NAMES = tuple(field.name for field in fields(AxisErrors))
"""Names of the axis errors, in the order of the vector form and of the Jacobian's columns."""

_G, _H, _C, _I, _BETA_X, _BETA_Y, _FLEXURE = range(len(NAMES))


@dataclass(frozen=True)
class MainAxis:
    """Main frame in the deck, and the derivatives of the main frame's rotation vector in d, rad per rad.

    Attributes:
        rotation_dm: deck from main frame, shape (..., 3, 3); its first column is the optical axis.
        by_error: derivatives with respect to the axis errors in the order of :data:`NAMES`, shape (..., 3, 7).
        by_encoder: derivatives with respect to the encoder angles (azimuth, elevation), shape (..., 3, 2).
    """

    rotation_dm: FloatArray
    by_error: FloatArray
    by_encoder: FloatArray


def main_axis(errors: AxisErrors, azimuth: Angle, elevation: Angle) -> MainAxis:
    """Return the main frame with its Jacobians. ``by_encoder`` also converts errors of the encoder readings.

    Example:
        The elevation of the encoder includes its zero point h:

        >>> main_axis(AxisErrors(h=0.1), azimuth=0.0, elevation=0.1).rotation_dm[:, 0]
        array([1., 0., 0.])
    """
    rotation_dx = errors.tilt_rotation @ _about_vertical_and_horizontal(errors, azimuth)
    rotation_dm = rotation_dx @ _about_elevation_and_collimation(errors, elevation)
    cosine, sine = _cos_sin(elevation)

    vertical = errors.tilt_rotation[..., :, 1]
    horizontal = rotation_dx[..., :, 2]
    by_error = np.empty((*rotation_dm.shape[:-1], len(NAMES)))
    by_error[..., _G] = vertical
    by_error[..., _H] = -horizontal
    by_error[..., _C] = rotation_dm[..., :, 1]
    by_error[..., _I] = -rotation_dx[..., :, 0]
    by_error[..., _BETA_X] = -errors.by_tilt[..., :, 2]
    by_error[..., _BETA_Y] = errors.by_tilt[..., :, 0]
    by_error[..., _FLEXURE] = _column(cosine) * horizontal
    by_encoder = np.empty((*rotation_dm.shape[:-1], 2))
    by_encoder[..., _AZIMUTH] = -vertical
    by_encoder[..., _ELEVATION] = _column(1.0 - errors.flexure * sine) * horizontal
    return MainAxis(rotation_dm, by_error, by_encoder)


def main_axis_rotation(errors: AxisErrors, azimuth: Angle, elevation: Angle) -> FloatArray:
    """Return the rotation deck from main frame, shape (..., 3, 3), without the Jacobians.

    Example:
        A quarter turn of the azimuth points the axis to starboard:

        >>> print(main_axis_rotation(AxisErrors(), azimuth=0.5 * np.pi, elevation=0.0)[:, 0].round(3))
        [0. 0. 1.]
    """
    rotation_dx = errors.tilt_rotation @ _about_vertical_and_horizontal(errors, azimuth)
    return rotation_dx @ _about_elevation_and_collimation(errors, elevation)


def direction_change(direction: FloatArray, by_rotation: FloatArray) -> FloatArray:
    """Return the derivative of a direction fixed in a frame, shape (..., 3, n).

    ``by_rotation`` is the derivative of the small rotation of the frame, shape (..., 3, n).

    Example:
        The encoder of elevation raises a horizontal axis, and that of azimuth moves it to the right:

        >>> main = main_axis(AxisErrors(), azimuth=0.0, elevation=0.0)
        >>> direction_change(main.rotation_dm[:, 0], main.by_encoder).T[:, 1:]  # up, right
        array([[0., 1.],
               [1., 0.]])
    """
    return -skew(direction) @ by_rotation


@dataclass(frozen=True)
class AxisGeometry:
    """Axis geometry at one time.

    Attributes:
        rotation_nd: horizon from deck, corrected by the errors of attitude and time, shape (3, 3).
        rotation_dm: deck from main frame, deformation included, shape (3, 3).
        rotation_nm: horizon from main frame, shape (3, 3).
        by_error: derivatives of the main frame's rotation vector in n with respect to the errors, shape (3, 14); the
            columns are :data:`SHIP`, :data:`DEFORMATION`, :data:`AXES` and :data:`SHIP_TIME`.
        by_encoder: derivatives of this rotation vector with respect to the encoder angles (azimuth, elevation), shape
            (3, 2).
    """

    rotation_nd: FloatArray
    rotation_dm: FloatArray
    rotation_nm: FloatArray
    by_error: FloatArray
    by_encoder: FloatArray


def axis_geometry(
    errors: FloatArray, rotation_nd: FloatArray, rate_d: FloatArray, azimuth: float, elevation: float
) -> AxisGeometry:
    """Return the axis geometry from a measured attitude of the ship and the encoders.

    Args:
        errors: estimated errors, shape (14,).
        rotation_nd: measured attitude of the deck, shape (3, 3).
        rate_d: angular velocity of the deck, rad/s, shape (3,).
        azimuth: encoder azimuth, rad.
        elevation: encoder elevation, rad.

    Example:
        The sample is valid at another time than assumed, while the ship turns to port at 0.1 rad/s:

        >>> rate_d = np.array([0.0, 0.1, 0.0])
        >>> geometry = axis_geometry(np.zeros(14), np.eye(3), rate_d, azimuth=0.0, elevation=0.0)
        >>> print(geometry.by_error[1, SHIP_TIME])  # rad/s about up
        [-0.1]
    """
    arrays = compiled_pointing.axis_geometries(
        errors[None], rotation_nd[None], rate_d[None], np.array([[azimuth, elevation]])
    )
    return AxisGeometry(*(of_all[0] for of_all in arrays))


def encoder_angles(
    errors: AxisErrors, direction_d: FloatArray, *, plunged: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return the encoder angles at which the optical axis has a given direction.

    There are two pairs of angles (faces). In the plunged pair the telescope is beyond the zenith and the azimuth
    differs by about 180°. Directions closer to the vertical axis than about c + I have no pair.

    Args:
        errors: axis errors.
        direction_d: wanted direction in the deck frame, of any length, shape (..., 3).
        plunged: return the plunged pair.

    Returns:
        Azimuth in [0, 2 pi) and elevation (rad), shape (...) each; NaN for directions that the axes cannot reach.
            Without axis errors the elevation is in [-pi/2, pi/2], or in [pi/2, 3 pi/2] if plunged.

    Example:
        >>> bow = np.array([1.0, 0.0, 0.0])
        >>> for plunged in (False, True):
        ...     print([round(float(angle), 3) for angle in encoder_angles(AxisErrors(g=0.1), bow, plunged=plunged)])
        [0.1, 0.0]
        [3.242, 3.142]
    """
    unit_d = direction_d / np.linalg.norm(direction_d, axis=-1, keepdims=True)
    # Direction in the frame of the tilted vertical axis: x, y (up), z.
    x, y, z = np.moveaxis((unit_d[..., None, :] @ errors.tilt_rotation)[..., 0, :], -1, 0)
    sin_c, cos_i, sin_i = np.sin(errors.c), np.cos(errors.I), np.sin(errors.I)
    # Components in the frame turned by A - g about the tilted vertical axis, before Rx(I). Its upward component is also
    # y.
    left = (y * sin_i + sin_c) / cos_i
    horizontal = np.hypot(x, z)
    square = (horizontal - left) * (horizontal + left)
    forward = np.sqrt(np.where(square >= 0.0, square, np.nan)) * (-1.0 if plunged else 1.0)

    turned = np.arctan2(forward * z + left * x, forward * x - left * z)
    raised = np.arctan2((y + sin_c * sin_i) / cos_i, forward)
    if plunged:
        raised = wrap_two_pi(raised)
    return wrap_two_pi(turned + errors.g), _elevation_before_flexure(errors, raised)


def _elevation_before_flexure(errors: AxisErrors, raised: FloatArray) -> FloatArray:
    """Return the encoder elevation E with E - h + f cos E = ``raised``, by Newton's method."""
    elevation = raised + errors.h
    for _ in range(_FLEXURE_STEPS):
        excess = elevation - errors.h + errors.flexure * np.cos(elevation) - raised
        elevation = elevation - excess / (1.0 - errors.flexure * np.sin(elevation))
    return elevation


def _tilt_vector(errors: AxisErrors) -> FloatArray:
    """Return the rotation vector of the tilt of the vertical axis, shape (..., 3)."""
    beta_x, beta_y = errors.beta_x, errors.beta_y
    if isinstance(beta_x, float) and isinstance(beta_y, float):
        return np.array([beta_y, 0.0, -beta_x])
    beta_x, beta_y = np.broadcast_arrays(beta_x, beta_y)
    return np.stack([beta_y, np.zeros(beta_x.shape), -beta_x], axis=-1)


def _about_vertical_and_horizontal(errors: AxisErrors, azimuth: Angle) -> FloatArray:
    """Return Ry(A - g) · Rx(I), multiplied out."""
    ca, sa = _cos_sin(azimuth - errors.g)
    ci, si = _cos_sin(errors.I)
    return _matrix([ca, sa * si, -sa * ci, 0.0, ci, si, sa, -ca * si, ca * ci])


def _about_elevation_and_collimation(errors: AxisErrors, elevation: Angle) -> FloatArray:
    """Return Rz(-(E - h + f cos E)) · Ry(-c), multiplied out."""
    cosine, _ = _cos_sin(elevation)
    ce, se = _cos_sin(elevation - errors.h + errors.flexure * cosine)
    cc, sc = _cos_sin(errors.c)
    return _matrix([ce * cc, -se, ce * sc, se * cc, ce, se * sc, -sc, 0.0, cc])


def _cos_sin(angle: Angle) -> tuple[Angle, Angle]:
    """Return cosine and sine; a single angle, as in a live node, is several times faster with ``math``."""
    if isinstance(angle, float):
        return math.cos(angle), math.sin(angle)
    return np.cos(angle), np.sin(angle)


def _matrix(elements: list[Angle]) -> FloatArray:
    """Return the matrix of nine elements, row by row, shape (..., 3, 3)."""
    if all(isinstance(element, float) for element in elements):
        return np.array(elements).reshape(3, 3)
    stacked = np.stack(np.broadcast_arrays(*elements), axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)


def _column(factor: Angle) -> FloatArray:
    """Return factors of shape (...) in shape (..., 1), to multiply vectors."""
    return np.asarray(factor)[..., None]


def telescope_rotation(parallelism: FloatArray, rotation_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the attitude of the telescope from the attitude of the main frame.

    Args:
        parallelism: azimuth, elevation and rotation of the main axis in the telescope, rad, shape (3,).
        rotation_nm: horizon from main frame, shape (3, 3).

    Returns:
        Horizon from telescope, shape (3, 3), and the derivative of its rotation vector in n with respect to the
            angles of the parallelism, shape (3, 3).

    Example:
        The main axis is 0.1 rad to the right in the telescope, so that the telescope points to its left:

        >>> rotation_nt, _ = telescope_rotation(np.array([0.1, 0.0, 0.0]), np.eye(3))
        >>> print(rotation_nt[:, 0].round(3)[[0, 2]])  # forward, right
        [ 0.995 -0.1  ]
    """
    azimuth, elevation, rotation = parallelism
    rotation_nt = rotation_nm @ rotation_from_angles(azimuth, elevation, rotation).T
    return rotation_nt, -rotation_nt @ rotation_vector_from_angle_errors(azimuth, elevation)

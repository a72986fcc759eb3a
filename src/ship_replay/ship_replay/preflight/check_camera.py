"""Contradictions between cameras and their stars: image axes, focal length, magnitudes, pixels counted from 1.

If a camera counts pixels from 1, all stars appear one pixel to the right and down: the camera's attitude is rotated by
one pixel about its up and right axes. If the installations are known to less than a pixel, the measured rotations of
several cameras against one INS show whether this rotation is present. One camera is enough if the attitude of the INS
is known to less than a pixel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ship_bags.mcap.bag_reader import Bag
from ship_estimation.innovations.gates import probability_above
from ship_geometry.rotations import FloatArray
from ship_replay.preflight.measured_camera import MagnitudeOffset, MeasuredCamera
from ship_replay.preflight.measured_mounting import MeasuredMounting

_CLEARLY_LIKELIER = 12.0
"""Difference of chi² from which on one hypothesis is clearly more likely, by a factor of 400.

A difference this large occurs by chance in at most 3 of 10 000 cases.
"""

_LEAST_PROBABILITY = 0.01
"""Minimum probability of the rotations under the best hypothesis; below this minimum another error is present."""

_SIGMAS = 5.0
_FOCAL_LENGTH_TOLERANCE = 0.01
"""Relative error of the focal length above which stars near the edge of the image are lost."""

_ACCEPTED_SIGMAS = 2.0
"""Error of the focal length, in its configured standard deviations, that is accepted without a warning."""

_OTHER_BAND = 0.4
"""Offset in magnitudes that indicates another band: V and Hp differ by at most 0.15 on average, B and R from Hp by 0.5
and more."""

_OFFSET_SIGMAS = 3.0


@dataclass(frozen=True)
class CameraTurn:
    """Mean rotation of a camera on the deck relative to its installation, measured with the attitude of the INS.

    Attributes:
        turn_d: rotation vector, deck frame, from the configured to the measured installation, rad, shape (3,).
        covariance_d: covariance of errors not shared with other cameras (installation, noise of the mean), rad², shape
            (3, 3).
        pixel_d: rotation vector due to pixels counted from 1, rad, shape (3,).
    """

    turn_d: FloatArray
    covariance_d: FloatArray
    pixel_d: FloatArray


def cameras_counting_from_one(cameras: Sequence[CameraTurn], ins_covariance_d: FloatArray) -> tuple[int, ...]:
    """Return the indices of the cameras whose rotations show that they count pixels from 1.

    Hypotheses are: no camera, each camera alone, all cameras together. The result is the intersection of all hypotheses
    that are not clearly less likely than the best hypothesis. The result is empty if even the best hypothesis is
    improbable.

    Args:
        cameras: cameras of one ship, each compared with the same INS.
        ins_covariance_d: covariance of the INS attitude, deck frame, rad², shape (3, 3).
    """
    if not cameras:
        return ()
    count = len(cameras)
    turn = np.concatenate([camera.turn_d for camera in cameras])
    covariance = np.kron(np.ones((count, count)), ins_covariance_d)
    for number, camera in enumerate(cameras):
        own = slice(3 * number, 3 * number + 3)
        covariance[own, own] += camera.covariance_d
    chi_squares = {}
    for chosen in ((), *_choices(count)):
        left = turn.copy()
        for number in chosen:
            left[3 * number : 3 * number + 3] -= cameras[number].pixel_d
        chi_squares[chosen] = float(left @ np.linalg.solve(covariance, left))
    least = min(chi_squares.values())
    if probability_above(least, 3 * count) <= _LEAST_PROBABILITY:
        return ()
    likely = [chosen for chosen, chi_square in chi_squares.items() if chi_square <= least + _CLEARLY_LIKELIER]
    return tuple(number for number in range(count) if all(number in chosen for chosen in likely))


def rate_corrected_turn(turns_d: FloatArray, rates_d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean rotation of a camera, corrected for a time offset while the deck moves, and its covariance.

    Args:
        turns_d: rotation vectors at n times, deck frame, rad, shape (n, 3).
        rates_d: rates of the deck at these times, rad/s, shape (n, 3).

    Returns:
        Rotation vector, rad, shape (3,), and covariance, rad², shape (3, 3).
    """
    count, mean_d, mean_rate_d = len(turns_d), turns_d.mean(axis=0), rates_d.mean(axis=0)
    swing_d = rates_d - mean_rate_d
    square = float(np.sum(swing_d**2))
    offset_s = float(np.sum(swing_d * turns_d)) / square if square > 0.0 else 0.0
    left_d = turns_d - mean_d - offset_s * swing_d
    noise_d = left_d.T @ left_d / max(count - 1, 1)
    offset_variance = float(np.trace(noise_d)) / 3.0 / square if square > 0.0 else 0.0
    covariance_d: FloatArray = noise_d / count + offset_variance * np.outer(mean_rate_d, mean_rate_d)
    return mean_d - offset_s * mean_rate_d, covariance_d


def _choices(count: int) -> Iterator[tuple[int, ...]]:
    """Yield each camera alone, and all of them if there are several."""
    yield from ((number,) for number in range(count))
    if count > 1:
        yield tuple(range(count))


def camera_contradictions(mounting: MeasuredMounting, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    """Yield each contradiction as True (error) or False (warning), parameter, and text."""
    camera = mounting.camera
    if camera is None:
        return
    if camera.axes.text:
        text = (
            f"{mounting.section}.camera: stars on '{mounting.topic}' in {bag.path} fit the sky only in a mirrored "
            f"image: {camera.axes.text}; expected u to the right and v down, looking out of the sensor"
        )
        yield True, f"{mounting.section}.camera", text
    if camera.focal_length_m is not None:
        yield from _focal_length(mounting, camera, camera.focal_length_m, bag)
    if camera.magnitudes is not None:
        yield from _magnitudes(mounting, camera.magnitudes, bag)


def _focal_length(
    mounting: MeasuredMounting, camera: MeasuredCamera, measured_m: float, bag: Bag
) -> Iterator[tuple[bool, str, str]]:
    configured_m = mounting.device.camera.focal_length_m
    name, pitch_m = f"{mounting.section}.camera.focal_length_m", mounting.device.camera.pixel_pitch_m
    start = f"parameter '{name}' = {configured_m:g} m, but angles between stars on '{mounting.topic}' in {bag.path}"
    off = measured_m / configured_m - 1.0
    if not abs(off) <= _FOCAL_LENGTH_TOLERANCE:
        yield True, name, f"{start} are those of {measured_m:.4g} m with pixels of {pitch_m:g} m"
        return
    least = _ACCEPTED_SIGMAS * mounting.device.camera.focal_sigma
    if camera.optics is not None and abs(off) > max(_SIGMAS * camera.optics.scale_sigma, least):
        sigma_m = camera.optics.scale_sigma * configured_m
        text = (
            f"{start} are those of {measured_m:.6g} m, sigma {sigma_m:.1g} m, with pixels of {pitch_m:g} m: "
            f"{100.0 * off:+.3f} %"
        )
        yield False, name, text


def _magnitudes(
    mounting: MeasuredMounting, magnitudes: MagnitudeOffset, bag: Bag
) -> Iterator[tuple[bool, str, str]]:
    if abs(magnitudes.offset) <= max(_OTHER_BAND, _OFFSET_SIGMAS * magnitudes.sigma):
        return
    side = "fainter" if magnitudes.offset > 0.0 else "brighter"
    text = (
        f"{mounting.section}: magnitudes of stars on '{mounting.topic}' in {bag.path} are {abs(magnitudes.offset):.2f} "
        f"{side} than the catalogue's (Hp), sigma {magnitudes.sigma:.2f}: instrumental, or of another band; "
        f"subtract {magnitudes.offset:.2f}, or give NaN"
    )
    yield False, mounting.section, text

"""Cameras whose pixels are counted from 1, detected from their attitudes relative to each other and to the INS.

If a camera counts pixels from 1, all stars appear one pixel to the right and down: the camera's attitude is rotated by
one pixel about its up and right axes. If the installations are known to less than a pixel, the measured rotations of
several cameras against one INS show whether this rotation is present. One camera is enough if the attitude of the INS
is known to less than a pixel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ship_estimation.innovations.chi_square import probability_above
from ship_geometry.rotations import FloatArray

_CLEARLY_LIKELIER = 12.0
"""Difference of chi² from which on one hypothesis is clearly more likely, by a factor of 400.

A difference this large occurs by chance in at most 3 of 10 000 cases.
"""

_LEAST_PROBABILITY = 0.01
"""Minimum probability of the rotations under the best hypothesis; below this minimum another error is present."""


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

"""The ship's attitude error as a state whose size is said by the messages, and may change at once.

Between two messages the error is a Gauss–Markov process with the steady covariance that the messages state. Where that
changes by more than a factor of two, more has happened than the process allows: stars came, or another system took
over. Then, axis by axis, what is left of the old error is what a Kalman update that reduced the variance so would
leave of it (the share new / old), or all of it where the variance grew; the rest of the new covariance is new.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

_AT_ONCE = 2.0


@dataclass(frozen=True)
class ShipErrorStep:
    """What happens to the error at once.

    Attributes:
        kept: share of each component that is left, shape (3,).
        new_n: covariance of what comes anew, rad², shape (3, 3).
    """

    kept: FloatArray
    new_n: FloatArray


def ship_error_step(followed_n: FloatArray, now_n: FloatArray) -> ShipErrorStep | None:
    """The step from one stated covariance to another, rad², shape (3, 3) each; None where there is none."""
    old, new = np.diagonal(followed_n), np.diagonal(now_n)
    if np.all(new <= _AT_ONCE * old) and np.all(old <= _AT_ONCE * new):
        return None
    kept = np.where(old > 0.0, np.minimum(new / np.where(old > 0.0, old, 1.0), 1.0), 1.0)
    left_n = now_n - followed_n * np.outer(kept, kept)
    # Not all changes of a matrix are such a step in each axis: what would be negative is none.
    values, vectors = np.linalg.eigh(0.5 * (left_n + left_n.T))
    return ShipErrorStep(kept, (vectors * np.maximum(values, 0.0)) @ vectors.T)


def with_step(
    mean: FloatArray, parts: FloatArray, rows: slice, source_index: int, step: ShipErrorStep
) -> tuple[FloatArray, FloatArray]:
    """State and covariance parts after the step; the arguments are left as they are.

    Args:
        mean: shape (n,).
        parts: shape (n_sources, n, n).
        rows: where the ship's error is.
        source_index: of its source.
        step: what happens.
    """
    mean, parts = mean.copy(), parts.copy()
    mean[rows] *= step.kept
    parts[:, rows, :] *= step.kept[:, None]
    parts[:, :, rows] *= step.kept
    parts[source_index, rows, rows] += step.new_n
    return mean, parts

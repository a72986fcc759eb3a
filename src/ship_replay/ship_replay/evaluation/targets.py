"""Errors of directions and positions of targets against the truth, by target.

The error of a direction has two components across the direction; the error of a position has three. Each error is
compared with its own covariance. A target in the truth is listed even if no direction to it was published.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.messages.field_checks import covariance_3x3, finite_vector
from ship_replay.evaluation.statistics import root_mean_square

TARGET_DIRECTION, TARGET_TRUTH = "theodolite/target_direction", "truth/target_direction"

_UNKNOWN = np.full((3, 3), np.nan)


@dataclass
class TargetErrors:
    """Errors of one target's directions and positions, one for each stamp of the truth with a usable direction.

    A published direction is usable unless it is INVALID or malformed.

    Attributes:
        unavailable_ns: stamps of the truth at which the published direction was INVALID, malformed or missing.
        time_ns: stamps of usable directions.
        direction_error_arcsec: estimate minus truth across the true direction, shape (2,) each.
        sigma_arcsec: predicted standard deviation, root mean square of the two components.
        nees: normalised error squared of the direction (2 degrees of freedom).
        position_error_m: distance of the published position from the true position; NaN if no position was published.
        position_sigma_m: predicted standard deviation, root sum square of the three axes.
        position_nees: normalised error squared of the position (3 degrees of freedom).
    """

    unavailable_ns: list[int] = field(default_factory=list)
    time_ns: list[int] = field(default_factory=list)
    direction_error_arcsec: list[FloatArray] = field(default_factory=list)
    sigma_arcsec: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    position_error_m: list[float] = field(default_factory=list)
    position_sigma_m: list[float] = field(default_factory=list)
    position_nees: list[float] = field(default_factory=list)

    def since(self, start_ns: int) -> "TargetErrors":
        """Return the errors stamped at or after a time."""
        kept = [row for row, time_ns in enumerate(self.time_ns) if time_ns >= start_ns]
        unavailable_ns = [time_ns for time_ns in self.unavailable_ns if time_ns >= start_ns]
        _, *columns = vars(self).values()
        return TargetErrors(unavailable_ns, *([values[row] for row in kept] for values in columns))

    def statistics(self) -> dict[str, float]:
        """Return quantity → value; quantities of directions and of positions only if some were published."""
        values = {"samples": float(len(self.time_ns)), "not_claimed": float(len(self.unavailable_ns))}
        if not self.time_ns:
            return values
        sizes_arcsec = np.linalg.norm(self.direction_error_arcsec, axis=-1)
        values |= {
            "direction.rms_arcsec": root_mean_square(sizes_arcsec / np.sqrt(2.0)),
            "direction.sigma_arcsec": root_mean_square(self.sigma_arcsec),
            "direction.nees_mean": float(np.mean(self.nees)),
        }
        has_position = np.isfinite(self.position_error_m)
        if np.any(has_position):
            values |= {
                "position.samples": float(np.sum(has_position)),
                "position.rms_m": root_mean_square(np.array(self.position_error_m)[has_position]),
                "position.sigma_m": root_mean_square(np.array(self.position_sigma_m)[has_position]),
                "position.nees_mean": float(np.mean(np.array(self.position_nees)[has_position])),
            }
        return values


class TargetDirections:
    """Collector of target directions published at the stamps of the truth; INVALID directions count as missing."""

    def __init__(self) -> None:
        self._truths: dict[tuple[str, int], Any] = {}
        self._errors: dict[str, TargetErrors] = {}
        self._available: set[tuple[str, int]] = set()

    def since(self, start_ns: int) -> dict[str, TargetErrors]:
        """Return target_id → errors stamped at or after a time, for each target with truth in this time."""
        errors = {target_id: TargetErrors() for target_id, _ in sorted(self._truths)} | self._errors
        for target_id, time_ns in sorted(self._truths):
            if (target_id, time_ns) not in self._available:
                errors[target_id].unavailable_ns.append(time_ns)
        found = {target_id: of_target.since(start_ns) for target_id, of_target in errors.items()}
        return {target_id: one for target_id, one in found.items() if one.time_ns or one.unavailable_ns}

    def __len__(self) -> int:
        return len(self._truths)

    def add_truth(self, message: Any) -> None:
        """Add a TargetDirection of the truth.

        Raises:
            MessageRejected: the direction is not finite.
        """
        finite_vector(message.direction, "direction of the truth")
        self._truths[message.target_id, ns_from_stamp(message.header.stamp)] = message

    def add_message(self, message: Any) -> None:
        """Add a published TargetDirection.

        Raises:
            MessageRejected: a value is not finite, or a covariance is not valid.
        """
        time_ns = ns_from_stamp(message.header.stamp)
        truth = self._truths.get((message.target_id, time_ns))
        if truth is None or message.status == message.INVALID:
            return
        direction = finite_vector(message.direction, "direction")
        known = covariance_3x3(message.direction_covariance, "direction_covariance")
        direction_covariance = _UNKNOWN if known is None else known
        place, place_covariance = _vector(message.position), _UNKNOWN
        if not np.all(np.isnan(place)):
            place = finite_vector(message.position, "position")
            known = covariance_3x3(message.position_covariance, "position_covariance")
            place_covariance = _UNKNOWN if known is None else known
        self._available.add((message.target_id, time_ns))
        across = np.linalg.svd(_vector(truth.direction)[None])[2][1:]
        error = across @ (direction - _vector(truth.direction))
        covariance = across @ direction_covariance @ across.T
        off_m = place - _vector(truth.position)
        errors = self._errors.setdefault(message.target_id, TargetErrors())
        errors.time_ns.append(time_ns)
        errors.direction_error_arcsec.append(error / ARCSEC)
        errors.sigma_arcsec.append(float(np.sqrt(0.5 * np.trace(covariance)) / ARCSEC))
        errors.nees.append(_square(error, covariance))
        errors.position_error_m.append(float(np.linalg.norm(off_m)))
        errors.position_sigma_m.append(float(np.sqrt(np.trace(place_covariance))))
        errors.position_nees.append(_square(off_m, place_covariance))


def _vector(of: Any) -> FloatArray:
    return np.array([of.x, of.y, of.z])


def _square(error: FloatArray, covariance: FloatArray) -> float:
    """Return the normalised error squared; NaN if error or covariance is unknown."""
    if not np.all(np.isfinite(covariance)) or not np.linalg.eigvalsh(covariance)[0] > 0.0:
        return float("nan")
    return float(error @ np.linalg.solve(covariance, error))

"""Diagnosis hints for a lasting disagreement between a source and the INS: probable cause and parameters to check."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ship_estimation.innovations.gates import chi_square_gate, normalized_error_squared
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import FloatArray, angle_between, wrap_pi

_HEADING_TOLERANCE_RAD: float = np.deg2rad(5.0)
"""Maximum remaining difference for a heading mistake to explain a disagreement, rad."""

_MIN_HEADING_ERROR_RAD = np.deg2rad(10.0)
"""Minimum heading difference for a hint, rad.

Near the headings 45° and 225°, heading and yaw (90° - heading) are almost equal, so yaw would explain any small
difference.
"""

_SAME_TILT_RAD = np.deg2rad(15.0)
"""Maximum tilt difference for a heading mistake, rad, because a heading mistake does not change the tilt."""

_QUARTER_TURN = 0.5 * np.pi
_REFERENCE = "reference."
_SAME_RATIO = 0.5
"""Maximum difference of two residuals that count as equal, divided by the smaller residual."""

_RECENT_NS = 10_000_000_000
"""Maximum age, at the stamp of the last rejected measurement of the source, of other measurements in a hint, ns."""

_SAME_CHI2 = chi_square_gate(0.999, 3)


@dataclass(frozen=True)
class AttitudeResidual:
    """Residual of a rejected attitude.

    Attributes:
        time_ns: stamp of the measurement.
        turn_n: rotation from predicted to measured attitude, rotation vector in the horizon frame, rad, shape (3,).
        noise_n: covariance of this rotation due to the measurement noise, rad², shape (3, 3).
    """

    time_ns: int
    turn_n: FloatArray
    noise_n: FloatArray


def diagnosis_hint(
    source: str,
    heading_parameter: str,
    consecutive_rejections: Mapping[str, int],
    last_used_ns: Mapping[str, int],
    rejected_residuals: Mapping[str, AttitudeResidual],
    ins_nd: FloatArray,
    measured_nd: FloatArray,
) -> str:
    """Return a diagnosis hint for a lasting disagreement between a source and the INS.

    Args:
        source: source that disagrees with the INS.
        heading_parameter: name of the parameter of its mounting that determines the heading.
        consecutive_rejections: number of consecutive rejections by source.
        last_used_ns: stamp of the last accepted measurement by source, ns.
        rejected_residuals: residual of the last rejected measurement by source.
        ins_nd: attitude of the deck by the INS, shape (3, 3).
        measured_nd: attitude of the deck by the source, shape (3, 3).
    """
    since_ns = rejected_residuals[source].time_ns - _RECENT_NS
    consistent = [
        name
        for name, time_ns in last_used_ns.items()
        if time_ns >= since_ns and not consecutive_rejections.get(name, 0)
    ]
    inconsistent = {
        name: residual
        for name, residual in rejected_residuals.items()
        if residual.time_ns >= since_ns and consecutive_rejections.get(name, 0)
    }
    ins_confirmed = bool(consistent) and len(inconsistent) == 1
    hint = heading_hint(ins_nd, measured_nd, source, heading_parameter, ins_confirmed)
    return f"{hint}; {consistency_text(source, consistent, inconsistent)}"


def heading_hint(
    ins_nd: FloatArray, measured_nd: FloatArray, source: str, heading_parameter: str, ins_confirmed: bool
) -> str:
    """Return a hint if the headings differ by a common mistake of marine drivers; otherwise return an empty text.

    Args:
        ins_nd: attitude of the deck by the INS, shape (3, 3).
        measured_nd: attitude of the deck by the other source, shape (3, 3).
        source: the other source, for example ``reference.<name>``.
        heading_parameter: name of the parameter of its mounting that determines the heading.
        ins_confirmed: True if other sources are consistent with the INS and only ``source`` is not; then the INS is not
            the cause.
    """
    by_ins, measured = angles_from_rotation(ins_nd)[0], angles_from_rotation(measured_nd)[0]
    difference = abs(float(wrap_pi(measured - by_ins)))
    # Row 1 is the direction Up in the deck frame.
    tilt = float(angle_between(ins_nd[1], measured_nd[1]))
    # With the condition in this form, NaN gives no hint.
    if not (difference > _MIN_HEADING_ERROR_RAD and tilt < _SAME_TILT_RAD):
        return ""
    is_reference = source.startswith(_REFERENCE)
    if _is_near(by_ins + measured, _QUARTER_TURN) and (is_reference or not ins_confirmed):
        of, driver = "ins", "the INS"
        if ins_confirmed:
            of, driver = f"references.{source.removeprefix(_REFERENCE)}", source
        return f", as if heading were given as yaw (90° - heading): check {of}.convention and the driver of {driver}"
    if _is_near(difference, _QUARTER_TURN):
        ins = "" if ins_confirmed else "ins.convention, ins.installation_heading_deg and "
        return f" by about 90° in heading: check {ins}{heading_parameter}"
    if _is_near(difference, np.pi):
        ins = "" if ins_confirmed else " and ins.installation_heading_deg"
        return f" by about 180° in heading: check {heading_parameter}{ins}"
    return ""


def consistency_text(source: str, consistent: Sequence[str], inconsistent: Mapping[str, AttitudeResidual]) -> str:
    """Return a text that states which sources are consistent with the INS and which are not.

    Args:
        source: source that disagrees with the INS.
        consistent: other sources that are consistent with the INS.
        inconsistent: residuals of the sources that disagree with the INS, ``source`` included.
    """
    others = [other for other in inconsistent if other != source]
    if consistent and not others:
        return f"only {source} differs, {_consistent_sources_text(consistent)} with the INS"
    if consistent:
        against = f"{', '.join(sorted(inconsistent))} disagree with the INS"
        return f"{against}, {_consistent_sources_text(consistent)} with the INS"
    if not others:
        return "no other source shows which of the two is faulty"
    if _are_same_residual(list(inconsistent.values())):
        return f"only the INS differs, {', '.join(sorted(inconsistent))} disagree with the INS equally"
    return f"{', '.join(sorted(inconsistent))} disagree with the INS and with each other"


def _consistent_sources_text(consistent: Sequence[str]) -> str:
    return f"{', '.join(sorted(consistent))} {'agree' if len(consistent) > 1 else 'agrees'}"


def _are_same_residual(residuals: Sequence[AttitudeResidual]) -> bool:
    return all(_is_same_residual(first, second) for first, second in combinations(residuals, 2))


def _is_same_residual(first: AttitudeResidual, second: AttitudeResidual) -> bool:
    """True if two residuals are equal within half the smaller residual, or within their noise."""
    difference = first.turn_n - second.turn_n
    size = min(float(np.linalg.norm(first.turn_n)), float(np.linalg.norm(second.turn_n)))
    if float(np.linalg.norm(difference)) <= _SAME_RATIO * size:
        return True
    noise_n = first.noise_n + second.noise_n
    return bool(noise_n.any()) and bool(normalized_error_squared(difference, noise_n) <= _SAME_CHI2)


def _is_near(angle: float, target: float) -> bool:
    return abs(float(wrap_pi(angle - target))) < _HEADING_TOLERANCE_RAD

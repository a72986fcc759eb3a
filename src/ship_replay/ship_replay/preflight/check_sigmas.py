"""Contradictions between sigmas and a bag, found from the innovations of a source or from the rates of the INS."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.measurements.baseline import BASELINE
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_estimation.innovations.innovation_diagnosis import DiagnosisKind, InnovationDiagnosis
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_node.adapters.node_adapter import NodeAdapter
from ship_node.messages.field_checks import MessageRejected
from ship_node.messages.ins_messages import ins_sample
from ship_replay.preflight.check_config import BagCheck, CheckedNode

CONTRADICTED_FACTOR = 1.5
"""Ratio of measured to stated sigma, or its inverse, from which on the data contradict the sigma."""

_INS_TOPIC = "ins/imu"
_LEAST_FACTOR = 0.01
_FEWEST_STEPS, _LONGEST_STEP_S = 200, 0.15
_RATE_SIGMAS = 5.0
_OUTLIER, _MAX_CORRELATED_SHARE = 8.0, 0.2


class InsNoise(NamedTuple):
    """Noise of an INS from its attitudes and rates, standard deviation per axis.

    Attributes:
        attitude_sigma_rad: standard deviation of a single attitude, rad.
        rate_sigma_rad_per_s: standard deviation of a single rate, rad/s; 0 if the attitude noise is too large to
            measure the rate noise, NaN if correlated errors are too large.
    """

    attitude_sigma_rad: float
    rate_sigma_rad_per_s: float


def check_sigmas(check: BagCheck, until_ns: int) -> None:
    """Report the sigmas that the data contradict, with the values that fit.

    Args:
        check: check whose nodes have processed the bag.
        until_ns: log time up to which the nodes have processed the bag.
    """
    for node in check.nodes:
        rests_on_ins = isinstance(node.config, (ShipAttitudeConfig, StarAttitudeConfig)) and _INS_TOPIC in check.usable
        # Innovations are not checked if the INS noise is wrong, because all depend on the INS.
        if rests_on_ins and _check_ins_noise(check, node, until_ns):
            continue
        if isinstance(node.adapter, NodeAdapter):
            for source, diagnosis in node.adapter.innovation_report.diagnoses().items():
                _check_source(check, node, node.adapter, source, diagnosis)


def _check_source(
    check: BagCheck, node: CheckedNode, adapter: NodeAdapter, source: str, diagnosis: InnovationDiagnosis
) -> None:
    """Report the noise parameters of one source that contradict its innovation diagnosis."""
    if diagnosis.kind not in (DiagnosisKind.OPTIMISTIC, DiagnosisKind.CONSERVATIVE):
        return
    factor = diagnosis.factor
    # Data without any noise are artificial and contradict no sigma.
    if not (factor >= CONTRADICTED_FACTOR or _LEAST_FACTOR <= factor <= 1.0 / CONTRADICTED_FACTOR):
        return
    feed = next(feed for feed in adapter.feeds.values() if feed.source == source)
    record = adapter.health.records[feed.input.topic]
    text_of_factor = f"the innovations of {source} in {check.bag.path} fit {factor:.2g} times this noise"
    names = list(_parameters(node.config, source))
    if not names or 2 * record.note_counts[Reason.COVARIANCE_UNKNOWN] < record.received:
        text = (
            f"{check.bag.path}: topic '{feed.input.topic}' states a noise, but {text_of_factor} "
            f"({diagnosis.count} measurements)"
        )
        check.report(False, f"{text}: {factor**2:.2g} times its variance fits")
        return
    for name in names:
        value = _value(node.config, name)
        text = f"{node.place(check.path, name)}: parameter '{name}' = {value:.3g}, but {text_of_factor}"
        check.report(False, f"{text} ({diagnosis.count} measurements): {factor * value:.2g} fits")


def _parameters(config: Any, source: str) -> Iterator[str]:
    """Yield the dotted names of a source's noise parameters, which apply if its messages give no covariance."""
    group, _, id_ = source.partition(".")
    if group == "star":
        section = "star_sensors" if id_ in getattr(config, "star_sensors", {}) else "telescopes"
        device = getattr(config, section)[id_]
        if getattr(device, "input", "observations") == "observations":
            yield f"{section}.{id_}.camera.centroid_sigma_px"
        else:
            yield from (f"{section}.{id_}.sigma_{axis}_arcsec" for axis in ("forward", "up", "right"))
    elif group == "reference":
        yield from (f"references.{id_}.sigma_{axis}_arcsec" for axis in ("heading", "pitch", "roll"))
    elif source == BASELINE:
        yield "ship_baseline.noise_sigma_m"
    elif source == "lights":
        yield "telescope.sigma_m"


def _value(config: Any, name: str) -> float:
    value = config
    for part in name.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    return float(value)


def _check_ins_noise(check: BagCheck, node: CheckedNode, until_ns: int) -> bool:
    """Report configured INS noise that is smaller than the measured noise; return True if any is found.

    A measured noise below the configured noise is not a contradiction, because the measured noise contains no
    correlated errors.
    """
    times, rotations, rates = [], [], []
    for record in check.bag.records({check.topic_names[_INS_TOPIC]}):
        if record.log_time_ns > until_ns:
            break
        try:
            sample = ins_sample(record.decode(), node.config.ins, record.log_time_ns).value
        except (MessageRejected, BadInput):
            continue
        if sample.rate_d is not None:
            times.append(sample.time_ns)
            rotations.append(sample.rotation_nd)
            rates.append(sample.rate_d)
    noise = ins_noise(np.array(times), np.array(rotations), np.array(rates))
    if noise is None:
        return False
    measured = {
        "ins.white_sigma_arcsec": (noise.attitude_sigma_rad / ARCSEC, "arcsec"),
        "ins.rate_sigma_arcsec_per_s": (noise.rate_sigma_rad_per_s / ARCSEC, "arcsec/s"),
    }
    found = False
    for name, (value, unit) in measured.items():
        stated = _value(node.config, name)
        # A rate sigma configured as zero is unknown, and estimated from the samples.
        if stated > 0.0 and value >= CONTRADICTED_FACTOR * stated:
            text = f"{node.place(check.path, name)}: parameter '{name}' = {stated:.3g} {unit}, but '{_INS_TOPIC}'"
            against = "attitudes scatter against their own rates" if "white" in name else "rates scatter"
            measured_text = f"{against} by {value:.2g} {unit}, 1 sigma: set the parameter to this value"
            check.report(False, f"{text} in {check.bag.path}: {measured_text}")
            found = True
    return found


def ins_noise(times_ns: Any, rotations_nd: FloatArray, rates_d: FloatArray) -> InsNoise | None:
    """Return the noise of an INS, from the rotation between two attitudes minus the rotation by their mean rate.

    The noise of an attitude enters two successive differences with opposite signs, the noise of a rate with equal
    signs.

    Args:
        times_ns: stamps, shape (N,).
        rotations_nd: attitudes, shape (N, 3, 3).
        rates_d: rates, rad/s, shape (N, 3).

    Returns:
        Noise; None if there are too few samples, or if their spacing in time is too long.
    """
    if len(times_ns) < _FEWEST_STEPS:
        return None
    steps_s = 1e-9 * np.diff(times_ns)
    usual_s = float(np.median(steps_s))
    turns = log_rotation(np.swapaxes(rotations_nd[:-1], 1, 2) @ rotations_nd[1:])
    coning = np.cross(rates_d[:-1], rates_d[1:]) * steps_s[:, None] ** 2 / 12.0
    residuals = turns - 0.5 * (rates_d[:-1] + rates_d[1:]) * steps_s[:, None] - coning
    residuals -= np.median(residuals, axis=0)
    size = np.linalg.norm(residuals, axis=1)
    good = (np.abs(steps_s - usual_s) <= 0.5 * usual_s) & (size <= _OUTLIER * np.median(size))
    pairs, skipping = good[1:] & good[:-1], good[2:] & good[:-2]
    if not 0.0 < usual_s <= _LONGEST_STEP_S or np.count_nonzero(pairs) < _FEWEST_STEPS:
        return None
    variance = float(np.mean(residuals[good] ** 2))
    next_one = float(np.mean((residuals[1:] * residuals[:-1])[pairs]))
    one_further = float(np.mean((residuals[2:] * residuals[:-2])[skipping]))
    of_rates = variance + 2.0 * next_one
    if of_rates < _RATE_SIGMAS * variance * np.sqrt(2.0 / np.count_nonzero(pairs)):
        of_rates = 0.0
    is_correlated = abs(one_further) > _MAX_CORRELATED_SHARE * variance
    return InsNoise(
        np.sqrt(max(variance - 0.5 * of_rates, 0.0) / 2.0), np.nan if is_correlated else np.sqrt(of_rates) / usual_s
    )

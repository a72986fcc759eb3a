"""Trial of a configuration: its nodes process a bag, to find wrong sigmas and inputs that are hardly used.

A wrong sigma is found from the innovations of a source, or from the rates of the INS.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.measurements.devices import BASELINE
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_estimation.innovations.innovation_diagnosis import DiagnosisKind, InnovationDiagnosis
from ship_estimation.rejection_rules import LONGEST_TEXT, Reason, shorten
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_node.adapters.node_adapter import NodeAdapter
from ship_node.messages.field_checks import MessageRejected
from ship_node.messages.sensor_readers import ins_sample
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.outputs import NullSink
from ship_replay.offline.replay_run import ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary, low_use_text, most_frequent_rejection
from ship_replay.preflight.check_config import INS_TOPIC, BagCheck, CheckedNode

CONTRADICTED_FACTOR = 1.5
"""Ratio of measured to stated sigma, or its inverse, from which on the data contradict the sigma."""

_LEAST_FACTOR = 0.01
_FEWEST_STEPS, _LONGEST_STEP_S = 200, 0.15
_RATE_SIGMAS = 5.0
_OUTLIER, _MAX_CORRELATED_SHARE = 8.0, 0.2

TRIAL_S = 600.0
"""Length of the part of a bag that is replayed, s: ten minutes of data take half a minute."""

_FEWEST = 10
_CONFIGURATION_REASONS = [
    Reason.ATTITUDE_CONFLICT.word,
    Reason.BAD_QUATERNION.word,
    Reason.EXCLUDED.word,
    Reason.FRAME.word,
    Reason.GATE.word,
    Reason.LIGHT_CONFLICT.word,
    Reason.UNITS.word,
    Reason.UNKNOWN_SENSOR.word,
]
"""Rejection reasons that indicate a wrong configuration if they affect a whole input."""

_WEATHER_REASONS = [
    reason.word for reason in (Reason.TOO_FEW_STARS, Reason.BELOW_HORIZON, Reason.DUPLICATE, Reason.OFF)
]
"""Rejection reasons that indicate no fault even if they affect most of an input."""

_ADVICE = {
    Reason.FUTURE.word: "set the device's clock to UTC (GPS time is 18 s ahead), or let its driver use the computer's "
    "clock",
    Reason.LATE.word: "set the device's clock, or raise lag_s to its delay",
    Reason.GAP.word: "samples of ins/imu around it are missing or rejected: check ins/imu first",
    Reason.NO_FIX.word: "provide position fixes on gnss/fix at least every sky.fix_max_age_s, stamped in UTC",
    Reason.UNIDENTIFIED.word: "check the camera's focal length, the installation angles, gnss/fix and the stamps (UTC)",
    Reason.JUMP.word: "such jumps are impossible on a ship: check the receiver or instrument first",
    Reason.NOT_FIXED.word: "the receiver has no fixed solution: check its corrections, or set least_fix",
}
"""Advice by rejection reason."""


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
        rests_on_ins = isinstance(node.config, (ShipAttitudeConfig, StarAttitudeConfig)) and INS_TOPIC in check.usable
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
    for record in check.bag.records({check.topic_names[INS_TOPIC]}):
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
            text = f"{node.place(check.path, name)}: parameter '{name}' = {stated:.3g} {unit}, but '{INS_TOPIC}'"
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


def check_trial(check: BagCheck) -> None:
    """Replay the beginning of a bag through the nodes; report wrong sigmas and inputs that are hardly used.

    Sigmas are checked only if no error was found before. The nodes cannot be used afterwards.
    """
    bag = check.bag
    chain = AdapterChain([node.adapter for node in check.nodes])
    names = {check.topic_names[topic.topic]: topic.topic for topic in chain.inputs if topic.topic in check.topic_names}
    run = ReplayRun(chain, NullSink(), ReplaySummary(), truth_topics=())
    is_cut, until_ns = False, bag.start_ns + round(TRIAL_S * NS_PER_S)
    try:
        for record in bag.records(names) if names else ():
            if record.log_time_ns > until_ns:
                is_cut = True
                break
            run.process_message(names[record.topic], record)
        run.finish()
    except BadInput as problem:
        check.findings.errors.append(f"{bag.path}: {problem}")
        return
    span = f"in the first {TRIAL_S:.0f} s: " if is_cut else ""
    for node in check.nodes:
        _check_use(check, node, run.last_time_ns or 0, span)
    if not check.findings.errors:
        check_sigmas(check, until_ns)


def _check_use(check: BagCheck, node: CheckedNode, last_ns: int, span: str) -> None:
    """Report inputs of which a node used at most half, and inputs with two publishers."""
    for text in node.adapter.health.first_duplicate_publishers.values():
        check.report(False, f"{check.bag.path}: {span}{text}; outputs based on both are not VALID")
    records, factory = node.adapter.health.records, RosbagsFactory()
    for health in node.adapter.health.messages(factory, last_ns):
        line = low_use_text(health) if health.received >= _FEWEST else ""
        if not line:
            continue
        word = most_frequent_rejection(health)[0]
        line_text = f"{check.bag.path}: {span}{node.adapter.node_name}: {line}"
        if not health.accepted and word in _CONFIGURATION_REASONS:
            check.findings.errors.append(line_text)
        elif 2 * health.rejected <= health.received or word in _WEATHER_REASONS:
            check.findings.warnings.append(line_text)
        else:
            share = f" ({100.0 * health.rejected / health.received:.0f} % not used)"
            check.findings.unused_inputs.append(
                line_text + share + _reason_and_advice(records[health.topic].last_rejection, word)
            )


def _reason_and_advice(last: Any, word: str) -> str:
    """Return the advice for a reason, after the text of the last rejection if it has this reason."""
    node_text = f": {shorten(last.text, LONGEST_TEXT)}" if last is not None and last.reason.word == word else ""
    return f"{node_text}; {_ADVICE[word]}" if word in _ADVICE else node_text

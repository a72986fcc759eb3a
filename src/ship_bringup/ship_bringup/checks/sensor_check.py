"""Check that every sensor of the suite file is received: type, rate, and stamps that fit this computer's clock."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from ship_bags.parameter_yaml import RELIABLE_INPUTS_PARAMETER, read_sections
from ship_bags.renamed_topics import ship_names
from ship_bags.topic_names import resolve_topic
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_state import STRONGER_QOS, NetworkState, ObservedTopic
from ship_node.health.input_record import MAX_AGE_S
from ship_watch.safety.limits import Limits
from ship_watch.topics import source_of_topic

_CHECK = "sensors"
_NOT_TIME_ORDERED = "gnss", "weather"
"""Inputs whose values are used on arrival, not in order of time."""
_OLD = "old"
_UNITS = ("years", 365.25 * 86400.0), ("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)
"""Units of ages and their lengths, s. An age is given in the largest unit of which it has at least two."""
_OVERRIDES, _RELIABLE = "qos_overrides.", "reliable"


def find_requested_qos(
    path: Path, topics: Iterable[str], namespace: str, reliable_inputs: bool = False
) -> dict[str, dict[str, str]]:
    """Return the qualities of service that settings require beyond a node's default.

    The result is relative topic → quality → setting that requires this quality.

    Args:
        path: the suite file.
        topics: relative names of inputs.
        namespace: namespace of the suite.
        reliable_inputs: True if ``suite`` will be started with ``--reliable-inputs``.
    """
    on_ship = ship_names(path)
    names = {topic: resolve_topic(on_ship.get(topic, topic), namespace) for topic in topics}
    prefixes = {f"{_OVERRIDES}{name}.subscription.": topic for topic, name in names.items()}
    found: dict[str, dict[str, str]] = {}
    if reliable_inputs:
        found = {topic: {_RELIABLE: "--reliable-inputs"} for topic in prefixes.values()}
    for section in read_sections(path)[1]:
        for key, (value, _) in section.parameters.items():
            if key == RELIABLE_INPUTS_PARAMETER and value is True:
                for name in prefixes.values():
                    found.setdefault(name, {})[_RELIABLE] = f"{key} in the suite file"
            topic = prefixes.get(key.rpartition(".")[0] + ".")
            if topic is not None and value in STRONGER_QOS:
                found.setdefault(topic, {})[value] = f"{_OVERRIDES[:-1]} in the suite file"
    return found


def check_sensors(
    state: NetworkState,
    limits: Limits,
    lags_s: Mapping[str, float],
    requested_qos: Mapping[str, Mapping[str, str]],
    own: Collection[str] = (),
    own_command: str = "",
) -> Iterator[CheckLine]:
    """Check all inputs.

    Args:
        state: observed state of the network.
        limits: limits of the ship; ``inputs.<id>.rate_hz`` is the expected rate.
        lags_s: relative topic → age beyond which a node no longer applies a message, s.
        requested_qos: see :func:`find_requested_qos`.
        own: inputs that the suite's own ``nmea_in`` may publish once it is started.
        own_command: command that starts this ``nmea_in`` now.
    """
    if state.failure:
        # Whatever the failure is, a suite whose sensors were not received is not ready.
        found = f"nothing could be received: {state.failure}"
        yield CheckLine(_CHECK, Result.FAIL, found, "correct the failures in the other rows, then run preflight again")
        return
    for observed in state.inputs:
        if not observed.publishers and observed.input.topic in own:
            found = f"{observed.input.topic}: no publisher yet: the suite starts nmea_in, which may publish it"
            # Without a publisher, a configured instrument may be switched off, so this is a failure too.
            is_needed = observed.input.required or observed.input.is_configured
            advice = f"start {own_command} and run preflight again; end nmea_in before you start the suite"
            yield CheckLine(_CHECK, Result.FAIL if is_needed else Result.NOT_CHECKED, found, advice)
            continue
        result, found, advice = _evaluate_input(observed, limits, lags_s, requested_qos.get(observed.input.topic, {}))
        if result is Result.FAIL and state.has_clock and found.endswith(_OLD):
            advice = "a bag is being played, as /clock shows: end its player"
        yield CheckLine(_CHECK, result, f"{observed.input.topic}: {found}", advice)


def _evaluate_input(
    observed: ObservedTopic, limits: Limits, lags_s: Mapping[str, float], requested_qos: Mapping[str, str]
) -> tuple[Result, str, str]:
    topic = observed.input.topic
    severity = Result.FAIL if observed.input.required or observed.input.is_configured else Result.WARN
    missing_result = Result.NOT_CHECKED if observed.input.is_occasional else severity
    if not observed.publishers:
        return missing_result, "no publisher", "start its driver, or name its topic in the suite file (topics)"
    of_type = [each for each in observed.publishers if each.type_name == observed.input.type_name]
    publishers = ", ".join(sorted({each.node for each in observed.publishers}))
    if not of_type:
        other = observed.publishers[0].type_name
        found = f"{publishers} publishes {other}, expected {observed.input.type_name}"
        return Result.FAIL, found, "change the driver, or name another topic in the suite file (topics)"
    if lacking := [
        quality for quality in sorted(requested_qos) if any(quality not in each.offered_qos for each in of_type)
    ]:
        settings = " and ".join(dict.fromkeys(requested_qos[quality] for quality in lacking))
        found = f"{publishers} does not offer {' and '.join(lacking)}, required by {settings}: no message will arrive"
        return Result.FAIL, found, f"let the driver offer it, or leave out {settings}"
    if not observed.count:
        return (
            missing_result,
            f"{publishers} publishes it, but no message arrived",
            "switch the device on; for a slow device use a longer --listen",
        )
    found = f"{observed.rate_hz:.3g} Hz from {publishers}" if observed.count > 1 else f"one message from {publishers}"
    least_hz = limits.input_limits(source_of_topic(topic)).rate_hz
    if not observed.rate_hz >= least_hz:
        advice = "check the device and the network; for a slow device use a longer --listen"
        return Result.FAIL, f"{found}: expected {least_hz:g} Hz at least", advice
    if observed.age_s is not None:
        found += f", stamps {_age_text(observed.age_s)}"
        if not -limits.machine.clock_offset_s <= observed.age_s <= MAX_AGE_S:
            return Result.FAIL, found, "set the clock of the device, or of this computer: nodes reject such stamps"
        if source_of_topic(topic) not in _NOT_TIME_ORDERED and not observed.age_s <= lags_s.get(topic, MAX_AGE_S):
            return Result.FAIL, f"{found}: later than lag_s", "check transmission delays, or increase lag_s"
    if len(observed.publishers) > 1:
        return (
            Result.WARN,
            f"{found}: {len(observed.publishers)} publishers",
            "end all publishers of this topic but one",
        )
    return Result.OK, found, ""


def _age_text(age_s: float) -> str:
    size_s = abs(age_s)
    for unit, unit_s in _UNITS:
        if size_s >= 2.0 * unit_s:
            length = f"{size_s / unit_s:.0f} {unit}"
            break
    else:
        length = f"{size_s:.3f} s"
    return f"{length} {'in the future' if age_s < 0.0 else _OLD}"

"""Checks of the network in which the suite will run: ROS domain, DDS security, and the sensors that are received.

The domain: its settings, and the nodes already in it. Security: DDS, the ship's keystore and its policies. Every sensor
of the suite file: type, rate, and stamps that fit this computer's clock.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from ship_bags.live.ros_process import ENABLE, is_security_requested
from ship_bags.parameter_yaml import RELIABLE_INPUTS_PARAMETER, read_sections
from ship_bags.topic_names import resolve_topic, ship_names
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_state import STRONGER_QOS, NetworkState, ObservedTopic
from ship_bringup.security.demand import DOMAIN, KEYSTORE, LAST_DOMAIN, security_problems
from ship_bringup.security.keystore import KeystoreUse, keystore_faults
from ship_node.health.input_record import MAX_AGE_S
from ship_watch.safety.limits import Limits
from ship_watch.topics import source_of_topic

_DOMAIN = "domain"
_DISCOVERY_RANGE, _STATIC_PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
_RANGES = "SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"
_LAST_SAFE_DOMAIN = 101
"""Highest domain whose ports are below the range that Linux assigns to any program."""

_SECURITY, _KEYSTORE, _POLICIES = "security", "keystore", "policies"

_SENSORS = "sensors"
_NOT_TIME_ORDERED = "gnss", "weather"
"""Inputs whose values are used on arrival, not in order of time."""
_OLD = "old"
_UNITS = ("years", 365.25 * 86400.0), ("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)
"""Units of ages and their lengths, s. An age is given in the largest unit of which it has at least two."""
_OVERRIDES, _RELIABLE = "qos_overrides.", "reliable"


def check_settings(environment: Mapping[str, str]) -> Iterator[CheckLine]:
    """Check the variables that define the domain and the range of discovery."""
    text = environment.get(DOMAIN, "")
    if not text:
        advice = f"export {DOMAIN}=N with a number of the ship's own, 1 to {_LAST_SAFE_DOMAIN}"
        yield CheckLine(_DOMAIN, Result.WARN, f"{DOMAIN} is not set: domain 0, the default of all ROS systems", advice)
    elif not text.isascii() or not text.isdigit() or int(text) > LAST_DOMAIN:
        expected = f"expected a number from 0 to {LAST_DOMAIN}"
        yield CheckLine(_DOMAIN, Result.FAIL, f"{DOMAIN} is '{text}': {expected}", f"export {DOMAIN}=N")
    elif int(text) > _LAST_SAFE_DOMAIN:
        found = f"{DOMAIN} is {text}: other programs of this computer may be given its ports"
        yield CheckLine(_DOMAIN, Result.WARN, found, f"use one up to {_LAST_SAFE_DOMAIN}")
    else:
        yield CheckLine(_DOMAIN, Result.OK, f"{DOMAIN} is {text}")
    reach = environment.get(_DISCOVERY_RANGE, "")
    if reach and reach not in _RANGES:
        expected = f"expected one of {', '.join(_RANGES)}"
        yield CheckLine(
            _DOMAIN, Result.FAIL, f"{_DISCOVERY_RANGE} is '{reach}': {expected}", f"export {_DISCOVERY_RANGE}=SUBNET"
        )
    elif reach == "OFF" and not environment.get(_STATIC_PEERS):
        advice = f"export {_DISCOVERY_RANGE}=SUBNET, or name the others in {_STATIC_PEERS}"
        found = f"{_DISCOVERY_RANGE} is OFF without {_STATIC_PEERS}: no other node is discovered"
        yield CheckLine(_DOMAIN, Result.FAIL, found, advice)
    else:
        yield CheckLine(_DOMAIN, Result.OK, f"range of discovery: {reach or 'SUBNET'}")


def check_domain(state: NetworkState, own: Collection[str], companions: Collection[str] = ()) -> Iterator[CheckLine]:
    """Check the nodes in the domain.

    Args:
        state: observed state of the network.
        own: full names of the suite's nodes, which are not started yet.
        companions: full names of ``nmea_in`` and ``nmea_out`` if the suite file has them; a user may have started them
            by hand so that the instruments can be checked.
    """
    if state.failure:
        yield CheckLine(_DOMAIN, Result.NOT_CHECKED, state.failure)
        return
    running = sorted(set(own) & set(state.nodes))
    if running:
        found = f"{', '.join(running)} is running already"
        yield CheckLine(_DOMAIN, Result.FAIL, found, "end that suite first: two nodes must not have the same name")
    by_hand = sorted(set(companions) & set(state.nodes))
    if by_hand:
        advice = "end it before the suite is started: the suite starts its own, which use the same ports and devices"
        yield CheckLine(_DOMAIN, Result.WARN, f"{', '.join(by_hand)} is running already", advice)
    others = {node for names in state.already_published.values() for node in names} - set(own)
    for topic in sorted(topic for topic, names in state.already_published.items() if others & set(names)):
        names = ", ".join(sorted(set(state.already_published[topic]) - set(own)))
        found = f"{topic}, an output of the suite, is published by {names}"
        yield CheckLine(_DOMAIN, Result.FAIL, found, "end it, or use another domain or --namespace for the suite")
    if state.has_clock:
        advice = "end the player of the bag, or use another domain"
        yield CheckLine(_DOMAIN, Result.WARN, "/clock is published, as by the player of a bag", advice)
    for name, count in Counter(state.nodes).items():
        if count > 1:
            yield CheckLine(_DOMAIN, Result.WARN, f"{count} nodes are called {name}", "give each node a different name")
    drivers = {publisher.node for topic in state.inputs for publisher in topic.publishers}
    unknown_nodes = sorted(set(state.nodes) - drivers - set(own) - set(companions) - others)
    if unknown_nodes:
        advice = "if they are not the ship's: another domain, or DDS security"
        yield CheckLine(_DOMAIN, Result.WARN, f"not part of the suite: {', '.join(unknown_nodes)}", advice)
    found = f"{state.rmw}; sensors: {', '.join(sorted(drivers)) or 'none'}"
    yield CheckLine(_DOMAIN, Result.OK, found)


def check_security(
    environment: Mapping[str, str], has_security: bool | None, is_required: bool
) -> Iterator[CheckLine]:
    """Check that DDS security is available and enforced.

    The result without security is FAIL if the ship's limits or the environment demand security, else WARN.

    Args:
        environment: environment of the process.
        has_security: True if DDS was built with security; None if unknown.
        is_required: True if the ship's limits demand security (machine.require_security).
    """
    found = security_problems(environment, has_security)
    if not found:
        yield CheckLine(_SECURITY, Result.OK, "available in DDS, and enforced by the environment")
    elif is_required or is_security_requested(environment):
        demand = "machine.require_security" if is_required else ENABLE
        for text, advice in found:
            yield CheckLine(_SECURITY, Result.FAIL, f"{demand} demands it, and {text}", advice)
    else:
        text = "off: any computer on the network can read and publish all topics"
        advice = "not demanded here; to use it: docs/how-to/security.md"
        yield CheckLine(_SECURITY, Result.WARN, text, advice)


def check_keystore(keystore: str, use: KeystoreUse, is_required: bool) -> Iterator[CheckLine]:
    """Check the keystore and the policies in it.

    Args:
        keystore: folder of the keystore; empty if the environment names no keystore.
        use: requirements of the suite on the keystore.
        is_required: True if the ship's limits or the environment demand security. A check that cannot be made is then a
            FAIL, otherwise NOT_CHECKED.
    """
    unchecked = Result.FAIL if is_required else Result.NOT_CHECKED
    if not keystore:
        yield CheckLine(_KEYSTORE, unchecked, f"{KEYSTORE} is not set")
        return
    try:
        faults = keystore_faults(Path(keystore), use)
    except LookupError:
        yield CheckLine(_KEYSTORE, unchecked, "no program openssl, which checks signatures", "sudo apt install openssl")
        return
    for fault in faults:
        result = Result.FAIL if fault.is_error else Result.WARN
        yield CheckLine(_POLICIES if fault.of_policy else _KEYSTORE, result, fault.text, fault.advice)
    enclaves = sum(1 for rights in use.rights if (Path(keystore) / "enclaves" / rights.enclave.lstrip("/")).is_dir())
    if not any(fault.is_error and not fault.of_policy for fault in faults):
        found = f"{keystore}: {enclaves} enclaves of this suite, signed by its authority"
        yield CheckLine(_KEYSTORE, Result.OK, found)
    if enclaves and not any(fault.of_policy for fault in faults):
        yield CheckLine(_POLICIES, Result.OK, "they allow what the code declares and no more")


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
        hint = "correct the failures in the other rows, then run preflight again"
        yield CheckLine(_SENSORS, Result.FAIL, found, hint)
        return
    for observed in state.inputs:
        if not observed.publishers and observed.input.topic in own:
            found = f"{observed.input.topic}: no publisher yet: the suite starts nmea_in, which may publish it"
            # Without a publisher, a configured instrument may be switched off, so this is a failure too.
            is_needed = observed.input.required or observed.input.is_configured
            advice = f"start {own_command} and run preflight again; end nmea_in before you start the suite"
            yield CheckLine(_SENSORS, Result.FAIL if is_needed else Result.NOT_CHECKED, found, advice)
            continue
        result, found, advice = _evaluate_input(observed, limits, lags_s, requested_qos.get(observed.input.topic, {}))
        if result is Result.FAIL and state.has_clock and found.endswith(_OLD):
            advice = "a bag is being played, as /clock shows: end its player"
        yield CheckLine(_SENSORS, result, f"{observed.input.topic}: {found}", advice)


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
        advice = "switch the device on; for a slow device use a longer --listen"
        return missing_result, f"{publishers} publishes it, but no message arrived", advice
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
        advice = "end all publishers of this topic but one"
        return Result.WARN, f"{found}: {len(observed.publishers)} publishers", advice
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

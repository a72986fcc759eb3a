"""Whether every sensor of the suite file is heard: with its type, at its rate, stamped by a clock like ours."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from ship_bags.parameter_yaml import full_name, read_sections
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_look import HeardTopic, NetworkState
from ship_node.edge.input_record import MAX_AGE_S
from ship_watch.limits import Limits
from ship_watch.topics import source_of_topic

_CHECK = "sensors"
_NOT_IN_THE_LOG = "gnss", "weather"
"""Their values are taken as they come: nothing is applied at their time."""
_OVERRIDES = "qos_overrides."


def wants_reliable(path: Path, topics: Iterable[str], namespace: str) -> frozenset[str]:
    """Relative names of the topics that the suite file has a node subscribe to reliably.

    Args:
        path: the suite file.
        topics: relative names of inputs.
        namespace: of the suite.
    """
    keys = {f"{_OVERRIDES}{full_name(topic, namespace)}.subscription.reliability": topic for topic in topics}
    given = (item for section in read_sections(path)[1] for item in section.parameters.items())
    return frozenset(keys[key] for key, (value, _) in given if key in keys and value == "reliable")


def judge_sensors(
    state: NetworkState, limits: Limits, lags_s: Mapping[str, float], reliable: frozenset[str]
) -> Iterator[CheckLine]:
    """Rows of all inputs.

    Args:
        state: what was heard.
        limits: of the ship; ``inputs.<id>.rate_hz`` says what rate is expected.
        lags_s: relative topic → age beyond which a node no longer applies a message, s.
        reliable: see :func:`wants_reliable`.
    """
    if state.failure:
        # A suite whose sensors nobody has heard is not ready, whatever the reason.
        found = f"nothing could be heard: {state.failure}"
        yield CheckLine(_CHECK, Result.FAIL, found, "set right what the other rows tell, then again")
        return
    for heard in state.heard:
        result, found, advice = _judged(heard, limits, lags_s, heard.input.topic in reliable)
        yield CheckLine(_CHECK, result, f"{heard.input.topic}: {found}", advice)


def _judged(
    heard: HeardTopic, limits: Limits, lags_s: Mapping[str, float], is_reliable_wanted: bool
) -> tuple[Result, str, str]:
    topic = heard.input.topic
    needed = Result.FAIL if heard.input.required or heard.input.named else Result.WARN
    if not heard.publishers:
        return needed, "nobody publishes it", "start its driver, or remap its topic to this name"
    of_type = [each for each in heard.publishers if each.type_name == heard.input.type_name]
    who = ", ".join(sorted({each.node for each in heard.publishers}))
    if not of_type:
        other = heard.publishers[0].type_name
        return Result.FAIL, f"{who} publishes {other}, expected {heard.input.type_name}", "change the driver or remap"
    if is_reliable_wanted and not all(each.is_reliable for each in of_type):
        found = f"{who} offers best effort, and the suite file asks for reliable: nothing will come"
        return Result.FAIL, found, "let the driver publish reliably, or take qos_overrides out"
    if not heard.count:
        return needed, f"{who} publishes it, and no message came", "is the device on? for slow ones: a longer --listen"
    found = f"{heard.rate_hz:.3g} Hz from {who}"
    least_hz = limits.of_input(source_of_topic(topic)).rate_hz
    if not heard.rate_hz >= least_hz:
        return Result.FAIL, f"{found}: expected {least_hz:g} Hz at least", "look at the device and the network"
    if heard.age_s is not None:
        found += f", stamps {_age_words(heard.age_s)}"
        if not -limits.machine.clock_offset_s <= heard.age_s <= MAX_AGE_S:
            return Result.FAIL, found, "set the clock of the device, or of this computer: nodes will refuse them"
        if source_of_topic(topic) not in _NOT_IN_THE_LOG and not heard.age_s <= lags_s.get(topic, MAX_AGE_S):
            return Result.FAIL, f"{found}: later than lag_s", "look at delays on the way, or raise lag_s"
    if len(heard.publishers) > 1:
        return Result.WARN, f"{found}: {len(heard.publishers)} publishers", "one device, one publisher: end the others"
    return Result.OK, found, ""


def _age_words(age_s: float) -> str:
    return f"{abs(age_s):.3f} s {'in the future' if age_s < 0.0 else 'old'}"

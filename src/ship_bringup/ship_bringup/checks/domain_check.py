"""Check of the ROS domain in which the suite will run: the settings of the domain, and the nodes already in it."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping

from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.checks.network_state import NetworkState
from ship_bringup.security.demand import DOMAIN, LAST_DOMAIN

_CHECK = "domain"
_DISCOVERY_RANGE, _STATIC_PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
_RANGES = "SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"
_LAST_SAFE_DOMAIN = 101
"""Highest domain whose ports are below the range that Linux assigns to any program."""


def check_settings(environment: Mapping[str, str]) -> Iterator[CheckLine]:
    """Check the variables that define the domain and the range of discovery."""
    text = environment.get(DOMAIN, "")
    if not text:
        advice = f"export {DOMAIN}=N with a number of the ship's own, 1 to {_LAST_SAFE_DOMAIN}"
        yield CheckLine(_CHECK, Result.WARN, f"{DOMAIN} is not set: domain 0, the default of all ROS systems", advice)
    elif not text.isascii() or not text.isdigit() or int(text) > LAST_DOMAIN:
        expected = f"expected a number from 0 to {LAST_DOMAIN}"
        yield CheckLine(_CHECK, Result.FAIL, f"{DOMAIN} is '{text}': {expected}", f"export {DOMAIN}=N")
    elif int(text) > _LAST_SAFE_DOMAIN:
        found = f"{DOMAIN} is {text}: other programs of this computer may be given its ports"
        yield CheckLine(_CHECK, Result.WARN, found, f"use one up to {_LAST_SAFE_DOMAIN}")
    else:
        yield CheckLine(_CHECK, Result.OK, f"{DOMAIN} is {text}")
    reach = environment.get(_DISCOVERY_RANGE, "")
    if reach and reach not in _RANGES:
        expected = f"expected one of {', '.join(_RANGES)}"
        yield CheckLine(
            _CHECK, Result.FAIL, f"{_DISCOVERY_RANGE} is '{reach}': {expected}", f"export {_DISCOVERY_RANGE}=SUBNET"
        )
    elif reach == "OFF" and not environment.get(_STATIC_PEERS):
        advice = f"export {_DISCOVERY_RANGE}=SUBNET, or name the others in {_STATIC_PEERS}"
        yield CheckLine(
            _CHECK,
            Result.FAIL,
            f"{_DISCOVERY_RANGE} is OFF without {_STATIC_PEERS}: no other node is discovered",
            advice,
        )
    else:
        yield CheckLine(_CHECK, Result.OK, f"range of discovery: {reach or 'SUBNET'}")


def check_domain(state: NetworkState, own: Collection[str], companions: Collection[str] = ()) -> Iterator[CheckLine]:
    """Check the nodes in the domain.

    Args:
        state: observed state of the network.
        own: full names of the suite's nodes, which are not started yet.
        companions: full names of ``nmea_in`` and ``nmea_out`` if the suite file has them; a user may have started them
            by hand so that the instruments can be checked.
    """
    if state.failure:
        yield CheckLine(_CHECK, Result.NOT_CHECKED, state.failure)
        return
    running = sorted(set(own) & set(state.nodes))
    if running:
        found = f"{', '.join(running)} is running already"
        yield CheckLine(_CHECK, Result.FAIL, found, "end that suite first: two nodes must not have the same name")
    by_hand = sorted(set(companions) & set(state.nodes))
    if by_hand:
        advice = "end it before the suite is started: the suite starts its own, which use the same ports and devices"
        yield CheckLine(_CHECK, Result.WARN, f"{', '.join(by_hand)} is running already", advice)
    others = {node for names in state.already_published.values() for node in names} - set(own)
    for topic in sorted(topic for topic, names in state.already_published.items() if others & set(names)):
        names = ", ".join(sorted(set(state.already_published[topic]) - set(own)))
        found = f"{topic}, an output of the suite, is published by {names}"
        yield CheckLine(_CHECK, Result.FAIL, found, "end it, or use another domain or --namespace for the suite")
    if state.has_clock:
        advice = "end the player of the bag, or use another domain"
        yield CheckLine(_CHECK, Result.WARN, "/clock is published, as by the player of a bag", advice)
    for name, count in Counter(state.nodes).items():
        if count > 1:
            yield CheckLine(_CHECK, Result.WARN, f"{count} nodes are called {name}", "give each node a different name")
    drivers = {publisher.node for topic in state.inputs for publisher in topic.publishers}
    unknown_nodes = sorted(set(state.nodes) - drivers - set(own) - set(companions) - others)
    if unknown_nodes:
        advice = "if they are not the ship's: another domain, or DDS security"
        yield CheckLine(_CHECK, Result.WARN, f"not part of the suite: {', '.join(unknown_nodes)}", advice)
    found = f"{state.rmw}; sensors: {', '.join(sorted(drivers)) or 'none'}"
    yield CheckLine(_CHECK, Result.OK, found)

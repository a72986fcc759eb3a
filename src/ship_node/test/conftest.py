"""Nodes of these tests meet only each other: this machine, a domain of their own."""

import os
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the domains that Linux has ports for, one that two test runs on a machine hardly share."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))


@pytest.fixture
def live_relay(own_domain: None) -> Iterator[object]:
    """Starts relay nodes in this process; see :class:`ship_testing.live_relay.LiveRelay`."""
    from ship_testing.live_relay import LiveRelay

    started: list[LiveRelay] = []

    def start(*ros_arguments: str) -> LiveRelay:
        started.append(LiveRelay(*ros_arguments))
        return started[-1]

    yield start
    for relay in started:
        relay.close()

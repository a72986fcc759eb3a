"""Nodes of these tests meet only each other: this machine, a domain of their own."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the domains that Linux has ports for, one that two test runs on a machine hardly share."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))


@pytest.fixture
def live_relay(own_domain: None) -> Iterator[object]:
    """Starts relay nodes in this process; see :class:`live_relay.LiveRelay`."""
    from live_relay import LiveRelay

    started: list[LiveRelay] = []

    def start(*ros_arguments: str) -> LiveRelay:
        started.append(LiveRelay(*ros_arguments))
        return started[-1]

    yield start
    for relay in started:
        relay.close()

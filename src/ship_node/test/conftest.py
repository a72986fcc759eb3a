"""Fixtures: the nodes of these tests use only this computer and a ROS domain of their own."""

from collections.abc import Iterator

import pytest

from ship_testing.trials.live_process import free_domain_id


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))


@pytest.fixture
def live_relay(own_domain: None) -> Iterator[object]:
    """Return a function that starts relay nodes in this process; see :class:`ship_testing.live_relay.LiveRelay`."""
    from ship_testing.live_relay import LiveRelay

    started: list[LiveRelay] = []

    def start(*ros_arguments: str) -> LiveRelay:
        started.append(LiveRelay(*ros_arguments))
        return started[-1]

    yield start
    for relay in started:
        relay.close()

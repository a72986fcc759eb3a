"""Fixtures of packages whose tests start nodes, which meet only each other: this machine, a domain of their own."""

import time

import pytest

from ship_replay.trials.live_process import free_domain_id


@pytest.fixture(autouse=True)
def own_domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))


@pytest.fixture
def until():
    """Calls a function until what it returns is true, and returns that."""

    def wait(look, limit_s=20.0):
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s:
            found = look()
            if found:
                return found
            time.sleep(0.02)
        raise AssertionError(f"not within {limit_s} s")

    return wait

"""Fixtures of packages whose tests start nodes: discovery only on this machine and in a separate domain."""

import time

import pytest

from ship_testing.trials.live_process import free_domain_id


@pytest.fixture(autouse=True)
def own_domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))


@pytest.fixture
def until():
    """Return a function that repeats a call until its result is true, and returns the result."""

    def wait(condition, limit_s=20.0):
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s:
            found = condition()
            if found:
                return found
            time.sleep(0.02)
        raise AssertionError(f"not within {limit_s} s")

    return wait

"""Nodes of these tests meet only each other: this machine, a domain of their own."""

import os
import time

import pytest


@pytest.fixture(autouse=True)
def own_domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))


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

"""Which tests run on one worker, where several run at once (``make test``).

Tests of one file share what they make: bags, runs, browsers. So a file runs on one worker. Tests over DDS wait for most
of their time, so there are more workers than cores; but not more than two such tests at once, on two workers of their
own, since what they start must answer in time. They come first: together they take as long as all others. What only
computes yields to them.
"""

import os

import pytest

LIVE_AT_ONCE = 2
YIELDING = 10
"""Added to the niceness of workers that compute: where both want a core, live tests get nine tenths of it."""
_YIELDS = pytest.StashKey[bool]()


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each test the group of its file; live tests those of their worker, the files in turn."""
    files: dict[str, int] = {}
    for item in items:
        file = item.nodeid.partition("::")[0]
        is_live = item.get_closest_marker("live") is not None
        group = f"live_{files.setdefault(file, len(files)) % LIVE_AT_ONCE}" if is_live else file
        item.add_marker(pytest.mark.xdist_group(group))
    items.sort(key=lambda item: item.get_closest_marker("live") is None)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let a worker, and what it starts, yield from its first test on that is not live: no live one comes after it."""
    yields = item.config.stash.get(_YIELDS, False) or item.get_closest_marker("live") is not None
    if hasattr(item.config, "workerinput") and not yields:
        item.config.stash[_YIELDS] = True
        os.nice(YIELDING)

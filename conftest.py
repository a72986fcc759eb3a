"""Distribution of the tests over workers, where several run at once (``make test``).

The tests of one file share their bags, runs and browsers, so a file runs on one worker. Live tests, over DDS, wait for
most of their time, so there are more workers than cores. Only one live test runs at a time, on a worker of its own,
because the programs of two suites overload two cores and would answer too late. The live tests come first, because
together they take nearly as long as all others. Tests that only compute run at a lower priority.
"""

import os
import sys
from pathlib import Path

import pytest

LIVE = "live"
"""Group of the live tests."""
YIELDING = 10
"""Increment of the niceness of workers that compute.

If such a worker and a live test compete for a core, the live test gets nine tenths of the processor time.
"""
_YIELDS = pytest.StashKey[bool]()

# colcon test starts ``python -m pytest`` in the folder of a package. If colcon built the package elsewhere, the modules
# in this folder are not compiled. This folder is then removed from the path, and the installed modules are tested.
_COMPILED = Path.cwd().glob(f"{Path.cwd().name}/**/compiled_*.py")
if not all(any(path.parent.glob(f"{path.stem}.*.so")) for path in _COMPILED):
    sys.path[:] = [path for path in sys.path if path not in ("", os.getcwd())]


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Assign each test to the group of its file, and all live tests to one group; sort the live tests to the front."""
    for item in items:
        is_live = item.get_closest_marker("live") is not None
        group = LIVE if is_live else item.nodeid.partition("::")[0]
        item.add_marker(pytest.mark.xdist_group(group))
    items.sort(key=lambda item: item.get_closest_marker("live") is None)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Increase the niceness of a worker, and of the processes that it starts, before its first test that is not live.

    No live test follows on that worker, because live tests come first.
    """
    yields = item.config.stash.get(_YIELDS, False) or item.get_closest_marker("live") is not None
    if hasattr(item.config, "workerinput") and not yields:
        item.config.stash[_YIELDS] = True
        os.nice(YIELDING)

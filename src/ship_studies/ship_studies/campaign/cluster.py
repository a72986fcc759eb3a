"""Run of items by the workers of a Dask cluster. Only this module imports the optional dask.distributed."""

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from ship_bags.errors import BadInput
from ship_studies.campaign.items import Item
from ship_studies.campaign.one_item import Result, failed_result
from ship_studies.campaign.processes import Make

_ONE_AT_A_TIME = threading.Lock()
"""Lock by which a worker runs one item at a time; parallel threads of one interpreter would not be faster."""


def run_in_cluster(make: Make, items: Sequence[Item], address: str) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result on completion; the cluster repeats the items of a worker that died.

    Args:
        make: function that runs an item in an empty folder; the workers import its module.
        items: items whose files have the same paths on the machines of the workers as here.
        address: address of the scheduler, tcp://host:port.

    Raises:
        BadInput: dask.distributed is not installed.
        OSError: no scheduler answers at the address.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as problem:
        raise BadInput("--scheduler needs dask.distributed: install it with pip install distributed") from problem
    with Client(address) as client:
        futures = {client.submit(_run_item, make, item, pure=False): item for item in items}
        try:
            for future in as_completed(list(futures)):
                error = future.exception()
                yield futures.pop(future), failed_result(str(error)) if error is not None else future.result()
        finally:
            client.cancel(list(futures))


def _run_item(make: Make, item: Item) -> Result:
    with _ONE_AT_A_TIME, TemporaryDirectory(prefix="campaign-") as folder:
        return make(item, Path(folder))

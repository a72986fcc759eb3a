"""Cost of the live page for the displayed estimator: processor time and latency, with and without open pages.

The same bag is played through the live node without a monitor, with a monitor without pages, and with three open pages.
An open page is simulated as a websocket session that receives every update. Drawing, on the computer of
the browser, is not measured.
"""

import asyncio
import contextlib
import re
import struct
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import websocket_connect

from bench_rows import Row, process_cpu_s
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.live.installed_types import installed_class
from ship_testing.trials.live_process import LiveProcess
from ship_testing.trials.live_run import LiveFailure, LiveRun, executable

BAG = Path(__file__).resolve().parents[1] / "bags" / "demo.mcap"
RATE = 3.0
"""Seconds of the bag per second. The 20 INS samples per second are played at 60 Hz, and the node must keep up."""
ROUNDS = 3
PAGES = 3
MAX_WITH_PAGES = 1.1
MAX_WITH_MONITOR = 1.25
MAX_CORE_SHARE = 0.15
_PAGE_PORT = 5061
_START_S = 30.0
_SAMPLE, _ATTITUDE = "ins/imu", "ship/attitude"
_TYPES = {_SAMPLE: "sensor_msgs/msg/Imu", _ATTITUDE: "ship_msgs/msg/ShipAttitude"}


@dataclass
class Cost:
    """Measurements of all runs of one kind.

    Attributes:
        node_s: processor time of the node over the bag, s, one value per run.
        latency_s: median time from publication of a sample to publication of its attitude, s, one value per run.
        monitor: processor time of the monitor divided by elapsed time, one value per run.
    """

    node_s: list[float] = field(default_factory=list)
    latency_s: list[float] = field(default_factory=list)
    monitor: list[float] = field(default_factory=list)


def monitor_cost() -> list[Row]:
    """Measure the node alone, with a monitor without pages, and with three open pages, alternately."""
    alone, watched, looked_at = Cost(), Cost(), Cost()
    with tempfile.TemporaryDirectory() as name:
        for number in range(ROUNDS):
            for cost, pages in ((alone, None), (watched, 0), (looked_at, PAGES)):
                folder = Path(name) / f"{number}_{pages}"
                _add_run(cost, folder, pages)
    return [
        Row("node over the demo bag, no monitor, processor time", min(alone.node_s), "s"),
        Row("its latency: median", 1e3 * min(alone.latency_s), "ms"),
        Row("ratio: processor time with a monitor", min(watched.node_s) / min(alone.node_s), "x"),
        *_rows("three pages / no page", looked_at, watched, MAX_WITH_PAGES),
        *_rows("three pages / no monitor", looked_at, alone, MAX_WITH_MONITOR),
        Row("monitor with three pages, of a core", min(looked_at.monitor), "x", MAX_CORE_SHARE),
    ]


def _rows(what: str, one: Cost, other: Cost, most: float) -> list[Row]:
    # The minimum is used, because other load of the machine only increases the times.
    return [
        Row(f"ratio: node's processor time, {what}", min(one.node_s) / min(other.node_s), "x", most),
        Row(f"ratio: latency, {what}", min(one.latency_s) / min(other.latency_s), "x", most),
    ]


def _add_run(cost: Cost, folder: Path, pages: int | None) -> None:
    """Play the bag once; None as ``pages`` means without a monitor."""
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", folder) as run, contextlib.ExitStack() as stack:
        published = _publication_times(run)
        monitor = stack.enter_context(_monitor(run, folder)) if pages is not None else None
        if pages:
            stack.enter_context(_open_pages(pages))
        begin_s, node_s = time.monotonic(), process_cpu_s(run.node.pid)
        monitor_s = process_cpu_s(monitor.pid) if monitor else 0.0
        run.play(RATE, report_elapsed=lambda _: _serve(run, 0.1))
        _serve(run, 1.0)
        cost.node_s.append(process_cpu_s(run.node.pid) - node_s)
        if monitor:
            cost.monitor.append((process_cpu_s(monitor.pid) - monitor_s) / (time.monotonic() - begin_s))
    sample, attitude = published[_SAMPLE], published[_ATTITUDE]
    stamps = sorted(sample.keys() & attitude.keys())
    if not stamps:
        raise LiveFailure("no attitude with the stamp of an INS sample was received")
    cost.latency_s.append(1e-9 * float(np.median([attitude[stamp] - sample[stamp] for stamp in stamps])))


def _serve(run: LiveRun, duration_s: float) -> None:
    run.observer.spin_until(lambda: False, duration_s)


def _publication_times(run: LiveRun) -> dict[str, dict[tuple[int, int], int]]:
    """Return topic → stamp → time of publication by DDS, ns, which does not depend on the time of reading."""
    published: dict[str, dict[tuple[int, int], int]] = {topic: {} for topic in _TYPES}
    for topic, type_name in _TYPES.items():

        def take(data: bytes, info: dict[str, Any], times: dict[tuple[int, int], int] = published[topic]) -> None:
            times[struct.unpack_from("<iI", data, 4)] = info["source_timestamp"]

        kind = installed_class(type_name)
        qos = QoSProfile(depth=4_000, reliability=ReliabilityPolicy.BEST_EFFORT)
        run.observer.node.create_subscription(kind, topic, take, qos, raw=True)
    return published


@contextlib.contextmanager
def _monitor(run: LiveRun, folder: Path) -> Iterator[LiveProcess]:
    command = [*executable("ship_monitor", "monitor"), "--port", str(_PAGE_PORT)]
    with LiveProcess(command, folder / "monitor.log", run.environment) as monitor:
        deadline_s = time.monotonic() + _START_S
        while "http://" not in monitor.log_text():
            if monitor.exit_code is not None or time.monotonic() > deadline_s:
                raise LiveFailure(f"the monitor did not start; its log:\n{monitor.log_text()}")
            time.sleep(0.1)
        yield monitor


@contextlib.contextmanager
def _open_pages(count: int) -> Iterator[None]:
    """Open pages as a browser does: request each page and receive its updates, in one thread for all pages."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    pages = [asyncio.run_coroutine_threadsafe(_keep_page_open(), loop) for _ in range(count)]
    try:
        yield
        if ended := [page.exception() for page in pages if page.done()]:
            raise LiveFailure(f"a page lost the connection to its server: {ended[0]}")
    finally:
        for page in pages:
            page.cancel()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


async def _keep_page_open() -> None:
    """Receive all updates of a new session; raise LiveFailure if the server ends the session."""
    answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{_PAGE_PORT}/")
    token = re.search(r'"token":"([^"]+)"', answer.body.decode())
    if token is None:
        raise LiveFailure("the page has no session token")
    url = f"ws://127.0.0.1:{_PAGE_PORT}/ws"
    connection = await websocket_connect(url, subprotocols=["bokeh", token.group(1)])
    updates = 0
    while await connection.read_message() is not None:
        updates += 1
    raise LiveFailure(f"the session ended after {updates} messages")

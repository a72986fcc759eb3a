"""``make watch``: the voyage is simulated, played live and shown; Ctrl-C ends it; a port in use is an error."""

import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from ship_testing.trials.live_process import LiveProcess, free_domain_id, live_environment

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[1]
START_S = 120.0


def run_watch(port):
    return [sys.executable, str(ROOT / "tools" / "watch.py"), "--port", str(port)]


@pytest.mark.smoke
def test_the_page_of_the_voyage_is_served_and_all_ends_with_ctrl_c(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = live_environment(free_domain_id(), tmp_path)
    with LiveProcess(run_watch(port), tmp_path / "watch.log", environment) as process:
        address, deadline_s = f"http://127.0.0.1:{port}/", time.monotonic() + START_S
        # The address is printed at the start, and again by the page, which may be later than the outputs.
        while process.log_text().count(address) < 2 or not all(
            words in process.log_text() for words in ("attitude: VALID", "pointing: VALID")
        ):
            assert process.exit_code is None, process.log_text()
            assert time.monotonic() < deadline_s, process.log_text()
            time.sleep(0.2)
        with urllib.request.urlopen(address, timeout=20.0) as page:
            assert page.status == 200
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        assert len(children) == 6  # three nodes, the alert node, the page and the player
        assert process.end() == 0, process.log_text()
    assert not [child for child in children if Path(f"/proc/{child}").exists()]


def test_a_port_in_use_is_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        ended = subprocess.run(run_watch(port), capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    expected = f"watch: port {port} of 127.0.0.1: Address already in use: use another, make watch PORT={port + 1}\n"
    assert ended.stderr == expected

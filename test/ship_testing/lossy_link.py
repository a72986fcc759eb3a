"""Two ends of a link with packet loss and interruptions, as network namespaces of this machine: for tests as root."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from signal import SIGUSR1, SIGUSR2
from types import TracebackType

from ship_bringup.suite.process import UDP_ONLY
from ship_testing.trials.live_process import LiveProcess, live_environment

NETEM = Path(__file__).parents[3] / "shared" / "tools" / "netem.py"
"""Connects the namespaces relA and relB by two TAP devices, and drops some of the UDP packets between them."""

NEAR, FAR = "relA", "relB"

_REALTIME_PRIORITY = "chrt", "--rr", "1"
"""Prefix of a command: real-time priority, if that is permitted."""
_START_S = 15.0
_LONGEST_S = 600
# netem.py finds its namespaces below /run/netns. With a private /run, two links do not meet and no namespace is left.
_PRIVATE_RUN = 'mount -t tmpfs tmpfs /run && mkdir /run/netns && exec "$@"'
# The loss is a variable of netem.py, which is read for each packet.
_SWITCHABLE_LOSS = f"""
import signal, sys
sys.argv = sys.argv[1:]
names, loss = {{"__name__": "netem"}}, float(sys.argv[1])
signal.signal({SIGUSR1.value}, lambda *_: names.update(loss=1.0))
signal.signal({SIGUSR2.value}, lambda *_: names.update(loss=loss))
exec(compile(open(sys.argv[0]).read(), sys.argv[0], "exec"), names)
"""


def unavailability_reason() -> str:
    """Return the reason why this machine cannot create such a link; empty if it can."""
    if not NETEM.is_file():
        return f"there is no {NETEM.name} next to this repository"
    if os.geteuid() != 0 or subprocess.run(["unshare", "--net", "--mount", "true"], check=False).returncode:
        return "only root may make network namespaces"
    if shutil.which("ip") is None or not Path("/dev/net/tun").exists():
        return "there is no 'ip' or no TUN device"
    return ""


class LossyLink:
    """The link and the programs at its ends; for a ``with`` statement, at whose end all of it is removed.

    Args:
        loss: share of lost packets, independent of each other.
        folder: folder of the logs.
    """

    def __init__(self, loss: float, folder: Path) -> None:
        self._folder = folder
        # Shared memory would bypass the link.
        self._environment = live_environment(1, folder / "ros") | UDP_ONLY
        self._has_realtime_priority = bool(shutil.which("chrt")) and not subprocess.run(
            [*_REALTIME_PRIORITY, "true"], stderr=subprocess.DEVNULL, check=False
        ).returncode
        self._environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
        script = [sys.executable, "-c", _SWITCHABLE_LOSS, str(NETEM), str(loss), "0", "0", "0", str(_LONGEST_S)]
        self._running = ExitStack()
        self._relay = self._start(["unshare", "--mount", "sh", "-c", _PRIVATE_RUN, "sh", *script], "link")

    def start(self, end: str, name: str, command: Sequence[str]) -> LiveProcess:
        """Run a program at one end."""
        place = f"--net=/proc/{self._relay.pid}/root/run/netns/{end}"
        return self._start(["nsenter", place, *command], name)

    def interrupt(self) -> int:
        """Drop all packets from now on; return the time, ns."""
        os.kill(self._relay.pid, SIGUSR1)
        return time.time_ns()

    def restore(self) -> int:
        """Transmit packets again; return the time, ns."""
        os.kill(self._relay.pid, SIGUSR2)
        return time.time_ns()

    def _start(self, command: Sequence[str], name: str) -> LiveProcess:
        # The link must not depend on other load of this machine: its processes have priority.
        urgent = [*(_REALTIME_PRIORITY if self._has_realtime_priority else ()), *command]
        return self._running.enter_context(LiveProcess(urgent, self._folder / f"{name}.log", self._environment))

    def __enter__(self) -> "LossyLink":
        deadline_s = time.monotonic() + _START_S
        while "ready" not in self._relay.log_text():
            if self._relay.exit_code is not None or time.monotonic() > deadline_s:
                self._running.close()
                raise OSError(f"no link: {self._relay.log_text()}")
            time.sleep(0.02)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._running.close()

"""The terminal view as an executable in a real terminal (tmux), while a ship publishes."""

import os
import shutil
import subprocess
import sys
import time

import pytest

from ship_bags.stamps import NS_PER_S
from ship_testing.publishing_ship import SuitePublisher, attitude

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed"),
]

START_NS = 1_777_636_807 * NS_PER_S
COMMAND = "import sys; from ship_monitor.commands.monitor_terminal import main; sys.exit(main())"


class Terminal:
    """A terminal of 80 by 24 with the view."""

    def __init__(self, *arguments, language="C.UTF-8"):
        view = f'{sys.executable} -c "{COMMAND}" {" ".join(arguments)}; echo EXIT CODE $?; exec sleep 60'
        start = ("new-session", "-d", "-x", "80", "-y", "24", f"LANG={language} LC_ALL={language} {view}")
        # On a busy machine the server of tmux sometimes ends at its start. Each attempt has its own socket.
        for attempt in range(3):
            self._tmux = ["tmux", "-L", f"ship_monitor_{os.getpid()}_{id(self)}_{attempt}", "-f", os.devnull]
            started = subprocess.run([*self._tmux, *start], check=False, capture_output=True, text=True)
            if started.returncode == 0:
                break
        assert started.returncode == 0, f"tmux: {started.stderr.strip()}"
        self._call("set", "-g", "status", "off")

    def _call(self, *arguments):
        done = subprocess.run([*self._tmux, *arguments], check=False, capture_output=True, text=True)
        assert done.returncode == 0, f"tmux {arguments[0]}: {done.stderr.strip()}"
        return done.stdout

    def press(self, key):
        self._call("send-keys", key)

    def rows(self):
        return self._call("capture-pane", "-p").splitlines()

    def close(self):
        self._call("kill-server")


@pytest.fixture(params=[pytest.param("C.UTF-8", marks=pytest.mark.smoke), "C"])
def terminal(request):
    terminal = Terminal("--namespace", "demo", language=request.param)
    yield terminal
    terminal.close()


def test_live_terminal_view(terminal, until):
    until(lambda: any("waiting for ship/attitude: namespace /demo, domain" in row for row in terminal.rows()))
    for start_ns in (START_NS, START_NS + 600 * NS_PER_S):
        ship, times = SuitePublisher(), iter(range(start_ns, start_ns + 600 * NS_PER_S, NS_PER_S // 50))

        def is_current(ship=ship, times=times):
            for _ in range(10):
                ship.publish("ship/attitude", attitude(next(times)))
                time.sleep(0.02)
            return any(row.startswith(" HEADING") and "057.30" in row and "OLD" not in row for row in terminal.rows())

        until(is_current)  # a heading of 1 rad
        ship.stop()
        until(lambda: any(row.startswith(" HEADING") and "OLD" in row and "UNSAFE" in row for row in terminal.rows()))
    terminal.press("q")
    until(lambda: "EXIT CODE 0" in terminal.rows())


def test_missing_terminal_is_reported():
    command = [sys.executable, "-c", COMMAND]
    done = subprocess.run(command, check=False, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["monitor_terminal: stdin or stderr is not a terminal; over ssh use ssh -t"]

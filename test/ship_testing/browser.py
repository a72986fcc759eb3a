"""Headless Chromium, driven through its debugging socket: opens pages, evaluates scripts, takes screenshots."""

import asyncio
import base64
import contextlib
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from tornado.websocket import websocket_connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
"""None if Chromium is not installed: tests that need it are skipped."""

_OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars", "--mute-audio"),
    "--remote-debugging-port=0",
)
_START_S = 60.0


_POLL_S = 0.2
"""Period of polling, s. Shorter periods delay the drawing of the page on a busy computer."""


class _LeftPage(Exception):
    """The page was replaced, as by a reload, during a query."""


class Browser:
    """Headless browser with one window.

    Attributes:
        problems: errors of scripts, of the console and of requests since the last :meth:`open`.
        addresses: URLs requested since the last :meth:`open`.
    """

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="chromium"))
        self._log = (self._folder / "log").open("wb")
        command = [str(CHROMIUM), *_OPTIONS, f"--user-data-dir={self._folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=self._log, stderr=self._log, stdin=subprocess.DEVNULL)
        self._loop = asyncio.new_event_loop()
        self._count = 0
        self.problems: list[str] = []
        self.addresses: list[str] = []
        self._socket = self._run(self._connect())
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def open(self, address: str, width: int = 1280, height: int = 800) -> None:
        """Open a page in a window of this size, and wait until it has loaded."""
        # The previous page may still log errors, of a server that has ended, until it is unloaded.
        self.call("Page.navigate", url="about:blank")
        self.problems.clear()
        self.addresses.clear()
        mobile = width < 700
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        self.call("Page.navigate", url=address)
        self.wait_until_true("document.readyState === 'complete' && location.href !== 'about:blank'")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_until_true(self, expression: str, limit_s: float = 30.0) -> Any:
        """Return the value of an expression once it is true; a query between two pages is repeated."""
        safe_expression = f"(() => {{ try {{ return {expression} }} catch {{ return null }} }})()"

        def look() -> Any:
            with contextlib.suppress(_LeftPage):
                return self.evaluate(safe_expression)

        return self.wait(look, expression, limit_s)

    def wait(self, condition: Callable[[], Any], what: str, limit_s: float = 30.0) -> Any:
        """Return the result of a function once it is true; process messages of the browser until then."""
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s:
            if found := condition():
                return found
            time.sleep(_POLL_S)
        raise AssertionError(f"not within {limit_s} s: {what}")

    def text(self, selector: str) -> str:
        """Return the text of an element."""
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).textContent"))

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, text=key if kind == "keyDown" else "")

    def take_screenshot(self, path: Path, whole: bool = False) -> None:
        """Write a PNG of the window, or of the whole page."""
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))

    def close(self) -> None:
        """End the browser."""
        self._run(self._leave())
        self._process.terminate()
        self._process.wait(20)
        self._loop.close()
        self._log.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of a method of the protocol; record events received before the result."""
        self._count += 1
        number = self._count
        return self._run(self._call(number, {"id": number, "method": method, "params": parameters}))

    async def _leave(self) -> None:
        """Close the connection in the browser's event loop; after an earlier test the thread may have no loop."""
        self._socket.close()

    async def _call(self, number: int, request: dict[str, Any]) -> dict[str, Any]:
        await self._socket.write_message(json.dumps(request))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), 30.0)
            assert text is not None, "the browser has gone"
            message = json.loads(text)
            if message.get("id") == number:
                if "navigated" in message.get("error", {}).get("message", ""):
                    raise _LeftPage(message["error"])
                assert "error" not in message, message["error"]
                return dict(message["result"])
            self._record_event(message.get("method", ""), message.get("params", {}))

    def _record_event(self, method: str, event: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.problems.append(str(event["exceptionDetails"].get("exception", event)))
        elif method == "Log.entryAdded" and event["entry"]["level"] == "error":
            self.problems.append(f"{event['entry']['text']} {event['entry'].get('url', '')}")
        elif method == "Runtime.consoleAPICalled" and event["type"] in ("error", "assert"):
            self.problems.append(str(event["args"]))
        elif method == "Network.requestWillBeSent":
            self.addresses.append(event["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.addresses.append(event["url"])

    async def _connect(self) -> Any:
        port_file = self._folder / "DevToolsActivePort"
        deadline_s = time.monotonic() + _START_S
        while not (port_file.exists() and "\n" in port_file.read_text()):
            assert self._process.poll() is None, (self._folder / "log").read_text(errors="replace")
            assert time.monotonic() < deadline_s, "Chromium did not start"
            await asyncio.sleep(0.05)
        port = port_file.read_text().splitlines()[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        return await websocket_connect(pages[0]["webSocketDebuggerUrl"], max_message_size=100_000_000)

    def _run(self, work: Any) -> Any:
        return self._loop.run_until_complete(work)

"""The page and the Foxglove server answer or refuse requests by Host and Origin; one test uses a real browser."""

import http.client
import http.server
import threading

import pytest

from ship_monitor.web.bounded_server import OwnHosts
from ship_monitor.web.foxglove_server import FoxgloveServer
from ship_testing import browser as browser_module
from ship_testing.browser import Browser
from ship_testing.foxglove_client import PROTOCOL
from ship_testing.page_runs import run_page_server

DESKTOP = (
    "Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 lichtblick/1.28.1 Chrome/140.0 Electron/38.1 Safari/537.36"
)
BROWSER = "Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 Chrome/140.0 Safari/537.36"
FOXGLOVE = "https://app.foxglove.dev"


def answer(port, *, host, origin=None, agent="", path="/", is_socket=True):
    """Return the status of a request to 127.0.0.1."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    headers = {"Host": host.replace("PORT", str(port))}
    headers |= {} if origin is None else {"Origin": origin.replace("PORT", str(port))}
    headers |= {"User-Agent": agent} if agent else {}
    if is_socket:
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        headers |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": PROTOCOL}
    connection.request("GET", path, headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status


def port_of(server):
    return int(server.address.strip("/").rpartition(":")[2])


@pytest.fixture(scope="module")
def foxglove():
    server = FoxgloveServer("demo", "127.0.0.1", 0)
    yield port_of(server)
    server.close()


@pytest.mark.parametrize(
    ("host", "origin", "agent", "status"),
    [
        ("localhost:PORT", FOXGLOVE, "", 101),
        ("127.0.0.1:PORT", "http://localhost:8080", "", 101),
        ("localhost.:PORT", None, "", 101),
        ("localhost:PORT", "", "", 101),
        ("localhost:PORT", "file://", DESKTOP, 101),
        ("localhost:PORT", "file://", BROWSER, 403),
        ("localhost:PORT", "null", BROWSER, 403),
        ("localhost:PORT", "http://evil.example", "", 403),
        ("localhost:PORT", "http://app.foxglove.dev", "", 403),
        ("localhost:PORT", "https://app.foxglove.dev.evil.example", "", 403),
        ("localhost:PORT", "http://localhost.evil.example:PORT", "", 403),
        ("localhost:PORT", "http://[", "", 403),
        ("evil.example:PORT", "http://evil.example:PORT", "", 403),
        ("evil.example:PORT", FOXGLOVE, "", 403),
        ("evil.example:PORT", None, "", 403),
        ("192.0.2.7:PORT", None, "", 403),
    ],
)
def test_foxglove_answers_viewers_and_this_machine(foxglove, host, origin, agent, status):
    assert answer(foxglove, host=host, origin=origin, agent=agent) == status


def test_allowed_name_is_host_and_origin():
    server = FoxgloveServer("demo", "127.0.0.1", 0, ["Bridge.ship.example"])
    port = port_of(server)
    assert answer(port, host="bridge.ship.example:PORT", origin="http://bridge.ship.example:8080") == 101
    assert answer(port, host="other.ship.example:PORT") == 403
    server.close()


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("evil.example:PORT", "http://evil.example:PORT", 403),
        ("evil.example:PORT", None, 403),
        ("bridge.ship.example:PORT", "http://bridge.ship.example:PORT", 200),
        ("bridge.ship.example:PORT", "http://localhost:PORT", 403),
        ("localhost:PORT", None, 200),
        ("127.0.0.1:PORT", "http://[", 403),
    ],
)
def test_page_on_all_addresses_answers_only_its_own_names(host, origin, status):
    """A foreign name that resolves to the ship's address is refused."""
    with run_page_server(address="0.0.0.0", allowed_hosts=["bridge.ship.example"]) as page:
        assert answer(port_of(page), host=host, origin=origin, is_socket=False) == status


def test_host_name_is_allowed_beyond_loopback(monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "Bridge")
    assert {"bridge", "bridge.local", "localhost"} <= OwnHosts("0.0.0.0")._names
    assert "bridge" not in OwnHosts("127.0.0.1")._names


@pytest.fixture(scope="module")
def site():
    """Serve a foreign web site: an empty page at any name that resolves to this computer."""

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>evil</title>")

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://evil.localhost:{server.server_port}/"
        server.shutdown()


@pytest.mark.skipif(browser_module.CHROMIUM is None, reason="there is no Chromium on this machine")
def test_page_of_another_site_reads_no_topics_in_a_browser(foxglove, site):
    browser = Browser()
    attempt = (
        "new Promise((done) => {{ const link = new WebSocket('{address}', {protocols});"
        " link.onmessage = (each) => done('read ' + each.data); link.onerror = () => done('refused'); }})"
    )
    try:
        with run_page_server() as page:
            browser.open(site)
            for address, protocols in (
                (f"ws://localhost:{foxglove}/", f"['{PROTOCOL}']"),
                (f"ws://evil.localhost:{foxglove}/", f"['{PROTOCOL}']"),
                (f"ws://localhost:{port_of(page)}/ws", "['bokeh', 'token']"),
            ):
                assert browser.evaluate(attempt.format(address=address, protocols=protocols)) == "refused", address
            # A foreign name that resolves to this server gets an error page.
            browser.open(f"http://evil.localhost:{port_of(page)}/")
            assert browser.text("p").startswith("403")
            # The same attempt from a page of this computer succeeds.
            browser.open(site.replace("evil.", ""))
            own = attempt.format(address=f"ws://localhost:{foxglove}/", protocols=f"['{PROTOCOL}']")
            assert browser.evaluate(own).startswith('read {"op": "serverInfo"')
    finally:
        browser.close()

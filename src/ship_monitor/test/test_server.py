"""The page's server without a browser: served content and refused requests."""

import asyncio
import http.client
import json
import logging
import re
import socket
import threading

import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from ship_bags.errors import BadInput
from ship_monitor.page.server import PageServer
from ship_testing.page_runs import StateSource, run_page_server


@pytest.fixture(scope="module")
def page():
    with run_page_server() as server:
        yield server


def get(page, path, host=None, origin=None, upgrade=False):
    """Return status and text of an answer; for an accepted websocket, wait until the server closes it."""
    place = page.address.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(place, timeout=20)
    headers = {"Host": host or place} | ({"Origin": origin} if origin else {})
    if upgrade:
        key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version": "13"}
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade"} | key
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read()
    if answer.status == 101:
        while connection.sock.recv(1024):  # the server logs before it closes the websocket
            pass
    connection.close()
    return answer.status, text.decode("utf-8", "replace")


@pytest.mark.parametrize(("theme", "colour"), [("day", "#0E141B"), ("dusk", "#05080B"), ("night", "#000000")])
def test_background_is_in_the_first_bytes(page, theme, colour):
    status, text = get(page, f"/?theme={theme}")
    assert status == 200
    assert f"background:{colour}" in text[:120]


def test_unknown_theme_is_the_default(page):
    assert "background:#0E141B" in get(page, "/?theme=%22%3E%3Cscript%3E")[1][:120]


def test_page_uses_no_other_host(page):
    text = get(page, "/")[1]
    own = text.replace("http://www.w3.org/2000/svg", "")
    assert "//" not in own.replace("// ", "").split("<script src")[0].split("<script>")[0]
    assert "cdn" not in text


def test_values_come_before_any_bokeh_script(page):
    text = get(page, "/")[1]
    assert text.index('"034.39\\u00b0"') < text.index("bokeh.min.js")


def test_only_fonts_are_served_from_matplotlib(page):
    assert get(page, "/fonts/DejaVuSans.ttf")[0] == 200
    assert get(page, "/fonts/DejaVuSans-Bold.ttf")[0] == 200
    assert get(page, "/fonts/../matplotlibrc")[0] == 404
    assert get(page, "/fonts/DejaVuSerif.ttf")[0] == 404


def test_error_page_is_black(page):
    status, text = get(page, "/nothing")
    assert status == 404
    assert "background:#000000" in text


def test_failed_page_is_not_white_and_retries():
    source = StateSource()
    source.fails = True
    with run_page_server(source) as page:
        status, text = get(page, "/?theme=night")
        assert status == 200
        assert "background:#000000" in text[:120]
        assert 'http-equiv="refresh"' in text
        source.fails = False
        assert "034.39" in get(page, "/?theme=night")[1]


def test_other_sites_are_refused_and_ssh_tunnels_are_not(page):
    place = page.address.removeprefix("http://").rstrip("/")
    assert get(page, "/ws", origin="http://evil.example", upgrade=True)[0] == 403
    assert get(page, "/ws", origin="http://localhost:1", upgrade=True)[0] == 403
    assert get(page, "/", host="evil.example")[0] == 403
    assert get(page, "/", host="localhost:8080")[0] == 200
    # Without a session's token Bokeh accepts the socket, then closes it.
    assert get(page, "/ws", origin=f"http://{place}", upgrade=True)[0] == 101
    assert get(page, "/ws", host="localhost:8080", origin="http://localhost:8080", upgrade=True)[0] == 101


async def leave_early(page):
    """Open a page, and send messages on a connection that the server already treats as lost."""
    loop = asyncio.get_running_loop()
    text = (await loop.run_in_executor(None, get, page, "/"))[1]
    token = re.search(r'"token":"([^"]+)"', text)[1]
    request = HTTPRequest(f"{page.address.replace('http', 'ws')}ws", headers={"Origin": page.address.rstrip("/")})
    connection = await websocket_connect(request, subprotocols=["bokeh", token])
    await connection.read_message()
    application, is_lost = page._server._tornado, threading.Event()

    def lose():
        for client in list(application._clients):
            application.client_lost(client)
        is_lost.set()

    page._loop.add_callback(lose)
    assert await loop.run_in_executor(None, is_lost.wait, 20.0)
    for part in ({"msgid": "1", "msgtype": "PULL-DOC-REQ"}, {}, {}):
        await connection.write_message(json.dumps(part))
    connection.close()
    while await connection.read_message() is not None:
        pass


def test_early_closed_tab_logs_no_traceback(caplog, monkeypatch):
    monkeypatch.setattr(logging.getLogger("bokeh"), "propagate", True)  # without other handlers bokeh uses its own
    with run_page_server() as page:
        asyncio.run(leave_early(page))
        assert get(page, "/")[0] == 200
    logged = [record.getMessage() for record in caplog.records if record.exc_info or record.levelno >= logging.ERROR]
    assert logged == []


def test_port_in_use_is_reported_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(BadInput, match=f"port {port} of 127.0.0.1 is in use"):
            PageServer(lambda document: None, "127.0.0.1", port, lambda: None)


def test_foreign_address_is_reported_in_one_line():
    with pytest.raises(BadInput, match=r"cannot listen on 192\.0\.2\.1"):
        PageServer(lambda document: None, "192.0.2.1", 0, lambda: None)

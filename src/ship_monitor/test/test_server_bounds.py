"""Requests beyond the bounds of the page's server: refused with one line, without effect on the page."""

import gc
import http.client
import logging
import socket
import time

import pytest

from ship_monitor.page import server
from ship_monitor.web import bounded_server
from ship_monitor.web.bounded_server import MAX_BODY_BYTES, MAX_CONNECTIONS
from ship_testing.page_runs import run_page_server


class Lines(logging.Handler):
    """Handler that collects the lines of the log and the tracebacks."""

    def __init__(self):
        super().__init__()
        self.texts, self.tracebacks = [], []

    def emit(self, record):
        self.texts.append(record.getMessage())
        self.tracebacks += [record.exc_info] if record.exc_info else []


@pytest.fixture
def page():
    with run_page_server() as server:
        yield "127.0.0.1", int(server.address.strip("/").rpartition(":")[2])


@pytest.fixture
def lines(page):
    handler = Lines()
    loggers = [logging.getLogger(f"tornado.{name}") for name in ("access", "application", "general")]
    for logger in loggers:
        for sparse in logger.filters:
            sparse._last_s.clear()
        logger.addHandler(handler)
    yield handler
    for logger in loggers:
        logger.removeHandler(handler)


def status(page, path="/health"):
    connection = http.client.HTTPConnection(*page, timeout=20)
    connection.request("GET", path)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status


def ends(connection):
    """Return True after the server has closed a connection; a connection that stays open raises TimeoutError."""
    try:
        while connection.recv(65536):
            pass
    except ConnectionError:
        pass
    return True


def wait_until(condition, limit_s=30.0):
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.1)


@pytest.mark.parametrize("path", ["/%00", "/static/js/%00", "/static/a%00b.js", "/fonts/%00.ttf", "/health%00"])
def test_nul_in_a_path_is_not_found(page, lines, path):
    assert status(page, path) == 404
    wait_until(lambda: len(lines.texts) == 1)
    assert not lines.tracebacks


def test_large_bodies_are_refused(page, lines):
    for length in (MAX_BODY_BYTES + 1, 95_000_000, 10**30):
        with socket.create_connection(page, timeout=20.0) as connection:
            connection.sendall(f"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\n".encode())
            assert ends(connection)
    assert lines.texts == ["Malformed HTTP message from 127.0.0.1: Content-Length too long"]
    assert status(page) == 200


def test_endless_request_is_closed(monkeypatch):
    monkeypatch.setattr(bounded_server, "REQUEST_TIMEOUT_S", 0.3)
    with run_page_server() as server:
        place = "127.0.0.1", int(server.address.strip("/").rpartition(":")[2])
        for start in (
            b"",
            b"GET / HTTP/1.1\r\nHost: loc",
            b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nab",
        ):
            with socket.create_connection(place, timeout=20.0) as connection:
                connection.sendall(start)
                assert ends(connection)
        assert status(place) == 200


def test_too_many_connections_are_closed_with_one_line(page, lines):
    connections = [socket.create_connection(page, timeout=20.0) for _ in range(MAX_CONNECTIONS + 20)]
    assert all(ends(each) for each in connections[-20:])
    assert lines.texts == [f"127.0.0.1: connection closed: {MAX_CONNECTIONS} are open, the maximum"]
    for each in connections:
        each.close()

    def answers():
        try:
            return status(page) == 200
        except (ConnectionError, http.client.HTTPException):
            return False

    wait_until(answers)


def test_too_many_pages_are_refused_until_others_are_closed(page, lines, monkeypatch):
    assert server.MAX_PAGES == 32
    monkeypatch.setattr(server, "MAX_PAGES", 5)  # few pages: none is closed while the others are opened
    assert [status(page, "/") for _ in range(8)] == [200] * 5 + [503] * 3
    assert status(page, "/autoload.js?bokeh-autoload-element=1") == 503
    wait_until(lambda: len(lines.texts) == 1)
    assert status(page) == 200
    # Bokeh collects garbage after each closed page; objects from before the first page are excluded.
    assert gc.get_freeze_count() > 0
    wait_until(lambda: status(page, "/") == 200)

"""Sinks with real sockets, a real pseudo-terminal and real files: what is sent, dropped and received."""

import errno
import os
import socket
import stat
import subprocess
import sys
import termios
import time
import tty

import pytest

from ship_nmea.connections import LineSplitter, permanent_error
from ship_nmea.out.config import SinkConfig
from ship_nmea.out.outlets import MAX_CLIENTS_PER_HOST, command_texts
from ship_nmea.out.sink import MAX_QUEUED, RETRY_S, Sink
from ship_node.messages.common_messages import Level
from ship_testing.nmea_in_peer import free_port

TIMEOUT_S = 20.0
SENTENCE = "$INHDT,12.3456,T*08"


def wait_until(look):
    """Return the value of ``look`` as soon as it is true."""
    end_s = time.monotonic() + TIMEOUT_S
    while not (found := look()) and time.monotonic() < end_s:
        time.sleep(0.01)
    assert found
    return found


@pytest.fixture
def open_sink():
    """Make started sinks, which are closed after the test. The lines that they receive are in ``received_lines``."""
    sinks = []

    def make(**values):
        lines = []
        sink = Sink("bridge", SinkConfig(**values), lambda text, _: lines.append(text))
        sink.received_lines = lines
        sinks.append(sink)
        sink.start()
        return sink

    yield make
    for sink in sinks:
        sink.close()


def connect(port):
    client = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
    client.settimeout(TIMEOUT_S)
    return client


def test_udp_sends_whole_sentences_and_receives_commands(open_sink):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bridge:
        bridge.bind(("127.0.0.1", 0))
        bridge.settimeout(TIMEOUT_S)
        listen_port = free_port()
        port = bridge.getsockname()[1]
        sink = open_sink(kind="udp", address="127.0.0.1", port=port, listen_port=listen_port)
        sink.queue(SENTENCE)
        assert bridge.recv(1000) == f"{SENTENCE}\r\n".encode()
        bridge.sendto(b"$IIACN,1*00\r\n$IIHBT,2*00", ("127.0.0.1", listen_port))
        wait_until(lambda: "$IIHBT,2*00" in sink.received_lines)
        assert "$IIACN,1*00" in sink.received_lines
        assert sink.status().level is Level.OK


def test_udp_continues_without_receiver(open_sink):
    sink = open_sink(kind="udp", address="127.0.0.1", port=free_port())
    for _ in range(5):
        sink.queue(SENTENCE)
        time.sleep(0.01)
    wait_until(lambda: int(sink.status().values["sent"]) == 5)
    assert sink.status().level is Level.OK


def test_udp_reaches_a_group(open_sink):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as member:
        member.bind(("239.192.0.1", 0))
        own = socket.inet_aton("127.0.0.1")
        member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.192.0.1") + own)
        member.settimeout(TIMEOUT_S)
        port = member.getsockname()[1]
        open_sink(kind="udp", address="239.192.0.1", port=port, interface="127.0.0.1").queue(SENTENCE)
        assert member.recv(1000) == f"{SENTENCE}\r\n".encode()


def test_tcp_serves_several_clients_and_receives_lines_in_chunks(open_sink):
    port = free_port(socket.SOCK_STREAM)
    sink = open_sink(kind="tcp_server", port=port)
    with connect(port) as one, connect(port) as two:
        wait_until(lambda: "2 clients" in sink.status().message)
        sink.queue(SENTENCE)
        for client in (one, two):
            assert client.recv(1000) == f"{SENTENCE}\r\n".encode()
        for piece in (b"$IIA", b"CN,1*00\r", b"\n$II"):
            two.sendall(piece)
        wait_until(lambda: sink.received_lines == ["$IIACN,1*00"])
    wait_until(lambda: "0 clients" in sink.status().message)
    assert sink.status().level is Level.OK


@pytest.mark.slow
def test_client_that_does_not_read_is_disconnected(open_sink, monkeypatch):
    monkeypatch.setattr("ship_nmea.out.outlets.CLIENT_TIMEOUT_S", 0.5)
    port = free_port(socket.SOCK_STREAM)
    sink = open_sink(kind="tcp_server", port=port)
    with socket.socket() as lazy, connect(port) as reader:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        lazy.connect(("127.0.0.1", port))
        wait_until(lambda: "2 clients" in sink.status().message)

        def one_more_reaches_the_reader():
            sink.queue(SENTENCE)
            assert reader.recv(1000).endswith(b"\r\n")
            return "1 clients disconnected" in sink.status().message

        wait_until(one_more_reaches_the_reader)
        assert "1 clients, " in sink.status().message
        assert sink.status().level is Level.WARN


@pytest.mark.slow
def test_client_that_does_not_read_is_disconnected_at_a_low_rate(open_sink, monkeypatch):
    """The client's system takes 2 kB. At a low rate the 8 kB of the send buffer take minutes more to fill."""
    monkeypatch.setattr("ship_nmea.out.outlets.CLIENT_TIMEOUT_S", 1.0)
    port = free_port(socket.SOCK_STREAM)
    sink = open_sink(kind="tcp_server", port=port)
    with socket.socket() as lazy, connect(port) as reader:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        lazy.connect(("127.0.0.1", port))
        wait_until(lambda: "2 clients" in sink.status().message)
        count = 0

        def one_more():
            nonlocal count
            count += 1
            sink.queue(SENTENCE)
            assert reader.recv(1000) == f"{SENTENCE}\r\n".encode()
            time.sleep(0.02)
            return "1 clients, 1 clients disconnected" in sink.status().message

        wait_until(one_more)
        assert count < 400  # sentences of 21 bytes; 480 fill both buffers


def test_one_host_cannot_use_all_connections(open_sink):
    port = free_port(socket.SOCK_STREAM)
    sink = open_sink(kind="tcp_server", port=port)
    clients = [connect(port) for _ in range(MAX_CLIENTS_PER_HOST + 2)]
    try:
        wait_until(lambda: "2 clients disconnected, 127.0.0.1 has 8 connections, the max" in sink.status().message)
        with socket.create_connection(("127.0.0.1", port), TIMEOUT_S, ("127.0.0.2", 0)) as other:
            wait_until(lambda: "9 clients" in sink.status().message)
            sink.queue(SENTENCE)
            assert other.recv(1000) == f"{SENTENCE}\r\n".encode()
    finally:
        for client in clients:
            client.close()


def test_slow_client_receives_whole_sentences(open_sink):
    port = free_port(socket.SOCK_STREAM)
    sink = open_sink(kind="tcp_server", port=port)
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        slow.connect(("127.0.0.1", port))
        slow.settimeout(TIMEOUT_S)
        wait_until(lambda: "1 clients" in sink.status().message)
        number = 0

        def one_more_until_some_are_skipped():
            nonlocal number
            number += 1
            sink.queue(f"${number:070d}")
            return "skipped" in sink.status().message

        wait_until(one_more_until_some_are_skipped)
        data = b""
        while len(data) < 3000:
            sink.queue("$end")
            data += slow.recv(4096)
        *lines, _ = data.split(b"\r\n")
        assert all(line == b"$end" or (len(line) == 71 and line[:1] == b"$") for line in lines)


def test_port_in_use_is_an_opening_error(open_sink):
    port = free_port(socket.SOCK_STREAM)
    open_sink(kind="tcp_server", port=port, address="127.0.0.1")
    refused = open_sink(kind="tcp_server", port=port, address="127.0.0.1").opening_error
    assert str(refused).startswith(f"parameter 'sinks.bridge.port' = {port}: Address already in use: another")
    assert refused.parameters == ("sinks.bridge.port",)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        taken = other.getsockname()[1]
        sink = open_sink(kind="udp", address="127.0.0.1", port=port, listen_port=taken)
        assert f"'sinks.bridge.listen_port' = {taken}: Address already in use" in str(sink.opening_error)
        assert sink.status().level is Level.ERROR
    wait_until(lambda: sink.status().level is Level.OK)


def test_foreign_address_is_an_opening_error(open_sink):
    sink = open_sink(kind="tcp_server", port=free_port(), address="192.0.2.1")
    assert "'sinks.bridge.address' = '192.0.2.1': Cannot assign" in str(sink.opening_error)


def test_file_as_serial_device_is_an_opening_error(open_sink, tmp_path):
    path = tmp_path / "log.nmea"
    path.touch()
    for device in (str(path), "/dev/null"):
        sink = open_sink(kind="serial", device=device)
        assert "'sinks.bridge.device'" in str(sink.opening_error)
        assert "not a serial device" in str(sink.opening_error)
        assert "Inappropriate ioctl for device; retried" in sink.status().message


@pytest.fixture
def line(tmp_path):
    """Return a function that makes a pseudo-terminal and returns its far end, and the path of its near end."""
    lines = []

    def plug_in(path=tmp_path / "ttyUSB0"):
        far, near = os.openpty()
        tty.setraw(near)
        lines.append(far)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(near))
        os.close(near)
        return far, str(path)

    yield plug_in
    for far in lines:
        if far is not None:
            os.close(far)
    lines.clear()


def test_serial_sends_and_receives_at_its_rate(open_sink, line):
    far, path = line()
    sink = open_sink(kind="serial", device=path, baud=4800)
    sink.queue(SENTENCE)
    assert os.read(far, 1000) == f"{SENTENCE}\r\n".encode()
    assert termios.tcgetattr(far)[5] == termios.B4800
    os.write(far, b"$IIACN,1*00\r\n")
    wait_until(lambda: sink.received_lines == ["$IIACN,1*00"])


def test_lost_serial_line_is_reported_and_opened_again(open_sink, tmp_path):
    def plug():
        far, near = os.openpty()
        tty.setraw(near)
        (tmp_path / "ttyUSB0").symlink_to(os.ttyname(near))
        os.close(near)
        return far

    far = plug()
    sink = open_sink(kind="serial", device=str(tmp_path / "ttyUSB0"))
    sink.queue(SENTENCE)
    assert os.read(far, 1000)
    (tmp_path / "ttyUSB0").unlink()
    os.close(far)
    status = wait_until(lambda: sink.status().level is Level.ERROR and sink.status())
    assert f"retried every {RETRY_S:g} s" in status.message
    sink.queue("$OLD")
    far = plug()
    try:
        wait_until(lambda: sink.status().level is not Level.ERROR)
        sink.queue(SENTENCE)
        # Sentences queued while the line was unplugged are not sent afterwards.
        assert os.read(far, 1000) == f"{SENTENCE}\r\n".encode()
        assert sink.status().values["dropped: while it was not open"] == "1"
    finally:
        os.close(far)


def test_old_sentences_of_a_blocked_serial_line_are_dropped(open_sink, line):
    _, path = line()
    sink = open_sink(kind="serial", device=path)

    def one_more():
        # A thousand sentences per second: a queue of MAX_QUEUED sentences exceeds their maximum age.
        for _ in range(10):
            sink.queue(SENTENCE * 20, max_wait_ns=50_000_000)
        return any("expired in the queue" in why for why in sink.status().values)

    wait_until(one_more)
    assert sink.status().level is Level.WARN
    assert int(sink.status().values["waiting"]) <= MAX_QUEUED


def test_missing_serial_device_is_retried(open_sink, tmp_path):
    sink = open_sink(kind="serial", device=str(tmp_path / "ttyUSB7"))
    assert sink.status().level is Level.ERROR
    assert sink.opening_error is None
    assert f"{tmp_path}/ttyUSB7 at 38400 Bd: No such file or directory; retried" in sink.status().message


def test_serial_device_without_permission_is_an_opening_error(tmp_path):
    far, near = os.openpty()
    name = os.ttyname(near)
    os.chmod(name, stat.S_IRUSR * 0)
    program = (
        "import os\n"
        "from ship_nmea.out.sink import Sink, SinkConfig\n"
        "if os.getuid() == 0: os.setuid(65534)\n"
        f"raise Sink('gyro', SinkConfig(kind='serial', device={name!r}), print).opening_error\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    os.close(far)
    os.close(near)
    error = ended.stderr.splitlines()[-1]
    assert f"BadInput: parameter 'sinks.gyro.device' = '{name}': Permission denied: not permitted" in error


def test_a_file_is_appended_to(open_sink, tmp_path):
    path = tmp_path / "log.nmea"
    path.write_text("before\n")
    sink = open_sink(kind="file", path=str(path))
    sink.queue(SENTENCE)
    sink.close()
    assert path.read_bytes() == f"before\n{SENTENCE}\r\n".encode()


def test_full_disk_is_reported_and_retried(open_sink):
    sink = open_sink(kind="file", path="/dev/full")
    sink.queue(SENTENCE)
    status = wait_until(lambda: sink.status().level is Level.ERROR and sink.status())
    assert "No space left on device" in status.message
    wait_until(lambda: sink.status().level is not Level.ERROR)


def test_full_disk_leaves_no_half_sentence(tmp_path):
    """A process's limit of file size cuts a write as a full disk does."""
    path = tmp_path / "log.nmea"
    program = (
        "import resource, signal\n"
        "from ship_nmea.out.outlets import FileOutlet\n"
        "from ship_nmea.out.sink import SinkConfig\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (30, 30))\n"
        f"outlet = FileOutlet(SinkConfig(kind='file', path={str(path)!r}), print)\n"
        "outlet.open(None)\n"
        "outlet.send(b'$INHDT,12.3456,T*08\\r\\n')\n"
        "outlet.send(b'$INHDT,12.3456,T*08\\r\\n')\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert "No space left on device" in ended.stderr
    assert path.read_bytes() == f"{SENTENCE}\r\n".encode()


@pytest.mark.parametrize(("kind", "advice"), [
    ("tcp_server", "ports below 1024"), ("udp", "ports below 1024"), ("serial", "'dialout'"), ("file", "a folder"),
])  # fmt: skip
def test_advice_on_missing_permission_depends_on_the_kind(kind, advice):
    named_by = {kind: ("port", "address")}
    assert advice in str(
        permanent_error(PermissionError(errno.EACCES, "no"), "sinks.bridge", SinkConfig(kind=kind), named_by)
    )


def test_unsupported_rate_names_its_parameter():
    problem, named_by = OSError(errno.EINVAL, "no"), {"serial": ("device", "baud")}
    error = str(permanent_error(problem, "sinks.gyro", SinkConfig(kind="serial", baud=12345), named_by))
    assert error.startswith("parameter 'sinks.gyro.baud' = 12345: Invalid argument: expected a rate")
    assert permanent_error(OSError(errno.ENOENT, "no"), "sinks.gyro", SinkConfig(kind="serial"), named_by) is None


def test_duplicate_sentence_is_refused():
    assert SinkConfig(kind="file", path="x", sentences=("HDT", "THS")).first_error() is None
    twice = SinkConfig(kind="file", path="x", sentences=("HDT", "THS", "HDT"))
    assert twice.first_error() == ("sentences", "names HDT twice: expected each sentence once")


def test_folder_as_file_is_refused(open_sink, tmp_path):
    refused = open_sink(kind="file", path=str(tmp_path)).opening_error
    assert str(refused) == f"parameter 'sinks.bridge.path' = '{tmp_path}': Is a directory"


def test_hanging_disk_delays_neither_node_nor_end(tmp_path):
    """A full pipe that is not read is a file whose write never returns."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    sink = Sink("log", SinkConfig(kind="file", path=str(path)), print)
    sink.start()
    end_s = time.monotonic() + TIMEOUT_S
    while "dropped" not in sink.status().message and time.monotonic() < end_s:
        began_s = time.monotonic()
        sink.queue(SENTENCE * 100)
        assert time.monotonic() - began_s < 1.0
    assert int(sink.status().values["waiting"]) == MAX_QUEUED
    assert any(f"more than {MAX_QUEUED}" in why for why in sink.status().values)
    sink.close()
    os.close(reader)  # frees the thread


def test_lines_without_end_are_bounded():
    splitter = LineSplitter()
    assert command_texts(splitter.split(b"x" * 5000)) == []
    assert command_texts(splitter.split(b"y" * 5000 + b"\n$ok\r\n")) == ["$ok"]
    assert command_texts(splitter.split(b"\xff\x00\n")) == ["\ufffd\x00"]

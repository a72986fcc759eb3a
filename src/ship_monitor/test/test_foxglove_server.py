"""The Foxglove server with a client over a real websocket."""

import socket
import struct
import time

import pytest

from ship_bags.errors import BadInput
from ship_monitor.web.foxglove_server import FoxgloveServer
from ship_testing.foxglove_client import FoxgloveClient, client_that_never_reads

STRING = "std_msgs/msg/String"
MESSAGE = b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00"
"""CDR of the text "hi", little-endian: a length with the closing zero, then the letters."""


@pytest.fixture
def server():
    server = FoxgloveServer("demo", "127.0.0.1", 0)
    yield server
    server.close()


@pytest.fixture
def connect(server):
    clients = []

    def make(**options):
        clients.append(FoxgloveClient(server.address, **options))
        return clients[-1]

    yield make
    for client in clients:
        client.close()


def subscribe_and_wait(server, client, *topics):
    client.wait_until(lambda: all(topic in client.channels for topic in topics))
    client.subscribe(*topics)
    awaited = set(topics)

    def have_all_come():
        awaited.difference_update(server.new_subscriptions())
        return not awaited

    client.wait_until(have_all_come)
    assert server.subscribed_topics() >= set(topics)


def test_server_info_has_the_name_and_no_capabilities(server, connect):
    client = connect()
    info = client.wait_until(lambda: client.server_messages and client.server_messages[0])
    assert (info["op"], info["name"], info["capabilities"]) == ("serverInfo", "demo", [])


def test_message_arrives_with_bytes_time_and_definition(server, connect):
    server.offer("/demo/text", STRING, "string data")
    client = connect()
    subscribe_and_wait(server, client, "/demo/text")
    channel = client.channels["/demo/text"]
    assert {key: channel[key] for key in ("encoding", "schemaName", "schemaEncoding", "schema")} == {
        "encoding": "cdr",
        "schemaName": STRING,
        "schemaEncoding": "ros2msg",
        "schema": "string data",
    }
    server.forward("/demo/text", MESSAGE, 1_700_000_000_123_456_789)
    received = client.wait_until(lambda: client.received and client.received[0])
    assert (received.log_time_ns, received.data) == (1_700_000_000_123_456_789, MESSAGE)


def test_subscribed_topics_follow_the_clients(server, connect):
    server.offer("/demo/text", STRING, "string data")
    server.offer("/demo/other", STRING, "string data")
    assert server.subscribed_topics() == server.new_subscriptions() == frozenset()
    first, second = connect(), connect()
    subscribe_and_wait(server, first, "/demo/text")
    assert server.new_subscriptions() == frozenset()
    subscribe_and_wait(server, second, "/demo/text")
    assert server.subscribed_topics() == {"/demo/text"}
    first.unsubscribe("/demo/text")
    server.forward("/demo/text", MESSAGE, 1)
    second.wait_until(lambda: len(second.received) == 1)
    assert server.subscribed_topics() == {"/demo/text"}
    second.close()
    first.wait_until(lambda: not server.subscribed_topics())
    server.forward("/demo/text", MESSAGE, 2)
    first.receive(0.2)
    assert not first.received


def test_two_clients_get_the_same_messages_in_order(server, connect):
    server.offer("/demo/text", STRING, "string data")
    clients = [connect(), connect()]
    for client in clients:
        subscribe_and_wait(server, client, "/demo/text")
    for number in range(500):
        server.forward("/demo/text", struct.pack("<I", number), number)
    for client in clients:
        client.wait_until(lambda client=client: len(client.received) == 500)
        assert [each.data for each in client.received] == [struct.pack("<I", number) for number in range(500)]
        assert [each.log_time_ns for each in client.received] == list(range(500))


def test_topic_with_another_type_is_another_channel(server, connect):
    server.offer("/demo/text", STRING, "string data")
    client = connect()
    subscribe_and_wait(server, client, "/demo/text")
    former = client.channels["/demo/text"]["id"]
    server.offer("/demo/text", STRING, "string data")
    server.offer("/demo/text", "std_msgs/msg/Int32", "int32 data")
    client.wait_until(lambda: client.channels.get("/demo/text", {}).get("schemaName") == "std_msgs/msg/Int32")
    assert client.channels["/demo/text"]["id"] != former
    assert not server.subscribed_topics()
    assert sum(each["op"] == "advertise" for each in client.server_messages) == 2


ONLY = "this server is read-only: "


@pytest.mark.parametrize(
    ("request_", "refusal"),
    [
        (
            {"op": "advertise", "channels": [{"id": 1, "topic": "/demo/x", "encoding": "cdr", "schemaName": STRING}]},
            f"{ONLY}'advertise' is refused",
        ),
        (struct.pack("<BI", 1, 1) + MESSAGE, f"{ONLY}binary messages are refused"),
        (
            {"op": "setParameters", "parameters": [{"name": "/ship_attitude.tau", "value": 1.0}]},
            f"{ONLY}'setParameters' is refused",
        ),
        ({"op": "getParameters", "parameterNames": []}, f"{ONLY}'getParameters' is refused"),
        (struct.pack("<BIII", 2, 1, 1, 3) + b"cdr" + MESSAGE, f"{ONLY}binary messages are refused"),
        ({"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1}, f"{ONLY}'fetchAsset' is refused"),
        ({"op": "subscribe", "subscriptions": [{"id": 1}]}, "not a request of the protocol"),
    ],
)
def test_server_is_read_only(server, connect, request_, refusal):
    client = connect()
    client.send_request(request_)
    client.wait_until(lambda: any(each.get("message") == refusal for each in client.server_messages))


def test_invalid_requests_harm_neither_the_server_nor_others(server, connect):
    server.offer("/demo/text", STRING, "string data")
    good, bad = connect(), connect()
    subscribe_and_wait(server, good, "/demo/text")
    bad.send_request(b"\xff" * 100)
    bad.send_request({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999}]})
    with socket.create_connection(("127.0.0.1", int(server.address.rpartition(":")[2]))) as connection:
        connection.sendall(b"GET / HTTP/1.0\r\n\r\n")
    bad.receive(0.2)
    server.forward("/demo/text", MESSAGE, 1)
    good.wait_until(lambda: good.received)


def resident_mb():
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


def test_client_that_does_not_read_delays_nothing_and_memory_is_bounded(server, connect):
    server.offer("/demo/text", STRING, "string data")
    good = connect()
    subscribe_and_wait(server, good, "/demo/text")
    with client_that_never_reads(server.address, good.channels["/demo/text"]["id"]):
        good.wait_until(server.new_subscriptions)
        payload = bytes(4000)
        before_mb, begin_s = resident_mb(), time.monotonic()
        for number in range(40):
            # The client that reads nothing is sent 160 MB; at most 1024 messages, 4 MB, wait in the server.
            for _ in range(1000):
                server.forward("/demo/text", payload, number)
            good.receive(0.01)
        assert time.monotonic() - begin_s < 10.0
        good.wait_until(lambda: good.received[-1].log_time_ns == 39)
        good.received.clear()
        assert resident_mb() - before_mb < 100.0
        begin_s = time.monotonic()
        server.close()
        server.close()  # while the first call still waits for the client
        assert time.monotonic() - begin_s < 5.0


def test_close_ends_connections_and_frees_the_port():
    server = FoxgloveServer("demo", "127.0.0.1", 0)
    client = FoxgloveClient(server.address)
    port = int(server.address.rpartition(":")[2])
    server.close()
    client.wait_until(lambda: client.is_over)
    client.close()
    again = FoxgloveServer("demo", "127.0.0.1", port)
    again.close()


def test_port_in_use_is_reported(server):
    port = int(server.address.rpartition(":")[2])
    with pytest.raises(BadInput, match=rf"port {port} of 127\.0\.0\.1 is in use: choose another one with --foxglove"):
        FoxgloveServer("demo", "127.0.0.1", port)


def test_foreign_address_is_reported():
    with pytest.raises(BadInput, match=r"cannot listen on 192\.0\.2\.1, port 0"):
        FoxgloveServer("demo", "192.0.2.1", 0)


def test_ipv6_address_is_in_brackets():
    server = FoxgloveServer("demo", "::1", 0)
    assert server.address.startswith("ws://[::1]:")
    client = FoxgloveClient(server.address)
    client.wait_until(lambda: client.server_messages)
    client.close()
    server.close()

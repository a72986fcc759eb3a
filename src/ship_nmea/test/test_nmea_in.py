"""nmea_in over DDS, with real sockets and a real serial line: what it publishes, counts and reports, and faults."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from datetime import datetime, timedelta, timezone
from itertools import pairwise

import numpy as np
import pynmea2
import pytest

from ship_bags.nmea.instrument_lines import datetime_ns
from ship_bags.stamps import ns_from_stamp
from ship_geometry.frames import rotation_from_angles, rotation_from_quaternion
from ship_geometry.rotations import log_rotation
from ship_testing.nmea_in_peer import START, free_port
from ship_testing.ship_logs import sentence

pytestmark = pytest.mark.live

OK, WARN, ERROR = 0, 1, 2

HEADINGS_DEG = np.arange(0.0, 360.0, 45.0)
ANGLES_DEG = [
    *((heading, 1.23, -4.56) for heading in HEADINGS_DEG),
    (179.99, 0.0, 0.0), (180.01, 0.0, 0.0), (359.99, -5.0, 5.0), (0.01, 5.0, -5.0),
    (90.0, 0.0, 179.99), (270.0, 0.0, -179.99), (30.0, 89.0, 10.0), (330.0, -89.0, -170.0),
]  # fmt: skip
"""Heading, pitch (bow up), roll (starboard down)."""


def udp(becomes, **more):
    return {"kind": "udp", "address": "127.0.0.1", "port": free_port(), "becomes": becomes, **more}


def lines_of(*bodies):
    return "".join(sentence(body) + "\r\n" for body in bodies).encode()


def psxn(utc, heading_deg, pitch_deg, roll_deg):
    """Return a burst of a Seapath, rendered by pynmea2: PSXN,23 has roll positive with port up, pitch with bow up."""
    zda = pynmea2.ZDA("IN", "ZDA", (f"{utc:%H%M%S.%f}", f"{utc:%d}", f"{utc:%m}", f"{utc:%Y}", "", ""))
    angles = (f"{roll_deg:.2f}", f"{pitch_deg:.2f}", f"{heading_deg:.2f}", "0.00")
    quality = pynmea2.ProprietarySentence("SXN", ["", "20", "0", "0", "0", "0"])
    attitude = pynmea2.ProprietarySentence("SXN", ["", "23", *angles])
    return "".join(one.render(newline=True) for one in (zda, quality, attitude)).encode()


def pashr(utc, heading_deg, pitch_deg, roll_deg):
    """Return PASHR as an RT300 writes it: heading, T, roll, pitch, heave, three accuracies, quality, INS status."""
    time_text = f"{utc:%H%M%S.%f}"[:9]
    angles = (f"{heading_deg:.3f}", "T", f"{roll_deg:+.3f}", f"{pitch_deg:+.3f}")
    fields = ["R", time_text, *angles, "+0.00", "0.001", "0.001", "0.001", "2", "1"]
    return pynmea2.ProprietarySentence("ASH", fields).render(newline=True).encode()


@pytest.mark.parametrize(("burst", "print_deg"), [(psxn, 0.005), (pashr, 0.0005)])
def test_attitudes_are_exact_to_the_printed_decimals(listening, burst, print_deg):
    node = listening({"seapath": udp("ins")}, namespace="aurora")
    start = datetime.now(timezone.utc).replace(microsecond=0) - timedelta(seconds=2)
    times = [start + timedelta(milliseconds=100 * number) for number in range(len(ANGLES_DEG))]
    for utc, angles in zip(times, ANGLES_DEG, strict=True):
        node.send("seapath", burst(utc, *angles))
    messages = node.received["ins/imu"]
    node.wait_until(lambda: len(messages) == len(ANGLES_DEG))
    for message, utc, angles in zip(messages, times, ANGLES_DEG, strict=True):
        assert ns_from_stamp(message.header.stamp) == datetime_ns(utc)
        q = message.orientation
        expected = rotation_from_angles(*np.deg2rad(angles))
        error = log_rotation(expected.T @ rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w])))
        # Each of three angles is rounded by half of its last digit at most.
        assert np.linalg.norm(np.rad2deg(error)) <= 3 * print_deg
        assert message.header.frame_id == "ins"
        assert message.angular_velocity_covariance[0] == -1.0
    values = node.wait_until(
        lambda: (status := node.source_status("seapath"))[:2] == (OK, "publishes ins/imu") and status[2]
    )
    assert values["ins/imu"] == str(len(ANGLES_DEG))


def test_bow_east_is_the_identity_in_ros_axes(listening):
    """REP-103: ENU <- FLU is the identity if the bow points east; the test uses none of our own conversions."""
    node = listening({"seapath": udp("ins")})
    node.send("seapath", psxn(datetime.now(timezone.utc), 90.0, 0.0, 0.0))
    (message,) = node.wait_until(lambda: node.received["ins/imu"])
    q = message.orientation
    assert [abs(q.w), q.x, q.y, q.z] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-9)


def test_each_role_has_its_topics_and_stamps(listening):
    """THS and weather contain no time: the stamp is the arrival, as for all sources with ``time: arrival``."""
    node = listening({
        "gps": udp("gnss", time="arrival"), "gyro": udp("gyro"), "second": udp("reference", time="arrival"),
        "mast": udp("weather"),
    })  # fmt: skip
    before_ns = time.time_ns()
    node.send("gps", b"$INGGA,000000.16,2200.110899,S,01756.359432,W,1,12,0.7,-2.76,M,4.67,M,,*6C\r\n")
    node.send("gyro", lines_of("HETHS,90.0,A"))
    node.send("second", lines_of("PSXN,23,1.0,2.0,3.0,0.0"))
    node.send("mast", lines_of("WIXDR,C,23.3,C,0,H,50.1,P,0,P,1009.5,H,0"))
    topics = ["gnss/fix", "reference/gyro/imu", "reference/second/imu"]
    topics += ["met/temperature", "met/humidity", "met/pressure"]
    node.wait_until(lambda: all(node.received[topic] for topic in topics))
    for topic in topics:
        assert before_ns <= ns_from_stamp(node.received[topic][0].header.stamp) <= time.time_ns()
    assert node.received["gnss/fix"][0].latitude == pytest.approx(-(22 + 0.110899 / 60))
    assert node.received["reference/gyro/imu"][0].header.frame_id == "gyro"
    assert node.received["met/pressure"][0].fluid_pressure == pytest.approx(100_950.0)


def test_sentences_without_checksum_need_the_parameter(listening):
    node = listening({"old": udp("gyro", checksum="optional"), "new": udp("gyro")})
    for id_ in ("old", "new"):
        node.send(id_, b"$HEHDT,218.0,T\r\n")
        node.send(id_, b"$HEHDT,21\r\n")
        node.send(id_, lines_of("HEHDT,219.0,T"))
    node.wait_until(lambda: len(node.received["reference/old/imu"]) == 2 and node.received["reference/new/imu"])
    for id_, rejected in (("old", "1"), ("new", "2")):
        node.wait_until(
            lambda id_=id_, rejected=rejected: (status := node.source_status(id_))
            and status[2].get("rejected: half line or no checksum") == rejected
        )
    assert [len(node.received[f"reference/{id_}/imu"]) for id_ in ("old", "new")] == [2, 1]


def test_sources_of_one_port_are_separated_by_talker(listening):
    port = free_port()
    node = listening({
        id_: {"kind": "udp", "address": "127.0.0.1", "port": port, "becomes": "gyro", "talkers": [talker]}
        for id_, talker in (("fore", "HE"), ("aft", "HN"))
    })  # fmt: skip
    node.send("fore", lines_of("HEHDT,10.0,T", "HNHDT,20.0,T", "GPHDT,30.0,T"))
    node.wait_until(lambda: node.received["reference/fore/imu"] and node.received["reference/aft/imu"])
    assert [len(node.received[f"reference/{id_}/imu"]) for id_ in ("fore", "aft")] == [1, 1]
    values = node.wait_until(lambda: (status := node.source_status("fore"))[2].get("lines") == "3" and status[2])
    assert (values["other talker: HN"], values["other talker: GP"]) == ("1", "1")


def test_multicast_group_is_received(listening):
    """IEC 61162-450: a group of its own for each kind of data, a mark and a TAG block before the sentence."""
    node = listening({"gyro": udp("gyro") | {"address": "239.192.0.4", "interface": "127.0.0.1"}})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        data = b"UdPbC\x00\\s:HE0001,n:12*2A\\" + lines_of("HEHDT,10.0,T")
        sender.sendto(data, ("239.192.0.4", node.config.sources["gyro"].port))
    node.wait_until(lambda: node.received["reference/gyro/imu"])


def test_unusable_lines_are_counted_and_the_rest_is_used(listening):
    """All faults in one datagram, between valid sentences."""
    node = listening({"gyro": udp("gyro", talkers=["HE"])})
    good = lines_of("HEHDT,218.53,T")
    node.send("gyro", b"".join(
        bad + good for bad in (
            b"$HEHDT,218.54,T*12\r\n", b"$HEHDT,21", b"8.5,T*12\r\n", b"$" + b"x" * 2000 + b"\r\n",
            bytes(range(128, 256)) + b"\r\n", lines_of("GPHDT,10.0,T"), lines_of("HEXYZ,1"), lines_of("HEHDT,,T"),
            lines_of("HEVTG,215.11,T,239.79,M,9.1,N,16.9,K,A"), b"\r\n\r\n",
        )
    ))  # fmt: skip
    node.wait_until(lambda: len(node.received["reference/gyro/imu"]) == 10)
    _, text, values = node.wait_until(lambda: (status := node.source_status("gyro"))[0] == WARN and status)
    assert {name: count for name, count in values.items() if name.startswith(("rejected", "not of", "other"))} == {
        "rejected: binary noise": "1", "rejected: checksum failed": "1", "rejected: half line or no checksum": "2",
        "rejected: line too long": "1", "rejected: no values in it": "1", "rejected: unknown sentence": "1",
        "not of interest: HEVTG": "1", "other talker: GP": "1",
    }  # fmt: skip
    assert values["example of checksum failed"] == "'$HEHDT,218.54,T*12'"
    assert "half line or no checksum 2, as '8.5,T*12'" in text
    assert len(values["example of line too long"]) < 100
    assert node.exception_text() == "no exception"


def test_impossible_time_is_an_error(listening):
    """The status depends on published messages: sentences of 2014 give no message today."""
    node = listening({"seapath": udp("ins", silent_after_s=0.5)})

    def error_text():
        node.send("seapath", psxn(datetime(2014, 8, 1, tzinfo=timezone.utc), 10.0, 0.0, 0.0))
        level, text, _ = node.source_status("seapath")
        return level == ERROR and "instrument time" in text and text

    text = node.wait_until(error_text)
    assert text.startswith("lines arrive, but no ins/imu for")
    assert "'2014-08-01T00:00:00Z is " in text


def test_source_without_data_is_an_error_until_data_arrives(listening):
    node = listening({"gyro": udp("gyro", silent_after_s=0.3)})
    node.send("gyro", lines_of("HEHDT,10.0,T"))
    node.wait_until(lambda: node.source_status("gyro")[0] == ERROR and "no line for" in node.source_status("gyro")[1])

    def send_and_check():
        node.send("gyro", lines_of("HEHDT,10.0,T"))
        return node.source_status("gyro")[0] == OK

    node.wait_until(send_and_check)


def test_foreign_sender_and_cut_datagrams_lose_no_ins_message(listening):
    """Sentences of the INS are cut in two after UBX data; after every 20th a foreign one is stamped 30 s ahead."""
    node = listening({"seapath": udp("ins"), "gps": udp("gnss", **{"from": ["127.0.0.3"]})})
    start = datetime.now(timezone.utc) - timedelta(seconds=2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        foreign.bind(("127.0.0.2", 0))
        for number in range(100):
            utc = start + timedelta(milliseconds=10 * number)
            data = b"\xb5b\x01\x07$\x00\xff" + pashr(utc, 10.0, 1.0, 2.0)
            node.send("seapath", data[:40])
            node.send("seapath", data[40:])
            if number % 20 == 1:
                ahead = pashr(utc + timedelta(seconds=30), 90.0, 0.0, 0.0)
                foreign.sendto(ahead, ("127.0.0.1", node.config.sources["seapath"].port))
        node.wait_until(lambda: len(node.received["ins/imu"]) == 100)
        values = node.wait_until(lambda: (got := node.source_status("seapath"))[2].get("lines") == "305" and got[2])
        assert values[f"other sender: 127.0.0.2:{foreign.getsockname()[1]}"] == "5"
        assert values["not of interest: binary"] == "200"
    node.send("gps", b"$INGGA,000000.16,2200.110899,S,01756.359432,W,1,12,0.7,-2.76,M,4.67,M,,*6C\r\n")
    node.wait_until(lambda: "rejected: sender that is not in 'from'" in node.source_status("gps")[2])
    assert node.exception_text() == "no exception"


class Server:
    """A TCP server of sentences."""

    def __init__(self, port):
        self.listener = socket.create_server(("127.0.0.1", port))
        self.listener.settimeout(20.0)
        self.connection, _ = self.listener.accept()

    def close(self):
        self.connection.close()
        self.listener.close()


def test_server_restart_and_lines_in_chunks(listening):
    port = free_port(socket.SOCK_STREAM)
    node = listening({"gyro": {"kind": "tcp", "address": "127.0.0.1", "port": port, "becomes": "gyro"}})
    node.wait_until(lambda: node.source_status("gyro")[1] == f"tcp 127.0.0.1:{port}: Connection refused; retried")
    server = Server(port)
    text = lines_of("HEHDT,10.0,T", "HEHDT,20.0,T")
    for place in range(0, len(text), 5):
        server.connection.sendall(text[place : place + 5])
        time.sleep(0.01)
    node.wait_until(lambda: len(node.received["reference/gyro/imu"]) == 2)
    server.connection.sendall(b"$HEHDT,30")
    server.close()
    node.wait_until(
        lambda: "closed the connection" in node.source_status("gyro")[1] or "refused" in node.source_status("gyro")[1]
    )
    server = Server(port)
    server.connection.sendall(lines_of("HEHDT,40.0,T"))
    node.wait_until(lambda: len(node.received["reference/gyro/imu"]) == 3)
    values = node.wait_until(lambda: (status := node.source_status("gyro"))[2].get("lines") == "3" and status[2])
    assert not [name for name in values if name.startswith("rejected")]
    server.close()


def test_serial_line_is_unplugged_and_plugged_in(listening, tmp_path):
    """The device is a link to a real pseudo-terminal, as udev makes one; the link does not exist at the start."""
    device = tmp_path / "ttyUSB0"
    node = listening({"gyro": {"kind": "serial", "device": str(device), "baud": 9600, "becomes": "gyro"}})
    node.wait_until(lambda: "No such file or directory" in node.source_status("gyro")[1])
    for _ in range(2):
        controller, terminal = os.openpty()
        device.symlink_to(os.ttyname(terminal))
        before = len(node.received["reference/gyro/imu"])

        def has_received(controller=controller, before=before):
            os.write(controller, lines_of("HEHDT,10.0,T")[:7])
            time.sleep(0.01)
            os.write(controller, lines_of("HEHDT,10.0,T")[7:])
            return len(node.received["reference/gyro/imu"]) > before and node.source_status("gyro")[0] != ERROR

        node.wait_until(has_received)
        device.unlink()
        os.close(controller)
        os.close(terminal)
        node.wait_until(lambda: "; retried" in node.source_status("gyro")[1])
    assert node.exception_text() == "no exception"


def start_error(tmp_path, text, *before):
    """Return the exit code of the node with a parameter file, and its error line; ``before`` precedes its command."""
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    command = [*before, sys.executable, "-c", START, "--ros-args", "--params-file", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    (line,) = done.stderr.splitlines()
    return done.returncode, line.replace(str(path), "suite.yaml")


SOURCE = "/**/nmea_in:\n  ros__parameters:\n    sources:\n      seapath:\n        becomes: ins\n"


def test_bad_input_is_one_line_with_file_line_and_parameter(tmp_path):
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", port))
        code, line = start_error(tmp_path, f"{SOURCE}        kind: udp\n        port: {port}\n")
    assert code == 2
    assert line == (
        f"nmea_in: suite.yaml:7: parameter 'sources.seapath.port' = {port}: Address already in use: another "
        "program uses it: end that program, or use another port"
    )
    code, line = start_error(tmp_path, f"{SOURCE}        kind: udp\n        port: {port}\n        address: 192.0.2.1\n")
    assert code == 2
    assert line.startswith("nmea_in: suite.yaml:8: parameter 'sources.seapath.address' = '192.0.2.1'")
    assert line.endswith("this machine has no such address")
    code, line = start_error(tmp_path, f"{SOURCE}        kind: serial\n        device: {tmp_path / 'suite.yaml'}\n")
    assert code == 2
    assert line.startswith("nmea_in: suite.yaml:7: parameter 'sources.seapath.device' =")
    assert line.endswith("not a serial device: expected for example /dev/ttyUSB0")
    code, line = start_error(tmp_path, f"{SOURCE}        kind: udp\n        prt: 10110\n")
    assert code == 2
    assert line.startswith("nmea_in: suite.yaml:7: parameter 'sources.seapath.prt' is unknown: expected one of port")
    code, line = start_error(tmp_path, "/**/nmea_in:\n  ros__parameters:\n    use_sim_time: false\n")
    assert (code, line) == (2, "nmea_in: parameter 'sources' names no source: expected one as 'sources.gyro.kind'")


def test_busy_port_of_one_source_does_not_stop_the_others(listening):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        busy = udp("gnss")
        other.bind(("127.0.0.1", busy["port"]))
        node = listening({"busy": busy, "well": udp("gyro")}, as_process=True)
        node.send("well", lines_of("HEHDT,10.0,T"))
        node.wait_until(lambda: node.received["reference/well/imu"] and node.source_status("busy")[0] == ERROR)
        assert node.source_status("busy")[1].endswith("Address already in use; retried")
    node.wait_until(lambda: "Address" not in node.source_status("busy")[1])
    expected = (
        f"nmea_in.yaml:8: parameter 'sources.busy.port' = {busy['port']}: Address already in use: another program uses "
        "it: end that program, or use another port; the others continue, and opening it is retried"
    )
    assert expected in node.log.read_text()


def test_device_without_permission(tmp_path):
    controller, terminal = os.openpty()
    device = os.ttyname(terminal)
    os.chmod(device, 0)
    # Root may open every file, unless it drops the capability.
    as_others = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
    if as_others and shutil.which("setpriv") is None:
        pytest.skip("root may open every device, and setpriv is not installed")
    code, line = start_error(tmp_path, f"{SOURCE}        kind: serial\n        device: {device}\n", *as_others)
    os.close(controller)
    os.close(terminal)
    assert code == 2
    assert line == (
        f"nmea_in: suite.yaml:7: parameter 'sources.seapath.device' = '{device}': Permission denied: not "
        "permitted: add this user to the group of the device, often 'dialout'"
    )


def resident_mb(process):
    with open(f"/proc/{process.pid}/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS:")) / 1024


def test_many_faults_at_once(listening, tmp_path):
    """Four sources have a flood, noise, a stopped server and an unplugged device; one source works."""
    tcp_port = free_port(socket.SOCK_STREAM)
    controller, terminal = os.openpty()
    device = tmp_path / "ttyUSB0"
    device.symlink_to(os.ttyname(terminal))
    node = listening(
        {
            "flooded": udp("gyro"), "noisy": udp("weather"), "well": udp("gyro"),
            "server": {"kind": "tcp", "address": "127.0.0.1", "port": tcp_port, "becomes": "gnss"},
            "device": {"kind": "serial", "device": str(device), "becomes": "gyro"},
        },
        as_process=True,
    )  # fmt: skip
    stop, rng = threading.Event(), np.random.default_rng(1)
    server = Server(tcp_port)

    def flood():
        heading, sender = lines_of("HEHDT,10.0,T"), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        while not stop.wait(0.001):  # 10 datagrams a millisecond: more than any machine processes
            for _ in range(10):
                sender.sendto(10 * heading, ("127.0.0.1", node.config.sources["flooded"].port))
        sender.close()

    sent = 0

    def run_until(happened):
        """Run until a condition holds, with 10 headings per second of the working source."""
        nonlocal sent
        end_s = time.monotonic() + 60.0
        while not happened():
            assert time.monotonic() < end_s, [node.source_status(id_) for id_ in node.config.sources]
            node.send("noisy", rng.bytes(500))
            node.send("well", lines_of("HEHDT,10.0,T"))
            sent += 1
            next_s = time.monotonic() + 0.1
            while time.monotonic() < next_s:
                node.spin()

    well = node.received["reference/well/imu"]
    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        run_until(lambda: well and int(node.source_status("flooded")[2].get("dropped", "0")) > 2000)
        # Some headings may be lost before DDS has matched both sides.
        node.wait_until(lambda: int(node.source_status("well")[2]["lines"]) == sent)
        before_mb, before, sent = resident_mb(node.process), len(well), 0
        server.close()
        device.unlink()
        os.close(controller)
        os.close(terminal)
        run_until(lambda: all("; retried" in node.source_status(id_)[1] for id_ in ("server", "device")))
        run_until(
            lambda: (
                int(node.source_status("flooded")[2]["dropped"]) > 8000 and "noise" in node.source_status("noisy")[1]
            )
        )
        assert node.source_status("flooded")[1].startswith("overflow: input faster than processing; ")
        assert node.source_status("well")[0] == OK
        node.wait_until(lambda: len(well) - before >= sent)
        assert resident_mb(node.process) - before_mb < 8.0
    finally:
        stop.set()
        flooding.join()
    assert node.exception_text() == "no exception"
    # A source has a line when its state or reason changes, at most one in each report (once a second). The thousands of
    # lines dropped add none.
    lines: dict[str, list[tuple[str, str, float]]] = {}
    for severity, stamp_s, source, text in re.findall(
        r"\[(\w+)\] \[([\d.]+)\] .*? source (\w+): (.*)", node.log.read_text()
    ):
        lines.setdefault(source, []).append((severity, re.sub(r"\d+", "", text), float(stamp_s)))
    for of_source in lines.values():
        assert all(one[:2] != other[:2] for one, other in pairwise(of_source)), of_source
        assert len(of_source) <= of_source[-1][2] - of_source[0][2] + 2.0, of_source
    assert set(lines) >= {"flooded", "noisy", "server", "device"}
    node.process.send_signal(signal.SIGTERM)
    assert node.process.wait(10.0) == 0

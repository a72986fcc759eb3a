"""The executable ``monitor``: errors in one line."""

import socket

import pytest

from ship_monitor.commands.monitor import main


@pytest.mark.live
def test_port_in_use_is_bad_input_in_one_line(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["--port", str(port)]) == 2
    assert capsys.readouterr().err == f"monitor: port {port} of 127.0.0.1 is in use: choose another one with --port\n"


def test_foxglove_port_in_use_is_bad_input_in_one_line(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["--foxglove", str(port)]) == 2
    expected = f"monitor: port {port} of 127.0.0.1 is in use: choose another one with --foxglove N\n"
    assert capsys.readouterr() == ("", expected)


def test_bag_is_not_served_to_foxglove(capsys):
    assert main(["--bag", "OUT.mcap", "--foxglove"]) == 2
    expected = "monitor: --foxglove serves a live suite: Foxglove opens OUT.mcap by itself\n"
    assert capsys.readouterr() == ("", expected)


@pytest.mark.live
def test_invalid_namespace_is_bad_input_in_one_line(capsys):
    assert main(["--namespace", "a b"]) == 2
    assert capsys.readouterr().err.startswith("monitor: '/a b' is not a namespace of ROS")


def test_unknown_key_of_the_limits_is_one_line_with_file_and_key(tmp_path, capsys):
    path = tmp_path / "limits.yaml"
    path.write_text("heading_arcsecs: 5.0\n", encoding="utf-8")
    assert main(["--limits", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(path) in error
    assert "heading_arcsecs" in error


@pytest.mark.parametrize("name", ["Europe/Olso", "Europe", "../etc/passwd", ""])
def test_invalid_time_zone_is_one_line_with_option_and_value(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--time-zone", name])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"--time-zone: {name!r} is not a time zone: use an IANA name like Europe/Oslo" in error


@pytest.mark.parametrize(
    "arguments", [["--port", "70000"], ["--port", "x"], ["--foxglove", "70000"], ["--theme", "white"]]
)
def test_bad_usage_ends_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1

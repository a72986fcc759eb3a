"""Atomic output files: no file of another program is changed, and a failure leaves no part.

Syncs run in the background without delaying the caller, and their failures are raised.
"""

import errno
import fcntl
import os
import resource
import subprocess
import sys
import threading

import pytest

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import BagWriter, TypeDefinition
from ship_bags.output_files import DiskSync, open_new, part_path, write_atomically, write_csv
from ship_node.saved_files.saved_document import DISK

NEEDS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="mounts a tiny disk in a namespace of its own: needs root")


def open_bag(path):
    return BagWriter(path, define=lambda name: TypeDefinition("string data\n", "RIHS01_0"), library="test")


def write_bag(path):
    with open_bag(path) as bag:
        bag.write_raw("topic", "std_msgs/msg/String", os.urandom(200_000), 1)


WRITERS = {
    "whole": lambda path: write_atomically(path, os.urandom(200_000)),
    "node": lambda path: DISK.write(path, os.urandom(200_000)),
    "bag": write_bag,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
class TestPart:
    def test_a_part_that_is_a_link_is_not_followed(self, tmp_path, write):
        (tmp_path / "precious").write_text("mine")
        part_path(tmp_path / "out").symlink_to(tmp_path / "precious")
        with pytest.raises((OSError, BadInput)):
            write(tmp_path / "out")
        assert (tmp_path / "precious").read_text() == "mine"
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["fifo", "folder"])
    def test_a_part_that_is_not_a_file_is_not_changed(self, tmp_path, write, make):
        make(part_path(tmp_path / "out"))
        with pytest.raises((OSError, BadInput)):
            write(tmp_path / "out")
        assert [path.name for path in tmp_path.iterdir()] == ["out.part"]

    def test_a_part_left_by_a_killed_program_is_removed(self, tmp_path, write):
        part_path(tmp_path / "out").write_bytes(b"half")
        write(tmp_path / "out")
        assert [path.name for path in tmp_path.iterdir()] == ["out"]
        assert (tmp_path / "out").stat().st_size > 200_000 - 1

    def test_a_part_locked_by_another_program_is_not_changed(self, tmp_path, write):
        with open(part_path(tmp_path / "out"), "wb") as other:
            fcntl.flock(other, fcntl.LOCK_EX)
            with pytest.raises((OSError, BadInput)):
                write(tmp_path / "out")
            assert part_path(tmp_path / "out").exists()

    def test_a_failed_write_names_the_file_and_leaves_no_part(self, tmp_path, write):
        """A limit on the length of files makes a write fail in the middle of the content, as on a full disk."""
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
        try:
            with pytest.raises(OSError, match="File too large") as caught:
                write(tmp_path / "out")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert caught.value.filename == str(tmp_path / "out")
        assert list(tmp_path.iterdir()) == []

    def test_an_interrupted_write_leaves_the_old_file(self, tmp_path, write, monkeypatch):
        (tmp_path / "out").write_text("old")

        def interrupt(number):
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / "out")
        assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("out", "old")]


def test_two_writers_of_one_name_exclude_each_other(tmp_path):
    part = tmp_path / "out.part"
    with open_new(part), pytest.raises(OSError, match=r"out\.part: another program is writing it") as caught:
        open_new(part)
    assert caught.value.errno == errno.EBUSY


@NEEDS_ROOT
def test_a_full_disk_is_reported_and_no_part_is_left(tmp_path):
    program = f"""
import sys
from pathlib import Path
from ship_bags.command_line import CommandParser, run_command
from test_output_files import WRITERS
path = Path({str(tmp_path)!r}) / "out"
for write in WRITERS.values():
    code = run_command(CommandParser(prog="test"), lambda parsed: write(path), [])
    print(code, list(path.parent.iterdir()))
"""
    mount = f"mount -t tmpfs -o size=64k tmpfs {tmp_path}; exec \"$@\""
    command = ["unshare", "-m", "--propagation", "private", "sh", "-c", mount, "sh", sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=os.path.dirname(__file__))
    assert done.stdout == "2 []\n" * 3, done.stderr
    assert done.stderr == f"test: {tmp_path}/out: No space left on device\n" * 3


def test_a_request_syncs_and_finish_waits_for_it(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with open(tmp_path / "a", "wb") as file:
        sync = DiskSync(file.fileno())
        sync.request()
        sync.finish()
        assert synced == [file.fileno()]


def test_a_slow_disk_does_not_delay_the_writer(tmp_path, monkeypatch):
    goes_on, synced = threading.Event(), []

    def slow(number):
        goes_on.wait(10)
        synced.append(number)

    monkeypatch.setattr(os, "fsync", slow)
    with open(tmp_path / "a", "wb") as file:
        sync = DiskSync(file.fileno())
        for _ in range(5):
            sync.request()
        assert synced == []
        goes_on.set()
        sync.finish()
        # Requests during the first sync are dropped: the next flush requests another sync.
        assert len(synced) == 1


def test_a_failed_sync_is_raised_by_the_next_request(tmp_path):
    with open(tmp_path / "a", "wb") as file:
        number = file.fileno()
    # The file is closed, so that a sync fails as on a failing disk.
    sync = DiskSync(number)
    sync.request()
    sync._thread.submit(lambda: None).result()
    with pytest.raises(OSError, match="Bad file descriptor"):
        sync.request()
    sync.finish()


def test_a_text_in_a_table_is_no_formula(tmp_path):
    path = write_csv(tmp_path / "table.csv", ("name", "value"), [("=1+1", -1.5), ("-2", -2), ("@a", "-3.5")])
    assert path.read_text() == "name,value\n'=1+1,-1.50000\n-2,-2\n'@a,-3.5\n"

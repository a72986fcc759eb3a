"""Syncs in the background: they happen, they never hold up the caller, their failures are told."""

import os
import threading

import pytest

from ship_bags.mcap.disk_sync import DiskSync


def test_a_request_syncs_and_finish_waits_for_it(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with open(tmp_path / "a", "wb") as file:
        sync = DiskSync(file.fileno())
        sync.request()
        sync.finish()
        assert synced == [file.fileno()]


def test_a_slow_disk_does_not_hold_up_the_writer(tmp_path, monkeypatch):
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
        # Those that came while the first one ran are made up for by the next flush.
        assert len(synced) == 1


def test_a_failed_sync_is_told_by_the_next_request(tmp_path):
    with open(tmp_path / "a", "wb") as file:
        number = file.fileno()
    # The file is closed: what the system says then stands for a disk that fails.
    sync = DiskSync(number)
    sync.request()
    sync._thread.submit(lambda: None).result()
    with pytest.raises(OSError, match="Bad file descriptor"):
        sync.request()
    sync.finish()

"""Saved documents: valid ones are read, invalid ones refused, unusable files set aside."""

import errno
import os
import socket
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_node.saved_files.saved_document import (
    DISK,
    READ_ONLY,
    DiskFiles,
    RecordingFiles,
    SavedFormat,
    finite_numbers,
    joint_covariance,
    section,
    stamp_ns,
    texts,
)
from ship_node.saved_files.saved_start import SavedStart
from ship_replay.verification.black_box_replay import RecordedFiles


@pytest.mark.parametrize(
    "rows",
    [
        [[4e-10, 1e-7], [1e-7, 2.5e-5]],  # an angle in rad with a clock offset in s
        [[0.0, 0.0], [0.0, 2.5e-5]],  # the first is held fixed
        [[2.5e-5, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
    ],
)
def test_covariances_are_read_unchanged(rows):
    assert np.array_equal(joint_covariance(rows, 2), rows)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([[1.0, 0.5], [0.4, 1.0]], "not symmetric"),
        ([[1.0, 1.1], [1.1, 1.0]], "not positive semidefinite"),
        ([[0.0, 0.1], [0.1, 1.0]], "not positive semidefinite"),  # held fixed, and still correlated
        ([[-1.0, 0.0], [0.0, 1.0]], "not positive semidefinite"),
        ([[1.0, 0.0]], "expected 2 x 2 finite numbers"),
        ([[1.0, float("nan")], [float("nan"), 1.0]], "expected 2 x 2 finite numbers"),
    ],
)
def test_other_matrices_are_refused(rows, text):
    with pytest.raises(ValueError, match=text):
        joint_covariance(rows, 2)


def read_all(document):
    return (
        section(document, "time_ns", stamp_ns),
        section(document, "serials", texts),
        section(document, "offsets", finite_numbers),
        section(document, "covariance", lambda rows: joint_covariance(rows, 2)),
    )


FORMAT = SavedFormat("test alignment", 1, "alignment", dict, read_all)
WHOLE = {"time_ns": 5, "serials": {"fore": "A1"}, "offsets": {"fore": 0.1}, "covariance": [[1.0, 0.0], [0.0, 1.0]]}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("time_ns", value) for value in ([], {}, None, "x", "1", 1.5, True, -1, 2**62, float("inf"), float("nan"))),
        *(("serials", value) for value in ([], 5, None, "x", {"fore": [1]}, {"fore": {}})),
        *(("offsets", value) for value in ([], 5, None, "x", {"a": []}, {"a": None}, {"a": "1"}, {"a": True})),
        *(("offsets", {"a": value}) for value in (float("inf"), float("nan"), 1e400)),
        *(("covariance", value) for value in ([], {}, 5, None, "x", [[1.0, 0.0]], [1.0, 2.0], [[1], [1, 2]])),
        ("covariance", [["a", "b"], ["c", "d"]]),
        *(("covariance", [[1.0, 0.0], [0.0, value]]) for value in (float("inf"), float("nan"), -1.0, {}, None, [])),
        ("covariance", [[1e308, 0.0], [0.0, 1e308]] * 2),
    ],
)
def test_a_tampered_document_is_refused_with_file_and_section(tmp_path, key, value):
    path = tmp_path / "saved.yaml"
    FORMAT.save(path, {**WHOLE, key: value})
    with pytest.raises(BadInput) as caught:
        FORMAT.load(path)
    assert str(caught.value).startswith(f"{path}: the alignment cannot be used: '{key}': ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f"time_ns: {'9' * 5000}", "saved.yaml:1: not YAML: a whole number of more than 64 bits"),
        (f"format: test alignment\ntime_ns: 0x{'f' * 5000}", "saved.yaml:2: not YAML: a whole number of more than"),
        ("time_ns: 2001-99-99", "saved.yaml:1: not YAML: month must be in 1..12"),
        ("\x00" * 3000, "saved.yaml: not YAML"),
        ("[" * 100_000, "nested too deeply"),
        ("a: &a [*a]", "nested too deeply"),
        ("a: {b: *c}", "saved.yaml:1: not YAML: found undefined alias"),
        ("? [a]\n: 1", "saved.yaml:1: not YAML: found unhashable key"),
        ("5", "not an alignment"),
        ("", "not an alignment"),
        ("format: test alignment\nversion: [" + "1, " * 500 + "]", "version [1, 1, 1, 1,"),
    ],
    ids=lambda value: value[:20],
)
def test_an_invalid_document_is_refused_in_one_line(tmp_path, text, complaint):
    path = tmp_path / "saved.yaml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        FORMAT.load(path)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_pipe_or_a_device_is_refused_immediately(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(tmp_path / "socket"))
        for path in (Path("/dev/zero"), tmp_path / "pipe", tmp_path / "socket"):
            with pytest.raises(BadInput, match=r"the alignment cannot be read: it is a pipe, a device or a socket"):
                FORMAT.load(path)
    with pytest.raises(BadInput, match="the alignment cannot be read: it is a folder: expected a file"):
        FORMAT.load(tmp_path)


def test_an_oversized_file_is_not_read_to_its_end(tmp_path):
    with open(tmp_path / "long.yaml", "wb") as long:
        long.truncate(1_000_000_000_000)
    with pytest.raises(BadInput, match="the alignment cannot be read: File too large"):
        FORMAT.load(tmp_path / "long.yaml")


@dataclass
class Content:
    """Content to start from: a time and the sigma of one angle."""

    time_ns: int = 0
    sigma: float = 1.0

    def sigmas(self):
        return {"angle": np.array([self.sigma])}


STARTS = SavedFormat(
    "test alignment",
    1,
    "alignment",
    asdict,
    lambda document: Content(section(document, "time_ns", stamp_ns), section(document, "sigma", float)),
)
WRITTEN = "format: test alignment\nversion: 1\ntime_ns: 5\nsigma: 1.0\n"
UNREADABLE = {
    "broken": "a: {b: *c}",
    "no document": "",
    "truncated": WRITTEN[:-12],
    "other version": WRITTEN.replace("version: 1", "version: 2"),
    "binary": "\udcff\udcfe",
}


def start(path, files=DISK, to_save=lambda: None):
    return SavedStart(STARTS, str(path), files, lambda content, now_ns: [], to_save, "nothing")


@pytest.mark.parametrize("text", UNREADABLE.values(), ids=UNREADABLE)
def test_an_unusable_file_is_set_aside_and_reported_until_the_next_save(tmp_path, text):
    path = tmp_path / "alignment.yaml"
    raw = text.encode(errors="surrogateescape")
    path.write_bytes(raw)
    files = RecordingFiles()
    saved = start(path, files, lambda: Content(7))
    assert not saved.is_pending
    assert str(path) in saved.unreadable_reason
    assert saved.unreadable_reason.endswith(f"; set aside as {path}.unreadable")
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {"alignment.yaml.unreadable": raw}
    # A replay of the black box gets the same reason.
    recorded = RecordedFiles(lambda difference: None)
    for use in files.uses:
        recorded.expect(use)
    assert start(path, recorded).unreadable_reason == saved.unreadable_reason
    saved.autosave()
    assert (saved.unreadable_reason, saved.autosave_problem, saved.notices) == ("", "", [])
    assert STARTS.load(path) == Content(7)


def test_a_second_unreadable_file_does_not_replace_the_first(tmp_path):
    path = tmp_path / "alignment.yaml"
    for text in ("one", "two", "three"):
        path.write_text(text)
        start(path)
    names = [path.with_name(f"alignment.yaml.unreadable{end}") for end in ("", ".2", ".3")]
    assert [name.read_text() for name in names] == ["one", "two", "three"]


def test_a_file_that_becomes_unreadable_while_the_node_runs_is_set_aside_at_the_next_save(tmp_path):
    path = tmp_path / "alignment.yaml"
    path.write_text(WRITTEN)
    saved = start(path, to_save=lambda: Content(7))
    path.write_text("broken")
    saved.autosave()
    assert STARTS.load(path) == Content(7)
    assert any("set aside" in notice for notice in saved.notices)
    assert (saved.unreadable_reason, saved.autosave_problem) == ("", "")


class CannotRename(DiskFiles):
    """Read-only disk."""

    def set_aside(self, path):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))


def test_if_renaming_fails_the_node_starts_and_overwrites_nothing(tmp_path):
    path = tmp_path / "alignment.yaml"
    path.write_text("broken")
    saved = start(path, CannotRename(), lambda: Content(7))
    assert "it cannot be renamed (Read-only file system): remove the file" in saved.unreadable_reason
    saved.autosave()
    assert saved.autosave_problem == saved.unreadable_reason
    assert path.read_text() == "broken"
    path.unlink()
    saved.autosave()
    assert (saved.autosave_problem, saved.unreadable_reason) == ("", "")


def test_read_only_files_are_not_set_aside(tmp_path):
    path = tmp_path / "alignment.yaml"
    path.write_text("broken")
    assert "set aside as" in start(path, READ_ONLY).unreadable_reason
    assert path.read_text() == "broken"


class Poor(DiskFiles):
    """Disk on which reading fails with an error number, if one is set."""

    def __init__(self, number):
        self.number = number

    def read(self, path):
        if self.number:
            raise OSError(self.number, os.strerror(self.number), str(path))
        return super().read(path)


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE, errno.ENOMEM])
def test_a_good_file_is_not_set_aside_for_lack_of_resources(tmp_path, number):
    path = tmp_path / "alignment.yaml"
    path.write_text(WRITTEN)
    with pytest.raises(BadInput, match="cannot be read"):
        start(path, Poor(number))
    assert path.read_text() == WRITTEN


NOT_OF_THE_FILE = [
    *(errno.EACCES, errno.EPERM),
    *(errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.ENODEV, errno.ENXIO),
]


@pytest.mark.parametrize("number", NOT_OF_THE_FILE)
def test_a_file_unreadable_at_the_start_stays_and_is_reported_until_readable(tmp_path, number):
    path, disk = tmp_path / "alignment.yaml", Poor(number)
    path.write_text(WRITTEN)
    saved = start(path, disk, lambda: Content(7, 2.0))
    assert not saved.is_pending
    assert saved.unreadable_reason.startswith(f"{path}: the alignment cannot be read: {os.strerror(number)}; not saved")
    saved.autosave()
    assert (saved.autosave_problem, saved.notices) == (saved.unreadable_reason, [saved.unreadable_reason])
    assert [each.read_text() for each in tmp_path.iterdir()] == [WRITTEN]
    disk.number = 0
    saved.autosave()
    assert saved.unreadable_reason == ""
    assert "has a smaller sigma of angle" in saved.autosave_problem
    assert path.read_text() == WRITTEN
    saved.save()
    assert STARTS.load(path) == Content(7, 2.0)


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENOMEM, *NOT_OF_THE_FILE])
def test_a_file_unreadable_once_at_run_time_stays(tmp_path, number):
    path, disk = tmp_path / "alignment.yaml", Poor(0)
    path.write_text(WRITTEN)
    saved = start(path, disk, lambda: Content(7))
    disk.number = number
    saved.autosave()
    assert os.strerror(number) in saved.autosave_problem
    assert [each.read_text() for each in tmp_path.iterdir()] == [WRITTEN]
    disk.number = 0
    saved.autosave()
    assert (saved.unreadable_reason, saved.autosave_problem) == ("", "")
    assert STARTS.load(path) == Content(7)


def test_a_repaired_file_is_no_longer_reported(tmp_path):
    path = tmp_path / "alignment.yaml"
    path.write_text("broken")
    saved = start(path, to_save=lambda: Content(7, 2.0))
    assert "set aside" in saved.unreadable_reason
    path.write_text(WRITTEN)
    saved.autosave()
    assert saved.unreadable_reason == ""
    assert "has a smaller sigma of angle" in saved.autosave_problem

"""What is read back of a saved document: a covariance is one, or is refused."""

from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_node.documents.saved_document import SavedFormat, finite_numbers, joint_covariance, section, stamp_ns, texts


@pytest.mark.parametrize(
    "rows",
    [
        [[4e-10, 1e-7], [1e-7, 2.5e-5]],  # an angle in rad beside a clock offset in s
        [[0.0, 0.0], [0.0, 2.5e-5]],  # the first is held fixed
        [[2.5e-5, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
    ],
)
def test_covariances_are_read_as_they_are(rows):
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
def test_mend_25_a_tampered_document_is_one_line_that_names_file_and_section(tmp_path, key, value):
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
def test_mend_25_what_is_no_document_is_one_line(tmp_path, text, complaint):
    path = tmp_path / "saved.yaml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        FORMAT.load(path)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_mend_25_a_file_without_end_is_not_read_to_its_end(tmp_path):
    with pytest.raises(BadInput, match="/dev/zero: the alignment cannot be read: File too large"):
        FORMAT.load(Path("/dev/zero"))

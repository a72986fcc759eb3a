"""The golden table of replays (tools/golden.py): on this processor as on the one that wrote it."""

import pytest

from tools import golden


@pytest.mark.slow
@pytest.mark.parametrize("name", golden.NAMES)
def test_replays_publish_the_numbers_of_the_golden_table(name, tmp_path):
    if name == golden.RECORDED and not golden.SHIP_LOGS.is_dir():
        pytest.skip(f"the ship's records are not here: {golden.SHIP_LOGS}")
    blocks, single = (golden.replayed_rows(name, one_by_one, tmp_path) for one_by_one in (False, True))
    assert list(golden.differences(blocks, single, 0.0)) == []
    assert list(golden.differences(golden.table()[name], blocks, golden.TOLERANCE)) == []


def test_each_kind_of_difference_is_named():
    row = {"messages": 10, "finite": 90, "sum": 1000.0, "sha256": "00"}
    wanted = dict.fromkeys(("same", "fewer", "absent", "last_bit", "other", "nan", "not_finite"), row)
    found = {
        "same": row,
        "fewer": row | {"messages": 9},
        "added": row,
        "last_bit": row | {"sha256": "01", "sum": 1000.0 * (1.0 + 1e-13)},
        "other": row | {"sha256": "01", "sum": 1000.001},
        "nan": row | {"sha256": "01", "sum": float("nan")},
        "not_finite": row | {"sha256": "01", "finite": 89},
    }
    expected = ["absent", "added", "fewer", "nan", "not_finite", "other"]
    assert [line.partition(":")[0] for line in golden.differences(wanted, found, golden.TOLERANCE)] == expected
    strict = [line.partition(":")[0] for line in golden.differences(wanted, found, 0.0)]
    assert strict == sorted([*expected, "last_bit"])

"""Bags in bags/: their scenarios, their reproducibility, and the bounds of a replay of them."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT
from ship_replay.evaluation.bounds import check_bounds, read_bounds
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.offline.replay import ADAPTERS, replay

ROOT = Path(__file__).parents[1]
BAGS = sorted((ROOT / "bags").glob("*.mcap"))
MAKE_BAGS = ROOT / "tools" / "make_bags.py"
SIZE_LIMIT_BYTES = 3_000_000

DIAGNOSES = {
    "demo": ["clocks", "verdict star.fore", "verdict star.starboard"],
    "theodolite": ["clocks", "verdict lights"],
}
"""Bag → sources and models with an innovation diagnosis."""

every_bag = pytest.mark.parametrize("path", BAGS, ids=lambda path: path.stem)


def sums() -> dict[str, str]:
    """Return file name → sha256 of bags/SHA256SUMS."""
    lines = (ROOT / "bags" / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    return {name: value for value, name in (line.split("  ") for line in lines)}


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_there_is_a_bag_of_the_ship_and_one_of_the_theodolite_and_a_sum_for_each():
    assert [path.stem for path in BAGS] == ["demo", "theodolite"]
    assert sorted(sums()) == [path.name for path in BAGS]


@every_bag
def test_a_bag_is_small_and_fits_its_sum_and_scenario(path):
    assert path.stat().st_size < SIZE_LIMIT_BYTES
    assert sha256(path) == sums()[path.name]
    with read_bag(path) as bag:
        scenario_path = ROOT / "bags" / "scenarios" / f"{path.stem}.yaml"
        assert bag.attachments[SCENARIO_ATTACHMENT] == scenario_path.read_bytes()
        assert SUITE_ATTACHMENT in bag.attachments
        assert sum(1 for _ in bag.records()) == bag.message_count > 0
        assert bag.problems == []


@pytest.fixture(scope="module", params=BAGS, ids=lambda path: path.stem)
def replayed_bag(request, tmp_path_factory) -> tuple[Path, Path, list[str]]:
    """Return a bag, its outputs of an offline replay, and the problems that the replay reported."""
    out = tmp_path_factory.mktemp("replayed") / "out.mcap"
    return request.param, out, replay(request.param, out, ADAPTERS).problems


@pytest.mark.slow
def test_an_offline_replay_meets_the_bounds(replayed_bag):
    path, out, problems = replayed_bag
    assert problems == []
    bounds = read_bounds(path.with_suffix(".expected.yaml"))
    checked = check_bounds(evaluate(out, path, bounds.skip_s).quantities(), bounds, path.name)
    assert checked
    assert [bound.line for bound in checked if not bound.is_met] == []


@pytest.mark.slow
def test_clean_data_cause_no_exclusion(replayed_bag):
    path, out, _ = replayed_bag
    statuses: dict[str, list[tuple[int, str]]] = {}
    with read_bag(out) as bag:
        for record in bag.records(["/diagnostics"]):
            for status in record.decode().status:
                thing = status.name.partition(": ")[2]
                if thing.startswith("verdict ") or thing == "clocks":
                    statuses.setdefault(thing, []).append((int(status.level), status.message))
    assert sorted(statuses) == DIAGNOSES[path.stem]
    for name, history in statuses.items():
        assert {level for level, _ in history} == {0}
        assert history[-1][1].startswith("within configured limits" if name == "clocks" else "as stated")
        assert len(history) > 100


@pytest.mark.slow
def test_the_bags_can_be_made_again(tmp_path):
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        command = [sys.executable, str(MAKE_BAGS), "--out", str(tmp_path / folder)]
        subprocess.run(command, check=True, capture_output=True)
    for path in BAGS:
        assert sha256(tmp_path / "first" / path.name) == sha256(tmp_path / "second" / path.name), path.name
        # Sines of numpy differ in the last bit from one kind of processor to another, so the bytes of a bag differ too.
        assert largest_difference(tmp_path / "first" / path.name, path) < 1e-12, path.name


def largest_difference(first: Path, second: Path) -> float:
    """Return the largest relative difference of two bags' numbers; infinite if anything else differs."""
    largest = 0.0
    with read_bag(first) as one, read_bag(second) as other:
        if one.attachments != other.attachments or one.metadata != other.metadata:
            return float("inf")
        for left, right in zip(one.records(), other.records(), strict=True):
            if (left.topic, left.log_time_ns) != (right.topic, right.log_time_ns):
                return float("inf")
            if left.data != right.data:
                largest = max(largest, difference(left.decode(), right.decode()))
    return largest


def difference(left, right) -> float:
    """Return the largest difference of two messages' numbers: absolute for numbers below 1, relative above.

    The difference is infinite if anything else differs.
    """
    if hasattr(left, "__dataclass_fields__"):
        return max((difference(getattr(left, n), getattr(right, n)) for n in left.__dataclass_fields__), default=0.0)
    if isinstance(left, list | tuple) and len(left) == len(right):
        return max((difference(a, b) for a, b in zip(left, right, strict=True)), default=0.0)
    if isinstance(left, float | np.ndarray) and np.shape(left) == np.shape(right):
        gap = np.abs(np.subtract(left, right)) / np.maximum(1.0, np.abs(left))
        both_nan = np.isnan(left) & np.isnan(right)
        return float(np.max(np.where(both_nan, 0.0, gap), initial=0.0))
    return 0.0 if left == right else float("inf")

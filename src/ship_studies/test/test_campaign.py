"""Campaigns: keys of items, results that survive a kill, and tables that do not depend on the workers."""

import csv
import dataclasses
import json
import logging
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from distributed import LocalCluster

from ship_bags.provenance import folder_sha256
from ship_replay.commands.evaluate import main as evaluate
from ship_replay.commands.replay import main as replay
from ship_simulation.simulate_command import main as simulate
from ship_studies.campaign.campaign_command import main
from ship_studies.campaign.items import (
    PAGE,
    TABLE,
    ResultFolder,
    campaign_items,
    csv_table,
    failed_result,
    parse_seeds,
    run_item,
)
from ship_studies.campaign.page import page, pools, worst_items
from ship_studies.campaign.workers import MAX_WORKER_FAILURES, run_in_cluster, run_in_processes
from ship_testing.campaign_items import dies_always, dies_once, dies_once_while_sending
from ship_testing.short_scenario import SHORT

SUITE = """\
/**/ship_attitude:
  ros__parameters:
    star_sensors: {fore: {azimuth_deg: 10.0, elevation_deg: 45.0}}
"""
TIMEOUT_S = 120.0


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("campaign") / "short.yaml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def by_one(scenario):
    """The folder of a campaign of three seeds run by one worker."""
    folder = scenario.parent / "by_one"
    assert main([str(scenario), "--seeds", "1-3", "--workers", "1", "--out", str(folder)]) == 0
    return folder


def files_of(folder):
    """Name → bytes of everything in a campaign's folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


class TestKeys:
    @pytest.fixture
    def inputs(self, tmp_path):
        (tmp_path / "voyage.yaml").write_text(SHORT)
        (tmp_path / "suite.yaml").write_text(SUITE)
        (tmp_path / "voyage.mcap").write_bytes(b"a voyage")
        return tmp_path

    def key(self, folder, source="voyage.yaml", seeds=(1,), **others):
        (item,) = campaign_items([folder / source], [folder / "suite.yaml"], seeds, **others)
        return item.key

    @pytest.mark.parametrize("name", ["voyage.yaml", "suite.yaml", "voyage.mcap"])
    def test_contents_are_in_the_key(self, inputs, name):
        sources = "voyage.yaml", "voyage.mcap"
        before = [self.key(inputs, source) for source in sources]
        with (inputs / name).open("a") as stream:
            stream.write("\n")
        after = [self.key(inputs, source) for source in sources]
        changed = [old != new for old, new in zip(before, after, strict=True)]
        assert changed == [name in ("suite.yaml", source) for source in sources]

    @pytest.mark.parametrize("change", [{"seeds": (2,)}, {"skip_s": 1.0}, {"source": "voyage.mcap"}])
    def test_seed_and_start_are_in_the_key(self, inputs, change):
        assert self.key(inputs, **change) != self.key(inputs)

    def test_the_namespace_is_in_the_key_of_a_bag_alone(self, inputs):
        assert self.key(inputs, "voyage.mcap", namespace="ship") != self.key(inputs, "voyage.mcap")
        assert self.key(inputs, namespace="ship") == self.key(inputs)

    def test_no_parameter_set_is_another_key(self, inputs):
        (item,) = campaign_items([inputs / "voyage.yaml"], [], [1])
        assert item.key != self.key(inputs)

    def test_the_code_is_in_the_key(self, inputs):
        (item,) = campaign_items([inputs / "voyage.yaml"], [], [1])
        assert dataclasses.replace(item, code="another").key != item.key

    def test_the_code_is_its_source_files_wherever_they_lie(self, inputs):
        (inputs / "code" / "room").mkdir(parents=True)
        (inputs / "code" / "room" / "one.py").write_text("1\n")
        code = folder_sha256(inputs / "code", "package")
        shutil.copytree(inputs / "code", inputs / "elsewhere")
        assert folder_sha256(inputs / "elsewhere", "package") == code
        (inputs / "code" / "room" / "one.pyc").write_bytes(b"compiled")
        assert folder_sha256(inputs / "code", "package") == code
        (inputs / "elsewhere" / "room" / "one.py").write_text("2\n")
        assert folder_sha256(inputs / "elsewhere", "package") != code

    def test_names_and_times_of_files_are_not_in_the_key(self, inputs, tmp_path):
        other = tmp_path / "elsewhere"
        other.mkdir()
        for name, new in (("voyage.yaml", "renamed.yaml"), ("suite.yaml", "suite.yaml")):
            (other / new).write_bytes((inputs / name).read_bytes())
        os.utime(inputs / "voyage.yaml", (1.0, 1.0))
        assert self.key(other, "renamed.yaml") == self.key(inputs)

    def test_a_recording_that_a_scenario_follows_is_in_the_key(self, inputs):
        (inputs / "ride.yaml").write_text(
            'start_utc: "2014-07-09T11:50:07.8Z"\nduration_s: 4.0\n'
            "carrier: {kind: recorded, recording: {bag: voyage.mcap}}\n"
        )
        before = self.key(inputs, "ride.yaml")
        (inputs / "voyage.mcap").write_bytes(b"another voyage")
        assert self.key(inputs, "ride.yaml") != before

    def test_an_item_whose_file_was_changed_meanwhile_fails(self, inputs):
        (item,) = campaign_items([inputs / "voyage.mcap"], [], [])
        (inputs / "voyage.mcap").write_bytes(b"another voyage")
        ((_, result),) = run_in_processes(run_item, [item], 1)
        assert result["error"] == f"{inputs}/voyage.mcap: has changed since the campaign began"


@pytest.mark.parametrize(
    ("text", "seeds"), [("7", [7]), ("1-3", [1, 2, 3]), ("5,1-2,2", [5, 1, 2]), ("0", [0]), ("3-3", [3])]
)
def test_seeds(text, seeds):
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "1-", "-1", "3-1", "1.5", "a", "1,,2"])
def test_what_are_no_seeds(text):
    with pytest.raises(ValueError, match=r"not seeds|before it begins"):
        parse_seeds(text)


class TestResults:
    def test_a_row_equals_the_output_of_the_commands(self, by_one, scenario, tmp_path, capsys):
        """The numbers are those of simulate, replay and evaluate, run one after another."""
        given, out, values = tmp_path / "in.mcap", tmp_path / "out.mcap", tmp_path / "values.json"
        assert simulate([str(scenario), "--out", str(given), "--seed", "2"]) == 0
        assert replay([str(given), "--out", str(out)]) == 0
        assert evaluate([str(out), "--against", str(given), "--json", str(values)]) == 0
        expected = json.loads(values.read_text())
        with (by_one / TABLE).open(newline="") as stream:
            row = list(csv.DictReader(stream))[1]
        assert (row["source"], row["parameters"], row["seed"], row["error"]) == (str(scenario), "as attached", "2", "")
        assert len(expected) > 50
        assert {name: row[name] for name in expected} == {
            name: "" if value is None else repr(value) for name, value in expected.items()
        }
        printed = capsys.readouterr().out
        outputs = sum(int(row[name]) for name in row if name.startswith("status.ship/attitude."))
        assert f"{outputs} outputs" in printed or f"of {outputs} outputs" in printed

    def test_two_workers_give_the_same_bytes(self, by_one, scenario, tmp_path):
        assert main([str(scenario), "--seeds", "1-3", "--workers", "2", "--out", str(tmp_path / "two")]) == 0
        assert files_of(tmp_path / "two") == files_of(by_one)

    def test_a_second_run_makes_only_what_is_missing(self, by_one, scenario, tmp_path, capsys):
        folder = tmp_path / "again"
        shutil.copytree(by_one, folder)
        kept, lost, *_ = sorted((folder / "results").iterdir())
        lost.unlink()
        before = kept.stat().st_mtime_ns
        assert main([str(scenario), "--seeds", "1-3", "--out", str(folder)]) == 0
        assert "3 items: 2 results exist, 1 to run" in capsys.readouterr().out
        assert kept.stat().st_mtime_ns == before
        assert files_of(folder) == files_of(by_one)

    def test_equal_contents_under_two_names_are_made_once(self, by_one, scenario, tmp_path, capsys):
        other = tmp_path / "renamed.yaml"
        other.write_bytes(scenario.read_bytes())
        shutil.copytree(by_one / "results", tmp_path / "out" / "results")
        assert main([str(other), str(scenario), "--seeds", "1-3", "--out", str(tmp_path / "out")]) == 0
        assert "6 items: 3 results exist, 0 to run" in capsys.readouterr().out
        rows = (tmp_path / "out" / TABLE).read_text().splitlines()
        assert len(rows) == 7
        assert {row.split(",", 1)[1] for row in rows[1:4]} == {row.split(",", 1)[1] for row in rows[4:]}

    def test_a_damaged_result_is_named(self, by_one, scenario, tmp_path, capsys):
        shutil.copytree(by_one, tmp_path / "out")
        path = min((tmp_path / "out" / "results").iterdir())
        path.write_text("{")
        assert main([str(scenario), "--seeds", "1-3", "--out", str(tmp_path / "out")]) == 2
        assert capsys.readouterr().err == f"campaign: {path}: is not a result of a campaign: remove it\n"

    def test_an_item_that_fails_is_a_row_and_is_made_again(self, scenario, tmp_path, capsys):
        bad = tmp_path / "bad.mcap"
        bad.write_bytes(b"no bag")
        arguments = [str(bad), str(scenario), "--out", str(tmp_path / "out")]
        assert main(arguments) == 1
        printed = capsys.readouterr().out
        assert f"failed: {bad}, as attached: {bad}: " in printed
        with (tmp_path / "out" / TABLE).open(newline="") as stream:
            rows = {row["source"]: row for row in csv.DictReader(stream)}
        assert rows[str(bad)]["error"].startswith(f"{bad}: ")
        assert rows[str(bad)]["fused.samples"] == ""
        assert rows[str(scenario)]["error"] == ""
        assert rows[str(scenario)]["fused.samples"] != ""
        assert rows[str(bad)]["error"].partition(": ")[2] in (tmp_path / "out" / PAGE).read_text()
        assert main(arguments) == 1
        assert "2 items: 1 results exist, 1 to run" in capsys.readouterr().out


class TestKilled:
    def make_all(self, make, scenario, tmp_path, workers=2):
        path = tmp_path / "short.yaml"
        shutil.copy(scenario, path)
        made = list(run_in_processes(make, campaign_items([path], [], range(1, 5)), workers))
        return {item.seed: result for item, result in made}

    @pytest.mark.parametrize("make", [dies_once, dies_once_while_sending])
    def test_the_item_of_a_killed_worker_is_made_again(self, make, scenario, tmp_path):
        found = self.make_all(make, scenario, tmp_path)
        assert (tmp_path / "died").exists()
        assert {seed: (result["error"], result["values"]["seed"]) for seed, result in found.items()} == {
            seed: (None, float(seed)) for seed in range(1, 5)
        }

    @pytest.mark.parametrize("workers", [1, 2])
    def test_an_item_that_kills_its_worker_each_time_fails_alone(self, scenario, tmp_path, workers):
        found = self.make_all(dies_always, scenario, tmp_path, workers)
        folders = (tmp_path / "deaths").read_text().splitlines()
        assert len(folders) == MAX_WORKER_FAILURES
        assert not any(Path(folder).exists() for folder in folders)
        assert {seed: result["error"] for seed, result in found.items()} == {
            1: None, 2: f"its worker died {MAX_WORKER_FAILURES} times, the last time with signal 9", 3: None, 4: None,
        }  # fmt: skip

    @pytest.mark.slow
    def test_a_worker_killed_from_outside_loses_nothing(self, by_one, scenario, tmp_path):
        with Command(scenario, tmp_path / "out") as command:
            os.kill(command.a_worker(), signal.SIGKILL)
            assert command.process.wait(TIMEOUT_S) == 0
        assert files_of(tmp_path / "out") == files_of(by_one)

    @pytest.mark.slow
    def test_ctrl_c_keeps_what_is_made(self, by_one, scenario, tmp_path, capsys):
        results = tmp_path / "out" / "results"
        with Command(scenario, tmp_path / "out", "--workers", "1") as command:
            wait_until(lambda: results.exists() and list(results.glob("*.json")))
            worker = command.a_worker()
            os.killpg(command.process.pid, signal.SIGINT)
            assert command.process.wait(TIMEOUT_S) == 130
            assert command.process.stderr.read() == "campaign: interrupted\n"
        wait_until(lambda: not Path(f"/proc/{worker}").exists())
        kept = len(list(results.iterdir()))
        assert 1 <= kept <= 2
        assert main([str(scenario), "--seeds", "1-3", "--out", str(tmp_path / "out")]) == 0
        assert f"3 items: {kept} results exist" in capsys.readouterr().out
        assert files_of(tmp_path / "out") == files_of(by_one)


class Command:
    """The command over three seeds, as a process in a group of its own."""

    def __init__(self, scenario, folder, *options):
        code = "import sys; from ship_studies.campaign.campaign_command import main; sys.exit(main())"
        arguments = [sys.executable, "-c", code, str(scenario), "--seeds", "1-3", "--out", str(folder), *options]
        self.process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()

    def a_worker(self):
        """Return the process id of a worker: a child of the fork server, which is a child of the command."""
        return wait_until(
            lambda: next(
                (
                    worker
                    for child in children(self.process.pid)
                    if "forkserver" in Path(f"/proc/{child}/cmdline").read_text()
                    for worker in children(child)
                ),
                None,
            )
        )


def children(pid):
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def wait_until(found):
    """Return the result of a function as soon as it is not empty."""
    end_s = time.monotonic() + TIMEOUT_S
    while not (value := found()):
        assert time.monotonic() < end_s
        time.sleep(0.01)
    return value


@pytest.fixture(scope="module")
def address():
    """Address of a Dask cluster of two worker processes on this machine."""
    place = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=2, threads_per_worker=1, silence_logs=logging.CRITICAL, **place) as cluster:
        yield cluster.scheduler_address


class TestCluster:
    @pytest.mark.slow
    def test_a_dask_cluster_gives_the_same_bytes(self, by_one, scenario, tmp_path, address):
        arguments = [str(scenario), "--seeds", "1-3", "--scheduler", address, "--out", str(tmp_path / "out")]
        assert main(arguments) == 0
        assert files_of(tmp_path / "out") == files_of(by_one)

    def test_the_item_of_a_killed_worker_is_made_again(self, scenario, tmp_path, address):
        path = tmp_path / "short.yaml"
        shutil.copy(scenario, path)
        made = list(run_in_cluster(dies_once, campaign_items([path], [], range(1, 5)), address))
        assert (tmp_path / "died").exists()
        assert sorted((item.seed, result["error"], result["values"]["seed"]) for item, result in made) == [
            (seed, None, float(seed)) for seed in range(1, 5)
        ]

    def test_without_dask_one_line_names_the_package(self, scenario, tmp_path, capsys, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        arguments = [str(scenario), "--scheduler", "tcp://127.0.0.1:1", "--out", str(tmp_path / "out")]
        assert main(arguments) == 2
        expected = "--scheduler needs dask.distributed: install it with pip install distributed"
        assert capsys.readouterr().err == f"campaign: {expected}\n"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["{short}", "--seeds", "5-1"], "'5-1' contains a range that ends before it begins"),
        (["{short}", "--workers", "0"], "'0' is not a whole number, 1 or more"),
        (["{short}", "--workers", "1", "--scheduler", "tcp://a:1"], "not allowed with argument"),
        (["nothing.mcap"], "nothing.mcap: No such file or directory"),
        (["nothing.yaml"], "nothing.yaml"),
        (["{short}", "--skip", "-1"], "--skip -1: expected 0 s or more"),
        (["{short}", "--config", "nothing.yaml"], "nothing.yaml"),
        (["{bag}", "--seeds", "1-2"], "--seeds needs scenarios (.yaml), but there is none"),
    ],
)
def test_bad_usage_is_one_line_and_two(arguments, complaint, scenario, tmp_path, capsys):
    bag = tmp_path / "voyage.mcap"
    bag.write_bytes(b"a voyage")
    given = [argument.format(short=scenario, bag=bag) for argument in arguments]
    try:
        code = main([*given, "--out", str(tmp_path / "out")])
    except SystemExit as left:
        code = left.code
    assert code == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


class TestPooled:
    """Results made by hand: 100 samples of 3″ and 300 of 5″, equivalent to 10 and 30 independent ones; a failed one."""

    @pytest.fixture
    def results(self, scenario):
        items = campaign_items([scenario], [], [1, 2, 3])
        return [
            (items[0], self.result(samples=100.0, rms=3.0, sigma=2.0, nees=6.0, independent=10.0, valid=90)),
            (items[1], self.result(samples=300.0, rms=5.0, sigma=5.0, nees=2.0, independent=30.0, valid=10)),
            (items[2], failed_result("no bag")),
        ]

    def result(self, samples, rms, sigma, nees, independent, valid):
        channel = {"heading.rms_arcsec": rms, "heading.sigma_arcsec": sigma, "heading.rms_over_sigma": rms / sigma}
        nees_values = {"nees_mean": nees, "nees_count": samples, "nees_independent": independent}
        return {
            "error": None,
            "errors": {"fused": {"channels": ["heading"], "samples": samples, **channel, **nees_values}},
            "values": {},
            "statuses": {"ship/attitude": {"VALID": valid, "COASTING": 100 - valid}},
            "refused": {"ins/imu": {"gate": 2, "stale": 1}},
        }

    def test_errors_statuses_and_rejections_by_hand(self, results):
        (pool,) = pools(results, lambda item: item.parameters_name)
        assert (pool.name, pool.items, pool.failed, pool.refused) == ("as attached", 2, 1, 6)
        (fused,) = pool.errors
        (heading,) = fused.channels
        assert heading.rms_arcsec == pytest.approx(math.sqrt((100 * 9 + 300 * 25) / 400))
        assert heading.sigma_arcsec == pytest.approx(math.sqrt((100 * 4 + 300 * 25) / 400))
        # The mean of 10 values of 6 and 30 values of 2. The band of the mean of 40 values with three degrees of freedom
        # is that of chi-square with 120 (scipy's chdtri).
        assert fused.fit.mean == pytest.approx(3.0)
        assert fused.fit.independent == 40.0
        assert fused.band == pytest.approx((75.46653 / 40, 177.60290 / 40), rel=1e-6)
        assert "as stated" in fused.fit.words
        assert pool.shares == {"ship/attitude": {"VALID": 0.5, "COASTING": 0.5}}

    def test_a_missing_sigma_is_not_made_up(self, results):
        results[0][1]["errors"]["fused"] |= {"heading.sigma_arcsec": None, "heading.rms_over_sigma": None}
        (pool,) = pools(results, lambda item: item.parameters_name)
        assert math.isnan(pool.errors[0].channels[0].sigma_arcsec)
        assert pool.errors[0].channels[0].rms_arcsec > 0.0

    def test_the_worst_come_first(self, results):
        assert [(item.seed, ratio) for item, *_, ratio in worst_items(results)] == [(1, 1.5), (2, 1.0)]

    def test_the_order_of_completion_has_no_effect(self, results):
        assert csv_table(results[::-1]) == csv_table(results)
        assert page(results[::-1]) == page(results)


def test_a_result_of_another_item_is_refused(scenario, tmp_path):
    one, two = campaign_items([scenario], [], [1, 2])
    folder = ResultFolder(tmp_path / "out")
    folder.save(one, failed_result("") | {"error": None})
    folder.path(one).rename(folder.path(two))
    assert folder.result(one) is None
    with pytest.raises(ValueError, match="is the result of another item"):
        folder.result(two)

"""Voyages with faults: what is drawn, how it is judged, and that a killed run goes on."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_replay.trials.fault_judge import EXCLUSION, Passage, Told, VoyageSink, is_source, judged
from ship_replay.trials.fault_results import ResultsFile, kind_rows, pair_rows, totals
from ship_replay.trials.fault_voyage import Voyage, clean_voyage, make_bag, replayed, run_voyage, voyages
from ship_replay.trials.one_fault import one_fault_lines
from ship_replay.trials.threats import BY_FORM, DATA_LIKE, OVERLAPPING, SINGLE, draw_faults
from ship_simulation.draws.noise import random_stream
from ship_simulation.scenario.fault import Fault, size_problems
from ship_simulation.scenario.fault_file import fault_problems
from ship_simulation.scenario.names import simulated_topics
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.places import ROOT

SCENARIOS = ROOT / "bags" / "scenarios"
KNOCK = "topic: star/fore/horizon_attitude, kind: knock, start_s: 20, end_s: 30, up_arcsec: 300"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Forty seconds of the demonstration."""
    return make_bag(SCENARIOS / "demo.yaml", 40.0, 1, tmp_path_factory.mktemp("bags") / "demo_1.mcap")


@pytest.fixture(scope="module")
def topics():
    return simulated_topics(load_scenario(SCENARIOS / "everything.yaml"))


def drawn(topics, number, mode, length_s=180.0):
    return draw_faults(topics, length_s, mode, 60.0, random_stream(number, "test"))


@pytest.mark.parametrize("mode", [SINGLE, OVERLAPPING])
def test_what_is_drawn_repeats_and_can_happen(topics, mode):
    for number in range(200):
        found = drawn(topics, number, mode)
        assert found == drawn(topics, number, mode)
        assert 1 <= len(found) <= 5
        faults = {f"f{i}": one.fault for i, one in enumerate(found)}
        assert list(fault_problems(faults, topics, "there")) == []
        assert [p for key, fault in faults.items() for p in size_problems(key, fault)] == []


def test_single_faults_leave_time_to_return(topics):
    for number in range(200):
        found = [one.fault for one in drawn(topics, number, SINGLE, 600.0)]
        assert all(later.start_s >= before.end_s + 60.0 for before, later in pairwise(found))


def test_every_threat_is_drawn_on_everything(topics):
    labels = {one.threat.label for number in range(1500) for one in drawn(topics, number, OVERLAPPING)}
    fed_by_the_filter = {"ship step", "ship drift", "ship frozen"}
    assert labels == {threat.label for threat in DATA_LIKE + BY_FORM} - fed_by_the_filter


def test_bags_and_modes_take_turns():
    found = voyages([Path("a"), Path("b")], 6)
    assert [(v.bag.name, v.mode) for v in found] == [
        ("a", SINGLE), ("b", SINGLE), ("a", OVERLAPPING), ("b", OVERLAPPING), ("a", SINGLE), ("b", SINGLE)
    ]  # fmt: skip


def told_of(claims=(), not_valid=(), signs=()):
    """What was told, times in s after the start at 0."""
    ns = NS_PER_S
    return Told(
        claims=[("ship/attitude", round(t * ns), round(t * ns), sigmas, level) for t, sigmas, level in claims],
        not_valid=[("ship/attitude", round(t * ns), round(t * ns), 2) for t in not_valid],
        signs=[(source, round(t * ns), round(t * ns), reason) for source, t, reason in signs],
    )


FAULT = Fault(topic="ins/imu", kind="bias", start_s=10.0, end_s=20.0, up_arcsec=30.0)


def verdict(told, clean=None, until_s=60.0):
    """The first message that the fault hits comes at 10.02 s, the next ones every 0.1 s."""
    arrivals_ns = np.arange(round(0.02 * NS_PER_S), 60 * NS_PER_S, NS_PER_S // 10)
    return judged(FAULT, told, Passage(clean or told_of(), {"ins/imu": arrivals_ns}, 0, 60 * NS_PER_S), until_s)


def test_what_a_fault_hits_and_how_soon_it_must_be_told():
    times_ns = {"ins/imu": np.arange(60) * NS_PER_S, "met/pressure": np.array([0])}
    flight = Passage(told_of(), times_ns, 0, 60 * NS_PER_S)
    assert (flight.hits(FAULT) / NS_PER_S).tolist() == list(range(10, 20))
    assert flight.alert_limit_s(FAULT) == 3.0
    pressure = Fault(topic="met/pressure", kind="drop", start_s=10.0)
    assert flight.hits(pressure).size == 0
    assert flight.alert_limit_s(pressure) == 1.0


def test_a_fault_is_told_by_a_status_or_by_its_name_within_its_time():
    assert not verdict(told_of()).detected
    found = verdict(told_of(not_valid=[10.5]))
    assert (found.detected, found.attributed, round(found.alert_s, 2)) == (True, False, 0.48)
    found = verdict(told_of(signs=[("ins", 10.1, "gate"), ("ins", 10.2, "gate")]))
    assert (found.detected, found.attributed, round(found.alert_s, 2)) == (True, True, 0.08)
    # Another source's name alone is no alert of the faulty one, and after the time nothing is.
    assert not verdict(told_of(signs=[("star.bow", 10.1, "gate")])).detected
    assert not verdict(told_of(not_valid=[23.1], signs=[("ins", 23.1, "gate")])).detected


def test_what_the_voyage_says_without_faults_is_no_sign():
    signs, not_valid = [("ins", 12.0, "gate")], [15.0, 15.5]
    clean = told_of(not_valid=not_valid, signs=signs)
    assert not verdict(told_of(not_valid=[15.3], signs=signs), clean).detected
    assert verdict(told_of(not_valid=[14.4], signs=signs), clean).detected


def test_who_is_excluded_counts_before_who_was_refused():
    refused = [("star.bow", 10.1 + 0.1 * i, "gate") for i in range(5)]
    assert not verdict(told_of(signs=[*refused, ("ins", 11.0, "gate"), ("ins", 11.1, "gate")])).attributed
    assert verdict(told_of(signs=[*refused, ("ins", 11.0, EXCLUSION)])).attributed
    assert not verdict(told_of(signs=[("ins", 11.0, EXCLUSION), ("star.bow", 12.0, EXCLUSION)])).attributed


def test_claims_beyond_five_sigmas_are_counted_until_the_next_fault():
    claims = [(t / 10.0, 6.0 if 300 <= t < 325 or 400 <= t < 410 else 1.0, 0.5) for t in range(100, 600)]
    found = verdict(told_of(claims=claims))
    assert (found.worst_sigmas, found.beyond_s, found.longest_beyond_s) == (6.0, pytest.approx(3.5), pytest.approx(2.5))
    assert verdict(told_of(claims=claims), until_s=30.0).beyond_s == 0.0
    assert found.worst_over_level == 0.5
    assert math.isnan(verdict(told_of(claims=[(11.0, 1.0, math.nan)])).worst_over_level)


@pytest.mark.parametrize(
    ("topic", "own", "other"),
    [
        ("ins/imu", "ins", "star.ins"),
        ("star/fore/observations", "star.fore", "star.aft"),
        ("reference/gyro/imu", "reference.gyro", "ins"),
        ("beacon/a/baseline", "light.a", "light.b"),
        ("theodolite/beacons", "lights", "baseline.a"),
        ("theodolite/encoder", "encoder", "ship"),
        ("ship/attitude", "ship", "ins"),
        ("ship/attitude", "ship_attitude", "ins"),
        ("gnss/fix", "gnss/fix", "ins"),
    ],
)
def test_the_names_of_the_device_behind_a_topic(topic, own, other):
    assert is_source(own, topic)
    assert not is_source(other, topic)


def test_levels_and_exclusions_are_those_of_the_last_integrity_message():
    class Message:
        def __init__(self, **fields):
            self.__dict__ |= fields

    stamp = Message(sec=1, nanosec=0)
    sink = VoyageSink({})
    for excluded in ([], ["ins"], ["ins"], [], ["ins"]):
        integrity = Message(header=Message(stamp=stamp), protection_level=[1e-4] * 3, excluded=excluded)
        sink.write("ship/integrity", integrity, 5)
    assert [sign[0] for sign in sink.told.signs] == ["ins", "ins"]


def test_a_voyage_is_judged_and_repeats(bag):
    voyage = Voyage(5, bag, OVERLAPPING)
    clean = clean_voyage(bag)
    first, again = run_voyage(voyage, clean), run_voyage(voyage, clean)
    assert first.pop("elapsed_s") > 0.0
    again.pop("elapsed_s")
    assert first == again
    assert first["exception"] == ""
    assert all(fault["worst_sigmas"] >= 0.0 for fault in first["faults"])
    json.dumps(first, allow_nan=False)


def test_an_exception_is_told_and_its_faults_with_it(bag, monkeypatch):
    clean = clean_voyage(bag)
    monkeypatch.setattr(VoyageSink, "write", lambda *_: 1 / 0)
    result = run_voyage(Voyage(5, bag, SINGLE), clean)
    assert "ZeroDivisionError" in result["exception"]
    assert result["faults"]
    assert not totals([result]).sound
    assert "ZeroDivisionError" in "\n".join(totals([result]).lines)


def test_a_replay_without_faults_is_that_of_the_bag(bag):
    flight = replayed(bag, {}, 1)
    told = flight.told
    assert round(flight.length_s) == 40
    assert len(flight.arrivals_ns["ins/imu"]) == 4001
    assert len(told.claims) == pytest.approx(401, abs=3)
    assert np.median([claim[3] for claim in told.claims]) < 3.0
    assert told.failures == 0


def test_one_fault_is_reported_with_its_sizes_and_times(bag):
    lines = one_fault_lines(bag, KNOCK)
    assert lines[0] == "demo_1.mcap: knock on star/fore/horizon_attitude from 20 s to 30 s"
    assert lines[1].startswith("detected True after 0.0")
    assert any("star.fore: gate" in line and line.endswith("<- the faulty one") for line in lines)
    with pytest.raises(BadInput, match="no message of ins/imu in the time of the fault"):
        one_fault_lines(bag, "topic: ins/imu, kind: drop, start_s: 50")
    with pytest.raises(BadInput, match="of kind knock needs"):
        one_fault_lines(bag, "topic: ins/imu, kind: knock, start_s: 20")
    with pytest.raises(BadInput, match="is not an input of the nodes"):
        one_fault_lines(bag, "topic: ship/imu, kind: drop, start_s: 20")


def result(number, **changes):
    fault = {
        "threat": "ins step", "topic": "ins/imu", "kind": "bias", "start_s": 10.0, "end_s": 20.0, "sizes": {},
        "sigmas": 30.0, "detected": True, "attributed": True, "alert_s": 0.5, "named": {}, "worst_sigmas": 3.0,
        "worst_over_level": 0.4, "beyond_s": 0.0, "longest_beyond_s": 0.0, "alert_limit_s": 1.0,
    } | changes  # fmt: skip
    return {
        "voyage": number, "bag": "demo_1", "mode": SINGLE, "exception": "", "failures": 0, "faults": [fault]
    }  # fmt: skip


def test_the_table_counts_and_the_bounds_are_those_of_single_faults():
    results = [
        result(0),
        result(1, alert_s=2.0, attributed=False),
        result(2, detected=False, attributed=False, alert_s=None, worst_sigmas=8.0, worst_over_level=None),
    ]
    row = kind_rows(results)[0]
    assert row == ("ins step", "3", "2", "1", "1.25", "1.98", "8.00", "1", "0.00", "0.40", "0")
    assert kind_rows(results)[-1][0] == "all"
    assert totals(results).sound
    assert "told: 66.7% of 3; within 1 s or three measurements 33.3%" in totals(results).lines[2]
    assert not totals([*results, result(3, worst_over_level=1.1)]).sound
    assert kind_rows([]) == pair_rows([]) == []


def test_pairs_are_those_that_overlap():
    both = result(0)
    both["mode"] = OVERLAPPING
    other = {**both["faults"][0], "threat": "star knock", "start_s": 15.0, "end_s": 30.0, "worst_sigmas": 7.0}
    apart = {**both["faults"][0], "threat": "flood", "start_s": 40.0, "end_s": 50.0}
    both["faults"] += [other, apart]
    assert pair_rows([both]) == [("ins step + star knock", "1", "7.00", "0.40", "0.00")]


def test_results_outlive_a_torn_line_and_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "single.jsonl"
    results = ResultsFile(path)
    results.add(result(1))
    results.add(result(0))
    with open(path, "a", encoding="utf-8") as file:
        file.write('{"voyage": 7, "ba')
    again = ResultsFile(path)
    assert [one["voyage"] for one in again.all()] == [0, 1]
    assert again.holds(Voyage(1, Path("x/demo_1.mcap"), SINGLE))
    assert not again.holds(Voyage(1, Path("x/demo_2.mcap"), SINGLE))
    again.add(result(2))
    assert len(path.read_text().splitlines()) == 3
    path.write_text("hello\n" + path.read_text())
    with pytest.raises(BadInput, match=r"single.jsonl:1: no result of a voyage"):
        ResultsFile(path)
    assert ResultsFile(path, fresh=True).all() == []


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_results(tmp_path, bag):
    """kill -9 of parent and workers after the first results; the second run makes only what is missing."""
    out = tmp_path / "faults"
    (out / "bags").mkdir(parents=True)
    (out / "bags" / "demo_1.mcap").write_bytes(bag.read_bytes())
    command = [
        sys.executable, str(ROOT / "tools" / "faults.py"), "--bags", "demo", "--bag-seeds", "1", "--voyages", "4",
        "--mode", SINGLE, "--processes", "1", "--out", str(out),
    ]  # fmt: skip
    path = out / "single.jsonl"
    run = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    deadline_s = time.monotonic() + 300.0
    while not (path.exists() and path.read_bytes().count(b"\n") >= 1):
        assert time.monotonic() < deadline_s
        assert run.poll() is None
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    made = path.read_bytes().count(b"\n")
    kept = path.read_bytes()[: path.read_bytes().rfind(b"\n") + 1]
    assert 1 <= made < 4
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode in (0, 1)
    assert path.read_bytes().startswith(kept)
    results = ResultsFile(path).all()
    assert [one["voyage"] for one in results] == [0, 1, 2, 3]
    assert b"4 voyages" in done.stdout

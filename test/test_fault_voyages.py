"""Voyages with faults: drawing, evaluation, and continuation after a kill."""

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
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_simulation.inject_command import Injection
from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.fault import KINDS, Fault, size_problems
from ship_simulation.scenario.names import simulated_topics
from ship_simulation.scenario.scenario_file import fault_problems, load_faults, load_scenario
from ship_testing.places import ROOT
from ship_testing.trials.fault_evaluation import (
    evaluate_fault,
    exceedance_durations,
    first_named_sources,
    is_faulty_source,
)
from ship_testing.trials.fault_free_replay import UNDETECTABLE_CASES, UNREPORTED_CASES, FaultFreeReplay
from ship_testing.trials.fault_results import pair_rows, results_file, threat_rows, totals
from ship_testing.trials.fault_voyage import (
    Voyage,
    input_topics,
    make_bag,
    replay_fault_free,
    replay_injection,
    run_voyage,
    voyages,
)
from ship_testing.trials.one_fault import one_fault_lines
from ship_testing.trials.threats import BY_FORM, DATA_LIKE, OVERLAPPING, SINGLE, draw_faults
from ship_testing.trials.voyage_outputs import (
    EXCLUSION,
    NO_DATA,
    FaultIndication,
    HealthHistory,
    ValidOutput,
    VoyageOutputs,
    VoyageSink,
)

SCENARIOS = ROOT / "bags" / "scenarios"
MOUNTING_SHIFT = "topic: star/fore/horizon_attitude, kind: knock, start_s: 20, end_s: 30, up_arcsec: 300"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Forty seconds of the demonstration with the INS at a quarter of its rate."""
    folder, text = tmp_path_factory.mktemp("bags"), (SCENARIOS / "demo.yaml").read_text(encoding="utf-8")
    assert "  rate_hz: 100.0\n" in text
    (folder / "demo.yaml").write_text(text.replace("  rate_hz: 100.0\n", "  rate_hz: 25.0\n"), encoding="utf-8")
    return make_bag(folder / "demo.yaml", 40.0, 1, folder / "demo_1.mcap")


@pytest.fixture(scope="module")
def topics():
    return simulated_topics(load_scenario(SCENARIOS / "everything.yaml"))


def draw(topics, number, mode, length_s=180.0):
    return draw_faults(topics, length_s, mode, 60.0, random_stream(number, "test"))


def test_the_page_lists_every_kind_with_the_rows_that_it_is_drawn_for():
    page = (ROOT / "docs" / "how-to" / "inject_faults.md").read_text(encoding="utf-8")
    section = page.split("## Kinds")[1].split("\n## ")[0]
    table = [[cell.strip() for cell in line.split("|")[1:4]] for line in section.splitlines() if line.startswith("| `")]
    assert [(kind.strip("`"), doc) for kind, doc, _ in table] == [(kind, KINDS[kind].doc) for kind in KINDS]
    for kind, _, rows in table:
        drawn_for = {threat.label for threat in DATA_LIKE + BY_FORM if threat.kind == kind.strip("`")}
        unseen = {row for row in UNDETECTABLE_CASES if row.split(",")[0] in drawn_for}
        assert set(rows.split("; ")) - {"-"} == drawn_for | unseen


@pytest.mark.parametrize("mode", [SINGLE, OVERLAPPING])
def test_what_is_drawn_repeats_and_can_happen(topics, mode):
    for number in range(200):
        found = draw(topics, number, mode)
        assert found == draw(topics, number, mode)
        assert 1 <= len(found) <= 5
        faults = {f"f{i}": one.fault for i, one in enumerate(found)}
        assert list(fault_problems(faults, topics, "there")) == []
        assert [p for key, fault in faults.items() for p in size_problems(key, fault)] == []


def test_single_faults_leave_time_to_return(topics):
    for number in range(200):
        found = [one.fault for one in draw(topics, number, SINGLE, 600.0)]
        assert all(later.start_s >= before.end_s + 60.0 for before, later in pairwise(found))


@pytest.mark.slow
def test_every_threat_is_drawn_on_everything(topics):
    labels = {one.threat.label for number in range(1500) for one in draw(topics, number, OVERLAPPING)}
    fed_by_the_filter = {"ship step", "ship drift", "ship frozen"}
    assert labels == {threat.label for threat in DATA_LIKE + BY_FORM} - fed_by_the_filter


def test_bags_and_modes_take_turns():
    found = voyages([Path("a"), Path("b")], 6)
    assert [(v.bag.name, v.mode) for v in found] == [
        ("a", SINGLE), ("b", SINGLE), ("a", OVERLAPPING), ("b", OVERLAPPING), ("a", SINGLE), ("b", SINGLE)
    ]  # fmt: skip


def outputs_of(valid_outputs=(), not_valid=(), indications=()):
    """Return outputs with times in s after the start at 0."""
    ns = NS_PER_S
    return VoyageOutputs(
        valid_outputs=[
            ValidOutput("ship/attitude", round(t * ns), round(t * ns), sigmas, level)
            for t, sigmas, level in valid_outputs
        ],
        not_valid=[("ship/attitude", round(t * ns), round(t * ns), 2) for t in not_valid],
        indications=[
            FaultIndication(source, round(t * ns), round(t * ns), reason) for source, t, reason in indications
        ],
    )


FAULT = Fault(topic="ins/imu", kind="bias", start_s=10.0, end_s=20.0, up_arcsec=30.0)


def fault_free_replay(
    outputs=None, arrivals_ns=None, lights_s=(), encoder_sigma_arcsec=math.nan, ins_sigma_arcsec=math.nan
):
    """Return the fault-free replay of a minute."""
    lights_ns = (np.array(lights_s) * NS_PER_S).astype(np.int64)
    sigmas_arcsec = encoder_sigma_arcsec, ins_sigma_arcsec
    return FaultFreeReplay(outputs or outputs_of(), arrivals_ns or {}, lights_ns, *sigmas_arcsec, 0, 60 * NS_PER_S)


def outcome(outputs, clean=None, until_s=60.0, first_s=10.02):
    """Return the outcome of a fault whose changed messages arrive every 0.1 s from 10.02 s on."""
    changed_ns = np.arange(round(first_s * NS_PER_S), 20 * NS_PER_S, NS_PER_S // 10)
    return evaluate_fault(FAULT, changed_ns, outputs, fault_free_replay(clean), until_s)


def test_time_limit_for_detection():
    known = fault_free_replay(arrivals_ns={"ins/imu": np.arange(60) * NS_PER_S, "met/pressure": np.array([0])})
    assert known.alert_limit_s(FAULT) == 3.0
    assert known.alert_limit_s(Fault(topic="met/pressure", kind="drop", start_s=10.0)) == 1.0


def test_a_fault_counts_from_the_first_message_that_it_changed():
    """Indications before the first changed message do not count; the time to detection begins at this message."""
    before = outputs_of(not_valid=[12.0], indications=[("ins", 12.0, "gate"), ("ins", 12.1, "gate")])
    assert outcome(before).detected
    assert not outcome(before, first_s=13.0).detected
    found = outcome(outputs_of(not_valid=[12.0, 14.5]), first_s=14.0)
    assert (round(found.alert_s, 2), found.changed) == (0.5, 60)


def test_effects_of_an_earlier_fault_do_not_count():
    """Outputs that are not VALID since before the fault give a time of an alert, but no detection."""
    left = [round(8.0 + 0.1 * n, 1) for n in range(60)]
    found = outcome(outputs_of(not_valid=left))
    assert (found.detected, round(found.alert_s, 2)) == (False, 0.08)
    assert outcome(outputs_of(not_valid=[*left, 15.0])).detected


def test_an_excluded_wrong_source_is_detected_and_not_attributed():
    found = outcome(outputs_of(indications=[("star.bow", 10.5, EXCLUSION)]))
    assert (found.detected, found.attributed) == (True, False)


def slip(arcsec):
    return Fault(topic="theodolite/encoder", kind="slip", start_s=10.0, end_s=20.0, elevation_arcsec=arcsec)


def test_only_a_slip_below_thirteen_sigmas_without_lights_is_undetectable():
    arrivals_ns = {"theodolite/encoder": np.arange(0, 60 * NS_PER_S, NS_PER_S // 50)}
    begin_ns = 10 * NS_PER_S
    dark = fault_free_replay(arrivals_ns=arrivals_ns, lights_s=[9.9, 11.1], encoder_sigma_arcsec=2.0)
    assert dark.undetectable_case(slip(-25.9), begin_ns) == "encoder slip, no lights"
    assert dark.undetectable_case(slip(26.1), begin_ns) == ""
    assert dark.undetectable_case(Fault(topic="theodolite/encoder", kind="freeze", start_s=10.0), begin_ns) == ""
    assert dark.undetectable_case(FAULT, begin_ns) == ""
    shifts = [Fault(topic="theodolite/beacons", kind="knock", start_s=10.0, up_arcsec=size) for size in (-12.9, 13.1)]
    assert [dark.undetectable_case(shift, begin_ns) for shift in shifts] == ["telescope knock, small", ""]
    lit = fault_free_replay(arrivals_ns=arrivals_ns, lights_s=[9.9, 10.9], encoder_sigma_arcsec=2.0)
    assert lit.undetectable_case(slip(-25.9), begin_ns) == ""
    unknown = fault_free_replay(arrivals_ns=arrivals_ns, lights_s=[])
    assert unknown.undetectable_case(slip(1.0), begin_ns) == ""


@pytest.mark.parametrize(
    ("topic", "size", "row"),
    [
        ("theodolite/encoder", {"azimuth_arcsec_per_min": -101.0}, "encoder drift, detected late"),
        ("theodolite/encoder", {"azimuth_arcsec_per_min": 99.0}, ""),
        ("theodolite/encoder", {"elevation_arcsec_per_min": 300.0}, ""),
        ("ins/imu", {"up_arcsec_per_min": 61.0}, "ins drift, detected late"),
        ("ins/imu", {"forward_arcsec_per_min": -61.0}, "ins drift, detected late"),
        ("ins/imu", {"right_arcsec_per_min": 59.0}, ""),
        ("star/bow/horizon_attitude", {"up_arcsec_per_min": 4.1}, "star drift, detected late"),
        ("star/bow/horizon_attitude", {"right_arcsec_per_min": -3.9}, ""),
        ("reference/gyro/imu", {"up_arcsec_per_min": 300.0}, ""),
    ],
)
def test_fast_drifts_are_detected_late(topic, size, row):
    fault = Fault(topic=topic, kind="drift", start_s=10.0, **size)
    two, three = (
        fault_free_replay(
            arrivals_ns={f"star/{name}/{kind}": [] for name in names for kind in ("observations", "solution")}
        )
        for names in (("bow", "port"), ("aft", "bow", "port"))
    )
    assert two.undetectable_case(fault, 10 * NS_PER_S) == row
    assert three.undetectable_case(fault, 10 * NS_PER_S) == ("" if topic.startswith(("ins", "star")) else row)


def test_an_ins_step_below_the_sample_noise_is_small():
    found = fault_free_replay(ins_sigma_arcsec=2.0)
    steps = [Fault(topic="ins/imu", kind="bias", start_s=10.0, east_arcsec=size) for size in (-21.9, 22.1)]
    assert [found.undetectable_case(step, 10 * NS_PER_S) for step in steps] == ["ins step, small", ""]
    assert fault_free_replay().undetectable_case(steps[0], 10 * NS_PER_S) == ""


def test_a_mounting_shift_without_stars_is_undetectable():
    """Stars from 0 to 8 s and from 20 s on: the first changed message comes after 12 s without stars."""
    seen_ns = np.r_[0:9, 20:40] * NS_PER_S
    clouded = fault_free_replay(arrivals_ns={"star/bow/observations": seen_ns[:9], "star/port/observations": seen_ns})
    shift = Fault(topic="star/port/observations", kind="knock", start_s=10.0, up_arcsec=15.0)
    assert clouded.undetectable_case(shift, 20 * NS_PER_S) == "star knock, no stars"
    assert clouded.undetectable_case(shift, 21 * NS_PER_S) == ""
    assert clouded.undetectable_case(FAULT, 20 * NS_PER_S) == ""
    other = fault_free_replay(
        arrivals_ns={"star/bow/observations": np.r_[0:40] * NS_PER_S, "star/port/observations": seen_ns}
    )
    assert other.undetectable_case(shift, 20 * NS_PER_S) == ""


def test_undetectable_cases_are_those_of_the_page():
    page = (ROOT / "docs" / "explanation" / "integrity.md").read_text(encoding="utf-8")
    section = page.split("## Undetectable faults")[1].split("\n##")[0]
    labels = [line.split("|")[2].strip() for line in section.splitlines() if line.startswith("|")][2:]
    assert sorted(label.strip("`") for label in labels if label != "-") == sorted(UNDETECTABLE_CASES)


def test_a_fault_is_detected_by_status_or_by_name_in_time():
    assert not outcome(outputs_of()).detected
    found = outcome(outputs_of(not_valid=[10.5]))
    assert (found.detected, found.attributed, round(found.alert_s, 2)) == (True, False, 0.48)
    found = outcome(outputs_of(indications=[("ins", 10.1, "gate"), ("ins", 10.2, "gate")]))
    assert (found.detected, found.attributed, round(found.alert_s, 2)) == (True, True, 0.08)
    # A rejection of another source alone is no alert of the faulty source; after the time limit nothing is an alert.
    assert not outcome(outputs_of(indications=[("star.bow", 10.1, "gate")])).detected
    assert not outcome(outputs_of(not_valid=[23.1], indications=[("ins", 23.1, "gate")])).detected


def test_indications_of_the_fault_free_voyage_do_not_count():
    signs, not_valid = [("ins", 12.0, "gate")], [15.0, 15.5]
    clean = outputs_of(not_valid=not_valid, indications=signs)
    assert not outcome(outputs_of(not_valid=[15.3], indications=signs), clean).detected
    assert outcome(outputs_of(not_valid=[14.4], indications=signs), clean).detected


def named_sources(*signs):
    return first_named_sources(outputs_of(indications=signs).indications)


STARS_REJECTED = [("star.bow", 10.1 + 0.1 * i, "gate") for i in range(5)]


def test_exclusion_precedes_rejection_in_comparison():
    assert named_sources(*STARS_REJECTED) == {"star.bow"}
    assert named_sources(*STARS_REJECTED, ("ins", 11.0, EXCLUSION)) == {"ins"}
    # With several exclusions, all are named.
    assert named_sources(("ins", 11.0, EXCLUSION), ("star.bow", 12.0, EXCLUSION)) == {"ins", "star.bow"}


def test_repeated_own_rejections_precede_later_exclusions():
    ins = [("ins", 10.0, "gate"), ("ins", 10.1, "gate")]
    exclusions = [("star.bow", 10.5, EXCLUSION), ("star.port", 10.5, EXCLUSION)]
    assert named_sources(*ins, *exclusions) == {"ins"}
    assert named_sources(*exclusions, *((source, t + 1.0, why) for source, t, why in ins)) == {"star.bow", "star.port"}
    # A single rejection is no pattern. The gate compares a star sensor with other sources, which may be faulty.
    assert named_sources(ins[0], *exclusions) == {"star.bow", "star.port"}
    assert named_sources(*STARS_REJECTED, *ins) == {"ins"}
    assert named_sources(
        ("theodolite/encoder", 10.2, NO_DATA), *STARS_REJECTED, ("theodolite/encoder", 11.2, NO_DATA)
    ) == {"theodolite/encoder"}
    assert named_sources(("star.bow", 10.0, "frame"), ("star.bow", 10.1, "frame"), *exclusions) == {"star.bow"}


def test_repeated_rejections_precede_a_single_one():
    assert named_sources(("lights", 10.0, "gate"), *STARS_REJECTED) == {"star.bow"}
    assert named_sources(("lights", 10.0, "gate"), ("star.bow", 10.1, "gate")) == {"lights"}
    assert named_sources() == set()


def test_claims_beyond_five_sigmas_are_counted_until_the_next_fault():
    claims = [(t / 10.0, 6.0 if 300 <= t < 325 or 400 <= t < 410 else 1.0, 0.5) for t in range(100, 600)]
    found = outcome(outputs_of(valid_outputs=claims))
    assert (found.worst_sigmas, found.beyond_s, found.longest_beyond_s) == (6.0, pytest.approx(3.5), pytest.approx(2.5))
    assert outcome(outputs_of(valid_outputs=claims), until_s=30.0).beyond_s == 0.0
    assert found.worst_over_level == 0.5
    assert math.isnan(outcome(outputs_of(valid_outputs=[(11.0, 1.0, math.nan)])).worst_over_level)


def test_an_output_that_was_not_valid_in_between_is_a_break():
    """Two wrong outputs ten seconds apart are not continuous."""
    claims = outputs_of(
        valid_outputs=[(10.0, 9.0, 0.1), (10.1, 9.0, 0.1), (20.0, math.inf, 0.1), (20.1, 1.0, 0.1)]
    ).valid_outputs
    assert exceedance_durations(claims) == (pytest.approx(0.3), pytest.approx(0.2))


@pytest.mark.parametrize(
    ("topic", "own", "other"),
    [
        ("ins/imu", "ins", "star.ins"),
        ("ins/imu", "ship_attitude", "encoder"),
        ("star/fore/observations", "star.fore", "star.aft"),
        ("reference/gyro/imu", "reference.gyro", "ins"),
        ("beacon/a/baseline", "light.a", "light.b"),
        ("beacon/a/baseline", "beacon.a", "lights"),
        ("beacon/a/imu", "beacon.a", "beacon.b"),
        ("theodolite/beacons", "lights", "baseline.a"),
        ("theodolite/beacons", "telescope", "ship_attitude"),
        ("theodolite/beacons", "theodolite/beacons", "beacon.a"),
        ("theodolite/encoder", "encoder", "ship"),
        ("theodolite/encoder", "encoder", "ship_attitude"),
        ("ship/attitude", "ship", "ins"),
        ("ship/attitude", "ship_attitude", "ins"),
        ("gnss/fix", "gnss/fix", "ins"),
        ("met/pressure", "met/pressure", "star.fore"),
    ],
)
def test_the_names_of_the_device_behind_a_topic(topic, own, other):
    fault = Fault(topic=topic, kind="knock", start_s=10.0, up_arcsec=9.0)
    assert is_faulty_source(own, fault)
    assert not is_faulty_source(other, fault)


@pytest.mark.parametrize(
    "changes", [{"kind": "swap"}, {"kind": "false_lights"}, {"kind": "nan", "field": "beacons[0].x"}]
)
def test_a_light_that_is_wrong_is_held_by_its_drone(changes):
    fault = Fault(topic="theodolite/beacons", start_s=10.0, **changes)
    assert is_faulty_source("beacon.a", fault)
    assert is_faulty_source("light.b", fault)
    assert not is_faulty_source("ship_attitude", fault)
    assert not is_faulty_source("encoder", fault)


class Message:
    def __init__(self, **fields):
        self.__dict__ |= fields


def report_indications(history, second, topic, received, reasons=(), level=0):
    report = Message(
        header=Message(stamp=Message(sec=second, nanosec=0)), topic=topic, received=received, level=level,
        reasons=list(dict(reasons)), reason_counts=list(dict(reasons).values()),
    )  # fmt: skip
    return [(sign.source, sign.reason) for sign in history.new_indications(report, second * NS_PER_S)]


def test_reports_on_inputs_name_what_is_new_in_them_for_each_node():
    history = HealthHistory()
    assert report_indications(history, 1, "ins/imu", 100) == []
    assert report_indications(history, 1, "ins/imu", 90) == []
    assert report_indications(history, 2, "ins/imu", 200, {"frame": 2, "revised": 3}) == [("ins/imu", "frame")]
    assert report_indications(history, 2, "ins/imu", 190) == []
    # Repeated counts, and rejections caused by other inputs, are no new indication of this input.
    assert report_indications(history, 3, "ins/imu", 300, {"frame": 2, "excluded": 4}) == []
    assert report_indications(history, 3, "ins/imu", 290, {"frame": 1}) == [("ins/imu", "frame")]
    assert report_indications(history, 4, "ins/imu", 300, {"frame": 2}, level=1) == [("ins/imu", NO_DATA)]
    assert report_indications(history, 4, "ins/imu", 290, {"frame": 1}) == []


def test_own_faults_among_rejections():
    """Stars rejected by the gate, or for lack of a position fix, may be correct; a rejected fix is not."""
    stars = {"gate": 3, "attitude_conflict": 1, "gap": 1, "no_fix": 1}
    assert report_indications(HealthHistory(), 1, "star/bow/observations", 9, stars) == []
    assert report_indications(HealthHistory(), 1, "theodolite/beacons", 9, stars) == []
    assert report_indications(HealthHistory(), 1, "star/bow/observations", 9, {"stuck": 1}) == [
        ("star/bow/observations", "stuck")
    ]
    assert report_indications(HealthHistory(), 1, "gnss/fix", 9, {"no_fix": 1}) == [("gnss/fix", "no_fix")]
    assert report_indications(HealthHistory(), 1, "ins/imu", 9, {"gate": 1, "excluded": 1}) == [("ins/imu", "gate")]


def test_levels_and_exclusions_are_those_of_the_last_integrity_message():
    stamp = Message(sec=1, nanosec=0)
    sink = VoyageSink({})
    for excluded in ([], ["ins"], ["ins"], [], ["ins"]):
        integrity = Message(header=Message(stamp=stamp), protection_level=[1e-4] * 3, excluded=excluded)
        sink.write("ship/integrity", integrity, 5)
    assert [sign[0] for sign in sink.outputs.indications] == ["ins", "ins"]


@pytest.mark.slow
def test_a_voyage_is_evaluated_reproducibly(bag):
    voyage = Voyage(5, bag, OVERLAPPING)
    clean = replay_fault_free(bag)
    first, again = run_voyage(voyage, clean), run_voyage(voyage, clean)
    assert first.pop("elapsed_s") > 0.0
    again.pop("elapsed_s")
    assert first == again
    assert first["exception"] == ""
    assert all(fault["worst_sigmas"] >= 0.0 for fault in first["faults"])
    json.dumps(first, allow_nan=False)


def test_an_exception_is_recorded_with_its_faults(bag, monkeypatch):
    clean = replay_fault_free(bag)
    monkeypatch.setattr(VoyageSink, "write", lambda *_: 1 / 0)
    result = run_voyage(Voyage(5, bag, SINGLE), clean)
    assert "ZeroDivisionError" in result["exception"]
    assert result["faults"]
    assert not totals([result]).all_met
    assert "ZeroDivisionError" in "\n".join(totals([result]).lines)


def test_a_replay_without_faults_is_that_of_the_bag(bag):
    outputs, clean = replay_injection(Injection(bag, {}, 1)), replay_fault_free(bag)
    assert [claim[:4] for claim in outputs.valid_outputs] == [claim[:4] for claim in clean.outputs.valid_outputs]
    assert round(clean.length_s) == 40
    assert len(clean.arrivals_ns["ins/imu"]) == 1001
    assert clean.beacon_times_ns.size == 0
    assert math.isnan(clean.encoder_sigma_arcsec)
    assert len(outputs.valid_outputs) == pytest.approx(401, abs=3)
    assert np.median([claim[3] for claim in outputs.valid_outputs]) < 3.0
    assert outputs.failure_count == 0


@pytest.mark.slow
def test_one_fault_is_reported_with_its_sizes_and_times(bag):
    lines = one_fault_lines(bag, MOUNTING_SHIFT)
    assert lines[0] == "demo_1.mcap: knock on star/fore/horizon_attitude from 20 s to 30 s"
    assert lines[1] == "changed 50 messages, the first at 20.13 s"
    assert lines[2].startswith("detected True after 0.0")
    assert any("star.fore: gate" in line and line.endswith("<- the faulty one") for line in lines)
    with pytest.raises(BadInput, match="the fault changes no message of ins/imu"):
        one_fault_lines(bag, "topic: ins/imu, kind: drop, start_s: 50")
    with pytest.raises(BadInput, match="of kind knock needs"):
        one_fault_lines(bag, "topic: ins/imu, kind: knock, start_s: 20")
    with pytest.raises(BadInput, match="is not an input of the nodes"):
        one_fault_lines(bag, "topic: ship/imu, kind: drop, start_s: 20")


def result(number, **changes):
    fault = {
        "threat": "ins step", "topic": "ins/imu", "kind": "bias", "start_s": 10.0, "end_s": 20.0, "sizes": {},
        "sigmas": 30.0, "detected": True, "attributed": True, "alert_s": 0.5, "named": {}, "worst_sigmas": 3.0,
        "worst_over_level": 0.4, "beyond_s": 0.0, "longest_beyond_s": 0.0, "alert_limit_s": 1.0, "changed": 100,
    } | changes  # fmt: skip
    return {
        "voyage": number, "bag": "demo_1", "mode": SINGLE, "exception": "", "failures": 0, "faults": [fault],
        "longest_beyond_s": fault["longest_beyond_s"],
    }  # fmt: skip


def test_the_table_counts():
    results = [
        result(0),
        result(1, alert_s=2.0, attributed=False),
        result(2, detected=False, attributed=False, alert_s=None, worst_sigmas=8.0, worst_over_level=None),
    ]
    row = threat_rows(results)[0]
    assert row == ("ins step", "3", "2", "1", "1.25", "1.98", "8.00", "1", "0.00", "0.40", "0")
    assert threat_rows(results)[-1][0] == "all"
    assert threat_rows([]) == pair_rows([]) == []


def overlapping(number, **changes):
    return result(number, **changes) | {"mode": OVERLAPPING}


@pytest.mark.parametrize(
    ("others", "unmet"),
    [
        ([], []),
        ([result(3, worst_over_level=1.1)], ["1 VALID beyond the protection level"]),
        ([result(3, worst_sigmas=5.1)], ["VALID beyond 5σ: 1;"]),
        ([result(3, threat=UNDETECTABLE_CASES[0], worst_sigmas=5.1)], []),
        ([result(3, threat=UNDETECTABLE_CASES[0], worst_over_level=1.1)], ["1 VALID beyond the protection level"]),
        ([result(3, alert_s=1.1)], ["detected within 1 s or 3 measurements: 98.0%"]),
        ([result(3, alert_s=1.1, sigmas=7.9)], []),
        ([result(3, alert_s=1.1, threat=UNREPORTED_CASES[0])], []),
        ([result(3, alert_s=1.1, threat="ins step, small")], ["detected within 1 s or 3 measurements: 98.0%"]),
        ([result(3, alert_s=None, detected=False)], ["detected within 1 s or 3 measurements: 98.0%"]),
        ([result(3, alert_s=None, detected=False, changed=2)], []),
        ([result(i, attributed=False) for i in range(3)], ["attributed to the right source: 94.2%"]),
        ([result(i, attributed=False) for i in range(2)], []),
        ([overlapping(3, longest_beyond_s=2.1, worst_sigmas=9.0)], ["the longest VALID beyond 5σ 2.10 s"]),
        ([overlapping(3, longest_beyond_s=2.0, worst_sigmas=9.0, worst_over_level=3.0)], []),
        ([result(3) | {"failures": 1}], ["1 with exceptions"]),
    ],
)
def test_each_bound_is_printed_with_its_result(others, unmet):
    found = totals([result(100 + i) for i in range(49)] + others)
    assert found.all_met == (not unmet)
    lines = [line for line in found.lines if line.startswith("NOT MET")]
    assert len(lines) == len(unmet)
    assert all(words in line for words, line in zip(unmet, lines, strict=True))
    assert sum(line.startswith("met ") for line in found.lines) == 6 - len(unmet)


def test_without_a_voyage_no_bound_is_broken():
    assert totals([]).all_met


def test_pairs_are_those_that_overlap_the_longest_wrong_claim_first():
    both = overlapping(0)
    other = {**both["faults"][0], "threat": "star knock", "start_s": 15.0, "end_s": 30.0, "worst_sigmas": 7.0}
    later = {**both["faults"][0], "threat": "flood", "start_s": 40.0, "end_s": 50.0}
    both["faults"] += [other, later]
    assert pair_rows([both]) == [("ins step + star knock", "1", "0.00", "7.00", "0.40")]
    longer = overlapping(1)
    longer["faults"].append({**other, "threat": "flood", "worst_sigmas": 6.0, "longest_beyond_s": 0.3})
    nowhere = overlapping(2)
    nowhere["faults"].append({**other, "threat": "drop", "worst_sigmas": 7.0, "worst_over_level": None})
    assert [row[0] for row in pair_rows([both, longer, nowhere])] == [
        "flood + ins step", "ins step + star knock", "drop + ins step"
    ]  # fmt: skip


def test_results_outlive_a_torn_line_and_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "single.jsonl"
    results = results_file(path)
    results.add(result(1))
    results.add(result(0))
    with open(path, "a", encoding="utf-8") as file:
        file.write('{"voyage": 7, "ba')
    again = results_file(path)
    assert [one["voyage"] for one in again.results()] == [0, 1]
    assert again.contains(Voyage(1, Path("x/demo_1.mcap"), SINGLE).key)
    assert not again.contains(Voyage(1, Path("x/demo_2.mcap"), SINGLE).key)
    again.add(result(2))
    assert len(path.read_text().splitlines()) == 3
    older = result(3)
    del older["faults"][0]["changed"]
    path.write_text(json.dumps(older) + "\n")
    with pytest.raises(BadInput, match=r"single.jsonl:1: no result of a voyage"):
        results_file(path)
    path.write_text("hello\n" + path.read_text())
    with pytest.raises(BadInput, match=r"single.jsonl:1: no result of a voyage"):
        results_file(path)
    assert results_file(path, fresh=True).results() == []


@pytest.mark.slow
def test_the_tables_of_results_that_are_there_and_their_exit_code(tmp_path):
    command = [sys.executable, str(ROOT / "tools" / "faults.py"), "--table", "--out", str(tmp_path)]
    both = overlapping(1, longest_beyond_s=1.9)
    both["faults"].append({**both["faults"][0], "threat": "flood", "start_s": 15.0})
    results = results_file(tmp_path / "both.jsonl")
    results.add(result(0))
    results.add(both)
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert "flood + ins step" in done.stdout
    assert done.stdout.count("met      ") == 6
    results.add(overlapping(2, longest_beyond_s=2.1))
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert done.returncode == 1, done.stderr
    assert "NOT MET  overlapping faults, 2 voyages: the longest VALID beyond 5σ 2.10 s; bound 2 s" in done.stdout


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        ("theodolite", "topic: ship/attitude, kind: freeze, start_s: 20, end_s: 35"),
        ("theodolite", "topic: beacon/a/baseline, kind: wrong_fix, start_s: 20, end_s: 35, up_m: 0.4"),
        ("everything", "topic: ins/imu, kind: bias, start_s: 24.1, end_s: 34, up_arcsec: 212"),
        ("everything", "topic: theodolite/encoder, kind: slip, start_s: 24.1, end_s: 34, elevation_arcsec: 30"),
    ],
)
def test_the_last_published_levels_hold_at_every_valid_output(scenario, words, tmp_path_factory):
    bag = tmp_path_factory.getbasetemp() / f"{scenario}_1.mcap"
    make_bag(SCENARIOS / f"{scenario}.yaml", 45.0, 1, bag)
    with read_bag(bag) as content:
        faults = load_faults(f"faults: {{one: {{{words}}}}}", input_topics(content), "an input of the nodes")
    shares = [claim.level_ratio for claim in replay_injection(Injection(bag, faults, 1)).valid_outputs]
    shares = [share for share in shares if np.isfinite(share)]
    assert len(shares) > 100
    assert max(shares) <= 1.0


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_results(tmp_path, bag):
    """kill -9 of parent and workers after the first results; the second run computes only missing results."""
    out = tmp_path / "faults"
    (out / "bags").mkdir(parents=True)
    (out / "bags" / "demo_120s_1.mcap").write_bytes(bag.read_bytes())  # named as by the tool
    command = [
        sys.executable, str(ROOT / "tools" / "faults.py"), "--bags", "demo", "--bag-seeds", "1", "--voyages", "3",
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
    assert 1 <= made < 3
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode in (0, 1)
    assert path.read_bytes().startswith(kept)
    results = results_file(path).results()
    assert [one["voyage"] for one in results] == [0, 1, 2]
    assert b"3 voyages" in done.stdout

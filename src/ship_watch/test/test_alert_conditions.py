"""Situations that are alerts: each row of the table in docs/explanation/alerts.md; one alert for one situation."""

from dataclasses import replace
from pathlib import Path

import pytest

from ship_geometry.rotations import ARCSEC
from ship_testing.suite_states import LIMITS as PICTURED
from ship_testing.suite_states import (
    angle,
    angle_over_limit,
    angles_timed_out,
    angles_without_data,
    late_input,
    source,
    source_out,
    suite_state,
    unsafe_angle,
)
from ship_watch.alerts.alert_conditions import ComputerState, NodeStatus, conditions
from ship_watch.alerts.alerts import AlertList, Condition
from ship_watch.safety.functions import diagnostic_entries, functions
from ship_watch.safety.limits import InputLimits, Limits
from ship_watch.suite_state import ADVICE, Presence, Priority, Safety, SuiteState, kind_of

S = 1_000_000_000
PAGE = Path(__file__).parents[3] / "docs/explanation/alerts.md"
UNCHECKED = {"safety": Safety.CAUTION, "reason": "no independent check"}
LIMITS = replace(Limits(), inputs={"gnss": InputLimits(rate_hz=1.5)})


def node(name: str, level: int = 2, **values: str) -> ComputerState:
    """Return the state of a computer with one status of a node."""
    return ComputerState((NodeStatus("ship_attitude", name, level, "text of the node", values),))


ATTITUDE, ANGLES_OF_POINTING = ("heading", "pitch", "roll"), ("azimuth", "elevation")

CASES: dict[tuple[str, str], tuple[SuiteState, ComputerState | None]] = {
    ("attitude.silent", "alarm"): (suite_state(*angles_timed_out(*ATTITUDE)), None),
    ("attitude.silent", "warning"): (suite_state(*angles_without_data(*ATTITUDE, *ANGLES_OF_POINTING)), None),
    ("attitude.degraded", "alarm"): (suite_state(unsafe_angle("heading")), None),
    ("attitude.degraded", "warning"): (suite_state(angle_over_limit("roll")), None),
    ("attitude.degraded", "caution"): (suite_state(angle("pitch", **UNCHECKED)), None),
    ("pointing.silent", "alarm"): (suite_state(*angles_timed_out(*ANGLES_OF_POINTING)), None),
    ("pointing.silent", "warning"): (suite_state(*angles_without_data(*ANGLES_OF_POINTING)), None),
    ("pointing.degraded", "alarm"): (suite_state(unsafe_angle("elevation")), None),
    ("pointing.degraded", "warning"): (suite_state(angle_over_limit("azimuth")), None),
    ("pointing.degraded", "caution"): (suite_state(angle("azimuth", **UNCHECKED)), None),
    ("stars.out", "warning"): (
        suite_state(source_out("star.fore", "no data"), source_out("star.starboard", "no data")),
        None,
    ),
    ("ins.out", "warning"): (suite_state(source_out("ins", "81 rejected in a row")), None),
    ("star.ID.out", "warning"): (suite_state(source_out("star.fore", "excluded")), None),
    ("star.ID.out", "caution"): (suite_state(source_out("star.fore", "no stars")), None),
    ("reference.ID.out", "warning"): (suite_state(source_out("reference.mast", "no data")), None),
    ("star.ID.remounted", "caution"): (suite_state(source("star.fore", mounting_shift=51.0 * ARCSEC)), None),
    ("reference.ID.remounted", "caution"): (suite_state(source("reference.mast", mounting_shift=51.0 * ARCSEC)), None),
    ("encoder.out", "warning"): (suite_state(source_out("encoder", "no data")), None),
    ("lights.out", "caution"): (suite_state(source_out("lights", "7 rejected in a row")), None),
    ("baselines.out", "caution"): (suite_state(source_out("baselines", "no data")), None),
    ("ship_attitude.out", "caution"): (suite_state(source_out("ship_attitude", "invalid")), None),
    ("gnss.out", "caution"): (suite_state(source_out("gnss", "no data")), None),
    ("weather.out", "caution"): (suite_state(source_out("weather", "no data")), None),
    ("SOURCE.unreported", "warning"): (
        suite_state(source_out("star.fore", "not reported", because_of="its node")),
        None,
    ),
    ("SOURCE.mended", "caution"): (suite_state(source("lights", disagreement="names exchanged")), None),
    ("SOURCE.rate", "caution"): (suite_state(source("gnss", rate_hz=1.0)), None),
    ("stars.old", "caution"): (suite_state(ages_s={"stars": 31.0, "lights": 0.5}), None),
    ("lights.old", "caution"): (suite_state(ages_s={"stars": 0.5, "lights": 31.0}), None),
    ("clock.ahead", "warning"): (suite_state(inputs=(late_input("ins/imu", -0.06),)), None),
    ("NODE.box", "warning"): (suite_state(), node("black box", lost="12")),
    ("NODE.clock", "warning"): (suite_state(), node("clock")),
    ("NODE.stamps", "warning"): (suite_state(), node("stamps")),
    ("NODE.name", "warning"): (suite_state(), node("name")),
    ("NODE.overload", "warning"): (suite_state(), node("overload")),
    ("NODE.recovered", "caution"): (suite_state(), node("recovery", level=0, **{"recovered after [s]": "86"})),
    ("NODE.software", "caution"): (suite_state(), node("callbacks")),
    ("NODE.sink.ID", "warning"): (suite_state(), node("sink bridge")),
    ("NODE.source.ID", "caution"): (suite_state(), node("source gyro")),
    ("disk.full", "warning"): (suite_state(), ComputerState(disk_free_gb=9.0)),
}


def alerts_of(shown: SuiteState, machine: ComputerState | None = None) -> dict[str, Condition]:
    """Return id → situation for the situations that have an alert after 20 s."""
    alert_list = AlertList(Limits().alerts)
    found = conditions(shown, LIMITS, machine)
    for tenth in range(200):
        alert_list.update(found, tenth * S // 10, 0)
    ids = {alert.id for alert in alert_list.alerts}
    return {each.id: each for each in found if each.id in ids}


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_each_row_is_one_alert(case: tuple[str, str]) -> None:
    """The situation of a row gives one alert with its id and priority."""
    (found,) = alerts_of(*CASES[case]).values()
    assert (kind_of(found.id), found.priority.name.lower()) == case
    assert "\n" not in found.text
    assert len(found.text) < 90


def test_documented_table_matches_the_code() -> None:
    """docs/explanation/alerts.md has each id with exactly its own priorities, and the advice of the code."""
    rows = [line.split("|")[1:-1] for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    table = {(row[0].strip().strip("`"), word.strip()) for row in rows for word in row[1].split(",")}
    assert table == set(CASES)
    assert all(len(row) == 5 and all(cell.strip() for cell in row) for row in rows)
    assert {row[0].strip().strip("`"): row[4].strip() for row in rows} == ADVICE


def test_accuracy_over_its_limit_refers_to_the_error_budget() -> None:
    (found,) = alerts_of(suite_state(angle_over_limit("roll"))).values()
    assert (found.priority, found.text) == (Priority.WARNING, "Tilt over its limit: see the error budget")


def test_recovering_function_is_reported_until_its_safety_is_better() -> None:
    """If a function is within its limit again, its diagnostics have the current reason."""
    reason = "within 3″ again; SAFE in 4 s"
    well_again = replace(angle_over_limit("roll", share=0.8), unheld_safety=(Safety.SAFE, ""), reason=reason)
    branches = {
        branch.path: (branch.level, branch.text) for branch in diagnostic_entries(suite_state(well_again), PICTURED)
    }
    assert branches["tilt within 3″"] == (1, "within 3″ again; SAFE in 4 s, 2.4″ (95 %), limit 3″")


def test_alert_uses_the_safety_without_hold() -> None:
    """The displayed safety has a hold; alerts have a hold of their own and use the safety without hold."""
    well_again = replace(angle_over_limit("roll", "ins", share=0.98), unheld_safety=(Safety.SAFE, ""))
    assert conditions(suite_state(well_again), LIMITS) == []
    worse_now = replace(angle_over_limit("roll"), unheld_safety=(Safety.UNSAFE, "invalid"))
    (found,) = conditions(suite_state(worse_now), LIMITS)
    assert (found.priority, found.text) == (Priority.ALARM, "Tilt lost: invalid")


def test_brief_excess_of_a_limit_is_no_alert_and_a_lost_function_is() -> None:
    """A brief excess is no alert of the output; the alert of the source at fault names the lost function at once."""
    brief = {"over_limit_s": 4.9}
    assert conditions(suite_state(replace(angle_over_limit("roll"), **brief)), LIMITS) == []
    assert list(alerts_of(suite_state(replace(unsafe_angle("roll"), **brief)))) == ["attitude.degraded"]
    by_ins = conditions(
        suite_state(source_out("ins", "no data"), replace(angle_over_limit("roll", "ins"), **brief)), LIMITS
    )
    assert [each.lost_functions for each in by_ins] == [{"tilt"}]


def test_all_well_is_no_alert() -> None:
    """No alert without faults, also with good statuses of nodes."""
    assert conditions(suite_state(), LIMITS, node("black box", 0)) == []
    assert conditions(suite_state(), LIMITS, node("callbacks", 1)) == []


def test_alert_of_a_source_names_the_lost_functions() -> None:
    """INS without data, heading, tilt and pointing lost: one alarm that names the INS and the lost functions."""
    angles = [unsafe_angle(name, "ins") for name in (*ATTITUDE, "azimuth", "elevation")]
    found = alerts_of(suite_state(source_out("ins", "no data", age_s=4.0), *angles))
    assert list(found) == ["ins.out"]
    alert = found["ins.out"]
    assert (alert.priority, alert.source) == (Priority.ALARM, "ins")
    assert alert.text == "Heading, tilt and pointing lost: no data from ins"
    assert (alert.value, alert.unit) == (4.0, "s")
    assert alert.lost_functions == {"heading", "tilt", "pointing"}


def test_pointing_lost_with_the_attitude_has_the_cause_of_the_attitude() -> None:
    """Drones on deck and no INS data: the pointing is lost because of the INS, not of the lights."""
    angles = [unsafe_angle(name, "ins") for name in ATTITUDE] + [
        unsafe_angle(name, "lights") for name in ANGLES_OF_POINTING
    ]
    shown = suite_state(source_out("lights", "no lights"), source_out("ins", "no data"), *angles)
    found = alerts_of(shown)
    assert {id_: one.priority for id_, one in found.items()} == {
        "ins.out": Priority.ALARM,
        "lights.out": Priority.CAUTION,
    }
    causes = {one.name: one.because_of for one in functions(shown)}
    assert causes == dict.fromkeys(("heading", "tilt", "pointing"), "ins")


def test_all_star_sensors_out_for_one_reason_are_one_situation() -> None:
    """Two reasons are two situations; sensors that need another source are covered by the alert of that source."""
    taken = angle_over_limit("heading", "star.fore")
    both = alerts_of(suite_state(source_out("star.fore", "no data"), source_out("star.starboard", "no data"), taken))
    assert list(both) == ["stars.out"]
    assert both["stars.out"].text == "Heading over its limit: no data from the star sensors"
    assert both["stars.out"].becomes_alarm
    two = alerts_of(
        suite_state(source_out("star.fore", "no data"), source_out("star.starboard", "81 rejected in a row"), taken)
    )
    assert sorted(two) == ["star.fore.out", "star.starboard.out"]
    needs = [source_out(f"star.{id_}", "needs ins", because_of="ins") for id_ in ("fore", "starboard")]
    assert list(alerts_of(suite_state(source_out("ins", "no data"), *needs))) == ["ins.out"]


def test_ended_node_is_one_situation() -> None:
    """No attitude, no reports of its sources, invalid pointing: one alarm."""
    gone = [source_out(name, "not reported", because_of="its node") for name in ("ins", "star.fore", "star.starboard")]
    angles = [*angles_timed_out(*ATTITUDE), unsafe_angle("azimuth"), unsafe_angle("elevation")]
    assert list(alerts_of(suite_state(*gone, *angles))) == ["attitude.silent"]


def test_suite_with_pointing_only_needs_no_attitude() -> None:
    """A suite that publishes a pointing and never an attitude has no attitude functions."""
    shown = suite_state(*angles_without_data(*ATTITUDE))
    assert alerts_of(shown) == {}
    assert [one.safety for one in functions(shown)] == [None, None, Safety.SAFE]


def test_texts_have_no_changing_figures() -> None:
    """A situation has the same text for other figures in its reasons."""
    texts = set()
    for count in (5, 81):
        shown = suite_state(
            source_out("star.fore", f"{count} rejected in a row", disagreement=f"reads {count}″ high", age_s=count),
            angle("heading", **{**UNCHECKED, "reason": f"no stars for {count} s"}),
        )
        texts |= {each.text for each in conditions(shown, LIMITS)}
    assert texts == {"star.fore rejected", "Heading unchecked: no stars"}


def test_black_box_may_lose_entries_within_the_limit() -> None:
    """Lost entries within the limit are no alert; a black box that has ended is always an alert."""
    patient = replace(LIMITS, machine=replace(LIMITS.machine, box_lost=20))
    assert conditions(suite_state(), patient, node("black box", lost="12")) == []
    assert len(conditions(suite_state(), patient, node("black box", lost="21"))) == 1
    assert len(conditions(suite_state(), patient, node("black box"))) == 1
    assert len(conditions(suite_state(), patient, node("black box", lost="many"))) == 1


def test_source_that_arrives_late_is_named_once_with_its_delay() -> None:
    """Pointing lost because the ship's attitude arrives too late: cause and consequence are one alert."""
    late = source_out("ship_attitude", "81 rejected in a row: late", topics=("ship/attitude",))
    lights = source_out("lights", "needs ship_attitude", because_of="ship_attitude")
    angles = [unsafe_angle(name, "ship_attitude") for name in ANGLES_OF_POINTING]
    (found,) = alerts_of(suite_state(late, lights, *angles, inputs=(late_input("ship/attitude", 1.0),))).values()
    assert (found.text, found.value, found.unit) == ("Pointing lost: late data from ship_attitude", 1.0, "s")
    (alone,) = alerts_of(suite_state(late)).values()
    assert alone.text == "late data from ship_attitude"


def test_lost_functions_come_before_those_over_their_limit() -> None:
    """The worst function comes first in the text, in any order of the functions."""
    (found,) = alerts_of(
        suite_state(source_out("ins", "no data"), angle_over_limit("heading", "ins"), unsafe_angle("roll", "ins"))
    ).values()
    assert found.text == "Tilt lost, heading over its limit: no data from ins"


def test_diagnostics_name_the_input_that_causes_a_loss() -> None:
    """Each function is listed with its limit and its sources; a source that causes a loss has the level ERROR."""
    angles = [unsafe_angle("heading", "ins"), angle_over_limit("roll", "ins", 2.0)]
    shown = suite_state(source_out("ins", "81 rejected in a row", disagreement="reads 9″ high"), *angles)
    branches = {branch.path: (branch.level, branch.text) for branch in diagnostic_entries(shown, PICTURED)}
    assert branches["heading within 5″"] == (2, "lost, because of ins, invalid, no accuracy, limit 5″")
    assert branches["heading within 5″/ins"] == (2, "out: 81 rejected in a row, reads 9″ high, therefore heading lost")
    assert branches["tilt within 3″"] == (1, "over its limit, because of ins, over the limit, 6.0″ (95 %), limit 3″")
    assert branches["tilt within 3″/star.fore"] == (0, "in")
    assert branches["pointing within 10″"] == (0, "safe: 5.3″ (95 %), limit 10″")
    assert branches["pointing within 10″/ins"][0] == 1
    assert "heading within 5″/lights" not in branches
    off = suite_state(source("gnss", presence=Presence.OFF))
    assert not any(branch.path.endswith("/gnss") for branch in diagnostic_entries(off, PICTURED))

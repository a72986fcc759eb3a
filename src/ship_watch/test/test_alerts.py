"""List of alerts: flapping, escalation, acknowledgement, restart, and one alert for one situation."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ship_watch.alerts.alerts import AlertChange, AlertList, AlertState, Condition
from ship_watch.safety.limits import AlertTimes
from ship_watch.suite_state import AlertEntry, Priority

S = 1_000_000_000
UTC = 1_700_000_000 * S
TIMES = AlertTimes()
OUT = Condition("star.bow.out", Priority.WARNING, "star.bow", "star.bow out: refused")


class Voyage:
    """A list of alerts that is updated four times a second."""

    def __init__(self, alert_list: AlertList | None = None, start_s: float = 0.0) -> None:
        self.alert_list = alert_list or AlertList(TIMES)
        self.now_s = start_s
        self.changes: list[AlertChange] = []

    def advance(self, seconds: float, *conditions: Condition) -> list[AlertChange]:
        """Update with these situations for some time; return the changes."""
        before = len(self.changes)
        for _ in range(round(4 * seconds)):
            self.now_s += 0.25
            now_ns = round(self.now_s * S)
            self.changes += self.alert_list.update(conditions, now_ns, UTC + now_ns)
        return self.changes[before:]

    def acknowledge(self, id_: str, instance: int = 1) -> str:
        """Acknowledge an alert now; return the text of the answer."""
        return self.alert_list.acknowledge(id_, instance, UTC + round(self.now_s * S))[1]

    def states(self) -> dict[str, str]:
        """Return priority and state of each alert."""
        return {alert.id: f"{alert.priority.name} {AlertState(alert.state).name}" for alert in self.alert_list.alerts}


def test_situation_is_raised_once_and_over_after_its_hold() -> None:
    """A warning is raised and acknowledged, and ends five seconds after its situation."""
    voyage = Voyage()
    changes = voyage.advance(30.0, OUT)
    assert [change.description for change in changes] == ["raised"]
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_UNACKNOWLEDGED"}
    assert voyage.acknowledge("star.bow.out") == "'star.bow.out' acknowledged"
    assert voyage.advance(4.75) == []
    assert [change.alert.state for change in voyage.advance(1.0)] == [AlertState.NORMAL]
    assert voyage.alert_list.alerts == ()


def test_alert_of_a_past_situation_stays_until_acknowledged() -> None:
    """An unacknowledged alert becomes rectified, and is over with its acknowledgement."""
    voyage = Voyage()
    voyage.advance(1.0, OUT)
    voyage.advance(3600.0)
    assert voyage.states() == {"star.bow.out": "WARNING RECTIFIED_UNACKNOWLEDGED"}
    assert voyage.acknowledge("star.bow.out") == "'star.bow.out' acknowledged, and over"
    assert voyage.alert_list.alerts == ()


@pytest.mark.parametrize("period_s", [0.5, 1.0, 2.0, 5.0, 9.0])
def test_flapping_input_gives_one_alert(period_s: float) -> None:
    """An hour of flapping with a duty cycle of a half: one instance, raised once."""
    voyage = Voyage()
    for _ in range(round(3600.0 / period_s)):
        voyage.advance(period_s / 2.0, OUT)
        voyage.advance(period_s / 2.0)
    assert sum(change.description == "raised" for change in voyage.changes) == 1
    assert [(alert.id, alert.instance) for alert in voyage.alert_list.alerts] == [("star.bow.out", 1)]
    voyage.acknowledge("star.bow.out")
    before = len(voyage.changes)
    for _ in range(round(600.0 / period_s)):
        voyage.advance(period_s / 2.0, OUT)
        voyage.advance(period_s / 2.0)
    assert voyage.changes[before:] == []


def test_slow_flapping_is_held_longer_each_time() -> None:
    """30 s present, 30 s absent, acknowledged each time: holds of 5, 10, 20, 40 s, then a single alert."""
    voyage = Voyage()
    for _ in range(60):
        for change in voyage.advance(30.0, OUT):
            voyage.acknowledge("star.bow.out", change.alert.instance)
        voyage.advance(30.0)
    # Holds of 5, 10 and 20 s are shorter than the pauses of 30 s, that of 40 s is not.
    assert [change.description for change in voyage.changes] == ["raised", "over"] * 3 + ["raised"]
    assert voyage.alert_list.alerts[0].instance == 4


def test_random_flapping_never_gives_two_alerts_of_one_situation() -> None:
    """For any pattern, one id has one alert, whose instances count up by one and which never ends unacknowledged."""
    for seed in range(20):
        draws = np.random.default_rng(seed)
        voyage = Voyage()
        for _ in range(200):
            there = bool(draws.integers(2))
            voyage.advance(float(draws.exponential(4.0)), *([OUT] if there else []))
            assert len(voyage.alert_list.alerts) <= 1
        raised = [change.alert.instance for change in voyage.changes if change.description == "raised"]
        assert raised == list(range(1, len(raised) + 1))
        assert all(change.alert.state != AlertState.NORMAL for change in voyage.changes)


def test_random_situations_keep_the_rules() -> None:
    """For random situations, priorities and texts: a caution is never unacknowledged, an unacknowledged alert never
    disappears or gets a lower priority, and an instance is never used twice."""
    for seed in range(20):
        draws = np.random.default_rng(seed)
        voyage = Voyage()
        for _ in range(300):
            lost = frozenset(draws.choice(["heading", "tilt"], size=draws.integers(3), replace=False).tolist())
            priority = Priority(int(draws.integers(3)))
            condition = replace(OUT, priority=priority, text=f"out {sorted(lost)}", lost_functions=lost)
            before, current = voyage.alert_list.alerts, voyage.alert_list
            voyage.advance(float(draws.exponential(4.0)), *([condition] if draws.integers(3) else []))
            for alert in before:
                if not alert.is_acknowledged:
                    assert current.alerts[0].priority >= alert.priority
                if draws.integers(4) == 0:
                    voyage.acknowledge(alert.id, current.alerts[0].instance if current.alerts else 0)
            for change in voyage.changes:
                assert change.alert.priority is not Priority.CAUTION or change.alert.state in (0, 3)
        raised = [change.alert.instance for change in voyage.changes if change.description == "raised"]
        assert len(set(raised)) == len(raised)


def test_more_lost_functions_than_acknowledged_give_a_new_instance() -> None:
    """A further loss before the acknowledgement changes only the text; a further loss after it is a new instance."""
    voyage = Voyage()
    heading = replace(OUT, text="out; heading", lost_functions=frozenset({"heading"}))
    both = replace(OUT, text="out; heading and tilt", lost_functions=frozenset({"heading", "tilt"}))
    voyage.advance(1.0, heading)
    assert [(change.alert.text, change.alert.instance) for change in voyage.advance(1.0, both)] == [(both.text, 1)]
    voyage.acknowledge("star.bow.out")
    for _ in range(50):
        voyage.advance(0.5, heading)
        voyage.advance(0.5, both)
    assert voyage.alert_list.alerts[0].instance == 1
    pointing = replace(both, lost_functions=both.lost_functions | {"pointing"})
    assert [change.description for change in voyage.advance(1.0, pointing)] == ["now also affects pointing"]
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_UNACKNOWLEDGED"}
    assert voyage.alert_list.alerts[0].instance == 2


def test_flickering_text_is_not_taken_over() -> None:
    """A new text is taken over only after it has lasted; a text that changes every half second is not."""
    voyage = Voyage()
    voyage.advance(1.0, OUT)
    voyage.acknowledge("star.bow.out")
    for _ in range(100):
        assert voyage.advance(0.5, replace(OUT, text="no data")) == []
        assert voyage.advance(0.5, OUT) == []
    assert [change.alert.text for change in voyage.advance(10.0, replace(OUT, text="no data"))] == ["no data"]


def test_glitch_of_one_update_is_no_alert() -> None:
    """A situation that is over at the next update is not raised."""
    voyage = Voyage()
    for _ in range(20):
        voyage.advance(0.25, OUT)
        voyage.advance(2.0)
    assert voyage.changes == []


def test_glitch_of_one_update_does_not_escalate_an_alert() -> None:
    """An escalation or a further loss must last, or appear twice within a second."""
    alarm = replace(OUT, priority=Priority.ALARM)
    more = replace(OUT, lost_functions=frozenset({"tilt"}))
    for graver in (alarm, more):
        voyage = Voyage()
        voyage.advance(1.0, OUT)
        voyage.acknowledge("star.bow.out")
        for _ in range(20):
            assert voyage.advance(0.25, graver) == []
            assert voyage.advance(2.0, OUT) == []
        voyage.advance(0.25, graver)
        voyage.advance(0.25, OUT)
        assert [change.alert.instance for change in voyage.advance(0.25, graver)] == [2]


def test_unacknowledged_warning_becomes_an_alarm() -> None:
    """A warning of a lost function becomes an alarm after a minute, and stays one until acknowledged."""
    voyage = Voyage()
    lost = replace(OUT, becomes_alarm=True)
    voyage.advance(60.0, lost)
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_UNACKNOWLEDGED"}
    changes = voyage.advance(0.5, lost)
    assert [change.description for change in changes] == ["became an alarm: not acknowledged for 60 s"]
    # An acknowledgement of the warning does not count for the alarm.
    assert voyage.alert_list.acknowledge("star.bow.out", 1, 0)[0] is None
    voyage.advance(600.0, lost)
    assert voyage.states() == {"star.bow.out": "ALARM ACTIVE_UNACKNOWLEDGED"}
    voyage.acknowledge("star.bow.out", 2)
    voyage.advance(30.0, lost)
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_ACKNOWLEDGED"}


def test_unacknowledged_warning_is_repeated() -> None:
    """An unacknowledged warning without lost functions is repeated each minute; an acknowledged one is not."""
    voyage = Voyage()
    changes = voyage.advance(301.0, OUT)
    assert [change.description[:8] for change in changes] == ["raised"] + ["repeated"] * 5
    times = [change.alert.changed_ns for change in changes]
    assert np.diff(times).tolist() == [60 * S] * 5
    assert len({change.alert.raised_ns for change in changes}) == 1
    voyage.acknowledge("star.bow.out")
    assert voyage.advance(301.0, OUT) == []


def test_silencing_lasts_half_a_minute_and_affects_no_new_alert() -> None:
    """Active alerts are silent for 30 s; an alert raised meanwhile sounds."""
    voyage = Voyage()
    voyage.advance(1.0, OUT)
    assert len(voyage.alert_list.silence(round(voyage.now_s * S), UTC)) == 1
    other = replace(OUT, id="gnss.out", source="gnss")
    voyage.advance(10.0, OUT, other)
    assert voyage.states() == {
        "star.bow.out": "WARNING ACTIVE_SILENCED", "gnss.out": "WARNING ACTIVE_UNACKNOWLEDGED"
    }
    changes = voyage.advance(21.0, OUT, other)
    assert [(change.alert.id, change.description) for change in changes] == [("star.bow.out", "sounds again")]


def test_caution_needs_no_acknowledgement() -> None:
    """A caution is acknowledged from the start, never repeated, and ends with its situation."""
    voyage = Voyage()
    caution = replace(OUT, priority=Priority.CAUTION)
    assert [change.description for change in voyage.advance(600.0, caution)] == ["raised"]
    assert voyage.states() == {"star.bow.out": "CAUTION ACTIVE_ACKNOWLEDGED"}
    expected = "'star.bow.out' needs no acknowledgement: it is a caution, active acknowledged"
    assert voyage.acknowledge("star.bow.out") == expected
    voyage.advance(6.0)
    assert voyage.alert_list.alerts == ()


def test_text_of_an_acknowledged_alarm_has_the_article_of_alarm() -> None:
    voyage = Voyage()
    voyage.advance(1.0, replace(OUT, priority=Priority.ALARM))
    voyage.acknowledge("star.bow.out")
    assert voyage.acknowledge("star.bow.out").endswith("it is an alarm, active acknowledged")


def test_escalation_is_a_new_instance_and_deescalation_waits() -> None:
    """An alarm after an acknowledged warning is a new instance; acknowledging the old one changes nothing."""
    voyage = Voyage()
    voyage.advance(1.0, OUT)
    voyage.acknowledge("star.bow.out")
    alarm = replace(OUT, priority=Priority.ALARM)
    assert [change.description for change in voyage.advance(1.0, alarm)] == ["was a warning, is an alarm now"]
    assert "now instance 2, not 1" in voyage.acknowledge("star.bow.out", 1)
    assert voyage.states() == {"star.bow.out": "ALARM ACTIVE_UNACKNOWLEDGED"}
    voyage.advance(20.0, OUT)
    assert voyage.states() == {"star.bow.out": "ALARM ACTIVE_UNACKNOWLEDGED"}
    voyage.acknowledge("star.bow.out", 2)
    voyage.advance(20.0, OUT)
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_ACKNOWLEDGED"}
    for _ in range(100):
        voyage.advance(1.0, OUT)
        voyage.advance(1.0, replace(OUT, priority=Priority.CAUTION))
    assert voyage.states() == {"star.bow.out": "WARNING ACTIVE_ACKNOWLEDGED"}


def test_situation_explained_by_another_alert_has_no_alert() -> None:
    """An alert for angles lost because of a source is covered by the source's alert, unless its priority is higher."""
    lost = Condition("heading.lost", Priority.WARNING, "star.bow", "heading lost", explained_by=("star.bow.out",))
    voyage = Voyage()
    voyage.advance(10.0, lost, OUT)
    assert list(voyage.states()) == ["star.bow.out"]
    voyage.advance(10.0, replace(lost, priority=Priority.ALARM), OUT)
    assert list(voyage.states()) == ["heading.lost", "star.bow.out"]
    at_once = Voyage()
    at_once.advance(5.0, replace(lost, priority=Priority.CAUTION))
    # In the update in which the cause appears, the covered alert is not escalated first.
    assert [change.alert.id for change in at_once.advance(0.25, lost, OUT)] == []
    assert {(change.alert.id, change.description) for change in at_once.advance(0.25, lost, OUT)} == {
        ("star.bow.out", "raised"), ("heading.lost", "covered by another alert")
    }
    late = Voyage()
    late.advance(10.0, lost)
    assert list(late.states()) == ["heading.lost"]
    changes = late.advance(10.0, lost, OUT)
    assert {(change.alert.id, change.description) for change in changes} == {
        ("star.bow.out", "raised"), ("heading.lost", "covered by another alert")
    }
    late.advance(10.0, lost)
    assert "heading.lost" in late.states()


def test_start_of_the_suite_is_no_alert() -> None:
    """An output that was never received raises an alert ten seconds after the start."""
    voyage = Voyage()
    starting = replace(OUT, may_be_startup=True)
    assert voyage.advance(9.0, starting) == []
    assert [change.description for change in voyage.advance(2.0, starting)] == ["raised"]


def test_restart_keeps_alerts_and_acknowledgements() -> None:
    """Alerts keep their acknowledgement through a file, past situations end, and instances continue to count."""
    voyage = Voyage()
    gnss, ins = replace(OUT, id="gnss.out", source="gnss"), replace(OUT, id="ins.out", value=math.nan)
    voyage.advance(5.0, OUT, gnss, ins)
    voyage.acknowledge("star.bow.out")
    voyage.acknowledge("gnss.out")
    before = voyage.states()
    saved = json.loads(json.dumps(voyage.alert_list.serialise()))
    again = Voyage(AlertList(TIMES, saved, round(100.0 * S)), 100.0)
    assert again.states() == before
    # The suite has no data for some seconds after a start: no alert ends meanwhile.
    assert again.advance(9.0) == []
    assert [(change.alert.id, change.description) for change in again.advance(20.0, OUT, ins)] == [("gnss.out", "over")]
    assert again.states() == {
        "ins.out": "WARNING ACTIVE_UNACKNOWLEDGED", "star.bow.out": "WARNING ACTIVE_ACKNOWLEDGED"
    }
    again.advance(400.0, ins)
    again.advance(1.0, OUT, ins)
    assert {alert.id: alert.instance for alert in again.alert_list.alerts} == {"star.bow.out": 2, "ins.out": 1}


def test_restart_without_data_changes_nothing() -> None:
    """An alarm from before a restart stays an alarm if the new process never receives the output."""
    voyage = Voyage()
    voyage.advance(5.0, replace(OUT, priority=Priority.ALARM, text="no data"))
    voyage.acknowledge("star.bow.out")
    again = Voyage(AlertList(TIMES, voyage.alert_list.serialise(), round(100.0 * S)), 100.0)
    never = replace(OUT, text="never received", may_be_startup=True, is_never_received=True, becomes_alarm=True)
    assert again.advance(300.0, never) == []
    assert again.states() == {"star.bow.out": "ALARM ACTIVE_ACKNOWLEDGED"}


@pytest.mark.parametrize(
    "changes", [{"state": 7}, {"priority": 5}, {"text": 3}, {"instance": "2"}, {"colour": "red"}, {"changed_ns": None}]
)
def test_corrupt_file_is_refused(changes: dict[str, object]) -> None:
    """A file with invalid values is not used in part."""
    voyage = Voyage()
    voyage.advance(5.0, OUT)
    with pytest.raises(ValueError, match="not a saved alert"):
        AlertList(TIMES, [{**voyage.alert_list.serialise()[0], **changes}])


def test_most_urgent_comes_first() -> None:
    """Unacknowledged present, unacknowledged past, then acknowledged alerts; each group by priority."""
    voyage = Voyage()
    kinds = {"a": Priority.CAUTION, "b": Priority.ALARM, "c": Priority.WARNING, "d": Priority.ALARM}
    voyage.advance(2.0, *(replace(OUT, id=id_, priority=priority) for id_, priority in kinds.items()))
    voyage.acknowledge("b")
    alerts: tuple[AlertEntry, ...] = voyage.alert_list.alerts
    assert [alert.id for alert in alerts] == ["d", "c", "b", "a"]
    voyage.advance(10.0, *(replace(OUT, id=id_, priority=priority) for id_, priority in kinds.items() if id_ != "d"))
    assert [alert.id for alert in voyage.alert_list.alerts] == ["c", "d", "b", "a"]


def test_last_change_comes_first_among_equals() -> None:
    """The newer of two warnings comes first; the older one comes first after it is repeated."""
    voyage = Voyage()
    older, newer = replace(OUT, id="older"), replace(OUT, id="newer")
    voyage.advance(20.0, older)
    voyage.advance(20.0, older, newer)
    assert [alert.id for alert in voyage.alert_list.alerts] == ["newer", "older"]
    changes = voyage.advance(21.0, older, newer)
    assert [(change.alert.id, change.description[:8]) for change in changes] == [("older", "repeated")]
    assert [alert.id for alert in voyage.alert_list.alerts] == ["older", "newer"]

"""Playback of a bag: the messages that are read, and the state at any time."""

import math

import pytest

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import NS_PER_S, make_header
from ship_monitor.page import bag_playback
from ship_monitor.page.bag_playback import THINNING_PERIOD_NS, BagPlayback, RecordedSuite
from ship_testing.hand_made_bags import FACTORY, START_NS, ship_attitude, write_imu_bag
from ship_testing.recorded_suites import TURN_RAD_PER_S, write_suite
from ship_watch.history.history import HISTORY_S
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Presence

LENGTH_S = 900


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_suite(tmp_path_factory.mktemp("after") / "night.mcap", LENGTH_S)


@pytest.fixture
def suite(bag):
    suite = RecordedSuite(bag)
    yield suite
    suite.close()


@pytest.fixture
def pictures(suite):
    return BagPlayback(suite, Limits())


def complete_state(pictures):
    """Return the state after the ten minutes of history have been read."""
    picture = pictures.current_state()
    while pictures._full_replay is not None:
        picture = pictures.current_state()
    return picture


def monitor_after(suite, since_ns, until_ns):
    """Return a monitor that has processed all messages between two times."""
    monitor = SuiteMonitor(Limits())
    for each in suite.messages(since_ns):
        if each.log_time_ns > until_ns:
            break
        monitor.process_message(each.topic, each.message, each.log_time_ns)
    return monitor


def slide(pictures, at_s):
    """Move the slider as a browser does."""
    pictures._controls._slider.value = at_s
    pictures._controls._on_slider_released("value_throttled", None, at_s)


class TestWhatIsRead:
    def test_needed_messages_are_read_and_ten_a_second_of_the_others(self, bag, suite):
        found = list(suite.messages(0))
        with read_bag(bag) as whole_bag:
            records = list(whole_bag.records())
        assert [each.topic for each in found].count("ship/innovation") == LENGTH_S
        attitudes = [each.log_time_ns for each in found if each.topic == "ship/attitude"]
        steps = {record.log_time_ns // THINNING_PERIOD_NS for record in records if record.topic == "ship/attitude"}
        assert sorted(time_ns // THINNING_PERIOD_NS for time_ns in attitudes) == sorted(steps)

    def test_valid_alerts_come_first(self, suite):
        since_ns = START_NS + 400 * NS_PER_S
        first, second = [message for message, _ in zip(suite.messages(since_ns), range(2), strict=False)]
        assert (first.topic, first.log_time_ns, first.message.alerts[0].id) == ("ship/alerts", since_ns, "star.bow.out")
        assert (second.topic, second.log_time_ns) == ("ship/attitude", since_ns)
        assert "ship/alerts" not in {each.topic for each in suite.messages(since_ns)} - {first.topic}

    @pytest.mark.parametrize("prefix", ["/", "/aurora/", "a/b/"])
    def test_single_namespace_is_found(self, tmp_path, prefix):
        suite = RecordedSuite(write_suite(tmp_path / "bag.mcap", 5, prefix))
        assert {each.topic for each in suite.messages(0)} == {"ship/attitude", "ship/innovation"}
        assert [each.topic for each in RecordedSuite(suite.path, prefix).messages(0)] == [
            each.topic for each in suite.messages(0)
        ]

    def test_one_of_several_suites_must_be_selected(self, tmp_path):
        path = tmp_path / "bag.mcap"
        with BagWriter(path) as writer:
            for name in ("/a/ship/attitude", "/b/ship/attitude"):
                writer.write(name, ship_attitude(START_NS), START_NS)
        with pytest.raises(BadInput, match=r"suites in /a, /b: select one with --namespace") as problem:
            RecordedSuite(path)
        assert "\n" not in str(problem.value)
        assert len(list(RecordedSuite(path, "b").messages(0))) == 1
        with pytest.raises(BadInput, match="no topic in the namespace /c"):
            RecordedSuite(path, "/c/")

    def test_missing_data_are_reported_in_one_line(self, tmp_path, suite):
        assert suite.notes == ("night.mcap contains no truth: innovations are shown, errors are not",)
        inputs = RecordedSuite(write_imu_bag(tmp_path / "inputs.mcap", 10))
        (note,) = inputs.notes
        assert note.startswith("inputs.mcap contains no ship/attitude and no theodolite/pointing, only inputs:")
        assert BagPlayback(inputs, Limits()).location == note
        assert RecordedSuite(write_suite(tmp_path / "simulated.mcap", 2, truth=True)).notes == ()

    def test_truth_or_scenario_means_simulated(self, tmp_path, suite):
        assert BagPlayback(suite, Limits()).label == "BAG"
        with_truth = RecordedSuite(write_suite(tmp_path / "truth.mcap", 2, truth=True))
        with_scenario = RecordedSuite(
            write_imu_bag(tmp_path / "scenario.mcap", 2, attachments=[("scenario.yaml", b"seed: 1")])
        )
        labels = [BagPlayback(each, Limits()).label for each in (with_truth, with_scenario)]
        assert labels == ["SIMULATED · bag"] * 2

    def test_damaged_messages_are_skipped_with_one_line(self, tmp_path, capsys):
        path = write_suite(tmp_path / "bag.mcap", 3)
        suite = RecordedSuite(path)
        record = next(iter(suite._bag.records({"ship/attitude"})))
        record.data = record.data[:20]
        suite._bag.records = lambda *_: iter([record] * 3)
        assert list(suite.messages(0)) == []
        assert capsys.readouterr().err.count("message skipped: topic 'ship/attitude'") == 1


class TestBagPlayback:
    @pytest.mark.slow
    @pytest.mark.parametrize("at_s", [0.0, 10.0, 250.0, 599.0, 700.3, 900.0])
    def test_state_at_a_time_equals_that_after_ten_minutes(self, suite, pictures, at_s):
        pictures.go_to(at_s)
        shown = complete_state(pictures)
        time_ns = min(START_NS + round(at_s * NS_PER_S), suite.end_ns)
        monitor = monitor_after(suite, max(time_ns - round(HISTORY_S * NS_PER_S), 0), time_ns)
        assert shown == monitor.current_state(time_ns)
        assert pictures.history.safety == monitor.history.safety
        heading = next(angle for angle in shown.angles if angle.name == "heading")
        assert heading.value == pytest.approx(TURN_RAD_PER_S * (time_ns - START_NS) / NS_PER_S, abs=2e-5)

    def test_first_state_has_safety_sources_and_alerts(self, suite, pictures):
        """The messages of the last minute give all of the state except events and plots."""
        pictures.go_to(450.0)
        first, later = pictures.current_state(), complete_state(pictures)
        assert not math.isnan(first.angles[0].value)
        assert [(a.name, a.value, a.safety, a.reason) for a in first.angles] == [
            (a.name, a.value, a.safety, a.reason) for a in later.angles
        ]
        assert [(s.name, s.presence, s.nis_consistency) for s in first.sources] == [
            (s.name, s.presence, s.nis_consistency) for s in later.sources
        ]
        assert first.alerts is not None
        assert first.alerts == later.alerts

    @pytest.mark.slow
    def test_moving_from_the_end_to_the_start_and_forward(self, pictures):
        presence = {}
        for at_s in (900.0, 300.0, 880.0, 350.0):
            pictures.go_to(at_s)
            star = next(source for source in complete_state(pictures).sources if source.name == "star.bow")
            presence[at_s] = star.presence
        assert presence == {900.0: Presence.OUT, 300.0: Presence.IN, 880.0: Presence.OUT, 350.0: Presence.IN}

    def test_one_update_reads_the_minute_and_a_part_of_the_ten(self, suite, pictures, monkeypatch):
        """The messages are counted; each update of the ten minutes ends at its deadline."""
        monkeypatch.setattr(bag_playback, "MAX_READ_S", 0.0)
        processed = []
        original = SuiteMonitor.process_message
        monkeypatch.setattr(
            SuiteMonitor, "process_message", lambda self, *given: processed.append(given) or original(self, *given)
        )
        pictures.go_to(850.0)
        pictures.current_state()
        minute = sum(
            START_NS + 790 * NS_PER_S <= each.log_time_ns <= START_NS + 850 * NS_PER_S for each in suite.messages(0)
        )
        at_first = len(processed)
        assert at_first <= minute + 2  # the alerts, and one attitude, because reading starts within a tenth of a second
        pictures.current_state()
        assert len(processed) <= at_first + 1  # one message of the ten minutes of history

    def test_chosen_time_is_displayed_at_once(self, pictures):
        seen = []
        pictures.controls(lambda: seen.append(pictures.current_state().utc_ns))
        slide(pictures, 100.0)
        assert seen == pytest.approx([START_NS + 100 * NS_PER_S], abs=0.1 * NS_PER_S)

    def test_alerts_and_states_older_than_ten_minutes_are_shown(self, tmp_path):
        """The nominal value of an installation angle is the first published one, as in live monitoring."""

        def alignment(stamp_ns, azimuth):
            return FACTORY.make(
                "ship_msgs/msg/AlignmentState",
                header=make_header(FACTORY, stamp_ns),
                names=["star.bow.azimuth"],
                values=[azimuth],
                covariance=[1e-12],
                units=["rad"],
            )

        with BagWriter(tmp_path / "long.mcap") as writer:
            for second in range(1500):
                stamp_ns = START_NS + second * NS_PER_S
                writer.write("ship/attitude", ship_attitude(stamp_ns), stamp_ns)
                if second in (5, 300):
                    writer.write("ship/alignment", alignment(stamp_ns, 1.0 + 1e-6 * second), stamp_ns)
        pictures = BagPlayback(RecordedSuite(tmp_path / "long.mcap"), Limits())
        for at_s, expected in ((1400.0, (1.0003, 1.000005)), (200.0, (1.000005, 1.000005))):
            pictures.go_to(at_s)
            pictures.current_state()
            (state,) = pictures.history.alignment
            assert (state.value, state.nominal) == pytest.approx(expected, abs=1e-9)
        pictures.go_to(1.0)
        complete_state(pictures)
        assert pictures.history.alignment == ()

    def test_playback_follows_the_clock_and_stops_at_the_end(self, pictures, monkeypatch):
        now = [0.0]
        slide(pictures, 100.0)
        complete_state(pictures)
        pictures._last_update_s = 0.0
        monkeypatch.setattr(bag_playback.time, "monotonic", lambda: now[0])
        pictures._controls._play.active = True
        now[0] = 0.5
        assert (pictures.current_state().utc_ns - START_NS) / NS_PER_S == pytest.approx(100.5, abs=0.11)
        pictures._controls._on_speed_clicked()
        now[0] = 1.5
        assert (pictures.current_state().utc_ns - START_NS) / NS_PER_S == pytest.approx(110.5, abs=0.11)
        now[0] = 1000.0
        pictures.current_state()
        assert not pictures._controls.is_playing
        pictures._controls._play.active = True  # again from the start
        now[0] = 1000.1
        assert (pictures.current_state().utc_ns - START_NS) / NS_PER_S == pytest.approx(1.0, abs=0.11)

    def test_drag_stops_the_playback(self, pictures):
        slide(pictures, 100.0)
        pictures._controls._play.active = True
        pictures.current_state()
        assert pictures._controls.is_playing
        pictures._controls._slider.value = 400.0
        assert not pictures._controls.is_playing

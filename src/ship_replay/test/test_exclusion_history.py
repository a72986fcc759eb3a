"""A replay prints at its end the excluded and reinstated sources, with times."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_replay.commands.replay import main as replay
from ship_replay.offline.replay_summary import ExclusionHistory
from ship_simulation.inject_command import main as inject
from ship_testing.bag_parts import write_beginning
from ship_testing.hand_made_bags import START_NS
from ship_testing.places import ROOT

SECOND_NS = 1_000_000_000
MOUNTING_SHIFT = "faults: {knock: {topic: star/fore/horizon_attitude, kind: knock, start_s: 3.0, right_arcsec: 20.0}}\n"


def integrity(time_s: float, **excluded_for_s: float) -> Any:
    header = make_header(RosbagsFactory(), START_NS + round(time_s * SECOND_NS), "")
    return SimpleNamespace(
        header=header, excluded=list(excluded_for_s), excluded_for_s=[*map(float, excluded_for_s.values())]
    )


def test_times_of_an_exclusion() -> None:
    history = ExclusionHistory()
    for message in (
        integrity(1.0),
        integrity(2.0, fore=0.4),
        integrity(3.0, fore=1.4, ins=0.0),
        integrity(4.0, ins=1.0),
        integrity(5.0, ins=2.0, fore=0.1),
    ):
        history.add(message)
    assert history.lines(START_NS) == [
        "  fore excluded at 1.6 s, reinstated at 4.0 s",
        "  ins excluded at 3.0 s, still excluded at the end",
        "  fore excluded at 4.9 s, still excluded at the end",
    ]
    assert ExclusionHistory().lines(START_NS) == []


def test_a_replay_names_the_shifted_sensor_below_the_statuses(tmp_path: Path, capsys) -> None:
    clean, faulty = tmp_path / "clean.mcap", tmp_path / "faulty.mcap"
    write_beginning(ROOT / "bags" / "demo.mcap", clean, 6)
    (tmp_path / "faults.yaml").write_text(MOUNTING_SHIFT)
    assert inject([str(clean), "--faults", str(tmp_path / "faults.yaml"), "--out", str(faulty)]) == 0
    ends = {}
    for bag in (clean, faulty):
        assert replay([str(bag), "--out", str(tmp_path / f"{bag.stem}_out.mcap")]) == 0
        lines = capsys.readouterr().out.splitlines()
        heading = next(number for number, line in enumerate(lines) if line.startswith("status of ship/attitude"))
        ends[bag.stem] = [line for line in lines[heading:] if "excluded at" in line]
    assert ends == {"clean": [], "faulty": ["  star.fore excluded at 3.4 s, still excluded at the end"]}

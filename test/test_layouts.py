"""Layouts for viewers: all their names exist in the outputs of the suite, and a misspelt name is detected.

The outputs of the suite are those of replays of the first seconds of two bags.
"""

import copy
import json
import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_replay.commands.replay import main as replay
from ship_testing.foxglove_layouts import SCRIPTS, MessagesByTopic, Scripts, check_foxglove, check_path, paths
from ship_testing.hand_made_bags import START_NS
from ship_testing.plotjuggler_layouts import check_plotjuggler
from ship_testing.recorded_suites import alert_array

ROOT = Path(__file__).parents[1]
LAYOUTS = ROOT / "src" / "ship_bringup" / "layouts"
HOW_TO = ROOT / "docs" / "how-to" / "layouts.md"
REPLAYED_S = 12
MESSAGES_A_TOPIC = 40


def messages_of(bag_name: str, folder: Path) -> MessagesByTopic:
    """Return the suite's messages for the first seconds of a bag of the repository, by absolute topic."""
    given, result = folder / f"{bag_name}_in.mcap", folder / f"{bag_name}_out.mcap"
    with read_bag(ROOT / "bags" / f"{bag_name}.mcap") as whole, BagWriter(given) as writer:
        for attachment, data in whole.attachments.items():
            writer.add_attachment(attachment, data)
        for record in whole.records():
            if record.log_time_ns > whole.start_ns + REPLAYED_S * 10**9:
                break
            writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    assert replay([str(given), "--out", str(result)]) == 0
    found: MessagesByTopic = {}
    with read_bag(result) as bag:
        for record in bag.records([topic for topic in bag.topics if not topic.startswith("truth/")]):
            found.setdefault(f"/{record.topic.removeprefix('/')}", []).append(record.decode())
    return {topic: sample_evenly(messages) for topic, messages in found.items()}


def sample_evenly(messages: list[Any]) -> list[Any]:
    """Return at most ``MESSAGES_A_TOPIC`` evenly spaced messages, and the last three."""
    return messages[:: -(-len(messages) // MESSAGES_A_TOPIC)] + messages[-3:]


@pytest.fixture(scope="module")
def by_topic(tmp_path_factory: pytest.TempPathFactory) -> MessagesByTopic:
    """Return the outputs of a suite with all nodes; the one alert is hand-made."""
    folder = tmp_path_factory.mktemp("run")
    found: MessagesByTopic = {}
    for bag_name in ("demo", "theodolite"):
        for topic, messages in messages_of(bag_name, folder).items():
            found[topic] = found.get(topic, []) + messages
    return found | {"/ship/alerts": [alert_array(START_NS)]}


@pytest.fixture(scope="module")
def foxglove() -> dict[str, Any]:
    return dict(json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def plotjuggler() -> ET.Element:
    return ET.parse(LAYOUTS / "plotjuggler.xml").getroot()


def test_all_names_in_the_foxglove_layout_exist(foxglove: dict[str, Any], by_topic: MessagesByTopic) -> None:
    check_foxglove(foxglove, by_topic)
    assert len(paths(foxglove)) > 80


def test_each_word_of_each_path_is_checked(foxglove: dict[str, Any], by_topic: MessagesByTopic) -> None:
    scripts = Scripts(foxglove, by_topic)
    for path in sorted(set(paths(foxglove))):
        for word in re.finditer(r"\w+", path):
            wrong = "99" if word[0].isdigit() else word[0] + "x"
            if word[0].isdigit() and path.startswith(SCRIPTS):
                continue  # the length of a script's array is known only in the viewer
            with pytest.raises(AssertionError):
                check_path(path[: word.start()] + wrong + path[word.end() :], foxglove, by_topic, scripts, (object,))


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("Plot!heading", "Plot!headin"),
        ("/ship/attitude.status", "/ship/attitude.state"),
        ("event.message.pitch", "event.message.pich"),
        ('Input<\\"/ship/attitude\\">', 'Input<\\"/ship/atitude\\">'),
        ("/studio_script/ship_budget", "/studio_script/ship_budgets"),
        ('"label": "COASTING"', '"label": "COSTING"'),
        ("1 COASTING", "1 DEGRADED"),
        ('\\"WARN\\", \\"ERROR\\"', '\\"ERROR\\", \\"WARN\\"'),
        ("star.fore", "star.aft"),
        ('"topicToRender": "/diagnostics"', '"topicToRender": "/diagnostic"'),
        ('"showLegend"', '"showLegends"'),
        ("heading: number", "headin: number"),
        ("residual_arcsec: number[]", "residual_arcsec: number"),
    ],
)
def test_a_foxglove_layout_with_a_misspelt_name_is_refused(by_topic: MessagesByTopic, right: str, wrong: str) -> None:
    text = (LAYOUTS / "foxglove.json").read_text(encoding="utf-8")
    assert right in text
    with pytest.raises((AssertionError, KeyError)):
        check_foxglove(json.loads(text.replace(right, wrong, 1)), by_topic)


def test_all_names_in_the_plotjuggler_layout_exist(plotjuggler: ET.Element, by_topic: MessagesByTopic) -> None:
    check_plotjuggler(plotjuggler, by_topic)
    assert [tab.get("tab_name") for tab in plotjuggler.iter("Tab")] == [
        "Attitude", "Pointing", "Errors", "Innovations", "Inputs", "Budget"
    ]  # fmt: skip


@pytest.mark.slow
def test_each_name_in_the_plotjuggler_layout_is_checked(plotjuggler: ET.Element, by_topic: MessagesByTopic) -> None:
    for which in ("curve", "snippet"):
        for index, _ in enumerate(plotjuggler.iter(which)):
            broken = copy.deepcopy(plotjuggler)
            element = list(broken.iter(which))[index]
            if which == "curve":
                element.set("name", f"{element.get('name')}x")
            else:
                element.find("linked_source").text += "x"
            with pytest.raises(AssertionError):
                check_plotjuggler(broken, by_topic)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("protection_level[2]", "protection_level[3]"),
        ("input ins/imu", "input ins/imu2"),
        ("verdict lights", "verdict light"),
        ("Scale/Offset", "Scale"),
        ('count="4"', 'count="3"'),
        ("1 COASTING", "1 COSTING"),
    ],
)
def test_a_plotjuggler_layout_with_a_misspelt_name_is_refused(
    by_topic: MessagesByTopic, right: str, wrong: str
) -> None:
    text = (LAYOUTS / "plotjuggler.xml").read_text(encoding="utf-8")
    assert right in text
    with pytest.raises(AssertionError):
        check_plotjuggler(ET.fromstring(text.replace(right, wrong, 1)), by_topic)


PREFIXES = {"demo": "/demo", "replayed": ""}
"""Names of the files that the page makes → prefix of the topics in them."""


def test_the_printed_commands_rename_every_topic(by_topic: MessagesByTopic, tmp_path: Path) -> None:
    lines = re.findall(r"^sed -E .*$", HOW_TO.read_text(encoding="utf-8"), re.MULTILINE)
    subprocess.run("\n".join(lines).replace(" out/", f" {tmp_path}/"), shell=True, cwd=ROOT, check=True)
    for name, prefix in PREFIXES.items():
        own = {with_prefix(topic, prefix): messages for topic, messages in by_topic.items()}
        check_foxglove(json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8")), own)
        check_plotjuggler(ET.parse(tmp_path / f"{name}.xml").getroot(), own)
    assert len(lines) == len(list(tmp_path.iterdir())) == 2 * len(PREFIXES)


def with_prefix(topic: str, prefix: str) -> str:
    """Return the name of a topic in another suite; /diagnostics is the same for all."""
    return topic if topic == "/diagnostics" else f"{prefix}{topic}".removeprefix("" if prefix else "/")

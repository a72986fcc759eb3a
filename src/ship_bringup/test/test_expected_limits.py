"""``suite … --limits``: expected availability and proposals; the shipped suites are within the default limits."""

import re
from pathlib import Path

import pytest
import yaml

from ship_bringup.commands.suite import main as suite
from ship_simulation.simulate_command import main as simulate
from ship_watch.safety.limits import Limits, read_limits

ROOT = Path(__file__).parents[3]
DEMO = ROOT / "bags" / "demo.mcap"
TWO_SENSORS = ROOT / "examples" / "two_sensors.yaml"
ROW = re.compile(r"(heading|tilt|pointing) +([\d.]+)″ +([\d.]+)″ +(\d+) % +([\d.]+)″ +(\d+) %")


def run_and_read_table(arguments: list[str], capsys: pytest.CaptureFixture) -> tuple[str, dict[str, tuple[float, ...]]]:
    """Return the text, and by quantity: median accuracy, limit, share SAFE, proposed limit, share SAFE with it."""
    assert suite(arguments) == 0
    text = capsys.readouterr().out
    return text, {name: tuple(map(float, numbers)) for name, *numbers in ROW.findall(text)}


def test_availability_is_printed_for_each_limit(capsys: pytest.CaptureFixture) -> None:
    text, rows = run_and_read_table([str(TWO_SENSORS), "--bag", str(DEMO), "--limits"], capsys)
    assert "starts" not in text
    assert "Nothing is adopted" in text
    assert {name: row[1:2] + row[3:4] for name, row in rows.items()} == {"heading": (6.0, 5.0), "tilt": (4.0, 4.0)}
    assert all(share >= 95.0 for row in rows.values() for share in (row[2], row[4]))
    assert "tilt: not SAFE for 25 % of the time, whatever the limit." in text
    assert "Most frequent reason (20 % of the time): no data from star.fore." in text


def test_printed_limits_are_a_valid_file(capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    tight, adopted = tmp_path / "tight.yaml", tmp_path / "adopted.yaml"
    tight.write_text("heading_arcsec: 3.5\ntilt_arcsec: 2.9\n")
    text, rows = run_and_read_table([str(TWO_SENSORS), "--bag", str(DEMO), "--limits", str(tight), "--dry-run"], capsys)
    assert rows["heading"][1:3] == (3.5, 0.0)
    assert rows["tilt"][2] < 95.0
    adopted.write_text("".join(line + "\n" for line in text.splitlines() if re.match(r"[a-z]+_arcsec: ", line)))
    assert read_limits(adopted) == Limits(heading_arcsec=5.0, tilt_arcsec=4.0)


def test_missing_bag_or_outputs_is_one_line(capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    assert suite([str(TWO_SENSORS), "--limits"]) == 2
    assert "limits need --bag BAG" in capsys.readouterr().err
    assert suite([str(TWO_SENSORS), "--dry-run"]) == 2
    assert suite([str(TWO_SENSORS), "--bag", str(DEMO), "--limits", str(tmp_path / "none.yaml"), "--dry-run"]) == 2
    capsys.readouterr()
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(scenario("demo") | {"duration_s": 20.0}))
    assert simulate([str(tmp_path / "short.yaml"), "--out", str(tmp_path / "short.mcap"), "--seed", "1"]) == 0
    assert suite([str(TWO_SENSORS), "--bag", str(tmp_path / "short.mcap"), "--limits"]) == 2
    assert "after the first 30 s no quantity is SAFE with any limit" in capsys.readouterr().err


def scenario(name: str) -> dict:
    return yaml.safe_load((ROOT / "bags" / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8"))


def theodolite() -> dict:
    """Return the voyage of test_examples for examples/theodolite.yaml: with star sensors, without ``ship/attitude``."""
    voyage = scenario("theodolite")
    voyage["fused_attitude"]["written"] = False
    voyage["star_sensors"] = scenario("demo")["star_sensors"]
    voyage["theodolite"]["telescope"]["phase_s"] = 0.1
    return voyage


def test_shipped_bags_are_within_the_default_limits(capsys: pytest.CaptureFixture) -> None:
    """After the first 30 s, the limits are met for at least 95 % of the time in which the output is VALID and checked.
    """
    _, rows = run_and_read_table(["--bag", str(ROOT / "bags" / "theodolite.mcap"), "--limits"], capsys)
    assert list(rows) == ["pointing"]
    assert rows["pointing"][2] >= 95.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("voyage", "example", "quantities"),
    [
        # make watch
        (scenario("everything"), "", ["heading", "tilt", "pointing"]),
        (theodolite(), "theodolite", ["heading", "tilt", "pointing"]),
        (scenario("three_sensors"), "three_sensors", ["heading", "tilt"]),
    ],
    ids=["everything", "theodolite", "three_sensors"],
)
def test_shipped_suites_are_within_the_default_limits(
    voyage: dict, example: str, quantities: list[str], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path, bag = tmp_path / "voyage.yaml", tmp_path / "voyage.mcap"
    path.write_text(yaml.safe_dump(voyage))
    assert simulate([str(path), "--out", str(bag), "--seed", "1"]) == 0
    capsys.readouterr()
    file = [str(ROOT / "examples" / f"{example}.yaml")] if example else []
    _, rows = run_and_read_table([*file, "--bag", str(bag), "--limits"], capsys)
    assert list(rows) == quantities
    assert all(row[2] >= 95.0 for row in rows.values()), rows

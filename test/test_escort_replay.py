"""Advised positions for the drones in a replayed bag: their times, their limits, and no effect on other outputs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.parameters.schema import build
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import ENU_FROM_HORIZON, rotation_from_angles
from ship_replay.offline.replay import ADAPTERS, replay
from ship_simulation.simulate_command import write_bag
from ship_simulation.suite_file import suite_yaml
from ship_testing.theodolite_scenes import bag_scenario
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.escort.advice import EscortAdvice
from theodolite_calib.messages.output_messages import escort_message

ESCORT, POINTING = "theodolite/escort", "theodolite/pointing"
LIMITS = {
    "range_min_m": 600.0,
    "range_max_m": 2500.0,
    "separation_min_m": 40.0,
    "elevation_min_deg": 1.0,
    "elevation_max_deg": 80.0,
    "field_deg": 3.0,
}
PERIOD_S, DURATION_S = 2.0, 10.0


@pytest.fixture(scope="module", name="voyage")
def _voyage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return a folder with a bag, and the suite file as a dict."""
    folder, scenario = tmp_path_factory.mktemp("escort"), bag_scenario(duration_s=DURATION_S)
    write_bag(scenario, 3, folder / "in.mcap", b"")
    return folder, yaml.safe_load(suite_yaml(scenario))


def entries(
    voyage: tuple[Path, dict[str, Any]], name: str, escort: dict[str, Any], *, one_by_one: bool = False, **others: Any
) -> list[tuple[str, bytes, int, Any]]:
    """Return the outputs of a replay with parameters: topic, bytes, log time, and decoded message."""
    folder, suite = voyage
    (node,) = (name for name in suite if name.endswith("optical_axis"))
    parameters = suite[node]["ros__parameters"] | others | {"escort": escort}
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(suite | {node: {"ros__parameters": parameters}}))
    summary = replay(folder / "in.mcap", folder / f"{name}.mcap", ADAPTERS, path, one_by_one=one_by_one)
    assert summary.problems == []
    with read_bag(folder / f"{name}.mcap") as bag:
        return [
            (record.topic.strip("/"), bytes(record.data), record.log_time_ns, record.decode())
            for record in bag.records()
        ]


@pytest.fixture(scope="module", name="advised")
def _advised_entries(voyage: tuple[Path, dict[str, Any]]) -> list[tuple[str, bytes, int, Any]]:
    return entries(voyage, "advised", {"enabled": True, "period_s": PERIOD_S, **LIMITS})


def messages(outputs: list[tuple[str, bytes, int, Any]], topic: str) -> list[Any]:
    return [message for name, _, _, message in outputs if name == topic]


def test_published_once_in_a_period_with_places_within_the_limits(advised, voyage) -> None:
    published, pointings = messages(advised, ESCORT), messages(advised, POINTING)
    stamps = [ns_from_stamp(message.header.stamp) for message in published]
    assert DURATION_S / PERIOD_S - 2 <= len(published) <= DURATION_S / PERIOD_S + 1
    assert np.all(np.diff(stamps) >= PERIOD_S * SECOND_NS)
    by_stamp = {ns_from_stamp(message.header.stamp): message for message in pointings}
    lever_m = parameters_of(voyage)["lever"]
    assert any(lever_m.values())
    checked = 0
    for message, stamp in zip(published, stamps, strict=True):
        assert message.header.frame_id == "horizon"
        assert list(message.beacon_ids) == sorted(parameters_of(voyage)["beacons"])
        assert 0.0 < message.sigma_advised <= message.sigma_now
        places = np.array([[place.x, place.y, place.z] for place in message.places])
        assert np.isfinite(places).all()
        assert np.linalg.norm(places[0] - places[1]) >= LIMITS["separation_min_m"]
        pointing = by_stamp[stamp]
        if np.isnan(pointing.telescope_azimuth):
            continue
        axis = (
            ENU_FROM_HORIZON
            @ rotation_from_angles(
                pointing.telescope_azimuth, pointing.telescope_elevation, pointing.telescope_rotation
            )[:, 0]
        )
        # The lever of some metres between the ship's antenna and the theodolite is not applied here, but allowed as
        # slack.
        slack_m = float(np.linalg.norm(list(lever_m.values())))
        range_m = np.linalg.norm(places, axis=1)
        assert np.all(range_m >= LIMITS["range_min_m"] - slack_m)
        assert np.all(range_m <= LIMITS["range_max_m"] + slack_m)
        off_deg = np.rad2deg(np.arccos(places @ axis / range_m))
        assert np.all(off_deg <= LIMITS["field_deg"] + np.rad2deg(slack_m / range_m))
        checked += 1
    assert checked >= 2


def parameters_of(voyage: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    _, suite = voyage
    (node,) = (name for name in suite if name.endswith("optical_axis"))
    found = suite[node]["ros__parameters"]
    config = build(OpticalAxisConfig, found)
    lever = {name: getattr(config.lever, name) for name in ("forward_m", "up_m", "right_m")}
    return found | {"lever": lever, "beacons": config.beacons}


def test_a_replay_in_blocks_gives_what_one_by_one_gives(advised, voyage) -> None:
    escort = {"enabled": True, "period_s": PERIOD_S, **LIMITS}
    singly = entries(voyage, "singly", escort, one_by_one=True)
    assert [entry[:3] for entry in singly] == [entry[:3] for entry in advised]


def test_other_outputs_are_those_without_advice(advised, voyage) -> None:
    without = entries(voyage, "without", LIMITS)
    assert messages(without, ESCORT) == []
    assert [entry[:3] for entry in without] == [entry[:3] for entry in advised if entry[0] != ESCORT]


@pytest.mark.slow
def test_a_removed_drone_has_no_position(voyage) -> None:
    escort = {"enabled": True, "period_s": 4.0, **LIMITS}
    first, second = sorted(parameters_of(voyage)["beacons"])
    published = messages(entries(voyage, "one", escort, sources_off=[f"baseline.{first}"]), ESCORT)
    assert [list(message.beacon_ids) for message in published] == [[second]] * len(published)
    assert len(published) >= 2
    assert messages(entries(voyage, "dark", escort, sources_off=["lights"]), ESCORT) == []


@pytest.mark.slow
def test_no_place_is_nan_with_the_limit(voyage) -> None:
    escort = LIMITS | {"enabled": True, "elevation_min_deg": 79.0, "period_s": 4.0}
    published = messages(entries(voyage, "none", escort), ESCORT)
    assert len(published) >= 2
    for message in published:
        assert [list(message.limits_reached)] == [["elevation_min_deg"]]
        assert np.isnan([[place.x, place.y, place.z] for place in message.places]).all()
        assert np.isnan(message.sigma_advised)
        assert message.sigma_now > 0.0


def test_places_are_east_north_up() -> None:
    places_n = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])  # North, Up, East
    advice = EscortAdvice(("a", "b"), places_n, 2e-5, 1e-5, ("a: field_deg",))
    message = escort_message(RosbagsFactory(), advice, 5 * SECOND_NS)
    assert [(place.x, place.y, place.z) for place in message.places] == [(3.0, 1.0, 2.0), (6.0, 4.0, 5.0)]
    assert (message.sigma_now, message.sigma_advised) == (2e-5, 1e-5)
    assert list(message.limits_reached) == ["a: field_deg"]

"""What no single value shows to be wrong with a theodolite and its lights; each text begins with the key."""

from collections.abc import Iterator, Mapping
from typing import Any

from ship_simulation.scenario.beacon_scenario import SECTIONS_OF_FLIGHT, Beacon
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_units import window_problems


def theodolite_problems(scenario: Scenario, given: Mapping[str, Any]) -> Iterator[str]:
    """The problems of a scenario; ``given`` is what its file holds."""
    if not scenario.theodolite.aboard:
        for group in ("theodolite", "beacons"):
            if given.get(group):
                yield f"'{group}' is not used without 'theodolite.aboard: true'"
        return
    programme = scenario.theodolite.programme
    if programme.greatest_elevation_deg < programme.least_elevation_deg:
        yield (
            f"'theodolite.programme.greatest_elevation_deg' = {programme.greatest_elevation_deg} deg must not be "
            f"less than least_elevation_deg = {programme.least_elevation_deg} deg"
        )
    for beacon_id, beacon in scenario.beacons.items():
        yield from _beacon_problems(f"beacons.{beacon_id}", beacon, given["beacons"][beacon_id].get("flight", {}))


def _beacon_problems(key: str, beacon: Beacon, flight: Mapping[str, Any]) -> Iterator[str]:
    kind = beacon.flight.kind
    for group in SECTIONS_OF_FLIGHT.values():
        if group in flight and group != SECTIONS_OF_FLIGHT[kind]:
            yield f"'{key}.flight.{group}' is not used by a flight of kind {kind}: expected {SECTIONS_OF_FLIGHT[kind]}"
    moments = [waypoint.time_s for waypoint in beacon.flight.waypoints.values()]
    if kind == "legs" and len(set(moments)) < max(2, len(moments)):
        yield f"'{key}.flight.waypoints' must be two or more with different time_s, got {moments}"
    windows = {"hidden": beacon.hidden, "rtk.float_times": beacon.rtk.float_times}
    windows |= {"rtk.no_solution_times": beacon.rtk.no_solution_times, "rtk.outages": beacon.rtk.outages}
    for group, named in windows.items():
        for name, window in named.items():
            yield from window_problems(f"{key}.{group}.{name}", window.start_s, window.end_s)

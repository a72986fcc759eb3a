"""The reference case at star level, cut short and changed, for several test files."""

import dataclasses

from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.places import ROOT

PAPER_STARS = ROOT / "bags" / "scenarios" / "paper_stars.yaml"


def paper_stars(**changes) -> Scenario:
    """Ten seconds of it with few INS samples, fields of the scenario changed."""
    scenario = load_scenario(PAPER_STARS)
    quick = dataclasses.replace(scenario, duration_s=10.0, ins=dataclasses.replace(scenario.ins, rate_hz=10.0))
    return dataclasses.replace(quick, **changes)


def with_sensor(scenario: Scenario, **changes) -> Scenario:
    """The scenario with one sensor only, ``fore``, changed; ``camera`` is a mapping of changes."""
    fore = scenario.star_sensors["fore"]
    if "camera" in changes:
        changes["camera"] = dataclasses.replace(fore.camera, **changes["camera"])
    return dataclasses.replace(scenario, star_sensors={"fore": dataclasses.replace(fore, **changes)})


def with_position(scenario: Scenario, **changes) -> Scenario:
    """The scenario with another place, motion or receiver."""
    return dataclasses.replace(scenario, position=dataclasses.replace(scenario.position, **changes))

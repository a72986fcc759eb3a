"""The reference case with single stars (scenario ``paper_stars``), shortened and changed, for several test files."""

import dataclasses
import re

from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.places import ROOT

PAPER_STARS = ROOT / "bags" / "scenarios" / "paper_stars.yaml"

EXACT_OPTICS = {"focal_length_sigma_m": 1e-12, "principal_sigma_px": 0.0, "distortion_sigma": 0.0}


def paper_stars(**changes) -> Scenario:
    """Return ten seconds of the case with the INS at 10 Hz and exact optics; ``changes`` replace scenario fields."""
    scenario = with_exact_optics(load_scenario(PAPER_STARS))
    quick = dataclasses.replace(scenario, duration_s=10.0, ins=dataclasses.replace(scenario.ins, rate_hz=10.0))
    return dataclasses.replace(quick, **changes)


def make_optics_exact(scenario: dict) -> None:
    """Set the sigmas of the optics in a scenario's content to almost zero, in place."""
    for group in ("star_sensors", "telescopes"):
        for one in scenario.get(group, {}).values():
            if "camera" in one:
                one["camera"] |= EXACT_OPTICS


def without_optics_sigmas(suite: str) -> str:
    """Return a suite file's text without the sigmas of the optics, so that their defaults apply."""
    return re.sub(rf"(?m)^ *({'|'.join(EXACT_OPTICS)}):.*\n", "", suite)


def with_exact_optics(scenario: Scenario) -> Scenario:
    """Return the scenario whose true cameras are the configured ones."""
    changes = {}
    for group in ("star_sensors", "telescopes"):
        changes[group] = {
            id_: dataclasses.replace(one, camera=dataclasses.replace(one.camera, **EXACT_OPTICS))
            for id_, one in getattr(scenario, group).items()
        }
    return dataclasses.replace(scenario, **changes)


def with_sensor(scenario: Scenario, **changes) -> Scenario:
    """Return the scenario with one sensor only, ``fore``, changed; ``camera`` is a mapping of changes."""
    fore = scenario.star_sensors["fore"]
    if "camera" in changes:
        changes["camera"] = dataclasses.replace(fore.camera, **changes["camera"])
    return dataclasses.replace(scenario, star_sensors={"fore": dataclasses.replace(fore, **changes)})


def with_position(scenario: Scenario, **changes) -> Scenario:
    """Return the scenario with another place, motion or receiver."""
    return dataclasses.replace(scenario, position=dataclasses.replace(scenario.position, **changes))

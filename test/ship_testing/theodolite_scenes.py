"""Scenarios of a theodolite with lights, shared by several test files."""

import dataclasses

from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.scenario.theodolite_scenario import Flight, Hover
from ship_testing.places import ROOT

SCENARIOS = ROOT / "bags" / "scenarios"


def replace_nested(record, **changes):
    """Return a nested dataclass with changes by path: ``air__sigma=0.0`` is the field sigma of the field air."""
    own = {}
    for path, value in changes.items():
        name, _, rest = path.partition("__")
        own[name] = replace_nested(own.get(name, getattr(record, name)), **{rest: value}) if rest else value
    return dataclasses.replace(record, **own)


def with_beacons(scenario, **changes):
    """Return the scenario with the same changes of all its beacons."""
    return dataclasses.replace(
        scenario, beacons={key: replace_nested(beacon, **changes) for key, beacon in scenario.beacons.items()}
    )


def with_theodolite(scenario, **changes):
    return dataclasses.replace(scenario, theodolite=replace_nested(scenario.theodolite, **changes))


def bag_scenario(duration_s=10.0, **changes):
    """Return the scenario of bags/theodolite.mcap, shortened."""
    return dataclasses.replace(load_scenario(SCENARIOS / "theodolite.yaml"), duration_s=duration_s, **changes)


def with_stars_and_targets(scenario):
    """Return the scenario with the targets, the star cameras and the main detector of theodolite_night.yaml."""
    stars = load_scenario(SCENARIOS / "theodolite_night.yaml")
    return dataclasses.replace(
        with_theodolite(scenario, main_detector=stars.theodolite.main_detector),
        targets=stars.targets,
        telescopes=stars.telescopes,
    )


def without_errors(scenario):
    """Return a scenario without random errors and with large axis errors; images coincide with other samples."""
    names = ("g", "h", "c", "I", "beta_x", "beta_y", "flexure")
    known = {f"axes__{name}_arcsec": 35.0 - 11.0 * number for number, name in enumerate(names)}
    sigmas = {f"axes__{name}_sigma_arcsec": 0.0 for name in names}
    angles = {f"telescope__{name}_sigma_arcsec": 0.0 for name in ("azimuth", "elevation", "rotation")}
    scenario = with_theodolite(
        scenario,
        **known,
        **sigmas,
        **angles,
        encoder__sigma_arcsec=0.0,
        deformation__sigma_arcsec=0.0,
        lever__sigma_m=0.0,
        telescope__focal_length_sigma_m=0.0,
        telescope__sigma_m=1e-9,
        telescope__lens__sigma_m=0.0,
        telescope__rate_hz=1.0,
        telescope__phase_s=0.5,
        air__sigma=0.0,
        air__light_sigma=0.0,
        ship_antenna__sigma_m=0.0,
    )
    return with_beacons(
        dataclasses.replace(
            scenario,
            fused_attitude=replace_nested(
                scenario.fused_attitude, tilt_sigma_arcsec=0.0, heading_sigma_arcsec=0.0, white_sigma_arcsec=0.0
            ),
        ),
        light__sigma_m=0.0,
        rtk__sigma_m=0.0,
        rtk__bias_sigma_m=0.0,
        imu__tilt_sigma_deg=0.0,
        imu__heading_sigma_deg=0.0,
        imu__white_sigma_deg=0.0,
    )


_HANGING_DEG = {"a": (3.0, 11.0), "b": (-1.0, 9.0)}
"""Azimuth and elevation at the start of the two lights over which the telescope sweeps."""


def sweep_over_beacons(exposure_s):
    """Return a scenario in which the telescope sweeps over two lights, without errors of the images."""
    scenario = without_errors(with_theodolite(bag_scenario(duration_s=2.0), telescope__exposure_s=exposure_s))
    flights = {
        key: Flight(hover=Hover(azimuth_deg=azimuth, elevation_deg=elevation, distance_m=2000.0, north_m_per_s=8.0))
        for key, (azimuth, elevation) in _HANGING_DEG.items()
    }
    beacons = {key: replace_nested(scenario.beacons[key], flight=flight) for key, flight in flights.items()}
    return dataclasses.replace(scenario, beacons=beacons)

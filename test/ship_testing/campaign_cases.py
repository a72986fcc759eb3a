"""Cases, full and short, for comparing the errors of the ship's attitude with their covariance over many seeds.

``tools/campaign.py`` runs each in full length, ``test/test_campaign_cases.py`` short. Each is a scenario of
``bags/scenarios``, or one with a change; the configuration of the suite follows from it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion, Outage, Wave
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.places import SCENARIOS

INS_RATE_HZ = 20.0
"""Rate of the INS in voyages of full length; a scenario's own 100 Hz give the same result at five times the cost."""


@dataclass(frozen=True)
class ShortRun:
    """Reductions of a case for a test of many seeds, which do not change what is tested.

    Attributes:
        duration_s: length.
        ins_rate_hz: samples of the INS.
        star_rate_hz: exposures of each star sensor; None: as in full length.
        clouds_s: start of clouds that last to the end, if any.
    """

    duration_s: float
    ins_rate_hz: float
    star_rate_hz: float | None
    clouds_s: float | None = None


def _without_change(scenario: Scenario) -> Scenario:
    return scenario


@dataclass(frozen=True)
class Case:
    """Scenario file, reductions of the short case, and change of the scenario."""

    file: str
    short: ShortRun
    change: Callable[[Scenario], Scenario] = _without_change


def case_at_length(name: str, recording: Path | None = None) -> Scenario:
    """Return a case as in the campaign.

    Args:
        name: of CASES.
        recording: bag with the ship's motion, for the case ``recorded`` only.
    """
    case = CASES[name]
    whole = load_scenario(SCENARIOS / f"{case.file}.yaml", recording=recording)
    return case.change(replace(whole, ins=replace(whole.ins, rate_hz=INS_RATE_HZ)))


def case_in_short(name: str, recording: Path | None = None) -> Scenario:
    """Return a case as in a test of many seeds; for the arguments see :func:`case_at_length`."""
    whole, short = case_at_length(name, recording), CASES[name].short
    changes: dict[str, Any] = {}
    if short.star_rate_hz is not None:
        changes["rate_hz"] = short.star_rate_hz
    if short.clouds_s is not None:
        changes["outages"] = {"clouds": Outage(short.clouds_s, short.duration_s + 1.0)}
    ins = replace(whole.ins, rate_hz=short.ins_rate_hz)
    return _each_sensor(replace(whole, duration_s=short.duration_s, ins=ins), **changes)


def _each_sensor(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with each star sensor changed."""
    sensors = {id_: replace(one, **changes) for id_, one in scenario.star_sensors.items()}
    return replace(scenario, star_sensors=sensors)


def _rolling_by_a_poor_clock(scenario: Scenario) -> Scenario:
    """Roll of 15° amplitude and 9 s period: at 10.5°/s, the clock's sigma of 20 ms causes 750 arcseconds."""
    roll = AngleMotion(waves={"swell": Wave(amplitude_deg=15.0, period_s=9.0)})
    ins = replace(scenario.ins, time_offset_sigma_s=0.02)
    return replace(scenario, ins=ins, carrier=replace(scenario.carrier, roll=roll))


def _late_at_two_rates(scenario: Scenario) -> Scenario:
    """Rates of 5 and 3 Hz: exposures of the two sensors coincide only once a second, and arrive half a second late."""
    late = _each_sensor(scenario, latency_s=0.5).star_sensors
    rates_hz = {"fore": 5.0, "starboard": 3.0}
    return replace(scenario, star_sensors={id_: replace(late[id_], rate_hz=rate) for id_, rate in rates_hz.items()})


def _without_waves(scenario: Scenario) -> Scenario:
    """A voyage of hours without waves, with one sample of each device every ten seconds."""
    heading, pitch, roll = AngleMotion(mean_deg=5.0), AngleMotion(mean_deg=0.5), AngleMotion(mean_deg=2.0)
    return replace(
        _each_sensor(scenario, rate_hz=0.1, phase_s=0.0),
        carrier=CarrierMotion(kind="sinusoids", heading=heading, pitch=pitch, roll=roll),
        ins=replace(scenario.ins, rate_hz=0.1, time_offset_sigma_s=0.0),
        position=replace(scenario.position, rate_hz=0.1),
    )


def _on_the_same_pixels(scenario: Scenario) -> Scenario:
    """A ship at a quay for two minutes: her stars drift by a seventh of a pixel between exposures."""
    heading, pitch = AngleMotion(mean_deg=34.4), AngleMotion(mean_deg=0.2)
    sensors = {
        id_: replace(one, camera=replace(one.camera, field_spatial_sigma_px=0.3, pixel_spatial_sigma_px=0.2))
        for id_, one in scenario.star_sensors.items()
    }
    carrier = CarrierMotion(kind="sinusoids", heading=heading, pitch=pitch, roll=AngleMotion(mean_deg=0.5))
    return replace(scenario, star_sensors=sensors, carrier=carrier, duration_s=min(scenario.duration_s, 120.0))


CASES = {
    # Two sensors 90° apart in azimuth.
    "paper": Case("paper", ShortRun(60.0, 20.0, 2.0)),
    # The error of one sensor about its boresight is large, so the error ellipsoid of the attitude is long.
    "one_sensor": Case("one_sensor", ShortRun(60.0, 20.0, 2.0)),
    # A turn of the ship separates the errors of the INS from those of the installation.
    "turn": Case("turn", ShortRun(280.0, 5.0, 1.0)),
    # Thirty minutes of clouds: the covariance grows as the INS's errors do.
    "outage": Case("outage", ShortRun(1860.0, 10.0, 1.0, clouds_s=60.0)),
    # Star data 0.5 s to 1.3 s late, and out of order.
    "late_shuffled": Case("late_shuffled", ShortRun(40.0, 20.0, 2.0)),
    # The waves follow a spectrum, and differ between seeds.
    "sea_state_5": Case("sea_state_5", ShortRun(60.0, 20.0, 2.0)),
    # The hull bends between INS and sensors while a wave passes.
    "flexure": Case(
        "paper", ShortRun(60.0, 20.0, 2.0), partial(_each_sensor, flexure_sigma_arcsec=5.0, flexure_time_s=10.0)
    ),
    # The roll makes the offset of the INS's clock observable. The offset is so large that its effect is not linear.
    "poor_clock": Case("paper", ShortRun(60.0, 20.0, 2.0), _rolling_by_a_poor_clock),
    # A late exposure rewinds the filter over exposures of the other sensor.
    "two_rates_late": Case("paper", ShortRun(25.0, 20.0, None), _late_at_two_rates),
    # Single stars of the real sky, at most eight an exposure.
    "paper_stars": Case("paper_stars", ShortRun(30.0, 10.0, 1.0)),
    # Stars to fourth magnitude alone: none to three in a field of 13°.
    "few_stars": Case(
        "paper_stars", ShortRun(40.0, 10.0, 1.0), partial(_each_sensor, magnitude_limit=4.0, most_stars=3)
    ),
    # A ship that rolls draws her stars as streaks.
    "streaks": Case("paper_stars", ShortRun(30.0, 10.0, 1.0), partial(_each_sensor, exposure_s=0.1)),
    # Field-spatial errors of 7″ and pixel-spatial errors of 5″, which do not average out while the stars stay on the
    # same pixels.
    "spatial_errors": Case("paper_stars", ShortRun(20.0, 10.0, 2.0), _on_the_same_pixels),
    # An undamped INS, two hours of stars and two of clouds.
    "schuler": Case("schuler", ShortRun(3600.0, 0.05, 0.025, clouds_s=1800.0), _without_waves),
    # The vertical changes by 60 arcseconds under clouds; the suite has a table of this change.
    "deflection": Case("deflection", ShortRun(3600.0, 0.05, 0.05), _without_waves),
    # The ship's motion is that of a recording made at sea.
    "recorded": Case("recorded", ShortRun(60.0, 20.0, None)),
}
WITHOUT_RECORDING = tuple(name for name in CASES if name != "recorded")

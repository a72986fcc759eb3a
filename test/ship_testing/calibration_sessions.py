"""Simulated calibration sessions: two star sensors 90° apart in azimuth, on a ship that is still, turns or heels."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion, Turn, Wave
from ship_simulation.scenario.scenario import Ins, Reference, Scenario, StarSensor
from ship_simulation.suite_file import suite_yaml

PRIOR_ARCSEC = 20.0

STILL = CarrierMotion(kind="sinusoids", heading=AngleMotion(mean_deg=34.4))
TURN = replace(STILL, turn=Turn(start_s=3.0, angle_deg=360.0, rate_deg_per_s=15.0, ramp_s=2.0))
HEELING = replace(
    TURN,
    pitch=AngleMotion(waves={"swell": Wave(amplitude_deg=3.0, period_s=8.0)}),
    roll=AngleMotion(waves={"swell": Wave(amplitude_deg=6.0, period_s=11.0)}),
)
PLATE = Reference(
    rate_hz=2.0,
    installation_sigma_arcsec=0.0,
    sigma_roll_arcsec=5.0,
    sigma_pitch_arcsec=5.0,
    sigma_heading_arcsec=5.0,
    time_offset_sigma_s=0.001,
)
"""A reference fixed to the deck, so its installation is known."""


def sensor(azimuth_deg: float, sigma_arcsec: float = PRIOR_ARCSEC) -> StarSensor:
    return StarSensor(
        azimuth_deg=azimuth_deg,
        elevation_deg=45.0,
        rate_hz=2.0,
        installation_sigma_forward_arcsec=sigma_arcsec,
        installation_sigma_up_arcsec=sigma_arcsec,
        installation_sigma_right_arcsec=sigma_arcsec,
    )


def session(
    carrier: CarrierMotion, reference: bool = False, duration_s: float = 30.0, sigma_arcsec: float = PRIOR_ARCSEC
) -> Scenario:
    return Scenario(
        carrier=carrier,
        start_utc="2014-07-09T11:50:07.8Z",
        duration_s=duration_s,
        ins=Ins(rate_hz=20.0),
        star_sensors={"fore": sensor(0.0, sigma_arcsec), "starboard": sensor(90.0, sigma_arcsec)},
        references={"plate": PLATE} if reference else {},
    )


def write_session(
    path: Path,
    scenario: Scenario,
    seed: int = 1,
    leave_out: Sequence[str] = (),
    suite: Callable[[str], str] | None = lambda text: text,
) -> SimulatedRun:
    """Simulate a session and write it to a bag.

    Args:
        path: path of the bag.
        scenario: scenario of the session.
        seed: seed of the run.
        leave_out: topics left out of the bag.
        suite: function that changes the scenario's suite configuration for the attachment; None for no attachment.
    """
    run = simulate(scenario, seed)
    with BagWriter(path) as bag:
        if suite is not None:
            bag.add_attachment(SUITE_ATTACHMENT, suite(suite_yaml(scenario)))
        for topic, message, log_time_ns in generate_messages([run], RosbagsFactory()):
            if topic not in leave_out:
                bag.write(topic, message, log_time_ns)
    return run

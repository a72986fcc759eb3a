"""Trials pass to a core the data that an adapter reads from the messages of the same run."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import SKY_SOURCES, simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario_file import load_scenario
from ship_stars.messages.star_messages import ExposingSensor
from ship_stars.messages.star_messages import star_exposure as read_exposure
from ship_stars.messages.surroundings_messages import humidity, position_fix, pressure, temperature
from ship_stars.sky.catalogue import hipparcos
from ship_stars.sky.config import SkyConfig
from ship_testing.paper_stars import paper_stars, with_position, with_sensor
from ship_testing.trials.monte_carlo import attitude_outcomes, core_for, measurement_of, sky_input, star_exposure

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
OBSERVATIONS = "star/fore/observations"


def entries_of(run, topic):
    """Return message and log time of each message of a topic; the messages are encoded and decoded as in a bag."""
    store = message_store()
    found = [(message, log) for name, message, log in generate_messages([run], RosbagsFactory()) if name == topic]
    return [(store.deserialize_cdr(serialize(message), message.__msgtype__), log) for message, log in found]


@pytest.mark.parametrize("identity", [{}, {"direction_given": True}, {"identified": False}], ids=str)
def test_an_estimator_reads_in_the_messages_what_the_run_holds(identity):
    scenario = with_sensor(
        paper_stars(duration_s=4.0), false_stars=1.0, outages={"cloud": Outage(1.0, 2.0)}, exposure_s=0.05, **identity
    )
    run = simulate(scenario, seed=1)
    sightings, config = run.stars["fore"], scenario.star_sensors["fore"].camera
    entries = entries_of(run, OBSERVATIONS)
    assert len(entries) == sightings.time_ns.size == 21
    for index, (message, log) in enumerate(entries):
        assert log == sightings.log_time_ns[index]
        assert message.exposure_s == pytest.approx(0.05)
        sensor = ExposingSensor("fore", "star_fore", config.camera("camera"), config)
        reading = read_exposure(message, log, sensor, hipparcos())
        held = star_exposure(run, "fore", index)
        read = reading.value
        assert reading.rejected_parts == ()
        assert read.content() == held.content()
        assert (read.source, read.time_ns) == (held.source, held.time_ns)
        np.testing.assert_array_equal(read.sigma, held.sigma)
        np.testing.assert_array_equal(read.is_identified, held.is_identified)
        for name in vars(held.positions):
            np.testing.assert_array_equal(getattr(read.positions, name), getattr(held.positions, name))
        # One sigma is for the year of the run's start, the other for the year of the exposure.
        np.testing.assert_allclose(read.position_sigma, held.position_sigma, rtol=1e-4)


@pytest.mark.parametrize("exposure_s", [0.1, 2.0])
def test_exposures_have_their_length(exposure_s):
    still, moving = (
        star_exposure(simulate(with_sensor(paper_stars(duration_s=4.0), exposure_s=length_s), seed=1), "fore", 0)
        for length_s in (0.0, exposure_s)
    )
    assert moving.length.exposure_s == pytest.approx(exposure_s)
    assert still.length is None


def test_fixes_and_weather_are_read_as_the_run_holds_them():
    run = simulate(with_position(with_sensor(paper_stars(duration_s=6.0)), slow_sigma_m=30.0), seed=1)
    read = {
        "fix": [position_fix(m, SkyConfig(), log) for m, log in entries_of(run, "gnss/fix")],
        "pressure": [pressure(m, log) for m, log in entries_of(run, "met/pressure")],
        "temperature": [temperature(m, log) for m, log in entries_of(run, "met/temperature")],
        "humidity": [humidity(m, log) for m, log in entries_of(run, "met/humidity")],
    }
    arrivals = [(source, index) for _, source, index in run.arrivals() if source in SKY_SOURCES]
    assert {source: sum(s == source for s, _ in arrivals) for source in SKY_SOURCES} == {
        "fix": 7,
        "pressure": 4,
        "temperature": 4,
        "humidity": 4,
    }
    for source, index in arrivals:
        held, found = sky_input(run, source, index), read[source][index].value
        if source == "fix":
            np.testing.assert_array_equal(found.covariance_m2, held.covariance_m2)
            assert (found.time_ns, found.position) == (held.time_ns, held.position)
        else:
            assert found == dataclasses.replace(held, value=pytest.approx(held.value, rel=1e-15))


def one_by_one(core, run, wanted_ns):
    """Return the outcomes of a run whose INS samples are passed to the core one after another."""
    for _, source, index in run.arrivals():
        if source == "ins":
            time_ns = int(run.ins.time_ns[index])
            sample = AttitudeSample(time_ns, run.ins.rotation_nd[index], run.ins.rate_d[index])
            yield core.ins.add(sample, estimate=time_ns in wanted_ns)
        elif source in SKY_SOURCES:
            yield core.add_surroundings(sky_input(run, source, index))
        else:
            yield core.add_measurement(measurement_of(run, source, index))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "late_shuffled", "everything"])
def test_ins_samples_in_batches_equal_those_one_by_one(name):
    scenario = dataclasses.replace(load_scenario(SCENARIOS / f"{name}.yaml"), duration_s=40.0)
    run = simulate(scenario, seed=1)
    wanted_ns = set(run.ins.time_ns[[700, 701, 1500, -1]].tolist())
    cores = core_for(scenario), core_for(scenario)
    found, expected = (
        list(outcomes(core, run, wanted_ns))
        for outcomes, core in zip((attitude_outcomes, one_by_one), cores, strict=True)
    )
    for attribute in ("estimates", "decisions", "rejection"):
        values = [[getattr(outcome, attribute) for outcome in some] for some in (found, expected)]
        one, other = ([each for each in some if each] for some in values)
        assert len(one) == len(other)
        if attribute == "estimates":
            for (mine,), (theirs,) in zip(one, other, strict=True):
                assert mine.time_ns == theirs.time_ns
                np.testing.assert_array_equal(mine.rotation_nd, theirs.rotation_nd)
                np.testing.assert_array_equal(mine.covariance_n, theirs.covariance_n)
        if attribute == "decisions":
            assert [[(d.accepted, d.nis) for d in each] for each in one] == [
                [(d.accepted, d.nis) for d in each] for each in other
            ]
    np.testing.assert_array_equal(cores[0].state.mean, cores[1].state.mean)

"""Simulated voyages through both nodes' cores: ``ship_attitude`` uses the solutions of ``star_attitude``."""

from collections.abc import Container, Iterator

from ship_attitude_star.adapters.star_attitude_adapter import star_horizon_attitude
from ship_attitude_star.messages.input_messages import star_measurement
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.core import StarCore
from ship_estimation.parameters.schema import build
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_simulation.run import SKY_SOURCES, SimulatedRun
from ship_simulation.suite_file import star_attitude_configuration, suite_configuration
from ship_stars.attitude_samples import AttitudeOutcome
from ship_stars.camera.config import JOINT
from ship_stars.sky.sky_model import load_sky_model
from ship_testing.adapter_runs import FACTORY
from ship_testing.trials.monte_carlo import sky_input, star_exposure


def run_with_solutions(run: SimulatedRun) -> list[AttitudeOutcome]:
    """Return the outcome of each input of ``ship_attitude``, in order; both nodes are configured for the scenario."""
    return list(outcomes_with_solutions(core_with_solutions(run), run, range(run.ins.time_ns.size)))


def core_with_solutions(run: SimulatedRun) -> ShipAttitudeCore:
    """Return a core of ``ship_attitude`` that uses the solutions of all star sensors of a scenario."""
    suite = suite_configuration(run.scenario)
    for sensor in suite["star_sensors"].values():
        sensor["input"] = "solution"
    config = build(ShipAttitudeConfig, suite)
    return ShipAttitudeCore(config, load_sky_model(config.sky))


def outcomes_with_solutions(
    core: ShipAttitudeCore, run: SimulatedRun, output_samples: Container[int]
) -> Iterator[AttitudeOutcome]:
    """Yield the core's outcome of each input; attitudes are computed only at the INS samples ``output_samples``."""
    star_config = build(StarAttitudeConfig, star_attitude_configuration(run.scenario))
    solver = StarCore(star_config, load_sky_model(star_config.sky))
    for _, source, index in run.arrivals():
        solved = []
        if source == "ins":
            rotation_nd, rate_d = run.ins.rotation_nd[index], run.ins.rate_d[index]
            sample = AttitudeSample(int(run.ins.time_ns[index]), rotation_nd, rate_d)
            solved = solver.add_ins(sample).solved
            yield core.ins.add(sample, estimate=index in output_samples)
        elif source in SKY_SOURCES:
            solver.add_surroundings(sky_input(run, source, index))
            yield core.add_surroundings(sky_input(run, source, index))
        else:
            solved = solver.add_exposure(star_exposure(run, source.partition(".")[2], index)).solved
        for one in solved:
            if one.is_valid and one.sensor_id != JOINT:
                sensor = core.config.star_sensors[one.sensor_id]
                message = star_horizon_attitude(FACTORY, one, sensor.frame_id)
                yield core.add_measurement(star_measurement(message, one.sensor_id, sensor, one.time_ns).value)

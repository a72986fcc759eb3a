"""One simulated voyage as arrays, without ROS and files: samples of the devices, their arrival times, and the truth.

A voyage is simulated as a whole, or in successive stretches; the samples are the same.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.random_draws import STRETCH_S, Draws, Stretch, split_voyage, truth_indices
from ship_simulation.scenario.scenario import Scenario, start_time_ns
from ship_simulation.ship.attitude_device import (
    DeviceSamples,
    DeviceTruth,
    FusedSamples,
    InsSamples,
    InsTruth,
    simulate_fused_attitude,
    simulate_ins,
    simulate_reference,
    simulate_star_sensor,
    star_sensor_motion,
)
from ship_simulation.ship.motion import Carrier, make_carrier
from ship_simulation.ship.ship_track import (
    Deflection,
    DeflectionSamples,
    FixSamples,
    ShipTrack,
    simulate_deflections,
    simulate_fixes,
)
from ship_simulation.stars.sky import TrueSky, draw_sky
from ship_simulation.stars.star_sightings import (
    InertialSamples,
    SightingsTruth,
    StarSightings,
    simulate_inertial_sensor,
    simulate_sightings,
)
from ship_simulation.theodolite.devices import BaselineSamples, simulate_ship_baseline
from ship_simulation.theodolite.run import TheodoliteRun, simulate_theodolite

SKY_SOURCES = ("fix", "pressure", "temperature", "humidity")
"""Sources, in addition to the measurements, of a run whose star sensors observe the real sky."""

BASELINE_SOURCE = "baseline"
"""Source of a run of a ship with two antennas."""

DEFLECTION_SOURCE = "deflection"
"""Source of a run with a topic on which the deflection of the vertical is published."""

StarSamples = DeviceSamples | StarSightings | InertialSamples
"""Horizon attitudes, single stars, or attitudes against the ICRS."""


@dataclass(frozen=True)
class VoyageTruth:
    """True quantities that the devices measure, and true errors of the devices.

    Attributes:
        ins_index: indices of the INS samples at whose stamps the true attitude is given, shape (m,). These samples are
            the first in each tenth of a second, and the last of the voyage.
        rotation_nd: true attitude at those stamps, shape (m, 3, 3).
        rate_d: true angular velocity at those stamps, rad/s, shape (m, 3).
        ins: errors of the INS.
        stars: mounting and time offset of each star sensor.
        sightings: true identities of the stars of each sensor that gives single stars.
        references: mounting and time offset of each other attitude system.
        track: the ship's position.
        deflection: deflection of the vertical at those stamps, rad, shape (m, 2).
        sky: the sky over the ship; None if no sensor or camera observes it.
    """

    ins_index: np.ndarray
    rotation_nd: FloatArray
    rate_d: FloatArray
    ins: InsTruth
    stars: dict[str, DeviceTruth]
    sightings: dict[str, SightingsTruth]
    references: dict[str, DeviceTruth]
    track: ShipTrack
    deflection: FloatArray
    sky: TrueSky | None


@dataclass(frozen=True)
class SimulatedRun:
    """The samples of a stretch of a voyage, or of the whole voyage, with one draw of the scenario's random parts.

    The weather station publishes the scenario's ``weather`` at the stamps ``weather_ns``, shape (n,). ``fused``,
    ``deflections``, ``ship_baseline`` and ``theodolite`` are None if the scenario does not contain them.
    """

    scenario: Scenario
    seed: int
    stretch: Stretch
    ins: InsSamples
    stars: dict[str, StarSamples]
    references: dict[str, DeviceSamples]
    fixes: FixSamples
    weather_ns: np.ndarray
    fused: FusedSamples | None
    deflections: DeflectionSamples | None
    ship_baseline: BaselineSamples | None
    theodolite: TheodoliteRun | None
    truth: VoyageTruth

    @property
    def start_ns(self) -> int:
        """Start of the voyage, ns."""
        return self.stretch.start_ns

    def arrivals(self) -> list[tuple[int, str, int]]:
        """Return (log time, source, index of the sample) of each input of ``ship_attitude``, in order of arrival.

        A source is ``ins``, ``star.<id>``, ``reference.<name>``, or one of SKY_SOURCES if a star sensor observes the
        real sky. If the suite needs the position for another reason, the fix is the only source of SKY_SOURCES.
        BASELINE_SOURCE requires two antennas, DEFLECTION_SOURCE a topic with the deflection. Samples that arrive at the
        same nanosecond are in the order of these sources, then by stamp.
        """
        sources = {"ins": self.ins.log_time_ns}
        sources |= {f"star.{key}": samples.log_time_ns for key, samples in self.stars.items()}
        sources |= {f"reference.{key}": samples.log_time_ns for key, samples in self.references.items()}
        if self.scenario.needs_position:
            sources[SKY_SOURCES[0]] = self.fixes.log_time_ns
        if self.scenario.needs_sky:
            sources |= self._sky_sources()
        if self.ship_baseline is not None:
            sources[BASELINE_SOURCE] = self.ship_baseline.log_time_ns
        if self.deflections is not None:
            sources[DEFLECTION_SOURCE] = self.deflections.time_ns
        return _sort_arrivals(sources)

    def _sky_sources(self) -> dict[str, np.ndarray]:
        fix, *weather = SKY_SOURCES
        return {fix: self.fixes.log_time_ns, **dict.fromkeys(weather, self.weather_ns)}

    def pointing_arrivals(self) -> list[tuple[int, str, int]]:
        """Return (log time, source, index of the sample) of each input of ``optical_axis``, in order of arrival.

        A source is ``ins``, ``fused``, ``encoder``, ``drone.<id>``, ``baseline.<id>``, ``image`` or ``target``. Star
        cameras on the theodolite add ``star.<id>`` and SKY_SOURCES.
        """
        sources = {"ins": self.ins.log_time_ns}
        if self.fused is not None:
            sources["fused"] = self.fused.log_time_ns
        if self.theodolite is not None:
            sources["encoder"] = self.theodolite.encoder.log_time_ns
            sources |= {f"drone.{key}": samples.log_time_ns for key, samples in self.theodolite.drones.items()}
            sources |= {f"baseline.{key}": samples.log_time_ns for key, samples in self.theodolite.baselines.items()}
            sources["image"] = self.theodolite.images.log_time_ns
            sources["target"] = self.theodolite.targets.log_time_ns
            sources |= {f"star.{key}": samples.log_time_ns for key, samples in self.theodolite.stars.items()}
            if self.theodolite.stars:
                sources |= self._sky_sources()
        return _sort_arrivals(sources)


def simulate(scenario: Scenario, seed: int) -> SimulatedRun:
    """Draw a voyage; the same scenario and seed give the same numbers.

    Each random component has a stream of its own, named after the component. Therefore an additional sensor does not
    change the numbers of other sensors.

    Raises:
        BadInput: the recorded motion cannot be used, or the theodolite cannot point along its programme.
    """
    voyage = _Voyage(scenario, seed)
    return voyage.samples(Stretch(voyage.track.start_ns, scenario.duration_s))


def simulate_stretches(scenario: Scenario, seed: int, length_s: int = STRETCH_S) -> Iterator[SimulatedRun]:
    """Draw a voyage in stretches, with the numbers of :func:`simulate` and memory independent of the voyage's length.

    Args:
        scenario: the voyage.
        seed: seed of all random parts of the voyage.
        length_s: length of the stretches, an even number of seconds, because star candidates are selected for blocks of
            two seconds.

    Raises:
        BadInput: as :func:`simulate`.
    """
    voyage = _Voyage(scenario, seed)
    for stretch in split_voyage(voyage.track.start_ns, scenario.duration_s, length_s):
        yield voyage.samples(stretch)


class _Voyage:
    """The draws of a voyage, and the state that continues from stretch to stretch."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.track = ShipTrack(scenario.position, start_time_ns(scenario.start_utc))
        self._draws = Draws(seed)
        self._carrier = make_carrier(scenario.carrier, seed)
        # Evaluated here, so that a motion that is too short is refused before any sample is computed.
        self._carrier.attitude(np.array([0.0, scenario.duration_s]))
        self._deflection = Deflection(scenario, self.track, self._draws)
        self._sky = draw_sky(scenario, self.track, seed) if scenario.has_sky else None

    def samples(self, stretch: Stretch) -> SimulatedRun:
        """Return the samples of the next stretch."""
        scenario, carrier, draws, seed = self.scenario, self._carrier, self._draws, self._draws.seed
        draws.begin_stretch(stretch)
        deflection = self._deflection
        ins, ins_truth = simulate_ins(scenario, carrier, stretch, draws, deflection)
        stars, star_truth, sightings_truth = _simulate_stars(scenario, carrier, self._sky, stretch, draws)
        references = {
            key: simulate_reference(key, scenario, carrier, ins_truth.time_offset_s, stretch, draws, deflection)
            for key in scenario.references
        }
        index = truth_indices(ins.time_ns, stretch.start_ns, stretch.contains_last(scenario.ins.rate_hz, 0.0))
        since_start_s = (ins.time_ns[index] - stretch.start_ns) / SECOND_NS
        truth = VoyageTruth(
            ins_index=index,
            rotation_nd=carrier.attitude(since_start_s),
            rate_d=carrier.body_rate(since_start_s),
            ins=ins_truth,
            stars=star_truth,
            sightings=sightings_truth,
            references={key: device_truth for key, (_, device_truth) in references.items()},
            track=self.track,
            deflection=deflection.deflection_at(since_start_s),
            sky=self._sky,
        )
        fused, aboard = scenario.fused_attitude.written, scenario.theodolite.aboard
        antennas = scenario.ship_baseline.is_aboard
        return SimulatedRun(
            scenario=scenario,
            seed=seed,
            stretch=stretch,
            ins=ins,
            stars=stars,
            references={key: samples for key, (samples, _) in references.items()},
            fixes=simulate_fixes(scenario, self.track, stretch, draws),
            weather_ns=stretch.stamps(scenario.weather.rate_hz, 0.0),
            fused=simulate_fused_attitude(scenario, carrier, stretch, draws) if fused else None,
            deflections=(
                simulate_deflections(scenario, stretch) if scenario.gravity.told == "topic" else None
            ),
            ship_baseline=simulate_ship_baseline(scenario, carrier, stretch, draws) if antennas else None,
            theodolite=simulate_theodolite(scenario, carrier, self._sky, stretch, draws) if aboard else None,
            truth=truth,
        )


def _sort_arrivals(sources: dict[str, np.ndarray]) -> list[tuple[int, str, int]]:
    """Return (log time, source, index) of all samples, in order of log time.

    Samples with equal log times are in the order of the sources, then of the stamps.
    """
    arrivals = [
        (int(log_time_ns), source, index)
        for source, log_times_ns in sources.items()
        for index, log_time_ns in enumerate(log_times_ns)
    ]
    # The sort is stable, so that samples with equal times stay in the order of sources and stamps.
    return sorted(arrivals, key=lambda arrival: arrival[0])


def _simulate_stars(
    scenario: Scenario, carrier: Carrier, sky: TrueSky | None, stretch: Stretch, draws: Draws
) -> tuple[dict[str, StarSamples], dict[str, DeviceTruth], dict[str, SightingsTruth]]:
    """Return samples and mounting of each star sensor, and the true identities of single stars."""
    samples: dict[str, StarSamples] = {}
    star_truth: dict[str, DeviceTruth] = {}
    sightings: dict[str, SightingsTruth] = {}
    for key, config in scenario.star_sensors.items():
        motion = star_sensor_motion(key, scenario, carrier, stretch, draws)
        star_truth[key] = motion.truth
        if sky is None or config.output == "horizon_attitude":
            samples[key] = simulate_star_sensor(key, scenario, motion, draws)
        elif config.output == "observations":
            samples[key], sightings[key] = simulate_sightings(f"star.{key}", config, motion, sky, draws)
        else:
            samples[key] = simulate_inertial_sensor(key, scenario, motion, sky, draws)
    return samples, star_truth, sightings

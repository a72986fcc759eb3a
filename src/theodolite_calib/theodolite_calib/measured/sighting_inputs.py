"""What is measured, in tracks of its own, and brought together at the middle of an exposure."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ship_estimation.refusals import Reason, Refusal, same_stamp
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S, Nodes, exposure_nodes
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from ship_geometry.sample_track import SECOND_NS, SampleTrack
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.chain.axes import AxisErrors, main_axis_rotation
from theodolite_calib.config.optical_axis import OpticalAxisConfig
from theodolite_calib.lights.image import Camera
from theodolite_calib.lights.light_points import Image
from theodolite_calib.lights.light_streaks import LightStreaks
from theodolite_calib.lights.line_of_sight import Lights
from theodolite_calib.measured.baseline_track import BaselineTrack
from theodolite_calib.measured.samples import EncoderSample, Exposure, SeenLight, ShipSample, Status
from theodolite_calib.measured.sighting import EncoderAt, ShipAt, Sighting

_LONGEST_REACH_NS = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns

Sample = TypeVar("Sample", EncoderSample, ShipSample, AttitudeSample, Any)


@dataclass(frozen=True)
class Inserted:
    """What became of a sample.

    Attributes:
        taken: whether it is in the track.
        refusal: DUPLICATE or CONFLICT where there was one of its stamp.
        changed_after_ns: the stamp after which interpolated values may have changed; None where none has.
    """

    taken: bool
    refusal: Refusal | None = None
    changed_after_ns: int | None = None


@dataclass(frozen=True)
class Assembled:
    """What belongs to an exposure.

    Attributes:
        sighting: of the lights that have all they need; None where none has.
        refusal: why there is none.
        lights_refused: the other lights, by name.
    """

    sighting: Sighting | None
    refusal: Refusal | None
    lights_refused: tuple[tuple[str, Refusal], ...]


class SightingInputs:
    """The tracks of one run.

    Args:
        config: the node's parameters.

    Attributes:
        ship_shift_ns: the ship's attitudes are valid so much later than their stamps.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.reconfigure(config)
        by_ins = config.ship.source == "ins/imu"
        self.ship_shift_ns = round(config.ins.time_offset_s * SECOND_NS) if by_ins else 0
        self.encoder: VectorTrack[EncoderSample] = VectorTrack(_ns(config.encoder.max_gap_s), 2.0 * np.pi)
        self.ship = AttitudeTrack(_ns(config.ins.max_gap_s if by_ins else config.ship.max_gap_s))
        self.baselines = {id_: BaselineTrack(_ns(b.rtk.max_gap_s)) for id_, b in config.beacons.items()}
        self._levers_b = {id_: b.light.vector_m for id_, b in config.beacons.items()}
        # A light at the antenna is where it is, however the drone stands.
        self.drones = {
            id_: AttitudeTrack(_ns(b.imu.max_gap_s)) for id_, b in config.beacons.items() if np.any(b.light.vector_m)
        }

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Go on with other noise."""
        self._config = config
        by_ins = config.ship.source == "ins/imu"
        white_arcsec = config.ins.white_sigma_arcsec if by_ins else config.ship.white_sigma_arcsec
        self._ship_noise = (white_arcsec * ARCSEC) ** 2

    @property
    def reach_ns(self) -> int:
        """How far from its moment data may lie that an exposure is compared with."""
        return max(track.max_gap_ns for track in self._tracks()) + abs(self.ship_shift_ns) + _LONGEST_REACH_NS

    def drop_before(self, time_ns: int) -> None:
        """Forget what no exposure at or after ``time_ns`` needs."""
        for track in self._tracks():
            track.drop_before(time_ns - abs(self.ship_shift_ns))

    def awaits(self, exposure: Exposure) -> bool:
        """True while data still to come may belong to an exposure."""
        tracks: list[SampleTrack[Any]] = []
        for light in exposure.lights:
            tracks.append(self.baselines[light.beacon_id])
            if light.beacon_id in self.drones:
                tracks.append(self.drones[light.beacon_id])
        end_ns = exposure.time_ns + exposure.reach_ns
        turned = self.ship_covers(end_ns) and self.encoder.covers(end_ns)
        return not (turned and all(track.covers(exposure.time_ns) for track in tracks))

    def ship_covers(self, time_ns: int) -> bool:
        """True once later samples can no longer change the ship's attitude at a moment."""
        return self.ship.covers(time_ns - self.ship_shift_ns)

    def ship_at(self, time_ns: int, over: Nodes | None = None) -> tuple[ShipAt, Status] | None:
        """The ship's attitude at a moment, and what its source says that it is worth; None in a gap.

        Args:
            time_ns: the moment.
            over: of an exposure about it that the track spans, where the noise is to be that of the mean over it.
        """
        attitude = self.ship.at(time_ns - self.ship_shift_ns)
        sample = self.ship.last_before(time_ns - self.ship_shift_ns)
        if attitude is None or not isinstance(sample, ShipSample):
            return None
        gain = attitude.noise_gain
        if over is not None:
            gain = self.ship.noise_gain_of_mean(over.moments(time_ns - self.ship_shift_ns))
        noise = gain * self._ship_noise + float(np.trace(attitude.error_covariance_d))
        return ShipAt(attitude.rotation_nd, attitude.rate_d, sample.slow_covariance_n, noise), sample.status

    def encoder_at(self, time_ns: int, over: Nodes | None = None) -> EncoderAt | None:
        """The encoders at a moment; None in a gap. For ``over`` see :meth:`ship_at`."""
        angles = self.encoder.at(time_ns)
        sample = self.encoder.last_before(time_ns)
        if angles is None or sample is None:
            return None
        azimuth, elevation = angles.vector.tolist()
        gain = angles.noise_gain if over is None else self.encoder.noise_gain_of_mean(over.moments(time_ns))
        noise = gain * sample.sigma**2 + float(np.trace(angles.error_covariance))
        return EncoderAt(azimuth, elevation, noise)

    def assemble(self, exposure: Exposure) -> Assembled:
        """Everything at the middle of an exposure."""
        ship, encoder = self.ship_at(exposure.time_ns), self.encoder_at(exposure.time_ns)
        if encoder is None:
            return Assembled(None, Refusal(Reason.GAP, "no encoder readings on both sides of it"), ())
        if ship is None:
            return Assembled(None, Refusal(Reason.GAP, "no attitudes of the ship on both sides of it"), ())
        found: list[tuple[SeenLight, _Placed]] = []
        refused: list[tuple[str, Refusal]] = []
        for light in exposure.lights:
            placed = self._placed(light.beacon_id, exposure.time_ns)
            if isinstance(placed, Refusal):
                refused.append((light.beacon_id, placed))
            else:
                found.append((light, placed))
        if not found:
            return Assembled(None, refused[0][1], tuple(refused))
        sighting = Sighting(
            exposure.time_ns,
            tuple(light.beacon_id for light, _ in found),
            Image(np.array([light.point_m for light, _ in found]), np.array([light.sigma_m for light, _ in found])),
            Lights(
                np.array([placed.baseline_n for _, placed in found]),
                np.array([placed.covariance_n for _, placed in found]),
                np.array([placed.rotation_nb for _, placed in found]),
                np.zeros((len(found), 3, 3)),
            ),
            ship[0],
            encoder,
        )
        if exposure.nodes is None:
            return Assembled(sighting, None, tuple(refused))
        steady = self._at_middle(sighting, exposure.nodes)
        if steady is None:
            text = f"no encoder readings or attitudes of the ship over its whole exposure of {exposure.exposure_s:g} s"
            return Assembled(None, Refusal(Reason.GAP, text), tuple(refused))
        return Assembled(steady, None, tuple(refused))

    def _at_middle(self, sighting: Sighting, nodes: Nodes) -> Sighting | None:
        """A sighting with its lights where they stood at the middle of the exposure; None where that is not known.

        It is compared with the mean over the exposure, and the noise of encoders and ship is that of the mean.
        """
        times_ns = [sighting.time_ns + offset_ns for offset_ns in nodes.offset_ns]
        ships, encoders = [self.ship_at(t) for t in times_ns], [self.encoder_at(t) for t in times_ns]
        attitudes = np.array([ship[0].rotation_nd for ship in ships if ship is not None])
        angles = np.array([[encoder.azimuth, encoder.elevation] for encoder in encoders if encoder is not None])
        if min(len(attitudes), len(angles)) < len(times_ns):
            return None
        telescope, lever_m = self._config.telescope, self._config.lever.vector_m
        middle, encoder = self.ship_at(sighting.time_ns, nodes), self.encoder_at(sighting.time_ns, nodes)
        assert middle is not None  # as at the nodes
        assert encoder is not None
        ship = middle[0]
        velocity_n = np.array([self.baselines[name].velocity_at(sighting.time_ns) for name in sighting.names])
        since_s = np.array(nodes.offset_ns)[:, None, None] / SECOND_NS
        carried_n = (attitudes - ship.rotation_nd) @ lever_m
        streaks = LightStreaks(
            image=sighting.image,
            camera=Camera(telescope.focal_length_m, 0.0, telescope.principal_point_m),
            psf_sigma_m=telescope.psf_sigma_m,
            nodes=nodes,
            rotation_nt=attitudes @ self._telescope(angles[:, 0], angles[:, 1]),
            middle_nt=ship.rotation_nd @ self._telescope(encoder.azimuth, encoder.elevation),
            path_n=sighting.lights.baseline_n - ship.rotation_nd @ lever_m,
            moved_n=since_s * velocity_n - carried_n[:, None, :],
        )
        return replace(sighting, image=streaks.at_middle(), streaks=streaks, ship=ship, encoder=encoder)

    def _telescope(self, azimuth: FloatArray | float, elevation: FloatArray | float) -> FloatArray:
        """Deck from telescope as configured, shape (..., 3, 3): a degree would be good enough."""
        errors = AxisErrors.from_vector(self._config.axes.values)
        rotation_dm = main_axis_rotation(errors, azimuth, elevation)
        rotation_dt: FloatArray = rotation_dm @ rotation_from_angles(*self._config.telescope.parallelism).T
        return rotation_dt

    def _placed(self, beacon_id: str, time_ns: int) -> "_Placed | Refusal":
        baseline = self.baselines[beacon_id].usable_at(time_ns)
        if isinstance(baseline, Refusal):
            return baseline
        if beacon_id not in self.drones:
            return _Placed(*baseline, np.eye(3))
        attitude = self.drones[beacon_id].at(time_ns)
        if attitude is None:
            return Refusal(Reason.GAP, "no attitudes of the drone on both sides of the exposure")
        lever_n = attitude.rotation_nd @ self._levers_b[beacon_id]
        by_turn = skew(lever_n)
        interpolated = by_turn @ attitude.error_covariance_n @ by_turn.T
        return _Placed(baseline[0], baseline[1] + interpolated, attitude.rotation_nd)

    def _tracks(self) -> Iterator[SampleTrack[Any]]:
        yield self.encoder
        yield self.ship
        yield from self.baselines.values()
        yield from self.drones.values()


@dataclass(frozen=True)
class _Placed:
    baseline_n: FloatArray
    covariance_n: FloatArray
    rotation_nb: FloatArray


def insert(track: SampleTrack[Any], sample: Any) -> Inserted:
    """Put a sample into a track; of two with the same stamp the one whose bytes sort first is kept."""
    known = track.get(sample.time_ns)
    if known is None:
        return Inserted(True, None, track.insert(sample))
    refusal = same_stamp(known.content(), sample.content())
    if known.content() <= sample.content():
        return Inserted(False, refusal)
    return Inserted(True, refusal, track.insert(sample))


def _ns(time_s: float) -> int:
    return round(time_s * SECOND_NS)

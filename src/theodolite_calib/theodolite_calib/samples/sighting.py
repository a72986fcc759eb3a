"""Sightings: one exposure of beacons or of stars, with the samples of all other sources at its middle."""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.mount.image import BeaconStreaks, Camera, Image
from ship_geometry.mount.line_of_sight import BeaconPoses
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.exposure_mean import Nodes
from ship_stars.attitude_from_stars.exposure import StarExposure, reduce_to_mid_exposure
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.samples import DetectedBeacon, Exposure
from theodolite_calib.samples.tracks import BaselineJump, BeaconAt, EncoderAt, MeasuredTracks, ShipAt


@dataclass(frozen=True)
class Sighting:
    """Exposure of beacons with the samples at its middle.

    Attributes:
        time_ns: middle of the exposure.
        names: names of the N beacons.
        image: points of the beacons on the detector.
        beacons: baselines and drone attitudes; the covariance of the drones' attitudes is not used.
        ship: ship's attitude.
        encoder: encoder angles.
        streaks: beacons as detected and their motion, from which ``image`` was computed. None if the duration of the
            exposure is not known; ``image`` then has the detected points.
    """

    time_ns: int
    names: tuple[str, ...]
    image: Image
    beacons: BeaconPoses
    ship: ShipAt
    encoder: EncoderAt
    streaks: BeaconStreaks | None = None

    def deck_from_telescope(self, rotation_nt: FloatArray) -> FloatArray:
        """Return deck from telescope, shape (3, 3), computed from ``rotation_nt`` and the ship's attitude."""
        rotation_dt: FloatArray = self.ship.rotation_nd.T @ rotation_nt
        return rotation_dt

    def select(self, rows: list[int], image_rows: list[int] | None = None) -> "Sighting":
        """Return the sighting with some beacons; beacon ``rows[i]`` gets the point ``image_rows[i]``, if given."""
        beacons = BeaconPoses(
            self.beacons.baseline_n[rows],
            self.beacons.baseline_covariance_n[rows],
            self.beacons.rotation_nb[rows],
            self.beacons.attitude_covariance_n[rows],
        )
        seen = rows if image_rows is None else image_rows
        streaks = None if self.streaks is None else self.streaks.select(rows, seen)
        return replace(
            self,
            names=tuple(self.names[row] for row in rows),
            image=self.image.select(seen) if streaks is None else streaks.image_at_middle(),
            beacons=beacons,
            streaks=streaks,
        )


@dataclass(frozen=True)
class AssembledSighting:
    """Result of assembling a sighting.

    Attributes:
        sighting: sighting of the beacons with complete data, or the reason why there is none.
        rejected_beacons: rejections of beacons without complete data, by name.
        jumps: baseline jumps of the beacons with complete data, by name.
    """

    sighting: Sighting | Rejection
    rejected_beacons: tuple[tuple[str, Rejection], ...] = ()
    jumps: tuple[tuple[str, BaselineJump], ...] = ()


class SightingAssembler:
    """Assembles sightings from the tracks of one run.

    Args:
        config: parameters of the node.
        tracks: tracks of the measured samples.
    """

    def __init__(self, config: OpticalAxisConfig, tracks: MeasuredTracks) -> None:
        self._tracks, self._telescope, self._lever_m = tracks, config.telescope, config.lever.vector_m
        self._axes = AxisErrors.from_vector(config.axes.values)

    def assemble(self, exposure: Exposure) -> AssembledSighting:
        """Return the sighting of an exposure, or its rejection."""
        axes = self._tracks.axes_at(exposure.time_ns)
        if isinstance(axes, Rejection):
            return AssembledSighting(axes)
        found: list[tuple[DetectedBeacon, BeaconAt]] = []
        rejected: list[tuple[str, Rejection]] = []
        for light in exposure.beacons:
            placed = self._tracks.beacon_at(light.beacon_id, exposure.time_ns)
            if isinstance(placed, Rejection):
                rejected.append((light.beacon_id, placed))
            else:
                found.append((light, placed))
        if not found:
            return AssembledSighting(rejected[0][1], tuple(rejected))
        sighting = Sighting(
            exposure.time_ns,
            tuple(light.beacon_id for light, _ in found),
            Image(np.array([light.point_m for light, _ in found]), np.array([light.sigma_m for light, _ in found])),
            BeaconPoses(
                np.array([placed.baseline_n for _, placed in found]),
                np.array([placed.covariance_n for _, placed in found]),
                np.array([placed.rotation_nb for _, placed in found]),
                np.zeros((len(found), 3, 3)),
            ),
            *axes,
        )
        jumps = tuple((light.beacon_id, placed.jump) for light, placed in found if placed.jump is not None)
        if exposure.nodes is None:
            return AssembledSighting(sighting, tuple(rejected), jumps)
        at_middle = self._at_middle(sighting, exposure.exposure_s, exposure.nodes)
        return AssembledSighting(at_middle, tuple(rejected), jumps)

    def _at_middle(self, sighting: Sighting, exposure_s: float, nodes: Nodes) -> Sighting | Rejection:
        """Return a sighting with its points at the middle of the exposure, or a rejection if samples are missing.

        The detected points are means over the exposure. Ship and encoders of the sighting have their values at the
        middle, and the noise of their means over the exposure.
        """
        tracks, lever_m, telescope = self._tracks, self._lever_m, self._telescope
        at_nodes = [tracks.axes_at(sighting.time_ns + offset_ns) for offset_ns in nodes.offset_ns]
        known = [axes for axes in at_nodes if not isinstance(axes, Rejection)]
        if len(known) < len(at_nodes):
            text = f"no encoder readings or attitudes of the ship over the whole exposure of {exposure_s:g} s"
            return Rejection(Reason.GAP, text)
        attitudes = np.array([ship.rotation_nd for ship, _ in known])
        angles = np.array([[encoder.azimuth, encoder.elevation] for _, encoder in known])
        axes = tracks.axes_at(sighting.time_ns, nodes)
        assert not isinstance(axes, Rejection)  # the nodes include the middle
        ship, encoder = axes
        velocity_n = np.array([tracks.baselines[name].velocity_at(sighting.time_ns) for name in sighting.names])
        since_s = np.array(nodes.offset_ns)[:, None, None] / SECOND_NS
        lever_change_n = (attitudes - ship.rotation_nd) @ lever_m
        streaks = BeaconStreaks(
            image=sighting.image,
            camera=Camera(telescope.focal_length_m, 0.0, telescope.principal_point_m),
            psf_sigma_m=telescope.psf_sigma_m,
            nodes=nodes,
            rotation_nt=attitudes @ self._rotation_dt(angles[:, 0], angles[:, 1]),
            middle_nt=ship.rotation_nd @ self._rotation_dt(encoder.azimuth, encoder.elevation),
            path_n=sighting.beacons.baseline_n - ship.rotation_nd @ lever_m,
            displacement_n=since_s * velocity_n - lever_change_n[:, None, :],
        )
        return replace(sighting, image=streaks.image_at_middle(), streaks=streaks, ship=ship, encoder=encoder)

    def _rotation_dt(self, azimuth: FloatArray | float, elevation: FloatArray | float) -> FloatArray:
        """Return deck from telescope from the configuration, shape (..., 3, 3); an accuracy of one degree suffices."""
        rotation_dm = main_axis_rotation(self._axes, azimuth, elevation)
        rotation_dt: FloatArray = rotation_dm @ rotation_from_angles(*self._telescope.parallelism).T
        return rotation_dt


@dataclass(frozen=True)
class StarSighting:
    """Exposure of stars with the samples that give the camera's attitude.

    Attributes:
        camera_id: id of the camera.
        exposure: exposure; the stars' points are at its middle if the duration is known.
        ship: ship's attitude.
        encoder: encoder angles.
    """

    camera_id: str
    exposure: StarExposure
    ship: ShipAt
    encoder: EncoderAt

    @property
    def time_ns(self) -> int:
        """Middle of the exposure."""
        return self.exposure.time_ns


def star_sighting(
    exposure: StarExposure, config: OpticalAxisConfig, tracks: MeasuredTracks
) -> StarSighting | Rejection:
    """Return an exposure with the samples at its middle, or a rejection that names the missing samples.

    If the duration is known, encoders and ship have the noise of their means over the exposure.

    Args:
        exposure: exposure as the camera recorded it.
        config: parameters of the node.
        tracks: tracks of the measured samples.
    """
    time_ns, camera_id = exposure.time_ns, exposure.source.partition(".")[2]
    nodes = None if exposure.length is None else exposure.length.nodes
    axes = tracks.axes_at(time_ns)
    if isinstance(axes, Rejection):
        return axes
    if exposure.length is None or nodes is None:
        return StarSighting(camera_id, exposure, *axes)
    turned_nm = tracks.main_axis_over(time_ns, nodes, AxisErrors.from_vector(config.axes.values))
    if turned_nm is None:
        length_s = exposure.length.exposure_s
        text = f"no encoder readings or attitudes of the ship over the whole exposure of {length_s:g} s"
        return Rejection(Reason.GAP, text)
    axes = tracks.axes_at(time_ns, nodes)
    assert not isinstance(axes, Rejection)  # as at the nodes
    rotation_sm = rotation_from_angles(*config.telescopes[camera_id].parallelism)
    turned_ns = turned_nm @ rotation_sm.T
    turns = np.swapaxes(turned_ns, -1, -2) @ turned_ns[nodes.offset_ns.index(0)]
    return StarSighting(camera_id, reduce_to_mid_exposure(exposure, turns), *axes)

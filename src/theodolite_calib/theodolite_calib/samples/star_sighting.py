"""Star sighting: one exposure of a camera on the theodolite, with encoders and ship at the middle of the exposure."""

from dataclasses import dataclass

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors
from ship_stars.solution.exposure import StarExposure, reduce_to_mid_exposure
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.tracks import EncoderAt, MeasuredTracks, ShipAt


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
    ship, encoder = tracks.ship_at(time_ns), tracks.encoder_at(time_ns)
    if encoder is None:
        return Rejection(Reason.GAP, "no encoder readings on both sides of the exposure")
    if ship is None:
        return Rejection(Reason.GAP, "no attitudes of the ship on both sides of the exposure")
    if exposure.length is None or nodes is None:
        return StarSighting(camera_id, exposure, ship, encoder)
    axes = AxisErrors.from_vector(config.axes.values)
    turned_nm = tracks.main_axis_at([moment_ns for moment_ns, _ in nodes.times_and_weights(time_ns)], axes)
    if turned_nm is None:
        length_s = exposure.length.exposure_s
        text = f"no encoder readings or attitudes of the ship over the whole exposure of {length_s:g} s"
        return Rejection(Reason.GAP, text)
    ship, encoder = tracks.ship_at(time_ns, nodes), tracks.encoder_at(time_ns, nodes)
    assert ship is not None  # as at the nodes
    assert encoder is not None
    rotation_sm = rotation_from_angles(*config.telescopes[camera_id].parallelism)
    turned_ns = turned_nm @ rotation_sm.T
    turns = np.swapaxes(turned_ns, -1, -2) @ turned_ns[nodes.offset_ns.index(0)]
    return StarSighting(camera_id, reduce_to_mid_exposure(exposure, turns), ship, encoder)

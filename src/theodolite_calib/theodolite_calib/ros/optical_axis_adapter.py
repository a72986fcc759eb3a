"""The node ``optical_axis``: which topic feeds which method of its core, what a pointing becomes, its diagnostics."""

import functools
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_estimation.outcome import Status
from ship_estimation.refusals import Refusal
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import (
    enu_covariance,
    flu_from_device_vector,
    mounting_quaternion,
    quaternion_from_rotation,
)
from ship_geometry.rotations import ARCSEC
from ship_node.documents.saved_document import DISK, Files
from ship_node.documents.saved_start import SavedStart
from ship_node.edge.messages_out import (
    BUDGET_TYPE,
    DECK_FRAME,
    HORIZON_FRAME,
    INNOVATION_TYPE,
    INTEGRITY_TYPE,
    TF_TOPIC,
    TF_TYPE,
    ZERO_VECTOR,
    DiagnosticStatus,
    Level,
    error_budget,
    refused_input,
)
from ship_node.edge.reporting_adapter import OWN_OUTPUTS, Feed, ReportingAdapter, untimed
from ship_node.edge.topics import InputTopic, OutputTopic, Published
from ship_node.edge.verdict_report import clock_status
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.measured.samples import Exposure, Mode, PointingEstimate
from theodolite_calib.optical_axis.calibration import Calibration
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.optical_axis.integrity import QUANTITIES
from theodolite_calib.ros import messages_in
from theodolite_calib.ros.calibration_file import CALIBRATION_FILE

MAIN_FRAME = "theodolite_main"
BASE_FRAME = "theodolite_base"
POINTING_TOPIC, INTEGRITY_TOPIC = "theodolite/pointing", "theodolite/integrity"

_IMU_TYPE = "sensor_msgs/msg/Imu"
_SHIP = {
    "ship/attitude": ("ship_msgs/msg/ShipAttitude", messages_in.ship_attitude),
    "ins/imu": (_IMU_TYPE, messages_in.ins_attitude),
}
"""Where the ship's attitude may come from: type and reader."""

_LEVELS = {
    Status.VALID: Level.OK,
    Status.COASTING: Level.WARN,
    Status.DEGRADED: Level.WARN,
    Status.INVALID: Level.ERROR,
}
_BY = {
    Mode.TWO_LIGHTS: "two or more lights",
    Mode.ONE_LIGHT: "one light",
    Mode.ENCODER: "encoders",
}


class OpticalAxisAdapter(ReportingAdapter):
    """The theodolite's optical axis from lights on drones, encoders and the ship's attitude, with its error budget.

    Args:
        config: the node's parameters.
        factory: makes the messages.
        files: where the saved calibration is read and written.

    Raises:
        BadInput: the calibration file cannot be read.
    """

    node_name: ClassVar[str] = "optical_axis"
    config_type: ClassVar[type] = OpticalAxisConfig
    services: ClassVar[tuple[str, ...]] = ("reset", "save_alignment", "load_alignment")
    main_topic: ClassVar[str] = POINTING_TOPIC
    innovation_topic: ClassVar[str] = "theodolite/innovation"
    integrity_topic: ClassVar[str] = INTEGRITY_TOPIC
    integrity_frame: ClassVar[str] = MAIN_FRAME
    quantities: ClassVar[tuple[str, ...]] = QUANTITIES
    checked_by: ClassVar["attrgetter[tuple[Any, ...]]"] = attrgetter("status", "mode")
    directions: ClassVar["attrgetter[np.ndarray]"] = attrgetter("by_error_n")
    outputs: tuple[OutputTopic, ...] = (
        OutputTopic(POINTING_TOPIC, "ship_msgs/msg/OpticalAxisPointing"),
        OutputTopic("theodolite/calibration", "ship_msgs/msg/TheodoliteCalibration", latched=True),
        OutputTopic("theodolite/error_budget", BUDGET_TYPE),
        OutputTopic(innovation_topic, INNOVATION_TYPE),
        OutputTopic(INTEGRITY_TOPIC, INTEGRITY_TYPE),
        OutputTopic("theodolite/error_arcsec", "ship_msgs/msg/PointingErrorArcsec"),
        OutputTopic(TF_TOPIC, TF_TYPE),
        *OWN_OUTPUTS,
    )

    def __init__(self, config: OpticalAxisConfig, factory: MessageFactory, files: Files = DISK) -> None:
        core = OpticalAxisCore(config)
        saved = SavedStart(
            CALIBRATION_FILE,
            config.calibration_file,
            files,
            start_from=core.start_from,
            to_save=core.calibration_to_save,
            nothing="no light was used yet: there is no calibration to save",
        )
        lever = dict(zip("xyz", flu_from_device_vector(config.lever.vector_m).tolist(), strict=True))
        super().__init__(config, core, factory, functools.partial(pointing_messages, factory, lever), saved)

    def table(self, config: OpticalAxisConfig) -> Iterator[Feed]:
        """Which topic feeds which method of the core."""
        core: OpticalAxisCore = self.core
        encoder = InputTopic("theodolite/encoder", "ship_msgs/msg/TheodoliteEncoder", required=True, depth=1000)
        yield Feed(encoder, "encoder", functools.partial(messages_in.encoder, config=config), core.add_encoder)
        type_name, read_ship = _SHIP[config.ship.source]
        ship = InputTopic(config.ship.source, type_name, required=True, depth=1000)
        yield Feed(ship, "ship", functools.partial(read_ship, config=config), core.add_ship)
        image = InputTopic("theodolite/beacons", "ship_msgs/msg/BeaconImage", required=False, depth=1000)
        read_image, take_image = functools.partial(messages_in.exposure, config=config), untimed(core.add_exposure)
        yield Feed(image, "lights", read_image, take_image, judged=True, measured_by=Exposure.source)
        for id_, beacon in config.beacons.items():
            topic = InputTopic(f"beacon/{id_}/baseline", "ship_msgs/msg/RtkBaseline", required=False, depth=1000)
            read_baseline = functools.partial(messages_in.baseline, beacon=beacon, least_fix=config.least_fix)
            take = untimed(functools.partial(core.add_baseline, id_))
            yield Feed(topic, f"baseline.{id_}", read_baseline, take)
        for id_, beacon in config.beacons.items():
            topic = InputTopic(f"beacon/{id_}/imu", _IMU_TYPE, required=False, depth=1000)
            read_imu = functools.partial(messages_in.drone_attitude, beacon=beacon)
            yield Feed(topic, f"drone.{id_}", read_imu, untimed(functools.partial(core.add_drone_attitude, id_)))

    def left_out_message(self, source: str, time_ns: int, name: str, refusal: Refusal) -> Any:
        """ship_msgs/Innovation of a light that had no part in its exposure, under the name of the light."""
        return refused_input(self.factory, f"light.{name}", time_ns, refusal)

    def own_slow_topics(self, now_ns: int) -> list[Published]:
        """Budget and predicted errors of the latest pointing, once each; what the filter knows of the theodolite."""
        factory, estimate, published = self.factory, self.budget_due, []
        if estimate is not None:
            sources = self.core.filter.model.sources
            published += [
                ("theodolite/error_budget", pointing_budget(factory, estimate, sources)),
                ("theodolite/error_arcsec", error_arcsec(factory, estimate)),
            ]
        calibration = calibration_message(factory, self.core.calibration(), now_ns)
        return [*published, ("theodolite/calibration", calibration)]

    def own_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """The pointing, the calibration, lights in conflict with the rest, verdicts."""
        return [
            pointing_status(self.latest, self.clock_jumps),
            calibration_status(self.core.calibration(), self.saved_remarks()),
            *self.integrity_statuses(),
            *self.conflict_statuses(),
            *self.verdicts.statuses(),
            clock_status(self.core.filter.model, self.core.state.mean, {"ship": "ins"}),
        ]


def pointing_messages(
    factory: MessageFactory, lever: Mapping[str, float], estimate: PointingEstimate
) -> list[Published]:
    """What a pointing becomes: ship_msgs/OpticalAxisPointing, and the main frame on /tf.

    Where no pointing is claimed the first is all NaN, and the second is not made.

    Args:
        factory: makes the messages.
        lever: place of the theodolite in the deck, x forward, y left, z up, m.
        estimate: the pointing.
    """
    azimuth, elevation, image_rotation = angles_from_rotation(estimate.rotation_nm).tolist()
    telescope_azimuth, telescope_elevation, telescope_rotation = angles_from_rotation(estimate.rotation_nt).tolist()
    angles_covariance = angle_covariance(estimate.covariance_n, azimuth, elevation)
    if np.isfinite(estimate.rotation_dm).all():
        parent, translation, quaternion = DECK_FRAME, lever, mounting_quaternion(estimate.rotation_dm)
    else:
        # The INS alone: its attitude is not that of the frame "deck", and nobody may publish that one at all.
        parent, translation = HORIZON_FRAME, ZERO_VECTOR
        quaternion = quaternion_from_rotation(estimate.rotation_nm)
    message = factory.encoded(
        "ship_msgs/msg/OpticalAxisPointing",
        header={"stamp": estimate.time_ns, "frame_id": MAIN_FRAME},
        azimuth=azimuth,
        elevation=elevation,
        image_rotation=image_rotation,
        covariance=angles_covariance.ravel(),
        rotation_covariance=enu_covariance(estimate.covariance_n).ravel(),
        telescope_azimuth=telescope_azimuth,
        telescope_elevation=telescope_elevation,
        telescope_rotation=telescope_rotation,
        mode=int(estimate.mode),
        status=int(estimate.status),
        light_count=estimate.light_count,
    )
    if estimate.status is Status.INVALID:
        return [(POINTING_TOPIC, message)]
    main = {
        "header": {"stamp": estimate.time_ns, "frame_id": parent},
        "child_frame_id": MAIN_FRAME,
        "transform": {
            "translation": translation,
            "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
        },
    }
    return [(POINTING_TOPIC, message), (TF_TOPIC, factory.encoded(TF_TYPE, transforms=[main]))]


def pointing_budget(factory: MessageFactory, estimate: PointingEstimate, sources: Sequence[str]) -> Any:
    """ship_msgs/ErrorBudget of a published pointing; ``sources`` name the parts of its covariance."""
    parts_n, covariance_n = estimate.parts_n, estimate.covariance_n
    return error_budget(factory, "optical_axis", estimate.time_ns, MAIN_FRAME, sources, parts_n, covariance_n)


def error_arcsec(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """ship_msgs/PointingErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
    azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
    sigma = np.sqrt(np.diagonal(angle_covariance(estimate.covariance_n, azimuth, elevation))) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/PointingErrorArcsec",
        header={"stamp": estimate.time_ns, "frame_id": MAIN_FRAME},
        sigma_azimuth_cos_elevation=float(sigma[0] * np.cos(elevation)),
        sigma_elevation=float(sigma[1]),
        sigma_image_rotation=float(sigma[2]),
        error_azimuth_cos_elevation=unknown,
        error_elevation=unknown,
        error_image_rotation=unknown,
    )


def calibration_message(factory: MessageFactory, values: Calibration, now_ns: int) -> Any:
    """ship_msgs/TheodoliteCalibration, stamped with the last sighting, or now where there was none."""
    return factory.make(
        "ship_msgs/msg/TheodoliteCalibration",
        header={"stamp": values.time_ns or now_ns, "frame_id": BASE_FRAME},
        names=list(values.names),
        values=values.values,
        covariance=values.covariance.ravel(),
        units=list(values.units),
        unobservable=list(values.unobservable),
        sighting_count=values.sighting_count,
        residual_rms=values.residual_rms,
    )


def pointing_status(estimate: PointingEstimate | None, clock_jumps: int) -> DiagnosticStatus:
    """State of the published pointing."""
    values = {"clock jumps back": str(clock_jumps)}
    if estimate is None:
        return DiagnosticStatus("pointing", Level.WARN, "no reading of the encoders yet", values)
    text = f"{estimate.status.name}: {estimate.text or f'by {_BY[estimate.mode]}'}"
    if estimate.status is not Status.INVALID:
        axis_n = estimate.rotation_nm[:, 0]
        across = np.trace(estimate.covariance_n) - axis_n @ estimate.covariance_n @ axis_n
        values |= {
            "mode": estimate.mode.name,
            "lights": str(estimate.light_count),
            "sigma of the axis (arcsec)": f"{np.sqrt(across) / ARCSEC:.2f}",
        }
    return DiagnosticStatus("pointing", _LEVELS[estimate.status], text, values)


def calibration_status(calibration: Calibration, messages: list[str]) -> DiagnosticStatus:
    """State of the calibration: what was said of a saved one, and what the sightings leave open."""
    values = {"sightings": str(calibration.sighting_count)}
    if calibration.sighting_count:
        values["residual RMS (arcsec)"] = f"{calibration.residual_rms / ARCSEC:.2f}"
        values["not told apart"] = "; ".join(calibration.unobservable) or "nothing"
    level = Level.WARN if messages else Level.OK
    return DiagnosticStatus("calibration", level, "; ".join(messages) or "as configured, saved or sighted", values)

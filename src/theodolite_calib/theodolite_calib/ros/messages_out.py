"""From the core's results to messages: axes, units, field names. Sets fields only; a factory knows the classes."""

from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_estimation.refusals import Reason
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.measured.samples import ExposureDecision, PointingEstimate
from theodolite_calib.optical_axis.calibration import Calibration

MAIN_FRAME = "theodolite_main"
BASE_FRAME = "theodolite_base"
LIGHTS = "lights"
"""Source of the innovations."""


def pointing(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """ship_msgs/OpticalAxisPointing; all NaN where no pointing is claimed."""
    angles, covariance = _angles(estimate)
    telescope = angles_from_rotation(estimate.rotation_nt)
    return factory.make(
        "ship_msgs/msg/OpticalAxisPointing",
        header=make_header(factory, estimate.time_ns, MAIN_FRAME),
        azimuth=float(angles[0]),
        elevation=float(angles[1]),
        image_rotation=float(angles[2]),
        covariance=covariance.ravel(),
        rotation_covariance=enu_covariance(estimate.covariance_n).ravel(),
        telescope_azimuth=float(telescope[0]),
        telescope_elevation=float(telescope[1]),
        telescope_rotation=float(telescope[2]),
        mode=int(estimate.mode),
        status=int(estimate.status),
        light_count=estimate.light_count,
    )


def error_budget(factory: MessageFactory, estimate: PointingEstimate, sources: list[str]) -> Any:
    """ship_msgs/ErrorBudget of a published pointing."""
    return factory.make(
        "ship_msgs/msg/ErrorBudget",
        header=make_header(factory, estimate.time_ns, MAIN_FRAME),
        quantity="optical_axis",
        sources=list(sources),
        covariances=enu_covariance(estimate.parts_n).ravel(),
        total=enu_covariance(estimate.covariance_n).ravel(),
    )


def error_arcsec(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """ship_msgs/PointingErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
    angles, covariance = _angles(estimate)
    sigma = np.sqrt(np.diagonal(covariance)) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/PointingErrorArcsec",
        header=make_header(factory, estimate.time_ns, MAIN_FRAME),
        sigma_azimuth_cos_elevation=float(sigma[0] * np.cos(angles[1])),
        sigma_elevation=float(sigma[1]),
        sigma_image_rotation=float(sigma[2]),
        error_azimuth_cos_elevation=unknown,
        error_elevation=unknown,
        error_image_rotation=unknown,
    )


def calibration(factory: MessageFactory, values: Calibration, now_ns: int) -> Any:
    """ship_msgs/TheodoliteCalibration, stamped with the last sighting, or now where there was none."""
    return factory.make(
        "ship_msgs/msg/TheodoliteCalibration",
        header=make_header(factory, values.time_ns or now_ns, BASE_FRAME),
        names=list(values.names),
        values=values.values,
        covariance=values.covariance.ravel(),
        units=list(values.units),
        unobservable=list(values.unobservable),
        sighting_count=values.sighting_count,
        residual_rms=values.residual_rms,
    )


def innovation(factory: MessageFactory, decision: ExposureDecision) -> Any:
    """ship_msgs/Innovation of an exposure that was judged."""
    reason, text = decision.reason, decision.text
    if decision.revised:
        verdict = "now used" if decision.accepted else f"now refused: {reason.word}"
        reason, text = Reason.REVISED, f"judged anew after a measurement that arrived late, {verdict} {text}".rstrip()
    return factory.make(
        "ship_msgs/msg/Innovation",
        header=make_header(factory, decision.measurement.time_ns, LIGHTS),
        source=LIGHTS,
        components=list(decision.components),
        residual=decision.residual,
        sigma=decision.sigma,
        nis=float(decision.nis),
        gate=float(decision.gate),
        accepted=decision.accepted,
        reason=int(reason),
        reason_text=text,
    )


def _angles(estimate: PointingEstimate) -> tuple[FloatArray, FloatArray]:
    """Azimuth, elevation, image rotation (rad) and their covariance (rad²)."""
    angles = angles_from_rotation(estimate.rotation_nm)
    return angles, angle_covariance(estimate.covariance_n, angles[0], angles[1])

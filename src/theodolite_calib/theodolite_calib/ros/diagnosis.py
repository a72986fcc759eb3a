"""What the diagnostics say of the pointing itself, in words for the watch."""

import numpy as np

from ship_estimation.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_node.edge.messages_out import DiagnosticStatus, Level
from theodolite_calib.measured.samples import ExposureDecision, Mode, PointingEstimate
from theodolite_calib.optical_axis.calibration import Calibration

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


def conflict_statuses(conflict: ExposureDecision | None) -> list[DiagnosticStatus]:
    """The lights that keep disagreeing with the encoders and the ship, if they do."""
    return [] if conflict is None else [DiagnosticStatus("conflict lights", Level.ERROR, conflict.text)]

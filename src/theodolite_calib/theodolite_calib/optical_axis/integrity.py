"""How far the pointing may be wrong although nothing says so: protection levels of its angles.

The estimates without one source each (:mod:`theodolite_calib.filter.alternatives`) tell how far the main axis would be
another one without it; :mod:`ship_estimation.protection` makes levels of that.
"""

import numpy as np

from ship_estimation.compiled_integrity import apart
from ship_estimation.outcome import Status
from ship_estimation.protection import Hypotheses, IntegrityReport, integrity_report
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.model import chain_rows
from theodolite_calib.filter.step import hypothesis_factors
from theodolite_calib.measured.samples import Mode, PointingEstimate

QUANTITIES = ("azimuth_cos_elevation", "elevation", "image_rotation")
"""What the levels bound."""


def integrity_of(
    filter_: CalibrationFilter, config: OpticalAxisConfig, estimate: PointingEstimate
) -> IntegrityReport:
    """The integrity of a pointing.

    Args:
        filter_: the filter and its model.
        config: its configuration.
        estimate: the pointing, which rests on a state of the filter.
    """
    state, sources = estimate.state, filter_.rows.sources
    azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
    to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
    to_angles[0] *= np.cos(elevation)
    # What the estimates dispute is covered by the levels already. What a pointing adds to the error of the state, as
    # the noise of the encoders, is the same in every estimate.
    beside = apart(
        chain_rows(filter_.model),
        to_angles,
        to_angles @ estimate.by_error_n,
        estimate.undisputed_n,
        state.mean,
        state.alternatives.mean,
        state.parts,
        state.alternatives.parts[:, 0],
    )
    excluded = {name: told.exclusion.since_ns for name, told in state.trust.left_out.items()}
    # Without lights nothing checks the encoders and the ship's attitude.
    in_dispute = state.trust.conflict is not None or state.refusals > 0 or estimate.status is Status.INVALID
    checked = estimate.mode is not Mode.ENCODER and not in_dispute
    hypotheses = Hypotheses(sources, hypothesis_factors(config.integrity, sources), *beside)
    rows = [row for row, name in enumerate(sources) if name not in excluded]
    return integrity_report(estimate.time_ns, config.integrity, hypotheses, rows, excluded, checked)

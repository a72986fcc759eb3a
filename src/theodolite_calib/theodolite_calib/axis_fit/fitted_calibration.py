"""A fit of sightings as the calibration that ``optical_axis`` starts from."""

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.robust_fit import AxisFit
from theodolite_calib.chain.axes import NAMES
from theodolite_calib.optical_axis.calibration import SAVED_NAMES, CalibrationPrior


def fitted_calibration(fit: AxisFit, time_s: FloatArray | None, serial: str) -> CalibrationPrior:
    """The calibration of a fit whose sigmas are known.

    Terms that were held, the focal length and the parallelism have no variance in it: they stay as configured.

    Args:
        fit: of the sightings.
        time_s: their moments, UTC as POSIX time; None where nobody knows: the calibration then is of 1970, so old.
        serial: of the theodolite.
    """
    values, covariance = np.zeros(len(SAVED_NAMES)), np.zeros((len(SAVED_NAMES), len(SAVED_NAMES)))
    values[: len(NAMES)] = fit.errors.vector()
    rows = [SAVED_NAMES.index(name) for name in fit.fitted]
    covariance[np.ix_(rows, rows)] = fit.covariance
    time_ns = 0 if time_s is None else round(float(np.max(time_s)) * 1e9)
    return CalibrationPrior(time_ns, serial, "", values, covariance)

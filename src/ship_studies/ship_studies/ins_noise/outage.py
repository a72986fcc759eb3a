"""Consistency check of a fitted model: predictions without stars over parts of the record, against later stars.

The record is cut into equal intervals. At the beginning of each interval except the first, the filter has used all
earlier stars. The filter predicts the INS's error to the end of the interval without stars, and the last stars of the
interval determine the prediction error. Under the model the errors of successive intervals are independent, because
each prediction uses all earlier stars. So the sum of the normalised squared errors follows chi², and their mean has a
known band.
"""

from typing import NamedTuple

import numpy as np

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import FloatArray
from ship_studies.ins_noise.fit import FittedModel
from ship_studies.ins_noise.likelihood import EpochFilter
from ship_studies.ins_noise.star_record import StarRecord

SHARES = (2, 4, 8, 16)
"""Numbers of intervals in a record: longer horizons are too rare to test, and much shorter horizons are not outages."""

_MAX_INTERVAL_RATIO = 1.25
"""Maximum ratio of the length of an interval to the horizon; an interval is excluded if stars return later."""

_CHECKED_SHARE = 0.125
"""Share of an interval at its end whose stars determine the prediction error."""

_MAX_CHECKED_EPOCHS = 50
"""Maximum number of epochs that determine a prediction error; more epochs do not improve the comparison."""

_PARTS = {"tilt": [0, 2], "heading": [1]}


class PredictionError(NamedTuple):
    """Error of predictions of tilt or heading.

    Attributes:
        rms_arcsec: RMS error of one axis.
        sigma_arcsec: predicted sigma of one axis, without the part that the stars at the end do not observe.
        nees: mean normalised error squared; two degrees of freedom for tilt, one for heading.
        nees_limit: upper limit of the 99.9 % band of ``nees``.
    """

    rms_arcsec: float
    sigma_arcsec: float
    nees: float
    nees_limit: float

    @property
    def is_consistent(self) -> bool:
        """True if the mean NEES is at most its limit; False for NaN."""
        return self.nees <= self.nees_limit


class OutageCheck(NamedTuple):
    """Predictions over one horizon compared with the stars at its end.

    Attributes:
        horizon_s: length of the intervals without stars.
        intervals: number of intervals.
        parts: ``tilt`` and ``heading`` → error of the predictions.
    """

    horizon_s: float
    intervals: int
    parts: dict[str, PredictionError]


def outage_checks(record: StarRecord, fitted: FittedModel) -> list[OutageCheck]:
    """Return the checks of a fitted model for each of SHARES that the record allows."""
    epochs = EpochFilter(record, fitted.model.steps(fitted.values[None], record.times_s))
    times_s, checks = record.times_s, []
    for share in SHARES:
        horizon_s = record.duration_s / share
        found = []
        for begin_s in horizon_s * np.arange(1, share):
            begin = int(np.searchsorted(times_s, begin_s, side="right")) - 1
            # By rounding, the last interval may end slightly after the record.
            end = int(np.searchsorted(times_s, begin_s + horizon_s - 1e-6))
            is_there = end < len(times_s) and times_s[end] - begin_s <= _MAX_INTERVAL_RATIO * horizon_s
            if is_there and end > begin:
                found.append(_prediction_error(epochs, begin, end))
        if found:
            checks.append(_outage_check(horizon_s, *(np.array(column) for column in zip(*found, strict=True))))
    return checks


def _prediction_error(epochs: EpochFilter, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
    """Return the correction of a prediction by the last stars, arcsec, shape (3,), and its covariance, (3, 3).

    Directions that the stars do not observe, such as a rotation about the only boresight, are not corrected and not
    tested.
    """
    estimate = epochs.estimate_at(begin)
    predicted = epochs.predict(estimate, begin, end)
    since_s = epochs.times_s[end] - _CHECKED_SHARE * (epochs.times_s[end] - epochs.times_s[begin])
    last = max(int(np.searchsorted(epochs.times_s, since_s)), end + 1 - _MAX_CHECKED_EPOCHS, begin + 1)
    corrected, at = estimate, begin
    for epoch in range(last, end + 1):
        corrected, at = epochs.update(epochs.predict(corrected, at, epoch), epoch), epoch
    # The covariance of the correction is the reduction of the covariance.
    return corrected.mean[:3] - predicted.mean[:3], predicted.covariance[:3, :3] - corrected.covariance[:3, :3]


def _outage_check(horizon_s: float, errors_by_interval: FloatArray, covariance: FloatArray) -> OutageCheck:
    parts = {}
    for name, axes in _PARTS.items():
        errors, claimed = errors_by_interval[:, axes], covariance[:, axes][:, :, axes]
        parts[name] = PredictionError(
            rms_arcsec=float(np.sqrt(np.mean(errors**2))),
            sigma_arcsec=float(np.sqrt(np.mean(np.diagonal(claimed, axis1=1, axis2=2)))),
            nees=float(np.mean(normalized_error_squared(errors, claimed))),
            nees_limit=mean_nees_band(len(errors), len(axes))[1],
        )
    return OutageCheck(horizon_s, len(errors_by_interval), parts)

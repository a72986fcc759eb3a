"""What a fitted model is worth without stars: predictions over parts of the record itself, against what stars then say.

The record is cut into equal intervals. At the beginning of each but the first the filter has all stars up to there; it
predicts the INS's error to the end of the interval without any, and the last stars of the interval say how wrong that
was. Under the model the errors of successive intervals are independent: the next prediction rests on all that the last
one missed. So the sum of their normalised squares is chi², and its mean has a band.
"""

from typing import NamedTuple

import numpy as np

from ship_estimation.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import FloatArray
from ship_replay.ins_noise.fit import FittedModel
from ship_replay.ins_noise.likelihood import EpochFilter
from ship_replay.ins_noise.star_record import StarRecord

SHARES = (2, 4, 8, 16)
"""Intervals in a record: longer horizons are met too rarely to judge by, and much shorter ones are no outage."""

_LATE = 1.25
"""Of a horizon: where stars come back later than this, the interval is left out."""

_LAST = 0.125
"""Share of an interval at its end whose stars say how wrong the prediction is."""

_MOST_LAST = 50
"""Epochs of it at most: more do not make the stars any surer beside what is predicted."""

_PARTS = {"tilt": [0, 2], "heading": [1]}


class Missed(NamedTuple):
    """By how much predictions of tilt or heading were wrong.

    Attributes:
        rms_arcsec: of each axis.
        sigma_arcsec: as claimed for it, but for what the stars at the end do not see.
        nees: mean normalised error squared; two degrees of freedom for tilt, one for heading.
        most: the upper end of its band of 99.9 %.
    """

    rms_arcsec: float
    sigma_arcsec: float
    nees: float
    most: float

    @property
    def is_honest(self) -> bool:
        """Whether the errors are no larger than claimed; NaN is not."""
        return self.nees <= self.most


class OutageCheck(NamedTuple):
    """Predictions over one horizon against the stars at its end.

    Attributes:
        horizon_s: length of the intervals without stars.
        intervals: number of them.
        parts: tilt and heading.
    """

    horizon_s: float
    intervals: int
    parts: dict[str, Missed]


def outage_checks(record: StarRecord, fitted: FittedModel) -> list[OutageCheck]:
    """The predictions of a fitted model over each of SHARES of a record that offers some."""
    epochs = EpochFilter(record, fitted.model.steps(fitted.values[None], record.times_s))
    times_s, checks = record.times_s, []
    for share in SHARES:
        horizon_s = record.duration_s / share
        found = []
        for begin_s in horizon_s * np.arange(1, share):
            begin = int(np.searchsorted(times_s, begin_s, side="right")) - 1
            # The last interval may end a rounding error after the record.
            end = int(np.searchsorted(times_s, begin_s + horizon_s - 1e-6))
            is_there = end < len(times_s) and times_s[end] - begin_s <= _LATE * horizon_s
            if is_there and end > begin:
                found.append(_missed(epochs, begin, end))
        if found:
            checks.append(_check(horizon_s, *(np.array(column) for column in zip(*found, strict=True))))
    return checks


def _missed(epochs: EpochFilter, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
    """By how much the last stars of an interval move the prediction, arcsec, shape (3,), and its covariance, (3, 3).

    What stars do not see, as a turn about the only boresight, they do not move: there nothing is judged.
    """
    known = epochs.known(begin)
    predicted = epochs.ahead(known, begin, end)
    since_s = epochs.times_s[end] - _LAST * (epochs.times_s[end] - epochs.times_s[begin])
    last = max(int(np.searchsorted(epochs.times_s, since_s)), end + 1 - _MOST_LAST, begin + 1)
    seen, at = known, begin
    for epoch in range(last, end + 1):
        seen, at = epochs.with_epoch(epochs.ahead(seen, at, epoch), epoch), epoch
    # The estimate moves by as much as its covariance shrinks.
    return seen.mean[:3] - predicted.mean[:3], predicted.covariance[:3, :3] - seen.covariance[:3, :3]


def _check(horizon_s: float, missed: FloatArray, covariance: FloatArray) -> OutageCheck:
    parts = {}
    for name, axes in _PARTS.items():
        errors, claimed = missed[:, axes], covariance[:, axes][:, :, axes]
        parts[name] = Missed(
            rms_arcsec=float(np.sqrt(np.mean(errors**2))),
            sigma_arcsec=float(np.sqrt(np.mean(np.diagonal(claimed, axis1=1, axis2=2)))),
            nees=float(np.mean(normalized_error_squared(errors, claimed))),
            most=mean_nees_band(len(errors), len(axes))[1],
        )
    return OutageCheck(horizon_s, len(missed), parts)

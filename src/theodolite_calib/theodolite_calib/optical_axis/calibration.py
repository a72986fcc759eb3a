"""The calibration in two views of the filter's state: for people now, and for the start of the next session.

:class:`Calibration` has the named values of the calibration topic: axis errors, focal length and deformation; where
stars may be seen, also N' and how the main axis stands in each camera.
:class:`CalibrationPrior` is what is saved: the constants. The deformation is not saved, for it will have changed by
then.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.chain.axes import NAMES
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_SAVED, parallelism_block
from theodolite_calib.filter.observability import DEFORMATION_NAMES, LENS_NAMES

SAVED_BLOCKS = ("axes", "focal_length", "parallelism")
SAVED_NAMES = (*NAMES, "focal_length", "parallelism_azimuth", "parallelism_elevation", "parallelism_rotation")
"""What is saved, in the order of the states' blocks."""

_OF_TELESCOPE = SAVED_NAMES[len(NAMES) :]


@dataclass(frozen=True)
class Calibration:
    """Named quantities with their joint covariance.

    Attributes:
        time_ns: moment of the last sighting used; 0 before it.
        names: as in ship_msgs/TheodoliteCalibration.
        values: rad or m, shape (n,).
        covariance: of the values, shape (n, n).
        units: "rad" or "m" for each.
        unobservable: combinations of names that the sightings so far cannot tell apart.
        sighting_count: sightings used so far.
        residual_rms: of lights and stars on the sky, rad; NaN before the first sighting.
    """

    time_ns: int
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    units: tuple[str, ...]
    unobservable: tuple[str, ...]
    sighting_count: int
    residual_rms: float


@dataclass(frozen=True)
class CalibrationPrior:
    """What a saved calibration holds.

    Attributes:
        time_ns: moment of the data it rests on.
        serial: of the theodolite.
        telescope_id: of the telescope.
        values: in the order of SAVED_NAMES, rad or m, shape (11,).
        covariance: joint, shape (11, 11).
    """

    time_ns: int
    serial: str
    telescope_id: str
    values: FloatArray
    covariance: FloatArray

    def sigmas(self) -> dict[str, FloatArray]:
        """Standard deviations by name with the theodolite's and its telescope's, each rad or m, shape (1,)."""
        telescope = f"{self.serial}, {self.telescope_id}"
        sigma = np.sqrt(np.diagonal(self.covariance))
        return {
            f"{name} of theodolite '{telescope if name in _OF_TELESCOPE else self.serial}'": sigma[i : i + 1]
            for i, name in enumerate(SAVED_NAMES)
        }


def calibration_of(filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState) -> Calibration:
    """The named values of a state; a flexure with value and sigma zero is left out."""
    model = filter_.model
    axes = config.axes.values + state.mean[model.slices["axes"]]
    variance = np.diagonal(state.covariance)
    shown = [i for i, row in enumerate(model.rows("axes")) if NAMES[i] != "flexure" or variance[row] > 0.0 or axes[i]]
    rows = np.concatenate([model.rows("axes")[shown], model.rows("focal_length"), model.rows("deformation")])
    deformation = state.mean[model.slices["deformation"]]
    by_stars = _by_stars(filter_, config, state)
    rows = np.concatenate([rows, [one.row for one in by_stars]]).astype(np.intp)
    values = np.concatenate([axes[shown], [filter_.sightings.focal_length_m(state.mean)], deformation])
    return Calibration(
        time_ns=state.informed_ns or 0,
        names=(*(NAMES[i] for i in shown), "focal_length", *DEFORMATION_NAMES, *(one.name for one in by_stars)),
        values=np.concatenate([values, [one.value for one in by_stars]]),
        covariance=state.covariance[np.ix_(rows, rows)],
        units=(*("rad" for _ in shown), "m", *("rad" for _ in DEFORMATION_NAMES), *(one.unit for one in by_stars)),
        unobservable=filter_.observability.open_combinations(state.unaided),
        sighting_count=state.sighting_count,
        residual_rms=state.residual_rms,
    )


class _Named(NamedTuple):
    """One state of the calibration topic: its name, its row, its value and the unit of that."""

    name: str
    row: int
    value: float
    unit: str


def _by_stars(filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState) -> list[_Named]:
    """What stars tell beside lights, as far as it is not held: N' and how the main axis stands in each camera."""
    if not config.telescopes:
        return []
    model, telescope = filter_.model, config.telescope
    told = {"parallelism": (SAVED_NAMES[-3:], telescope.parallelism, "rad")}
    for id_, camera in config.telescopes.items():
        names = tuple(f"telescopes.{id_}.{angle}" for angle in ("azimuth", "elevation", "roll"))
        # The calibration telescope has one parallelism by lights and by stars, and is told already.
        told.setdefault(parallelism_block(id_, config), (names, camera.parallelism, "rad"))
    told["lens"] = LENS_NAMES, telescope.lens.vector_m, "m"
    return [
        _Named(name, row, float(value + state.mean[row]), unit)
        for block, (names, configured, unit) in told.items()
        if block in model.slices
        for name, row, value in zip(names, model.rows(block).tolist(), configured, strict=True)
        if state.covariance[row, row] > 0.0
    ]


def prior_of(filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState) -> CalibrationPrior:
    """What to save of a state that rests on sightings."""
    assert state.informed_ns is not None
    rows = _rows(filter_)
    values = _configured(config) + state.mean[rows]
    covariance = state.covariance[np.ix_(rows, rows)]
    return CalibrationPrior(state.informed_ns, config.serial, config.telescope.telescope_id, values, covariance)


def state_from_prior(
    filter_: CalibrationFilter, config: OpticalAxisConfig, prior: CalibrationPrior, now_ns: int
) -> tuple[CalibrationState, list[str]]:
    """The start of a session with a saved calibration, and remarks for the operator.

    A calibration of another theodolite is not used at all, and one of another telescope is used without focal length
    and parallelism. A calibration older than ``calibration_max_age_d`` keeps its values, and the configured uncertainty
    is added to its own.
    """
    initial = filter_.initial_state()
    if prior.serial != config.serial:
        text = f"saved calibration is of theodolite '{prior.serial}', configured is '{config.serial}': not used"
        return initial, [text]
    messages = []
    # A quantity that was held when the calibration was saved takes its uncertainty from the configuration.
    usable = np.diagonal(prior.covariance) > 0.0
    of_telescope = usable & [name in _OF_TELESCOPE for name in SAVED_NAMES]
    if prior.telescope_id != config.telescope.telescope_id and np.any(of_telescope):
        usable &= ~of_telescope
        messages.append(
            f"saved calibration is of telescope '{prior.telescope_id}', configured is "
            f"'{config.telescope.telescope_id}': its focal length and parallelism are not used"
        )
    rows, chosen = _rows(filter_)[usable], np.flatnonzero(usable)
    mean, parts = initial.mean.copy(), initial.parts.copy()
    mean[rows] = (prior.values - _configured(config))[usable]
    age_d = max(now_ns - prior.time_ns, 0) * 1e-9 / 86400.0
    if age_d > config.calibration_max_age_d:
        messages.append(
            f"saved calibration is {age_d:.1f} d old, more than calibration_max_age_d = "
            f"{config.calibration_max_age_d:g}: its uncertainty is widened by the configured one"
        )
    else:
        parts[:, rows, :] = 0.0
        parts[:, :, rows] = 0.0
    source = filter_.model.sources.index(SOURCE_SAVED)
    parts[source][np.ix_(rows, rows)] += prior.covariance[np.ix_(chosen, chosen)]
    return filter_.started(mean, parts), messages


def _configured(config: OpticalAxisConfig) -> FloatArray:
    telescope = config.telescope
    return np.concatenate([config.axes.values, [telescope.focal_length_m], telescope.parallelism])


def _rows(filter_: CalibrationFilter) -> FloatArray:
    return np.concatenate([filter_.model.rows(name) for name in SAVED_BLOCKS])

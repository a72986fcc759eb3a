"""Calibration from the filter's state: values for the calibration topic, and a prior for the next session.

:class:`Calibration` has the named values of the calibration topic: axis errors, focal length and deformation. With
star cameras the calibration also has N' and the parallelism of the main axis in each camera, if these are estimated.
:class:`CalibrationPrior` has the constants, which are saved. The deformation is not saved, because it will have changed
at the next session.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_SAVED, parallelism_block
from theodolite_calib.filter.observability import DEFORMATION_NAMES, LENS_NAMES

SAVED_BLOCKS = ("axes", "focal_length", "parallelism")
SAVED_NAMES = (*NAMES, "focal_length", "parallelism_azimuth", "parallelism_elevation", "parallelism_rotation")
"""Names that are always saved, in the order of the state blocks; angles of other star cameras follow them."""

_TELESCOPE_NAMES = SAVED_NAMES[len(NAMES) :]
_REMOUNTED_SIGMAS = 6.0
"""Difference between saved and configured angles, in joint sigmas, above which a camera counts as remounted."""


def camera_names(id_: str) -> tuple[str, str, str]:
    """Return the names of the angles of the main axis in a star camera."""
    return f"telescopes.{id_}.azimuth", f"telescopes.{id_}.elevation", f"telescopes.{id_}.roll"


def camera_of(name: str) -> str:
    """Return the id of the star camera of a saved quantity; empty if the quantity is not an angle of a star camera."""
    return name.removeprefix("telescopes.").rpartition(".")[0] if name.startswith("telescopes.") else ""


@dataclass(frozen=True)
class Calibration:
    """Named quantities with their joint covariance.

    Attributes:
        time_ns: time of the last accepted sighting; 0 before the first sighting.
        names: names as in ship_msgs/TheodoliteCalibration.
        values: values, rad or m, shape (n,).
        covariance: covariance of the values, shape (n, n).
        units: "rad" or "m" for each value.
        unobservable: combinations of names that the accepted sightings cannot separate.
        sighting_count: number of accepted sightings.
        residual_rms: RMS of the residuals of beacons and stars on the sky, rad; NaN before the first accepted sighting.
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
    """Content of a saved calibration.

    Attributes:
        time_ns: time of the last sighting in the calibration.
        serial: serial number of the theodolite.
        telescope_id: id of the telescope.
        values: values in the order of ``names``, rad or m, shape (n,).
        covariance: joint covariance of the values, shape (n, n).
        names: SAVED_NAMES, then :func:`camera_names` of each star camera that is not the calibration telescope.
    """

    time_ns: int
    serial: str
    telescope_id: str
    values: FloatArray
    covariance: FloatArray
    names: tuple[str, ...] = SAVED_NAMES

    def sigmas(self) -> dict[str, FloatArray]:
        """Return standard deviations, rad or m, shape (1,), by a text of name and serial number.

        The text of a quantity of the telescope also contains the telescope's id.
        """
        telescope = f"{self.serial}, {self.telescope_id}"
        sigma = np.sqrt(np.diagonal(self.covariance))
        return {
            f"{name} of theodolite '{telescope if name in _TELESCOPE_NAMES else self.serial}'": sigma[i : i + 1]
            for i, name in enumerate(self.names)
        }


def calibration_from_state(
    filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState
) -> Calibration:
    """Return the named values of a state; the flexure is omitted if its value and sigma are zero."""
    model, mean, covariance = filter_.model, state.mean, state.covariance
    axis_rows, (length_row,) = model.state_indices("axes").tolist(), model.state_indices("focal_length").tolist()
    axes = zip(NAMES, axis_rows, (config.axes.values + mean[axis_rows]).tolist(), strict=True)
    listed = [
        _CalibrationValue(name, row, value, "rad")
        for name, row, value in axes
        if name != "flexure" or covariance[row, row] > 0.0 or value
    ]
    listed.append(_CalibrationValue("focal_length", length_row, filter_.sightings.focal_length_m(mean), "m"))
    for name, row in zip(DEFORMATION_NAMES, model.state_indices("deformation").tolist(), strict=True):
        listed.append(_CalibrationValue(name, row, mean[row], "rad"))
    names, rows, values, units = zip(*listed, *_star_values(filter_, config, state), strict=True)
    return Calibration(
        time_ns=state.last_update_ns or 0,
        names=names,
        values=np.array(values),
        covariance=covariance[np.ix_(rows, rows)],
        units=units,
        unobservable=filter_.observability.unobservable_combinations(state.observability),
        sighting_count=state.sighting_count,
        residual_rms=state.residual_rms,
    )


class _CalibrationValue(NamedTuple):
    """One value of the calibration topic, with the index ``row`` of its state."""

    name: str
    row: int
    value: float
    unit: str


def _star_values(
    filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState
) -> list[_CalibrationValue]:
    """Return N' and the parallelism of each camera if they are estimated; no values without star cameras."""
    if not config.telescopes:
        return []
    model, telescope = filter_.model, config.telescope
    reported = {"parallelism": (SAVED_NAMES[-3:], telescope.parallelism, "rad")}
    for id_, camera in config.telescopes.items():
        # The parallelism of the calibration telescope is already listed, because beacons and stars share it.
        reported.setdefault(parallelism_block(id_, config), (camera_names(id_), camera.parallelism, "rad"))
    reported["lens"] = LENS_NAMES, telescope.lens.vector_m, "m"
    return [
        _CalibrationValue(name, row, float(value + state.mean[row]), unit)
        for block, (names, configured, unit) in reported.items()
        if block in model.slices
        for name, row, value in zip(names, model.state_indices(block).tolist(), configured, strict=True)
        if state.covariance[row, row] > 0.0
    ]


def prior_from_state(
    filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState
) -> CalibrationPrior:
    """Return the prior to save, from a state after at least one sighting."""
    assert state.last_update_ns is not None
    saved = _saved_quantities(filter_, config)
    rows = [one.row for one in saved]
    return CalibrationPrior(
        time_ns=state.last_update_ns,
        serial=config.serial,
        telescope_id=config.telescope.telescope_id,
        values=np.array([one.total_value(state.mean[one.row]) for one in saved]),
        covariance=state.covariance[np.ix_(rows, rows)],
        names=tuple(one.name for one in saved),
    )


def state_from_prior(
    filter_: CalibrationFilter, config: OpticalAxisConfig, prior: CalibrationPrior, now_ns: int
) -> tuple[CalibrationState, list[str]]:
    """Return the initial state of a session with a saved calibration, and remarks for the operator.

    A calibration of another theodolite is not used. A calibration of another telescope is used without focal length and
    parallelism. The angles of a camera that is not configured, or was remounted, are not used. For a calibration older
    than ``calibration_max_age_d`` the configured uncertainty is added to the saved uncertainty.
    """
    initial = filter_.initial_state()
    if prior.serial != config.serial:
        text = f"saved calibration is of theodolite '{prior.serial}', configured is '{config.serial}': not used"
        return initial, [text]
    saved = {one.name: one for one in _saved_quantities(filter_, config)}
    messages = []
    # A quantity that was fixed in the saved calibration has its value and uncertainty from the configuration.
    usable = np.diagonal(prior.covariance) > 0.0
    of_telescope = usable & [name in _TELESCOPE_NAMES for name in prior.names]
    if prior.telescope_id != config.telescope.telescope_id and np.any(of_telescope):
        usable &= ~of_telescope
        messages.append(
            f"saved calibration is of telescope '{prior.telescope_id}', configured is "
            f"'{config.telescope.telescope_id}': its focal length and parallelism are not used"
        )
    for id_ in dict.fromkeys(filter(None, map(camera_of, prior.names))):
        of_camera = np.array([camera_of(name) == id_ for name in prior.names])
        reason = _camera_refusal_reason(prior, of_camera & usable, saved, initial)
        if reason:
            usable &= ~of_camera
            messages.append(f"saved calibration of camera '{id_}' is not used: {reason}")
    chosen = np.flatnonzero(usable)
    rows = np.array([saved[prior.names[place]].row for place in chosen], dtype=np.intp)
    mean, parts = initial.mean.copy(), initial.covariance_by_source.copy()
    mean[rows] = [saved[prior.names[place]].correction(prior.values[place]) for place in chosen]
    age_d = max(now_ns - prior.time_ns, 0) * 1e-9 / 86400.0
    if age_d > config.calibration_max_age_d:
        messages.append(
            f"saved calibration is {age_d:.1f} d old, more than calibration_max_age_d = "
            f"{config.calibration_max_age_d:g}: the configured uncertainty is added to its own"
        )
    else:
        parts[:, rows, :] = 0.0
        parts[:, :, rows] = 0.0
    source = filter_.model.sources.index(SOURCE_SAVED)
    parts[source][np.ix_(rows, rows)] += prior.covariance[np.ix_(chosen, chosen)]
    return filter_.initial_state_from(mean, parts), messages


class _SavedQuantity(NamedTuple):
    """Saved quantity: its name, the index ``row`` of its state, and its configured value."""

    name: str
    row: int
    configured: float

    def total_value(self, correction: float) -> float:
        """Return the configured value plus a correction."""
        value = float(self.configured + correction)
        return float(wrap_pi(value)) if camera_of(self.name) else value

    def correction(self, total_value: float) -> float:
        """Return a total value minus the configured value."""
        difference = float(total_value - self.configured)
        return float(wrap_pi(difference)) if camera_of(self.name) else difference


def _saved_quantities(filter_: CalibrationFilter, config: OpticalAxisConfig) -> list[_SavedQuantity]:
    """Return all saved quantities: SAVED_NAMES, then the angles of each other star camera."""
    model, telescope = filter_.model, config.telescope
    names, configured = [*SAVED_NAMES], [*config.axes.values, telescope.focal_length_m, *telescope.parallelism]
    blocks = [*SAVED_BLOCKS]
    for id_, camera in config.telescopes.items():
        if id_ != telescope.telescope_id:
            names += camera_names(id_)
            configured += [*camera.parallelism]
            blocks.append(parallelism_block(id_, config))
    rows = np.concatenate([model.state_indices(block) for block in blocks])
    return list(map(_SavedQuantity, names, rows.tolist(), map(float, configured)))


def _camera_refusal_reason(
    prior: CalibrationPrior,
    of_camera: NDArray[np.bool_],
    saved: Mapping[str, _SavedQuantity],
    initial: CalibrationState,
) -> str:
    """Return the reason why the saved angles of a camera are not used; empty if they are used."""
    for place in np.flatnonzero(of_camera):
        one = saved.get(prior.names[place])
        if one is None:
            return "no camera of this name with angles of its own is configured"
        sigma = np.sqrt(prior.covariance[place, place] + initial.covariance[one.row, one.row])
        offset = abs(one.correction(prior.values[place]))
        if not offset <= _REMOUNTED_SIGMAS * sigma:
            angle = one.name.rpartition(".")[2]
            distance_text = (
                f"{offset / ARCSEC:.1f} arcsec from the configured one, more than {_REMOUNTED_SIGMAS:g} sigma"
            )
            return f"its {angle} is {distance_text}: remounted?"
    return ""

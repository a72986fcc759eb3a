"""Alignment, which consists of the estimated installation angles and clock offsets.

:class:`Alignment` holds named values for the alignment topic, among them the INS errors and the optics of cameras.
:class:`AlignmentPrior` holds the start values of the next voyage, without INS attitude errors and optics.
"""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.model import SOURCE_SAVED_ALIGNMENT
from ship_attitude_star.ship_attitude.state import FilterState
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation, wrap_pi

_OPTICS = ("focal_length", "1"), ("principal_u", "px"), ("principal_v", "px"), ("distortion_k1", "1")
"""Names and units of the errors of a camera's optics, true minus configured; the focal length error is relative."""


@dataclass(frozen=True)
class Alignment:
    """Named quantities with their joint covariance.

    Attributes:
        names: names as in ship_msgs/AlignmentState.
        values: values, shape (n,).
        covariance: covariance of the values, shape (n, n).
        units: unit of each value: "rad", "s", "px", or "1" for a ratio.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    units: tuple[str, ...]


@dataclass(frozen=True)
class AlignmentPrior:
    """Content of a saved alignment.

    Attributes:
        time_ns: time of the last applied measurement.
        serials: serial number by star sensor id.
        rotations_dv: rotation deck from device by device name, shape (3, 3).
        time_offsets_s: clock offset by state name, configured plus estimated, s.
        names: names of the state blocks of ``covariance``, in order.
        covariance: joint covariance of rotation vectors in the device frames (rad) and clock offsets (s).
    """

    time_ns: int
    serials: dict[str, str]
    rotations_dv: dict[str, FloatArray]
    time_offsets_s: dict[str, float]
    names: tuple[str, ...]
    covariance: FloatArray

    def sigmas(self) -> dict[str, FloatArray]:
        """Return standard deviations by block name, rad or s, shape (3,) or (1,).

        The name of a star sensor's installation block includes the sensor's serial number if known.
        """
        serials = {f"star.{id_}.installation": f" of serial {serial}" for id_, serial in self.serials.items() if serial}
        return {name + serials.get(name, ""): sigma for name, sigma in self.block_sigmas()}

    def block_sigmas(self) -> list[tuple[str, FloatArray]]:
        """Return the state blocks with their standard deviations, rad or s, shape (3,) or (1,)."""
        sigma, ends = np.sqrt(np.diagonal(self.covariance)), accumulate(map(_width, self.names))
        return [(name, sigma[end - _width(name) : end]) for name, end in zip(self.names, ends, strict=True)]


def current_alignment(filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState) -> Alignment:
    """Return the alignment of a state."""
    model = filter_.model
    quantities: list[tuple[str, float, str, FloatArray]] = []

    def add(name: str, value: float, unit: str, row: FloatArray) -> None:
        quantities.append((name, float(value), unit, row))

    def add_time_offset(name: str, configured_s: float) -> None:
        row = np.zeros(model.size)
        value_s = configured_s
        if name in model.slices:
            row[model.slices[name]] = 1.0
            value_s += state.mean[model.slices[name]][0]
        add(name, value_s, "s", row)

    attitude = model.slices["ins.attitude"]
    for axis, index in zip(("north", "up", "east"), range(attitude.start, attitude.stop), strict=True):
        add(f"ins.{axis}", state.mean[index], "rad", np.eye(model.size)[index])
    add_time_offset("ins.time_offset", config.ins.time_offset_s)
    for device in filter_.devices.values():
        angles, jacobian = _installation(filter_, state, device.name)
        for name, index in device.angles:
            angle = float(wrap_pi(angles[index])) if device.are_angles_signed else angles[index]
            add(f"{device.name}.{name}", angle, "rad", jacobian[index])
        if device.time_offset_s is not None:
            add_time_offset(f"{device.name}.time_offset", device.time_offset_s)
        optics = model.slices.get(f"{device.name}.optics")
        if optics is not None:
            camera = config.star_sensors[device.name.removeprefix("star.")].camera
            sigmas = camera.optics_errors(camera.camera(f"{device.parameters}.camera")).sigmas
            for (name, unit), index, sigma in zip(_OPTICS, range(optics.start, optics.stop), sigmas, strict=True):
                add(f"{device.name}.{name}", sigma * state.mean[index], unit, sigma * np.eye(model.size)[index])
    names, values, units, rows = zip(*quantities, strict=True)
    transport = np.array(rows)
    return Alignment(names, np.array(values), transport @ state.covariance @ transport.T, units)


def prior_from_state(filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState) -> AlignmentPrior:
    """Return the alignment to save from a state after measurements."""
    assert state.time_ns is not None
    model = filter_.model
    names = [name for name in model.slices if name.endswith((".installation", ".time_offset"))]
    rows = np.concatenate([model.state_indices(name) for name in names])
    to_saved = np.eye(model.size)
    rotations = {}
    for device in filter_.devices.values():
        block = model.slices[f"{device.name}.installation"]
        rotations[device.name] = installation_rotation(filter_, state, device.name)
        to_saved[block, block] = left_jacobian(state.mean[block]).T
    covariance = (to_saved @ state.covariance @ to_saved.T)[np.ix_(rows, rows)]
    offsets = {
        name: _configured_offset_s(filter_, config, name) + float(state.mean[model.slices[name]][0])
        for name in names
        if name.endswith(".time_offset")
    }
    serials = {id_: star.serial for id_, star in config.star_sensors.items()}
    return AlignmentPrior(state.time_ns, serials, rotations, offsets, tuple(names), covariance)


def state_from_prior(
    filter_: ShipFilter, config: ShipAttitudeConfig, prior: AlignmentPrior, now_ns: int
) -> tuple[FilterState, list[str]]:
    """Return the start state of a voyage with a saved alignment, and remarks for the operator.

    A sensor with another serial number keeps its configured prior. An alignment older than ``alignment_max_age_d``
    keeps its values, with the configured uncertainty added. The random walk since the alignment is always added.
    """
    model, initial = filter_.model, filter_.initial_state()
    warnings = _changed_serials(config, prior)
    foreign = tuple(f"star.{id_}." for id_ in warnings)
    usable = [name for name in prior.names if name in model.slices and not name.startswith(foreign)]
    mean, rows, saved_rows = initial.mean.copy(), list[int](), list[int]()
    start = dict(zip(prior.names, np.cumsum([0] + [_width(n) for n in prior.names]), strict=False))
    to_state = np.eye(model.size)
    for name in usable:
        block = model.slices[name]
        rows += range(block.start, block.stop)
        saved_rows += range(start[name], start[name] + _width(name))
        if name.endswith(".installation"):
            device = filter_.devices[name.removesuffix(".installation")]
            mean[block] = log_rotation(device.rotation_dv0.T @ prior.rotations_dv[device.name])
            to_state[block, block] = np.linalg.inv(left_jacobian(mean[block]).T)
        else:
            mean[block] = prior.time_offsets_s[name] - _configured_offset_s(filter_, config, name)
    age_s = max(now_ns - prior.time_ns, 0) * 1e-9
    messages = list(warnings.values())
    saved = np.zeros((model.size, model.size))
    saved[np.ix_(rows, rows)] = prior.covariance[np.ix_(saved_rows, saved_rows)]
    saved = to_state @ saved @ to_state.T
    saved[rows, rows] += model.transition(age_s)[1][rows]
    covariance_by_source = initial.covariance_by_source.copy()
    if age_s > config.alignment_max_age_d * 86400.0:
        messages.append(
            f"saved alignment is {age_s / 86400.0:.1f} d old, more than alignment_max_age_d = "
            f"{config.alignment_max_age_d:g}: its uncertainty is widened by the configured one"
        )
    else:
        covariance_by_source[:, rows, :] = 0.0
        covariance_by_source[:, :, rows] = 0.0
    covariance_by_source[model.sources.index(SOURCE_SAVED_ALIGNMENT)] += saved
    return filter_.fault_detector.initial_state(mean, covariance_by_source), messages


def installation_rotation(filter_: ShipFilter, state: FilterState, name: str) -> FloatArray:
    """Return the estimated rotation deck from device, shape (3, 3)."""
    vector = state.mean[filter_.model.slices[f"{name}.installation"]]
    rotation_dv: FloatArray = filter_.devices[name].rotation_dv0 @ exp_rotation(vector)
    return rotation_dv


def _installation(filter_: ShipFilter, state: FilterState, name: str) -> tuple[FloatArray, FloatArray]:
    """Return the installation angles (azimuth, elevation, roll) of a device, rad, and their Jacobian, shape (3, n)."""
    block = filter_.model.slices[f"{name}.installation"]
    vector = state.mean[block]
    rotation_dv = installation_rotation(filter_, state, name)
    angles = angles_from_rotation(rotation_dv)
    jacobian = np.zeros((3, filter_.model.size))
    to_angles = angle_errors_from_rotation_vector(angles[0], angles[1])
    jacobian[:, block] = to_angles @ rotation_dv @ left_jacobian(vector).T
    return angles, jacobian


def _changed_serials(config: ShipAttitudeConfig, prior: AlignmentPrior) -> dict[str, str]:
    return {
        id_: f"saved alignment of star sensor '{id_}' is of serial '{prior.serials[id_]}', "
        f"configured is '{star.serial}': its configured prior is used"
        for id_, star in config.star_sensors.items()
        if id_ in prior.serials and prior.serials[id_] != star.serial
    }


def _configured_offset_s(filter_: ShipFilter, config: ShipAttitudeConfig, name: str) -> float:
    if name == "ins.time_offset":
        return config.ins.time_offset_s
    offset_s = filter_.devices[name.removesuffix(".time_offset")].time_offset_s
    assert offset_s is not None
    return offset_s


def _width(name: str) -> int:
    return 3 if name.endswith(".installation") else 1

"""The saved alignment as a file: YAML that people can read, written atomically, with a version."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from ship_attitude_star.alignment import AlignmentPrior
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_node.errors import BadInput
from ship_node.files import DISK, Files

FORMAT = "ship_attitude alignment"
VERSION = 1

_ANGLES = "azimuth_deg", "elevation_deg", "roll_deg"
_ROUNDING = 1e-6

Section = TypeVar("Section")


def save(path: Path, prior: AlignmentPrior, files: Files = DISK) -> None:
    """Write an alignment; the file is either the old one or the new one, never a part.

    Raises:
        BadInput: the file cannot be written.
    """
    try:
        files.write(path, yaml.safe_dump(_document(prior), sort_keys=False, width=110).encode())
    except OSError as error:
        raise BadInput(f"{path}: the alignment cannot be written: {error.strerror}") from error


def load(path: Path, files: Files = DISK) -> AlignmentPrior:
    """Read an alignment.

    Raises:
        BadInput: names the file and what is wrong with it.
    """
    try:
        content = files.read(path)
    except OSError as error:
        raise BadInput(f"{path}: the alignment cannot be read: {error.strerror}") from error
    return _parsed(path, content)


def load_if_there(path: Path, files: Files = DISK) -> AlignmentPrior | None:
    """As :func:`load`; None where there is no such file."""
    try:
        content = files.read(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise BadInput(f"{path}: the alignment cannot be read: {error.strerror}") from error
    return _parsed(path, content)


def _parsed(path: Path, content: bytes) -> AlignmentPrior:
    try:
        document = yaml.safe_load(content.decode())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(f"{path}: not an alignment: expected 'format: {FORMAT}'")
    if document.get("version") != VERSION:
        raise BadInput(f"{path}: version {document.get('version')!r} of the alignment: expected {VERSION}")
    try:
        return _prior(document)
    except ValueError as error:
        raise BadInput(f"{path}: the alignment cannot be used: {error}; save it anew") from error


def _document(prior: AlignmentPrior) -> dict[str, Any]:
    devices = {}
    for name, rotation_dv in prior.rotations_dv.items():
        azimuth, elevation, roll = np.rad2deg(angles_from_rotation(rotation_dv)).tolist()
        roll_deg, azimuth_deg = roll, azimuth
        if name.startswith("reference."):
            azimuth_deg = float(np.rad2deg(wrap_pi(np.deg2rad(azimuth))))
        devices[name] = {"azimuth_deg": azimuth_deg, "elevation_deg": elevation, "roll_deg": roll_deg}
    sigma = np.sqrt(np.diagonal(prior.covariance))
    return {
        "format": FORMAT,
        "version": VERSION,
        "time_ns": prior.time_ns,
        "serials": prior.serials,
        "installation": devices,
        "time_offset_s": prior.time_offsets_s,
        "covariance_of": list(prior.names),
        "covariance_note": "rotation vectors (forward, up, right) in the device frames in rad, time offsets in s",
        "sigma_arcsec_or_s": _human_sigma(prior, sigma),
        "covariance": prior.covariance.tolist(),
    }


def _human_sigma(prior: AlignmentPrior, sigma: np.ndarray) -> dict[str, list[float]]:
    """Standard deviations for the reader of the file; not read back."""
    human, start = {}, 0
    for name in prior.names:
        width, unit = (3, ARCSEC) if name.endswith(".installation") else (1, 1.0)
        human[name] = [float(value) for value in sigma[start : start + width] / unit]
        start += width
    return human


def _prior(document: dict[str, Any]) -> AlignmentPrior:
    """What the document says; a ValueError names the section that cannot be used."""
    rotations_dv = _section(document, "installation", _rotations)
    time_offsets_s = _section(document, "time_offset_s", _finite_numbers)
    names = _section(document, "covariance_of", tuple)
    known = {f"{device}.installation": 3 for device in rotations_dv} | dict.fromkeys(time_offsets_s, 1)
    for name in names:
        if name not in known:
            raise ValueError(f"'covariance_of': {name!r} is neither in 'installation' nor in 'time_offset_s'")
    size = sum(known[name] for name in names)
    return AlignmentPrior(
        time_ns=_section(document, "time_ns", int),
        serials=_section(document, "serials", lambda serials: {str(k): str(v) for k, v in serials.items()}),
        rotations_dv=rotations_dv,
        time_offsets_s=time_offsets_s,
        names=names,
        covariance=_section(document, "covariance", lambda rows: _covariance(rows, size)),
    )


def _section(document: dict[str, Any], key: str, read: Callable[[Any], Section]) -> Section:
    try:
        return read(document[key])
    except KeyError as error:
        raise ValueError(f"{error} is missing" if error.args == (key,) else f"'{key}': {error} is missing") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"'{key}': {error}") from error


def _rotations(installation: dict[str, Any]) -> dict[str, FloatArray]:
    rotations = {}
    for name, angles in installation.items():
        angles_deg = _finite_numbers({f"{name} {key}": angles[key] for key in _ANGLES})
        rotations[name] = rotation_from_angles(*np.deg2rad(list(angles_deg.values())))
    return rotations


def _finite_numbers(values: dict[str, Any]) -> dict[str, float]:
    for name, value in values.items():
        if not np.isfinite(float(value)):
            raise ValueError(f"{name} is {value}: expected a finite number")
    return {str(name): float(value) for name, value in values.items()}


def _covariance(rows: list[list[float]], size: int) -> FloatArray:
    covariance = np.array(rows, dtype=float)
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise ValueError(f"shape {covariance.shape}: expected {size} x {size} finite numbers")
    # In sigmas, because angles are far smaller numbers than seconds.
    scale = np.sqrt(np.abs(np.diagonal(covariance)))
    correlation = covariance / np.where(scale > 0.0, np.outer(scale, scale), 1.0)
    if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
        raise ValueError("not symmetric")
    if np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        raise ValueError("not positive semidefinite")
    return covariance

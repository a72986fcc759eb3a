"""The saved alignment as a file: YAML that people can read, written atomically, with a version."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ship_attitude_star.alignment import AlignmentPrior
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_node.errors import BadInput

FORMAT = "ship_attitude alignment"
VERSION = 1


def save(path: Path, prior: AlignmentPrior) -> None:
    """Write an alignment; the file is either the old one or the new one, never a part.

    Raises:
        BadInput: the file cannot be written.
    """
    partial = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("w", encoding="utf-8") as stream:
            yaml.safe_dump(_document(prior), stream, sort_keys=False, width=110)
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except OSError as error:
        raise BadInput(f"{path}: the alignment cannot be written: {error.strerror}") from error


def load(path: Path) -> AlignmentPrior:
    """Read an alignment.

    Raises:
        BadInput: names the file and what is wrong with it.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{path}: the alignment cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(f"{path}: not an alignment: expected 'format: {FORMAT}'")
    if document.get("version") != VERSION:
        raise BadInput(f"{path}: version {document.get('version')!r} of the alignment: expected {VERSION}")
    try:
        return _prior(document)
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{path}: {type(error).__name__} in the alignment: {error}; save it anew") from error


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
    rotations = {
        name: rotation_from_angles(
            *np.deg2rad([float(d["azimuth_deg"]), float(d["elevation_deg"]), float(d["roll_deg"])])
        )
        for name, d in document["installation"].items()
    }
    names = tuple(document["covariance_of"])
    covariance = np.array(document["covariance"], dtype=float)
    size = sum(3 if name.endswith(".installation") else 1 for name in names)
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise ValueError(f"covariance of shape {covariance.shape}: expected {size} x {size} finite numbers")
    return AlignmentPrior(
        time_ns=int(document["time_ns"]),
        serials={str(k): str(v) for k, v in document["serials"].items()},
        rotations_dv=rotations,
        time_offsets_s={str(k): float(v) for k, v in document["time_offset_s"].items()},
        names=names,
        covariance=covariance,
    )

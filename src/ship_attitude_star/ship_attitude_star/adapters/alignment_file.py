"""Alignment file: readable YAML with a version, written atomically."""

from typing import Any

import numpy as np

from ship_attitude_star.ship_attitude.alignment import AlignmentPrior
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_node.saved_files.saved_document import SavedFormat, finite_numbers, joint_covariance, section, stamp_ns, texts

_ANGLES = "azimuth_deg", "elevation_deg", "roll_deg"


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
    """Return standard deviations for a person who reads the file; programs do not read them."""
    human, start = {}, 0
    for name in prior.names:
        width, unit = (3, ARCSEC) if name.endswith(".installation") else (1, 1.0)
        human[name] = [float(value) for value in sigma[start : start + width] / unit]
        start += width
    return human


def _prior(document: dict[str, Any]) -> AlignmentPrior:
    """Return the alignment of a document.

    Raises:
        ValueError: a section cannot be used; the text names the section.
    """
    rotations_dv = section(document, "installation", _rotations)
    time_offsets_s = section(document, "time_offset_s", finite_numbers)
    names = section(document, "covariance_of", _names)
    known = {f"{device}.installation": 3 for device in rotations_dv} | dict.fromkeys(time_offsets_s, 1)
    for name in names:
        if name not in known:
            raise ValueError(f"'covariance_of': {name!r} is neither in 'installation' nor in 'time_offset_s'")
    size = sum(known[name] for name in names)
    return AlignmentPrior(
        time_ns=section(document, "time_ns", stamp_ns),
        serials=section(document, "serials", texts),
        rotations_dv=rotations_dv,
        time_offsets_s=time_offsets_s,
        names=names,
        covariance=section(document, "covariance", lambda rows: joint_covariance(rows, size)),
    )


def _names(listed: list[Any]) -> tuple[str, ...]:
    names = tuple(name for name in listed if isinstance(name, str))
    if not isinstance(listed, list) or len(set(names)) != len(listed):
        raise ValueError("expected a list of names, each once")
    return names


def _rotations(installation: dict[str, Any]) -> dict[str, FloatArray]:
    rotations = {}
    for name, angles in installation.items():
        angles_deg = finite_numbers({f"{name} {key}": angles[key] for key in _ANGLES})
        rotations[str(name)] = rotation_from_angles(*np.deg2rad(list(angles_deg.values())))
    return rotations


ALIGNMENT_FILE = SavedFormat("ship_attitude alignment", 1, "alignment", _document, _prior)
"""Format of the alignment file."""

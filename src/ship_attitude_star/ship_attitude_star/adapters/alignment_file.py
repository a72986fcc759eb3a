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
        angles_deg = np.rad2deg(angles_from_rotation(rotation_dv)).tolist()
        if name.startswith("reference."):
            angles_deg[0] = float(np.rad2deg(wrap_pi(np.deg2rad(angles_deg[0]))))
        devices[name] = dict(zip(_ANGLES, angles_deg, strict=True))
    # Programs do not read these standard deviations; people do.
    sigmas = {
        name: (sigma / (ARCSEC if name.endswith(".installation") else 1.0)).tolist()
        for name, sigma in prior.block_sigmas()
    }
    return {
        "time_ns": prior.time_ns,
        "serials": prior.serials,
        "installation": devices,
        "time_offset_s": prior.time_offsets_s,
        "covariance_of": list(prior.names),
        "covariance_note": "rotation vectors (forward, up, right) in the device frames in rad, time offsets in s",
        "sigma_arcsec_or_s": sigmas,
        "covariance": prior.covariance.tolist(),
    }


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

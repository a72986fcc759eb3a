"""File of the saved calibration: readable YAML with a version, written atomically."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.saved_files.saved_document import SavedFormat, finite_numbers, joint_covariance, section, stamp_ns
from theodolite_calib.optical_axis.calibration import SAVED_NAMES, CalibrationPrior

_FOCAL_LENGTH = "focal_length"
_OF_CAMERA = re.compile(r"(telescopes\..+\.(?:azimuth|elevation|roll))_arcsec")

_HALF_TURN = np.pi * (1.0 + 1e-12)
"""Maximum angle: half a turn, because a camera may look backward, with a margin for rounding."""


def _key(name: str) -> str:
    return f"{name}_m" if name == _FOCAL_LENGTH else f"{name}_arcsec"


def _units(names: tuple[str, ...]) -> FloatArray:
    return np.array([1.0 if name == _FOCAL_LENGTH else ARCSEC for name in names])


def _document(prior: CalibrationPrior) -> dict[str, Any]:
    sigma = np.sqrt(np.diagonal(prior.covariance))
    return {
        "time_ns": prior.time_ns,
        "serial": prior.serial,
        "telescope_id": prior.telescope_id,
        "values": _values_in_file_units(prior.names, prior.values),
        "sigma": _values_in_file_units(prior.names, sigma),
        "covariance_note": "of the values in their order, in rad and m: g, c, I and the parallelism belong together; "
        "where a sigma is 0 the configured value applies",
        "covariance": prior.covariance.tolist(),
    }


def _values_in_file_units(names: tuple[str, ...], values: FloatArray) -> dict[str, float]:
    return dict(zip(map(_key, names), (values / _units(names)).tolist(), strict=True))


def _prior(document: dict[str, Any]) -> CalibrationPrior:
    """Return the content of the document.

    Raises:
        ValueError: a section cannot be used; the text names the section.
    """
    names = section(document, "values", _names)
    covariance = section(document, "covariance", lambda rows: joint_covariance(rows, len(names)))
    has_value = np.diagonal(covariance) > 0.0
    return CalibrationPrior(
        time_ns=section(document, "time_ns", stamp_ns),
        serial=section(document, "serial", str),
        telescope_id=section(document, "telescope_id", str),
        values=section(document, "values", lambda given: _values(given, names, has_value)),
        covariance=covariance,
        names=names,
    )


def _names(given: dict[str, Any]) -> tuple[str, ...]:
    """Return the names of the saved values: ``SAVED_NAMES``, then angles of cameras in the order of the file."""
    found = map(_OF_CAMERA.fullmatch, map(str, given.keys()))
    return (*SAVED_NAMES, *(match[1] for match in found if match is not None))


def _values(given: dict[str, Any], names: tuple[str, ...], has_value: NDArray[np.bool_]) -> FloatArray:
    """Return the values in SI units; the focal length may be 0 if it has no variance."""
    numbers = finite_numbers({key: given[key] for key in map(_key, names)})
    key_of_length = _key(_FOCAL_LENGTH)
    focal_length_m, has_focal_length = numbers[key_of_length], has_value[names.index(_FOCAL_LENGTH)]
    if not (focal_length_m > 0.0 or (focal_length_m == 0.0 and not has_focal_length)):
        raise ValueError(f"{key_of_length} is {focal_length_m:g}: expected more than 0")
    for key, number in numbers.items():
        if key != key_of_length and not abs(number) * ARCSEC <= _HALF_TURN:
            raise ValueError(f"{key} is {number:g}: expected an angle within half a turn")
    values: FloatArray = _units(names) * np.array(list(numbers.values()))
    return values


CALIBRATION_FILE = SavedFormat("optical_axis calibration", 1, "calibration", _document, _prior)
"""Format of a saved calibration."""

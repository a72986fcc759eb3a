"""The saved calibration as a file: YAML that people can read, written atomically, with a version."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.documents.saved_document import SavedFormat, finite_numbers, joint_covariance, section, stamp_ns
from theodolite_calib.optical_axis.calibration import SAVED_NAMES, CalibrationPrior

_KEYS = {name: "focal_length_m" if name == "focal_length" else f"{name}_arcsec" for name in SAVED_NAMES}
_UNITS = np.array([1.0 if name == "focal_length" else ARCSEC for name in SAVED_NAMES])


def _document(prior: CalibrationPrior) -> dict[str, Any]:
    sigma = np.sqrt(np.diagonal(prior.covariance))
    return {
        "time_ns": prior.time_ns,
        "serial": prior.serial,
        "telescope_id": prior.telescope_id,
        "values": _human(prior.values),
        "sigma": _human(sigma),
        "covariance_note": "of the values in their order, in rad and m: g, c, I and the parallelism belong together; "
        "where a sigma is 0 the configuration rules",
        "covariance": prior.covariance.tolist(),
    }


def _human(values: FloatArray) -> dict[str, float]:
    return dict(zip(_KEYS.values(), (values / _UNITS).tolist(), strict=True))


def _prior(document: dict[str, Any]) -> CalibrationPrior:
    """What the document says; a ValueError names the section that cannot be used."""
    size = len(SAVED_NAMES)
    covariance = section(document, "covariance", lambda rows: joint_covariance(rows, size))
    said = np.diagonal(covariance) > 0.0
    return CalibrationPrior(
        time_ns=section(document, "time_ns", stamp_ns),
        serial=section(document, "serial", str),
        telescope_id=section(document, "telescope_id", str),
        values=section(document, "values", lambda given: _values(given, said)),
        covariance=covariance,
    )


def _values(given: dict[str, Any], said: NDArray[np.bool_]) -> FloatArray:
    """The values; of a focal length without a sigma the file says nothing, and it may be 0."""
    numbers = finite_numbers({key: given[key] for key in _KEYS.values()})
    focal_length_m, is_said = numbers[_KEYS["focal_length"]], said[SAVED_NAMES.index("focal_length")]
    if not (focal_length_m > 0.0 or (focal_length_m == 0.0 and not is_said)):
        raise ValueError(f"{_KEYS['focal_length']} is {numbers[_KEYS['focal_length']]:g}: expected more than 0")
    for key, number in numbers.items():
        if key != _KEYS["focal_length"] and not abs(number) * ARCSEC <= np.pi:
            raise ValueError(f"{key} is {number:g}: expected an angle within half a turn")
    values: FloatArray = _UNITS * np.array(list(numbers.values()))
    return values


CALIBRATION_FILE = SavedFormat("optical_axis calibration", 1, "calibration", _document, _prior)
"""How a calibration is saved."""

"""Error budget of a layout: maximum size of each error for which the requirement is met, and the dominant error.

If all errors are scaled by one factor, the joint error scales by the same factor, because the best combination stays
the same. *Together*, all errors meet the requirement if each is divided by the requirement use, the ratio of sigma to
limit of the worst angle. *Alone*, with the other errors unchanged, an error may grow until the worst angle reaches its
limit; the sensors are then combined with their new covariances. An error that another sensor compensates may have any
size.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.layout.joint_error import Layout

MAX_ERROR_ARCSEC = 36_000.0
"""Largest error of a study, arcseconds; an error that is allowed to exceed this value may have any size."""
_MIN_NOISE_ARCSEC = 0.001
"""Minimum noise of a sensor, arcseconds: the covariance of zero noise is singular."""
_HALVINGS = 40

_AXES = ("forward", "up", "right")
_COMMON_INDICES = {"tilt": [0, 2], "heading": [1], "refraction": [3]}
_KINDS_OF_COMMON = {"tilt": "horizon", "heading": "clock", "refraction": "refraction"}


@dataclass(frozen=True)
class Allocation:
    """Maximum size of one error.

    Attributes:
        key: parameter of the study that sets the error.
        kind: "star noise", "installation", "refraction", "horizon" or "clock".
        sigma_arcsec: present size of the error.
        share: present fraction of the variance due to the error, for the angle that uses most of its limit.
        together_arcsec: maximum size of the error if all errors are scaled equally.
        alone_arcsec: maximum size of the error with the other errors unchanged; infinite if any size is allowed, NaN
            if the requirement is not met even without the error.
    """

    key: str
    kind: str
    sigma_arcsec: float
    share: float
    together_arcsec: float
    alone_arcsec: float


def requirement_use(sigmas_arcsec: FloatArray, limits_arcsec: FloatArray) -> FloatArray:
    """Return the ratio of sigma to limit of the worst angle, shape (...); NaN if a required angle is not known.

    Args:
        sigmas_arcsec: standard deviations of heading, pitch, roll, shape (..., 3).
        limits_arcsec: limits of these angles, shape (3,); infinite for an angle without requirement.
    """
    is_limited = np.isfinite(limits_arcsec)
    use: FloatArray = np.max(sigmas_arcsec[..., is_limited] / limits_arcsec[is_limited], axis=-1)
    return use


def binding_angle(sigmas_arcsec: FloatArray, limits_arcsec: FloatArray) -> int:
    """Return the index of the angle (heading, pitch, roll) that uses most of its limit."""
    return int(np.argmax(np.asarray(sigmas_arcsec) / limits_arcsec))


def allocate_errors(layout: Layout, limits_arcsec: FloatArray) -> list[Allocation]:
    """Return the maximum sizes of a layout's errors, the error with the largest share first.

    Args:
        layout: layout whose sigmas are known.
        limits_arcsec: maximum sigma of heading, pitch, roll, shape (3,); infinite for an angle without requirement.
    """
    sigmas = layout.sigmas_arcsec()
    use, angle = float(requirement_use(sigmas, limits_arcsec)), binding_angle(sigmas, limits_arcsec)
    shares: dict[str, float] = {}
    for source in layout.budget():
        part = float((source.errors_arcsec[angle] / sigmas[angle]) ** 2)
        shares[source.key] = shares.get(source.key, 0.0) + part
    rows = []
    for error in _errors(layout):
        sigma = error.sigma_arcsec(layout)
        alone = _max_alone_arcsec(layout, error, limits_arcsec)
        rows.append(Allocation(error.key, error.kind, sigma, shares.get(error.key, 0.0), sigma / use, alone))
    return sorted(rows, key=lambda row: -row.share)


@dataclass(frozen=True)
class _Error:
    """One error, with the field of a layout that contains the error, and the index in that field."""

    key: str
    kind: str
    field: str
    index: tuple[int | list[int], ...]
    least_arcsec: float

    def sigma_arcsec(self, layout: Layout) -> float:
        return float(np.max(getattr(layout, self.field)[self.index])) / ARCSEC

    def with_sigma(self, layout: Layout, sigma_arcsec: float) -> Layout:
        """Return the layout with another size of this error."""
        sigmas = getattr(layout, self.field).copy()
        sigmas[self.index] = ARCSEC * max(sigma_arcsec, self.least_arcsec)
        changed: Layout = replace(layout, **{self.field: sigmas})
        return changed


def _errors(layout: Layout) -> Iterator[_Error]:
    for number, name in enumerate(layout.names):
        for axis, axis_name in enumerate(_AXES):
            key = f"sensors.{name}.sigma_{axis_name}_arcsec"
            yield _Error(key, "star noise", "noise_sigmas", (number, axis), _MIN_NOISE_ARCSEC)
        for axis, axis_name in enumerate(_AXES):
            key = f"sensors.{name}.installation_sigma_{axis_name}_arcsec"
            yield _Error(key, "installation", "installation_sigmas", (number, axis), 0.0)
    for name, indices in _COMMON_INDICES.items():
        kind = _KINDS_OF_COMMON[name]
        yield _Error(f"common.{name}_sigma_arcsec", kind, "common_sigmas", (indices,), 0.0)


def _max_alone_arcsec(layout: Layout, error: _Error, limits_arcsec: FloatArray) -> float:
    """Return the largest sigma of one error that meets the requirement; the joint error grows with this sigma.

    Infinite if any size meets the requirement, NaN if no size meets it.
    """

    def is_met(sigma_arcsec: float) -> bool:
        return bool(requirement_use(error.with_sigma(layout, sigma_arcsec).sigmas_arcsec(), limits_arcsec) <= 1.0)

    if not is_met(0.0):
        return float("nan")
    if is_met(MAX_ERROR_ARCSEC):
        return float("inf")
    low, high = 0.0, MAX_ERROR_ARCSEC
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_met(middle) else (low, middle)
    return low

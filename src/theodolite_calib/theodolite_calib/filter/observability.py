"""Which combinations of axis errors and deformation the sightings cannot tell apart, as the live filter sees it.

Where stars may be seen beside lights, N' is among them: lights depend on it, and stars do not.

A second covariance runs beside the filter's. At its start the errors told of are as good as unknown, and the
deformation is a random walk as fast as the filter's process, without a mean to return to. All other states are as in
the filter, slow errors included. A combination that this covariance leaves open is therefore one that the sightings
leave open, however many of the same kind there are. A factor between N' and an angle is in metres for a radian.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.kalman import LinearMeasurement, StateModel, block, innovation, predict, update
from ship_estimation.open_combinations import open_combinations
from ship_geometry.rotations import FloatArray
from theodolite_calib.chain.axes import NAMES
from theodolite_calib.filter.model import ShipErrorStep, add_steady_noise, with_step

DEFORMATION_NAMES = ("deformation_bow", "deformation_up", "deformation_starboard")

LENS_NAMES = ("lens_forward", "lens_up", "lens_right")

_LEADING = (*DEFORMATION_NAMES, "c", "I", "h", "flexure", "beta_x", "beta_y", "g", *LENS_NAMES)
"""In this order errors lead the combinations that are told. The error that leads one combination is eliminated from all
others; the errors that pair with the deformation come last."""

_ONLY_SOURCE = 0
"""Index of the source of error that all states here share."""

_UNKNOWN = 1000.0
"""Sigma of an unknown error at the start, in sigmas of the configuration."""


@dataclass(frozen=True)
class Unaided:
    """Covariance of the states by the sightings alone, shape (1, n, n)."""

    parts: FloatArray


class Observability:
    """What the sightings tell of the states of a filter.

    Args:
        model: states of the filter.
        tells_lens: whether N' is told of, where it is a state.
    """

    def __init__(self, model: StateModel, tells_lens: bool = False) -> None:
        deformation = model.blocks["deformation"]
        unknown = {
            "axes": replace(model.blocks["axes"], sigma=_UNKNOWN * model.blocks["axes"].sigma),
            "deformation": block(
                "deformation",
                _UNKNOWN * deformation.sigma,
                "any",
                walk=deformation.sigma * np.sqrt(2.0 / deformation.time_s),
            ),
        }
        told = {"axes": NAMES, "deformation": DEFORMATION_NAMES}
        if tells_lens and "lens" in model.slices:
            unknown["lens"] = replace(model.blocks["lens"], sigma=_UNKNOWN * model.blocks["lens"].sigma)
            told["lens"] = LENS_NAMES
        blocks = [replace(unknown.get(name, entry), source="any") for name, entry in model.blocks.items()]
        self._model = StateModel(blocks, [])
        self._ship = model.slices["ship.attitude"]
        names = [name for of_block in told.values() for name in of_block]
        sigma = np.concatenate([model.blocks[name].sigma for name in told])
        rows = np.concatenate([model.rows(name) for name in told])
        self._told = names
        # An error with a sigma of 0 is held, and need not be told.
        order = [names.index(name) for name in _LEADING if name in names and sigma[names.index(name)] > 0.0]
        self._names, self._sigma, self._rows = [names[i] for i in order], sigma[order], rows[order]

    def start(self) -> Unaided:
        """Before any sighting."""
        return Unaided(self._model.initial_parts())

    def predicted(self, unaided: Unaided, dt_s: float, ship_steady_n: FloatArray | None) -> Unaided:
        """After ``dt_s``; the ship's error follows a stated steady covariance (rad², (3, 3)) where there is one."""
        decay, noise = self._model.transition(dt_s)
        parts = predict(unaided.parts, decay, noise, self._model.source_of)
        add_steady_noise(parts, self._ship, _ONLY_SOURCE, decay[self._ship], ship_steady_n)
        return Unaided(parts)

    def with_ship_step(self, unaided: Unaided, step: ShipErrorStep) -> Unaided:
        """After a change of the ship's error at once."""
        return Unaided(with_step(np.zeros(self._model.size), unaided.parts, self._ship, _ONLY_SOURCE, step)[1])

    def updated(self, unaided: Unaided, jacobian: FloatArray, noise: FloatArray) -> Unaided:
        """After a sighting with the filter's Jacobian (m, n) and noise (m, m)."""
        measurement = LinearMeasurement(np.zeros(len(noise)), jacobian, {_ONLY_SOURCE: noise})
        return Unaided(update(unaided.parts, measurement, innovation(unaided.parts, measurement).gain)[1])

    def open_combinations(self, unaided: Unaided) -> tuple[str, ...]:
        """Combinations of names that the sightings so far cannot tell apart, as ``g - deformation_up``."""
        covariance = unaided.parts[_ONLY_SOURCE][np.ix_(self._rows, self._rows)]
        return open_combinations(covariance, self._sigma, self._names, self._told)

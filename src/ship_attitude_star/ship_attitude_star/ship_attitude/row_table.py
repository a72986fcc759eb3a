"""The rows of hypotheses of a ship: what each of them leaves out, how probable that is, and what it owns.

The first row is by all sources that are not excluded; each other row does without one source more. In the last row the
INS is the one that is wrong: its slow error is unknown there, but its turn from one measurement to the next is used. A
ship with a single source has no such row: it would be nothing but that source.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_estimation.exclusion import excess_limit
from ship_estimation.parameters import ParameterError
from ship_estimation.protection import Factors, factors

INS = "ins"


class RowTable:
    """The rows of a configuration.

    Args:
        config: the node's configuration.
        model: what the states are.
        devices: the sources by name.

    Attributes:
        sources: names, in the order of their index.
        names: of the hypotheses, one for each row after the first.
        rows: how many there are, with the first.
        ins_row: where the INS is the one that is wrong; None where there is no such row.
        uses: which source each row uses where none is excluded, shape (h, s).
        own: by source, the states that belong to it alone, shape (n,).
        k: numbers of sigmas of the protection levels.
        limit: chi² of a mean of whitened turns that no source exceeds which is right.

    Raises:
        ParameterError: there are more rows than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        self.sources = tuple(devices)
        self.names = (*self.sources, INS) if len(self.sources) > 1 else self.sources
        self.rows, most = len(self.names) + 1, config.integrity.max_hypotheses
        if self.rows > most:
            reason = f"parameter 'integrity.max_hypotheses' = {most} is less than the {self.rows} of these sources: "
            raise ParameterError(reason + ", ".join(self.names), "integrity.max_hypotheses", value=most)
        self.ins_row = self.rows - 1 if len(self.sources) > 1 else None
        self.uses: NDArray[np.bool_] = np.arange(self.rows)[:, None] != np.arange(1, len(self.sources) + 1)
        self.own = {name: _own_states(model, name) for name in self.sources}
        prior = config.integrity.prior_per_h
        kinds = [prior.star_sensor if device.is_star else prior.reference for device in devices.values()]
        self.k: Factors = factors(config.integrity, [*kinds, prior.ins][: len(self.names)])
        self.limit = excess_limit(config.integrity, len(self.sources)) if self.sources else np.inf


def _own_states(model: ShipStateModel, source: str) -> NDArray[np.bool_]:
    """The states that belong to one source alone, shape (n,)."""
    own = np.zeros(model.size, dtype=bool)
    for name, rows in model.slices.items():
        own[rows] = name.startswith(f"{source}.")
    return own

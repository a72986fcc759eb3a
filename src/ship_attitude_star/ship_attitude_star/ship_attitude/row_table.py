"""The rows of hypotheses of a ship: what each of them leaves out, how probable that is, and what it owns.

The first row is by all sources that are not excluded; each other row does without one source more, and where that is
configured some do without two. Where the INS is left out it is the one that is wrong: its slow error is unknown there,
but its turn from one measurement to the next is used. A ship with a single source has no such row: it would be nothing
but that source.
"""

import itertools
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_estimation.common_error import common_threshold
from ship_estimation.parameters import ParameterError
from ship_estimation.protection import Factors, factors, prior_of_all
from ship_estimation.running_means import excess_limit

INS = "ins"

ALL_STARS = "all_stars"
"""The hypothesis of an error that all star sensors share."""

LEAST_FOR_PAIRS = 3
"""Sources beside the INS: without two of them one is left that the INS checks; without one and the INS, two."""


_LEAST_CHECKED = 2
"""Beside the INS: with fewer nothing checks the one that there is."""


class Asked(NamedTuple):
    """What an attitude that rests on some sources is held against.

    Attributes:
        hypotheses: numbers of those in question, shape (h,); the first one is that of the second row.
        names: theirs.
        check_one_another: whether its sources beside the INS do.
    """

    hypotheses: NDArray[np.intp]
    names: tuple[str, ...]
    check_one_another: bool


class RowTable:
    """The rows of a configuration.

    Args:
        config: the node's configuration.
        model: what the states are.
        devices: the sources by name.

    Attributes:
        sources: names, in the order of their index.
        stars: those that are star sensors.
        left_out: by each row after the first, names; ``ins`` where the INS is the one that is wrong.
        names: of the hypotheses, one for each row after the first: "star.bow", "star.bow+star.port".
        rows: how many there are, with the first.
        singles: the rows that leave out one source.
        pairs: those that leave out two.
        ins_rows: those where the INS is the one that is wrong.
        uses: which source each row uses where none is excluded, shape (h, s).
        users: by source, which row uses it where none is excluded, shape (h,).
        own: by source, the states that belong to it alone, shape (n,).
        learns: by source, which states each row may learn of it where none is excluded, shape (h, n).
        k: numbers of sigmas of the protection levels.
        common_missed: that of the estimate without the stars of late, for an error that all of them share.
        common_threshold: sigmas of their corrections beyond which all stars contradict the INS.
        limit: chi² of a mean of whitened turns that no source exceeds which is right.

    Raises:
        ParameterError: there are more rows than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        self.sources = tuple(devices)
        one = (*self.sources, INS) if len(self.sources) > 1 else self.sources
        with_pairs = config.integrity.pairs and len(self.sources) >= LEAST_FOR_PAIRS
        two = itertools.combinations(one, 2) if with_pairs else ()
        self.left_out: tuple[tuple[str, ...], ...] = (*((name,) for name in one), *two)
        self.names = tuple("+".join(names) for names in self.left_out)
        self.rows = len(self.names) + 1
        self._check_number(config.integrity.max_hypotheses)
        self.singles, self.pairs = range(1, len(one) + 1), range(len(one) + 1, self.rows)
        self.ins_rows = tuple(row for row, names in enumerate(self.left_out, start=1) if INS in names)
        used = [[name not in names for name in self.sources] for names in ((), *self.left_out)]
        self.uses: NDArray[np.bool_] = np.array(used, dtype=bool)
        self.users = {name: self.uses[:, index].copy() for index, name in enumerate(self.sources)}
        self.own = {name: _own_states(model, name) for name in self.sources}
        self.learns = {name: self.uses[:, index, None] | self.own[name] for index, name in enumerate(self.sources)}
        prior = config.integrity.prior_per_h
        prior_per_h = {name: prior.star_sensor if one.is_star else prior.reference for name, one in devices.items()}
        prior_per_h[INS] = prior.ins
        priors_per_h = [prior_of_all([prior_per_h[name] for name in names]) for names in self.left_out]
        k = factors(config.integrity, [*priors_per_h, prior.all_stars])
        self.k: Factors = replace(k, missed=k.missed[:-1])
        self.common_missed = float(k.missed[-1])
        self.common_threshold = common_threshold(config.integrity)
        self.stars = frozenset(name for name, one in devices.items() if one.is_star)
        self._asked: dict[tuple[tuple[str, ...], tuple[str, ...]], Asked] = {}
        self.limit = excess_limit(config.integrity, len(self.sources)) if self.sources else np.inf

    def pairs_in_question(self, in_use: Collection[str], excluded: Collection[str]) -> list[int]:
        """The rows without two of those in use, where two or more others in use are left to check each other.

        There are none while the INS is excluded: two pairs of sensors that contradict one another are alike then.

        Args:
            in_use: sources beside the INS.
            excluded: sources, or the INS, that no row uses.
        """
        if INS in excluded or len(in_use) < LEAST_FOR_PAIRS:
            return []
        everyone = {INS, *in_use}
        return [row for row in self.pairs if everyone.issuperset(self.left_out[row - 1])]

    def contradict_ins(self, in_use: Collection[str]) -> bool:
        """True if sources that agree with one another show that the INS is wrong.

        Star sensors alone do not: a wrong position or UTC, or wrong refraction, moves all of them alike.
        """
        return len(in_use) >= _LEAST_CHECKED and not self.stars.issuperset(in_use)

    def asked(self, sources: tuple[str, ...], excluded: Collection[str]) -> Asked:
        """What an attitude is held against; remembered, as most attitudes rest on the same sources.

        Args:
            sources: that it rests on, with the INS.
            excluded: sources, or the INS, that no row uses.
        """
        key = sources, tuple(excluded)
        if key not in self._asked:
            self._asked[key] = self._held_against(sources, excluded)
        return self._asked[key]

    def _held_against(self, sources: Collection[str], excluded: Collection[str]) -> Asked:
        others = [name for name in sources if name in self.sources and name not in excluded]
        hypotheses = [row - 1 for row in self.singles if self.names[row - 1] not in excluded]
        hypotheses += [row - 1 for row in self.pairs_in_question(others, excluded)]
        names = tuple(self.names[number] for number in hypotheses)
        check_one_another = len(others) >= _LEAST_CHECKED and not self.stars.isdisjoint(others)
        return Asked(np.array(hypotheses, dtype=np.intp), names, check_one_another)

    def _check_number(self, most: int) -> None:
        if self.rows > most:
            reason = f"parameter 'integrity.max_hypotheses' = {most} is less than the {self.rows} of these sources: "
            reason += ", ".join(self.names)
            if len(self.left_out[-1]) > 1:
                reason += f"; set it to {self.rows}, or 'integrity.pairs' to false"
            raise ParameterError(reason, "integrity.max_hypotheses", value=most)


def _own_states(model: ShipStateModel, source: str) -> NDArray[np.bool_]:
    """The states that belong to one source alone, shape (n,)."""
    own = np.zeros(model.size, dtype=bool)
    for name, rows in model.slices.items():
        own[rows] = name.startswith(f"{source}.")
    return own

"""The main filter of a ship, and its subfilters, which each exclude one source or two sources.

The main filter uses all sources that are not excluded. Each subfilter excludes one more source; with
``integrity.pairs`` some subfilters exclude two sources. A subfilter without the INS treats the correlated error of the
INS as unknown, and still uses the change of the INS attitude between measurements. A ship with a single source besides
the INS has no subfilter without the INS.
"""

import itertools
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.measurements.kind import Device
from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_estimation.fault_detection.common_error import common_threshold
from ship_estimation.fault_detection.subfilter_table import SubfilterTable
from ship_estimation.integrity.protection_levels import SigmaMultipliers, sigma_multipliers
from ship_estimation.parameters.schema import ParameterError

INS = "ins"

ALL_STARS = "all_stars"
"""Name of the hypothesis of an error that all star sensors share."""

MIN_SOURCES_FOR_PAIRS = 3
"""Minimum number of sources besides the INS for subfilters without two sources.

A subfilter without two of three sources uses the third source and the INS, which check each other. A subfilter without
one of three sources and the INS uses the two other sources.
"""


_MIN_FOR_CROSS_CHECK = 2
"""Minimum number of sources besides the INS that check one another."""


class RelevantHypotheses(NamedTuple):
    """Fault hypotheses of an attitude that is computed from some of the sources.

    Attributes:
        indices: indices of the hypotheses, shape (h,); index 0 is the first subfilter.
        names: names of the hypotheses.
        is_cross_checked: True if at least two sources of the attitude besides the INS are in use, one of them a star
            sensor.
    """

    indices: NDArray[np.intp]
    names: tuple[str, ...]
    is_cross_checked: bool


class ShipSubfilters(SubfilterTable):
    """The h filters of a configuration (the main filter first), for s sources of n states.

    Args:
        config: configuration of the node.
        model: state vector.
        devices: sources by name.

    Attributes:
        stars: names of the star sensors.
        ins_subfilters: indices of the subfilters that exclude the INS.
        used_by: for each source, True for the filters that use the source, if no source is excluded, shape (h,).
        own_states: for each source, True for the states that belong to the source alone, shape (n,).
        updatable_states: for each source, True for the states that each filter updates with measurements of the source,
            if no source is excluded, shape (h, n).
        k: sigma multipliers K of the protection levels.
        common_k_md: multiplier K_md (missed detection) for the hypothesis of an error that all star sensors share.
        common_threshold: threshold of the sum of the star corrections, in standard deviations; above this threshold all
            stars contradict the INS.

    Raises:
        ParameterError: there are more filters than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        one = (*devices, INS) if len(devices) > 1 else tuple(devices)
        with_pairs = config.integrity.pairs and len(devices) >= MIN_SOURCES_FOR_PAIRS
        two = itertools.combinations(one, 2) if with_pairs else ()
        prior = config.integrity.prior_per_h
        prior_per_h = {name: prior.star_sensor if one.is_star else prior.reference for name, one in devices.items()}
        prior_per_h[INS] = prior.ins
        super().__init__(tuple(devices), (*((name,) for name in one), *two), prior_per_h, config.integrity)
        self._check_count(config.integrity.max_hypotheses)
        self.ins_subfilters = tuple(row for row, names in enumerate(self.excluded_sources, start=1) if INS in names)
        self.used_by = {name: self.uses[:, index].copy() for index, name in enumerate(self.sources)}
        self.own_states = {name: _own_states(model, name) for name in self.sources}
        self.updatable_states = {
            name: self.uses[:, index, None] | self.own_states[name] for index, name in enumerate(self.sources)
        }
        k = sigma_multipliers(config.integrity, [*self.priors_per_h, prior.all_stars])
        self.k: SigmaMultipliers = replace(k, missed_detection=k.missed_detection[:-1])
        self.common_k_md = float(k.missed_detection[-1])
        self.common_threshold = common_threshold(config.integrity)
        self.stars = frozenset(name for name, one in devices.items() if one.is_star)
        self._relevant: dict[tuple[tuple[str, ...], tuple[str, ...]], RelevantHypotheses] = {}

    def relevant_pairs(self, in_use: Collection[str], excluded: Collection[str]) -> list[int]:
        """Return the subfilters that exclude two sources in use; none for fewer than three sources besides the INS.

        The result is empty while the INS is excluded: if two pairs of sensors contradict each other without the INS,
        neither pair is isolated as faulty.

        Args:
            in_use: sources in use, without the INS.
            excluded: names of the excluded sources, the INS included.
        """
        if INS in excluded or len(in_use) < MIN_SOURCES_FOR_PAIRS:
            return []
        sources = {INS, *in_use}
        return [row for row in self.pair_subfilters if sources.issuperset(self.excluded_sources[row - 1])]

    def can_show_ins_fault(self, in_use: Collection[str]) -> bool:
        """True if two or more sources are in use and at least one of them is not a star sensor.

        Star sensors alone cannot show a fault of the INS, because an error of position, UTC or refraction rotates all
        star sensors equally.
        """
        return len(in_use) >= _MIN_FOR_CROSS_CHECK and not self.stars.issuperset(in_use)

    def relevant_hypotheses(self, sources: tuple[str, ...], excluded: Collection[str]) -> RelevantHypotheses:
        """Return the fault hypotheses of an attitude; results are cached.

        Args:
            sources: sources of the attitude, the INS included.
            excluded: names of the excluded sources, the INS included.
        """
        key = sources, tuple(excluded)
        if key not in self._relevant:
            self._relevant[key] = self._find_relevant(sources, excluded)
        return self._relevant[key]

    def _find_relevant(self, sources: Collection[str], excluded: Collection[str]) -> RelevantHypotheses:
        others = [name for name in sources if name in self.sources and name not in excluded]
        hypotheses = [row - 1 for row in self.single_subfilters if self.names[row - 1] not in excluded]
        hypotheses += [row - 1 for row in self.relevant_pairs(others, excluded)]
        names = tuple(self.names[number] for number in hypotheses)
        is_cross_checked = len(others) >= _MIN_FOR_CROSS_CHECK and not self.stars.isdisjoint(others)
        return RelevantHypotheses(np.array(hypotheses, dtype=np.intp), names, is_cross_checked)

    def _check_count(self, most: int) -> None:
        if self.count > most:
            reason = f"parameter 'integrity.max_hypotheses' = {most} is less than the {self.count} for these sources: "
            reason += ", ".join(self.names)
            if len(self.excluded_sources[-1]) > 1:
                reason += f"; set it to {self.count}, or 'integrity.pairs' to false"
            raise ParameterError(reason, "integrity.max_hypotheses", value=most)


def _own_states(model: ShipStateModel, source: str) -> NDArray[np.bool_]:
    """Return a mask of the states that belong to one source alone, shape (n,)."""
    own = np.zeros(model.size, dtype=bool)
    for name, rows in model.slices.items():
        own[rows] = name.startswith(f"{source}.")
    return own

"""Table of the filters: sources that each filter uses and excludes, with the fault rates of the hypotheses."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.innovation_means import excess_limit
from ship_estimation.integrity.protection_levels import IntegrityConfig, joint_prior_per_h


class SubfilterTable:
    """The h filters, the main filter first, and the s measured sources.

    Args:
        sources: names of the measured sources, in the order of their index.
        excluded_sources: names of the sources that each subfilter excludes; subfilters without one source come first.
            A source that is not measured itself, such as an INS, appears here only.
        prior_per_h: fault rate of each source, 1/h.
        config: probability of a false exclusion.

    Attributes:
        sources: names of the measured sources.
        indices: index of each measured source.
        excluded_sources: names of the sources that each subfilter excludes.
        names: name of the hypothesis of each subfilter, for example "star.bow" or "star.bow+star.port".
        count: number of filters, h.
        single_subfilters: indices of the subfilters that exclude one source.
        pair_subfilters: indices of the subfilters that exclude two sources.
        uses: True where a filter uses a source, if no source is excluded, shape (h, s).
        priors_per_h: fault rate of each hypothesis, 1/h.
        innovation_mean_limit: chi² limit of a windowed mean of whitened innovations.

    Example:
        >>> stars, prior_per_h = ("aft", "fore"), {"aft": 1e-3, "fore": 1e-3, "ins": 1e-4}
        >>> table = SubfilterTable(stars, (("aft",), ("fore",), ("ins",)), prior_per_h, IntegrityConfig())
        >>> table.uses.tolist(), table.subfilter_of("ins")
        ([[True, True], [False, True], [True, False], [True, True]], 3)
    """

    def __init__(
        self,
        sources: Sequence[str],
        excluded_sources: Sequence[tuple[str, ...]],
        prior_per_h: Mapping[str, float],
        config: IntegrityConfig,
    ) -> None:
        self.sources, self.excluded_sources = tuple(sources), tuple(excluded_sources)
        self.indices = {name: index for index, name in enumerate(self.sources)}
        self.names = tuple("+".join(names) for names in self.excluded_sources)
        self.count = len(self.names) + 1
        singles = sum(len(names) == 1 for names in self.excluded_sources)
        self.single_subfilters, self.pair_subfilters = range(1, singles + 1), range(singles + 1, self.count)
        used = [[name not in names for name in self.sources] for names in ((), *self.excluded_sources)]
        self.uses: NDArray[np.bool_] = np.array(used, dtype=bool)
        by_hypothesis = [[prior_per_h[name] for name in names] for names in self.excluded_sources]
        self.priors_per_h = [joint_prior_per_h(priors_per_h) for priors_per_h in by_hypothesis]
        self.innovation_mean_limit = excess_limit(config, max(len(self.sources), 1))

    def subfilter_of(self, name: str) -> int:
        """Return the index of the subfilter of a hypothesis."""
        return 1 + self.names.index(name)

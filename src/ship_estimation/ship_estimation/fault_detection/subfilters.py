"""Main filter, which uses all sources, and subfilters, each without one or more sources; all are updated together.

:class:`SubfilterTable` lists the sources that each filter uses and excludes, with the fault rates of the hypotheses.

The innovations of a measurement are computed for all filters at once. A subfilter that excludes the source of a
measurement updates only the states that belong to that source alone, such as its installation. The other states and
their covariance are, to the last digit, the same as in a filter without the source. The subfilter therefore monitors
the source that it excludes, and the mounting of that source is known when the source is reinstated.

The main filter keeps its covariance by error source; each subfilter keeps one matrix. All matrices are kept in one
stack, first the n_sources parts of the main filter, then the covariances of the h - 1 subfilters. Main filter,
subfilter and solution separation are terms of ARAIM (Blanch et al. 2015, see
:mod:`ship_estimation.integrity.protection_levels`).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.isolation import excess_limit
from ship_estimation.integrity.protection_levels import (
    LEAST_SHARE,
    LEAST_VARIANCE_RAD2,
    IntegrityConfig,
    joint_prior_per_h,
)
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_kalman


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


class FilterInnovations(NamedTuple):
    """Innovations of a measurement of m components in h filters of n states, the main filter first.

    Attributes:
        residual: measured minus predicted by each filter, shape (h, m).
        covariance: innovation covariance, shape (h, m, m).
        nis: normalised innovation squared, shape (h,).
        gain: Kalman gain, shape (h, n, m).
        whitened_innovation: whitened innovation as a rotation vector of the device (least squares), shape (h, 3). Its
            covariance is the unit matrix if the filter is consistent.
        whitened_noise: covariance of the main filter's whitened innovation due to the measurement noise alone,
            shape (3, 3). The rest of the unit matrix is due to the state.
        whitening_root: square root of the covariance of the rotation vector, rad, shape (h, 3, 3). The rotation vector
            is ``whitening_root @ whitened_innovation``.
    """

    residual: FloatArray
    covariance: FloatArray
    nis: FloatArray
    gain: FloatArray
    whitened_innovation: FloatArray
    whitened_noise: FloatArray
    whitening_root: FloatArray


def filter_covariances(stack: FloatArray, filter_count: int) -> FloatArray:
    """Return the covariance of each of h filters, shape (h, n, n), from their stack.

    Example:
        The main filter has two parts, 1 and 2; the subfilter has 5:

        >>> print(filter_covariances(np.array([[[1.0]], [[2.0]], [[5.0]]]), filter_count=2).ravel())
        [3. 5.]
    """
    found: FloatArray = compiled_kalman.filter_covariances(np.ascontiguousarray(stack), filter_count)
    return found


def add_error(
    stack: FloatArray,
    filter_count: int,
    source_index: int,
    states: slice,
    covariance: FloatArray,
    subfilter: int | None = None,
) -> None:
    """Inflate the covariance of some states, in place, in all filters or in one subfilter.

    Args:
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        filter_count: number of filters, h.
        source_index: error source to which the added covariance belongs in the main filter.
        states: slice of the k states.
        covariance: added covariance, shape (k, k).
        subfilter: index of the subfilter, from 1 on; None for all filters.

    Example:
        >>> stack = np.zeros((3, 1, 1))  # two parts of the main filter, and a subfilter
        >>> add_error(stack, 2, source_index=1, states=slice(0, 1), covariance=np.array([[4.0]]))
        >>> print(stack.ravel())
        [0. 4. 4.]
    """
    first = states.indices(stack.shape[-1])[0]
    compiled_kalman.add_error(stack, filter_count, source_index, first, covariance, subfilter or 0)


def solution_separations(means: FloatArray, stack: FloatArray, states: slice) -> tuple[FloatArray, FloatArray]:
    """Return the solution separations of the filters from the main filter in k states.

    The standard deviations of the separations are as in
    :func:`ship_estimation.integrity.protection_levels.separation_sigma`. The test statistic of a filter is NaN if one
    of its separations is NaN.

    Args:
        means: states of each filter, shape (h, n).
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        states: slice of the k states.

    Returns:
        Separations, shape (h, k), and the test statistic of each filter, its largest separation in sigmas, shape (h,).

    Example:
        A subfilter of variance 13 is separated by six from the main filter, whose two parts are 1 and 3:

        >>> stack = np.array([1.0, 3.0, 13.0])[:, None, None]
        >>> separations, sigmas = solution_separations(np.array([[0.0], [6.0]]), stack, slice(0, 1))
        >>> print(separations.ravel(), sigmas)
        [0. 6.] [0. 2.]
    """
    first, end, _ = states.indices(means.shape[1])
    found: tuple[FloatArray, FloatArray] = compiled_kalman.solution_separations(
        means, stack, first, end - first, LEAST_SHARE, LEAST_VARIANCE_RAD2
    )
    return found


def are_consistent(means: FloatArray, stack: FloatArray, states: slice, threshold_sigmas: float) -> bool:
    """True if no solution separation (:func:`solution_separations`) exceeds ``threshold_sigmas``; false for NaN.

    Example:
        >>> stack = np.array([1.0, 3.0, 13.0])[:, None, None]
        >>> are_consistent(np.array([[0.0], [6.0]]), stack, slice(0, 1), threshold_sigmas=1.9)
        False
    """
    first, end, _ = states.indices(means.shape[1])
    is_separated: bool = compiled_kalman.exceeds_separation(
        means, stack, first, end - first, LEAST_SHARE, LEAST_VARIANCE_RAD2, threshold_sigmas
    )
    return not is_separated


def restart_from_subfilter(stack: FloatArray, filter_count: int, subfilter: int) -> FloatArray:
    """Return the stack with all filters restarted from one subfilter.

    A subfilter has no covariance by error source. A linear map transforms the covariance of the main filter to that of
    the subfilter, and the same map transforms each part. The sum of the parts is exact, their shares are approximate.

    Args:
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        filter_count: number of filters, h.
        subfilter: index of the subfilter, from 1 on.

    Example:
        >>> stack = np.array([[[1.0]], [[3.0]], [[8.0]]])  # parts of 1 and 3, and a subfilter of 8
        >>> print(restart_from_subfilter(stack, 2, subfilter=1).ravel())
        [2. 6. 8.]
    """
    both = filter_covariances(stack, filter_count)[[0, subfilter]]
    sigma = np.sqrt(np.diagonal(both[0]))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(both / (scale[:, None] * scale))
    root = np.sqrt(np.maximum(values, 0.0))
    inverse = np.where(root[0] > 1e-7 * root[0, -1], 1.0 / np.where(root[0] > 0.0, root[0], 1.0), 0.0)
    to_subfilter = (vectors[1] * root[1]) @ vectors[1].T @ (vectors[0] * inverse) @ vectors[0].T
    to_subfilter = scale[:, None] * to_subfilter / scale
    parts = to_subfilter @ stack[: len(stack) - filter_count + 1] @ to_subfilter.T
    # Rounding must not give a variance to states that are known exactly.
    parts[:, sigma == 0.0, :] = parts[:, :, sigma == 0.0] = 0.0
    parts[np.argmax(np.trace(parts, axis1=-2, axis2=-1))] += both[1] - parts.sum(axis=0)
    return np.concatenate([parts, np.tile(both[1], (filter_count - 1, 1, 1))])


def subfilter_innovations(
    means: FloatArray,
    stack: FloatArray,
    measurement: LinearMeasurement,
    linearisation_mean: FloatArray,
    rotation_jacobian: FloatArray,
) -> FilterInnovations:
    """Return the innovations of a measurement in the main filter and all subfilters.

    Args:
        means: predicted states, shape (h, n).
        stack: covariances of the filters, shape (n_sources + h - 1, n, n).
        measurement: measurement linearised at the state ``linearisation_mean``.
        linearisation_mean: state of the linearisation, shape (n,).
        rotation_jacobian: derivative of the residual with respect to a rotation vector of the device, shape (m, 3).

    Raises:
        numpy.linalg.LinAlgError: an innovation covariance is not positive definite.

    Example:
        One state has sigma 3 in the main filter (two parts) and 4 in the subfilter. The state is predicted as 0 and 5,
        and measured as 10 with sigma 4:

        >>> stack = np.array([[[5.0]], [[4.0]], [[16.0]]])
        >>> measured = LinearMeasurement(np.array([10.0]), np.array([[1.0]]), {0: np.array([[16.0]])})
        >>> means, by_rotation = np.array([[0.0], [5.0]]), np.array([[1.0, 0.0, 0.0]])
        >>> found = subfilter_innovations(means, stack, measured, np.array([0.0]), by_rotation)
        >>> print(found.nis, found.gain.ravel())
        [4.      0.78125] [0.36 0.5 ]
    """
    found = compiled_kalman.innovations(
        means,
        stack,
        measurement.residual,
        measurement.jacobian,
        measurement.noise,
        linearisation_mean,
        rotation_jacobian,
    )
    return FilterInnovations(*found)


def update_subfilters(
    stack: FloatArray, measurement: LinearMeasurement, innovations: FilterInnovations, updated_states: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return the corrections, shape (h, n), and the stack of covariances after a measurement update of all filters.

    The update has Joseph's form, which is valid for any gain. A state that is not updated has a gain of zero.

    Args:
        stack: covariances of the filters before the measurement, shape (n_sources + h - 1, n, n).
        measurement: the measurement.
        innovations: innovations of the measurement, from :func:`subfilter_innovations`.
        updated_states: True for each state that a filter updates, shape (h, n); all False if the filter rejects the
            measurement.

    Example:
        The sum of two states of variance 4 is measured with sigma 1. The subfilter updates only the second state. The
        variance of the first state stays, and the two states become correlated:

        >>> stack = np.tile(4.0 * np.eye(2), (2, 1, 1))
        >>> measured = LinearMeasurement(np.array([9.0]), np.array([[1.0, 1.0]]), {0: np.array([[1.0]])})
        >>> found = subfilter_innovations(np.zeros((2, 2)), stack, measured, np.zeros(2), np.array([[1.0, 0.0, 0.0]]))

        >>> corrections, after = update_subfilters(stack, measured, found, np.array([[True, True], [False, True]]))
        >>> print(corrections, after[1].round(3).tolist())
        [[4. 4.]
         [0. 4.]] [[4.0, -1.778], [-1.778, 2.222]]
    """
    corrections, updated = compiled_kalman.update(
        np.ascontiguousarray(stack),
        measurement.jacobian,
        innovations.residual,
        innovations.gain,
        updated_states.view(np.uint8),
        measurement.noise_parts,
        measurement.noise,
    )
    return corrections, updated

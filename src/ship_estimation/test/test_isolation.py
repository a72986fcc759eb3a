"""Fault isolation: two to four sensors on a shaken base, with a mounting shift of one or two of them."""

import copy
import functools
import itertools

import numpy as np
import pytest

from ship_estimation.fault_detection.exclusion import ExcludedSource, evaluate_reinstatement
from ship_estimation.fault_detection.isolation import (
    cleared_means,
    excess_limit,
    initial_means,
    isolate_fault,
    updated_means,
)
from ship_estimation.fault_detection.subfilters import subfilter_innovations, update_subfilters
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_geometry.earth.time_scales import SECOND_NS

NOISE, WALK, MOUNTING = 3.0, 0.3, 20.0


class FilterBank:
    """An angle about each axis with a random walk, measured by sensors whose mounting is estimated.

    The subfilters leave out each sensor and, with ``pairs``, each pair of sensors.
    """

    def __init__(self, sensors, pairs=False):
        self.sensors, size = sensors, 3 * (sensors + 1)
        one = [(sensor,) for sensor in range(sensors)]
        self.left_out = [(), *one, *(itertools.combinations(range(sensors), 2) if pairs else ())]
        self.uses = np.array([[sensor not in out for sensor in range(sensors)] for out in self.left_out])
        filters = len(self.left_out)
        self.means = np.zeros((filters, size))
        prior = np.diag(np.repeat([10.0, *[MOUNTING] * sensors], 3) ** 2)
        self.stack = np.tile(prior, (filters, 1, 1))
        self.seen, self.limit = initial_means(filters, sensors), excess_limit(IntegrityConfig(), sensors)

    def add(self, sensor, residual, time_ns):
        jacobian = np.zeros((3, self.means.shape[1]))
        jacobian[:, :3] = jacobian[:, 3 * sensor + 3 : 3 * sensor + 6] = np.eye(3)
        self.stack[:, range(3), range(3)] += WALK**2
        measured = LinearMeasurement(residual, jacobian, {0: NOISE**2 * np.eye(3)})
        compared = subfilter_innovations(self.means, self.stack, measured, np.zeros(self.means.shape[1]), np.eye(3))
        accepted, left = compared.nis < 21.1, ~self.uses[:, sensor]
        own = np.isin(np.arange(self.means.shape[1]), range(3 * sensor + 3, 3 * sensor + 6))
        learns = np.where(left[:, None], own, True) & accepted[:, None] & np.any(accepted & ~left)
        correction, self.stack = update_subfilters(self.stack, measured, compared, learns)
        self.means = self.means + correction
        self.seen = updated_means(self.seen, sensor, compared.whitened_innovation, accepted, time_ns, self.limit)

    def isolation(self, time_ns):
        separation = self.means[1:, :3] - self.means[0, :3]
        total = self.stack[:, range(3), range(3)]
        statistic = np.max(np.abs(separation) / np.sqrt(np.maximum(total[1:] - total[0], 1e-6 * total[0])), axis=-1)
        one, two = range(1, self.sensors + 1), range(self.sensors + 1, len(self.left_out))
        return isolate_fault(
            self.seen, self.uses, np.concatenate([[0.0], statistic]), 5.1, one, time_ns, larger_subfilters=two
        )


AT = 200
"""Epoch of the mounting shifts."""


class Base:
    """A shaken base with sensors, from the first epoch on."""

    def __init__(self, seed, sensors, pairs):
        self.rng, self.bank, self.epoch = np.random.default_rng(seed), FilterBank(sensors, pairs), 0
        self.mounting = MOUNTING * self.rng.standard_normal((sensors, 3))
        self.angle = 10.0 * self.rng.standard_normal(3)

    def isolations_until(self, epoch, shifts):
        """Yield the fault isolation of each measurement before an epoch, with its epoch."""
        while self.epoch < epoch:
            for sensor, mounting in enumerate(self.mounting):
                self.angle = self.angle + WALK * self.rng.standard_normal(3)
                wrong = shifts.get(sensor, 0.0) * np.array([0.0, 1.0, 0.0])
                measured = self.angle + mounting + wrong + NOISE * self.rng.standard_normal(3)
                self.bank.add(sensor, measured, self.epoch * SECOND_NS // 5)
                yield self.epoch, self.bank.isolation(self.epoch * SECOND_NS // 5)
            self.epoch += 1


@functools.cache
def _before_shifts(seed, sensors, pairs):
    """Return the base at AT, without a detected fault; the base is the same for all shifts."""
    base = Base(seed, sensors, pairs)
    assert not any(found.is_detected for _, found in base.isolations_until(AT, {}))
    return base


def _voyage(seed, sensors, shifts=None, epochs=2 * AT, pairs=False):
    """Return the epochs from the shifts to a detected fault, and the sensors isolated first, None if not isolated.

    The result is None without a detected fault.

    Args:
        seed: seed of the noise.
        sensors: number of sensors.
        shifts: mounting shift of each sensor about the second axis, from AT on.
        epochs: number of measurements of each sensor.
        pairs: True to add subfilters that leave out two sensors.
    """
    base, detected_at = copy.deepcopy(_before_shifts(seed, sensors, pairs)), None
    for epoch, found in base.isolations_until(epochs, shifts or {}):
        detected_at = epoch - AT if found.is_detected and detected_at is None else detected_at
        if found.subfilter is not None:
            return detected_at, base.bank.left_out[found.subfilter]
    return None if detected_at is None else (detected_at, None)


@pytest.mark.parametrize("sensors", [2, 3])
def test_fault_free_sources_are_not_excluded(sensors):
    assert [_voyage(seed, sensors, epochs=1000) for seed in range(3)] == [None] * 3


@pytest.mark.parametrize("sensor", [0, 2])
@pytest.mark.parametrize("shift", [30.0, 60.0, -60.0])
def test_shift_of_ten_sigmas_is_isolated_within_three_measurements(shift, sensor):
    found = [_voyage(seed, 3, {sensor: shift}) for seed in range(8)]
    assert [named for _, named in found] == [(sensor,)] * 8
    assert max(epochs for epochs, _ in found) <= 3


def test_small_shifts_are_isolated_within_seconds():
    """Shifts of 4 σ of one measurement: no single innovation detects them, but the mean of several innovations does."""
    found = [_voyage(seed, 3, {1: 12.0}) for seed in range(8)]
    assert [named for _, named in found] == [(1,)] * 8
    assert max(epochs for epochs, _ in found) <= 50


def test_fault_of_one_of_two_sensors_is_isolated_by_the_motion_of_the_base():
    found = [_voyage(seed, 2, {seed % 2: 40.0}) for seed in range(8)]
    assert [named for _, named in found] == [(seed % 2,) for seed in range(8)]


@pytest.mark.parametrize("sensors", [3, 4])
@pytest.mark.parametrize("shifts", [(40.0, 40.0), (40.0, -60.0), (25.0, 1e4)])
def test_simultaneous_shifts_of_two_sensors_are_isolated_with_subfilters_of_pairs(sensors, shifts):
    both = dict(zip((0, 2), shifts, strict=True))
    found = [_voyage(seed, sensors, both, pairs=True) for seed in range(4)]
    assert [named for _, named in found] == [(0, 2)] * 4
    assert max(epochs for epochs, _ in found) <= 3
    # Without such subfilters the faults are detected but not isolated.
    assert _voyage(0, sensors, both)[1] is None


@pytest.mark.parametrize("shift", [12.0, 30.0, 1e4])
def test_single_fault_is_preferred_over_pairs(shift):
    """The subfilter without a pair explains every fault that the subfilter without one source of the pair explains."""
    assert [_voyage(seed, 4, {1: shift}, pairs=True)[1] for seed in range(4)] == [(1,)] * 4


def test_with_pairs_fault_free_sources_are_not_excluded():
    assert [_voyage(seed, 4, epochs=1000, pairs=True) for seed in range(2)] == [None] * 2


def test_pair_subfilter_is_tested_if_no_single_one_explains_the_fault_or_if_it_separates_most():
    uses = np.array([[True] * 3, [False, True, True], [True, False, True], [False, False, True]])
    seen = initial_means(4, 3)
    seen.last_measured_ns[:], seen.excess[:2, 1], seen.excess[2, 0] = 0, [3.0, 2.0], 0.8
    # Filter 2, the subfilter without the second source, is consistent: it may still explain the fault.
    assert isolate_fault(seen, uses, np.zeros(4), 5.0, [1, 2], 0, larger_subfilters=[3]).subfilter is None
    seen.excess[2, 0] = 1.1
    assert isolate_fault(seen, uses, np.zeros(4), 5.0, [1, 2], 0, larger_subfilters=[3]).subfilter == 3
    agrees = initial_means(4, 3)
    agrees.last_measured_ns[:] = 0
    for far, expected in ((6.0, 3), (5.2, None)):
        # The separations of the subfilters without one source are nearly equal and below the threshold.
        assert (
            isolate_fault(agrees, uses, np.array([0.0, 4.5, 4.4, far]), 5.0, [1, 2], 0, larger_subfilters=[3]).subfilter
            == expected
        )


def test_separation_isolates_nothing_after_a_rejection():
    """The main filter has not used a measurement that a subfilter used: the covariances do not bound the separation."""
    uses = np.array([[True, True], [False, True], [True, False]])
    seen = initial_means(3, 2)
    seen.last_measured_ns[:] = 0
    separation = np.array([0.0, 2000.0, 4.0])
    assert isolate_fault(seen, uses, separation, 5.0, [1, 2], 0).subfilter == 1
    seen.rejection_counts[0, 1] = 1
    found = isolate_fault(seen, uses, separation, 5.0, [1, 2], 0)
    assert (found.is_detected, found.subfilter) == (True, None)
    # Rejections of a source that the main filter does not use have no effect.
    assert isolate_fault(seen, uses & [True, False], separation, 5.0, [1, 2], 0).subfilter == 1


def test_single_gross_error_excludes_no_source():
    bank, rng = FilterBank(3), np.random.default_rng(8)
    for epoch in range(100):
        for sensor in range(3):
            wrong = 1e6 if (sensor, epoch) == (1, 50) else 0.0
            bank.add(sensor, NOISE * rng.standard_normal(3) + wrong, epoch * SECOND_NS)
            assert not bank.isolation(epoch * SECOND_NS).is_detected


def test_nan_is_inconsistent():
    means = initial_means(2, 1)
    means.excess[0, 0], means.last_measured_ns[0] = np.nan, 0
    uses = np.array([[True], [False]])
    assert isolate_fault(means, uses, np.zeros(2), 5.0, [1], 0).is_detected
    assert isolate_fault(initial_means(2, 1), uses, np.array([0.0, np.nan]), 5.0, [1], 0).is_detected


@pytest.mark.parametrize("after", [2, 6])
def test_successive_rejections_make_a_filter_inconsistent_without_a_mean(after):
    uses = np.array([[True, True], [False, True], [True, False]])

    def isolation_after(by_all, by_second):
        seen = initial_means(3, 2)
        seen.last_measured_ns[:], seen.excess[:, 0], seen.rejection_counts[[0, 2], 0] = (
            0,
            [0.9, 0.0, 0.3],
            [by_all, by_second],
        )
        return isolate_fault(seen, uses, np.zeros(3), 5.0, [1, 2], 0, after)

    assert not isolation_after(after - 1, after).is_detected
    assert isolation_after(after, after).subfilter == 1
    # The subfilter that uses the same source is consistent: it may still be the fault-free one.
    assert (isolation_after(after, after - 1).is_detected, isolation_after(after, after - 1).subfilter) == (True, None)


def test_source_is_reinstated_after_an_unbroken_time_of_consistency():
    means, exclusion = initial_means(1, 1), ExcludedSource(since_ns=0)
    for second in range(30):
        exclusion, back = evaluate_reinstatement(exclusion, means, 0, second * SECOND_NS, 60.0)
        assert not back
    means.excess[0, 0] = 0.6
    exclusion, _ = evaluate_reinstatement(exclusion, means, 0, 30 * SECOND_NS, 60.0)
    means = cleared_means(means, slice(None), [0])
    for second in range(31, 91):
        exclusion, back = evaluate_reinstatement(exclusion, means, 0, second * SECOND_NS, 60.0)
        assert not back
    assert evaluate_reinstatement(exclusion, means, 0, 91 * SECOND_NS, 60.0)[1]


def test_source_without_mounting_shift_is_reinstated_when_its_offset_has_vanished():
    """The time of 60 s begins when the mean over 20 measurements is below 0.5, after ln(2) 21/2 = 7 measurements."""
    means, exclusion = initial_means(1, 1), ExcludedSource(since_ns=0, offset=np.array([0.0, 30.0, 0.0]))
    for second in range(200):
        share = 1.0 if second < 100 else 0.07
        exclusion, back = evaluate_reinstatement(exclusion, means, 0, second * SECOND_NS, 60.0, share)
        if back:
            break
    assert 160 + 6 <= second <= 160 + 8


@pytest.mark.parametrize("gross", [np.nan, np.inf, -1e6, 1e6])
def test_gross_error_delays_a_reinstatement_by_some_measurements_only(gross):
    """After eight gross errors the mean over 20 is 1.1, and after eight correct measurements 0.5 again."""
    exclusion, agreed = ExcludedSource(since_ns=0, offset=np.array([0.0, 30.0, 0.0]), remaining_offset_ratio=0.0), []
    for second, share in enumerate([gross] * 8 + [0.0] * 14):
        exclusion, _ = evaluate_reinstatement(exclusion, initial_means(1, 1), 0, second * SECOND_NS, 60.0, share)
        agreed.append(exclusion.consistent_since_ns is not None)
    assert not any(agreed[3:14])
    assert all(agreed[17:])

"""Accuracy of the pointing with beacons at given positions, from the calibration filter's model before any sighting.

The covariance after the filter's first update by one sighting is computed. P is the configured covariance of states,
with the stated covariance of the ship's attitude. H and R are Jacobian and noise of the sighting
(:mod:`theodolite_calib.filter.prediction`). T is the derivative of the main axis' rotation vector with respect to the
states. The pointing has

    C = T (P - P Hᵀ (H P Hᵀ + R/n)⁻¹ H P) Tᵀ + noise of the encoders and of the ship at a reading

where n is the number of exposures over which white errors are averaged (``escort.exposures``).

Previous updates of the filter are not used. With previous updates the errors of a beacon observed for long would be
partly known. Every move would then seem a gain, and the advice would never settle.
"""

from collections.abc import Mapping

import numpy as np

from ship_estimation.kalman.kalman_filter import LinearMeasurement, innovation, update
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import Image
from ship_geometry.mount.line_of_sight import BeaconPoses
from ship_geometry.rotations import FloatArray
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.prediction import Prediction
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.samples.tracks import EncoderAt, ShipAt

_ANYWHERE_M = 1000.0


class BeaconAccuracy:
    """Accuracy of the pointing with beacons at given positions, for one pose of ship and theodolite.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        ship: ship's attitude.
        encoder: encoders.
        mean: estimated errors, shape (n,); zero if not given.
        baseline_noise_n: covariance of the white error of each baseline, m², shape (3, 3), by the drone's name; drones
            that are missing here have the configured noise.

    Attributes:
        rotation_nt: horizon from telescope, shape (3, 3).
        rotation_nm: horizon from main frame, shape (3, 3).
        centre_n: vector from the ship's antenna to the intersection of the theodolite's axes, m, shape (3,).
    """

    def __init__(
        self,
        config: OpticalAxisConfig,
        filter_: CalibrationFilter,
        ship: ShipAt,
        encoder: EncoderAt,
        mean: FloatArray | None = None,
        baseline_noise_n: Mapping[str, FloatArray] | None = None,
    ) -> None:
        self._config, self._filter, self._ship, self._encoder = config, filter_, ship, encoder
        self._exposures = config.escort.exposures
        configured_n = {name: beacon.rtk.sigma_m**2 * np.eye(3) for name, beacon in config.beacons.items()}
        self._noise_n = configured_n | dict(baseline_noise_n or {})
        start = filter_.propagate(filter_.initial_state(), 0, ship.correlated_covariance_n)
        self._mean = start.mean if mean is None else mean
        self._parts, self._covariance = start.covariance_by_source, start.covariance
        self._parallelism = filter_.model.slices["parallelism"]
        self.centre_n: FloatArray = ship.rotation_nd @ config.lever.vector_m
        # The pose of telescope and main axis does not depend on the position of the beacon, so any position is used.
        anywhere_n = self.centre_n + np.array([[_ANYWHERE_M, 0.0, 0.0]])
        prediction = self._predict(tuple(config.beacons)[:1], anywhere_n)
        self.rotation_nt = prediction.rotation_nt
        parallelism = filter_.sightings.parallelism(self._mean)
        self.rotation_nm: FloatArray = prediction.rotation_nt @ rotation_from_angles(*parallelism)
        main, by_noise_n = self._main_axis(prediction)
        self._without_beacons_n = main @ self._covariance @ main.T + by_noise_n

    def sigma(self, names: tuple[str, ...], places_n: FloatArray) -> float:
        """Return the standard deviation of the pointing on the sky, rad; NaN if a beacon is behind the telescope.

        Args:
            names: names of N beacons; empty for encoders and ship alone.
            places_n: vectors from the ship's antenna to the drones' antennas (N, U, E), m, shape (N, 3).
        """
        if not names:
            return self._on_sky(self._without_beacons_n)
        prediction = self._predict(names, places_n)
        main, by_noise_n = self._main_axis(prediction)
        jacobian = prediction.jacobian
        if not np.all(np.isfinite(jacobian)):
            return float("nan")
        noise = sum(prediction.noise_by_source.values()) / self._exposures
        by_states = self._covariance @ jacobian.T
        main_by_measurement = main @ by_states
        reduction = main_by_measurement @ np.linalg.solve(jacobian @ by_states + noise, main_by_measurement.T)
        return self._on_sky(main @ self._covariance @ main.T - reduction + by_noise_n)

    def budget(self, names: tuple[str, ...], places_n: FloatArray) -> dict[str, FloatArray]:
        """Return the pointing's covariance by source, rotation vector in n, rad², shape (3, 3) each.

        Args:
            names: names of N beacons, at least one.
            places_n: as in :meth:`sigma`.
        """
        model = self._filter.model
        prediction = self._predict(names, places_n)
        noise = {
            model.sources.index(source): part / self._exposures for source, part in prediction.noise_by_source.items()
        }
        measurement = LinearMeasurement(np.zeros(2 * len(names)), prediction.jacobian, noise)
        _, parts = update(self._parts, measurement, innovation(self._parts, measurement).gain)
        main, _ = self._main_axis(prediction)
        by_source = dict(zip(model.sources, main @ parts @ main.T, strict=True))
        for source, part in prediction.noise_n.items():
            by_source[source] = by_source[source] + part
        return by_source

    def _predict(self, names: tuple[str, ...], places_n: FloatArray) -> Prediction:
        count = len(names)
        image = Image(np.zeros((count, 2)), np.full(count, self._config.telescope.sigma_m))
        noise_n = np.array([self._noise_n[name] for name in names]).reshape(count, 3, 3)
        level = np.tile(np.eye(3), (count, 1, 1))  # a level drone, its nose to the North
        beacons = BeaconPoses(places_n, noise_n, level, np.zeros((count, 3, 3)))
        sighting = Sighting(0, names, image, beacons, self._ship, self._encoder)
        return self._filter.sightings.predict(self._mean, sighting)

    def _main_axis(self, prediction: Prediction) -> tuple[FloatArray, FloatArray]:
        """Return the derivative T by the states, shape (3, n), and the noise of the axis at a reading, rad², (3, 3)."""
        by_state_n = prediction.by_state_n.copy()
        # The parallelism rotates the telescope, not the main axis.
        by_state_n[:, self._parallelism] = 0.0
        return by_state_n, sum(prediction.noise_n.values(), np.zeros((3, 3)))

    def _on_sky(self, covariance_n: FloatArray) -> float:
        axis_n = self.rotation_nm[:, 0]
        return float(np.sqrt(np.trace(covariance_n) - axis_n @ covariance_n @ axis_n))

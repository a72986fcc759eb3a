"""Prediction of a sighting of beacons from a state of the calibration filter, with its Jacobian.

The beacons' points on the detector follow from the attitude of the telescope
(:mod:`ship_geometry.mount.axes`) and from the lines of sight (:mod:`ship_geometry.mount.line_of_sight`).
Attitude and lines of sight are corrected by the estimated errors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import StateModel
from ship_geometry.mount.axes import AXES, SHIP_TIME, AxisGeometry, axis_geometry, telescope_rotation
from ship_geometry.mount.image import Camera, predict_points
from ship_geometry.mount.line_of_sight import (
    BASELINE,
    SHIP_ROTATION,
    TERM_COLUMNS,
    BeaconPoses,
    LeverArm,
    LinesOfSight,
    Ship,
    Survey,
    lines_of_sight,
)
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_kernels import compiled_pointing
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.model import (
    COMMON_TERMS,
    OWN_TERMS,
    SOURCE_ENCODER,
    SOURCE_IMAGE,
    SOURCE_RTK,
    SOURCE_SHIP_NOISE,
    axis_state_indices,
)
from theodolite_calib.samples.sighting import Sighting

_OWN_WIDTHS = {"rtk": 3, "lever": 3, "attitude": 3, "refraction": 1}
"""Number of components of each state of one beacon."""

_NO_COVARIANCE, _UNIT = np.zeros((3, 3)), np.eye(3)

_ALL_BEACONS = -1
"""Beacon index of an error that affects all beacons."""


@dataclass(frozen=True)
class Prediction:
    """Sighting of N beacons predicted from a state of n errors.

    Attributes:
        rotation_nt: horizon from telescope, shape (3, 3).
        by_state_n: derivative of the telescope's rotation vector in n with respect to the states, shape (3, n).
        noise_n: covariance of the white error of the telescope's rotation vector in n, by source, rad², shape (3, 3).
        camera: camera with the estimated focal length.
        lines: predicted lines of sight to the beacons.
        residual: measured minus predicted points, m, shape (2 N,); NaN for a beacon behind the telescope.
        by_attitude_n: derivative of the points with respect to the telescope's rotation vector in n, m/rad, (2 N, 3).
        jacobian: derivative of the points with respect to all states, shape (2 N, n).
        noise_by_source: covariance of the white error of the points, by source, m², shape (2 N, 2 N).
    """

    rotation_nt: FloatArray
    by_state_n: FloatArray
    noise_n: dict[str, FloatArray]
    camera: Camera
    lines: LinesOfSight
    residual: FloatArray
    by_attitude_n: FloatArray
    jacobian: FloatArray
    noise_by_source: dict[str, FloatArray]


class SightingModel:
    """Measurement model of sightings of beacons for a configuration.

    Args:
        config: parameters of the node.
        model: states of the filter.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel) -> None:
        self._config, self._model = config, model
        self._axis_indices = axis_state_indices(model)
        self._configured_errors: FloatArray = np.zeros(SHIP_TIME.stop)
        self._configured_errors[AXES] = config.axes.values
        self._parallelism = config.telescope.parallelism
        self._principal_point = config.telescope.principal_point_m
        self._beacon_setups: dict[tuple[str, ...], _BeaconSetup] = {}

    def geometry_errors(self, mean: FloatArray) -> FloatArray:
        """Return the estimated errors of the axis geometry, in the order of ``AxisGeometry.by_error``, shape (14,)."""
        errors: FloatArray = self._configured_errors.copy()
        errors[: len(self._axis_indices)] += mean[self._axis_indices]
        return errors

    def parallelism(self, mean: FloatArray) -> FloatArray:
        """Return the angles of the main axis in the telescope, rad, shape (3,)."""
        return self._parallelism + self._state_block(mean, "parallelism")

    def focal_length_m(self, mean: FloatArray) -> float:
        """Return the estimated focal length, m."""
        return self._config.telescope.focal_length_m + float(self._state_block(mean, "focal_length")[0])

    def by_state_n(self, geometry: AxisGeometry, by_parallelism: FloatArray, parallelism: str) -> FloatArray:
        """Return the derivative of a camera's rotation vector in n with respect to the states, shape (3, n).

        Args:
            geometry: geometry of the main axis, to which the camera is fixed.
            by_parallelism: derivative of this rotation vector with respect to the angles of the parallelism, shape (3,
                3).
            parallelism: name of the states of the parallelism.
        """
        by_state_n = np.zeros((3, self._model.size))
        by_state_n[:, self._axis_indices] = geometry.by_error[:, : len(self._axis_indices)]
        by_state_n[:, self._model.slices[parallelism]] = by_parallelism
        return by_state_n

    def predict(self, mean: FloatArray, sighting: Sighting) -> Prediction:
        """Predict a sighting from a state."""
        ship, encoder = sighting.ship, sighting.encoder
        geometry = axis_geometry(
            self.geometry_errors(mean), ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation
        )
        rotation_nt, by_parallelism = telescope_rotation(self.parallelism(mean), geometry.rotation_nm)
        setup = self._beacon_setups.get(sighting.names)
        if setup is None:
            setup = self._beacon_setups[sighting.names] = _BeaconSetup(self._config, self._model, sighting.names)
        lines = self._lines(mean, sighting, geometry, setup)
        camera = Camera(self.focal_length_m(mean), self._config.telescope.focal_length_sigma_m, self._principal_point)
        points = predict_points(camera, rotation_nt, lines.direction_n)
        by_state_n = self.by_state_n(geometry, by_parallelism, "parallelism")
        rows = 2 * len(sighting.names)
        by_attitude_n = points.by_attitude_n.reshape(rows, 3)
        jacobian, by_error = compiled_pointing.jacobian_by_states(
            points.by_attitude_n,
            points.by_direction_n,
            points.by_focal_length,
            lines.jacobian_n,
            by_state_n,
            self._model.slices["focal_length"].start,
            setup.couplings,
        )
        if "ship.time_offset" in self._model.slices:
            # The ship's time offset also moves the theodolite relative to the antenna.
            by_turn = by_error[..., SHIP_ROTATION].reshape(rows, 3)
            jacobian[:, self._model.slices["ship.time_offset"]] += by_turn @ geometry.by_error[:, SHIP_TIME]
        parts_n = np.array([encoder.noise * (geometry.by_encoder @ geometry.by_encoder.T), ship.noise * _UNIT])
        encoder_noise, ship_noise = compiled_pointing.covariances_by_rotation(by_attitude_n, parts_n)
        noise = {
            SOURCE_ENCODER: encoder_noise,
            SOURCE_SHIP_NOISE: ship_noise,
            SOURCE_IMAGE: sighting.image.covariance_m2,
            SOURCE_RTK: compiled_pointing.covariance_by_own_error(
                by_error[..., BASELINE], sighting.beacons.baseline_covariance_n
            ),
        }
        noise_n = {SOURCE_ENCODER: parts_n[0], SOURCE_SHIP_NOISE: parts_n[1]}
        residual = (sighting.image.point_m - points.point_m).reshape(rows)
        return Prediction(rotation_nt, by_state_n, noise_n, camera, lines, residual, by_attitude_n, jacobian, noise)

    def _lines(
        self, mean: FloatArray, sighting: Sighting, geometry: AxisGeometry, setup: "_BeaconSetup"
    ) -> LinesOfSight:
        """Return the lines of sight, corrected by the estimated errors."""
        own, survey = setup.own_errors(mean), setup.survey
        beacons = BeaconPoses(
            baseline_n=sighting.beacons.baseline_n + own["rtk"] + self._state_block(mean, "ship_antenna"),
            baseline_covariance_n=sighting.beacons.baseline_covariance_n,
            rotation_nb=np.array([exp_rotation(turn) for turn in own["attitude"]]) @ sighting.beacons.rotation_nb,
            attitude_covariance_n=setup.attitude_covariance_n,
        )
        refraction = survey.refraction_coefficient + self._state_block(mean, "refraction", 1) + own["refraction"][:, 0]
        corrected_survey = Survey(
            theodolite_lever=_corrected_lever(survey.theodolite_lever, self._state_block(mean, "lever")),
            principal_point=_corrected_lever(survey.principal_point, self._state_block(mean, "lens")),
            beacon_lever=_corrected_lever(survey.beacon_lever, own["lever"]),
            rtk_base_sigma_m=survey.rtk_base_sigma_m,
            rtk_bias_sigma_m=survey.rtk_bias_sigma_m,
            refraction_coefficient=refraction,
            refraction_sigma=survey.refraction_sigma,
            refraction_beacon_sigma=survey.refraction_beacon_sigma,
        )
        return lines_of_sight(
            beacons, Ship(geometry.rotation_nd, _NO_COVARIANCE, geometry.rotation_dm), corrected_survey
        )

    def _state_block(self, mean: FloatArray, name: str, width: int = 3) -> FloatArray:
        """Return a block of the state; zeros if the filter has no such state."""
        columns = self._model.slices.get(name)
        return mean[columns] if columns is not None else np.zeros(width)


class _BeaconSetup:
    """Configuration of N beacons and the indices of their states.

    Args:
        config: parameters of the node.
        model: states of the filter.
        names: names of the beacons.

    Attributes:
        survey: configured quantities, without corrections by the states.
        attitude_covariance_n: covariances of the drones' attitudes, rad², shape (N, 3, 3).
        couplings: argument ``couplings`` of :func:`ship_kernels.compiled_pointing.jacobian_by_states`, shape
            (e, 3).
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel, names: tuple[str, ...]) -> None:
        beacons = [config.beacons[name] for name in names]
        self.survey = Survey(
            theodolite_lever=LeverArm(config.lever.vector_m, np.full(3, config.lever.sigma_m)),
            principal_point=LeverArm(config.telescope.lens.vector_m, np.full(3, config.telescope.lens.sigma_m)),
            beacon_lever=LeverArm(
                np.array([beacon.light.vector_m for beacon in beacons]),
                np.array([[beacon.light.sigma_m] * 3 for beacon in beacons]),
            ),
            rtk_base_sigma_m=np.full(3, config.ship_antenna.sigma_m),
            rtk_bias_sigma_m=np.array([[beacon.rtk.bias_sigma_m] * 3 for beacon in beacons]),
            refraction_coefficient=config.air.coefficient,
            refraction_sigma=config.air.sigma,
            refraction_beacon_sigma=np.full(len(names), config.air.light_sigma),
        )
        imus = [beacon.imu for beacon in beacons]
        sigma = np.deg2rad([[imu.tilt_sigma_deg, imu.heading_sigma_deg, imu.tilt_sigma_deg] for imu in imus])
        self.attitude_covariance_n: FloatArray = sigma[:, :, None] ** 2 * np.eye(3)
        # A rotation of the ship also moves the points, because the theodolite moves around the antenna.
        common = {**COMMON_TERMS, "ship_attitude": "ship.attitude"}
        effects = [(_ALL_BEACONS, term, state) for term, state in common.items()]
        effects += [
            (light, term, f"light.{name}.{state}")
            for term, state in OWN_TERMS.items()
            for light, name in enumerate(names)
        ]
        self.couplings: NDArray[np.intp] = np.array(
            [
                (light, column, row)
                for light, term, state in effects
                if state in model.slices
                for column, row in zip(_numbers(TERM_COLUMNS[term]), _numbers(model.slices[state]), strict=True)
            ],
            dtype=np.intp,
        )
        self._own_indices = {
            state: np.array([_state_indices(model, f"light.{name}.{state}", width) for name in names])
            for state, width in _OWN_WIDTHS.items()
        }

    def own_errors(self, mean: FloatArray) -> dict[str, FloatArray]:
        """Return the estimated errors of each beacon by state name, shape (N, 3) or (N, 1)."""
        padded = np.append(mean, 0.0)
        return {state: padded[indices] for state, indices in self._own_indices.items()}


def _state_indices(model: StateModel, state: str, width: int) -> list[int]:
    """Return the indices of a state; if it does not exist, the index of a zero appended to all states."""
    columns = model.slices.get(state)
    return [model.size] * width if columns is None else list(_numbers(columns))


def _corrected_lever(lever: LeverArm, error_m: FloatArray) -> LeverArm:
    return LeverArm(lever.vector_m + error_m, lever.sigma_m)


def _numbers(columns: slice) -> range:
    return range(columns.start, columns.stop)

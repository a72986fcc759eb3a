"""Effect of correlated errors on the direction of the optical axis from an exposure of beacons."""

import numpy as np

from ship_estimation.kalman.kalman_filter import StateModel
from ship_geometry.mount.axes import direction_change
from ship_geometry.mount.line_of_sight import covariance_by_source
from ship_geometry.rotations import FloatArray
from ship_studies.axis_fit.sightings import right_and_up
from theodolite_calib.beacon_camera.telescope_attitude import linearise, total_covariance
from theodolite_calib.filter.prediction import Prediction
from theodolite_calib.samples.sighting import Sighting

# The axis errors are the unknowns of the fit, not errors of a sighting.
_FITTED_BLOCK = "axes"
_SHIP = "ship.attitude"


def correlated_effects(
    model: StateModel, prediction: Prediction, sighting: Sighting, rotation_nt: FloatArray, direction_d: FloatArray
) -> dict[tuple[str, float], FloatArray]:
    """Return the effect of one sigma of each correlated error on a sighting.

    Args:
        model: model of the errors.
        prediction: exposure predicted with the configured values, with its Jacobian with respect to all errors.
        sighting: the exposure.
        rotation_nt: attitude of the telescope (horizon from telescope) from the beacons, shape (3, 3).
        direction_d: direction of the main axis by this attitude, unit vector in d, shape (3,).

    Returns:
        Name and correlation time (s) → angles to the right and up, shape (2,), rad.
    """
    line_covariance = total_covariance(covariance_by_source(prediction.lines.terms))
    equations = linearise(
        sighting.image, prediction.camera, prediction.lines.direction_n, line_covariance, rotation_nt, None
    )
    gain = np.linalg.solve(equations.weighted_jacobian @ equations.jacobian, equations.weighted_jacobian)
    # The beacons give the telescope's attitude without the axis geometry, whose part is removed from the Jacobian.
    through_beacons = gain @ (prediction.jacobian - prediction.by_attitude_n @ prediction.by_state_n)
    turn_d = sighting.ship.rotation_nd.T @ (prediction.by_state_n + through_beacons)
    by_error = right_and_up(direction_d) @ direction_change(direction_d, turn_d)
    effects = {}
    for name, block in model.blocks.items():
        if name == _FITTED_BLOCK:
            continue
        root = np.diag(block.sigma)
        if name == _SHIP and sighting.ship.correlated_covariance_n is not None:
            values, vectors = np.linalg.eigh(sighting.ship.correlated_covariance_n)
            root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        effect = by_error[:, model.slices[name]] @ root
        for number, time_s in enumerate(block.time_s):
            effects[f"{name}.{number + 1}", float(time_s)] = effect[:, number]
    return effects

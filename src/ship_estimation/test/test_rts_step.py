"""The backward step of the smoother against dense least squares over all epochs at once."""

import numpy as np
from scipy.linalg import block_diag

from ship_estimation.kalman.rts_smoother import GaussianEstimate, SmootherStep, smoother_step


def test_backward_step_equals_batch_least_squares() -> None:
    # The last two states have no process noise, and one of them is known exactly. The reference is dense least squares.
    rng, n, count = np.random.default_rng(2), 4, 12
    start = np.diag([4.0, 1.0, 0.0, 2.0])
    decays, noise = rng.uniform(0.5, 1.0, (count, n)), rng.uniform(0.1, 1.0, (count, n))
    noise[:, 2:] = 0.0
    rows, values = rng.standard_normal((count, 2, n)), rng.standard_normal((count, 2))
    known, backs = GaussianEstimate(np.zeros(n), start), []
    for epoch in range(count):
        predicted, cross = known, start
        if epoch:
            transition = np.diag(decays[epoch])
            cross = known.covariance @ transition.T
            predicted = GaussianEstimate(transition @ known.mean, transition @ cross + np.diag(noise[epoch]))
            backs.append(smoother_step(known, cross, predicted))
        innovation = rows[epoch] @ predicted.covariance @ rows[epoch].T + np.eye(2)
        gain = predicted.covariance @ rows[epoch].T @ np.linalg.inv(innovation)
        mean = predicted.mean + gain @ (values[epoch] - rows[epoch] @ predicted.mean)
        known = GaussianEstimate(mean, predicted.covariance - gain @ innovation @ gain.T)
    found = [known]
    for back in reversed(backs):
        assert isinstance(back, SmootherStep)
        found.append(back.apply(found[-1]))
    # All states as functions of the first one and of the process noise at each epoch.
    of_new = np.zeros((count, n, count, n))
    for epoch in range(count):
        for since in range(epoch + 1):
            of_new[epoch, :, since] = np.diag(np.prod(decays[since + 1 : epoch + 1], axis=0))
    of_new = of_new.reshape(count * n, count * n)
    prior = of_new @ block_diag(start, *map(np.diag, noise[1:])) @ of_new.T
    design = np.zeros((count, 2, count, n))
    for epoch in range(count):
        design[epoch, :, epoch] = rows[epoch]
    design = design.reshape(2 * count, count * n)
    weights = prior @ design.T @ np.linalg.inv(design @ prior @ design.T + np.eye(2 * count))
    mean, covariance = (weights @ values.ravel()).reshape(count, n), prior - weights @ design @ prior
    for epoch, one in enumerate(reversed(found)):
        block = slice(epoch * n, (epoch + 1) * n)
        np.testing.assert_allclose(one.mean, mean[epoch], atol=1e-12)
        np.testing.assert_allclose(one.covariance, covariance[block, block], atol=1e-12)

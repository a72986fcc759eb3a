"""Messages that are made together for many attitudes equal those made one by one, byte for byte."""

import numpy as np

from ship_attitude_star.messages.attitude_messages import AttitudeNumbers, attitude_messages, attitude_rows
from ship_bags.message_store import RosbagsFactory
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import exp_rotation
from ship_stars.attitude_samples import AttitudeEstimate, Horizon

RATE_SIGMA = 2e-5
KINDS = [
    (Status.VALID, ("ins", "star.fore", "star.starboard"), True),
    (Status.COASTING, ("ins",), True),
    (Status.INVALID, (), False),
    (Status.DEGRADED, ("star.fore",), False),
    (Status.VALID, ("ins", "star.fore"), True),
]
"""Status, sources, and True if the rate is known."""


def attitudes(count: int = 40) -> list[AttitudeEstimate]:
    """Attitudes of all statuses with different numbers."""
    rng = np.random.default_rng(3)
    found = []
    for number in range(count):
        status, sources, rate_known = KINDS[number % len(KINDS)]
        root = 1e-5 * rng.standard_normal((3, 3))
        nothing = np.nan if status is Status.INVALID else 0.0
        found.append(
            AttitudeEstimate(
                time_ns=1_400_000_000_000_000_000 + 10_000_001 * number,
                rotation_nd=exp_rotation(rng.uniform(-2.0, 2.0, 3)) + nothing,
                covariance_by_source_n=np.zeros((1, 3, 3)),
                covariance_n=root @ root.T + nothing,
                covariance_without_separation_n=root @ root.T,
                rate_d=rng.standard_normal(3) + (0.0 if rate_known else np.nan),
                status=status,
                horizon=Horizon.GRAVITY if number % 3 else Horizon.GEODETIC,
                sources=sources,
                star_age_s=0.1 * number,
                state=None,
            )
        )
    return found


def test_rows_are_the_messages_of_each_attitude_in_their_order() -> None:
    factory = RosbagsFactory()
    numbers = AttitudeNumbers.from_runs([AttitudeNumbers.from_estimate(attitude) for attitude in attitudes()])
    found: list[list[tuple[str, bytes]]] = [[] for _ in attitudes()]
    for rows in attitude_rows(factory, numbers, RATE_SIGMA):
        for number, place in enumerate(rows.places.tolist()):
            found[place].append((rows.topic, rows.messages.message(number).__cdr__))
    for messages, attitude in zip(found, attitudes(), strict=True):
        alone = attitude_messages(factory, attitude, RATE_SIGMA)
        assert messages == [(topic, message.__cdr__) for topic, message in alone]
    assert {len(messages) for messages in found} == {2, 4}

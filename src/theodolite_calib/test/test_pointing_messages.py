"""Messages of many pointings equal those of each alone, byte for byte, and decode to the pointings."""

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angles_from_rotation, enu_covariance, mounting_quaternion, quaternion_from_rotation
from ship_geometry.rotations import exp_rotation
from theodolite_calib.messages.output_messages import PointingNumbers, pointing_messages, pointing_rows
from theodolite_calib.optical_axis.output import PointingSeries
from theodolite_calib.samples.samples import Mode, PointingEstimate

LEVER = {"x": 12.0, "y": 2.0, "z": 3.0}
KINDS = [
    (Status.VALID, Mode.TWO_LIGHTS, True),
    (Status.VALID, Mode.ONE_LIGHT, False),
    (Status.INVALID, Mode.ENCODER, False),
    (Status.DEGRADED, Mode.TWO_LIGHTS, True),
    (Status.COASTING, Mode.ENCODER, True),
    (Status.COASTING, Mode.ENCODER, False),
]
"""Status, mode, and True if the pointing used a ship/attitude."""


def pointings(count: int = 40) -> list[PointingEstimate]:
    """Return pointings of all kinds, each with other numbers."""
    rng = np.random.default_rng(3)
    found = []
    for number in range(count):
        status, mode, in_deck = KINDS[number % len(KINDS)]
        root = 1e-5 * rng.standard_normal((3, 3))
        nothing = np.nan if status is Status.INVALID else 0.0
        found.append(
            PointingEstimate(
                time_ns=1_400_000_000_000_000_000 + 10_000_001 * number,
                rotation_nm=exp_rotation(rng.uniform(-2.0, 2.0, 3)) + nothing,
                covariance_by_source_n=np.zeros((1, 3, 3)),
                covariance_n=root @ root.T + nothing,
                covariance_without_separation_n=root @ root.T,
                rotation_nt=exp_rotation(rng.uniform(-2.0, 2.0, 3)) + (np.nan if mode is Mode.ENCODER else 0.0),
                mode=mode,
                status=status,
                light_count=number % 3,
                state=None,
                text="",
                by_error_n=np.zeros((3, 13)),
                rotation_dm=exp_rotation(rng.uniform(-2.0, 2.0, 3)) + (0.0 if in_deck else np.nan),
            )
        )
    return found


def series_of(estimates: list[PointingEstimate]) -> PointingSeries:
    """Return pointings as a series."""
    whole = {name: [getattr(estimate, name) for estimate in estimates] for name in vars(estimates[0])}
    arrays = {name: values if name in ("status", "text") else np.array(values) for name, values in whole.items()}
    return PointingSeries(**{**arrays, "state": None})


def test_rows_are_the_messages_of_each_pointing_in_their_order() -> None:
    factory = RosbagsFactory()
    numbers = PointingNumbers.from_series([series_of(pointings()[:17]), series_of(pointings()[17:])])
    found: list[list[tuple[str, bytes]]] = [[] for _ in pointings()]
    for rows in pointing_rows(factory, LEVER, numbers):
        for number, place in enumerate(rows.places.tolist()):
            found[place].append((rows.topic, rows.messages.message(number).__cdr__))
    for messages, pointing in zip(found, pointings(), strict=True):
        alone = pointing_messages(factory, LEVER, pointing)
        assert messages == [(topic, message.__cdr__) for topic, message in alone]
    assert {len(messages) for messages in found} == {1, 2}


def test_fields_of_one_pointing() -> None:
    factory = RosbagsFactory()
    for pointing in pointings(len(KINDS)):
        (topic, message), *on_tf = pointing_messages(factory, LEVER, pointing)
        assert (topic, message.header.frame_id) == ("theodolite/pointing", "theodolite_main")
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == pointing.time_ns
        for name in ("mode", "status", "light_count"):
            assert getattr(message, name) == getattr(pointing, name)
        found = message.azimuth, message.elevation, message.image_rotation
        assert found == pytest.approx(angles_from_rotation(pointing.rotation_nm), abs=1e-13, nan_ok=True)
        found = message.telescope_azimuth, message.telescope_elevation, message.telescope_rotation
        assert found == pytest.approx(angles_from_rotation(pointing.rotation_nt), abs=1e-13, nan_ok=True)
        expected = enu_covariance(pointing.covariance_n).ravel()
        assert message.rotation_covariance == pytest.approx(expected, rel=1e-12, abs=1e-24, nan_ok=True)
        if pointing.status is Status.INVALID:
            assert not on_tf
            continue
        (transform,) = on_tf[0][1].transforms
        turn = transform.transform.rotation
        quaternion, place = [turn.x, turn.y, turn.z, turn.w], transform.transform.translation
        if np.isfinite(pointing.rotation_dm).all():
            assert (transform.header.frame_id, place.x, place.y, place.z) == ("deck", 12.0, 2.0, 3.0)
            assert quaternion == pytest.approx(mounting_quaternion(pointing.rotation_dm), abs=1e-13)
        else:
            assert (transform.header.frame_id, place.x, place.y, place.z) == ("horizon", 0.0, 0.0, 0.0)
            assert quaternion == pytest.approx(quaternion_from_rotation(pointing.rotation_nm), abs=1e-13)

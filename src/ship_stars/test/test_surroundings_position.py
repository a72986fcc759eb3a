"""The ship's position from fixes: anywhere on Earth, with a growing error, in any order of arrival."""

import itertools

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_stars.attitude_samples import PositionFix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.position_from_fixes import ACCELERATION_SIGMA_M_PER_S2, SPEED_SIGMA_M_PER_S, ShipPosition
from ship_stars.sky.surroundings import Surroundings
from ship_testing.horizon_vectors import vector_between

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
SIGMA_M = np.diag([4.0, 9.0, 1.0])
M_PER_DEG_OF_LATITUDE = 110_574.0
"""At the equator, WGS 84."""
M_PER_DEG_OF_LONGITUDE = 111_320.0
"""At the equator: 40 075 017 m / 360."""


def position_at(latitude_deg: float, longitude_deg: float, height_m: float = 20.0) -> GeodeticPosition:
    return GeodeticPosition(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), height_m)


def track(*fixes: tuple[float, GeodeticPosition], covariance_m2=SIGMA_M, **config) -> "Fixes":
    result = Fixes(SkyConfig(**config))
    for since_s, position in fixes:
        result.insert(PositionFix(ns(since_s), position, covariance_m2))
    return result


class Fixes(Surroundings):
    """Surroundings for requests of the position only."""

    def position(self, time_ns: int) -> ShipPosition | Rejection:
        found = self.position_and_air_at(time_ns)
        return found if isinstance(found, Rejection) else found[0]


def ns(since_s: float) -> int:
    return START_NS + round(since_s * SECOND_NS)


def position_bytes(place: ShipPosition | Rejection) -> bytes:
    if isinstance(place, Rejection):
        return place.reason.name.encode()
    position = place.observer.position
    where = np.array([position.latitude, position.longitude, position.height_m, place.age_s])
    return where.tobytes() + place.observer.velocity_n_m_per_s.tobytes() + place.covariance_m2.tobytes()


def distance_m(place, position: GeodeticPosition) -> float:
    return float(np.linalg.norm(vector_between(position, place.observer.position)))


def test_between_fixes_the_position_is_on_the_line() -> None:
    place = track((0, position_at(0.0, 10.0)), (10, position_at(0.001, 10.0))).position(ns(2.5))
    # The chord is lower than the arc by s (L - s) / 2R, below a millimetre here.
    assert distance_m(place, position_at(0.00025, 10.0)) < 1e-3
    np.testing.assert_allclose(place.observer.velocity_n_m_per_s, [0.001 * M_PER_DEG_OF_LATITUDE / 10, 0, 0], atol=1e-3)
    assert place.age_s == 2.5


def test_beyond_the_last_fix_the_line_of_the_last_five_seconds_is_extrapolated() -> None:
    fixes = (
        (0, position_at(0.0001, 10.0)),
        (1, position_at(0.0, 10.0)),
        (4, position_at(0.0002, 10.0)),
        (6, position_at(0.0, 10.0005)),
    )
    place = track(*fixes).position(ns(8))
    assert distance_m(place, position_at(0.0, 10.0007)) < 1e-3
    np.testing.assert_allclose(place.observer.velocity_n_m_per_s, [0, 0, 1e-4 * M_PER_DEG_OF_LONGITUDE], atol=1e-3)
    assert place.age_s == 2.0


def test_a_fix_is_not_used_before_its_delay_is_over() -> None:
    fixes = [(t, position_at(50.0 + 1e-5 * t * t, 10.0)) for t in range(10)]
    earlier, later = track(*fixes[:9]), track(*fixes)
    for since_s in (8.5, 9.0, 9.25, 9.499999999):
        assert position_bytes(later.position(ns(since_s))) == position_bytes(earlier.position(ns(since_s)))
    assert later.position(ns(9.25)).age_s == 1.25
    assert later.position(ns(9.5)).age_s == 0.5


@pytest.mark.parametrize("delay_s", [0.0, 0.5, 2.0])
def test_a_fix_in_time_changes_nothing_before_its_delay_is_over(delay_s: float) -> None:
    fixes = track(*((t, position_at(50.0 + 1e-5 * t * t, 10.0)) for t in range(10)), gnss_delay_s=delay_s)
    for t in range(10, 20):
        changed_after_ns = fixes.insert(PositionFix(ns(t), position_at(50.0 + 1e-5 * t * t, 10.0), SIGMA_M))
        assert changed_after_ns == ns(t) + round(delay_s * SECOND_NS) - 1
        fixes.drop_before(ns(t - 4.0))


def test_fixes_at_10_hz_do_not_amplify_their_errors() -> None:
    rng = np.random.default_rng(5)
    errors_m = rng.normal(0.0, 1.0, (400, 2))
    places_deg = errors_m / [M_PER_DEG_OF_LATITUDE, M_PER_DEG_OF_LONGITUDE]
    fixes = track(*((0.1 * number, position_at(*place_deg)) for number, place_deg in enumerate(places_deg)))
    away = [distance_m(fixes.position(ns(t)), position_at(0.0, 0.0)) for t in np.arange(6.05, 39.0, 0.1)]
    # The line over 5 s is extrapolated by 0.55 s: 1.11 times the error of its last fix, 0.11 times that of its first.
    assert np.sqrt(np.mean(np.square(away))) == pytest.approx(np.sqrt(2.0) * np.hypot(1.11, 0.11), rel=0.15)


def test_at_the_start_the_nearest_fix_is_used_even_if_later() -> None:
    one = track((0, position_at(0.0, 10.0)))
    assert [one.position(ns(t)).age_s for t in (-0.25, 0.25, 0.75)] == [0.25, 0.25, 0.75]
    two = track((0, position_at(0.0, 10.0)), (1, position_at(0.0, 10.0001)))
    for since_s in (-0.25, 0.25, 0.75, 1.25):
        assert distance_m(two.position(ns(since_s)), position_at(0.0, 10.0 + 1e-4 * since_s)) < 1e-3
    assert two.position(ns(1.25)).age_s == 0.25
    assert two.position(ns(1.5)).age_s == 0.5


def test_after_a_gap_the_first_new_fix_is_used_at_once() -> None:
    fixes = track(*((t, position_at(50.0, 10.0)) for t in range(10)), (200, position_at(50.0, 10.001)))
    assert isinstance(fixes.position(ns(69.0)), ShipPosition)
    assert fixes.position(ns(69.0)).age_s == 60.0
    assert fixes.position(ns(100.0)).reason is Reason.NO_FIX
    assert [fixes.position(ns(t)).age_s for t in (199.75, 200.25)] == [0.25, 0.25]


def test_before_the_first_fix_the_line_is_extrapolated_backwards() -> None:
    place = track((0, position_at(0.0, 10.0)), (1, position_at(0.0, 10.0001))).position(ns(-2))
    assert distance_m(place, position_at(0.0, 9.9998)) < 1e-3


def test_across_the_date_line_the_path_is_the_short_one() -> None:
    place = track((0, position_at(0.0, 179.9999)), (1, position_at(0.0, -179.9999))).position(ns(0.75))
    assert distance_m(place, position_at(0.0, -179.99995)) < 1e-3
    assert place.observer.velocity_n_m_per_s[2] == pytest.approx(2e-4 * M_PER_DEG_OF_LONGITUDE, abs=1e-3)


def test_over_the_pole_the_path_is_straight() -> None:
    # 11 m on either side of the pole: north first, then south on the opposite meridian.
    fixes = (0, position_at(89.9999, 30.0)), (2, position_at(89.9999, -150.0))
    speed_m_per_s = 2e-4 * 111_694.0 / 2  # per degree of latitude at the pole
    before, after = (track(*fixes).position(ns(t)) for t in (0.5, 1.5))
    assert distance_m(before, position_at(89.99995, 30.0)) < 1e-3
    assert distance_m(after, position_at(89.99995, -150.0)) < 1e-3
    np.testing.assert_allclose(before.observer.velocity_n_m_per_s, [speed_m_per_s, 0, 0], atol=1e-3)
    np.testing.assert_allclose(after.observer.velocity_n_m_per_s, [-speed_m_per_s, 0, 0], atol=1e-3)


def test_near_the_pole_the_error_keeps_its_direction_on_earth() -> None:
    # At the first fix its covariance is used unrotated, although the other fix is a quarter turn round the pole away.
    place = track(
        (0, position_at(89.9999, 0.0)), (1, position_at(89.9999, 90.0)), covariance_m2=np.diag([100.0, 0.0, 1.0])
    ).position(ns(0))
    assert place.covariance_m2[0, 0] == pytest.approx(100.0)
    turned = track((0, position_at(89.9999, 0.0)), covariance_m2=np.diag([100.0, 0.0, 1.0]))
    turned.insert(PositionFix(ns(1), position_at(89.9999, 90.0), np.diag([1.0, 0.0, 100.0])))
    # At longitude 45°, halfway in time: both fixes have the same ellipse, rotated by 45°.
    north, _, east = np.diagonal(turned.position(ns(0.5)).covariance_m2)
    drift_m2 = (0.5 * ACCELERATION_SIGMA_M_PER_S2 * 0.25) ** 2
    assert (north, east) == pytest.approx((50.5 + drift_m2, 50.5 + drift_m2))


@pytest.mark.parametrize(
    ("since_s", "drift_m"),
    [
        (0.0, 0.0),
        (1.0, 0.0),
        (0.5, 0.5 * 0.1 * 0.25),  # half the acceleration, times 0.5 s to either fix
        (11.0, 0.5 * 0.1 * 11.0 * 10.0),
        (61.0, 0.5 * 0.1 * 61.0 * 60.0),
    ],
)
def test_the_error_grows_with_the_time_to_the_fixes(since_s: float, drift_m: float) -> None:
    covariance_m2 = (
        track((0, position_at(50.0, 10.0)), (1, position_at(50.0, 10.0))).position(ns(since_s)).covariance_m2
    )
    np.testing.assert_allclose(covariance_m2, SIGMA_M + np.diag([drift_m**2, 0.0, drift_m**2]), rtol=1e-9, atol=1e-9)


def test_with_one_fix_the_error_allows_any_course() -> None:
    place = track((0, position_at(50.0, 10.0))).position(ns(3))
    drift_m2 = (3 * SPEED_SIGMA_M_PER_S) ** 2
    np.testing.assert_allclose(place.covariance_m2, SIGMA_M + np.diag([drift_m2, 0.0, drift_m2]), atol=1e-9)
    np.testing.assert_array_equal(place.observer.velocity_n_m_per_s, 0.0)


def test_fixes_with_a_long_gap_give_no_velocity() -> None:
    fast = {"fix_max_age_s": 60.0, "max_speed_m_per_s": 100.0}
    distant = track((0, position_at(0.0, 10.0)), (121, position_at(0.0, 10.1)), **fast)
    assert distance_m(distant.position(ns(3)), position_at(0.0, 10.0)) < 1e-6
    joined = track((0, position_at(0.0, 10.0)), (120, position_at(0.0, 10.1)), **fast)
    # The chord of 11 km is below the sea surface by s (L - s) / 2R: 2.3 m in its middle.
    assert distance_m(joined.position(ns(60)), position_at(0.0, 10.05)) == pytest.approx(
        5566.0**2 / 2 / 6_378_137.0, rel=1e-3
    )


def test_without_a_recent_fix_the_position_is_rejected_with_a_reason() -> None:
    assert track().position(ns(0)).reason is Reason.NO_FIX
    fixes = track((0, position_at(50.0, 10.0)), fix_max_age_s=60.0)
    assert isinstance(fixes.position(ns(60)), ShipPosition)
    rejection = fixes.position(ns(60.1))
    assert (rejection.reason, rejection.text) == (
        Reason.NO_FIX,
        "the nearest position fix is 60.1 s older: more than fix_max_age_s = 60",
    )
    assert "newer" in fixes.position(ns(-61)).text


def test_any_order_of_arrival_gives_the_same_positions_to_the_last_bit() -> None:
    rng = np.random.default_rng(11)
    fixes = [(float(t), position_at(50.0 + 1e-4 * rng.normal(), 10.0 + 1e-4 * rng.normal())) for t in (0, 1, 2, 4, 9)]
    fixes.append((4.0, position_at(50.0, 10.00005)))  # another with the same stamp
    times_ns = [ns(t) for t in (-3.0, 0.0, 0.25, 0.5, 1.5, 2.0, 3.3, 4.0, 4.6, 7.0, 9.0, 9.7, 12.0)]

    def answers(order) -> list[bytes]:
        found = track(*order)
        return [position_bytes(found.position(time_ns)) for time_ns in times_ns]

    expected = answers(fixes)
    assert all(answers(order) == expected for order in itertools.islice(itertools.permutations(fixes), 0, 720, 7))


def test_nothing_changes_at_or_before_the_returned_time() -> None:
    times = [0, 1, 2, 4, 9]
    places = {t: position_at(50.0 + 1e-4 * t * t, 10.0) for t in times}
    times_s = np.arange(-5.0, 15.0, 0.25)
    whole = track(*places.items(), max_speed_m_per_s=1000.0)
    for late in times:
        others = track(*((t, places[t]) for t in times if t != late), max_speed_m_per_s=1000.0)
        before = [position_bytes(others.position(ns(m))) for m in times_s]
        changed_after_ns = others.insert(PositionFix(ns(late), places[late], SIGMA_M))
        for time_s, old in zip(times_s, before, strict=True):
            # A cached result must equal the recomputed one.
            assert position_bytes(others.position(ns(time_s))) == position_bytes(whole.position(ns(time_s)))
            assert position_bytes(whole.position(ns(time_s))) == old or ns(time_s) > changed_after_ns
    assert others.insert(PositionFix(ns(9), places[9], SIGMA_M)) is None


@pytest.mark.parametrize("seed", range(8))
def test_cached_results_equal_recomputed_ones_for_late_inputs(seed: int) -> None:
    """Fixes with gaps, jumps and equal stamps, up to 3 s late, while old ones are dropped."""
    rng = np.random.default_rng(seed)
    period_s, max_age_s = rng.choice([0.1, 0.25, 1.0, 5.0]), rng.choice([1.2, 6.0, 60.0])
    stamps_s = np.cumsum(period_s * rng.choice([0.0, 0.9, 1.0, 1.1, 15.0], 25, p=[0.05, 0.3, 0.3, 0.3, 0.05]))
    north_m = 2.0 * stamps_s + rng.normal(0.0, 1.0, 25) + np.where(rng.random(25) < 0.1, 500.0, 0.0)
    arrivals_s = stamps_s + rng.choice([0.0, 1.0], 25) * rng.uniform(0.0, 3.0, 25)
    # Results change at the stamps, at the ends of delays, and in between.
    times_s = np.sort(np.concatenate([stamps_s, stamps_s + 0.5, rng.uniform(-2.0, stamps_s[-1] + 3.0, 50)]))
    cached, taken, oldest_s = track(fix_max_age_s=max_age_s), [], -np.inf
    for index in np.argsort(arrivals_s, kind="stable"):
        if stamps_s[index] < oldest_s:
            continue
        taken.append((stamps_s[index], position_at(50.0 + north_m[index] / 111_229.0, 10.0)))
        cached.insert(PositionFix(ns(stamps_s[index]), taken[-1][1], SIGMA_M))
        oldest_s = max(oldest_s, arrivals_s[index] - 3.0)
        cached.drop_before(ns(oldest_s))
        recomputed = track(*taken, fix_max_age_s=max_age_s)
        for time_ns in (ns(since_s) for since_s in times_s if since_s >= oldest_s):
            assert position_bytes(cached.position(time_ns)) == position_bytes(recomputed.position(time_ns))


def test_a_repeated_stamp_is_rejected() -> None:
    fixes = track((0, position_at(50.0, 10.0)))
    assert fixes.rejection(PositionFix(ns(0), position_at(50.0, 10.0), SIGMA_M)).reason is Reason.DUPLICATE
    assert fixes.rejection(PositionFix(ns(0), position_at(50.0, 10.1), SIGMA_M)).reason is Reason.CONFLICT
    assert fixes.rejection(PositionFix(ns(1), position_at(50.0, 10.0001), SIGMA_M)) is None


def test_dropped_fixes_are_not_needed() -> None:
    fixes = [(t, position_at(50.0 + 1e-5 * t * t, 10.0)) for t in range(20)]
    kept, whole = track(*fixes), track(*fixes)
    kept.drop_before(ns(15.25))
    for since_s in (15.25, 16.0, 18.3, 22.0):
        assert position_bytes(kept.position(ns(since_s))) == position_bytes(whole.position(ns(since_s)))
    assert distance_m(kept.position(ns(12.0)), whole.position(ns(12.0)).observer.position) > 1.0


def moving_fix(since_s: float, off_m: float = 0.0, latitude_deg: float = 50.0, longitude_deg: float = 10.0):
    """Return the time and the position of a ship that sails north at 10 m/s, ``off_m`` further north."""
    north_deg = (10.0 * since_s + off_m) / 111_229.0  # metres per degree of latitude at 50°, WGS 84
    return since_s, position_at(latitude_deg + north_deg, longitude_deg)


@pytest.mark.parametrize("off_m", [300.0, -1000.0, 10_000.0, 5e6])
def test_a_fix_that_jumps_is_rejected_and_the_line_is_extrapolated(off_m: float) -> None:
    fixes = track(*(moving_fix(t) for t in range(10)))
    for t in range(10, 30):
        wrong = PositionFix(ns(t), moving_fix(t, off_m)[1], SIGMA_M)
        rejection = fixes.rejection(wrong)
        assert rejection is not None
        assert (rejection.reason, "from the last accepted value" in rejection.text) == (Reason.JUMP, True)
        assert fixes.insert(wrong) is None
        place = fixes.position(ns(t))
        assert distance_m(place, moving_fix(t)[1]) < 0.1
        assert place.age_s == t - 9
    # The straight line has the error of an acceleration of 0.1 m/s², as in any time without fixes.
    north_m2 = 4.0 + (0.5 * ACCELERATION_SIGMA_M_PER_S2 * 20.0 * 25.0) ** 2
    assert fixes.position(ns(29)).covariance_m2[0, 0] == pytest.approx(north_m2, rel=1e-3)
    back = PositionFix(ns(30), moving_fix(30)[1], SIGMA_M)
    assert fixes.rejection(back) is None
    assert fixes.insert(back) == ns(30.5) - 1


def test_a_permanent_jump_is_accepted_and_no_line_connects_it() -> None:
    """The jump is accepted after 25 s (``JUMP_CONFIRMATION_S``)."""
    fixes = track(*(moving_fix(t) for t in range(10)), *(moving_fix(t, 1000.0) for t in range(10, 36)))
    # A fix is used from gnss_delay_s after its stamp on. No line connects it to the position before.
    assert distance_m(fixes.position(ns(35.4)), moving_fix(35.4)[1]) < 0.1
    assert distance_m(fixes.position(ns(35.5)), moving_fix(35, 1000.0)[1]) < 1e-3
    later = track(*(moving_fix(t) for t in range(10)), *(moving_fix(t, 1000.0) for t in range(10, 38))).position(ns(39))
    assert distance_m(later, moving_fix(39, 1000.0)[1]) < 0.1
    assert later.observer.velocity_n_m_per_s[0] == pytest.approx(10.0, abs=0.01)


def test_changes_within_the_limits_are_accepted() -> None:
    def rejections(*fixes, **config) -> list:
        found, sky = [], Fixes(SkyConfig(**config))
        for since_s, position, *sigma_m in fixes:
            fix = PositionFix(ns(since_s), position, np.eye(3) * (sigma_m[0] if sigma_m else 3.0) ** 2)
            found.append(sky.rejection(fix))
            sky.insert(fix)
        return [rejection for rejection in found if rejection is not None]

    # Another antenna 45 m along the ship; minutes without fixes; a receiver that states a large error.
    assert rejections(*(moving_fix(t) for t in range(5)), *(moving_fix(t, 45.0) for t in range(5, 10))) == []
    assert rejections(moving_fix(0), moving_fix(1), moving_fix(400), moving_fix(401)) == []
    assert rejections(*((*moving_fix(t, 300.0 * (t % 2)), 100.0) for t in range(20))) == []
    # The date line, and over the pole by 11 m on either side.
    assert (
        rejections((0, position_at(0.0, 179.9999)), (1, position_at(0.0, -179.9999)), (2, position_at(0.0, -179.9997)))
        == []
    )
    assert (
        rejections(
            (0, position_at(89.9999, 30.0)), (1, position_at(89.9999, -150.0)), (2, position_at(89.9997, -150.0))
        )
        == []
    )
    # On the opposite side of the Earth the chord has no horizontal part: it is a jump nevertheless.
    assert len(rejections((0, position_at(0.0, 10.0)), (1, position_at(0.0, 10.0)), (2, position_at(0.0, -170.0)))) == 1
    # Height is not compared.
    assert rejections((0, position_at(50.0, 10.0, 20.0)), (1, position_at(50.0, 10.0, 900.0))) == []

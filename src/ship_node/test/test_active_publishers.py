"""Active publishers of a topic, by the sequence numbers of their messages."""

from ship_node.health.duplicate_publishers import ActivePublishers

MS = 1_000_000


def two_found(numbers: list[int], period_ms: int = 10, publishers: ActivePublishers | None = None) -> list[bool]:
    """Return for each message whether two publishers send."""
    publishers = ActivePublishers() if publishers is None else publishers
    return [publishers.add_message(number, n * period_ms * MS) for n, number in enumerate(numbers)]


def test_one_publisher_with_lost_messages() -> None:
    assert not any(two_found([1, 2, 5, 6, 100, 101]))


def test_a_restarted_publisher_is_one() -> None:
    # After the restart the numbers pass 5, the last one before the restart, and message 5 is lost. Another restart
    # follows.
    assert not any(two_found([3, 4, 5, 1, 2, 3, 4, 6, 7, 8, 9, 1, 2, 3]))


def test_two_publishers_are_detected_with_any_numbers_and_rates() -> None:
    assert two_found([700, 1, 701, 2, 702, 3])[3:] == [True] * 3
    assert two_found([1, 1, 2, 2, 3, 3, 4, 4])[-1]
    assert two_found([10, 11, 11, 12, 12, 13, 13])[-1]
    fast_and_slow = [number for n in range(1, 5) for number in (*range(1000 + 100 * n, 1100 + 100 * n), n)]
    assert two_found(fast_and_slow).index(True) < 310


def test_a_stopped_publisher_times_out_after_three_periods() -> None:
    publishers = ActivePublishers()
    two_found([700, 1, 701, 2, 702, 3], publishers=publishers)
    assert publishers.has_two(500 * MS)
    for n in range(100):
        publishers.add_message(703 + n, (60 + 10 * n) * MS)
    assert not publishers.has_two(1060 * MS)


def test_a_new_publisher_after_two_is_one() -> None:
    publishers = ActivePublishers()
    two_found([700, 1, 701, 2, 702, 3], publishers=publishers)
    publishers.keep_latest()
    assert not any(
        publishers.add_message(number, (60 + 10 * n) * MS) for n, number in enumerate((4, 5, 1, 2, 3, 4, 5, 6, 7))
    )


def test_without_sequence_numbers_no_publisher_is_stored() -> None:
    """CycloneDDS gives no numbers: each message would count as a new publisher for ten seconds."""
    publishers = ActivePublishers()
    assert not any(two_found([2**64 - 1] * 500, publishers=publishers))
    assert publishers._publishers == []

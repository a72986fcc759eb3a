from ship_node.live.tick_grid import TickGrid, WaitingClock


def test_first_call_only_starts_the_grid():
    assert list(TickGrid(100).due(1050)) == []


def test_every_multiple_reached_comes_once():
    grid = TickGrid(100)
    list(grid.due(1050))
    assert list(grid.due(1099)) == []
    assert list(grid.due(1100)) == [1100]
    assert list(grid.due(1100)) == []
    assert list(grid.due(1420)) == [1200, 1300, 1400]


def test_time_that_wavers_back_repeats_no_tick():
    grid = TickGrid(100)
    list(grid.due(1050))
    assert list(grid.due(1210)) == [1100, 1200]
    assert list(grid.due(1190)) == []
    assert list(grid.due(1300)) == [1300]


def test_restart_makes_up_for_nothing():
    grid = TickGrid(100)
    list(grid.due(1050))
    grid.restart(500)
    assert list(grid.due(700)) == [600, 700]


def test_mend_04_waiting_is_the_time_in_which_the_node_listens() -> None:
    start_ns, steady_ns = 1_700_000_000_000_000_000, 5_000_000_000
    clock = WaitingClock(lambda: steady_ns)
    assert clock.now_ns(start_ns) == start_ns
    steady_ns += 1_200_000_000
    # It was not asked for so long: the node stood still.
    assert clock.now_ns(start_ns) == start_ns + 200_000_000
    steady_ns += 50_000_000
    # Whatever the system's clock shows.
    assert clock.now_ns(start_ns - 3600 * 10**9) == start_ns + 250_000_000
    assert clock.now_ns(start_ns + 3600 * 10**9) == start_ns + 250_000_000

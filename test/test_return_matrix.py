"""A seeded fiftieth of the return matrix: every cell returns in time, and is never VALID beyond its protection level.

``make returns`` runs all cells.
"""

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import serialize
from ship_simulation.inject_command import Injection
from ship_simulation.scenario.fault import KINDS
from ship_testing.returns.cells import Cell, all_cells, sample_cells
from ship_testing.returns.run_cell import deliver_messages, run_cell
from ship_testing.returns.table import failed_results, failure_lines
from ship_testing.returns.voyages import VOYAGES, VoyageData, load_voyage, make_bag

SHARE, PARTS = 50, 8


@pytest.fixture(scope="module")
def voyages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, VoyageData]:
    folder = tmp_path_factory.mktemp("voyages")
    return {name: load_voyage(make_bag(name, folder)) for name in VOYAGES}


@pytest.fixture(scope="module")
def cells(voyages: dict[str, VoyageData]) -> list[Cell]:
    return all_cells(voyages)


def assert_returned(cells: list[Cell], voyages: dict[str, VoyageData]) -> None:
    results = [run_cell(cell, voyages[cell.voyage].path) for cell in cells]
    lines = [line for result in failed_results(results) for line in failure_lines(result)]
    assert not lines, "\n".join(lines)


def test_every_kind_of_fault_has_cells(cells: list[Cell]) -> None:
    assert len(cells) >= 1500
    assert {cell.row for cell in cells} >= set(KINDS)
    assert len({cell.name for cell in cells}) == len(cells)


@pytest.mark.parametrize("kind", ["delay", "conflict", "flood", "false_stars"])
def test_faults_made_in_memory_are_those_of_an_injected_bag(
    kind: str, cells: list[Cell], voyages: dict[str, VoyageData]
) -> None:
    """``inject`` reads bags. Its random numbers depend on the name of the fault, which is the same here."""
    cell = next(cell for cell in cells if cell.voyage == "sky" and cell.row == kind and "star/" in cell.name)
    data, fault = voyages["sky"], cell.faults[0]
    injection = Injection(data.path, {"f0": fault}, cell.number)
    with read_bag(data.path) as bag:
        injected = [(one.log_time_ns, one.data) for one in injection.records(bag) if one.topic == fault.topic]
    made = [(one.log_ns, serialize(one.content)) for one in deliver_messages(cell, data) if one.topic == fault.topic]
    assert made == injected


@pytest.mark.parametrize("voyage", VOYAGES)
def test_a_short_fault_of_each_voyage_returns(voyage: str, cells: list[Cell], voyages: dict[str, VoyageData]) -> None:
    assert_returned([next(cell for cell in cells if cell.voyage == voyage and cell.row == "offset")], voyages)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "tracker: offset gravity/deflection, node starts after 15 of 30 s",
        "paper: knock ins/imu 120 s",
        "sky: offset ins/imu 120 s",
        "theodolite: history 83:",
        "mount: history 119:",
        "tracker: freeze star/starboard/inertial_attitude 40-160 s + offset gravity/deflection",
        "theodolite: corrupt theodolite/encoder 4 s",
    ],
)
def test_a_cell_that_once_failed_returns(name: str, cells: list[Cell], voyages: dict[str, VoyageData]) -> None:
    """Causes by case: memory of a fault, INS turned in its frame (twice), drift, frozen encoders, one sensor, encoders.
    """
    (cell,) = [cell for cell in cells if cell.name.startswith(name)]
    assert_returned([cell], voyages)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_a_seeded_fiftieth_of_all_cells_returns(part: int, cells: list[Cell], voyages: dict[str, VoyageData]) -> None:
    assert_returned(sample_cells(cells, len(cells) // SHARE)[part::PARTS], voyages)

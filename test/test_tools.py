"""The programs in tools/, which ``make`` runs: no other test and no type check imports all of them."""

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from rosbags.typesys import Stores, get_typestore

TOOLS = Path(__file__).parents[1] / "tools"
PACKAGES = ("ship_", "theodolite_calib")


@pytest.mark.parametrize("tool", sorted(TOOLS.glob("*.py")), ids=lambda path: path.name)
def test_imports_of_the_tools_from_the_suite_exist(tool: Path) -> None:
    """A renamed module or name is found here, not by a user of ``make demo``."""
    tree = ast.parse(tool.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGES):
            module = importlib.import_module(node.module or "")
            missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
            for name in missing:
                importlib.import_module(f"{node.module}.{name}")


def test_the_page_of_speed_has_value_bound_and_circumstances(tmp_path: Path) -> None:
    kept = {
        "date": "2026-11-23", "processor": "one of 1 GHz", "cores": 1, "python": "3.11.7", "numpy": "2.4.6",
        "load": 0.5,
        "rows": [
            {"benchmark": "star_solution", "name": "fast", "value": 1.5, "unit": "x", "greatest": 2.0},
            {"benchmark": "star_solution", "name": "odd", "value": float("nan"), "unit": "x", "greatest": 2.0},
            {"benchmark": "step", "name": "shown", "value": 12.34, "unit": "us"},
        ],
    }  # fmt: skip
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(kept), encoding="utf-8")
    script = f"import json, bench_page; print(bench_page.page(json.load(open({str(path)!r}))))"
    command = [sys.executable, "-c", script]
    text = subprocess.run(command, cwd=TOOLS, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "Measured on 2026-11-23: one of 1 GHz, 1 core, Python 3.11.7, numpy 2.4.6;\nload 0.5, mean" in text
    assert "## star solution\n" in text
    assert "| fast | 1.5 | x | at most 2: met |" in text
    assert "| odd | nan | x | at most 2: NOT MET |" in text
    assert "| shown | 12.3 | us |  |" in text


def packages_that_colcon_finds(*where: str) -> set[str]:
    command = ["colcon", "--log-base", "/dev/null", "list", "--names-only", *where]
    return set(subprocess.run(command, cwd=TOOLS.parent, capture_output=True, text=True, check=True).stdout.split())


def test_packages_of_jazzy_are_built_only_by_the_setup_with_wheels() -> None:
    """A second tf2_msgs in the workspace of a ship's computer would hide the installed one."""
    assert {path.name for path in (TOOLS / "wheels_only").iterdir()} == {"COLCON_IGNORE", "tf2_msgs"}
    assert "ship_msgs" in (found := packages_that_colcon_finds())
    assert "tf2_msgs" not in found
    assert packages_that_colcon_finds("--paths", "tools/wheels_only/tf2_msgs") == {"tf2_msgs"}


def test_tf2_msgs_is_defined_as_in_jazzy() -> None:
    """The hash with which DDS matches types is equal; rosbags has its own copy of Jazzy's definitions."""
    kind = "tf2_msgs/msg/TFMessage"
    described = Path(get_package_share_directory("tf2_msgs"), "msg", "TFMessage.json").read_text(encoding="utf-8")
    hashes = {each["type_name"]: each["hash_string"] for each in json.loads(described)["type_hashes"]}
    assert hashes[kind] == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(kind)

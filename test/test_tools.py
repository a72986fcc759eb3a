"""The programs in tools/, which make runs: no other test and no type check loads them all."""

import ast
import importlib
import json
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from rosbags.typesys import Stores, get_typestore

TOOLS = Path(__file__).parents[1] / "tools"
PACKAGES = ("ship_", "theodolite_calib")


@pytest.mark.parametrize("tool", sorted(TOOLS.glob("*.py")), ids=lambda path: path.name)
def test_what_a_tool_imports_of_the_suite_exists(tool: Path) -> None:
    """A module or a name that has moved is found here, not by the one who types ``make demo``."""
    tree = ast.parse(tool.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGES):
            module = importlib.import_module(node.module or "")
            missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
            for name in missing:
                importlib.import_module(f"{node.module}.{name}")


def packages_that_colcon_finds(*where: str) -> set[str]:
    command = ["colcon", "--log-base", "/dev/null", "list", "--names-only", *where]
    return set(subprocess.run(command, cwd=TOOLS.parent, capture_output=True, text=True, check=True).stdout.split())


def test_what_jazzy_brings_itself_is_built_only_by_the_setup_over_wheels() -> None:
    """In a workspace of a ship's computer a second tf2_msgs would hide the installed one."""
    assert {path.name for path in (TOOLS / "wheels_only").iterdir()} == {"COLCON_IGNORE", "tf2_msgs"}
    assert "ship_msgs" in (found := packages_that_colcon_finds())
    assert "tf2_msgs" not in found
    assert packages_that_colcon_finds("--paths", "tools/wheels_only/tf2_msgs") == {"tf2_msgs"}


def test_tf2_msgs_is_defined_as_in_jazzy() -> None:
    """By the hash with which DDS matches types; rosbags has its own copy of Jazzy's definitions."""
    kind = "tf2_msgs/msg/TFMessage"
    described = Path(get_package_share_directory("tf2_msgs"), "msg", "TFMessage.json").read_text(encoding="utf-8")
    hashes = {each["type_name"]: each["hash_string"] for each in json.loads(described)["type_hashes"]}
    assert hashes[kind] == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(kind)

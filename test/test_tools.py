"""The programs in tools/, which make runs: no other test and no type check loads them all."""

import ast
import importlib
from pathlib import Path

import pytest

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

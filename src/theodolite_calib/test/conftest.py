"""Lets the tests of this directory import the helpers beside them, and those that tests of all adapters share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "ship_node" / "test"))
sys.path.insert(0, str(Path(__file__).parent))

"""Paths of files in the checkout that tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BAGS = ROOT / "bags"
SCENARIOS = BAGS / "scenarios"
RELAY_PROGRAM = str(Path(__file__).with_name("relay_adapter.py"))
"""Node as a separate process: :class:`ship_testing.relay_adapter.RelayAdapter` in a live node."""

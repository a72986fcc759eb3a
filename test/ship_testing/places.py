"""Where the checkout keeps what tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BAGS = ROOT / "bags"
SCENARIOS = BAGS / "scenarios"
RELAY_PROGRAM = str(Path(__file__).with_name("relay_adapter.py"))
"""A node of its own process: :class:`ship_testing.relay_adapter.RelayAdapter` in the shell of a live node."""

"""Cost of a black box for its node: processor time over the demo bag, with and without black box."""

import tempfile
from pathlib import Path

from bench_rows import Row, process_cpu_s
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_testing.trials.live_run import LiveRun

BAG = Path(__file__).resolve().parents[1] / "bags" / "demo.mcap"
RATE = 6.0
PAIRS = 3
GREATEST_BOX_RATIO = 1.10
"""Maximum ratio of the node's processor time with and without black box."""


def black_box_cost() -> list[Row]:
    """Measure the processor time of the live node over the demo bag, alternately with and without its black box."""
    without, with_box = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(PAIRS):
            without.append(_node_cpu_s(folder / f"without_{number}", {}))
            with_box.append(_node_cpu_s(folder / f"with_{number}", {"black_box": f"{folder}/box.mcap"}))
    # The minimum is used, because other load of the machine only increases the times.
    return [
        Row("node over the demo bag, processor time", min(without), "s"),
        Row("the same with its black box", min(with_box), "s"),
        Row("ratio: black box", min(with_box) / min(without), "x", GREATEST_BOX_RATIO, "the node without"),
    ]


def _node_cpu_s(folder: Path, parameters: dict[str, str]) -> float:
    """Return the processor time of the node for the demo bag, without the start of the node, s."""
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", folder, parameters) as run:
        begin_s = process_cpu_s(run.node.pid)
        run.play(RATE)
        return process_cpu_s(run.node.pid) - begin_s

"""Kills `record` and a node with its black box (kill -9) at random times and counts the lost messages.

Exits with 1 if more than a flush period is lost, or if rosbags and mcap do not read the whole recovered file.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from ship_testing.trials.kill_trial import RATE_HZ, KillTrial, kill_node, kill_recorder

BOX_FLUSH_PERIOD_S = 0.1


def main() -> int:
    """Run the campaign; return 0 if no more than the last flush period is lost."""
    first, _, last = __doc__.splitlines()[:3]
    parser = argparse.ArgumentParser(description=first, epilog=last, allow_abbrev=False)
    parser.add_argument("--kills", type=int, default=40, help="of each of the two (default 40)")
    parser.add_argument("--first-seed", type=int, default=1, help="seed of the first moment (default 1)")
    parser.add_argument(
        "--flush-period-s", type=float, default=0.1, help="of record, in seconds (default 0.1)"
    )
    parser.add_argument("--only", choices=("record", "box"), help="one of them (both)")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.kills)
    victims: dict[str, tuple[float, Callable[[Path, int], KillTrial]]] = {
        "record": (
            arguments.flush_period_s,
            lambda folder, seed: kill_recorder(folder, seed, arguments.flush_period_s),
        ),
        "box": (BOX_FLUSH_PERIOD_S, kill_node),
    }
    console = Console(width=120)
    table = Table(title=f"kill -9 at random moments, {RATE_HZ:.0f} messages/s")
    for column in (
        "victim",
        "kills",
        "flush period (ms)",
        "lost: median, largest (ms)",
        "lost messages",
        "gaps",
        "re-read",
        "",
    ):
        table.add_column(column, justify="left" if column == "victim" else "right")
    kept = True
    for name, (period_s, kill) in victims.items():
        if arguments.only not in (None, name):
            continue
        with tempfile.TemporaryDirectory() as folder:
            trials = [kill(Path(folder), seed) for seed in track(seeds, name, console=Console(stderr=True))]
        bad = [seed for seed, trial in zip(seeds, trials, strict=True) if not trial.is_within_flush_period(period_s)]
        kept &= not bad
        table.add_row(
            name,
            str(len(trials)),
            f"{period_s * 1e3:.0f}",
            *_figures(trials),
            f"seeds {bad}" if bad else "ok",
        )
    console.print(table)
    return 0 if kept else 1


def _figures(trials: list[KillTrial]) -> tuple[str, ...]:
    lost_ms = sorted(trial.lost_s * 1e3 for trial in trials)
    reread = sum(trial.recovered_count == trial.readable_counts[0] == trial.readable_counts[1] for trial in trials)
    return (
        f"{lost_ms[len(lost_ms) // 2]:.0f}, {lost_ms[-1]:.0f}",
        f"{max(trial.sent_count - trial.kept_count for trial in trials)} at most",
        str(sum(trial.has_gap for trial in trials)),
        f"{reread} of {len(trials)}",
    )


if __name__ == "__main__":
    raise SystemExit(main())
